"""Trials that come one after the other from a file that may be larger than memory."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, compress, groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeVar, Unpack, cast
from urllib.parse import unquote

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import checks_types
from commonlaw.runtime.cluster import done_in_parts, on_cluster, refuse_client
from commonlaw.runtime.files import MOST_CELLS
from commonlaw.runtime.progress import ProgressCallback, check_memory, on_terminal
from commonlaw.text import counted
from commonlaw.trials.columns import Table
from commonlaw.trials.dates import holds_dates
from commonlaw.trials.files import batch_tables, files_of, opened
from commonlaw.trials.nonmem import items_of
from commonlaw.trials.reading import Reading, Roles, checked
from commonlaw.trials.tables import read_rows
from commonlaw.trials.trial import Schema, Trial, TrialData, check_gaps, check_measured, joined
from commonlaw.trials.trials import Named, Trials, Until, labels, name_of

if TYPE_CHECKING:
    from distributed import Client

R = TypeVar("R")

_ROWS = 100_000
"""Rows of a file that are held at a time, besides those of the trial that is not complete yet."""


class NotInMemoryError(CommonlawError, AttributeError):
    """Something is asked of a stream that only trials in memory have."""


@dataclass(frozen=True, eq=False, repr=False)
class TrialStream:
    """Trials of files that may exceed memory, read one after the other.

    Most are made by `from_parquet`.

    Parameters
    ----------
    schema
        Names and units of the variables.
    source
        A function that returns an iterator over the trials, or `Trials`, which may have properties.
    parts
        Streams of the single files, in order; each can be pickled.
    """

    schema: Schema
    source: Callable[[], Iterable[Trial]]
    parts: Sequence["TrialStream"] = ()

    stands_for: ClassVar[type] = Trials

    def __repr__(self) -> str:
        of = f"{counted(len(self.parts), 'part')}, " if self.parts else ""
        return f"<TrialStream: {of}{', '.join(self.schema.states)}>"

    def __iter__(self) -> Iterator[Trial]:
        return iter(self.source())

    def __getattr__(self, name: str) -> NoReturn:
        """Refuse what only trials in memory have, in words: it is asked for where these are needed."""
        if name.startswith("_") or not (hasattr(Trials, name) or name in Trials.__dataclass_fields__):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}", name=name, obj=self)
        raise NotInMemoryError("not-in-memory")

    @property
    def files(self) -> Sequence["TrialStream"]:
        """Its parts, or the stream itself if it has none."""
        return self.parts or (self,)

    def read(self) -> Trials:
        """Read all trials into memory, with the properties of their objects.

        Raises `CommonlawError` if there are too many.
        """
        if isinstance(self.source, _TrialsOfFile | _Kept):
            return self.source.read()
        if self.parts:
            read, size = list[Trials](), 0
            for part in self.parts:
                trials = part.read()
                size += sum(
                    trial.times.nbytes + trial.states.nbytes + trial.inputs.nbytes + trial.noise.nbytes
                    for trial in trials
                )
                remedy = "take some of them, or stream.select(object=...)"
                check_memory(counted(len(self.parts), "file"), size, remedy)
                read.append(trials)
            return as_one(read)
        content = self.source()
        return content if isinstance(content, Trials) else Trials(tuple(content), self.schema)

    def select(self, /, object: object = None, trial: object = None) -> "TrialStream":
        """Return the stream of selected objects and trials, see `Trials.select`.

        The stream is read once, to find the files with such trials. Raises `CommonlawError` if a name is unknown, or
        nothing is selected.
        """
        return self._divided(object, trial)[0]

    def split(self, /, object: object = None, trial: object = None) -> tuple["TrialStream", "TrialStream"]:
        """Return the stream that `select` returns for these conditions, and that of all other trials.

        Raises `CommonlawError` if a name is unknown, or if one of the two parts is empty.
        """
        chosen, rest = self._divided(object, trial)
        if not rest.parts:
            raise CommonlawError("split-one-sided")
        return chosen, rest

    @checks_types
    def until(self, time: float) -> "TrialStream":
        """Return the stream of the samples up to a time, without trials that begin later.

        Raises `CommonlawError` if no trial begins by that time.
        """
        kept = [TrialStream(self.schema, _Kept(part, Until(time))) for part in self.files]
        begun = done_in_parts(_has_trials, kept, "looking for trials", on_terminal())
        if not any(begun):
            raise CommonlawError("trials-begin-later", time_name=self.schema.time, time=time)
        return self._of([*compress(kept, begun)])

    @checks_types
    def joined(self, other: "TrialStream") -> "TrialStream":
        """Return the concatenation with another stream of the same variables."""
        return self._of([*self.files, *other.files])

    def _divided(self, name: object, trial: object) -> tuple["TrialStream", "TrialStream"]:
        """Return the streams of the trials that have these names, and of the others."""
        asked = {"object": name, "trial": trial}
        wanted = {role: frozenset(labels(names)) for role, names in asked.items() if names is not None}
        chosen = Named(wanted)
        looked = done_in_parts(partial(_looked_for, chosen), self.files, "looking for trials", on_terminal())
        for role, names in wanted.items():
            if missing := sorted(names.difference(*(present[role] for present, _ in looked))):
                raise CommonlawError("stream-without-role", role=role, name=missing[0])
        if not any(True in fit for _, fit in looked):
            raise CommonlawError("no-trial-fits", conditions=", ".join(f"{role}={asked[role]}" for role in wanted))
        kept, rest = (
            [
                TrialStream(self.schema, _Kept(part, replace(chosen, others=not fits)))
                for part, (_, fit) in zip(self.files, looked, strict=True)
                if fits in fit
            ]
            for fits in (True, False)
        )
        return self._of(kept), self._of(rest)

    def _of(self, parts: Sequence["TrialStream"]) -> "TrialStream":
        return TrialStream(self.schema, partial(chain.from_iterable, parts), parts)

    @classmethod
    @checks_types
    def from_parquet(cls, path: str | os.PathLike[str], **roles: Unpack[Roles]) -> "TrialStream":
        """Return the stream of Parquet files in which the rows of each trial are contiguous.

        Rows without a measured state are left out, except those with inputs after the first measurement. Each trial
        must lie in one file.

        Raises `CommonlawError` if pyarrow is not installed, a file is missing or cannot be read, or a role is missing;
        and while reading, if a value is invalid, a state was measured in too few samples, or the rows of a trial are
        not contiguous.

        Parameters
        ----------
        path
            A file; a folder, with all its ``*.parquet``; or a pattern such as ``"runs/*.parquet"``. Folders named
            ``object=ball`` (Hive partitions) are read as a column ``object``.
        **roles
            See `Roles`; object, trial, time and states must be named here or in the first file, by `Trials.to_parquet`.
            Properties are those of columns that are named.
        """
        files = []
        for file_path in _files(path):
            pairs = (part.split("=", 1) for part in file_path.parent.parts if "=" in part)
            files.append(_TrialsOfFile(file_path, {name: unquote(value) for name, value in pairs if name}))
        _, kept = opened(files[0].path)
        known = cast(Reading, {"properties": [], "noise_columns": {}, **kept, **checked(roles, Roles)})
        if not isinstance(known["properties"], list | tuple):
            raise CommonlawError("stream-properties", where=str(path))
        missing = [name for name in ("object", "trial", "time", "states") if not known.get(name)]
        if missing:
            raise CommonlawError("stream-roles-missing", where=str(path), roles=missing)
        begin = next(files[0].tables(1), None)
        if begin is None:
            raise CommonlawError("stream-without-rows", path=files[0].path)
        time = begin.find(str(known["time"]))
        if holds_dates(begin.columns[time]):  # The earliest is not known
            raise CommonlawError("dates-in-stream", where=begin.source, column=time)
        if items_of(begin, known):
            raise CommonlawError("doses-in-stream", where=begin.source)
        schema = read_rows(begin, known).data.schema
        parts = [cls(schema, replace(file, roles=known)) for file in files]
        return cls(schema, partial(chain.from_iterable, parts), parts)


def measured(trials: Trials | TrialStream | Any) -> Trials | TrialStream:
    """Return trials or a stream as they are, and the trials that `Trials.from_frame` makes of a table."""
    return trials if isinstance(trials, Trials | TrialStream) else Trials.from_frame(trials)


def in_memory_or_by_file(
    trials: Trials | TrialStream,
    client: "Client | None",
    in_memory: Callable[[Trials], R],
    by_file: Callable[[TrialStream], R],
) -> R:
    """Return what is computed of trials in memory, or of a stream, whose files the workers of a dask client read.

    This is the door of each verb that takes both: what it calls takes one of them. Raises `CommonlawError` if there is
    a client but no stream.
    """
    if isinstance(trials, TrialStream):
        with on_cluster(client):
            return by_file(trials)
    refuse_client(client)
    return in_memory(trials)


def _looked_for(wanted: Named, part: TrialStream) -> tuple[dict[str, set[str]], set[bool]]:
    """Return which wanted names a part of a stream has, by role, and whether trials of it fit, do not, or both."""
    seen: dict[str, set[str]] = {role: set() for role in wanted.names}
    fit = set[bool]()
    for trial in part:
        for role, name in wanted.names.items():
            seen[role] |= name & {name_of(trial, role)}
        fit.add(wanted.fits(trial))
    return seen, fit


def _has_trials(part: TrialStream) -> bool:
    return any(True for _ in part)


@dataclass(frozen=True)
class _Kept:
    """Yields what is kept of the trials of a stream; it can be sent to another process."""

    stream: TrialStream
    keep: Callable[[Trial], Trial | None]

    def __call__(self) -> Iterator[Trial]:
        return (kept for trial in self.stream if (kept := self.keep(trial)) is not None)

    def read(self) -> Trials:
        """Return the trials in memory, with the properties of their objects."""
        trials = self.stream.read()
        return trials.with_trials([kept for trial in trials if (kept := self.keep(trial)) is not None])


def objects_of_parts(parts: Sequence[TrialStream], progress: ProgressCallback) -> list[tuple[str, ...]]:
    """Return the names of the objects of each part."""
    return done_in_parts(_objects, parts, "listing objects", progress)


def _objects(part: TrialStream) -> tuple[str, ...]:
    return tuple(dict.fromkeys(trial.object for trial in part))


def as_one(parts: Sequence[Trials]) -> Trials:
    """Return the trials of several collections in one, with the properties of their objects."""
    properties = {name: attribute for part in parts for name, attribute in part.properties.items()}
    notes = tuple(note for part in parts for note in part.notes)
    return Trials(tuple(chain.from_iterable(parts)), parts[0].schema, properties, notes)


@dataclass(frozen=True)
class _TrialsOfFile:
    """Yields the trials of a Parquet file; the last one of a batch of rows may go on in the next."""

    path: Path
    partition: dict[str, str]
    """What the names of its folders say of all its rows."""
    roles: Reading = field(default_factory=Reading)

    def tables(self, rows: int) -> Iterator[Table]:
        """Yield the tables in so many rows after the other."""
        for table in batch_tables(self.path, rows):
            columns = {name: np.full(len(table), value, dtype=object) for name, value in self.partition.items()}
            yield replace(table, columns={**columns, **table.columns}) if columns else table

    def read(self) -> Trials:
        """Return the trials in memory, with the properties of their objects."""
        batches = list[TrialData]()
        trials = tuple(self(batches))
        properties = {name: attribute for batch in batches for name, attribute in batch.properties.items()}
        return Trials(trials, batches[0].schema, properties)

    def __call__(self, read: list[TrialData] | None = None) -> Iterator[Trial]:
        """Yield the trials; what comes with those of each batch of rows is kept in a list, if there is one."""
        path, done = self.path, set[tuple[str, str]]()
        batches = self._batches(read)
        trials = ((trial.measured(), data.schema.states) for data in batches for trial in data.trials)
        for key, group in groupby(trials, lambda part: (part[0].object, part[0].name)):
            parts, states = zip(*_held(path, group), strict=True)
            if key in done:
                raise CommonlawError("stream-unsorted", where=str(path), trial=parts[0].label)
            done.add(key)
            arrays = ((part.times, part.states, part.inputs, part.noise, part.below) for part in parts)
            times, states_of, inputs, noise, below = map(np.concatenate, zip(*arrays, strict=True))
            repeats = joined([(part.repeats, part.states.shape) for part in parts])
            trial = Trial(*key, times, states_of, inputs, noise, repeats, below=below) if len(parts) > 1 else parts[0]
            check_measured([trial], states[0])
            check_gaps([trial], Schema(tuple(states[0])))
            yield trial

    def _batches(self, read: list[TrialData] | None) -> Iterator[TrialData]:
        for table in self.tables(_ROWS):
            data = read_rows(table, self.roles).data
            if read is not None:
                read.append(data._replace(trials=()))
            yield data


def _files(path: str | os.PathLike[str]) -> list[Path]:
    """Return the files that a path names, in order of their names."""
    paths = files_of(Path(path), {".parquet"})
    if paths is None:
        return [Path(path).absolute()]
    files = sorted(file.absolute() for file in paths if file.is_file())
    if not files:
        raise CommonlawError("no-parquet-file", path=str(path))
    return files


def _held(path: Path, group: Iterable[tuple[Trial, tuple[str, ...]]]) -> Iterator[tuple[Trial, tuple[str, ...]]]:
    """Yield the parts of a trial, as far as memory holds them."""
    cells = 0
    for part, states in group:
        cells += len(part) * (1 + part.states.shape[1] + part.inputs.shape[1])
        if cells > MOST_CELLS:
            raise CommonlawError("trial-too-large", where=str(path), trial=part.label, limit=MOST_CELLS)
        yield part, states
