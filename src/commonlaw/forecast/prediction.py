"""Forecasts of trials by a law, from given or estimated initial conditions, and how far they may be off."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.forecast.forecast import Forecast, Part
from commonlaw.forecast.initial_state import FilteredStart, StartedTrial, begin, model_error_std, with_times
from commonlaw.forecast.population import with_objects_of
from commonlaw.integration import InitialValueProblem, Inputs, Trajectory, simulate
from commonlaw.integration.vector_field import InputFunction
from commonlaw.law import Law, select_objects
from commonlaw.law.alignment import matched, matched_times
from commonlaw.law.law import object_index
from commonlaw.law.parameters import Parameters, named_parameters, rate_names, vector_field
from commonlaw.law.quantiles import two_sided
from commonlaw.library import Terms
from commonlaw.likelihood import WHITE_NOISE
from commonlaw.runtime.arguments import check_type, numbers_of
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import MOMENT, with_logarithms, with_property_inputs


def simulate_law(
    law: Law,
    times: ArrayLike,
    initial: "ArrayLike | Mapping[str, ArrayLike]",
    *,
    tolerance: float,
    doses: Mapping[str, Mapping[float, float]] | None,
    inputs: "ArrayLike | InputFunction | Mapping[str, ArrayLike | InputFunction] | None",
    **options: Any,
) -> dict[str, Trajectory]:
    """Integrate a law for every object, see `Law.simulate`."""
    problems = initial_value_problems(law, times, initial, doses, inputs, tolerance)
    return dict(zip(problems, simulate(problems.values(), tolerance=tolerance, **options), strict=True))


def initial_value_problems(
    law: Law,
    times: ArrayLike,
    initial: "ArrayLike | Mapping[str, ArrayLike]",
    doses: Mapping[str, Mapping[float, float]] | None,
    inputs: "ArrayLike | InputFunction | Mapping[str, ArrayLike | InputFunction] | None",
    tolerance: float,
) -> dict[str, InitialValueProblem]:
    """Return the initial value problem of every object, see `Law.simulate`."""
    for name in doses or {}:
        check_choice("dose", name, law.schema.doses)
    natural = Terms(replace(law.terms.variables, logarithmic=()), law.terms.terms)
    starts = initial if isinstance(initial, Mapping) else dict.fromkeys(law.objects, initial)
    width, grid = len(law.terms.variables.states), numbers_of("times", times)
    pulses = inputs_of_doses(grid, [(doses or {}).get(name, {}) for name in law.schema.doses])
    if inputs is None and law.schema.inputs != law.schema.doses:
        raise CommonlawError("simulate-with-inputs", names=law.schema.inputs)
    if inputs is not None and law.schema.inputs == law.schema.doses and not isinstance(inputs, Mapping):
        raise CommonlawError("option-without-effect", option="inputs=...", kind="a law without inputs")
    driven = pulses if inputs is None else _given_inputs(law, grid, inputs, pulses, tolerance)
    problems = {}
    for name, start in starts.items():
        state = np.atleast_1d(numbers_of("initial", start))
        if state.shape != (width,):
            wanted = ", ".join(law.terms.variables.states)
            raise CommonlawError("initial-state-size", where=name, given=state.size, expected=width, names=wanted)
        field = replace(vector_field(law, name), terms=natural, inputs=driven)
        problems[name] = InitialValueProblem(field, state, grid, name)
    return problems


def _given_inputs(
    law: Law,
    grid: Floats,
    given: "ArrayLike | InputFunction | Mapping[str, ArrayLike | InputFunction]",
    pulses: Inputs | None,
    tolerance: float,
) -> Inputs:
    """Return inputs that are given as numbers, arrays at the times of a grid, or functions, with those of doses."""
    schema = law.schema
    names = [name for name in schema.inputs if name not in schema.doses]
    if isinstance(given, Mapping):
        for name in given:
            check_choice("input", name, names)
        if missing := [name for name in names if name not in given]:
            raise CommonlawError("simulate-with-inputs", names=missing)
        blocks = [(slice(i, i + 1), given[name]) for i, name in enumerate(names)]
    else:
        blocks = [(slice(0, len(names)), given)]
    functions, arrays = list[tuple[slice, InputFunction]](), np.zeros((len(grid), len(names)))
    for columns, signal in blocks:
        if callable(signal):
            functions.append((columns, signal))
            continue
        values, shape = np.asarray(signal, dtype=np.float64), arrays[:, columns].shape
        if values.ndim and values.shape not in (shape, shape[:1] if shape[1] == 1 else ()):
            raise CommonlawError("input-shape", names=names[columns], shape=values.shape, samples=len(grid))
        arrays[:, columns] = values.reshape(shape) if values.ndim else values
    between = Inputs.of(grid, arrays, schema.input_interpolation)
    if not functions and pulses is None:
        return between

    def along(times: Floats) -> Floats:
        rows = between.at(times)
        for columns, function in functions:
            values = [np.atleast_1d(np.asarray(function(time), dtype=np.float64)) for time in times.tolist()]
            rows[:, columns] = np.array(values)
        by_name = {name: rows[:, [i]] for i, name in enumerate(names)}
        if pulses is not None:
            by_name |= {name: pulses.at(times)[:, [i]] for i, name in enumerate(schema.doses)}
        return np.hstack([by_name[name] for name in schema.inputs])

    mesh = (
        grid if pulses is None else np.union1d(grid, pulses.knots[(pulses.knots > grid[0]) & (pulses.knots < grid[-1])])
    )
    return Inputs.of_function(along, mesh, tolerance)


def inputs_of_doses(grid: Floats, doses: Sequence[Mapping[float, float]]) -> Inputs | None:
    """Return inputs that add amounts in the moment after their times, none without any; see `with_doses`."""
    if not doses:
        return None
    moment = MOMENT * float(np.diff(grid).min(initial=np.inf))
    given = np.array(sorted({time for dose in doses for time in dose}), dtype=np.float64)
    values = np.array([[dose.get(float(time), 0.0) for dose in doses] for time in given]).reshape(-1, len(doses))
    times = np.column_stack([given, given + moment, given + 2 * moment]).ravel()
    pulses = np.stack([np.zeros_like(values), values / moment, np.zeros_like(values)], axis=1)
    pulses = pulses.reshape(-1, len(doses))
    first = np.array([min([grid[0], *given]) - 1.0])
    return Inputs.of(np.append(first, times), np.vstack([np.zeros((1, len(doses))), pulses]))


def predict(
    law: Law,
    trials: Trials,
    *,
    times: ArrayLike | None = None,
    start: int | Literal["all"] | None = None,
    from_time: float | None = None,
    return_std: bool = False,
    method: str = "auto",
    tolerance: float = 1e-8,
    seed: int = 0,
    input_interpolation: str | None = None,
    discrepancy: bool = False,
    averaged: bool = True,
) -> Forecast:
    """Forecast each trial from its own initial state, see `Law.predict`."""
    wanted, from_time = wanted_times(law, trials, times, from_time)
    trials = matched(law, trials)
    if discrepancy:
        law, trials = with_discrepancy(law, trials)
    law, trials = with_object(law, trials)
    if return_std:
        law.uncertainty.known_covariance()
        if law.uncertainty.noise is None:
            raise CommonlawError("noise-unknown-at-start")
    followed = with_logarithms(trials, law.schema.logarithmic)

    def forecast(law: Law) -> Forecast:
        begun, started = begin(law, followed, wanted, start, from_time, input_interpolation, seed)
        return _Forecaster(law, begun, tuple(started), from_time, return_std, method, tolerance).forecast()

    first, *others = law.models if averaged else law.models[:1]
    parts = [Part(first.probability, forecast(law))]
    for model in others:
        with suppress(CommonlawError):  # Its start may not be fitted where that of the law is
            plausible = replace(model.law, provenance=law.provenance)
            parts.append(Part(model.probability, forecast(plausible), equations="; ".join(plausible.structure)))
    result = average(parts)
    notes = remarks_on(result)
    result = result if trials.schema.logarithmic == law.schema.logarithmic else result.as_measured(trials)
    # Where it leaves what the law was learned from
    visited, ahead = list[tuple[str, dict[str, Floats]]](), 0.0
    for trial, trajectory in zip(result.trials, result.trajectories, strict=True):
        columns = dict(zip((*law.schema.states, *rate_names(law)), trajectory.states.T, strict=True))
        columns |= dict(zip(result.trials.schema.inputs, trial.inputs.T, strict=True))
        properties = result.trials.properties.get(trial.object, {})
        columns |= {name: np.array([value]) for name, value in properties.items() if isinstance(value, float)}
        visited.append((trial.label, columns))
        known = trial.times[np.isfinite(trial.states).any(axis=1)][-1]
        since = known if result.from_time is None else min(known, result.from_time)
        ahead = max(ahead, float(trial.times[-1] - since))
    unit = result.trials.schema.units.get(result.trials.schema.time, "")
    notes += tuple(law.provenance.domain.remarks(visited, unit, ahead))
    noted = replace(result.trials, notes=(*result.trials.notes, *notes)) if notes else result.trials
    return replace(result, trials=noted, wanted=wanted)


def wanted_times(
    law: Law, trials: Trials, times: ArrayLike | None, from_time: float | None
) -> tuple[Floats, float | None]:
    """Return further times of forecasts and that at which they begin, given in the unit of trials, in that of the law.

    Raises `CommonlawError` if the latter is no finite number.
    """
    wanted = np.atleast_1d(numbers_of("times", [] if times is None else matched_times(law, trials, times)))
    if from_time is not None:
        check_type("from_time", from_time, Real, "a number")
        if not np.isfinite(from_time):
            raise CommonlawError("forecast-from-time", from_time=from_time)
        from_time = float(np.asarray(matched_times(law, trials, from_time)))
    return wanted, from_time


def forecast_from(law: Law, name: str, times: Floats, start: Floats, limit: float | None = None) -> Forecast:
    """Forecast an object from a given state, with standard deviations where the law has a covariance.

    Raises `CommonlawError` if the start has the wrong number of values, or must be positive and is not.

    Parameters
    ----------
    law, name
        A law without inputs, and one of its objects.
    times
        Shape (n,); the first is that of the start.
    start
        The states, followed by the rates of those of second order, shape (width,), without error.
    limit
        A state larger than this is not followed on, see `simulate`.
    """
    variables, states = law.terms.variables.states, len(law.schema.states)
    if len(start) != len(variables):
        raise CommonlawError("start-size", given=len(start), expected=len(variables), variables=variables)
    unknown = np.full((len(times) - 1, states), np.nan)
    trial = Trial(name, "1", times, np.vstack([start[:states], unknown]))
    measured = Trials((trial,), replace(law.schema, logarithmic=()))
    followed = with_logarithms(measured, law.schema.logarithmic)
    initial = np.append(followed.trials[0].states[0], start[states:])
    width, certain = len(variables), np.zeros((1, len(variables)))
    begun = followed.trials[0]
    inputs = Inputs.of(begun.times, begun.inputs, law.schema.input_interpolation)

    def forecast(plausible: Law) -> Forecast:
        sensitivity = np.zeros((width, int(plausible.support.sum())))
        given = FilteredStart(times[:1], initial[None], certain, np.zeros((width, width)), sensitivity[None])
        started, has_std = (StartedTrial(begun, inputs, given),), law.uncertainty.has_std
        return _Forecaster(plausible, followed, started, None, has_std, "auto", 1e-8, limit).forecast()

    averaged = average([Part(model.probability, forecast(model.law)) for model in law.models])
    return averaged.as_measured(measured) if law.schema.logarithmic else averaged


@dataclass(frozen=True, eq=False)
class _Forecaster:
    """All that forecasts are made from; see `Law.predict`."""

    law: Law
    trials: Trials
    started: tuple[StartedTrial, ...]
    from_time: float | None
    return_std: bool
    method: str
    tolerance: float
    limit: float | None = None

    def forecast(self) -> Forecast:
        trajectories = simulate(
            [self._problem(trial) for trial in self.started],
            method=self.method,
            tolerance=self.tolerance,
            sensitivities=self.return_std,
            limit=self.limit,
        )
        known = self.law.uncertainty
        # The derivatives have done their work, and are many times larger than the states
        lighter = [replace(trajectory, sensitivities=None) for trajectory in trajectories]
        pairs = zip(self.started, lighter, strict=True)
        return Forecast(
            self.trials,
            tuple(begun.start.followed_by(path, begun.trial.times) for begun, path in pairs),
            self._std(trajectories) if self.return_std else None,
            known.noise if self.return_std else None,
            self.from_time,
            known.error_model,
            None if self.law.order == 0 else self.at_more_times,
            degrees_of_freedom=known.degrees_of_freedom,
            horizons=tuple(np.maximum(0.0, begun.trial.times - begun.start.known_until) for begun in self.started),
            interval_inflation=known.interval_inflation,
        )

    def at_more_times(self, times: Sequence[Floats]) -> Forecast:
        """Return the forecasts from the same beginnings at more times of each trial."""
        finer = [
            replace(started, trial=with_times(started.trial, started.inputs, more))
            for started, more in zip(self.started, times, strict=True)
        ]
        trials = self.trials.with_trials([started.trial for started in finer])
        return replace(self, trials=trials, started=tuple(finer)).forecast()

    def _std(self, trajectories: Sequence[Trajectory]) -> tuple[Floats, ...]:
        """Return the standard deviations of the states of each trajectory, with those before its start."""
        law, deviations = self.law, []
        parameters, errors = named_parameters(law), law.uncertainty.error_model
        covariance = parameters.covariance_given_limits
        assert covariance is not None
        for started, trajectory in zip(self.started, trajectories, strict=True):
            carried, initial = started.start.propagated(trajectory)
            of_object = covariance[object_index(law, started.trial.object)]
            std = trajectory_std(carried, of_object, initial)
            if parameters.limits:
                std = np.hypot(std, self._to_limits(started, trajectory, parameters))
            if errors.of_law:
                std = np.hypot(std, model_error_std(law, started.ahead, started.inputs, trajectory.states))
            whole = started.start.std_followed_by(std, started.trial.times, of_object)
            deviations.append(whole[:, : len(law.schema.states)])
        return tuple(deviations)

    def _to_limits(self, started: StartedTrial, trajectory: Trajectory, parameters: Parameters) -> Floats:
        """Return by how much parameters that have only a limit move a trajectory, as standard deviations, (n, D).

        Their 95 % band reaches the forecasts with such a parameter at its limit, and far beyond it.
        """
        problem = self._problem(started)
        ends = [end for pair in parameters.beyond_limits(started.trial.object) for end in pair]
        fields = [replace(problem.field, coefficients=coefficients, free=None) for coefficients in ends]
        problems = [replace(problem, field=field) for field in fields]
        paths = simulate(problems, method=self.method, tolerance=self.tolerance, limit=self.limit)
        distances = [np.abs(path.states - trajectory.states) for path in paths]
        return np.asarray(np.fmax.reduce([np.zeros_like(trajectory.states), *distances]) / two_sided(0.95))

    def _problem(self, started: StartedTrial) -> InitialValueProblem:
        field = replace(vector_field(self.law, started.trial.object), inputs=started.inputs)
        if self.return_std:
            # By the coefficients of all objects, so that an object without one of the terms fits the covariance too
            field = replace(field, free=self.law.support)
        return InitialValueProblem(field, started.start.initial, started.ahead.times, started.trial.label)


def with_discrepancy(law: Law, trials: Trials) -> tuple[Law, Trials]:
    """Return the law with its discrepancy as further terms, and trials with the properties that these take as inputs.

    Raises `CommonlawError` if it has none, or the law was changed since.
    """
    wider, used = law.provenance.with_discrepancy, law.support.any(axis=0)
    if wider is None:
        raise CommonlawError("discrepancy-missing")
    if {*law.objects} <= {*wider.objects}:
        wider = select_objects(wider, law.objects)
    if law.scheme == "collocation":
        same = np.array_equal(wider.coefficients[:, :, : used.sum()], law.coefficients[:, :, used])
    else:
        narrow, whole = named_parameters(law), named_parameters(wider)
        both = [whole.names.index(name) for name in narrow.names if name in whole.names]
        same = narrow.values.shape == whole.values[:, both].shape and np.allclose(narrow.values, whole.values[:, both])
    if not same or (wider.schema.states, wider.order) != (law.schema.states, law.order):
        raise CommonlawError("discrepancy-outdated")
    known = {name: {**law.properties.get(name, {}), **trials.properties.get(name, {})} for name in trials.objects}
    taken = wider.schema.inputs[len(law.schema.inputs) :]
    return wider, with_property_inputs(replace(trials, properties=known), taken)


def trajectory_std(trajectory: Trajectory, parameters: Floats, initial: Floats) -> Floats:
    """Return the standard deviation of every state of a trajectory, to first order, shape (n, states).

    From the independent covariances of parameters and initial states; NaN where the trajectory has diverged.
    """
    if trajectory.sensitivities is None:
        raise CommonlawError("sensitivities-missing")
    width, variances = len(initial), np.zeros(trajectory.states.shape)
    with np.errstate(all="ignore"):  # Chaos makes derivatives as large as one likes
        for derivatives, covariance in (
            (trajectory.sensitivities[:, :, :-width], parameters),
            (trajectory.sensitivities[:, :, -width:], initial),
        ):
            variances += np.sum((derivatives @ covariance) * derivatives, axis=2)
        return np.sqrt(np.maximum(variances, 0))


def with_object(law: Law, trials: Trials) -> tuple[Law, Trials]:
    """Return the law of these trials' objects; where their only one was not named, it is the only one of the law."""
    name, others = trials.objects[0], ", ".join(law.objects)
    if not trials.nameless or name in law.objects:
        if len(law.objects) == 1:
            select_objects(law, trials.objects)
        law, notes = with_objects_of(law, trials)
        return law, replace(trials, notes=(*trials.notes, *notes)) if notes else trials
    if len(law.objects) > 1:
        raise CommonlawError("object-unnamed", objects=others)
    note = f"no object is named: {name} has the coefficients of {others}, the only object of the law"
    other_laws = law.uncertainty.map_other_laws(lambda plausible: replace(plausible, objects=(name,)))
    uncertainty = replace(law.uncertainty, other_laws=other_laws)
    return replace(law, objects=(name,), uncertainty=uncertainty), trials.with_trials(trials.trials, note)


