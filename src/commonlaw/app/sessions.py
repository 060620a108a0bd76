"""Tables and searches that the server keeps for its pages, and sessions on disk, which outlive the app."""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from secrets import token_hex
from threading import Lock
from typing import Any, Generic, TypeVar

import msgspec

from commonlaw.app.question import Columns, Question, Table, check_lengths, message, named
from commonlaw.app.result import Found, ShownLaw, of_terms, results, support_of
from commonlaw.app.working import Work
from commonlaw.errors import CommonlawError
from commonlaw.law import from_json, to_json
from commonlaw.law.law import shares_terms
from commonlaw.runtime.files import make_folder, one_writer, read_file, read_json, remove_file, write_whole
from commonlaw.runtime.fit_options import FitOptions, read_settings
from commonlaw.runtime.progress import part


@dataclass(eq=False)
class Search:
    """A search that runs or has ended: what is asked of a table."""

    question: Question
    table: Table
    fits: list[Work[ShownLaw]] = field(default_factory=list)
    """Of laws of other terms, in the order in which they were asked for; only the last may go on."""
    law: str | None = None
    """The law that it found before, if it was saved since."""

    def __post_init__(self) -> None:
        self._work = Work(partial(answer, self.question, self.table, self.law))

    @property
    def is_running(self) -> bool:
        """Whether it, or a fit, goes on."""
        return self._work.is_running or self.is_fitting

    @property
    def is_fitting(self) -> bool:
        """Whether a fit goes on."""
        return any(fit.is_running for fit in self.fits[-1:])

    @property
    def made(self) -> Found | None:
        """What it found so far, without laws that were fitted since."""
        return self._work.made

    @property
    def found(self) -> Found:
        """What it found so far, with the laws that were fitted since.

        Raises `CommonlawError` if there is no law yet.
        """
        if self._work.made is None:
            raise CommonlawError("no-law-yet")
        return self._work.made.with_laws(fit.made for fit in self.fits if not fit.is_running and fit.made)

    def fit_terms(self, terms: Sequence[Sequence[str]]) -> None:
        """Begin to fit the law of these terms, those of each equation, in place of one that is being fitted."""
        if self._work.is_running:
            raise CommonlawError("candidates-running")
        result = self.found
        support = support_of(result.law, terms)
        self.cancel_fit()
        # What the page is sent is large
        self.fits.append(Work(partial(of_terms, replace(result, about={}, candidates=()), support)))

    def stop(self) -> None:
        """Let the search end with its best law so far."""
        self._work.stop()

    def cancel(self) -> None:
        """End all that goes on."""
        self._work.cancel()
        self.cancel_fit()

    def close(self) -> None:
        """End all that goes on, and wait until its processes are gone."""
        self._work.close()
        for fit in self.fits:
            fit.close()

    def cancel_fit(self) -> None:
        """End the fit of a law of other terms, if one goes on."""
        for fit in self.fits[-1:]:
            fit.cancel()

    def state(self) -> dict[str, Any]:
        """Return what is sent to the page."""
        return self._work.state() | {"fitting": self.is_fitting}

    def fit_state(self) -> dict[str, Any]:
        """Return what is sent to the page about the last law of other terms: its progress, and then where it is."""
        if not self.fits:
            raise CommonlawError("no-other-terms")
        return self.fits[-1].state() | {"at": len(self.found.candidates) - 1}


def answer(question: Question, table: Table, known: str | None, show: Callable[[str], None]) -> Iterator[Found]:
    """Yield what a question asked of a table finds, with more and more candidates; or of a known law."""
    from commonlaw.discovery import discover

    searching, finishing = part(show, 0.0, 0.5), part(show, 0.5, 1.0)
    show("reading the table")
    trials = table.trials(question.columns)
    training = question.hold_out.training(trials)
    if (given := known or question.law) is not None:
        law = from_json(given)
    elif question.equations is not None:
        law = question.equations.fit(training, question.fit_settings | {"progress": searching})
    else:
        law = discover(
            training,
            order=question.order,
            library=question.library,
            method=question.method,
            known=dict(question.known.items()),
            progress=searching,
            time_limit=question.time_limit,
        )
        if question.explain:
            show("explaining coefficients")
            law = law.explain()
    yield from results(law, trials, training, finishing)


