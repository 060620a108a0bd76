"""A law, what was measured, and the functions that may be added to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.discrepancy.coordinates import Visited, with_properties_in, zero_in
from commonlaw.discrepancy.prior import Samples, factors, meaning
from commonlaw.discrepancy.smooth_basis import SmoothBasis
from commonlaw.discrepancy.trajectories import FunctionModel
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.search.setup import FitSetup
from commonlaw.inference.settings import MAX_MESH_POINTS
from commonlaw.law import Law
from commonlaw.library import Terms, highest_columns
from commonlaw.trials import Trials


@dataclass(frozen=True, eq=False)
class Setting:
    """A law whose terms are over all that functions may take, what was measured, and where it went."""

    law: Law
    problem: SearchProblem
    visited: Visited

    @classmethod
    def of(
        cls, law: Law, trials: Trials, texts: Sequence[str], noise: Mapping[str, float] | None, huber_threshold: float
    ) -> "Setting":
        """Return the setting for functions of some texts."""
        setup = FitSetup.of(law, trials, noise, huber_threshold)
        law, trials = with_properties_in(texts, setup.law, setup.trials)
        problem = replace(setup, law=law, trials=trials).problem()
        return cls(law, problem, Visited.of(problem, law.terms))

    @property
    def own(self) -> Bools:
        """Which coefficients are to be found, shape (equations, terms)."""
        return np.asarray(self.law.support & self.problem.allowed)

    @property
    def alone(self) -> FunctionModel:
        """The law without a function."""
        return FunctionModel(self.law.terms, self.own, np.zeros_like(self.own), (), 1.0)

    def with_function(self, basis: SmoothBasis, equation: int, zero_at: float | str | None) -> FunctionModel:
        """Return the law with a function in one equation."""
        law, visited = self.law, self.visited
        terms = Terms(law.terms.variables, (*law.terms.terms, *basis.terms(law.terms.variables)))
        shape = (len(law.states), len(basis))
        shared = np.zeros(shape, dtype=np.bool_)
        shared[equation] = True
        values, times = visited.evaluate(basis.coordinate), visited.evaluate(basis.times)
        matrix = law.terms.evaluate(visited.values)[:, self.own[equation]]
        samples = [Samples(values[own], times[own], matrix[own]) for own in visited.objects]
        kept = meaning(basis, samples, zero_in(basis, zero_at, law.schema.time))
        column = highest_columns(law.order, len(law.states))[equation]
        size = visited.rate_size(column) / np.sqrt(np.mean(times**2))
        return FunctionModel(
            terms,
            np.column_stack([self.own, np.zeros(shape, dtype=np.bool_)]),
            np.column_stack([np.zeros_like(self.own), shared]),
            factors(basis, kept.constraints),
            float(size),
            kept.zero_at,
            tuple(np.flatnonzero(self.own[equation])[list(kept.held)].tolist()),
        )

    def resolving(self, basis: SmoothBasis) -> "Setting":
        """Return the setting with meshes that are fine enough for bumps."""
        problem, step = self.problem, np.quantile(self.visited.steps(self.visited.evaluate(basis.coordinate)), 0.95)
        while problem.points < MAX_MESH_POINTS[1] and step > basis.width * problem.points / 2:
            problem = problem.finer()
        return replace(self, problem=problem)
