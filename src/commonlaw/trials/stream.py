"""Trials that come one after the other from a file that may be larger than memory."""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Unpack, cast

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.foreign import MOST_CELLS
from commonlaw.trials.dates import refuse_dates
from commonlaw.trials.parquet import batch_tables, opened
from commonlaw.trials.roles import Reading, Roles, checked
from commonlaw.trials.tables import read_rows
from commonlaw.trials.trial import Schema, Trial, check_measured

_ROWS = 100_000
"""Rows of a file that are held at a time, besides those of the trial that is not complete yet."""


@dataclass(frozen=True, eq=False)
class TrialStream:
    """Trials that are made while they are gone through, each time anew.

    Parameters
    ----------
    schema
        Names and units of the variables.
    source
        Returns an iterator over the trials.
    """

    schema: Schema
    source: Callable[[], Iterator[Trial]]

    def __iter__(self) -> Iterator[Trial]:
        return self.source()

    @classmethod
    def from_parquet(cls, path: str | os.PathLike[str], **roles: Unpack[Roles]) -> "TrialStream":
        """Return the trials of a Parquet file in which the rows of each trial follow each other, without properties.

        Rows without a measured state are left out, and with them trials that have no other row.

        Parameters
        ----------
        path
            The file. One written by `Trials.to_parquet` says itself which column is what.
        **roles
            Which column is what, see `Roles`; object, trial, time and states must be named here or in the file.

        Raises
        ------
        CommonlawError
            If pyarrow is not installed, the file cannot be read, a role is missing, or, while the trials are gone
            through, a value cannot be used, a state was measured in too few samples, or the rows of a trial do not
            follow each other.
        """
        _, kept = opened(path)
        known = cast(Reading, {**kept, **checked(roles), "properties": []})
        missing = [name for name in ("object", "trial", "time", "states") if not known.get(name)]
        if missing:
            raise CommonlawError(f"{path}: say which column is what for a stream: {', '.join(missing)} not named")
        begin = next(batch_tables(path, 1), None)
        if begin is None:
            raise CommonlawError(f"{path} has no rows: give it the measured rows")
        refuse_dates(begin, begin.find(str(known["time"])))
        first = read_rows(begin, "object", known)
        return cls(first.data.schema, lambda: _trials(Path(path), known))


def _trials(path: Path, roles: Reading) -> Iterator[Trial]:
    """Yield the trials of a file; the last one of a batch may go on in the next."""
    done: set[tuple[str, str]] = set()
    batches = (read_rows(each, "object", roles) for each in batch_tables(path, _ROWS))
    trials = ((trial.measured(), batch.data.schema.states) for batch in batches for trial in batch.data.trials)
    for key, group in groupby(trials, lambda part: (part[0].object, part[0].name)):
        parts, states = zip(*_held(path, group), strict=True)
        if key in done:
            raise CommonlawError(
                f"{path}: the rows of {parts[0].label} do not follow each other; sort the file by object, trial, time"
            )
        done.add(key)
        arrays = zip(*((each.times, each.states, each.inputs, each.noise) for each in parts), strict=True)
        trial = Trial(*key, *map(np.concatenate, arrays))
        check_measured([trial], states[0])
        yield trial


def _held(path: Path, group: Iterable[tuple[Trial, tuple[str, ...]]]) -> Iterator[tuple[Trial, tuple[str, ...]]]:
    """Yield the parts of a trial, as far as memory holds them."""
    cells = 0
    for part, states in group:
        cells += len(part) * (1 + part.states.shape[1] + part.inputs.shape[1])
        if cells > MOST_CELLS:
            raise CommonlawError(
                f"{path}: {part.label} has more than {MOST_CELLS} values, and no trial may have more: divide it into "
                "several trials"
            )
        yield part, states