def fitted(law: Law, trials: Trials, return_std: bool = False) -> Forecast:
    """Return the solutions of a law whose initial conditions are estimated from all samples of each trial.

    ``x0 = argmin sum_i ((y_i - x(t_i; x0)) / sigma_i)^2`` at fixed coefficients, with the Huber loss; sigma, the
    standard deviation of a measurement, is heteroscedastic where errors grow with the states. Process noise is left
    out, so that residuals are all that the equations leave; such fits have no bands.

    Raises `CommonlawError` if the law is in discrete time, or not finite near the samples of a trial.
    """
    errors, trials = law.uncertainty.error_model, matched(law, trials, observed=True)
    solution = replace(law, uncertainty=replace(law.uncertainty, error_model=WHITE_NOISE))
    return_std = return_std and not errors.of_law
    fit = solution.predict(trials, start="all", return_std=return_std, averaged=False)
    noise, is_plain = law.uncertainty.noise, not errors.heteroscedastic and errors.correlated is None
    if noise is None or law.schema.logarithmic or is_plain:
        return fit
    # Errors that grow with the states are known once these are
    curves = [np.nan_to_num(trajectory.states[:, : len(law.schema.states)]) for trajectory in fit.trajectories]
    weighted = tuple(
        replace(trial, noise=errors.measurement_std(curve, trial.std(noise)))
        for trial, curve in zip(fit.trials, curves, strict=True)
    )
    names = {name: f"standard deviation of {name}" for name in law.schema.states} | dict(trials.schema.noise_columns)
    trials = replace(trials, trials=weighted, schema=replace(trials.schema, noise_columns=names))
    return solution.predict(trials, start="all", return_std=return_std, averaged=False)


