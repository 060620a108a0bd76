"""Latent states: the prior of their initial values, and initial estimates by multi-start.

Coefficients of equations of latent states are drawn at random over their plausible range. Each draw is integrated along
the smoothed measured states, coefficients of the other equations follow by gradient matching, and the best draws are
fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.data.smoothing import Curve, gradient_matching, terms_and_rates
from commonlaw.inference.fit.parameter_grid import factor_powers, grid_product, parameter_values
from commonlaw.inference.fit.structural_identifiability import has_symmetry
from commonlaw.integration import runge_kutta_step
from commonlaw.library import Terms, order_of_each, with_rates
from commonlaw.likelihood import Estimate, TrajectoryModel, fit, interpolate
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import natural


def latent_state_ranges(trials: Trials, estimates: Sequence[Estimate]) -> dict[str, tuple[float, float]]:
    """Return the ranges of states with free initial values, by name."""
    states = np.concatenate([path for estimate in estimates for path in estimate.states])
    free = np.flatnonzero(trials.schema.with_free_start)
    return {trials.schema.states[j]: (float(states[:, j].min()), float(states[:, j].max())) for j in free}


def with_initial_condition_noise(trials: Trials, terms: Terms, known: Floats) -> Trials:
    """Return trials with standard deviations of the initial values of latent states, relative to the scales of these.

    They are `ROUNDING` for given values, and `VAGUE` for free ones, whose value is zero. Scales are those of given
    values, or follow from the equations. Fixed coefficients have shape (equations, terms), NaN for free ones.

    Raises `CommonlawError` if the scale of a state, or its zero, is not identifiable.
    """
    schema, started = trials.schema, trials.schema.is_latent
    if not started.any():
        return trials
    free = schema.with_free_start
    at_zero = started & np.all([trial.states[0] == 0 for trial in trials], axis=0)
    guesses = _Guesses(trials, terms, known)
    sizes = guesses.whole(np.where(guesses.largest > 0, guesses.largest, np.nan))
    rescaled = has_symmetry("scaling", terms, known, at_zero | free, sizes)
    shifted = has_symmetry("translation", terms, known, free, sizes)
    mixed = has_symmetry("mixing", terms, known, free, sizes)
    for name, any_scale, any_zero, any_share in zip(schema.states, rescaled, shifted, mixed, strict=True):
        if any_scale and schema.initial_values.get(name, 0.0) is not None:
            raise CommonlawError("latent-scale-of-zero", name=name)
        if any_scale or any_zero:
            what, where = ("scale", "1.0") if any_scale else ("zero", "0.0")
            raise CommonlawError("latent-scale", name=name, quantity=what, value=where)
        if any_share:
            raise CommonlawError("latent-initial-value", name=name)
    std = np.where(free, settings.VAGUE, settings.ROUNDING) * guesses.scales
    changed = []
    for trial in trials:
        states, noise = trial.states.copy(), trial.noise.copy()
        states[0, free] = 0.0
        noise[0, started] = std[started]
        changed.append(replace(trial, states=states, noise=noise))
    return trials.with_trials(changed)


def pooled_start(model: TrajectoryModel, start: Estimate, others: Sequence[Floats]) -> Estimate:
    """Return an initial estimate at the mean coefficients of other objects, each of shape (equations, terms).

    Its states are fitted with these coefficients; without other objects it stays as it is.
    """
    if not others:
        return start
    coefficients = np.mean(others, axis=0)
    fixed = np.zeros(coefficients.shape, dtype=np.bool_)
    fitted = fit(model, replace(start, coefficients=coefficients), fixed, settings.LATENT_MODEL_ERRORS)
    return Estimate(fitted.states, coefficients) if np.isfinite(fitted.objective) else start


def initial_latent_estimates(
    models: Sequence[TrajectoryModel], trials: Trials, curves: Sequence[Sequence[Curve]], known: Floats, guess: Floats
) -> tuple[list[Estimate], list[list[Curve]], list[Floats]]:
    """Return the initial estimate of each object, the curves of all its states, and equivalent optima of the first one.

    Of optima that fit equally well, that with guessed signs and the fastest latent states is taken, and in each object
    that closest to the others.

    Curves are NaN in unmeasured states. Fixed coefficients, NaN for free ones, and guesses of signs, zero without any,
    have shape (objects, equations, terms).
    """
    started, free = trials.schema.is_latent, trials.schema.with_free_start
    objects = [
        _Object(model, trials.of_object(name), smoothed, started, free, signs, _Guesses(trials, model.terms, given))
        for model, name, smoothed, given, signs in zip(models, trials.objects, curves, known, guess, strict=True)
    ]
    fits = [obj.fits(obj.guesses.draws(obj.signs)) for obj in objects]
    for obj, listed in zip(objects, fits, strict=True):
        if not listed:
            raise CommonlawError("latent-diverges", where=obj.group[0].object, latent=trials.schema.initial_values)
    first = [obj.best(listed)[0][0] for obj, listed in zip(objects, fits, strict=True)]
    some = [
        Draw(first[i].coefficients, first[i].states[0][0, : len(started)])
        for i in evenly_spaced(len(first), settings.MAX_OBJECTS)
    ]
    best = [obj.best([*listed, *obj.fits(some)]) for obj, listed in zip(objects, fits, strict=True)]
    leading = [ranked[0][0].coefficients for ranked in best]
    typical = min(leading, key=lambda candidate: sum(_distance(candidate, likely) for likely in leading))
    nearest = [min(ranked, key=lambda fitted: _distance(fitted[0].coefficients, typical)) for ranked in best]
    tolerance = settings.MAX_RELATIVE_DIFFERENCE * np.isnan(known[0]).sum()
    distant = [_distance(estimate.coefficients, typical) > tolerance for estimate, _ in nearest]
    if 2 * sum(distant) < len(distant):
        for o, (obj, (estimate, _)) in enumerate(zip(objects, nearest, strict=True)):
            shoots = not free.any() and not obj.model.terms.variables.logarithmic and obj.model.order == 1
            if distant[o] and shoots:
                shot = obj.shot(np.where(np.isnan(obj.known), typical, obj.known))
                if np.isfinite(shot[0].objective) and obj.is_equivalent(shot[0], estimate):
                    nearest[o] = shot
    different: list[Floats] = []
    for theta in (nearest[0][0].coefficients, *(estimate.coefficients for estimate, _ in best[0])):
        if not any(np.allclose(theta, listed, rtol=settings.MAX_RELATIVE_DIFFERENCE, atol=0.0) for listed in different):
            different.append(theta)
    return [estimate for estimate, _ in nearest], [curve for _, curve in nearest], different[1:]


def _distance(a: Floats, b: Floats) -> float:
    """Return the sum of relative differences ``|a - b| / (|a| + |b|)`` of coefficients, shape (equations, terms)."""
    sizes = np.abs(a) + np.abs(b)
    return float(np.sum(np.abs(a - b) / np.where(sizes > 0, sizes, 1.0)))


class Draw(NamedTuple):
    """Initial coefficients, shape (equations, terms), and initial values of states, shape (states,)."""

    coefficients: Floats
    starts: Floats


@dataclass(frozen=True, eq=False)
class _Guesses:
    """Random initial coefficients of the equations of latent states, given fixed ones, shape (equations, terms)."""

    trials: Trials
    terms: Terms
    known: Floats

    @cached_property
    def largest(self) -> Floats:
        """The largest absolute value of each state, measured or given, shape (states,), zero without any."""
        columns = np.concatenate([natural(trial.states, self.trials.schema) for trial in self.trials])
        return np.asarray(np.nanmax(np.abs(np.vstack([columns, np.zeros(columns.shape[1])])), axis=0))

    @cached_property
    def scales(self) -> Floats:
        """The scale of each state, shape (states,), by measurements and starts, or else by the equations.

        By these, and by parameters that are factors of terms, states change by about their scales within a trial.
        """
        largest = self.largest
        unknown = self.trials.schema.is_latent & (largest == 0)
        scales = np.where(unknown, np.median(largest[~unknown]), largest)
        where = np.nonzero(~np.isnan(self.known) & (self.known != 0) & self.terms.is_factor)
        count, inside = int(unknown.sum()), self.known[:, list(self.terms.parameters)].sum(axis=0)
        if not unknown.any() or not len(where[0]):
            return scales

        def excess(logarithms: Floats) -> Floats:
            """Return by what factors, as logarithms, rates are off."""
            scales[unknown], parameters = np.exp(logarithms[:count]), np.exp(logarithms[count:])
            parameters = np.where(np.isnan(inside), parameters, inside)
            rates = self._sizes(scales, parameters)[where[1]] * np.abs(self.known[where])
            factors = np.log(self._times[where[0]] * rates / scales[where[0]])
            return np.where(np.isfinite(factors), factors, 0.0)

        logarithms = np.log([*scales[unknown], *np.full(len(self.terms.parameters), 1 / self._duration)])
        for _ in range(settings.MAX_ITERATIONS):
            here, steps = excess(logarithms), settings.ROUNDING * np.eye(len(logarithms))
            slopes = np.array([(excess(logarithms + step) - here) / settings.ROUNDING for step in steps]).T
            step = np.linalg.lstsq(slopes, here, rcond=settings.ROUNDING)[0]
            logarithms = logarithms - np.clip(step, -1.0, 1.0)
            if np.abs(step).max() < settings.ROUNDING:
                break
        scales[unknown] = np.exp(logarithms[:count])
        return scales

    def relative_speed(self, coefficients: Floats) -> float:
        """Return the sum of relative rates of latent states times the duration of a trial."""
        parameters = coefficients[:, list(self.terms.parameters)].sum(axis=0)
        rates = np.abs(coefficients) * self._sizes(self.scales, parameters) / self.scales[:, np.newaxis]
        return self._duration * float(np.sum(rates[self.trials.schema.is_latent]))

    def draws(
        self, guess: Floats, decades: tuple[float, float] = (-1.0, 1.5), share_negative: float = 0.25
    ) -> list[Draw]:
        """Return random draws of nonlinear parameters and coefficients of latent equations, with given signs.

        Rates are log-uniform: a state changes by its scale within a trial at the slowest, and within the shortest step
        at the fastest. Parameters that are no factors, such as K in ``s/(K + s)``, are from their `parameter_grid`.
        Free initial values are log-uniform between decades from the scales of their states, a share of them negative.
        """
        trials, terms, schema = self.trials, self.terms, self.trials.schema
        tried = np.isnan(self.known) & (schema.is_latent[:, np.newaxis] | ~terms.is_factor)
        powers, is_rate = factor_powers(terms), tried & terms.is_factor
        is_rate[:, list(terms.parameters)] |= tried[:, list(terms.parameters)] & np.isfinite(powers).all(axis=0)
        (equations, columns), matrix = self._rates(is_rate, powers)
        first, inside = len(terms.variables.measured), tried & ~is_rate
        others = [first + terms.parameters.index(k) for k in np.argwhere(inside)[:, 1].tolist()]
        sizes = self.whole(self.scales)[np.newaxis]
        bank = grid_product(parameter_values(terms, sizes, others)) if others else np.empty((1, 0))
        signs = np.sign(guess[is_rate])
        factors = np.nan_to_num(np.abs(self.known[equations, columns]), nan=1.0)
        steps = self._duration / min(np.diff(trial.measured().times).min() for trial in trials)
        count, is_drawn = int(tried.sum() + schema.with_free_start.sum()), bool(schema.with_free_start.any())
        random, draws = np.random.default_rng(0), list[Draw]()
        for _ in range(settings.MIN_DRAWS[is_drawn] * max(1, (count + 1) // 2) if count else 1):
            drawn, starts = self.known.copy(), self.scales
            either = np.where(signs == 0, random.choice([-1, 1], len(signs)), signs)
            drawn[inside] = bank[random.integers(len(bank))]
            parameters = np.nan_to_num(np.where(is_rate, 1.0, drawn)[:, list(terms.parameters)]).sum(axis=0)
            sizes = self._sizes(self.scales, parameters)[columns] * factors
            typical = self.scales[equations] / (self._times[equations] * sizes)
            targets = np.log(typical * steps ** random.uniform(0, 1, len(typical)))
            drawn[is_rate] = either * np.exp(np.linalg.lstsq(matrix, targets)[0])
            if is_drawn:
                is_negative = random.uniform(size=len(starts)) < share_negative
                sizes = starts * 10 ** random.uniform(*decades, len(starts))
                starts = np.where(is_negative, -sizes, sizes)
            draws.append(Draw(drawn, starts))
        return draws

    def _rates(self, is_rate: Bools, powers: Floats) -> tuple[tuple[Floats, Floats], Floats]:
        """Return the terms with drawn factors, by equation and term, and the exponents of draws, (terms, draws)."""
        columns = np.argwhere(is_rate).tolist()
        parameters = {k: c for c, k in enumerate(self.terms.parameters)}
        is_one = (is_rate & self.terms.is_factor) | (~np.isnan(self.known) & (self.known != 0))
        rows, matrix = [], list[list[float]]()
        for j, k in np.argwhere(is_one).tolist():
            row = [powers[k, parameters[b]] if b in parameters else float((j, k) == (a, b)) for a, b in columns]
            if any(row):
                rows.append((j, k))
                matrix.append(row)
        indices = np.array(rows, dtype=int).reshape(-1, 2)
        return (indices[:, 0], indices[:, 1]), np.array(matrix).reshape(len(rows), len(columns))

    @cached_property
    def _duration(self) -> float:
        return float(np.mean([np.ptp(trial.times) for trial in self.trials]))

    @cached_property
    def _times(self) -> Floats:
        """The duration to the power of the order of each equation, shape (equations,)."""
        equations = len(self.known)
        orders = order_of_each(self.terms.variables.order_of(equations), equations)
        return self._duration ** np.array(orders, dtype=float)

    def whole(self, scales: Floats) -> Floats:
        """Return the sizes of all variables other than parameters, given scales of states, shape (variables,)."""
        rates = scales[with_rates(self.terms.variables.order_of(len(scales)), len(scales))] / self._duration
        inputs = np.sqrt(np.mean(np.concatenate([trial.inputs for trial in self.trials]) ** 2, axis=0))
        return np.concatenate([scales, rates, inputs, [self._duration]])

    def _sizes(self, scales: Floats, parameters: Floats) -> Floats:
        """Return the mean absolute value of each term for states uniform up to their scales, shape (terms,)."""
        whole = self.whole(scales)
        # Independently, so that differences of variables do not cancel
        values = whole * np.random.default_rng(0).uniform(size=(settings.GENERIC_POINTS, len(whole)))
        values = np.column_stack([values, np.broadcast_to(parameters, (len(values), len(parameters)))])
        with np.errstate(all="ignore"):
            return np.asarray(np.mean(np.abs(self.terms.evaluate(values)), axis=0))


Candidate = tuple[Estimate, list[Curve]]
"""A fit, and the curves of all states from which it started."""


@dataclass(frozen=True, eq=False)
class _Object:
    """An object: its model, trials and curves, masks of latent states and of those with free initial values.

    Guessed signs of coefficients have shape (equations, terms), zero without any.
    """

    model: TrajectoryModel
    group: Sequence[Trial]
    curves: Sequence[Curve]
    started: Bools
    free: Bools
    signs: Floats
    guesses: _Guesses

    @property
    def known(self) -> Floats:
        """Fixed coefficients, shape (equations, terms), NaN for free ones."""
        return self.guesses.known

    def fits(self, tried: Sequence[Draw]) -> list[Candidate]:
        """Return the fits from the draws of least gradient-matching residuals, with the curves of all states."""
        drawn = np.array([np.where(np.isnan(self.known), draw.coefficients, self.known) for draw in tried])
        starts = np.where(self.free, [draw.starts for draw in tried], np.nan)
        pairs = list(zip(self.group, self.curves, strict=True))
        followed = [_integrated(self.model.terms, *pair, drawn, starts, self.started) for pair in pairs]
        candidates = []
        for coefficients, *states in zip(drawn, *followed, strict=True):
            if all(np.isfinite(path).all() for path in states):
                filled = self._filled(states)
                candidates.append((*self._along(filled, coefficients), filled))
        best = sorted(candidates, key=lambda candidate: candidate[0])[: 2 * settings.MIN_DRAWS[0]]
        free, fits = np.isnan(self.known), list[Candidate]()
        for _, coefficients, filled in best:
            start = Estimate(tuple(interpolate([states for states, _ in filled])), coefficients)
            fits.append((fit(self.model, start, free, settings.LATENT_MODEL_ERRORS), filled))
        return [fit for fit in fits if np.isfinite(fit[0].objective)]

    def best(self, fits: Sequence[Candidate]) -> list[Candidate]:
        """Return the equally good best fits, those with guessed signs and fast latent states first."""
        least = min((fitted for fitted, _ in fits), key=lambda estimate: estimate.objective)

        def sort_key(fitted: Candidate) -> tuple[int, float]:
            coefficients = fitted[0].coefficients
            return -int(np.sum(coefficients * self.signs > 0)), -self.guesses.relative_speed(coefficients)

        return sorted((fit for fit in fits if self.is_equivalent(fit[0], least)), key=sort_key)

    def is_equivalent(self, estimate: Estimate, reference: Estimate) -> bool:
        """Return whether ``n log(D / D_ref)`` of the deviances D, with the noise profiled out, is indifferent."""
        count = sum(int(np.isfinite(trial.states).sum()) for trial in self.group)
        ratio = (estimate.objective + settings.ROUNDING) / (reference.objective + settings.ROUNDING)
        return bool(count * np.log(ratio) < settings.INDIFFERENT)

    def shot(self, coefficients: Floats) -> Candidate:
        """Return the least-squares fit of solutions near some coefficients (single shooting).

        It is slower than collocation, and fails on chaotic trajectories, but converges in narrow curved valleys of the
        likelihood, which latent states often have.
        """
        from scipy.optimize import least_squares

        measured = [path[0] for path, _ in self.curves]
        initial = np.where(self.started, [trial.states[0] for trial in self.group], measured)
        free, is_free = np.isnan(self.known), np.broadcast_to(~self.started, initial.shape)
        noise, everything = self.model.observation.noise, np.ones_like(self.started)
        sizes = np.concatenate([np.abs(coefficients[free]), np.maximum(np.abs(initial), noise)[is_free]])
        sizes = np.where(sizes > 0, sizes, 1.0)

        def solutions(parameters: Floats) -> tuple[list[Floats], Floats]:
            """Return states of each trial, and coefficients, at scaled parameters of shape (m, parameters)."""
            laws, starts = (np.tile(array, (len(parameters), 1, 1)) for array in (coefficients, initial))
            laws[:, free], starts[:, is_free] = np.split(parameters * sizes, [int(free.sum())], axis=1)
            rows = zip(self.group, self.curves, starts.swapaxes(0, 1), strict=True)
            terms = self.model.terms
            return [_integrated(terms, trial, curve, laws, initial, everything) for trial, curve, initial in rows], laws

        def residuals(parameters: Floats) -> Floats:
            with np.errstate(all="ignore"):
                parts = [
                    ((states - trial.states) / noise)[:, np.isfinite(trial.states) & ~self.started]
                    for states, trial in zip(solutions(parameters)[0], self.group, strict=True)
                ]
            return np.nan_to_num(np.concatenate(parts, axis=1), nan=np.inf, posinf=np.inf, neginf=np.inf)

        def residuals_at(parameters: Floats) -> Floats:
            return np.asarray(residuals(parameters[np.newaxis])[0])

        def slopes(parameters: Floats) -> Floats:
            steps = settings.ROUNDING * np.eye(len(parameters) + 1, len(parameters), -1)
            values = residuals(parameters + steps)
            return np.asarray(((values[1:] - values[0]) / settings.ROUNDING).T)

        x = np.concatenate([coefficients[free], initial[is_free]]) / sizes
        with np.errstate(over="ignore"):  # Far from any law
            squares = float(np.sum(residuals_at(x) ** 2))
            if np.isfinite(squares) and np.isfinite(slopes(x)).all():
                tolerance = max(settings.SAME_DEVIANCE / max(squares, 1.0), np.finfo(float).eps)
                solved = least_squares(residuals_at, x, slopes, ftol=tolerance)
                x, squares = solved.x, float(2 * solved.cost)
        states, laws = solutions(x[np.newaxis])
        start = Estimate(tuple(interpolate([path[0] for path in states])), laws[0])
        # The solution on the mesh differs by the discretization error
        converged = fit(self.model, start, np.zeros_like(free), (*settings.LATENT_MODEL_ERRORS, 0.001, 0.0003))
        return replace(converged, deviance=squares, objective=squares), self._filled([path[0] for path in states])

    def _filled(self, states: Sequence[Floats]) -> list[Curve]:
        pairs = zip(states, self.curves, strict=True)
        return [(path, np.where(self.started, 0.0, rates)) for path, (_, rates) in pairs]

    def _along(self, filled: list[Curve], coefficients: Floats) -> tuple[float, Floats]:
        """Return the sum of log mean squared gradient-matching residuals, and all coefficients."""
        curves = list(zip(self.group, filled, strict=True))
        completed = gradient_matching(self.model.terms, curves, coefficients)
        library, rates = terms_and_rates(self.model.terms, curves, completed)
        residuals = (rates - library @ completed.T)[:, ~self.started]
        with np.errstate(over="ignore"):  # Far from any law
            squares = np.mean(residuals**2, axis=0)
        return float(np.sum(np.log(squares + np.finfo(float).tiny))), completed


def _integrated(
    terms: Terms, trial: Trial, curve: Curve, coefficients: Floats, starts: Floats, solved: Bools
) -> Floats:
    """Return states of which some are integrated along a curve of the others (classical Runge-Kutta).

    The shape is (draws, n, states), for coefficients (draws, equations, terms) and initial values (draws, states), NaN
    where the trial gives them.
    """
    columns = np.flatnonzero(solved)
    parameters = np.nan_to_num(coefficients[:, :, list(terms.parameters)]).sum(axis=1)
    substeps = -(-settings.MAX_CURVE_POINTS // len(trial))
    known = curve[0].copy()
    known[:, columns] = 0.0
    rows = np.column_stack([known, trial.inputs, trial.times])
    (rows,) = interpolate([rows], 2 * substeps, len(trial))
    rows = terms.variables.natural(rows)
    values = np.empty((len(coefficients), rows.shape[1] + parameters.shape[1]))
    values[:, rows.shape[1] :], equations = parameters, coefficients[:, solved]
    chosen = np.flatnonzero(equations.any(axis=(0, 1)))
    equations, terms = equations[:, :, chosen], terms.take(chosen.tolist())

    path = [np.where(np.isnan(starts), trial.states[0], starts)[:, columns]]
    with np.errstate(all="ignore"):
        for i in range(0, len(rows) - 1, 2):

            def rates(z: Floats, share: float, i: int = i) -> Floats:
                values[:, : rows.shape[1]] = rows[i + round(2 * share)]
                values[:, columns] = z
                return np.asarray((equations @ terms.evaluate(values)[:, :, np.newaxis])[:, :, 0])

            path.append(runge_kutta_step(rates, path[-1], rows[i + 2, -1] - rows[i, -1]))
    states = np.tile(curve[0], (len(coefficients), 1, 1))
    states[:, :, columns] = np.stack(path[::substeps], axis=1)
    return states
