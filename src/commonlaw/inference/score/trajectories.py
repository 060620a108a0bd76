"""The score of a law that was fitted by shooting: that of collocation, from the rows of its fit.

With standardized residuals r and their slopes by the unknowns, minus twice the log-evidence is, by Laplace's method,

    sum log sigma^2 + log det S + (starts) + D(R) + k (log n + log m) + C + ...

with the information S on initial values of what was measured, see `start_variances`. D, k (log n + log m) and C
are those of `evidence`, for the coefficients of m objects, or for parameters where coefficients do not determine these.
Other unknowns have unit information: log n_j with the number n_j of measurements that depend on one (Pauler 1998,
Biometrika 85, 13). Unknowns with normal priors are integrated out: ``sum ((p - m)/s)^2 + log s^2 - log det V``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation.noise import rounding_noise, within_trial_std
from commonlaw.estimation.fitting import Fitted
from commonlaw.estimation.problem import TrialData
from commonlaw.inference import settings
from commonlaw.inference.data.noise import estimated_noise, has_replicates, noise_floor
from commonlaw.inference.data.smoothing import smooth_curves, start_variances
from commonlaw.inference.score.evidence import (
    NoisePrior,
    NoiseScale,
    coefficient_penalty,
    minus_twice_log_evidence,
    residual_squares,
)
from commonlaw.inference.score.misfit import FittedResiduals
from commonlaw.inference.score.score import Part, Score
from commonlaw.inference.score.supports import random_effect_factors
from commonlaw.law.parse import GivenEquations, read_equations
from commonlaw.library import Terms, with_rates
from commonlaw.library.grammar import columns_in
from commonlaw.likelihood.levels import Deviations, Whitened, scales_of
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import property_names, replication, with_typical


class Rows(NamedTuple):
    """The likelihood of an object's trials, linearized about a fit, by standardized residuals.

    Columns are slopes by initial values with a vague prior, by other unknowns, and by coefficients, which have the
    values `coefficients`, shape (k,). `logs` is the sum of the logarithms of the variances of the residuals.
    """

    starts: Floats
    others: Floats
    columns: Floats
    residuals: Floats
    coefficients: Floats
    logs: float


def score_of_rows(
    rows: Sequence[Rows], logarithmic: Bools, noise_scale: NoiseScale, parts: Mapping[Part, float]
) -> Score:
    """Return the score of a fit of all objects, with parts that rows do not show.

    Coefficients that are `logarithmic`, shape (k,), scatter by their logarithms, unless signs differ between objects.
    """
    factors, log_determinant = list[Floats](), 0.0
    for part in rows:
        target = part.columns @ part.coefficients - part.residuals
        first = np.column_stack([part.starts[:, part.starts.any(axis=0)], part.others])
        stacked = np.column_stack([first, part.columns, target])
        triangle = np.asarray(np.linalg.qr(np.vstack([stacked, np.zeros((stacked.shape[1],) * 2)]), mode="r"))
        diagonal = np.abs(np.diagonal(triangle))[: int(part.starts.any(axis=0).sum())]
        log_determinant += part.logs + 2 * float(np.log(diagonal).sum())
        factors.append(triangle[first.shape[1] :, first.shape[1] :])
    values = np.array([part.coefficients for part in rows])
    same = logarithmic & (np.abs(np.sign(values).sum(axis=0)) == len(values))
    effects = random_effect_factors(np.array(factors), np.where(same, values, 0.0))
    indices, objects = np.arange(values.shape[1]), len(rows)
    evidence = minus_twice_log_evidence(effects, indices, noise_scale)
    likelihood = float(noise_scale.deviance(residual_squares(effects, indices), len(indices) * objects))
    coefficients = coefficient_penalty(len(indices), objects, noise_scale)
    listed: dict[Part, float] = {
        "likelihood": likelihood,
        "latent states": log_determinant,
        "coefficients": coefficients,
        "scatter": evidence - likelihood - coefficients,
    }
    return Score({part: listed.get(part, 0.0) + parts.get(part, 0.0) for part in {**listed, **parts}})


def canonical_order(terms: Terms) -> list[int]:
    """Return the order of terms, by index, in which coefficients scatter, whichever way equations are written."""
    return sorted(range(len(terms)), key=lambda k: (not terms.is_factor[k], terms.names[k]))


@dataclass(frozen=True, eq=False)
class TrajectoryScore:
    """What the score of a fit by shooting is made of."""

    fitted: Fitted

    @property
    def trials(self) -> list[Trial]:
        """The trials with logarithms of what is measured by these."""
        return [data.trial for data in self.fitted.begun.problem.trials]

    @property
    def objects(self) -> tuple[str, ...]:
        return self.fitted.begun.trials.objects

    @cached_property
    def outliers(self) -> list[Bools]:
        """Which measurements of each trial are outliers, shape (n, m)."""
        return self.fitted.begun.problem.outliers(self.fitted.optimum.unknowns, self.fitted.optimum.noise)

    @cached_property
    def owners(self) -> list[set[str]]:
        """The objects whose trials depend on each unknown."""
        unknowns = self.fitted.begun.unknowns
        rows = list(zip(self.trials, unknowns.parameters, unknowns.initial, strict=True))
        return [
            {trial.object for trial, *indices in rows if any(k in listed for listed in indices)}
            for k in range(len(unknowns.names))
        ]

    @cached_property
    def held(self) -> list[int]:
        """Unknowns at bounds, with priors, or of several objects: coefficients scatter given these."""
        problem = self.fitted.begun.problem
        priors = {k for prior in problem.priors for k in prior.indices.tolist()}
        return [
            k
            for k, objects in enumerate(self.owners)
            if self.fitted.optimum.at_bound[k] or k in priors or len(objects) > 1
        ]

    @cached_property
    def at_bounds(self) -> set[str]:
        """Names of unknowns that are at a bound, if only of some objects."""
        return {*compress(self.fitted.begun.unknowns.names, self.fitted.optimum.at_bound.tolist())}

    @cached_property
    def equations(self) -> GivenEquations:
        """The equations as they are written."""
        begun = self.fitted.begun
        return read_equations(
            begun.model.text.equations,
            begun.model.schema,
            properties=property_names(begun.trials.properties),
            determined=begun.model.parameters,
        )

    @cached_property
    def measured(self) -> dict[int, tuple[int, int]]:
        """The measured quantity h that is a function of each state z alone, and this state, by index.

        Rates that are not measured themselves have those of their states: what starts with them is ``h'(z) z'``.
        """
        model, result = self.fitted.begun.model, dict[int, tuple[int, int]]()
        for measured, output in enumerate(model.expressions[model.width :]):
            column, *others = columns_in(output)
            if not others:
                result.setdefault(column, (measured, column))
        states = len(model.schema.states)
        rates = dict(enumerate(with_rates(model.order, states).tolist(), start=states))
        return {**{rate: result[state] for rate, state in rates.items() if state in result}, **result}

    @cached_property
    def starts(self) -> dict[int, list[tuple[int, int]]]:
        """Unknown initial values of measured states, and their rates: the trial and the state, by index, of each.

        An unknown that is in no equation, and determines one alone, ``x0 = g(p)``, stands for that.
        """
        model, unknowns = self.fitted.begun.model, self.fitted.begun.unknowns
        result = dict[int, list[tuple[int, int]]]()
        of_equations = {coefficient.name for coefficient in self.equations.coefficients}
        for i, (data, parameters) in enumerate(zip(self.fitted.begun.problem.trials, unknowns.parameters, strict=True)):
            indices = {model.first_parameter + p: k for p, k in enumerate(parameters) if k >= 0}
            for j, text in enumerate(model.initial):
                k = int(data.initial[j])
                if k < 0 and np.isnan(data.fixed[j]) and text is not None:
                    inside = {indices[column] for column in columns_in(text) if column in indices}
                    k = inside.pop() if len(inside) == 1 else -1
                    is_function = k >= 0 and text != f"+v{model.first_parameter + parameters.index(k)}"
                    k = -1 if is_function and unknowns.names[k] in of_equations else k
                if k >= 0 and k not in self.held and j in self.measured:
                    result.setdefault(k, []).append((i, j))
        return {k: places for k, places in result.items() if len(self.owners[k]) == 1}

    def of_object(self, owner: str) -> tuple[list[int], list[int]]:
        """Return the unknown initial values of an object, and its other unknowns."""
        free = [k for k, objects in enumerate(self.owners) if objects == {owner} and k not in self.held]
        return [k for k in free if k in self.starts], [k for k in free if k not in self.starts]

    @cached_property
    def score(self) -> Score:
        """Minus twice the logarithm of the evidence, in its parts."""
        rows, others = list[Rows](), list[int]()
        for owner in self.objects:
            starts, free = self.of_object(owner)
            mixture, coefficients, logarithmic = self._coordinates(owner, free)
            rest = [k for k, row in zip(free, mixture, strict=True) if not row.any()]
            slopes, residuals, logs = self._rows(owner)
            of_starts, columns = slopes[:, starts] * self._units(starts), slopes[:, free] @ mixture
            rows.append(Rows(of_starts, slopes[:, rest], columns, residuals, coefficients, logs))
            others += rest
        noise_scale, levels = self._noise()
        outlying = int(sum(far.sum() for far in self.outliers))
        noise_scale = replace(noise_scale, freedom=noise_scale.freedom - outlying)
        priors = {k for prior in self.fitted.begun.problem.priors for k in prior.indices.tolist()}
        others += [k for k in self.held if k not in priors]
        parts: dict[Part, float] = {
            "coefficients": self._unit_information(others) + self._of_priors(),
            "initial conditions": self._initial_conditions(),
            "error levels": levels,
            "outliers": self.fitted.begun.problem.huber_threshold**2 * outlying if outlying else 0.0,
        }
        return score_of_rows(rows, logarithmic, noise_scale, parts)

    @property
    def residuals(self) -> FittedResiduals:
        """Residuals without outliers."""
        parts = zip(self._whitened, self.outliers, strict=True)
        whitened = [part._replace(z=np.where(outlying, np.nan, part.z)) for part, outlying in parts]
        known = self.fitted.begun.problem.known_noise
        return FittedResiduals(self.trials, whitened, self.fitted.optimum.degrees_of_freedom, known)

    @property
    def has_few_measurements(self) -> bool:
        """Whether there are fewer than `MIN_SAMPLES_PER_TERM` measurements for each unknown."""
        problem = self.fitted.begun.problem
        return bool(problem.counts.sum() < settings.MIN_SAMPLES_PER_TERM * problem.unknowns)

    @property
    def noise_floor(self) -> Floats:
        """The smallest noise of each quantity, shape (m,)."""
        return np.asarray(np.maximum(settings.MIN_NOISE * within_trial_std(self.trials), rounding_noise(self.trials)))

    def standardized(self, k: int) -> list[tuple[Floats, Floats]]:
        """Return standardized residuals of a quantity in each trial, outliers included, and sizes of its values."""
        problem, unknowns = self.fitted.begun.problem, self.fitted.optimum.unknowns
        result = list[tuple[Floats, Floats]]()
        for data, part in zip(problem.trials, self._whitened, strict=True):
            seen = np.isfinite(data.trial.states[:, k])
            values = problem.predicted(data, unknowns, False).values
            result.append((part.z[seen, k], np.abs(values[seen, k])))
        return result

    @property
    def residuals_by_object(self) -> list[tuple[str, Floats]]:
        """Differences of measurements and trajectories of each trial and quantity, shape (n,), with the object."""
        problem, unknowns, listed = self.fitted.begun.problem, self.fitted.optimum.unknowns, list[tuple[str, Floats]]()
        for data in problem.trials:
            values = problem.predicted(data, unknowns, False).values
            for residuals in (data.trial.states - values).T:
                listed.append((data.trial.object, residuals[np.isfinite(residuals)]))
        return listed

    def _coordinates(self, owner: str, free: Sequence[int]) -> tuple[Floats, Floats, Bools]:
        """Return derivatives of unknowns by coefficients, shape (unknowns, k), these, and which scatter by logarithms.

        Parameters that are at a bound in some objects do not scatter in the others. Coefficients are in the order of
        their terms, whichever way these are written.
        """
        begun, unknowns, given = self.fitted.begun, self.fitted.optimum.unknowns, self.equations
        names = [begun.unknowns.names[k] for k in free]
        scattering = {coefficient.name for coefficient in given.coefficients} - self.at_bounds
        inside = np.array([name in scattering for name in names], dtype=np.bool_)
        values = self.fitted.values(owner)
        place = np.argsort(canonical_order(given.terms))
        products = sorted(given.products, key=lambda product: (product.equation, place[product.term]))
        slopes = np.array([[product.slopes(values).get(name, 0.0) for name in names] for product in products])
        used = np.flatnonzero(slopes[:, inside].any(axis=1)) if len(slopes) else np.empty(0, dtype=np.int64)
        places, count = [(products[i].equation, products[i].term) for i in used], int(inside.sum())
        mixture = np.zeros((len(free), count))
        square = slopes[np.ix_(used, np.flatnonzero(inside))] if count else np.zeros((0, 0))
        if len(used) == count == len({*places}) and (not count or np.linalg.cond(square) < 1e12):
            mixture[inside] = np.linalg.inv(square)
            coefficients = np.array([float(products[i].value(values)) for i in used])
            return mixture, coefficients, np.array([given.terms.have_parameters[products[i].term] for i in used], bool)
        order = [k for k in np.argsort(names).tolist() if inside[k]]
        mixture[order, range(count)] = 1.0
        return mixture, unknowns[np.array(free, dtype=np.int64)[order]], np.zeros(count, dtype=np.bool_)

    def _rows(self, owner: str) -> tuple[Floats, Floats, float]:
        """Return the slopes of the residuals of an object by all unknowns, these, and logarithms of their variances.

        Outliers have a variance, but no residual.
        """
        problem, optimum, logs, inner = self.fitted.begun.problem, self.fitted.optimum, 0.0, list[TrialData]()
        for data, part, outlying in zip(problem.trials, self._whitened, self.outliers, strict=True):
            if data.trial.object == owner:
                logs += 2 * float(np.log(part.std[np.isfinite(data.trial.states)]).sum())
                inner.append(replace(data, omitted=outlying))
        problem = replace(problem, trials=tuple(inner), priors=(), huber_threshold=np.inf)
        residuals, rows = problem.residuals(optimum.unknowns, optimum.noise)
        assert rows is not None
        return np.nan_to_num(rows), residuals, logs

    def _units(self, starts: Sequence[int]) -> Floats:
        """Return the derivatives of unknowns by the measured initial values that they determine, on their scale."""
        slopes = np.array([self._start(k)[1] for k in starts])
        return np.asarray(1 / np.where(slopes, slopes, 1.0))

    def _start(self, k: int) -> tuple[float, float]:
        """Return the measured initial value that an unknown determines, on its scale, and its derivative by this."""
        problem, unknowns, (i, j) = self.fitted.begun.problem, self.fitted.optimum.unknowns, self.starts[k][0]
        data, model, (measured, state) = problem.trials[i], problem.model, self.measured[j]
        initial, start_by = problem.initial(data, unknowns)
        assert start_by is not None
        point = problem.starting_point(data, data.parameters(unknowns))
        point[0, : model.width] = initial
        value, slope = model.outputs.evaluate(point)[0, measured], model.outputs.jacobian(point)[0, measured, state]
        slope /= value if problem.logarithmic[measured] else 1.0
        by_unknown = float(start_by[j, np.append(data.parameter, data.initial) == k].sum())
        return float(value if j == state else slope * initial[j]), float(slope * by_unknown)

    def _initial_conditions(self) -> float:
        """Return minus twice the log prior of measured initial values, and of their rates."""
        if not self.starts:
            return 0.0
        count, total = len(self.fitted.begun.model.observables), 0.0
        second = sorted({measured for j, (measured, state) in self.measured.items() if j != state})
        order = tuple(2 if k in second else 1 for k in range(count))
        pairs = ((trial, np.isfinite(trial.states).sum(axis=0) < 2) for trial in self.trials)
        variances = start_variances(self.trials, [smooth_curves(trial, order, few)[0] for trial, few in pairs])
        for k, places in self.starts.items():
            j = places[0][1]
            measured, state = self.measured[j]
            is_rate = j != state
            variance = variances[count + second.index(measured) if is_rate else measured]
            total += float(np.log(variance) + (self._start(k)[0] ** 2 / variance if is_rate else 0.0))
        return total

    def _noise(self) -> tuple[NoiseScale, float]:
        """Return the posterior of the noise scale, and minus twice the log prior of levels of errors."""
        problem, trials, noise = self.fitted.begun.problem, self.trials, self.fitted.optimum.noise
        estimate, observations = None, 0.0
        varying = np.any([np.ptp(np.nan_to_num(trial.states), axis=0) > 0 for trial in trials], axis=0)
        if not problem.known_noise.any() and varying.all():
            schema = replace(self.fitted.begun.trials.schema, states=problem.model.observables)
            measured = Trials(tuple(trials), schema)
            estimate = np.maximum(estimated_noise(measured)[0], noise_floor(measured))
            is_long = any(np.isfinite(trial.states).sum(axis=0).max() >= settings.MIN_SAMPLES for trial in trials)
            observations = settings.PRIOR_OBSERVATIONS if is_long or has_replicates(measured).any() else 0.0
        elif not problem.known_noise.any():
            estimate = noise
        replicated = replication(trials)
        repeated = sum(float(of_trial.freedom.sum()) for _, of_trial in replicated)
        count = sum(int(trial.counts.sum()) + int(np.isfinite(trial.below).sum()) for trial in trials)
        std = within_trial_std(trials)
        prior = NoisePrior(
            count,
            count - repeated - len(self.starts),
            np.ones(len(noise), dtype=np.bool_),
            estimate,
            observations,
            replicated,
            self.noise_floor,
            scales_of(std, trials),
        )
        single = [
            np.where(np.isfinite(trial.states), std / (with_typical(trial.noise, noise) * trial.averaging), np.nan)
            for trial, std in zip(trials, (part.white for part in self._whitened), strict=True)
        ]
        relative = np.nanmean(np.concatenate(single) ** 2, axis=0)
        penalty = prior.penalty(noise, problem.errors, relative) + prior.of_levels(problem.errors)
        return prior.posterior(noise, problem.errors, relative), penalty

    @cached_property
    def _whitened(self) -> list[Whitened]:
        problem, optimum, result = self.fitted.begun.problem, self.fitted.optimum, list[Whitened]()
        for data, outlying in zip(problem.trials, self.outliers, strict=True):
            values = problem.predicted(data, optimum.unknowns, False).values
            deviations = Deviations(data.trial, values, None, values if data.fitted is None else data.fitted, outlying)
            result.append(deviations.whitened(optimum.noise, problem.errors))
        return result

    def _unit_information(self, unknowns: Sequence[int]) -> float:
        counts = np.zeros(len(self.owners))
        begun = self.fitted.begun
        for data, *indices in zip(begun.problem.trials, begun.unknowns.parameters, begun.unknowns.initial, strict=True):
            used = np.unique([k for listed in indices for k in listed if k >= 0]).astype(np.int64)
            counts[used] += data.trial.counts.sum() + np.isfinite(data.trial.below).sum()
        return float(np.log(np.maximum(counts[np.array(unknowns, dtype=np.int64)], 1.0)).sum())

    def _of_priors(self) -> float:
        optimum, total, inner = self.fitted.optimum, 0.0, list[int]()
        for prior in self.fitted.begun.problem.priors:
            kept = ~optimum.at_bound[prior.indices]
            inner += prior.indices[kept].tolist()
            total += float(np.sum(prior.residuals(optimum.unknowns) ** 2))
            total -= float(np.linalg.slogdet((prior.root.T @ prior.root)[np.ix_(kept, kept)])[1])
        return total - float(np.linalg.slogdet(optimum.covariance[np.ix_(inner, inner)])[1])
