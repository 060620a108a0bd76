"""What the server keeps for its pages: tables and searches, the latest of each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from secrets import token_hex
from threading import Lock
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
            raise CommonlawError("session-gone", part=self.what)
        return self.values[name]


@dataclass
class Sessions:
    """All that the pages of a server have; what begins is counted and begun in one step, also when many ask at once."""

    tables: Kept[Table] = field(default_factory=lambda: Kept("table", _TABLES, lambda _: None))
    searches: Kept[Search] = field(default_factory=lambda: Kept("search", _SEARCHES, Search.cancel))
    latest: dict[str, str] = field(default_factory=dict)
    """Names of the table and the search that were begun last, where a new page goes on."""
    _beginning: Lock = field(default_factory=Lock)
    _is_open: bool = True

    def open_table(self, table: Table) -> str:
        """Keep a table, and return its name."""
        with self._beginning:
            name = self.tables.add(table)
            self.latest = {"table": name}
        return name

    def search(self, question: Question) -> str:
        """Begin a search, and return its name.

        Raises
        ------
        CommonlawError
            If its table is not there, or too many searches run.
        """
        with self._beginning:
            table = self.tables.get(question.table)
            self._check_room(())
            name = self.searches.add(Search(question, table))
            self.latest = {"table": question.table, "search": name}
        return name

    def fit_terms(self, name: str, terms: Sequence[Sequence[str]]) -> None:
        """Begin to fit a law of other terms to what a search was asked of.

        Raises
        ------
        CommonlawError
            If the search is not there or has no law, there are no such terms, or too many searches run.
        """
        with self._beginning:
            search = self.searches.get(name)
            self._check_room((search,))
            search.fit_terms(terms)

    def _check_room(self, but: Sequence[Search]) -> None:
        running = [each for each in self.searches.values.values() if each not in but and each.is_running]
        if len(running) >= _AT_ONCE:
            raise CommonlawError("too-many-searches", limit=_AT_ONCE)
        if not self._is_open:
            raise CommonlawError("app-ending")

    def close(self) -> None:
        """End all that goes on, and begin nothing more."""
        with self._beginning:
            self._is_open = False
            searches = [*self.searches.values.values()]
        for each in searches:
            each.cancel()
        for each in searches:
            each.close()
