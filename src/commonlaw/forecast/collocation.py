"""Forecasts of laws of measured states: solutions from initial states that samples determine by collocation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast.initial_state import (
    MIN_SAMPLES,
    MeasuredStart,
    Start,
    StartedTrial,
    can_fit_initial_state,
    default_start,
    fit_initial_state,
    model_error_std,
    with_weights,
)
from commonlaw.forecast.scheme import (
    PLANNED_TOLERANCE,
    WITHOUT_DRAWS,
    AbstractScheme,
    AbstractStarted,
    Extended,
    Followed,
    ForecastOptions,
    Measured,
    PlannedTrial,
    Solved,
    measurement_errors,
    refuse_method,
)
from commonlaw.integration import InitialValueProblem, Inputs, Trajectory, VectorField, simulate
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.parameters import Parameters, named_parameters, rate_names, vector_field
from commonlaw.law.quantiles import two_sided
from commonlaw.library import highest_columns, highest_order, order_of_each, with_rates
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import with_logarithms, with_zeros_before_doses


@dataclass(frozen=True, eq=False)
class Collocation(AbstractScheme):
    """A law of measured states."""

    law: Law

    def free_starts(self, trial: Trial) -> int:
        """Return how many initial values of measured states, and of latent ones with unknown ones, there are."""
        law, schema = self.law, self.law.schema
        is_given = np.array([schema.initial_values.get(name) is not None for name in schema.states])
        is_measured = np.isfinite(trial.states).any(axis=0)
        orders = np.maximum(order_of_each(law.order, len(schema.states)), 1)
        return int(orders[(is_measured | schema.with_free_start) & ~is_given].sum())

    def check(self, options: ForecastOptions) -> None:
        if self.law.order == 0:
            refuse_method(options.method, "a law in discrete time")
        if options.seed is not None and highest_order(self.law.order) != 2:
            raise CommonlawError("option-without-effect", option=f"seed={options.seed}", kind=WITHOUT_DRAWS)

    def taken(self, trials: Trials) -> Trials:
        return with_logarithms(with_zeros_before_doses(trials), self.law.schema.logarithmic)

    def begin(self, trials: Trials, extended: Sequence[Extended], options: ForecastOptions) -> "FromStarts":
        law, seed, count_of_all = self.law, options.seed or 0, max(map(len, trials))
        if options.start == "all":
            law = with_weights(law, trials)
        start = count_of_all if options.start == "all" else options.start
        result = list[StartedTrial]()
        for trial, whole, inputs in extended:
            if options.from_time is not None:
                result.append(_begin_later(law, trial, whole, inputs, start, options.from_time, seed))
                continue
            measured = trial if law.schema.doses else trial.measured()
            count = default_start(law, measured, len(measured) < len(trial)) if start is None else start
            if min(count, len(measured)) > 1:
                if trial.times[0] < measured.times[0]:  # The solution begins with the first row, measured or not
                    is_kept = np.isfinite(trial.states).any(axis=1) | (np.arange(len(trial)) == 0)
                    measured, count = trial.rows(np.asarray(is_kept)), count + 1
                begins: Start = fit_initial_state(law, measured, inputs, count)
            else:
                begins = MeasuredStart(law, trial.measured(), seed)
                if earlier := int(np.searchsorted(whole.times, begins.begins)):  # Below a limit
                    whole = whole.rows(slice(earlier, None))
            result.append(StartedTrial(whole, inputs, begins))
        starts = [started.start for started in result if rate_names(law)]
        measured_starts = [start for start in starts if isinstance(start, MeasuredStart)]
        unknown = [start.samples.label for start in measured_starts if len(start.samples) == 1]
        notes = tuple[str, ...]()
        if unknown:
            labels = "; ".join(unknown)
            notes = (f"rates not identifiable from one sample were set to zero, without a band: {labels}",)
        trials = trials.with_trials([started.trial for started in result], *notes)
        return FromStarts(self.law, trials, tuple(result), options)

    def beginning(self, start: Floats, std: Floats) -> tuple[Floats, Floats]:
        start, std, logs = start.copy(), std.copy(), [*self.law.terms.variables.logarithmic_columns]
        latent = np.flatnonzero(self.law.schema.is_latent)
        std[logs] /= start[logs]
        start[logs] = np.log(start[logs])
        std[latent] = np.where(np.isfinite(std[latent]), std[latent], 0.0)
        return start, std

    @property
    def shown(self) -> tuple[str, ...]:
        return self.law.terms.variables.states

    def followed(self, trials: Sequence[PlannedTrial], slopes: bool, limit: float | None = None) -> list[Followed]:
        law = self.law
        problems = [
            InitialValueProblem(
                VectorField(law.terms, trial.coefficients, law.order, trial.inputs, law.support),
                trial.beginning,
                trial.times,
                trial.object,
            )
            for trial in trials
        ]
        trajectories = simulate(problems, tolerance=PLANNED_TOLERANCE, sensitivities=slopes, limit=limit)
        result = list[Followed]()
        for path in trajectories:
            by = path.sensitivities
            is_whole = path.outcome is None and by is not None and bool(np.isfinite(by).all())
            shown = (path.states, by) if is_whole else (None, None)
            result.append(Followed(path.times, path.states, *shown))
        return result

    def measured(self, name: str, followed: Followed) -> Measured | None:
        law, (times, states, values, slopes) = self.law, followed
        if values is None or slopes is None:
            return None
        errors, seen = law.uncertainty.error_model, np.flatnonzero(~law.schema.is_latent)
        assert law.uncertainty.noise is not None
        by_coefficients, by_start = np.split(slopes, [-states.shape[1]], axis=2)
        of_states = values[:, : len(law.schema.states)]
        noise = errors.noise_of(name, law.uncertainty.noise)
        white, coloured = measurement_errors(errors, noise, times, of_states, ~law.schema.is_latent)
        if errors.of_law:
            pushed = _pushes(law, name, times, by_start)[:, seen].reshape(white.size, -1)
            coloured = pushed @ pushed.T + (0.0 if coloured is None else coloured)
        return Measured(values[:, seen], by_coefficients[:, seen], by_start[:, seen], white, coloured)


def _pushes(law: Law, owner: str, times: Floats, by_start: Floats) -> Floats:
    """Return what standard normal numbers, which drive the errors of a law, add to its states, shape (n, D, k)."""
    errors, steps = law.uncertainty.error_model, np.diff(times)
    count, width = by_start.shape[:2]
    with np.errstate(all="ignore"):
        carried = np.einsum("nab,mbc->namc", by_start, np.linalg.pinv(by_start))  # From the time m to the time n
    carried = (carried[:, :, :-1] + carried[:, :, 1:]) / 2  # From within the step m
    carried *= (np.arange(count)[:, np.newaxis] > np.arange(count - 1))[:, np.newaxis, :, np.newaxis]
    parts = []
    walk = errors.walk_of(owner, with_rates(law.order, len(law.schema.states)))
    if walk is not None:
        parts.append(carried * walk * np.sqrt(steps)[:, np.newaxis])
    if errors.force is not None:
        middles = times[1:] - steps / 2
        apart = np.sqrt(3) * np.abs(middles[:, np.newaxis] - middles) / errors.force_time
        kernel = (1 + apart) * np.exp(-apart) + 1e-10 * np.eye(len(steps))
        pushed = highest_columns(law.order, len(law.schema.states))
        forced = carried[..., pushed] * errors.force * steps[:, np.newaxis]
        parts.append(np.einsum("namc,mk->nakc", forced, np.linalg.cholesky(kernel)))
    return np.concatenate([part.reshape(count, width, -1) for part in parts], axis=2)


def _begin_later(
    law: Law, trial: Trial, extended: Trial, inputs: Inputs, start: int | None, from_time: float, seed: int
) -> StartedTrial:
    """Return a trial started by the last samples before a time: so many as are asked for, else as can be fitted."""
    measured = trial.measured()
    stop = int(np.searchsorted(measured.times, from_time))
    fits = can_fit_initial_state(law)
    # More samples add little, and take long
    count = start or (min(stop, 500) if fits else MIN_SAMPLES if rate_names(law) else 1)
    samples = measured.rows(slice(max(0, stop - count), stop))
    rows = extended.rows(slice(int(np.searchsorted(extended.times, samples.times[0])), None))
    if len(samples) == 1 or not (start or fits):
        return StartedTrial(rows, inputs, MeasuredStart(law, samples, seed))
    if law.schema.doses:  # Which are given where nothing was measured
        begins, ends = np.searchsorted(trial.times, samples.times[[0, -1]])
        samples = trial.rows(slice(begins, ends + 1))
    return StartedTrial(rows, inputs, fit_initial_state(law, samples, inputs, len(samples)))


@dataclass(frozen=True, eq=False)
class FromStarts(AbstractStarted):
    """Trials that start at their first samples, or at the last of several."""

    law: Law
    trials: Trials
    started: tuple[StartedTrial, ...]
    options: ForecastOptions

    @property
    def inputs(self) -> list[Inputs]:
        return [started.inputs for started in self.started]

    @property
    def known_until(self) -> list[float]:
        return [started.start.known_until for started in self.started]

    def solved(self, trials: Sequence[Trial]) -> list[Solved]:
        options = self.options
        listed = [replace(started, trial=trial) for started, trial in zip(self.started, trials, strict=True)]
        trajectories = simulate(
            [self._problem(started) for started in listed],
            method=options.method,
            tolerance=options.tolerance,
            sensitivities=options.return_std,
            limit=options.limit,
        )
        deviations = self._std(listed, trajectories) if options.return_std else (None,) * len(listed)
        # The derivatives have done their work, and are many times larger than the states
        lighter = [replace(trajectory, sensitivities=None) for trajectory in trajectories]
        triples = zip(listed, lighter, deviations, strict=True)
        return [Solved(begun.start.followed_by(path, begun.trial.times), std, None) for begun, path, std in triples]

    def _std(self, listed: Sequence[StartedTrial], trajectories: Sequence[Trajectory]) -> tuple[Floats, ...]:
        """Return the standard deviations of the states of each trajectory, with those before its start."""
        law, deviations = self.law, []
        parameters, errors = named_parameters(law), law.uncertainty.error_model
        covariance = parameters.covariance_given_limits
        assert covariance is not None
        for started, trajectory in zip(listed, trajectories, strict=True):
            carried, initial = started.start.propagated(trajectory)
            of_object = covariance[object_index(law, started.trial.object)]
            std = trajectory_std(carried, of_object, initial)
            if parameters.limits:
                std = np.hypot(std, self._to_limits(started, trajectory, parameters))
            if errors.of_law or started.inputs.jumps_within:
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
        paths = simulate(
            problems, method=self.options.method, tolerance=self.options.tolerance, limit=self.options.limit
        )
        distances = [np.abs(path.states - trajectory.states) for path in paths]
        return np.asarray(np.fmax.reduce([np.zeros_like(trajectory.states), *distances]) / two_sided(0.95))

    def _problem(self, started: StartedTrial) -> InitialValueProblem:
        field = replace(vector_field(self.law, started.trial.object), inputs=started.inputs)
        if self.options.return_std:
            # By the coefficients of all objects, so that an object without one of the terms fits the covariance too
            field = replace(field, free=self.law.support)
        return InitialValueProblem(field, started.start.initial, started.ahead.times, started.trial.label)


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
