"""From measured trials to forecasts, and how far off these may be."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast.beginning import Beginning, begin, start_covariance
from commonlaw.forecast.model_error import model_error_std
from commonlaw.integration import InitialValueProblem, Trajectory, simulate
from commonlaw.law import Law
from commonlaw.law.forecast import Forecast
from commonlaw.trials import Trials


def predict(
    law: Law,
    trials: Trials,
    *,
    times: ArrayLike | None = None,
    start: int | None = None,
    from_time: float | None = None,
    return_std: bool = False,
    method: str = "auto",
    tolerance: float = 1e-8,
    seed: int = 0,
    input_between: str = "linear",
) -> Forecast:
    """Forecast each trial from its own initial state, see `Law.predict`."""
    _check_variables(law, trials)
    law, trials = _with_object(law, trials)
    covariance, noise = (law.uncertainty.known_covariance(), _noise_of(law)) if return_std else (None, None)
    trials, beginnings = begin(law, trials, times, start, from_time, input_between)
    problems = [_problem(law, each) for each in beginnings]
    if covariance is None or noise is None:
        found = simulate(problems, method=method, tolerance=tolerance)
        return Forecast(trials, _whole(beginnings, found), from_time=from_time)
    # By the coefficients of all objects, so that an object without one of the terms fits the covariance too
    problems = [replace(each, field=replace(each.field, free=law.support)) for each in problems]
    found = simulate(problems, method=method, tolerance=tolerance, sensitivities=True)
    deviations = []
    for own, trajectory in zip(beginnings, found, strict=True):
        known = covariance[law.objects.index(own.trial.object)]
        if own.fitted is None:
            first = law.uncertainty.error_model.measurement_std(own.told.states[:1], noise)[0]
            std = trajectory_std(trajectory, known, start_covariance(law, own.told, first, seed))
        else:
            carried, initial = own.fitted.propagated(trajectory)
            std = trajectory_std(carried, known, initial)
        if law.uncertainty.error_model.of_law:
            std = np.hypot(std, model_error_std(law, own.ahead, own.inputs, trajectory.states))
        deviations.append(std if own.fitted is None else own.fitted.std_followed_by(std, own.trial.times))
    # The derivatives have done their work, and are many times larger than the states
    lighter = _whole(beginnings, [replace(each, sensitivities=None) for each in found])
    return Forecast(trials, lighter, tuple(deviations), noise, from_time, law.uncertainty.error_model)


def _problem(law: Law, beginning: Beginning) -> InitialValueProblem:
    field = replace(law.vector_field(beginning.trial.object), inputs=beginning.inputs)
    return InitialValueProblem(field, beginning.initial(law), beginning.ahead.times, beginning.trial.label)


def _whole(beginnings: Sequence[Beginning], found: Sequence[Trajectory]) -> tuple[Trajectory, ...]:
    """Return trajectories with what is before their starts, at all times of the trials."""
    return tuple(
        trajectory if own.fitted is None else own.fitted.followed_by(trajectory, own.trial.times)
        for own, trajectory in zip(beginnings, found, strict=True)
    )


def trajectory_std(trajectory: Trajectory, parameters: Floats, initial: Floats) -> Floats:
    """Return the standard deviation of every state of a trajectory, to first order, shape (n, states).

    From the covariances of the parameters and of the initial states, which are independent of each other; NaN where the
    trajectory has diverged.
    """
    if trajectory.sensitivities is None:
        raise CommonlawError("this trajectory has no derivatives: simulate with sensitivities=True")
    width, variances = len(initial), np.zeros(trajectory.states.shape)
    with np.errstate(all="ignore"):  # Chaos makes derivatives as large as one likes
        for derivatives, covariance in (
            (trajectory.sensitivities[:, :, :-width], parameters),
            (trajectory.sensitivities[:, :, -width:], initial),
        ):
            variances += np.sum((derivatives @ covariance) * derivatives, axis=2)
        return np.sqrt(np.maximum(variances, 0))


def _noise_of(law: Law) -> Floats:
    if law.noise is None:
        raise CommonlawError(
            "this law does not know the noise of the measurements, and so not how accurate initial states are: "
            "give its noise, a standard deviation for each state"
        )
    return law.noise


def _with_object(law: Law, trials: Trials) -> tuple[Law, Trials]:
    """Return law and trials; where the trials' only object was not named, it is the only one of the law."""
    name, others = trials.objects[0], ", ".join(law.objects)
    if not trials.nameless or name in law.objects:
        return law, trials
    if len(law.objects) > 1:
        raise CommonlawError(
            f"the trials do not say of which object they are, and the law has several: say it with object_name=..., "
            f"one of {others}"
        )
    note = f"no object is named: {name} has the coefficients of {others}, the only object of the law"
    return replace(law, objects=(name,)), trials.with_trials(trials.trials, note)


def _check_variables(law: Law, trials: Trials) -> None:
    for kind, wanted, given in (
        ("states", law.schema.states, trials.schema.states),
        ("inputs", law.schema.inputs, trials.schema.inputs),
    ):
        if wanted != given:
            raise CommonlawError(
                f"the law has the {kind} {', '.join(wanted) or 'none'}, "
                f"the trials have {', '.join(given) or 'none'}; name the columns of the table as in the law"
            )
