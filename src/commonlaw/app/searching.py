"""Searches, and the laws of other terms that are asked for when they have ended."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from commonlaw.app.question import Question, Table
from commonlaw.app.result import SEARCHED, Found, ShownLaw, of_terms, results, support_of
from commonlaw.app.working import Work
from commonlaw.errors import CommonlawError
from commonlaw.runtime.progress import part


@dataclass(eq=False)
class Search:
    """A search that runs or has ended.

    Parameters
    ----------
    question
        What is asked.
    table
        The table that it is asked of.
    fits
        Of laws of other terms, in the order in which they were asked for; only the last may go on.
    """

    question: Question
    table: Table
    fits: list[Work[ShownLaw]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._work = Work(partial(answer, self.question, self.table))

    @property
    def is_running(self) -> bool:
        """Whether it, or a fit, goes on."""
        return self._work.is_running or self.is_fitting

    @property
    def is_fitting(self) -> bool:
        """Whether a fit goes on."""
        return any(each.is_running for each in self.fits[-1:])

    @property
    def found(self) -> Found:
        """What it found so far, with the laws that were fitted since.

        Raises
        ------
        CommonlawError
            If there is no law yet.
        """
        if self._work.made is None:
            raise CommonlawError("no-law-yet")
        return self._work.made.with_laws(each.made for each in self.fits if not each.is_running and each.made)

    def fit_terms(self, terms: Sequence[Sequence[str]]) -> None:
        """Begin to fit the law of these terms, those of each equation, in place of one that is being fitted."""
        if self._work.is_running:
            raise CommonlawError("candidates-running")
        found = self.found
        support = support_of(found.law, terms)
        self.cancel_fit()
        self.fits.append(Work(partial(of_terms, found.without_page(), support)))

    def cancel(self) -> None:
        """End all that goes on."""
        self._work.cancel()
        self.cancel_fit()

    def close(self) -> None:
        """End all that goes on, and wait until its processes are gone."""
        self._work.close()
        for each in self.fits:
            each.close()

    def cancel_fit(self) -> None:
        """End the fit of a law of other terms, if one goes on."""
        for each in self.fits[-1:]:
            each.cancel()

    def state(self) -> dict[str, Any]:
        """Return what the page is told."""
        return self._work.state() | {"fitting": self.is_fitting}

    def fit_state(self) -> dict[str, Any]:
        """Return what the page is told of the law of other terms asked for last; when it is there, where it stands."""
        if not self.fits:
            raise CommonlawError("no-other-terms")
        return self.fits[-1].state() | {"at": len(self.found.candidates) - 1}


def answer(question: Question, table: Table, show: Callable[[str], None]) -> Iterator[Found]:
    """Yield what a question asked of a table finds, with more and more candidates; the work of a search."""
    from commonlaw.discovery import discover
    from commonlaw.law import Law

    show("reading the table")
    trials = table.trials(question.columns)
    training = question.hold_out.training(trials)
    if question.law is not None:
        law = Law.from_json(question.law)
    else:
        law = discover(
            training,
            order=question.order,
            library=question.library,
            known=dict(question.known.items()),
            progress=part(show, 0.0, SEARCHED),
        )
        if question.explain:
            show("explaining coefficients")
            law = law.explain()
    yield from results(law, trials, training, show)
