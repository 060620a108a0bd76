"""What the server keeps for its pages: tables and searches, the latest of each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from secrets import token_hex
from typing import Generic, TypeVar

from commonlaw.app.question import Question, Table
from commonlaw.app.searching import Search
from commonlaw.errors import CommonlawError

T = TypeVar("T")

_TABLES, _SEARCHES, _AT_ONCE = 12, 12, 3
"""Tables and searches that are kept, and searches that run at the same time."""


@dataclass
class Kept(Generic[T]):
    """Values by a name that nobody can guess; the oldest go when there are too many."""

    what: str
    most: int
    drop: Callable[[T], None]
    values: dict[str, T] = field(default_factory=dict)

    def add(self, value: T) -> str:
        """Keep a value, and return its name."""
        while len(self.values) >= self.most:
            self.drop(self.values.pop(next(iter(self.values))))
        name = token_hex(8)
        self.values[name] = value
        return name

    def get(self, name: str) -> T:
        """Return the value of a name.

        Raises
        ------
        CommonlawError
            If it is not kept, or no longer.
        """
        if name not in self.values:
            raise CommonlawError(f"this {self.what} is no longer here: open the table again")
        return self.values[name]


@dataclass
class Sessions:
    """All that the pages of a server have."""

    tables: Kept[Table] = field(default_factory=lambda: Kept("table", _TABLES, lambda _: None))
    searches: Kept[Search] = field(default_factory=lambda: Kept("search", _SEARCHES, Search.cancel))

    def search(self, question: Question) -> str:
        """Begin a search, and return its name.

        Raises
        ------
        CommonlawError
            If its table is not there, or too many searches run.
        """
        table = self.tables.get(question.table)
        self._check_room(())
        return self.searches.add(Search(question, table))

    def fit_terms(self, name: str, terms: Sequence[Sequence[str]]) -> None:
        """Begin to fit a law of other terms to what a search was asked of.

        Raises
        ------
        CommonlawError
            If the search is not there or has no law, there are no such terms, or too many searches run.
        """
        search = self.searches.get(name)
        self._check_room((search,))
        search.fit_terms(terms)

    def _check_room(self, but: Sequence[Search]) -> None:
        running = [each for each in self.searches.values.values() if each not in but and each.is_running]
        if len(running) >= _AT_ONCE:
            raise CommonlawError(f"{_AT_ONCE} searches run already: wait for one of them, or cancel it")

    def close(self) -> None:
        """End all that goes on."""
        for each in self.searches.values.values():
            each.cancel()
