"""Solutions of laws from given initial states."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.forecast.scheme import refuse_method
from commonlaw.forecast.shooting import Shooting, trajectory_of
from commonlaw.integration import InitialValueProblem, Inputs, Trajectory, simulate
from commonlaw.integration.shooting import NO_INPUTS, DelayedInputs, shoot
from commonlaw.integration.vector_field import InputFunction
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.parameters import vector_field
from commonlaw.library import Terms
from commonlaw.runtime.arguments import numbers_of
from commonlaw.trials import Schema
from commonlaw.trials.transformations import MOMENT


def simulate_law(
    law: Law,
    times: ArrayLike,
    initial: "ArrayLike | Mapping[str, ArrayLike]",
    *,
    method: str,
    tolerance: float,
    doses: Mapping[str, Mapping[float, float]] | None,
    inputs: "ArrayLike | InputFunction | Mapping[str, ArrayLike | InputFunction] | None",
    **options: Any,
) -> dict[str, Trajectory]:
    """Integrate a law for every object, see `Law.simulate`."""
    by_shooting = bool(law.observation.events) or law.schema.inputs != law.observation.measured.inputs
    if by_shooting:
        refuse_method(method, "a law with events or delayed inputs")
        if refused := [name for name, value in options.items() if value]:
            raise CommonlawError("simulate-with-events", settings=refused)
    if law.order == 0:
        refuse_method(method, "a law in discrete time")
    problems = _problems(law, times, initial, doses, inputs, tolerance)
    if by_shooting:
        return _by_shooting(law, problems, tolerance)
    trajectories = simulate(problems.values(), method=method, tolerance=tolerance, **options)
    return dict(zip(problems, trajectories, strict=True))


def _by_shooting(law: Law, problems: Mapping[str, InitialValueProblem], tolerance: float) -> dict[str, Trajectory]:
    """Return the trajectories of a law that changes its states at events, or has delayed inputs."""
    shooting, result = Shooting.of(law, ()), dict[str, Trajectory]()
    for name, problem in problems.items():
        driven, model = problem.field.inputs, shooting.model
        delayed = NO_INPUTS if driven is None else DelayedInputs(driven, model.column, model.delay)
        states, _, is_endless = shoot(
            model.switched,
            shooting.parameters(shooting.named.values[object_index(law, name)], law.properties.get(name, {})),
            problem.initial,
            problem.times,
            shooting.sizes,
            delayed,
            derivatives=False,
            tolerance=tolerance,
        )
        finite = np.asarray(np.isfinite(states).all(axis=1))
        result[name] = trajectory_of(problem.times, states, finite, is_endless, name)
    return result


def _problems(
    law: Law,
    times: ArrayLike,
    initial: "ArrayLike | Mapping[str, ArrayLike]",
    doses: Mapping[str, Mapping[float, float]] | None,
    inputs: "ArrayLike | InputFunction | Mapping[str, ArrayLike | InputFunction] | None",
    tolerance: float,
) -> dict[str, InitialValueProblem]:
    """Return the initial value problem of every object, see `Law.simulate`."""
    schema = law.observation.measured
    for name in doses or {}:
        check_choice("dose", name, schema.doses)
    natural = Terms(replace(law.terms.variables, logarithmic=()), law.terms.terms)
    starts = initial if isinstance(initial, Mapping) else dict.fromkeys(law.objects, initial)
    width, grid = len(law.terms.variables.states), numbers_of("times", times)
    pulses = inputs_of_doses(grid, [(doses or {}).get(name, {}) for name in schema.doses])
    if inputs is None and schema.inputs != schema.doses:
        raise CommonlawError("simulate-with-inputs", names=schema.inputs)
    if inputs is not None and schema.inputs == schema.doses and not isinstance(inputs, Mapping):
        raise CommonlawError("option-without-effect", option="inputs=...", kind="a law without inputs")
    driven = pulses if inputs is None else _given_inputs(schema, grid, inputs, pulses, tolerance)
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
    schema: Schema,
    grid: Floats,
    given: "ArrayLike | InputFunction | Mapping[str, ArrayLike | InputFunction]",
    pulses: Inputs | None,
    tolerance: float,
) -> Inputs:
    """Return inputs that are given as numbers, arrays at the times of a grid, or functions, with those of doses."""
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
