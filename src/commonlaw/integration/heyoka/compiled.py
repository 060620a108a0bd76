"""Laws compiled by heyoka: one structure, whatever the coefficients, the start and the levels of events."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import heyoka
import numpy as np

from commonlaw.array_types import Floats
from commonlaw.integration.event import EventFunctions
from commonlaw.integration.heyoka.translation import translated
from commonlaw.integration.initial_value_problem import InitialValueProblem, OutputOptions
from commonlaw.integration.vector_field import VectorField
from commonlaw.library import Term

# A home that cannot be written to costs heyoka its cache on disk, and is nothing to tell a user of each time.
heyoka.set_logger_level_error()

Found = list[tuple[int, float, Floats]]

_LARGE = 100
"""Laws of more coefficients than this, and sensitivities, are compiled in heyoka's compact mode."""


@dataclass(frozen=True)
class Structure:
    """Everything that is compiled, and so nothing that differs between objects.

    The terms that are in some equation; for each coefficient, in their order, its `pair`: the equation and the index of
    the term; the indices of those that sensitivities are wanted of, if any (`free`), and of those that are the values
    of constants `inside` of terms, None for one that is zero; how many `inputs` there are, the indices of the states
    that are `logarithmic`, and how many powers the polynomials of inputs have; each event's expression, direction and
    whether it is terminal.
    """

    terms: tuple[Term, ...]
    pairs: tuple[tuple[int, int], ...]
    free: tuple[int, ...]
    inside: tuple[int | None, ...]
    equations: int
    second: tuple[int, ...]
    inputs: int
    logarithmic: tuple[int, ...]
    powers: int
    events: tuple[tuple[Term, int, bool], ...]
    tolerance: float
    sensitivities: bool

    @property
    def width(self) -> int:
        """How many states and rates there are."""
        return self.equations + len(self.second)

    @classmethod
    def of(cls, vector_field: VectorField, options: OutputOptions) -> "Structure":
        """Return the structure of a vector field."""
        used = np.flatnonzero(vector_field.kept.any(axis=0))
        columns = np.argwhere(vector_field.kept)[:, 1].tolist()
        events = EventFunctions(options.events, vector_field).terms.terms
        free = np.flatnonzero(vector_field.parameter_mask[vector_field.kept] & options.sensitivities)
        return cls(
            tuple(vector_field.terms.terms[k] for k in used),
            tuple((int(j), int(k)) for j, k in np.argwhere(vector_field.kept[:, used])),
            tuple(int(i) for i in free),
            tuple(columns.index(k) if k in columns else None for k in vector_field.terms.constants),
            len(vector_field.coefficients),
            tuple(vector_field.second.tolist()),
            len(vector_field.terms.variables.inputs),
            vector_field.terms.variables.logarithmic_columns,
            0 if vector_field.inputs is None else vector_field.inputs.powers,
            tuple((term, each.sign, each.terminal) for term, each in zip(events, options.events, strict=True)),
            max(options.tolerance, float(np.finfo(float).eps)),
            options.sensitivities,
        )


@dataclass(frozen=True, eq=False)
class Compiled:
    """What heyoka made of a structure: its integrator, which holds parameters, state and time, for `width` states.

    Its parameters are coefficients and levels of events, so many `constants`, and then the polynomials of the inputs.
    `terminal` are the indices of the terminal events; the others write to `found`. Initial sensitivities are row by
    row, empty without.
    """

    stepper: Any
    width: int
    constants: int
    terminal: list[int]
    found: Found
    initial_sensitivities: Floats

    def start(self, problem: InitialValueProblem, levels: Floats) -> None:
        """Set parameters, state and time to the start of a problem."""
        self.stepper.pars[: self.constants] = np.concatenate([problem.field.coefficients[problem.field.kept], levels])
        self.reset(problem.start, np.concatenate([problem.initial, self.initial_sensitivities]))

    def reset(self, time: float, row: Floats) -> None:
        """Set time and state, and forget what was found."""
        self.stepper.time = time
        self.stepper.state[:] = row
        self.found.clear()
        if self.terminal:
            self.stepper.reset_cooldowns()

    def follow(self, problem: InitialValueProblem) -> float:
        """Set the inputs to what holds from the present time on; return until when."""
        time, stops, inputs = self.stepper.time, problem.stops, problem.field.inputs
        if inputs is not None:
            piece = inputs.piece(time)
            # heyoka has no parameters after the last one that the law uses
            own = self.stepper.pars[self.constants :]
            own[:] = np.append(inputs.knots[piece], inputs.coefficients[piece])[: len(own)]
        following = stops.searchsorted(time, side="right")
        return float(stops[following]) if following < len(stops) else np.inf


