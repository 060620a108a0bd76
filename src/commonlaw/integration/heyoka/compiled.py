"""Laws compiled by heyoka: one structure, whatever the coefficients, the start and the levels of events."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import heyoka
import numpy as np

from commonlaw.array_types import Floats
from commonlaw.integration.event import event_terms
from commonlaw.integration.heyoka.translation import translated
from commonlaw.integration.initial_value_problem import InitialValueProblem, OutputOptions
from commonlaw.integration.vector_field import VectorField
from commonlaw.library import AbstractTerm

# A home that cannot be written to costs heyoka its cache on disk, and is nothing to tell a user of each time.
heyoka.set_logger_level_error()

Found = list[tuple[int, float, Floats]]

_LARGE = 100
"""Laws of more coefficients than this, and sensitivities, are compiled in heyoka's compact mode."""


@dataclass(frozen=True)
class Structure:
    """Everything that is compiled, and so nothing that differs between objects.

    Parameters
    ----------
    terms
        Those in some equation, over `size` variables, time the last.
    pairs
        Equation and index of the term of each coefficient, in the coefficients' order.
    free
        Which of these are parameters that sensitivities are wanted of; empty if none are wanted.
    equations, order, size
        How many equations, the order of the law, how many variables.
    events
        Expression, direction and whether it is terminal.
    tolerance, sensitivities
        As asked for.
    """

    terms: tuple[AbstractTerm, ...]
    pairs: tuple[tuple[int, int], ...]
    free: tuple[int, ...]
    equations: int
    order: int
    size: int
    events: tuple[tuple[AbstractTerm, int, bool], ...]
    tolerance: float
    sensitivities: bool

    @classmethod
    def of(cls, vector_field: VectorField, options: OutputOptions) -> "Structure":
        """Return the structure of a vector field without inputs."""
        used = np.flatnonzero(vector_field.kept.any(axis=0))
        variables = vector_field.terms.variables
        events = event_terms(options.events, variables).terms
        free = np.flatnonzero(vector_field.parameter_mask[vector_field.kept] & options.sensitivities)
        return cls(
            tuple(vector_field.terms.terms[k] for k in used),
            tuple((int(j), int(k)) for j, k in np.argwhere(vector_field.kept[:, used])),
            tuple(int(i) for i in free),
            len(vector_field.coefficients),
            vector_field.order,
            len(variables.names),
            tuple((term, each.sign, each.terminal) for term, each in zip(events, options.events, strict=True)),
            max(options.tolerance, float(np.finfo(float).eps)),
            options.sensitivities,
        )


@dataclass(frozen=True, eq=False)
class Compiled:
    """What heyoka made of a structure.

    Parameters
    ----------
    stepper
        heyoka's integrator, which holds parameters, state and time.
    width
        The number of states.
    terminal
        The indices of the terminal events among all events.
    found
        What the other events write to: index, time, states.
    initial_sensitivities
        The initial sensitivities, row by row; empty without.
    """

    stepper: Any
    width: int
    terminal: list[int]
    found: Found
    initial_sensitivities: Floats

    def start(self, problem: InitialValueProblem, levels: Floats) -> None:
        """Set parameters, state and time to the start of a problem."""
        self.stepper.pars[:] = np.concatenate([problem.field.coefficients[problem.field.kept], levels])
        self.reset(problem.start, np.concatenate([problem.initial, self.initial_sensitivities]))

    def reset(self, time: float, row: Floats) -> None:
        """Set time and state, and forget what was found."""
        self.stepper.time = time
        self.stepper.state[:] = row
        self.found.clear()
        if self.terminal:
            self.stepper.reset_cooldowns()


def compiled(structure: Structure) -> Compiled:
    """Return what was compiled for a structure; each thread has its own, since it holds a state.

    Raises
    ------
    UnsupportedError
        If the law or an event holds a function without Taylor series.
    """
    return _compiled(structure, threading.get_ident())


@lru_cache(maxsize=32)
def _compiled(structure: Structure, _thread: int) -> Compiled:
    """Compile a structure, for one thread: an integrator holds its own state."""
    states = heyoka.make_vars(*[f"v{i}" for i in range(structure.equations * structure.order)], "unused")[:-1]
    variables = [*states, heyoka.time]
    terms = [translated(term, variables) for term in structure.terms]
    sums: list[list[Any]] = [[] for _ in range(structure.equations)]
    for i, (equation, index) in enumerate(structure.pairs):
        sums[equation].append(heyoka.par[i] * terms[index])
    highest = [heyoka.sum(each) if each else heyoka.expression(0.0) for each in sums]
    rates = [*states[len(highest) :], *highest] if structure.order == 2 else highest
    system: Any = list(zip(states, rates, strict=True))
    parameters, initial_sensitivities = len(structure.pairs), np.empty(0)
    if structure.sensitivities:
        system = heyoka.var_ode_sys(system, [*(heyoka.par[i] for i in structure.free), *states])
        initial_sensitivities = np.hstack([np.zeros((len(states), len(structure.free))), np.eye(len(states))]).ravel()
    terminal, found, events = _events(structure, variables)
    large = structure.sensitivities or parameters > _LARGE
    stepper = heyoka.taylor_adaptive(
        system,
        np.zeros(len(states)),
        pars=np.zeros(parameters + len(structure.events)),
        tol=structure.tolerance,
        compact_mode=large,
        opt_level=1 if large else 0,
        **events,
    )
    return Compiled(stepper, len(states), terminal, found, initial_sensitivities)


def _events(structure: Structure, variables: list[Any]) -> tuple[list[int], Found, dict[str, list[Any]]]:
    """Return the indices of terminal events, the list that others write to, and both as heyoka takes them."""
    directions = {
        1: heyoka.event_direction.positive,
        -1: heyoka.event_direction.negative,
        0: heyoka.event_direction.any,
    }
    found: Found = []
    width = structure.equations * structure.order

    def writer(index: int) -> Callable[[Any, float, int], None]:
        def write(stepper: Any, time: float, _: int) -> None:
            stepper.update_d_output(time)
            found.append((index, time, stepper.d_output[:width].copy()))

        return write

    passing, terminal, indices = [], [], []
    for i, (term, sign, ends) in enumerate(structure.events):
        crossed = translated(term, variables) - heyoka.par[len(structure.pairs) + i]
        if ends:
            terminal.append(heyoka.t_event(crossed, direction=directions[sign]))
            indices.append(i)
        else:
            passing.append(heyoka.nt_event(crossed, writer(i), direction=directions[sign]))
    lists = {"t_events": terminal, "nt_events": passing}
    return indices, found, {name: each for name, each in lists.items() if each}
