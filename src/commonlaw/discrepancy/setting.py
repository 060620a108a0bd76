"""A law and where its trials went: what a discrepancy, a function of the variables there, is looked for about."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.discrepancy.smooth_basis import Samples, SmoothBasis, factors, meaning
from commonlaw.discrepancy.trajectories import FunctionFit, FunctionModel
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.library import Terms, Variables
from commonlaw.library.grammar import evaluate, read
from commonlaw.trials import Trials


@dataclass(frozen=True, eq=False)
class Visited:
    """Variables by name at all samples, shape (n, variables), where each trial begins, and each object's samples."""

    names: tuple[str, ...]
    values: Floats
    begins: tuple[int, ...]
    objects: tuple[slice, ...]

    @classmethod
    def of(cls, names: Sequence[str], objects: Sequence[Sequence[Floats]]) -> "Visited":
        """Return what each object visited in its trials, arrays of shape (n, variables)."""
        parts = [part for trials in objects for part in trials]
        ends = np.cumsum([0, *(sum(map(len, trials)) for trials in objects)]).tolist()
        begins = np.cumsum([0, *map(len, parts)])[:-1]
        slices = tuple(slice(*pair) for pair in pairwise(ends))
        return cls(tuple(names), np.concatenate(parts), tuple(begins.tolist()), slices)

    def evaluate(self, text: str) -> Floats:
        """Return an expression at all samples, shape (n,); raises `CommonlawError` where it is not finite."""
        tree = read(text, self.names)
        with np.errstate(all="ignore"):
            result: Floats = evaluate(tree, self.values.T) + np.zeros(len(self.values))
        if not np.isfinite(result).all():
            at = self.values[np.argmin(np.isfinite(result))]
            point = ", ".join(f"{name} = {value:g}" for name, value in zip(self.names, at, strict=True))
            raise CommonlawError("coordinate-not-finite", coordinate=text, point=point)
        return result

    def steps(self, values: Floats) -> Floats:
        """Return the sizes of the steps from sample to sample within trials."""
        return np.delete(abs(np.diff(values)), np.array(self.begins[1:], dtype=int) - 1)


class AbstractSetting(ABC):
    """A law that is fitted to trials, alone and together with functions."""

    law: Law
    visited: Visited

    @classmethod
    @abstractmethod
    def of(
        cls,
        law: Law,
        trials: Trials,
        texts: Sequence[str],
        noise: Mapping[str, float] | None,
        huber_threshold: float,
        /,
    ) -> Self:
        """Return the setting for functions of some texts, in which properties of the objects may stand."""

    @property
    @abstractmethod
    def variables(self) -> Variables:
        """What functions may be of: the variables of the law, and properties among their parameters."""

    @property
    @abstractmethod
    def own(self) -> Bools:
        """Which coefficients are to be found, shape (equations, terms)."""

    @abstractmethod
    def directions(self, equation: int) -> tuple[tuple[str, ...], Floats]:
        """Return the derivatives of a rate by what is to be found, shape (n, k), at all samples, and their names."""

    @abstractmethod
    def rates(self, equation: int) -> Floats:
        """Return the highest derivative of a state at all samples, shape (n,)."""

    @abstractmethod
    def annealed(self, model: FunctionModel) -> list[FunctionFit]:
        """Return the fits of a model at all model errors, from large ones to none."""

    def converged(self, fitted: FunctionFit) -> FunctionFit:
        """Return a fit after its trajectories have followed the coefficients until these converge."""
        return fitted

    @abstractmethod
    def value(self, alone: FunctionFit, model: FunctionModel) -> float:
        """Return minus twice the log-evidence of a model about trajectories of the law alone."""

    def resolving(self, basis: SmoothBasis) -> Self:
        """Return the setting with solutions that are fine enough for bumps."""
        return self

    @abstractmethod
    def given_deviance(self) -> float:
        """Return the sum of squared residuals over noise of the law as it was given, with free initial states."""

    @abstractmethod
    def refitted(self, law: Law, found: FunctionFit) -> tuple[Law, Law]:
        """Return a law with coefficients as they are with the function, and the law with the function as terms."""

    @property
    def alone(self) -> FunctionModel:
        """The law without a function."""
        return FunctionModel(self.law.terms, self.own, np.zeros_like(self.own), (), 1.0)

    def with_function(self, basis: SmoothBasis, equation: int, zero_at: float | str | None) -> FunctionModel:
        """Return the law with a function in one equation."""
        law, visited = self.law, self.visited
        terms = Terms(self.variables, (*law.terms.terms, *basis.terms(self.variables)))
        shape = (len(law.schema.states), len(basis))
        shared = np.zeros(shape, dtype=np.bool_)
        shared[equation] = True
        values, times = visited.evaluate(basis.coordinate), visited.evaluate(basis.times)
        names, matrix = self.directions(equation)
        samples = [Samples(values[name], times[name], matrix[name]) for name in visited.objects]
        if zero_at == "auto":
            margin = 0.25 * basis.range
            near = basis.low - margin <= 0.0 <= basis.high + margin
            zero_at = 0.0 if near and basis.coordinate != law.schema.time else None
        kept = meaning(basis, samples, None if zero_at is None else float(zero_at))
        size = float(np.sqrt(np.mean(self.rates(equation) ** 2))) / np.sqrt(np.mean(times**2))
        return FunctionModel(
            terms,
            np.column_stack([self.own, np.zeros(shape, dtype=np.bool_)]),
            np.column_stack([np.zeros_like(self.own), shared]),
            factors(basis, kept.constraints),
            float(size),
            kept.zero_at,
            tuple(names[k] for k in kept.held),
        )
