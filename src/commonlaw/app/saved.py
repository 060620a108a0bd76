"""Sessions on disk: a table, what was asked of it, and the law, by a name; they outlive the app."""

import os
import re
from datetime import UTC, datetime
from pathlib import Path
from secrets import token_hex
from typing import Any

import msgspec

from commonlaw.app.question import Columns, Question, Table
from commonlaw.app.sessions import Sessions
from commonlaw.errors import CommonlawError
from commonlaw.law import to_json
from commonlaw.runtime.files import make_folder, remove_file, write_whole
from commonlaw.runtime.reading import read_file, read_json

FOLDER = "COMMONLAW_SESSIONS"
"""Environment variable that names the folder of sessions; by default that of the user's data."""
_KEY = re.compile("[0-9a-f]{16}")


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

    @property
    def folder(self) -> Path:
        """The folder, which is made when a session is saved first."""
        if given := os.environ.get(FOLDER):
            return Path(given)
        from platformdirs import user_data_path

        return user_data_path("commonlaw", appauthor=False) / "sessions"

    def listed(self) -> list[dict[str, Any]]:
        """Return a summary of each session, the latest first; files that are damaged are left out."""
        result = []
        for path in self.folder.glob("*.json") if self.folder.is_dir() else ():
            if _KEY.fullmatch(path.stem):
                try:
                    result.append(_summary(path.stem, self._read(path.stem)))
                except CommonlawError:
                    continue
        return sorted(result, key=lambda each: str(each["saved"]), reverse=True)

    def save(self, asked: Named, sessions: Sessions) -> dict[str, Any]:
        """Save a session, or another state of it, and return its summary.

        Raises `CommonlawError` if its name is empty, its table is gone, or the file cannot be written.
        """
        name = " ".join(asked.name.split())[:80]
        if not name:
            raise CommonlawError("session-without-name")
        search = None if asked.search is None else sessions.searches.get(asked.search)
        made = None if search is None or search.made is None else to_json(search.made.law)
        # The key of a table is that of one app
        question = None if search is None else msgspec.structs.replace(search.question, table="")
        state = State(asked.columns, question, made)
        key = asked.key or token_hex(8)
        states = () if asked.key is None else self._read(key).states
        is_same = bool(states) and (states[-1].columns, states[-1].question) == (state.columns, question)
        # An undo returns to the states before, of which 20 are kept
        states = (*states[:-1], state) if is_same else (*states, state)[-20:]
        now = datetime.now(UTC).isoformat(timespec="seconds")
        return self._write(key, Session(name, now, sessions.tables.get(asked.table), states))

    def resume(self, key: str, sessions: Sessions) -> dict[str, Any]:
        """Open the present state of a session, and return where the page goes on."""
        session = self._read(key)
        state = session.states[-1]
        found = {"table": sessions.open_table(session.table), "search": None, "columns": state.columns}
        if state.question is not None and state.law is not None:
            question = msgspec.structs.replace(state.question, table=found["table"])
            found["search"] = sessions.search(question, state.law)
        return found | {"session": _summary(key, session)}

    def undo(self, key: str, sessions: Sessions) -> dict[str, Any]:
        """Return to the state before the present one.

        Raises `CommonlawError` if there is none.
        """
        session = self._read(key)
        if len(session.states) < 2:
            raise CommonlawError("session-at-first-state")
        self._write(key, msgspec.structs.replace(session, states=session.states[:-1]))
        return self.resume(key, sessions)

    def delete(self, key: str) -> None:
        """Delete a session; `restore` brings it back."""
        self._deleted[key] = read_file(self._path(key))
        remove_file(self._path(key))

    def restore(self, key: str) -> None:
        """Bring a session back that was deleted since the app began."""
        if key not in self._deleted:
            raise CommonlawError("session-gone", part="session")
        write_whole(self._path(key), self._deleted.pop(key))

    def _path(self, key: str) -> Path:
        if not _KEY.fullmatch(key):
            raise CommonlawError("session-gone", part="session")
        return self.folder / f"{key}.json"

    def _read(self, key: str) -> Session:
        path = self._path(key)
        if not path.is_file():
            raise CommonlawError("session-gone", part="session")
        result = read_json(read_file(path), Session)
        if not result.states:
            raise CommonlawError("session-gone", part="session")
        return result

    def _write(self, key: str, session: Session) -> dict[str, Any]:
        make_folder(self.folder, private=True)
        write_whole(self._path(key), msgspec.json.encode(session))
        return _summary(key, session)


def _summary(key: str, session: Session) -> dict[str, Any]:
    law = session.states[-1].law
    return {
        "key": key,
        "name": session.name,
        "saved": session.saved,
        "table": session.table.name,
        "law": law is not None,
        "states": len(session.states),
    }