T = TypeVar("T")


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

        Raises `CommonlawError` if it is not kept, or no longer.
        """
        if name not in self.values:
            raise CommonlawError("session-gone", part=self.what)
        return self.values[name]


@dataclass
class Sessions:
    """All that the pages of a server have; what begins is counted and begun in one step, also when many ask at once."""

    tables: Kept[Table] = field(default_factory=lambda: Kept("table", 12, lambda _: None))
    searches: Kept[Search] = field(default_factory=lambda: Kept("search", 12, Search.cancel))
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

    def search(self, question: Question, law: str | None = None) -> str:
        """Begin a search, or show the law that it found before, and return its name.

        Raises `CommonlawError` if its table is not there, a setting does not fit, or too many searches run.
        """
        FitOptions(**read_settings(FitOptions, question.settings))  # Refuses those that do not fit
        with self._beginning:
            table = self.tables.get(question.table)
            self._check_room(())
            name = self.searches.add(Search(question, table, law=law))
            self.latest = {"table": question.table, "search": name}
        return name

    def laws(self) -> list[dict[str, Any]]:
        """Return the laws that searches found, each with its table, the first of them first."""
        return [
            {
                "search": name,
                "table": search.question.table,
                "text": "; ".join(made.law.structure if shares_terms(made.law) else ("equations by object",)),
            }
            for name, search in [*self.searches.values.items()]
            if (made := search.made) is not None
        ]

    def fit_terms(self, name: str, terms: Sequence[Sequence[str]]) -> None:
        """Begin to fit a law of other terms to what a search was asked of.

        Raises `CommonlawError` if the search is not there or has no law, there are no such terms, or too many searches
        run.
        """
        with self._beginning:
            search = self.searches.get(name)
            self._check_room((search,))
            search.fit_terms(terms)

    def _check_room(self, but: Sequence[Search]) -> None:
        running = [value for value in self.searches.values.values() if value not in but and value.is_running]
        if len(running) >= 3:
            raise CommonlawError("too-many-searches", limit=3)
        if not self._is_open:
            raise CommonlawError("app-ending")

    def close(self) -> None:
        """End all that goes on, and begin nothing more."""
        with self._beginning:
            self._is_open = False
            searches = [*self.searches.values.values()]
        for end in (Search.cancel, Search.close):
            for search in searches:
                end(search)


FOLDER = "COMMONLAW_SESSIONS"
"""Environment variable that names the folder of sessions; by default that of the user's data."""
_KEY = re.compile("[0-9a-f]{16}")
LARGEST_SESSION = 2**28
"""Bytes of a session: four times those of a request, as a table in JSON takes a third more, and laws come with it."""


