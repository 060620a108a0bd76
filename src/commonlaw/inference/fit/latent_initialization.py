"""States that nobody measured: how exactly their starts are known, and where a fit begins.

No curve tells the coefficients of their equations. So a fit begins at many of them: each gives the states along the
curves of those that were measured, and least squares then the coefficients of the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.data.latent_states import scales_of_starts
from commonlaw.inference.data.smoothing import first_coefficients, terms_and_rates
from commonlaw.inference.fit.initial_guesses import Drawn, draws, relative_speed, scales_of_states
from commonlaw.inference.fit.shooting import shot
from commonlaw.inference.fit.structural_identifiability import may_be_mixed, may_be_rescaled, may_be_shifted
from commonlaw.library import Terms
from commonlaw.likelihood import Estimate, TrajectoryModel, fit, interpolate
from commonlaw.spacing import evenly_spaced
from commonlaw.trials import Schema, Trial, Trials

Curve = tuple[Floats, Floats]
"""States and rates of a trial at its samples, shape (n, D), and their highest derivatives, shape (n, states)."""


def with_exact_starts(trials: Trials, terms: Terms, known: Floats) -> Trials:
    """Return trials whose known starts have standard deviations that are small beside the scale of their states.

    Starts that nobody knows are zero, with standard deviations that say next to nothing. Scales are those of starts, or
    follow from the equations. Coefficients that are known have the shape (equations, terms), NaN where they are to be
    found.

    Raises
    ------
    CommonlawError
        If nothing tells the scale of a state, or its zero.
    """
    schema, started = trials.schema, trials.schema.unmeasured
    if not started.any():
        return trials
    free = schema.with_free_start
    at_zero = started & np.all([trial.states[0] == 0 for trial in trials], axis=0)
    rescaled = may_be_rescaled(terms, known, at_zero | free)
    shifted, mixed = may_be_shifted(terms, known, free), may_be_mixed(terms, known, free)
    _refuse_what_starts_do_not_tell(schema, rescaled, shifted, mixed)
    std = np.where(free, settings.VAGUE, settings.ROUNDING) * scales_of_states(trials, terms, known)
    changed = []
    for trial in trials:
        states, noise = trial.states.copy(), trial.noise.copy()
        states[0, free] = 0.0
        noise[0, started] = std[started]
        changed.append(replace(trial, states=states, noise=noise))
    return trials.with_trials(changed)


def _refuse_what_starts_do_not_tell(schema: Schema, rescaled: Bools, shifted: Bools, mixed: Bools) -> None:
    """Refuse states whose scale, zero, or share of another state could be any."""
    for name, any_scale, any_zero, any_share in zip(schema.states, rescaled, shifted, mixed, strict=True):
        is_free = schema.starts.get(name, 0.0) is None
        if any_scale and not is_free:
            raise CommonlawError("latent-scale-of-zero", name=name)
        if any_scale or any_zero:
            what, where = ("scale", "1.0") if any_scale else ("zero", "0.0")
            raise CommonlawError("latent-scale", name=name, quantity=what, value=where)
        if any_share:
            raise CommonlawError("latent-initial-value", name=name)


def with_noise_of_unmeasured(noise: Floats, trials: Trials) -> Floats:
    """Return the noise of each state, shape (states,), with that of states that nobody measured as if they had been.

    It is the same share of their scale as of others. Model errors are relative to it, and so is what says next to
    nothing of a state; starts have standard deviations of their own.
    """
    started = trials.schema.unmeasured
    spread = np.nanstd(np.concatenate([trial.states for trial in trials])[:, ~started], axis=0)
    share = np.median(noise[~started] / spread)
    return np.where(started, share * scales_of_starts(trials), noise)


def begun_at_starts(
    models: Sequence[TrajectoryModel],
    trials: Trials,
    curves: Sequence[Sequence[Curve]],
    known: Floats,
    guess: Floats,
) -> tuple[list[Estimate], list[list[Curve]], list[Floats]]:
    """Return where the fit of each object begins, curves of all its states, and what would fit the first one as well.

    Where several coefficients, shape (equations, terms), fit as well, it begins at those with signs as guessed by which
    unmeasured states change fastest, and of each object at those that are most like the others'.

    Parameters
    ----------
    models
        Of the objects.
    trials
        Of the objects, whose starts have standard deviations.
    curves
        Through the measurements of each object; those of unmeasured states are NaN.
    known
        Coefficients that are known, shape (objects, equations, terms), NaN where they are to be found.
    guess
        Coefficients of likely signs, of the same shape; zero where nothing is likely.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed from any of them.
    """
    groups = [trials.of_object(name) for name in trials.objects]
    started = trials.schema.unmeasured
    free = trials.schema.with_free_start
    objects = [_Object(*own, started, free) for own in zip(models, groups, curves, known, guess, strict=True)]
    tried = [each.begun(draws(trials, each.model.terms, each.known, each.guess)) for each in objects]
    for each, own in zip(objects, tried, strict=True):
        if not own:
            raise CommonlawError("latent-diverges", where=each.group[0].object, latent=trials.schema.starts)
    first = [_found(_best(*each, trials)[0][0]) for each in zip(objects, tried, strict=True)]
    some = [first[i] for i in evenly_spaced(len(first), settings.MAX_OBJECTS)]
    best = [_best(each, [*own, *each.begun(some)], trials) for each, own in zip(objects, tried, strict=True)]
    typical = _typical([each[0][0].coefficients for each in best])
    nearest = [min(each, key=lambda fit: _distance(fit[0].coefficients, typical)) for each in best]
    unlike = [_distance(each.coefficients, typical) > settings.ALIKE * np.isnan(known[0]).sum() for each, _ in nearest]
    if 2 * sum(unlike) < len(unlike):
        nearest = [
            own.like(typical, fitted) if other else fitted
            for own, fitted, other in zip(objects, nearest, unlike, strict=True)
        ]
    others = _different([nearest[0][0].coefficients, *(found.coefficients for found, _ in best[0])])
    return [found for found, _ in nearest], [curve for _, curve in nearest], others[1:]


def _typical(found: Sequence[Floats]) -> Floats:
    """Return the coefficients of the object that is most like all others."""
    return min(found, key=lambda each: sum(_distance(each, other) for other in found))


def _distance(one: Floats, other: Floats) -> float:
    """Return how far coefficients, shape (equations, terms), are apart, relative to their sizes."""
    sizes = np.abs(one) + np.abs(other)
    return float(np.sum(np.abs(one - other) / np.where(sizes > 0, sizes, 1.0)))


@dataclass(frozen=True, eq=False)
class _Object:
    """An object: its model, trials, curves, known and guessed coefficients, and which states nobody measured.

    Of these, some start where nobody knows.
    """

    model: TrajectoryModel
    group: Sequence[Trial]
    curves: Sequence[Curve]
    known: Floats
    guess: Floats
    started: Bools
    free: Bools

    def begun(self, tried: Sequence[Drawn]) -> list[tuple[Estimate, list[Curve]]]:
        """Return fits that begin at coefficients, NaN where least squares find them, and curves of all states.

        Of many those begin that leave least of the rates of measured states along curves.
        """
        drawn = np.array([np.where(np.isnan(self.known), each.coefficients, self.known) for each in tried])
        starts = np.where(self.free, [each.starts for each in tried], np.nan)
        pairs = list(zip(self.group, self.curves, strict=True))
        followed = [_followed(self.model.terms, *pair, drawn, starts, self.started) for pair in pairs]
        begins = []
        for coefficients, *states in zip(drawn, *followed, strict=True):
            if all(np.isfinite(own).all() for own in states):
                filled = [
                    (own, np.where(self.started, 0.0, rates))
                    for own, (_, rates) in zip(states, self.curves, strict=True)
                ]
                begins.append((*self._along(filled, coefficients), filled))
        best = sorted(begins, key=lambda each: each[0])[: settings.MAX_FITTED_DRAWS]
        fits = ((self._fitted(own, filled), filled) for _, own, filled in best)
        return [each for each in fits if np.isfinite(each[0].objective)]

    def as_good(self, one: Estimate, other: Estimate, most: float) -> bool:
        """Return whether a fit is worse than another by no more than this in twice the log-likelihood.

        That is at the noise that each fit leaves, as it is not known yet.
        """
        count = sum(int(np.isfinite(trial.states).sum()) for trial in self.group)
        return bool(count * np.log((one.objective + settings.ROUNDING) / (other.objective + settings.ROUNDING)) < most)

    def like(self, typical: Floats, fitted: tuple[Estimate, list[Curve]]) -> tuple[Estimate, list[Curve]]:
        """Return a fit that is like the typical coefficients, if that is as good as another one; else this."""
        if not self.free.any() and not self.model.terms.variables.logarithmic and self.model.order == 1:
            found = self.shot(np.where(np.isnan(self.known), typical, self.known))
            if np.isfinite(found[0].objective) and self.as_good(found[0], fitted[0], settings.INDIFFERENT):
                return found
        return fitted

    def shot(self, coefficients: Floats) -> tuple[Estimate, list[Curve]]:
        """Return the solutions of the law that fit best near some coefficients, with the squares that they leave."""
        measured = [np.where(self.started, np.nan, trial.states) for trial in self.group]
        begin = np.array([trial.states[0] for trial in self.group])
        begin = np.where(self.started, begin, [states[0] for states, _ in self.curves])
        loose = np.broadcast_to(~self.started, begin.shape)

        def solutions(found: Floats, starts: Floats) -> list[Floats]:
            everything, pairs = np.ones_like(self.started), zip(self.group, self.curves, strict=True)
            terms = self.model.terms
            return [_followed(terms, *pair, found, starts[:, i], everything) for i, pair in enumerate(pairs)]

        free, noise = np.isnan(self.known), self.model.observation.noise
        squares, found, starts = shot(solutions, measured, noise, coefficients, free, begin, loose)
        states = [each[0] for each in solutions(found[np.newaxis], starts[np.newaxis])]
        filled = [
            (own, np.where(self.started, 0.0, rates)) for own, (_, rates) in zip(states, self.curves, strict=True)
        ]
        # On the mesh a solution is slightly another one
        settled = fit(
            self.model,
            Estimate(tuple(interpolate(states)), found),
            np.zeros_like(free),
            (*settings.LATENT_MODEL_ERRORS, 0.001, 0.0003),
        )
        return replace(settled, deviance=squares, objective=squares), filled

    def _along(self, filled: list[Curve], coefficients: Floats) -> tuple[float, Floats]:
        """Return how much of the rates of measured states is left along curves of all states, and all coefficients."""
        curves = list(zip(self.group, filled, strict=True))
        own = first_coefficients(self.model.terms, curves, coefficients)
        library, rates = terms_and_rates(self.model.terms, curves, own)
        left = (rates - library @ own.T)[:, ~self.started]
        with np.errstate(over="ignore"):  # Far from any law
            squares = np.mean(left**2, axis=0)
        return float(np.sum(np.log(squares + np.finfo(float).tiny))), own

    def _fitted(self, coefficients: Floats, filled: list[Curve]) -> Estimate:
        start = Estimate(tuple(interpolate([states for states, _ in filled])), coefficients)
        return fit(self.model, start, np.isnan(self.known), settings.LATENT_MODEL_ERRORS)


def _found(estimate: Estimate) -> Drawn:
    """Return the coefficients of a fit, and where its first trial starts."""
    return Drawn(estimate.coefficients, estimate.states[0][0, : len(estimate.coefficients)])


def _best(
    own: _Object, fits: Sequence[tuple[Estimate, list[Curve]]], trials: Trials
) -> list[tuple[Estimate, list[Curve]]]:
    """Return the fits that are the best, those with signs as guessed and fast unmeasured states first."""
    least = min((found for found, _ in fits), key=lambda each: each.objective)
    best = [each for each in fits if own.as_good(each[0], least, settings.INDIFFERENT)]
    return sorted(
        best,
        key=lambda each: (
            -int(np.sum(each[0].coefficients * own.guess > 0)),
            -relative_speed(trials, own.model.terms, own.known, each[0].coefficients),
        ),
    )


def _different(found: Sequence[Floats]) -> list[Floats]:
    """Return the first of coefficients that are alike."""
    kept: list[Floats] = []
    for each in found:
        if not any(np.allclose(each, other, rtol=settings.ALIKE, atol=0.0) for other in kept):
            kept.append(each)
    return kept


def _followed(terms: Terms, trial: Trial, curve: Curve, coefficients: Floats, starts: Floats, started: Bools) -> Floats:
    """Return states with the unmeasured ones from their starts on, along a curve of the others (Runge-Kutta).

    They have the shape (draws, n, states), by coefficients of shape (draws, equations, terms) and starts of those that
    nobody knows, shape (draws, states).
    """
    substeps = -(-settings.MAX_CURVE_POINTS // len(trial))
    known, columns = curve[0].copy(), np.flatnonzero(started)
    known[:, columns] = 0.0
    rows = np.column_stack([known, trial.inputs, trial.times])
    (rows,) = interpolate([rows], 2 * substeps, len(trial))
    rows = terms.variables.natural(rows)
    own = coefficients[:, started]
    inside = np.nan_to_num(coefficients[:, :, list(terms.constants)]).sum(axis=1)
    values = np.empty((len(coefficients), rows.shape[1] + inside.shape[1]))
    values[:, rows.shape[1] :] = inside

    def rates(i: int, now: Floats) -> Floats:
        values[:, : rows.shape[1]] = rows[i]
        values[:, columns] = now
        return np.asarray((own @ terms.evaluate(values)[:, :, np.newaxis])[:, :, 0])

    now = np.where(np.isnan(starts), trial.states[0], starts)[:, started]
    path = [now]
    with np.errstate(all="ignore"):
        for i in range(0, len(rows) - 1, 2):
            step = rows[i + 2, -1] - rows[i, -1]
            first = rates(i, now)
            second = rates(i + 1, now + step / 2 * first)
            third = rates(i + 1, now + step / 2 * second)
            now = now + step / 6 * (first + 2 * (second + third) + rates(i + 2, now + step * third))
            path.append(now)
    states = np.tile(curve[0], (len(coefficients), 1, 1))
    states[:, :, columns] = np.stack(path[::substeps], axis=1)
    return states
