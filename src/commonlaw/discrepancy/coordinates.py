"""Coordinates that a discrepancy may be a function of, as texts and as values at all samples."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.discrepancy.smooth_basis import SmoothBasis
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.verbs.comparison import written_alike
from commonlaw.law import Law
from commonlaw.library import Terms, Variables
from commonlaw.library.grammar import columns_in, evaluate, read, with_names, write
from commonlaw.library.notation import quoted
from commonlaw.trials import Trials
from commonlaw.trials.property_inputs import with_property_inputs
from commonlaw.trials.trial import property_names

_NEAR = 0.25
"""Zero is near the visited range if it is this share of it away."""


@dataclass(frozen=True, eq=False)
class Visited:
    """The variables at all samples, shape (n, variables), where each trial begins, and each object's samples."""

    variables: Variables
    values: Floats
    begins: tuple[int, ...]
    objects: tuple[slice, ...]

    @classmethod
    def of(cls, problem: SearchProblem, terms: Terms) -> "Visited":
        """Return what was visited, by smoothed measurements."""
        names, parts, ends = problem.trials.objects, list[Floats](), [0]
        for name, curves in zip(names, problem.smoothed, strict=True):
            for trial, states in zip(problem.trials.of_object(name), curves, strict=True):
                parts.append(np.column_stack([states, trial.inputs, trial.times]))
            ends.append(sum(map(len, parts)))
        begins = np.cumsum([0, *map(len, parts)])[:-1]
        values = terms.variables.natural(np.concatenate(parts))
        return cls(terms.variables, values, tuple(begins.tolist()), tuple(slice(*pair) for pair in pairwise(ends)))

    def evaluate(self, text: str) -> Floats:
        """Return an expression at all samples, shape (n,).

        Raises
        ------
        CommonlawError
            If it is not finite at a sample.
        """
        tree = read(text, self.variables.names)
        with np.errstate(all="ignore"):
            found: Floats = evaluate(tree, self.values.T) + np.zeros(len(self.values))
        if not np.isfinite(found).all():
            at = self.values[np.argmin(np.isfinite(found))]
            point = ", ".join(f"{name} = {value:g}" for name, value in zip(self.variables.names, at, strict=True))
            raise CommonlawError("coordinate-not-finite", coordinate=text, point=point)
        return found

    def steps(self, values: Floats) -> Floats:
        """Return the sizes of the steps from sample to sample within trials."""
        found = abs(np.diff(values))
        return np.delete(found, np.array(self.begins[1:], dtype=int) - 1)

    def rate_size(self, column: int) -> float:
        """Return the root mean square of the derivative of a smoothed state, or of its rate, by differences."""
        parts = np.split(self.values[:, [column, -1]], self.begins[1:])
        rates = np.concatenate([np.gradient(part[:, 0], part[:, 1]) for part in parts])
        return float(np.sqrt(np.mean(rates**2)))


def basis_of(visited: Visited, coordinate: str, times: str) -> SmoothBasis:
    """Return the smooth functions of a coordinate over what was visited.

    Raises
    ------
    CommonlawError
        If the coordinate does not change.
    """
    values = visited.evaluate(coordinate)
    low, high = float(values.min()), float(values.max())
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        raise CommonlawError("coordinate-constant", coordinate=coordinate, value=low)
    return SmoothBasis(coordinate, times, low, high)


def zero_in(basis: SmoothBasis, zero_at: float | str | None, time: str) -> float | None:
    """Return where a function is to be zero, see `Law.discrepancy`, None if nowhere."""
    if zero_at != "auto":
        return None if zero_at is None else float(zero_at)
    near = basis.low - _NEAR * basis.range <= 0.0 <= basis.high + _NEAR * basis.range
    return 0.0 if near and basis.coordinate != time else None


def with_properties_in(texts: Sequence[str], law: Law, trials: Trials) -> tuple[Law, Trials]:
    """Return law and trials with the properties that occur in texts as inputs that do not change.

    Raises
    ------
    CommonlawError
        If a text cannot be read, or names what is neither a variable nor a property.
    """
    own = law.terms.variables.names
    names = [*own, *(name for name in property_names(trials.properties) if name not in own)]
    used = {names[i] for text in texts for i in columns_in(write(read(text, names)))}
    taken = [name for name in names[len(own) :] if name in used]
    trials = with_property_inputs(trials, taken)
    wider = replace(law.schema, inputs=(*law.schema.inputs, *taken))
    return written_alike(law, wider), trials


def expression(text: str, names: Sequence[str]) -> str:
    """Return a text as terms are written, so that it can stand in one."""
    return with_names(write(read(text, names)), [quoted(name) for name in names])


def with_known_properties(trials: Trials, law: Law) -> Trials:
    """Return trials with what the law knows of their objects beside what they know themselves."""
    known = {name: {**law.properties.get(name, {}), **trials.properties.get(name, {})} for name in trials.objects}
    return replace(trials, properties=known)
