"""The fits of all models to the same trials, ranked by their scores."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.fit import PLAUSIBLE, Fit
from commonlaw.law.parameters import standard_errors
from commonlaw.runtime.forking import cached_property


@dataclass(frozen=True, eq=False)
class Pool:
    """Fits of different models to the same trials, the best first, then its rivals.

    Those whose problem has a solver were selected among plain terms; `explored` are all fits of that search, the
    largest evidence first. If the best has process noise, `deterministic` are those of largest evidence without.
    The best `is_approximation` if it is one of these, as it forecasts better.

    Raises `CommonlawError` if the best fit failed.
    """

    fits: tuple[Fit, ...]
    explored: Sequence[Fit] = ()
    deterministic: tuple[Fit, ...] = ()
    is_approximation: bool = False

    def __post_init__(self) -> None:
        if not self.best.is_usable:
            raise CommonlawError("no-law-near-measurements")

    @classmethod
    def of(cls, fits: Sequence[Fit], explored: Sequence[Fit] = (), deterministic: Sequence[Fit] = ()) -> "Pool":
        """Return the pool of fits, the largest evidence first.

        Plausible laws too stiff for their mesh come last.
        """
        first, last = list[Fit](), list[Fit]()
        for fit in sorted(fits):
            near = len(fits) > 1 and (not first or fit.score - first[0].score < PLAUSIBLE)
            (last if near and not fit.is_resolved else first).append(fit)
        return cls((*first, *last), explored, tuple(deterministic))

    def joined(self, *fits: Fit, deterministic: Sequence[Fit] = ()) -> "Pool":
        return Pool.of((*self.fits, *fits), self.explored, (*self.deterministic, *deterministic))

    def with_best(self, fit: Fit) -> "Pool":
        """Return the pool with the best fit replaced: the same law on a finer mesh, or with supports selected again."""
        return replace(self, fits=(fit.with_steps(fit.steps or self.best.steps), *self.fits[1:]))

    @property
    def best(self) -> Fit:
        return self.fits[0]

    @property
    def rivals(self) -> tuple[Fit, ...]:
        return self.fits[1:]

    @property
    def plain(self) -> Fit | None:
        """The best fit selected among plain terms, if there is one."""
        return next((fit for fit in self.fits if fit.problem.solver is not None), None)

    @property
    def chosen_by(self) -> str:
        """The criterion by which the best was chosen, as recorded in the history."""
        return self.best.score.kind

    def proposals(self) -> Iterator[Bools]:
        """Yield supports of large evidence under the error model of the best, and those on the path of the solver."""
        best, solver = self.best, self.best.problem.solver
        assert solver is not None
        yield best.supports
        yield from (fit.supports for fit in self.explored[: settings.MAX_PROPOSED])
        near = [[support for _, support in listed[: settings.MAX_PROPOSED]] for listed in best.neighbours()]
        paths = [best.evidence.path(best.supports, j, solver) for j in range(len(best.supports))]
        for j, support in (
            (j, proposed) for group in (near, paths) for j, listed in enumerate(group) for proposed in listed
        ):
            supports = best.supports.copy()
            supports[j] = support
            yield supports

    @cached_property
    def is_determined(self) -> bool:
        """Whether each coefficient exceeds its standard error (RMS over objects), and in each object at least one does.

        A term is kept for what it explains. If its coefficient is smaller than its standard error all the same, terms
        are collinear and the likelihood is flat along a combination of them.
        """
        law = fitted_law(self.best.problem.law, self.best)
        chosen = np.broadcast_to(self.best.supports, law.coefficients.shape)
        values, errors = law.coefficients[chosen], standard_errors(law)[chosen]
        ratios = np.divide(values, errors, out=np.full_like(values, np.inf), where=~(errors <= 0))
        squares = np.nan_to_num(ratios.reshape(len(law.objects), -1) ** 2, posinf=np.inf)
        of_terms, of_objects = squares.mean(axis=0), squares.max(axis=1, initial=0.0)
        return not squares.size or bool(min(*of_terms, *of_objects) > 1)