@lru_cache(maxsize=32)
def compiled(structure: Structure, _thread: int) -> Compiled:
    """Return what is compiled for a structure and one thread, as an integrator holds its own state."""
    states = heyoka.make_vars(*[f"v{i}" for i in range(structure.width)], "unused")[:-1]
    parameters, constants = len(structure.pairs), len(structure.pairs) + len(structure.events)
    natural = [heyoka.exp(each) if j in structure.logarithmic else each for j, each in enumerate(states)]
    own = [heyoka.expression(0.0) if i is None else heyoka.par[i] for i in structure.inside]
    variables = [*natural, *_inputs(structure, constants), heyoka.time, *own]
    terms = [translated(term, variables) for term in structure.terms]
    sums: list[list[Any]] = [[] for _ in range(structure.equations)]
    for i, (equation, index) in enumerate(structure.pairs):
        if i not in structure.inside:
            sums[equation].append(heyoka.par[i] * terms[index])
    highest = [heyoka.sum(each) if each else heyoka.expression(0.0) for each in sums]
    highest = [each / natural[j] if j in structure.logarithmic else each for j, each in enumerate(highest)]
    rates = [*highest, *(highest[j] for j in structure.second)]
    for j, rate in zip(structure.second, states[structure.equations :], strict=True):
        rates[j] = rate
    system: Any = list(zip(states, rates, strict=True))
    initial_sensitivities = np.empty(0)
    if structure.sensitivities:
        system = heyoka.var_ode_sys(system, [*(heyoka.par[i] for i in structure.free), *states])
        initial_sensitivities = np.eye(len(states), len(structure.free) + len(states), len(structure.free)).ravel()
    terminal, found, events = _events(structure, variables)
    large = structure.sensitivities or parameters > _LARGE
    stepper = heyoka.taylor_adaptive(
        system,
        np.zeros(len(states)),
        tol=structure.tolerance,
        compact_mode=large,
        opt_level=1 if large else 0,
        **events,
    )
    return Compiled(stepper, len(states), constants, terminal, found, initial_sensitivities)


def _inputs(structure: Structure, first: int) -> list[Any]:
    """Return the inputs as polynomials, whose knot and coefficients are parameters from the index `first` on."""
    since, found = heyoka.time - heyoka.par[first], []
    for j in range(structure.inputs):
        value = heyoka.expression(0.0)
        for power in reversed(range(structure.powers)):
            value = value * since + heyoka.par[first + 1 + power * structure.inputs + j]
        found.append(value)
    return found


def _events(structure: Structure, variables: list[Any]) -> tuple[list[int], Found, dict[str, list[Any]]]:
    """Return the indices of terminal events, the list that others write to, and both as heyoka takes them."""
    found: Found = []
    width = structure.width

    def writer(index: int) -> Callable[[Any, float, int], None]:
        def write(stepper: Any, time: float, _: int) -> None:
            stepper.update_d_output(time)
            found.append((index, time, stepper.d_output[:width].copy()))

        return write

    passing, terminal, indices = [], [], []
    for i, (term, sign, ends) in enumerate(structure.events):
        crossed = translated(term, variables) - heyoka.par[len(structure.pairs) + i]
        if ends:
            terminal.append(heyoka.t_event(crossed, direction=heyoka.event_direction(sign)))
            indices.append(i)
        else:
            passing.append(heyoka.nt_event(crossed, writer(i), direction=heyoka.event_direction(sign)))
    lists = {"t_events": terminal, "nt_events": passing}
    return indices, found, {name: each for name, each in lists.items() if each}
