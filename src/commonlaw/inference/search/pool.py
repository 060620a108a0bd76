"""Fits of models to the same trials, of which the best is chosen."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.fit import PLAUSIBLE, Fit
from commonlaw.inference.score.score import Kind, Score
from commonlaw.law import Law
from commonlaw.law.parameters import standard_errors
from commonlaw.library import with_rates
from commonlaw.likelihood import variance_of_rates


@dataclass(frozen=True, eq=False)
class Pool:
    """Fits of different models to the same trials.

    Parameters
    ----------
    fits
        The best first, then its rivals. Those whose problem has a solver were chosen among plain terms.
    explored
        All that the search among plain terms came by, the largest evidence first.
    approximations
        Of laws with process noise: the fits of largest evidence under white noise, whose solutions fit best.
    is_approximation
        Whether the best was taken in place of a law with process noise, as its solutions explain more.

    Raises `CommonlawError` if the best fit failed.
    """

    fits: tuple[Fit, ...]
    explored: Sequence[Fit] = ()
    approximations: tuple[Fit, ...] = ()
    is_approximation: bool = False

    def __post_init__(self) -> None:
        if not self.best.is_usable:
            raise CommonlawError("no-law-near-measurements")

    @classmethod
    def of(cls, fits: Sequence[Fit], explored: Sequence[Fit] = (), approximations: Sequence[Fit] = ()) -> "Pool":
        """Return the pool of fits, the largest evidence first.

        Laws that are too fast for their steps, of those as likely as this, come last.
        """
        first, last = list[Fit](), list[Fit]()
        for fit in sorted(fits):
            near = len(fits) > 1 and (not first or fit.score - first[0].score < PLAUSIBLE)
            (last if near and not fit.follows_solutions else first).append(fit)
        return cls((*first, *last), explored, tuple(approximations))

    def joined(self, others: Sequence[Fit] = (), approximations: Sequence[Fit] = ()) -> "Pool":
        """Return the pool with other fits."""
        return Pool.of((*self.fits, *others), self.explored, (*self.approximations, *approximations))

    def with_best(self, fit: Fit) -> "Pool":
        """Return the pool with another fit in place of the best: the same law, on a finer mesh or chosen again."""
        return replace(self, fits=(fit, *self.fits[1:]))

    @property
    def best(self) -> Fit:
        """The fit that was chosen."""
        return self.fits[0]

    @property
    def rivals(self) -> tuple[Fit, ...]:
        """The others."""
        return self.fits[1:]

    @property
    def plain(self) -> Fit | None:
        """The best among plain terms, if any was chosen among these."""
        return next((fit for fit in self.fits if fit.problem.solver is not None), None)

    @property
    def chosen_by(self) -> str:
        """What the best was chosen by, in the words of the history of a law."""
        kind = self.best.score.kind
        if self.is_approximation and kind is Kind.EVIDENCE:
            return f"{kind} without process noise: solutions of the law with it explain whole trials less well"
        return kind

    def proposals(self) -> Iterator[Bools]:
        """Yield the supports of large evidence under the errors of the best, and those on the path of the solver."""
        best = self.best
        yield best.supports
        yield from (fit.supports for fit in self.explored[: settings.MAX_PROPOSED])
        equations, solver = range(len(best.supports)), best.problem.solver
        assert solver is not None
        for j, listed in zip(equations, best.neighbours(), strict=True):
            yield from (_exchanged(best.supports, j, own) for _, own in listed[: settings.MAX_PROPOSED])
        for j in equations:
            yield from (_exchanged(best.supports, j, own) for own in best.evidence.path(best.supports, j, solver))

    def law(self) -> Law:
        """Return the law of the best, with its coefficients and their errors."""
        return fitted_law(self.best.problem.law, self.best)

    @cached_property
    def is_determined(self) -> bool:
        """Whether no coefficient is within its error on average over objects, and no object has them all within errors.

        Evidence keeps a term for what it explains; where its coefficient is within its error nonetheless, others make
        up for it, and the likelihood has no maximum to speak of.
        """
        law = self.law()
        chosen = np.broadcast_to(self.best.supports, law.coefficients.shape)
        values, errors = law.coefficients[chosen], standard_errors(law)[chosen]
        ratios = np.divide(values, errors, out=np.full_like(values, np.inf), where=~(errors <= 0))
        squares = np.nan_to_num(ratios.reshape(len(law.objects), -1) ** 2, posinf=np.inf)
        of_terms, of_objects = squares.mean(axis=0), squares.max(axis=1, initial=0.0)
        return not squares.size or bool(min(*of_terms, *of_objects) > 1)


def _exchanged(supports: Bools, equation: int, support: Bools) -> Bools:
    """Return supports with another one of an equation, shape (terms,)."""
    changed = supports.copy()
    changed[equation] = support
    return changed


def score_of_order(fit: Fit) -> Score:
    """Return minus twice the log-evidence of a law, which compares with that of a law of another order.

    The evidence of a search is the density of all that was measured after the start of each segment, with any start
    being as likely: so of a law of first order. Rates at starts of states of second order are to be found besides.
    While one order is sought their distribution is one that says next to nothing, and narrows as meshes get coarser.
    Here it is the normal distribution about zero as wide as rates are in all trials (root mean square of smoothed
    rates). What the linearised likelihood promises away from the estimates counts as not there: of an order that does
    not suit, fits may get stuck in stiff laws.
    """
    problem, states = fit.problem, len(fit.problem.noise)
    score = fit.score.plus("Laplace correction", fit.predicted_decrease)
    if not len(with_rates(problem.order, states)):
        return score
    rates = np.concatenate([each[:, states:] for own in problem.smoothed for each in own])
    variances, price = np.nanmean(rates**2, axis=0), 0.0
    for model, estimate in zip(problem.models, fit.estimates, strict=True):
        for mesh, found, _ in model.parts(estimate):
            starts = found[mesh.first, states : model.width]
            price += float(np.sum(starts**2 / variances + np.log(variances / variance_of_rates(model, mesh))))
    return score.plus("initial conditions", price)