class State(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What a session shows: how its table is read, what was asked, and the law that was found."""

    columns: Columns
    question: Question | None = None
    law: str | None = None


class Session(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A table by a name, with the states that were saved, the present one last."""

    name: str
    saved: str
    table: Table
    states: tuple[State, ...]


class Named(msgspec.Struct, forbid_unknown_fields=True):
    """A session to save: a new one, or another state of one that is there."""

    name: str
    table: str
    columns: Columns
    search: str | None = None
    key: str | None = None


class SavedSessions:
    """The sessions in a folder, each a file; those that were deleted can be brought back until the app ends."""

    def __init__(self) -> None:
        self._deleted = dict[str, bytes]()
        self._summaries = dict[tuple[str, tuple[int, int]], dict[str, Any]]()

    @property
    def folder(self) -> Path:
        """The folder, which is made when a session is saved first."""
        if given := os.environ.get(FOLDER):
            return Path(given)
        from platformdirs import user_data_path

        return user_data_path("commonlaw", appauthor=False) / "sessions"

    def listed(self) -> list[dict[str, Any]]:
        """Return a summary of each session, the latest first; of one that cannot be opened the reason."""
        result = []
        for path in self.folder.glob("*.json") if self.folder.is_dir() else ():
            if _KEY.fullmatch(path.stem):
                try:
                    state = path.stat()
                    mark = state.st_mtime_ns, state.st_size
                    if (path.stem, mark) not in self._summaries:  # A large session takes seconds to read
                        self._summaries[path.stem, mark] = _summary(path.stem, self._read(path.stem))
                    result.append(self._summaries[path.stem, mark])
                except FileNotFoundError:  # It was deleted meanwhile
                    continue
                except CommonlawError as error:
                    result.append({"key": path.stem, "name": path.name, "saved": "", "problem": message(error)})
        return sorted(result, key=lambda summary: str(summary["saved"]), reverse=True)

    def save(self, asked: Named, sessions: Sessions) -> dict[str, Any]:
        """Save a session, or another state of it, and return its summary.

        Raises `CommonlawError` if its name is empty, its table is gone, or the file could not be written or opened.
        """
        name = " ".join(asked.name.split())[:80]
        if not name:
            raise CommonlawError("session-without-name")
        search = None if asked.search is None else sessions.searches.get(asked.search)
        made = None if search is None or search.made is None else to_json(search.made.law)
        if made is not None:
            from_json(made)
        # The key of a table is that of one app
        question = None if search is None else msgspec.structs.replace(search.question, table="")
        state, table = State(asked.columns, question, made), sessions.tables.get(asked.table)
        key = asked.key or token_hex(8)
        make_folder(self.folder, private=True)
        with one_writer(self.folder):
            states = () if asked.key is None else self._read(key).states
            is_same = bool(states) and (states[-1].columns, states[-1].question) == (state.columns, question)
            # An undo returns to the states before, of which 20 are kept
            states = (*states[:-1], state) if is_same else (*states, state)[-20:]
            now = datetime.now(UTC).isoformat(timespec="seconds")
            return self._write(key, Session(name, now, table, states))

    def resume(self, key: str, sessions: Sessions) -> dict[str, Any]:
        """Open the present state of a session, and return where the page goes on."""
        session = self._read(key)
        state = session.states[-1]
        opened = {"table": sessions.open_table(session.table), "search": None, "columns": state.columns}
        if state.question is not None and state.law is not None:
            question = msgspec.structs.replace(state.question, table=opened["table"])
            opened["search"] = sessions.search(question, state.law)
        return opened | {"session": _summary(key, session)}

    def undo(self, key: str, sessions: Sessions) -> dict[str, Any]:
        """Return to the state before the present one.

        Raises `CommonlawError` if there is none.
        """
        with one_writer(self._file(key).parent):
            session = self._read(key)
            if len(session.states) < 2:
                raise CommonlawError("session-at-first-state")
            self._write(key, msgspec.structs.replace(session, states=session.states[:-1]))
        return self.resume(key, sessions)

    def delete(self, key: str) -> None:
        """Delete a session; `restore` brings it back."""
        path = self._file(key)
        with one_writer(path.parent):
            self._deleted[key] = read_file(path)
            remove_file(path)

    def restore(self, key: str) -> None:
        """Bring a session back that was deleted since the app began."""
        if key not in self._deleted:
            raise CommonlawError("session-gone", part="session")
        write_whole(self._path(key), self._deleted[key], mode=0o600)
        del self._deleted[key]

    def _path(self, key: str) -> Path:
        if not _KEY.fullmatch(key):
            raise CommonlawError("session-gone", part="session")
        return self.folder / f"{key}.json"

    def _file(self, key: str) -> Path:
        path = self._path(key)
        if not path.is_file():
            raise CommonlawError("session-gone", part="session")
        return path

    def _read(self, key: str) -> Session:
        result = read_json(read_file(self._file(key)), Session, LARGEST_SESSION)
        if not result.states:
            raise CommonlawError("session-gone", part="session")
        check_lengths(msgspec.to_builtins(result.states))
        # Of a path the last part, as of a table that the page sends
        name = named(result.table.name, b"").name
        return msgspec.structs.replace(result, table=msgspec.structs.replace(result.table, name=name))

    def _write(self, key: str, session: Session) -> dict[str, Any]:
        """Write a session, if it can be read again."""
        content = msgspec.json.encode(session)
        try:
            is_same = read_json(content, Session, LARGEST_SESSION) == session
        except CommonlawError as error:
            raise CommonlawError("session-not-saved", reason=error) from None
        if not is_same:
            raise CommonlawError("session-not-saved", reason="it would differ")
        write_whole(self._path(key), content, mode=0o600)
        return _summary(key, session)


def _summary(key: str, session: Session) -> dict[str, Any]:
    return {
        "key": key,
        "name": session.name,
        "saved": session.saved,
        "table": session.table.name,
        "law": session.states[-1].law is not None,
        "states": len(session.states),
    }
