"""Subsets of terms: one by one in or out (stepwise selection), and the best of every number (exact search)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from commonlaw.array_types import Bools, Indices
from commonlaw.errors import check_choice
from commonlaw.runtime.arguments import check_whole_number
from commonlaw.solvers.base import (
    AbstractSolver,
    Candidates,
    Directions,
    Problems,
    StandardizedProblem,
    Subset,
    Values,
    check_shared,
    fixed_cardinality,
)


@dataclass(frozen=True)
class StepwiseSelection(AbstractSolver):
    """Forward selection or backward elimination, one term in each step.

    Forward, the term that lowers the squared residuals most enters: orthogonal least squares (FROLS; Chen, Billings,
    Luo 1989, Int. J. Control 50, 1873; Billings 2013, Nonlinear System Identification, section 3.2). Backward, the term
    whose leaving raises them least leaves: the stepwise sparse regressor of Boninsegna, Nüske, Clementi (2018), J.
    Chem. Phys. 148, 241723, with the rise of the squared residuals after a refit, which does not depend on units, in
    place of the magnitude of the coefficient. Objects are summed relative to their residual variances, see
    `StandardizedProblem`.

    Raises `CommonlawError` if an argument does not fit.

    Parameters
    ----------
    terms
        Number of terms in each equation; None to have it chosen.
    direction
        ``"forward"`` from no terms, or ``"backward"`` from all of them.
    shared
        Whether all objects have the same terms, or each object its own.
    """

    terms: int | None = None
    direction: Literal["forward", "backward"] = "forward"
    shared: bool = True

    hyperparameter_name = "terms"

    def __post_init__(self) -> None:
        check_whole_number("terms", self.terms, 1, optional=True)
        check_shared(self.shared)
        check_choice("direction", self.direction, ("forward", "backward"))

    def path(self, problems: Problems, target: int, allowed: Bools, values: Values = None) -> Candidates:
        return fixed_cardinality(self._choose, self.shared, problems, target, allowed, values)

    def _choose(self, problem: StandardizedProblem, sizes: Sequence[int]) -> dict[int, Subset]:
        is_forward = self.direction == "forward"
        order = forward_order(problem, max(sizes)) if is_forward else backward_order(problem, min(sizes))
        return {size: Subset(order[:size]) for size in sizes}


def forward_order(problem: StandardizedProblem, terms: int) -> Indices:
    """Return the indices of the first terms that enter, in their order."""
    directions, order = problem.entering, np.zeros(0, dtype=np.intp)
    while len(order) < terms:
        index = int(np.argmax(directions.error_reductions))
        order = np.append(order, directions.indices[index])
        directions = directions.take(index)
    return order


def backward_order(problem: StandardizedProblem, least: int = 0) -> Indices:
    """Return the indices of all terms, those that stay longest first, as found on the way down to `least` terms."""
    directions, gone = problem.leaving, np.zeros(0, dtype=np.intp)
    while len(directions.indices) > least:
        index = int(np.argmin(directions.error_reductions))
        gone = np.append(directions.indices[index], gone)
        directions = directions.take(index)
    return np.concatenate([directions.indices, gone])


@dataclass(frozen=True)
class BestSubset(AbstractSolver):
    """The terms with the smallest sum of squared residuals over all objects, for every number of terms.

    Exact by branch and bound, as the leaps and bounds of Furnival and Wilson (1974), Technometrics 16, 499: leaving out
    terms only raises the residuals, so the residual of all terms that are still open bounds all supports among them. A
    candidate is ``proven`` when the search of its size ended. Objects count relative to their residual variance, see
    `StandardizedProblem`. For about 60 terms this takes seconds; sizes well beyond the true one use up their nodes.

    Raises `CommonlawError` if an argument does not fit.

    Parameters
    ----------
    terms
        Number of terms in each equation; None to have it chosen.
    shared
        Whether all objects have the same terms, or each object its own.
    largest
        The path is searched up to this number of terms; above it is backward elimination, see `StepwiseSelection`.
    nodes
        At most so many nodes of the search tree for each number of terms (2000 take about a second for 56 terms and 10
        objects), fewer beyond 60 terms, and half as many after a number that used up its nodes; then the best terms so
        far are returned, of greedy selection and exchanges at least.
    """

    terms: int | None = None
    shared: bool = True
    largest: int = 12
    nodes: int = 2000

    hyperparameter_name = "terms"

    def __post_init__(self) -> None:
        check_whole_number("terms", self.terms, 1, optional=True)
        check_whole_number("largest", self.largest, 0)
        check_whole_number("nodes", self.nodes, 1)
        check_shared(self.shared)

    def path(self, problems: Problems, target: int, allowed: Bools, values: Values = None) -> Candidates:
        largest = self.largest if values is None else np.inf

        def choose(problem: StandardizedProblem, sizes: Sequence[int]) -> dict[int, Subset]:
            searched, stays = [size for size in sizes if size <= largest], backward_order(problem)
            subsets = {size: Subset(stays[:size], size == problem.size) for size in sizes if size > largest}
            enters = forward_order(problem, max(searched))
            # The work of a node grows with the third power of the terms
            nodes = int(np.ceil(self.nodes * min(1.0, (60 / max(problem.size, 1)) ** 3)))
            for size in sorted(searched):
                subsets[size] = _Search(problem, size, [stays[:size], enters[:size]]).run(nodes)
                # The tree grows with the size: where one used up its nodes, the next would need more
                nodes = nodes if subsets[size].proven else -(-nodes // 2)
            return subsets

        return fixed_cardinality(choose, self.shared, problems, target, allowed, values)


@dataclass(frozen=True, eq=False)
class _Node:
    """All supports with the terms `inside` and some open ones, of which `bound` is the residual with all.

    `entering` is what open terms add to those inside, `leaving` what their leaving costs, in the same order.
    """

    inside: Indices
    entering: Directions
    leaving: Directions
    bound: float


class _Search:
    """The search for the best support of one size, from the best of some supports to begin with."""

    def __init__(self, problem: StandardizedProblem, size: int, starts: Sequence[Indices]) -> None:
        self.problem, self.size = problem, size
        self.best = min(starts, key=problem.residual)
        self.least = problem.residual(self.best)
        while self._accept(self._swaps()):
            pass

    def run(self, nodes: int) -> Subset:
        """Search depth first, through at most so many nodes."""
        waiting = [_Node(self.best[:0], self.problem.entering, self.problem.leaving, self.problem.rest)]
        for _ in range(nodes):
            if not waiting:
                break
            waiting += self._branch(waiting.pop())
        return Subset(np.sort(self.best), proven=not waiting, converged=not waiting)

    @property
    def _bar(self) -> float:
        """What a support must stay below to be better than the best so far, beyond rounding."""
        return self.least * (1 - 1e-12) - self.problem.rounding

    def _accept(self, supports: Iterator[Indices]) -> bool:
        """Take the first support that is better than the best so far."""
        for support in supports:
            value = self.problem.residual(support)
            if value < self._bar:
                self.best, self.least = support, value
                return True
        return False

    def _swaps(self) -> Iterator[Indices]:
        """Yield supports in which one term of the best is replaced by the one that then explains most."""
        for stay in (np.delete(self.best, index) for index in range(self.size)):
            yield np.append(stay, self.problem.best_entering(stay))

    def _branch(self, node: _Node) -> list[_Node]:
        """Decide on the term whose leaving would cost most, or close the node."""
        costs, open_ = node.leaving.error_reductions, node.leaving.indices
        need = self.size - len(node.inside)
        surplus = len(open_) - need
        # Of the terms in question `surplus` must leave, together at no less cost than the most expensive of them alone.
        cheapest = np.sort(costs)[surplus - 1] if surplus else 0.0
        if node.bound + cheapest >= self._bar:
            return []
        if min(need, surplus) <= 2:
            self._accept(iter([np.concatenate([node.inside, _best_of_few(node, need, surplus)])]))
            return []
        top = int(np.argmax(costs))
        inside = np.append(node.inside, open_[top])
        children = [_Node(inside, node.entering.take(top), node.leaving.drop(top), node.bound)]
        bound = node.bound + costs[top]
        if bound < self._bar:
            children.append(_Node(node.inside, node.entering.drop(top), node.leaving.take(top), bound))
        return children


def _best_of_few(node: _Node, need: int, surplus: int) -> Indices:
    """Return which terms in question to take in where that, or what must leave, is at most two terms."""
    open_ = node.entering.indices
    entering = need <= surplus
    few, directions, best = (need, node.entering, np.argmax) if entering else (surplus, node.leaving, np.argmin)
    indices = open_[:0]
    if few == 1:
        indices = open_[[best(directions.error_reductions)]]
    elif few == 2:
        pairs = np.stack(np.triu_indices(len(open_), 1))
        indices = open_[pairs[:, best(directions.pair_error_reductions()[*pairs])]]
    return indices if entering else np.setdiff1d(open_, indices)
