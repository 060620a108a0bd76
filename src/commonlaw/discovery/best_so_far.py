"""The best law of a search so far, which is shown as it comes, and is what is left if the time is over."""

from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from commonlaw.inference.fit.covariance import own_coefficients
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.score.score import Score
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Law
from commonlaw.library import Order
from commonlaw.runtime.progress import Interim, ProgressCallback
from commonlaw.runtime.time_limit import current_limit
from commonlaw.text import counted


class LawSoFar(Interim):
    """The best law of a search so far, in a line; the `law` itself has no standard errors yet."""

    law: Law

    @classmethod
    def of(cls, fit: Fit) -> "LawSoFar":
        """Return the law of a fit."""
        problem, schema = fit.problem, fit.problem.trials.schema
        template = problem.law
        uncertainty = replace(template.uncertainty, noise=problem.noise)
        law = replace(template, coefficients=own_coefficients(fit), uncertainty=uncertainty)
        listed = [
            model.residuals(mesh, states)
            for model, estimate in zip(problem.models, fit.estimates, strict=True)
            for mesh, states in zip(model.meshes, estimate.states, strict=True)
        ]
        columns = [column[np.isfinite(column)] for column in np.concatenate(listed).T]
        errors = " and ".join(
            f"{np.sqrt(np.mean(column**2)):.3g} {schema.units.get(name, '')}".rstrip() + f" ({name})"
            for name, column in zip(schema.states, columns, strict=True)
            if len(column)
        )
        about = f"{counted(fit.size, 'term')}, RMS residual {errors}{', with process noise' * fit.has_process_noise}"
        line = cls(f"best law so far: {'; '.join(law.structure)} ({about})")
        line.law = law
        return line


class _Candidate(Protocol):
    """A candidate of an order, see `commonlaw.discovery.candidate_search.Candidate`."""

    @property
    def pool(self) -> Pool: ...
    @property
    def score(self) -> Score: ...
    @property
    def order(self) -> Order: ...


class _Search(Protocol):
    """What finds candidates, see `commonlaw.discovery.candidate_search.CandidateSearch`."""

    @property
    def progress(self) -> ProgressCallback: ...


C = TypeVar("C", bound=_Candidate)
S = TypeVar("S", bound=_Search)


@dataclass(eq=False)
class Best(Generic[S, C]):
    """The best candidates of a search so far, the last of each order; in words what it left out, and has not tried."""

    search: S | None = None
    candidates: dict[Order, C] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    untried: tuple[str, ...] = ()

    def take(self, search: S, candidate: C) -> None:
        """Take a candidate in place of that of its order, and show it if it is another law, and the best."""
        before = self.candidate if self.candidates else None
        self.search, self.candidates[candidate.order] = search, candidate
        is_new = before is None or before.pool.best.model != candidate.pool.best.model
        if is_new and self.candidate is candidate:
            search.progress(LawSoFar.of(candidate.pool.best))
        limit = current_limit()
        if limit is not None:
            limit.take_result()

    def begin_again(self) -> None:
        """Forget what was found, and await the first law again."""
        self.candidates.clear()
        self.left_out.clear()
        limit = current_limit()
        if limit is not None:
            limit.await_result()

    @property
    def candidate(self) -> C:
        """The most probable candidate, with which a search ends; one that diverges only if there is no other."""
        return min(self.candidates.values(), key=lambda candidate: (candidate.pool.best.diverges, candidate.score))