def average(parts: Sequence[Part]) -> Forecast:
    """Return the average of forecasts of the same trials, of which the first is that of the law itself.

    States are medians over laws, weighted by their probabilities; standard deviations are about these, and intervals
    hold their share of the mixture. A law that diverges in a trial does not count for it; where all do, the law stands
    alone.
    """
    if len(parts) == 1:
        return parts[0].forecast
    first = parts[0].forecast
    weights = [_weights(parts, i) for i in range(len(first.trajectories))]
    moments = [_moments(parts, i, weight) for i, weight in enumerate(weights)]
    return replace(
        first,
        trajectories=tuple(trajectory for trajectory, _ in moments),
        std=None if first.std is None else tuple(std for _, std in moments),
        at_more_times=None if first.at_more_times is None else partial(_averaged_at, tuple(parts)),
        parts=tuple(part._replace(weights=tuple(weight[k] for weight in weights)) for k, part in enumerate(parts)),
    )


def _averaged_at(parts: Sequence[Part], times: Sequence[Floats]) -> Forecast:
    """Return the average of the forecasts at more times; a function of a module, as processes hand it to each other."""
    pairs = [(part, part.forecast.at_more_times) for part in parts]
    return average([part._replace(forecast=more(times)) for part, more in pairs if more])


def remarks_on(found: Forecast) -> tuple[str, ...]:
    """Return a sentence on rival laws where the law diverges, or where they shift a forecast by more than its error."""
    if len(found.parts) < 2:
        return ()
    first, farthest = found.parts[0], 0.0
    lost = [trial.label for trial, share in zip(found.trials, first.weights, strict=True) if not share]
    if lost:
        return (
            f"the law diverges in {', '.join(lost)}: its forecasts there average the other plausible laws, of total "
            f"posterior probability {1 - first.probability:.2g}",
        )
    if found.std is None:
        return ()
    width = len(found.trials.schema.states)
    for i, (std, noise) in enumerate(zip(first.forecast.std or (), first.forecast.measurement_std(), strict=True)):
        middle = found.trajectories[i].states[:, :width]
        others = [(part.weights[i], part.forecast.trajectories[i].states[:, :width]) for part in found.parts]
        between = np.sqrt(sum(share * (states - middle) ** 2 for share, states in others if share))
        farthest = max(farthest, float(np.nanmax(between / np.hypot(std, noise), initial=0.0)))
    if farthest <= 1:
        return ()
    second = found.parts[1]
    return (
        f"{second.equations} is also plausible (posterior probability {second.probability:.2g}): forecasts average "
        f"{len(found.parts)} laws, which differ by more than the standard error of one forecast",
    )


