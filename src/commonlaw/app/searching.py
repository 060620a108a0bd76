"""Searches, each in a process of its own: the page stays alive, and what is cancelled ends at once."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from time import monotonic
from typing import Any

from commonlaw.app.question import Question, Table
from commonlaw.app.result import Found, found
from commonlaw.errors import CommonlawError

_CONTEXT = get_context("spawn")
"""A forked process would have the threads' locks of this one, and none of its threads."""


@dataclass
class Search:
    """A search that runs or has ended.

    Parameters
    ----------
    question
        What is asked.
    table
        The table that it is asked of.
    """

    question: Question
    table: Table
    stages: list[str] = field(default_factory=lambda: ["starting"])
    failure: str = ""
    found: Found | None = None

    def __post_init__(self) -> None:
        self._began = monotonic()
        self._connection, other = _CONTEXT.Pipe(duplex=False)
        self._process = _CONTEXT.Process(target=_work, args=(other, self.question, self.table), daemon=True)
        self._process.start()
        other.close()

    @property
    def is_running(self) -> bool:
        """Whether it goes on; takes in what the process has said."""
        while self._is_open and self._connection.poll():
            self._take()
        return self._is_open

    def cancel(self) -> None:
        """End it now, if it goes on."""
        if self.is_running:
            self._process.kill()
            self._close("cancelled")

    def state(self) -> dict[str, Any]:
        """Return what the page is told."""
        running = self.is_running
        seconds = round(monotonic() - self._began, 1)
        return {
            "running": running,
            "stages": self.stages,
            "seconds": seconds if running else None,
            "failure": self.failure,
            "found": None if self.found is None else self.found.shown,
        }

    @property
    def _is_open(self) -> bool:
        return not self._connection.closed

    def _take(self) -> None:
        try:
            kind, value = self._connection.recv()
        except (EOFError, pickle.UnpicklingError):
            self._process.join(1)
            self._close(
                f"the search ended by itself, with code {self._process.exitcode}: there may be too little memory"
            )
            return
        if kind == "stage":
            self.stages.append(value)
        elif kind == "failure":
            self._close(value)
        else:
            self.found = value
            self._close("")

    def _close(self, failure: str) -> None:
        self.failure = failure
        self._connection.close()


def _work(connection: Connection, question: Question, table: Table) -> None:
    """Search, and say how far it has come; the main function of the process."""

    def show(stage: str) -> None:
        connection.send(("stage", stage))

    try:
        connection.send(("found", _answer(question, table, show)))
    except CommonlawError as error:
        connection.send(("failure", str(error)))
    except MemoryError:
        connection.send(("failure", "there is not enough memory for this: take fewer trials or a smaller library"))


def _answer(question: Question, table: Table, show: Callable[[str], None]) -> Found:
    from commonlaw.discovery import discover
    from commonlaw.law import Law

    show("reading the table")
    trials = question.columns.trials(table)
    training = question.hold_out.training(trials)
    if question.law is not None:
        law = Law.from_json(question.law)
    else:
        law = discover(
            training,
            order=question.order,
            library=question.library,
            known=dict(question.known.items()),
            progress=show,
        )
        if question.explain:
            show("explaining coefficients")
            law = law.explain()
    return found(law, trials, training, show)
