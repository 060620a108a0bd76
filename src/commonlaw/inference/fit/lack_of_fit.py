"""Lack of fit: tests of residuals for white noise, discretization error, divergence, and poles.

Noise that grows with a state, or differs between objects, is estimated from differences of neighbouring samples before
the search, which would otherwise interpret large residuals as lack of fit, or be decided by the noisiest object.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise

import numpy as np

from commonlaw.array_types import Floats, evenly_spaced
from commonlaw.differentiation import differences, noise_correlation, noise_order, without_outliers
from commonlaw.inference import settings
from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.noise_by_group import approximately_used, noise_by_group
from commonlaw.inference.fit.parameter_grid import divisors, log_grid
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.settings import (
    MAX_DECADES,
    MIN_SAMPLES,
    MIN_SAMPLES_OF_MANY,
    PER_DECADE,
)
from commonlaw.integration import (
    InitialValueProblem,
    Inputs,
    OutputOptions,
    VectorField,
    runge_kutta_step,
    simulate_each,
)
from commonlaw.library.grammar import evaluate
from commonlaw.likelihood import (
    HUBER_THRESHOLD,
    ErrorModel,
    Estimate,
    Mesh,
    NoiseByGroup,
    by_group,
    groupings,
    jacobians,
    propagated,
)
from commonlaw.likelihood.levels import autocorrelation
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.progress import unannounced

Departures = Mapping[str, bool]
"""Departures of residuals from white noise in words, and whether each is of the noise; others are lack of fit."""

HETEROSCEDASTIC = "heteroscedastic"
UNEQUAL = "of unequal noise between objects or trials"
OF_NOISE = (HETEROSCEDASTIC, UNEQUAL)
"""Departures that are of the noise."""

NO_LAW: Departures = {"lack of fit: no law of this library fits the measurements within their noise": False}
"""The departure of a fit with a model error."""


def departures(problem: SearchProblem, estimates: Sequence[Estimate]) -> Departures:
    """Return the departures of residuals from white noise, state by state.

    They are heteroscedastic or autocorrelated if twice the log-likelihood ratio of a model with it exceeds log n for
    each of its parameters (BIC), see `autocorrelation`. Those of white noise are of unequal noise between objects or
    trials if that of levels by group exceeds their costs, see `NoiseByGroup.evidence`, and for given terms very
    strongly so: these are fitted under white noise else.
    """
    # At the noise floor, residuals are discretization errors
    measured = problem.noise > 1.001 * noise_floor(problem.trials)
    is_unequal = np.zeros(len(measured), dtype=np.bool_)
    if not (problem.noise_given or problem.errors) and measured.any():
        needed = settings.VERY_STRONG if problem.solver is None else 0.0
        used = approximately_used(problem, estimates)
        for kind in groupings(problem.in_order):
            is_unequal |= measured & (noise_by_group(problem, estimates, used, kind).evidence > needed)
    return {
        f"residuals of {name} are {words}": words in OF_NOISE
        for j, name in enumerate(problem.trials.schema.states)
        if name not in problem.trials.schema.initial_values
        for words in (*_of_state(problem, estimates, j, bool(measured[j])), *[UNEQUAL] * int(is_unequal[j]))
    }


def _of_state(problem: SearchProblem, estimates: Sequence[Estimate], j: int, is_measured: bool) -> list[str]:
    """Return the departures of the residuals of one state, see `departures_of_series`."""
    series = list[tuple[Floats, Floats]]()
    for model, estimate in zip(problem.models, estimates, strict=True):
        for mesh, states in zip(model.meshes, estimate.states, strict=True):
            segments = np.concatenate([[0], np.cumsum(~mesh.contiguous)])
            seen = (mesh.observed & ~mesh.still)[:, j]
            standard = (model.residuals(mesh, states) / problem.std_of(mesh))[seen, j]
            ends = np.flatnonzero(np.diff(segments[seen])) + 1
            columns = np.split(standard, ends), np.split(np.abs(states[seen, j]), ends)
            series += zip(*columns, strict=True)
    is_logarithmic = problem.trials.schema.states[j] in problem.trials.schema.logarithmic
    return departures_of_series(series, is_measured, is_logarithmic)


def departures_of_series(series: Sequence[tuple[Floats, Floats]], is_measured: bool, is_logarithmic: bool) -> list[str]:
    """Return the departures from white noise of series of standardized residuals, with sizes of the state, (n,) each.

    Their pattern is tested above the noise floor only, where noise is measured, and noise of logarithms for
    autocorrelation alone.
    """
    squares, sizes, lags, whole = list[Floats](), list[Floats](), list[Floats](), 0
    for standard, states in series:
        usual = np.abs(standard) <= HUBER_THRESHOLD
        kept, whole = standard[usual], whole + len(usual)
        squares.append(kept**2)
        sizes.append(states[usual])
        lags.append(kept[1:] * kept[:-1])
    squared, listed = np.concatenate([np.zeros(0), *squares]), list[str]()
    if 2 * len(squared) < whole:
        return [f"mostly larger than {HUBER_THRESHOLD:g} noise standard deviations"]
    if not is_measured or not whole:
        return []
    penalty = np.log(max(len(squared), 2))
    if not is_logarithmic and proportional_noise_gain(squared, np.concatenate(sizes))[0] > penalty:
        listed.append(HETEROSCEDASTIC)
    if autocorrelation(squared, np.concatenate(lags)):
        listed.append("autocorrelated")
    return listed


TOLERANCE = 1e-6
"""Relative error of solutions that are checked for divergence."""


@dataclass(frozen=True, eq=False)
class DiscretizationErrors:
    """Errors of collocation on one mesh of an object, in standard deviations of the noise, infinite if unknown.

    `local` are those of single steps, shape (steps, d). `total` says how far a solution from the first state of a
    segment may depart from the estimated states, to first order, if that is off by `TOLERANCE`, shape (points, d).
    """

    object: int
    mesh: Mesh
    states: Floats
    local: Floats
    total: Floats


def discretization_errors(problem: SearchProblem, estimates: Sequence[Estimate]) -> list[DiscretizationErrors]:
    """Return the errors of steps of collocation, compared with solutions from the same estimated states.

    Solutions are by classical Runge-Kutta steps, halved up to 64 in a step. Errors are infinite where these do not
    converge.
    """
    listed = list[DiscretizationErrors]()
    for i in evenly_spaced(len(estimates), settings.MAX_CHECKED_OBJECTS):
        model = problem.models[i]
        field, d = model.field(estimates[i].coefficients), model.equations
        for mesh, states in zip(model.meshes, estimates[i].states, strict=True):
            z, on = states[:, : model.width], mesh.contiguous
            std = np.broadcast_to(problem.std_of(mesh), (len(mesh), d))
            with np.errstate(all="ignore"):
                linear = jacobians(field, mesh, z)
                right = np.concatenate([linear.defects[on][:, :, np.newaxis], linear.start[on]], axis=2)
                try:
                    solved = np.linalg.solve(linear.end[on], right)
                except np.linalg.LinAlgError:
                    solved = np.full_like(right, np.inf)
                ends = np.full_like(z[1:][on], np.inf)
                for count in (2, 4, 8, 16, 32, 64):  # Stable where rates are up to 180 in a step
                    ends, before = _followed(field, mesh, z, count)[on], ends
                    if (np.abs(ends - before)[:, :d] < settings.RESOLVED_NOISE * std[1:][on]).all():
                        break
                sources = np.zeros((*z.shape, 1 + model.width))
                sources[1:][on, :, 0] = ends - z[1:][on]
                sources[mesh.first, :, 1:] = TOLERANCE * np.diag(np.abs(z).max(axis=0))
                missed = solved[:, :, 0]  # Where a step without a defect ends, to first order
                local = (sources[1:][on, :, 0] + missed)[:, :d] / std[1:][on]
                total = np.abs(propagated(mesh, solved[:, :, 1:], sources)[:, :d]).sum(axis=2) / std
            finite = (np.where(np.isfinite(errors), errors, np.inf) for errors in (local, total))
            listed.append(DiscretizationErrors(i, mesh, z, *finite))
    return listed


def is_resolved(errors: Sequence[DiscretizationErrors]) -> bool:
    """Return whether the mean square discretization error of a step is below the noise variance."""
    return bool(np.mean(np.concatenate([part.local.ravel() ** 2 for part in errors])) < 1)


@unannounced()
def diverges(problem: SearchProblem, estimates: Sequence[Estimate], errors: Sequence[DiscretizationErrors]) -> bool:
    """Return whether the trajectory of a training trial diverges from its fitted initial state.

    Trials in which it stays within the noise of the estimated states, to first order, are not integrated.
    """
    problems = []
    for part in errors:
        if (part.total < 1).all():
            continue
        mesh, field = part.mesh, problem.models[part.object].field(estimates[part.object].coefficients)
        for first, last in pairwise([*np.flatnonzero(mesh.first).tolist(), len(mesh)]):
            times = mesh.times[first:last]
            inputs = Inputs.of(times, mesh.inputs[first:last], problem.trials.schema.input_interpolation)
            problems.append(InitialValueProblem(replace(field, inputs=inputs), part.states[first], times, ""))
    return any(trajectory.outcome for trajectory in simulate_each(problems, OutputOptions(tolerance=TOLERANCE)))


def _followed(field: VectorField, mesh: Mesh, states: Floats, count: int) -> Floats:
    """Return the states at the ends of all steps from those at their starts, by so many classical Runge-Kutta steps."""
    z, h = states[:-1], mesh.steps[:, np.newaxis] / count
    for k in range(count):

        def rates(z: Floats, share: float, k: int = k) -> Floats:
            share = (k + share) / count
            inputs = mesh.inputs[:-1] if mesh.held else (1 - share) * mesh.inputs[:-1] + share * mesh.inputs[1:]
            return field.derivatives(np.column_stack([z, inputs, mesh.times[:-1] + share * mesh.steps]))

        z = runge_kutta_step(rates, z, h)
    return z


def has_pole(problem: SearchProblem, index: int, estimate: Estimate) -> bool:
    """Return whether a denominator changes its sign over the states of an object or chords between them."""
    if not (codes := divisors(problem.models[index].terms)):
        return False
    values = with_chord_points(values_along(problem, index, estimate))
    columns = problem.models[index].terms.at(values, estimate.coefficients).T
    with np.errstate(all="ignore"):
        return any(np.ptp(np.sign(evaluate(code, columns))) != 0 for code in codes)


def values_along(problem: SearchProblem, index: int, estimate: Estimate) -> Floats:
    """Return the variables along the estimated states of an object, shape (n, variables)."""
    model = problem.models[index]
    states = np.concatenate([state[:, : model.width] for state in estimate.states])
    inputs, times = (np.concatenate([getattr(mesh, name) for mesh in model.meshes]) for name in ("inputs", "times"))
    return model.terms.variables.natural(np.column_stack([states, inputs, times]))


def with_chord_points(values: Floats) -> Floats:
    """Return points, shape (n, variables), with random points on chords between them."""
    generator = np.random.default_rng(0)
    first, last = generator.integers(len(values), size=(2, settings.MAX_PAIRS))
    share = generator.uniform(size=(settings.MAX_PAIRS, 1))
    return np.concatenate([values, share * values[first] + (1 - share) * values[last]])


def proportional_noise_gain(squared: Floats, sizes: Floats) -> tuple[float, Floats]:
    """Return twice the log-likelihood ratio of proportional to constant noise, and the levels a and b.

    The variance is ``a^2 + b^2 x^2``, with b/a on a logarithmic grid and a of largest likelihood, against a constant
    one. Squared residuals, and sizes |x| of the state, have shape (n,).
    """
    typical = max(np.sqrt(np.mean(sizes**2)), np.finfo(float).tiny)
    shares = log_grid(PER_DECADE[1], 2 * MAX_DECADES)
    variances = 1 + (shares[:, np.newaxis] * sizes / typical) ** 2
    levels = np.mean(squared / variances, axis=1)
    if not (levels > 0).all():
        return 0.0, np.zeros(2)
    values = len(squared) * np.log(levels) + np.sum(np.log(variances), axis=1)
    best = int(np.argmin(values))
    gain = float(len(squared) * np.log(squared.mean()) - values[best])
    return gain, np.sqrt(levels[best]) * np.array([1.0, shares[best] / typical])


def with_heteroscedastic_noise(problem: SearchProblem, kinds: Sequence[ErrorKind]) -> SearchProblem:
    """Return the problem with noise that grows with states, or differs between objects, by differences of samples.

    Of the states for which differences support noise of one of these kinds, that of more evidence is taken: twice the
    log-likelihood ratio of squared differences, over the variance inflation by the correlation of neighbouring ones,
    less log n for proportional noise, which must be above zero, and less the costs of levels by object, see
    `NoiseByGroup.evidence`, which must be very strong. Trials in which no two orders of differences agree are left
    out: their states change too fast between samples. They must be fewer than half.
    """
    schema, floor, trials = problem.trials.schema, noise_floor(problem.trials), problem.in_order
    noise, shares, proportional = problem.noise.copy(), np.zeros(len(problem.noise)), 0.0
    if problem.noise_given:
        return problem
    squares, freedom = np.zeros((2, len(trials), len(noise)))
    for j, name in enumerate(schema.states):
        columns = list[tuple[int, tuple[Floats, Floats, Floats]]]()  # Times, values, and smoothed values of each trial
        for i, (trial, smooth) in enumerate(zip(trials, chain.from_iterable(problem.smoothed), strict=True)):
            seen = np.isfinite(trial.states[:, j])
            values = trial.states[seen, j]
            if name not in schema.initial_values and len(values) >= MIN_SAMPLES and np.ptp(values) > 0:
                columns.append((i, (trial.times[seen], values, smooth[seen, j])))
        orders = [noise_order(times, values) for _, (times, values, _) in columns]
        columns = [column for column, order in zip(columns, orders, strict=True) if order]
        if len(columns) <= len(orders) / 2:
            continue
        order = max(order for order in orders if order)
        parts = [(i, *_differences(*column, order)) for i, column in columns]
        squared, sizes = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
        if np.sqrt(np.mean(squared)) <= 1.001 * floor[j]:  # At the noise floor
            continue
        inflation = noise_correlation(order)
        gain, (constant, share) = proportional_noise_gain(squared, sizes)
        if (evidence := gain / inflation - np.log(sum(problem.measured))) > 0:
            noise[j], shares[j], proportional = max(constant, floor[j]), share, proportional + float(evidence)
        for i, of_trial, _ in parts:
            squares[i, j] += of_trial.sum() / inflation
            freedom[i, j] += len(of_trial) / inflation
    floors = np.array([noise_floor(problem.trials.with_trials([trial])) for trial in trials])
    why = "by differences of neighbouring samples"
    most, chosen = proportional * ("proportional" in kinds), None
    for kind in (kind for kind in groupings(trials) if kind in kinds):
        residuals = NoiseByGroup(squares, freedom, freedom, floors).merged(by_group(kind).groups(trials))
        scatters = residuals.evidence > settings.VERY_STRONG
        if (evidence := float(residuals.evidence[scatters].sum())) > most:
            most, chosen = evidence, (kind, residuals, scatters)
    if chosen is not None:
        return problem.with_noise_by_group(*chosen, why)
    if "proportional" in kinds and shares.any():
        return problem.with_errors(noise, ErrorModel({"proportional": shares}), why)
    return problem


def _differences(times: Floats, values: Floats, smooth: Floats, order: int) -> tuple[Floats, Floats]:
    """Return squared differences without outliers, and the mean absolute values of the state there."""
    *_, columns = differences(times, values[:, np.newaxis], order)
    residuals = columns[:, 0]
    sizes = np.convolve(np.abs(smooth), np.full(order + 1, 1 / (order + 1)), "valid")
    typical = np.ones(len(residuals))
    for near in np.array_split(np.argsort(sizes, kind="stable"), max(len(residuals) // MIN_SAMPLES_OF_MANY, 1)):
        typical[near] = np.median(np.abs(residuals[near])) or np.mean(np.abs(residuals[near])) or 1.0
    kept = without_outliers(residuals / typical, order)
    return residuals[kept] ** 2, sizes[kept]
