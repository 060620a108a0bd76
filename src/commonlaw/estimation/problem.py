"""The likelihood of a model's parameters and initial values, with its derivatives."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.differentiation.noise import rounding_noise, within_trial_std
from commonlaw.estimation.model import Model
from commonlaw.formulation import symmetric_root
from commonlaw.integration.shooting import MAX_STEPS, NO_INPUTS, DelayedInputs, Solution, shoot
from commonlaw.integration.vector_field import Inputs
from commonlaw.library.grammar import columns_in
from commonlaw.likelihood import WHITE_NOISE, ErrorModel, NoiseByGroup, by_group, omitted_by_group
from commonlaw.likelihood.levels import Deviations, LinearizedFit
from commonlaw.likelihood.mesh import MIN_NOISE
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Trial
from commonlaw.trials.transformations import known_inputs, starts_by
from commonlaw.trials.trial import replication


@dataclass(frozen=True, eq=False)
class TrialData:
    """One trial as the likelihood takes it.

    Parameters
    ----------
    trial
        What was measured; logarithms of `logarithmic` quantities.
    times
        Where solutions are wanted, from the initial time on, shape (n,), and the row of each sample in them.
    parameter
        The index of each parameter among the unknowns, or -1 for one that is known, and `values` what it is then.
    initial
        The index of each initial value among the unknowns, or -1 for one that is a number, in `fixed`, or else follows
        from the parameters, shape (D,).
    cycle
        The period after which the solution returns to its initial values, which follow from this; 0 without one.
    fitted
        Observables of an earlier fit at the samples, about which errors hold, shape (n, m); None before there is one.
    weights
        Of white noise about these, see `Deviations.reweighted`; None for equal ones.
    omitted
        Which measurements are left out, shape (n, m); None for none.
    """

    trial: Trial
    times: Floats
    rows: Indices
    inputs: DelayedInputs
    parameter: Indices
    values: Floats
    initial: Indices
    fixed: Floats
    cycle: float = 0.0
    fitted: Floats | None = None
    weights: Floats | None = None
    omitted: Bools | None = None

    @classmethod
    def of(
        cls,
        trial: Trial,
        model: Model,
        start: float | None,
        parameter: Sequence[int],
        values: Sequence[float],
        initial: Sequence[int],
    ) -> "TrialData":
        """Return a trial whose solution begins at a time, by default that of its first sample; refused if it is later.

        Inputs are those before the first sample, too.
        """
        times = trial.times
        if start is not None and trial.cycle == 0 and not starts_by(trial, start):
            times = np.append(start, times)
        inputs = NO_INPUTS
        if trial.inputs.shape[1]:
            undelayed = Inputs.of(*known_inputs(trial), model.schema.input_interpolation)
            inputs = DelayedInputs(undelayed, model.column, model.delay)
        indices, free = (np.array(numbers, dtype=np.int64) for numbers in (parameter, initial))
        rows, fixed = np.searchsorted(times, trial.times), model.initial_of(trial)
        return cls(trial, times, rows, inputs, indices, np.array(values), free, fixed, trial.cycle)

    def seen(self, rows: Bools | slice) -> "TrialData":
        """Return the trial with some of its samples, the inputs being those of all of them."""
        fitted, weights = (None if values is None else values[rows] for values in (self.fitted, self.weights))
        return replace(self, trial=self.trial.rows(rows), rows=self.rows[rows], fitted=fitted, weights=weights)

    def parameters(self, unknowns: Floats) -> Floats:
        """Return the values of all parameters."""
        return np.where(self.parameter < 0, self.values, np.append(unknowns, np.nan)[self.parameter])


class Predicted(NamedTuple):
    """Observables at the samples of a trial, shape (n, m), their derivatives by the unknowns, and the solution.

    A solution is endless as in `commonlaw.integration.shooting.Solution`.
    """

    values: Floats
    slopes: Floats | None
    states: Floats
    is_endless: bool


class _Standardized(NamedTuple):
    """A trial with its measurements about its solution, and which of them are seen, or under a limit, shape (n, m).

    Where they are, z is ``(h - y) / sigma`` and u is ``(L - h) / sigma``; h / sigma has the derivatives `by`, shape
    (n, m, p). Beyond the threshold z counts by the Huber loss; it is infinite where weights stand for that. The rest of
    minus twice the log-likelihood beyond the losses of z is the `deviance`.
    """

    trial: Trial
    seen: Bools
    under: Bools
    z: Floats
    u: Floats
    by: Floats | None
    deviance: float
    threshold: float


@dataclass(frozen=True, eq=False)
class NormalPrior:
    """Unknowns, by index, that are jointly normal: ``root (p - mean)`` is standard normal, root of shape (k, k)."""

    indices: Indices
    mean: Floats
    root: Floats

    @classmethod
    def of(cls, index: int, mean: float, std: float) -> "NormalPrior":
        """Return the prior of one unknown."""
        return cls(np.array([index]), np.array([mean]), np.array([[1 / std]]))

    @classmethod
    def joint(cls, indices: Sequence[int], mean: Floats, covariance: Floats, least: float = 1e-6) -> "NormalPrior":
        """Return the prior of some unknowns; what the covariance fixes has the least standard deviation, in its size.

        The prior then keeps it to rounding.
        """
        sizes = np.sqrt(np.diagonal(covariance)) + np.abs(mean) * least
        sizes = np.where(sizes > 0, sizes, 1.0)
        values, vectors = np.linalg.eigh(covariance / sizes / sizes[:, np.newaxis])
        root = (vectors / np.sqrt(np.maximum(values, least**2))).T / sizes
        return cls(np.array(indices, dtype=np.int64), mean, root)

    def residuals(self, unknowns: Floats) -> Floats:
        """Return what is standard normal beforehand, shape (k,)."""
        return np.asarray(self.root @ (unknowns[self.indices] - self.mean))


@dataclass(frozen=True, eq=False)
class Problem:
    """A model and its trials.

    Parameters
    ----------
    unknowns
        How many unknown numbers there are, p.
    logarithmic
        Which observables are measured by their logarithms, shape (m,).
    sizes
        How large states and rates get, shape (D,).
    priors
        Of unknowns, no two of the same one.
    tolerance, max_steps
        Relative error of a step of a solution, and how many there may be.
    errors
        Errors of measurements besides white noise; with these the noise is held. They hold in trials that are about
        values of an earlier fit, see `about`.
    huber_threshold
        Standardized residual c beyond which a measurement counts by ``2 c |z| - c^2`` instead of the square (Huber
        1964), under errors the white noise in it. These outliers are left out of estimates of the noise, unless most
        measurements of a quantity are.
    rejects
        Whether outliers count by ``c^2``, as one at the threshold, and have no weight.
    """

    model: Model
    trials: tuple[TrialData, ...]
    unknowns: int
    logarithmic: Bools
    sizes: Floats
    priors: tuple[NormalPrior, ...]
    tolerance: float = 1e-8
    max_steps: int = MAX_STEPS
    errors: ErrorModel = WHITE_NOISE
    huber_threshold: float = np.inf
    rejects: bool = False
    _last: dict[TrialData, tuple[Floats, Predicted]] = field(default_factory=dict, init=False, repr=False)
    """The unknowns that each trial was predicted by last, and what they predict, as residuals, noise and slopes ask."""

    def apart(self) -> list[tuple[Indices, "Problem"]]:
        """Return the problems of trials that have no unknowns in common, each with the indices of its unknowns."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        blocks = [
            *(np.append(data.parameter, data.initial) for data in self.trials),
            *(prior.indices for prior in self.priors),
        ]
        rows = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
        columns = np.concatenate(blocks)
        joined, total = columns >= 0, len(blocks) + self.unknowns
        pairs = rows[joined], columns[joined] + len(blocks)
        labels = connected_components(coo_array((np.ones(joined.sum()), pairs), (total, total)), directed=False)[1]
        groups = [np.flatnonzero(labels[len(blocks) :] == label) for label in np.unique(labels[len(blocks) :])]
        if len(groups) < 2:
            return [(np.arange(self.unknowns), self)]
        parts = list[tuple[Indices, Problem]]()
        for group in groups:
            index = np.full(self.unknowns + 1, -1)  # The last one is that of what is known
            index[group] = np.arange(len(group))
            label, ends = labels[len(blocks) + group[0]], labels[: len(blocks)]
            trials = tuple(
                replace(data, parameter=index[data.parameter], initial=index[data.initial])
                for data, end in zip(self.trials, ends[: len(self.trials)], strict=True)
                if end == label
            )
            priors = tuple(
                replace(prior, indices=index[prior.indices])
                for prior, end in zip(self.priors, ends[len(self.trials) :], strict=True)
                if end == label
            )
            parts.append((group, replace(self, trials=trials, unknowns=len(group), priors=priors)))
        return parts

    def predicted(self, data: TrialData, unknowns: Floats, slopes: bool = True) -> Predicted:
        """Return what a trial should be."""
        if data in self._last:
            last, known = self._last[data]
            if np.array_equal(last, unknowns) and not (slopes and known.slopes is None):
                return known if slopes else known._replace(slopes=None)
        result = self._solved(data, unknowns, slopes)
        self._last[data] = unknowns.copy(), result
        return result

    def _solved(self, data: TrialData, unknowns: Floats, slopes: bool) -> Predicted:
        model, parameters, first = self.model, data.parameters(unknowns), self.model.first_parameter
        width, count = model.width, len(parameters)
        initial, start_by = self.initial(data, unknowns, slopes)
        if np.isfinite(initial).all() and np.isfinite(parameters).all():
            solution = shoot(
                model.switched,
                parameters,
                initial,
                data.times,
                self.sizes,
                data.inputs,
                derivatives=slopes,
                tolerance=self.tolerance,
                max_steps=self.max_steps,
            )
        else:
            shape = len(data.times), width
            wide = np.full((*shape, count + width), np.nan) if slopes else None
            solution = Solution(np.full(shape, np.nan), wide)
        states = solution.states[data.rows]
        times, measured = data.times[data.rows], model.measured_states
        if measured is None:
            point = model.point(states, data.inputs.at(times, parameters), times, parameters)
        values = model.outputs.evaluate(point) if measured is None else states[:, measured]
        shown = values
        if self.logarithmic.any():
            with np.errstate(all="ignore"):
                shown = np.where(self.logarithmic, np.log(np.where(self.logarithmic, values, 1.0)), values)
        if solution.derivatives is None:
            return Predicted(shown, None, states, solution.is_endless)
        by = solution.derivatives[data.rows]
        assert start_by is not None
        with np.errstate(invalid="ignore"):  # Of the logarithm of zero, where nothing was measured
            if measured is None:
                outer = model.outputs.jacobian(point)
                by = outer[:, :, :width] @ by
                by[:, :, :count] += outer[:, :, first : first + count]
            else:
                by = by[:, measured]
            by_start = by[:, :, count:] @ start_by
            by_start[:, :, :count] += by[:, :, :count]
        by_unknowns, indices = np.zeros((*values.shape, self.unknowns)), np.append(data.parameter, data.initial)
        by_unknowns[:, :, indices[indices >= 0]] = by_start[:, :, indices >= 0]
        with np.errstate(all="ignore"):
            by_unknowns /= np.where(self.logarithmic, values, 1.0)[:, :, np.newaxis]
        return Predicted(shown, by_unknowns, states, solution.is_endless)

    def initial(self, data: TrialData, unknowns: Floats, slopes: bool = True) -> tuple[Floats, Floats | None]:
        """Return the initial values of a trial, shape (D,), and their derivatives by its parameters and by these."""
        model, parameters, first = self.model, data.parameters(unknowns), self.model.first_parameter
        width, count = model.width, len(parameters)
        initial = np.where(data.initial < 0, data.fixed, np.append(unknowns, np.nan)[data.initial])
        follows, start_by = (data.initial < 0) & np.isnan(data.fixed), None
        if slopes and not follows.any():
            start_by = np.eye(width, count + width, count)
        elif follows.any():
            unit = self.starting_point(data, parameters)
            initial = np.where(follows, model.starts.evaluate(unit)[0], initial)
            start_by = np.hstack([model.starts.jacobian(unit)[0][:, first:], np.eye(width)]) if slopes else None
        if model.steady:
            initial, start_by = self._steady(data, parameters, initial, start_by)
        if data.cycle:
            initial, start_by = self._periodic(data, parameters)
        return initial, start_by

    def starting_point(self, data: TrialData, parameters: Floats) -> Floats:
        """Return the variables at the beginning of a trial, of which written initial values are functions."""
        model, times = self.model, data.times[:1]
        inputs = data.inputs.at(times, parameters) if model.starting_inputs else np.zeros((1, len(model.column)))
        return model.point(np.zeros((1, model.width)), inputs, times, parameters)

    def _steady(
        self, data: TrialData, parameters: Floats, initial: Floats, by: Floats | None
    ) -> tuple[Floats, Floats | None]:
        """Return initial values with those of the steady state, and their derivatives by parameters and others.

        The rates of these states are zero, the others being as they are; the way there is that of time steps which grow
        as the rates fall (Kelley and Keyes 1998, SIAM J. Numer. Anal. 35, 508), from the sizes of the states.
        """
        model, steady, sizes = self.model, list(self.model.steady), self.sizes[list(self.model.steady)]
        times, inputs = data.times[:1], data.inputs.at(data.times[:1], parameters)
        unit, given = model.point(np.zeros((1, model.width)), 0 * inputs, times, parameters), list(model.steady_inputs)
        inputs[0, given] = model.before.evaluate(unit)[0, given]
        result = initial.copy()
        result[steady] = sizes
        step, last = np.inf, np.inf
        with np.errstate(all="ignore"):
            for _ in range(200):
                point = model.point(result[np.newaxis], inputs, times, parameters)
                rates, jacobian = model.rates.evaluate(point)[0, steady], model.rates.jacobian(point)[0, steady]
                speed = float(np.max(np.abs(rates) / sizes)) or np.finfo(np.float64).tiny
                step, last = step * min(10.0, max(last / speed, 0.1)) if np.isfinite(step) else 1 / speed, speed
                try:
                    change = np.linalg.solve(np.eye(len(steady)) / step - jacobian[:, steady], rates)
                except np.linalg.LinAlgError:
                    break
                result[steady] += change
                if np.max(np.abs(change) / (np.abs(result[steady]) + sizes)) < 1e-9:
                    if np.linalg.matrix_rank(jacobian[:, steady] * sizes) < len(steady):
                        break  # It is one of many
                    return result, by if by is None else self._steady_by(jacobian, by, unit)
        return np.full_like(result, np.nan), by

    def _periodic(self, data: TrialData, parameters: Floats) -> tuple[Floats, Floats]:
        """Return initial values x to which solutions return after a cycle, and their derivatives by parameters p.

        With the states F(x, p) after a cycle, Newton's method solves ``x = F``, and
        ``dx/dp = inv(I - F_x) F_p`` (Nayfeh and Balachandran 1995, section 6.4). NaN where eigenvalues of F_x are not
        within the unit circle, as no repetition leads there.
        """
        count, width = len(parameters), self.model.width
        result, by = np.zeros(width), np.zeros((width, count + width))
        times = data.times[0] + np.array([0.0, data.cycle])
        for _ in range(50):
            solution = shoot(
                self.model.switched, parameters, result, times, self.sizes, data.inputs, tolerance=self.tolerance
            )
            assert solution.derivatives is not None
            slopes = solution.derivatives[-1]
            if not np.isfinite(slopes).all():
                break
            try:
                inverse = np.linalg.inv(np.eye(width) - slopes[:, count:])
            except np.linalg.LinAlgError:
                break
            change = inverse @ (solution.states[-1] - result)
            result = result + change
            by[:, :count] = inverse @ slopes[:, :count]
            if np.max(np.abs(change) / (np.abs(result) + self.sizes)) < 1e-7:
                if np.abs(np.linalg.eigvals(slopes[:, count:])).max() < 1:
                    return result, by
                break
        return np.full(width, np.nan), by

    def _steady_by(self, jacobian: Floats, by: Floats, unit: Floats) -> Floats:
        """Return derivatives of initial values with those of the steady state: 0 = f(x, y, u, p), y being the others.

        dx/dp = -inv(f_x) (f_p + f_u du/dp + f_y dy/dp); `jacobian` has the derivatives of f by all variables.
        """
        model, steady, result = self.model, list(self.model.steady), by.copy()
        count, first, given = len(model.parameters), model.first_parameter, list(model.steady_inputs)
        others = np.delete(np.arange(model.width), steady)
        right = jacobian[:, others] @ by[others]
        right[:, :count] += jacobian[:, first : first + count]
        columns = model.width + np.array(given, dtype=np.int64)
        right[:, :count] += jacobian[:, columns] @ model.before.jacobian(unit)[0, given, first : first + count]
        result[steady] = -np.linalg.solve(jacobian[:, steady], right)
        return result

    @cached_property
    def events_move(self) -> bool:
        """Whether the time of an event depends on more than numbers."""
        time = self.model.first_parameter - 1
        return any(set(columns_in(condition)) - {time} for condition, _ in self.model.events)

    @cached_property
    def event_ranges(self) -> dict[int, tuple[float, float]]:
        """The unknown times of events and thresholds of measured states, by index, and what trials cover of them.

        They are tau in ``t > tau`` and h in ``x > h``.
        """
        first, ranges = self.model.first_parameter, dict[int, tuple[float, float]]()
        for columns in (sorted(columns_in(condition)) for condition, _ in self.model.events):
            if len(columns) != 2 or columns[0] >= first or columns[1] < first:
                continue
            name = self.model.variables.names[columns[0]]
            for data in self.trials:
                seen = data.times[[0, -1]]
                if name in self.model.observables and name not in self.model.text.observed:
                    k = self.model.observables.index(name)
                    seen = data.trial.states[:, k]
                    seen = np.exp(seen) if self.logarithmic[k] else seen
                elif columns[0] < first - 1:
                    continue
                index, (low, high) = int(data.parameter[columns[1] - first]), (np.nanmin(seen), np.nanmax(seen))
                before = ranges.get(index, (low, high))
                ranges[index] = float(min(low, before[0])), float(max(high, before[1]))
        return {index: covered for index, covered in ranges.items() if index >= 0}

    @cached_property
    def event_unknowns(self) -> list[int]:
        """The unknowns in conditions of events and in what these change, by index."""
        first, texts = (
            self.model.first_parameter,
            (text for event in self.model.events for text in (event[0], *event[1])),
        )
        columns = {column - first for text in texts for column in columns_in(text) if column >= first}
        return sorted({int(trial.parameter[i]) for trial in self.trials for i in columns} - {-1})

    @cached_property
    def known_noise(self) -> Bools:
        """Of which observables standard deviations are known, shape (m,)."""
        return np.asarray(np.any([trial.trial.known_noise for trial in self.trials], axis=0))

    @cached_property
    def counts(self) -> Floats:
        """How many measurements of each observable there are, shape (m,)."""
        return np.asarray(sum(trial.trial.counts.sum(axis=0) for trial in self.trials))

    @cached_property
    def censored(self) -> Bools:
        """Which observables have censored measurements, shape (m,)."""
        return np.asarray(np.any([np.isfinite(trial.trial.below).any(axis=0) for trial in self.trials], axis=0))

    def about(self, unknowns: Floats, noise: Floats, errors: ErrorModel) -> "Problem":
        """Return the problem under other errors than white noise, evaluated at what the trials are at unknowns."""
        trials = list[TrialData]()
        for data in self.trials:
            values = self.predicted(data, unknowns, False).values
            none_omitted = np.zeros(values.shape, dtype=np.bool_)
            deviations = Deviations(data.trial, values, None, values, none_omitted, data.weights)
            weights = deviations.reweighted(noise, errors, self.huber_threshold, rejects=self.rejects).weights
            trials.append(replace(data, fitted=values, weights=weights))
        return replace(self, trials=tuple(trials), errors=errors)

    def linearized(self, unknowns: Floats, noise: Floats, free: Bools) -> LinearizedFit:
        """Return measurements, and priors, about what the trials are at unknowns, of which some are free.

        Outliers under the noise are left out.
        """
        trials = list[Deviations]()
        for data, far in zip(self.trials, self.outliers(unknowns, noise), strict=True):
            values, slopes, *_ = self.predicted(data, unknowns)
            slopes = None if slopes is None else slopes[:, :, free]
            trials.append(Deviations(data.trial, values, slopes, values, far))
        residuals = [np.zeros(0), *(prior.residuals(unknowns) for prior in self.priors)]
        unit = np.eye(self.unknowns)[:, free]
        rows = [prior.root @ unit[prior.indices] for prior in self.priors]
        rows = [np.zeros((0, int(free.sum()))), *rows]
        return LinearizedFit(trials, (np.concatenate(residuals), np.concatenate(rows)))

    def standardized(self, unknowns: Floats, noise: Floats, slopes: bool) -> "Iterator[_Standardized]":
        """Yield the residuals of each trial."""
        for data in self.trials:
            predicted, trial = self.predicted(data, unknowns, slopes), data.trial
            values, is_first = predicted.values, data.fitted is None
            reference = values if data.fitted is None else data.fitted
            omitted = np.zeros(values.shape, dtype=np.bool_) if data.omitted is None else data.omitted
            deviations = Deviations(trial, values, predicted.slopes, reference, omitted, data.weights)
            seen = deviations.seen
            whitened = deviations.whitened(noise, WHITE_NOISE if is_first else self.errors)
            under, deviance = np.isfinite(trial.below), deviations.deviance(whitened)
            u = (trial.below - values) / whitened.std
            threshold = self.huber_threshold if data.weights is None else np.inf
            if data.weights is not None and np.isfinite(self.huber_threshold):  # The loss beyond the weighted squares
                beyond = data.weights[seen] < 1 if self.rejects else 1 / data.weights[seen] - 1
                deviance += self.huber_threshold**2 * float(np.sum(beyond))
            yield _Standardized(trial, seen, under, whitened.z, u, whitened.slopes, deviance, threshold)

    def residuals(self, unknowns: Floats, noise: Floats, slopes: bool = True) -> tuple[Floats, Floats | None]:
        """Return standardized residuals, shape (r,), and their derivatives, shape (r, p).

        A measurement is ``z = (h - y) / sigma``, for an outlier the root of its loss; one below a limit L is
        ``sqrt(-2 log Phi((L - h) / sigma))``, so that half the sum of squares is the negative log-likelihood but for
        its constants; a prior is ``(p - mean) / std``.
        """
        parts, rows = list[Floats](), list[Floats]()
        for _, seen, under, z, u, by, _, threshold in self.standardized(unknowns, noise, slopes):
            root = np.sqrt(np.maximum(-2 * log_ndtr(u[under]), np.finfo(np.float64).tiny))
            loss, slope = self._loss(z[seen], threshold)
            parts += [loss, root]
            if by is not None:
                rows += [by[seen] * slope[:, np.newaxis], by[under] * (_mills(u[under]) / root)[:, np.newaxis]]
        for prior in self.priors:
            parts.append(prior.residuals(unknowns))
            rows.append(prior.root @ np.eye(self.unknowns)[prior.indices])
        return np.concatenate(parts), np.concatenate(rows) if slopes else None

    def _loss(self, z: Floats, threshold: float) -> tuple[Floats, Floats]:
        """Return the roots of the losses of standardized residuals, with the sign of these, and their derivatives."""
        if self.rejects:
            return np.clip(z, -threshold, threshold), np.where(np.abs(z) > threshold, 0.0, 1.0)
        loss, slope, far = z.copy(), np.ones_like(z), np.abs(z) > threshold
        loss[far] = np.sqrt(2 * threshold * np.abs(z[far]) - threshold**2)
        slope[far] = threshold / loss[far]
        loss[far] *= np.sign(z[far])
        return loss, slope

    def outliers(self, unknowns: Floats, noise: Floats) -> list[Bools]:
        """Return which measurements of each trial are outliers, shape (n, m), unless most of a quantity are."""
        if not np.isfinite(self.huber_threshold):
            return [np.zeros(data.trial.states.shape, dtype=np.bool_) for data in self.trials]
        parts = zip(self.trials, self.standardized(unknowns, noise, False), strict=True)
        far = [
            np.abs(part.z) > self.huber_threshold if data.weights is None else part.seen & (data.weights < 1)
            for data, part in parts
        ]
        measured = np.sum([np.isfinite(data.trial.states).sum(axis=0) for data in self.trials], axis=0)
        rare = 2 * np.sum([outlying.sum(axis=0) for outlying in far], axis=0) < measured
        return [outlying & rare for outlying in far]

    def information(self, unknowns: Floats, noise: Floats) -> Floats:
        """Return rows R whose product R'R is the information of the unknowns, shape (r, p).

        They are the derivatives of the residuals, zero where these are not finite, as of 0^p by p; outliers have the
        weights ``c / |z|``, or none if they are rejected. Where values are below limits they count, with
        u = (L - h) / sigma and m = phi(u) / Phi(u), by m (m + u), the curvature of their tail, and log sigma, on which
        estimates then depend, is eliminated.
        """
        if not self.censored.any():
            return self._weighted(unknowns, noise)
        count, quantities = self.unknowns, len(noise)
        total, mixed, by_noise = np.zeros((count, count)), np.zeros((quantities, count)), np.zeros(quantities)
        for trial, measured, limited, residuals, tails, by, *_ in self.standardized(unknowns, noise, True):
            assert by is not None
            for k in range(quantities):
                seen, under = measured[:, k], limited[:, k]
                z, g = residuals[seen, k], by[seen, k]
                u, h = tails[under, k], by[under, k]
                m = _mills(u)
                total += g.T @ g + (h.T * (m * (m + u))) @ h
                mixed[k] += (m * (m + u) * u - m) @ h - 2 * z @ g
                by_noise[k] += 2 * z @ z + np.sum(m * (m + u) * u**2 - m * u)
                if trial.repeats is not None:
                    by_noise[k] += 2 * float((trial.repeats.squares[seen, k] / noise[k] ** 2).sum())
        for prior in self.priors:
            total[np.ix_(prior.indices, prior.indices)] += prior.root.T @ prior.root
        for k in np.flatnonzero(self.censored & ~self.known_noise).tolist():
            total -= np.outer(mixed[k], mixed[k]) / by_noise[k]
        return symmetric_root(total).T

    def _weighted(self, unknowns: Floats, noise: Floats) -> Floats:
        """Return derivatives of the residuals, zero where not finite, outliers with the root of their weight."""
        _, rows = self.residuals(unknowns, noise)
        assert rows is not None
        rows = np.where(np.isfinite(rows), rows, 0.0)
        if np.isfinite(self.huber_threshold) and not self.rejects:
            parts = list[Floats]()
            for _, seen, under, z, *_, threshold in self.standardized(unknowns, noise, False):
                size = np.abs(z[seen]) / threshold
                parts += [np.where(size > 1, np.sqrt(2 - 1 / np.maximum(size, 1.0)), 1.0), np.ones(under.sum())]
            weights = np.concatenate(parts)
            rows[: len(weights)] *= weights[:, np.newaxis]
        return rows

    def leverage(self, unknowns: Floats, noise: Floats, free: Bools) -> Floats:
        """Return the trace of the hat matrix of the free unknowns over measurements of each trial, shape (trials, m).

        With the rows X of the derivatives of standardized residuals, priors among them, it is
        ``sum_i x_i' (X'X)^-1 x_i`` over the rows i of an observable.
        """
        rows, quantities = self._weighted(unknowns, noise), len(noise)
        pairs = [(np.isfinite(data.trial.states), np.isfinite(data.trial.below)) for data in self.trials]
        columns = np.concatenate(
            [quantities * i + np.nonzero(kind)[1] for i, pair in enumerate(pairs) for kind in pair]
        )
        rows = rows[:, free]
        scales = np.linalg.norm(rows, axis=0)
        basis, sizes, _ = np.linalg.svd(rows / np.where(scales > 0, scales, 1.0), full_matrices=False)
        basis = basis[: len(columns), sizes > np.finfo(float).eps * len(rows) * sizes.max(initial=0.0)]
        traces = np.bincount(columns, np.sum(basis**2, axis=1), minlength=quantities * len(self.trials))
        return np.asarray(traces, dtype=np.float64).reshape(len(self.trials), quantities)

    def noise_by_group(
        self, kind: ErrorKind, unknowns: Floats, noise: Floats, free: Bools, restricted: bool = True
    ) -> NoiseByGroup:
        """Return the residuals of each group of a kind of noise, see `commonlaw.likelihood.NoiseByGroup`.

        Residuals that are outliers by the median size of those of their group, too, are left out. Without the
        restricted likelihood no degrees of freedom are used up.
        """
        used = self.leverage(unknowns, noise, free) * restricted
        groups = by_group(kind).groups(data.trial for data in self.trials)
        squares, freedom, counts, floors = np.zeros((4, int(groups.max()) + 1, len(noise)))
        whitened = list[Floats]()
        for data, part in zip(self.trials, self.standardized(unknowns, noise, False), strict=True):
            z = part.z if data.weights is None else part.z / np.sqrt(data.weights)
            whitened.append(np.where(part.seen, z, np.nan))
        for k in range(len(squares)):
            rows = np.flatnonzero(groups == k)
            trials = [self.trials[i].trial for i in rows]
            sizes = np.concatenate([whitened[i] for i in rows])
            kept = np.isfinite(sizes) & ~omitted_by_group(sizes, self.huber_threshold)
            squares[k] = np.where(kept, sizes**2, 0.0).sum(axis=0) * self.errors.noise_of_trial(trials[0], noise) ** 2
            freedom[k] = kept.sum(axis=0) - used[rows].sum(axis=0)
            for _, known in replication(trials):
                squares[k] += known.squares
                freedom[k] += known.freedom
                counts[k] += known.counts
            floors[k] = np.maximum(MIN_NOISE * within_trial_std(trials), rounding_noise(trials))
        return NoiseByGroup(squares, freedom, counts, floors)

    @property
    def scatters(self) -> Bools:
        """Of which observables the noise differs between objects, or trials, shape (m,)."""
        trials, ones = [data.trial for data in self.trials], np.ones(len(self.logarithmic))
        return np.asarray(np.any([self.errors.noise_of_trial(trial, ones) != 1 for trial in trials], axis=0))

    def restricted_noise(self, unknowns: Floats, noise: Floats, free: Bools) -> tuple[Floats, Floats]:
        """Return the noise of restricted maximum likelihood and its degrees of freedom, shape (m,) each.

        ``s_k^2 = S_k / nu_k`` with the residual sum of squares S_k and ``nu_k = n_k - tr H_k`` of n_k measurements, see
        `leverage`, of which those below limits do not count (Patterson and Thompson 1971). An observable with less than
        one degree of freedom has the scale of all, and those of all. Known noise stays, with infinite ones.
        """
        unknown, freedom = ~self.known_noise, np.full(len(noise), np.inf)
        for _ in range(20):
            used = self.leverage(unknowns, noise, free).sum(axis=0)
            levels, before = self.noise_levels(unknowns, noise, used), freedom
            noise = np.where(levels > 0, levels, noise)  # Without residuals, the leverage is that at any noise
            outlying = np.sum([far.sum(axis=0) for far in self.outliers(unknowns, noise)], axis=0)
            freedom = np.where(unknown, self.counts - used - outlying, np.inf)
            if np.allclose(freedom, before, rtol=1e-6):
                break
        if self.scatters.any():
            residuals = self.noise_by_group(self.errors.grouping, unknowns, noise, free)
            freedom = np.where(unknown, residuals.degrees_of_freedom(self.scatters), np.inf)
        total = max(round(float(freedom[unknown].sum()), 6), 1.0)
        return noise, np.where(freedom < 1, total, freedom)

    def noise_levels(self, unknowns: Floats, noise: Floats, used: Floats | None = None) -> Floats:
        """Return the standard deviation of each observable that fits best, given the last one, shape (m,).

        Those that are known stay, and all do under other errors than white noise. `used` has the measurements of each
        observable to be counted off, shape (m,), see `restricted_noise`; without it the likelihood is largest.
        """
        if self.errors:
            return noise
        result, squares = noise.copy(), np.zeros(len(noise))
        tails, counts = list[tuple[Floats, Floats]](), self.counts if used is None else self.counts - used
        for data, far in zip(self.trials, self.outliers(unknowns, noise), strict=True):
            trial, values = data.trial, self.predicted(data, unknowns, False).values
            seen, counts = np.isfinite(trial.states) & ~far, counts - far.sum(axis=0)
            squares += np.where(seen, (values - trial.states) ** 2 * trial.counts, 0.0).sum(axis=0)
            if trial.repeats is not None:
                squares += np.where(np.isfinite(trial.states), trial.repeats.squares, 0.0).sum(axis=0)
            tails.append((trial.below, values))
        unknown = ~self.known_noise
        total = max(float(counts[unknown].sum()), 0.1)
        common = float(np.sum(squares[unknown] / noise[unknown] / noise[unknown])) / total
        for k in np.flatnonzero(unknown & (self.counts > 0)):
            result[k] = np.sqrt(squares[k] / counts[k]) if counts[k] >= 1 else noise[k] * np.sqrt(common)
            if self.censored[k]:
                result[k] = _with_tails(squares[k], counts[k], [(a[:, k], b[:, k]) for a, b in tails], result[k])
        return result

    def log_likelihood(self, unknowns: Floats, noise: Floats) -> float:
        """Return the log-likelihood of the measurements, without priors."""
        total = 0.0
        for _, seen, _, z, _, _, deviance, threshold in self.standardized(unknowns, noise, False):
            loss, _ = self._loss(z[seen], threshold)
            total -= 0.5 * (float(loss @ loss) + deviance)
        return float(total - 0.5 * self.counts.sum() * np.log(2 * np.pi))


def _mills(u: Floats) -> Floats:
    """Return ``phi(u) / Phi(u)``, the inverse Mills ratio."""
    return np.asarray(np.exp(-u * u / 2 - log_ndtr(u)) / np.sqrt(2 * np.pi))


def _with_tails(squares: float, count: float, tails: Sequence[tuple[Floats, Floats]], first: float) -> float:
    """Return the standard deviation of largest likelihood where some measurements are below limits."""
    from scipy.optimize import minimize_scalar

    limits = np.concatenate([below[np.isfinite(below)] for below, _ in tails])
    values = np.concatenate([value[np.isfinite(below)] for below, value in tails])

    def deviance(log_std: float) -> float:
        std = np.exp(log_std)
        return float(squares / std**2 / 2 + count * log_std - log_ndtr((limits - values) / std).sum())

    middle = np.log(first) if first > 0 else 0.0
    return float(np.exp(minimize_scalar(deviance, bounds=(middle - 3, middle + 3), method="bounded").x))
