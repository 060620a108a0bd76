"""States that nobody measured, but whose starts are known: how exactly these are, and where a fit begins.

No curve tells the coefficients of their equations. So a fit begins at many of them: each gives the states along the
curves of those that were measured, and least squares then the coefficients of the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference.scaling import may_be_rescaled
from commonlaw.inference.smooth_rates import first_coefficients
from commonlaw.inference.tried_coefficients import draws, relative_speed, scales_of_states
from commonlaw.library import Terms
from commonlaw.likelihood import Estimate, TrajectoryModel, fit, interpolate
from commonlaw.trials import Trial, Trials

_RELATIVE = 1e-6
"""Standard deviation of a start relative to the scale of its state: less than any measurement tells."""

_OTHERS = 6
"""Objects whose coefficients are tried on each object, too: objects are alike."""

_STEPS = 256
"""Steps in which states are followed along a trial, at least."""

_MODEL_ERRORS = (1.0, 0.1, 0.01)
"""Relative to the noise: states first follow what was measured, then the law."""

_AS_GOOD = 1.0
"""What two fits to the same measurements may differ by in twice the log-likelihood, as meshes may."""

_ALIKE = 0.1
"""Coefficients that differ by less of their size may be the same, before they are fitted to the end."""

_EXACT = 1e-6
"""Deviance of measurements that count as exact."""

Curve = tuple[Floats, Floats]
"""States and rates of a trial at its samples, each of shape (n, states)."""


def with_exact_starts(trials: Trials, terms: Terms, known: Floats) -> Trials:
    """Return trials whose known starts have standard deviations that are small beside the scale of their states.

    That is the largest start; of states that start at zero it follows from the numbers in equations. Coefficients that
    are known have the shape (equations, terms), NaN where they are to be found.

    Raises
    ------
    CommonlawError
        If nothing tells the scale of a state.
    """
    started = trials.schema.unmeasured
    if not started.any():
        return trials
    scales = scales_of_states(trials, terms, known)
    at_zero = started & np.all([trial.states[0] == 0 for trial in trials], axis=0)
    unclear = may_be_rescaled(terms, known, at_zero)
    for name, free in zip(trials.schema.states, unclear, strict=True):
        if free:
            raise CommonlawError(
                f"{name} was not measured and starts at zero, so that nothing tells its scale: twice {name}, with "
                "other coefficients, would fit as well; write a number for the coefficient of one term in its "
                f"equation, such as {name}' = 1 x - ..., which says in what {name} is counted"
            )
    changed = []
    for trial in trials:
        noise = trial.noise.copy()
        noise[0, started] = _RELATIVE * scales[started]
        changed.append(replace(trial, noise=noise))
    return trials.with_trials(changed)


def with_noise_of_unmeasured(noise: Floats, trials: Trials) -> Floats:
    """Return the noise of each state, shape (states,), with that of states that nobody measured as if they had been.

    It is the same share of their scale as of others. Model errors are relative to it, and so is what says next to
    nothing of a state; starts have standard deviations of their own.
    """
    started = trials.schema.unmeasured
    spread = np.nanstd(np.concatenate([trial.states for trial in trials])[:, ~started], axis=0)
    share = np.median(noise[~started] / spread)
    return np.where(started, share * noise_of_starts(trials) / _RELATIVE, noise)


def noise_of_starts(trials: Trials) -> Floats:
    """Return the standard deviation of the starts of each state, shape (states,)."""
    return np.asarray(np.max([trial.noise[0] for trial in trials], axis=0))


def begun_at_starts(
    models: Sequence[TrajectoryModel],
    trials: Trials,
    curves: Sequence[Sequence[Curve]],
    known: Floats,
    guess: Floats,
) -> tuple[list[Estimate], list[list[Curve]], list[Floats]]:
    """Return where the fit of each object begins, curves of all its states, and what would fit the first one as well.

    Where several coefficients, shape (equations, terms), fit as well, it begins at those with signs as guessed by which
    unmeasured states change fastest.

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
    objects = [_Object(*own, started) for own in zip(models, groups, curves, known, guess, strict=True)]
    tried = [each.begun(draws(trials, each.model.terms, each.known, each.guess)) for each in objects]
    for each, own in zip(objects, tried, strict=True):
        if not own:
            raise CommonlawError(
                f"{each.group[0].object}: with none of the coefficients that were tried does "
                f"{', '.join(trials.schema.starts)} stay finite from its start on, along the other states, of which "
                "each trial needs measurements: look for a wrong sign or a missing term in the equations"
            )
    first = [_best(*each, trials)[0][0].coefficients for each in zip(objects, tried, strict=True)]
    some = first[:: -(-len(first) // _OTHERS)]
    best = [_best(each, [*own, *each.begun(some)], trials) for each, own in zip(objects, tried, strict=True)]
    others = [found.coefficients for found, _ in best[0]]
    return [each[0][0] for each in best], [each[0][1] for each in best], _different(others)[1:]


@dataclass(frozen=True, eq=False)
class _Object:
    """An object: its model, trials, curves, known and guessed coefficients, and which states nobody measured."""

    model: TrajectoryModel
    group: Sequence[Trial]
    curves: Sequence[Curve]
    known: Floats
    guess: Floats
    started: Bools

    def begun(self, tried: Sequence[Floats]) -> list[tuple[Estimate, list[Curve]]]:
        """Return fits that begin at coefficients, NaN where least squares find them, and curves of all states."""
        terms, found = self.model.terms, list[tuple[Estimate, list[Curve]]]()
        tried = [np.where(np.isnan(self.known), each, self.known) for each in tried]
        pairs = list(zip(self.group, self.curves, strict=True))
        followed = [_followed(terms, *pair, np.array(tried), self.started) for pair in pairs]
        for coefficients, *states in zip(tried, *followed, strict=True):
            if all(np.isfinite(own).all() for own in states):
                filled = [
                    (own, np.where(self.started, 0.0, rates))
                    for own, (_, rates) in zip(states, self.curves, strict=True)
                ]
                own = first_coefficients(terms, list(zip(self.group, filled, strict=True)), coefficients)
                start = Estimate(tuple(interpolate(states)), own)
                fitted = fit(self.model, start, np.isnan(self.known), _MODEL_ERRORS)
                if np.isfinite(fitted.objective):
                    found.append((fitted, filled))
        return found


def _best(
    own: _Object, fits: Sequence[tuple[Estimate, list[Curve]]], trials: Trials
) -> list[tuple[Estimate, list[Curve]]]:
    """Return the fits that are the best, those with signs as guessed and fast unmeasured states first."""
    count = sum(int(np.isfinite(trial.states).sum()) for trial in own.group)
    least = min(found.objective for found, _ in fits)
    # Twice the log-likelihood at the noise that each fit leaves, as that is not known yet
    best = [each for each in fits if count * np.log((each[0].objective + _EXACT) / (least + _EXACT)) < _AS_GOOD]
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
        if not any(np.allclose(each, other, rtol=_ALIKE, atol=0.0) for other in kept):
            kept.append(each)
    return kept


def _followed(terms: Terms, trial: Trial, curve: Curve, coefficients: Floats, started: Bools) -> Floats:
    """Return states with the unmeasured ones from their starts on, along a curve of the others (Runge-Kutta).

    They have the shape (draws, n, states), by coefficients of shape (draws, equations, terms).
    """
    substeps = -(-_STEPS // len(trial))
    rows = np.column_stack([np.where(started, 0.0, curve[0]), trial.inputs, trial.times])
    (rows,) = interpolate([rows], 2 * substeps, len(trial))
    rows, columns = terms.variables.natural(rows), np.flatnonzero(started)
    own = coefficients[:, started]
    inside = np.nan_to_num(coefficients[:, :, list(terms.constants)]).sum(axis=1)
    values = np.empty((len(coefficients), rows.shape[1] + inside.shape[1]))
    values[:, rows.shape[1] :] = inside

    def rates(i: int, now: Floats) -> Floats:
        values[:, : rows.shape[1]] = rows[i]
        values[:, columns] = now
        return np.asarray((own @ terms.evaluate(values)[:, :, np.newaxis])[:, :, 0])

    now = np.tile(trial.states[0, started], (len(coefficients), 1))
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
    states[:, :, started] = np.stack(path[::substeps], axis=1)
    return states