def _weights(parts: Sequence[Part], trial: int) -> Floats:
    """Return what each forecast of a trial counts, shape (parts,)."""
    shares: Floats = np.array([part.probability for part in parts])
    whole = np.zeros(len(parts), dtype=np.bool_)
    for k, (forecast, trajectory) in enumerate((part.forecast, part.forecast.trajectories[trial]) for part in parts):
        std = 0.0 if forecast.std is None else forecast.std[trial]
        whole[k] = trajectory.outcome is None and np.isfinite(trajectory.states).all() and np.isfinite(std).all()
    if not whole.any():
        return np.asarray(np.eye(len(parts))[0])
    return np.asarray(shares * whole / shares[whole].sum())


def _moments(parts: Sequence[Part], trial: int, weights: Floats) -> tuple[Trajectory, Floats]:
    """Return the median trajectory of a trial and the standard deviation of its states about it, shape (n, states)."""
    kept = [(share, part.forecast) for share, part in zip(weights, parts, strict=True) if share]
    states = np.array([forecast.trajectories[trial].states for _, forecast in kept])
    # The least of the values up to which half of the weight lies
    order = np.argsort(states, axis=0)
    reached = np.cumsum(weights[weights > 0][order], axis=0) >= 0.5 * (1 - 1e-12)
    places = np.take_along_axis(order, reached.argmax(axis=0)[np.newaxis], axis=0)
    median = np.take_along_axis(states, places, axis=0)[0]
    width = len(parts[0].forecast.trials.schema.states)
    variance = np.zeros_like(median[:, :width])
    for (share, forecast), state in zip(kept, states, strict=True):
        with np.errstate(invalid="ignore"):
            about = (state - median)[:, :width]
            variance += share * ((0.0 if forecast.std is None else forecast.std[trial]) ** 2 + about**2)
    return replace(kept[0][1].trajectories[trial], states=median), np.sqrt(variance)
