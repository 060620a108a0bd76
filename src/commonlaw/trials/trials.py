"""The collection of trials that everything downstream takes."""

import math
import numbers
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from commonlaw.errors import CommonlawError, unknown
from commonlaw.trials.roles import PropertyTable, Roles
from commonlaw.trials.trial import Schema, Trial, label

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.trials.check import Report

Property = float | str


@dataclass(frozen=True, eq=False)
class Trials:
    """An immutable collection of trials with their objects' properties, variable names and units.

    Parameters
    ----------
    trials
        The trials, in order.
    schema
        Names and units of the variables.
    properties
        Property values by object and property name: ``{"Golf Ball": {"radius": 0.022}}``; their units stand in
        ``schema.units``. A property is a number for every object that has it, or a text for every one; where it is
        not known, it is left out.
    notes
        What was done to the data on the way in (sorted, clipped), in words.

    A collection is indexed like a NumPy array of trials: ``trials[0]`` is a `Trial`, ``trials[[0, 2]]`` and
    ``trials[:3]`` are `Trials`; so scikit-learn's splitters work on it.

    Raises
    ------
    CommonlawError
        If there is no trial, a trial's columns do not match the schema, one object has two trials of the same name,
        or a property has no value that can be used or belongs to an object without trials.
    """

    trials: tuple[Trial, ...]
    schema: Schema
    properties: Mapping[str, Mapping[str, Property]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.trials:
            raise CommonlawError("there is no trial: the collection is empty; check the table or the selection")
        seen: set[tuple[str, str]] = set()
        for trial in self.trials:
            if (trial.object, trial.name) in seen:
                raise CommonlawError(f"{trial.label} is there twice; give each trial of an object a label of its own")
            seen.add((trial.object, trial.name))
            for kind, values, names in (
                ("states", trial.states, self.schema.states),
                ("inputs", trial.inputs, self.schema.inputs),
            ):
                if values.shape[1] != len(names):
                    raise CommonlawError(f"{trial.label} has {values.shape[1]} {kind}, expected {', '.join(names)}")
        object.__setattr__(self, "properties", _settled(self.properties))
        self._check_properties()

    @classmethod
    def read(cls, path: str | os.PathLike[str], *, sheet: str | None = None, **roles: Unpack[Roles]) -> "Trials":
        """Return the trials in a file; see `commonlaw.trials.tables.read_trials`."""
        from commonlaw.trials.tables import read_trials

        return read_trials(path, sheet=sheet, **roles)

    @classmethod
    def from_frame(cls, frame: Any, **roles: Unpack[Roles]) -> "Trials":
        """Return the trials in a frame; see `commonlaw.trials.tables.trials_from_frame`."""
        from commonlaw.trials.tables import trials_from_frame

        return trials_from_frame(frame, **roles)

    @classmethod
    def from_arrays(
        cls,
        times: Sequence[Any] | NDArray[Any],
        states: ArrayLike,
        *,
        object: object = "object",
        trial: object = None,
        inputs: ArrayLike | None = None,
        names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
        properties: str | os.PathLike[str] | PropertyTable | Any = None,
    ) -> "Trials":
        """Return the trials in arrays; see `commonlaw.trials.arrays.trials_from_arrays`."""
        from commonlaw.trials.arrays import trials_from_arrays

        return trials_from_arrays(
            times, states, object=object, trial=trial, inputs=inputs, names=names, units=units, properties=properties
        )

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the objects, in order of first appearance."""
        return tuple(dict.fromkeys(trial.object for trial in self.trials))

    @property
    def shape(self) -> tuple[int]:
        """The number of trials, as scikit-learn's splitters ask for it."""
        return (len(self.trials),)

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Iterator[Trial]:
        return iter(self.trials)

    @overload
    def __getitem__(self, index: int) -> Trial: ...
    @overload
    def __getitem__(self, index: Any) -> "Trials": ...
    def __getitem__(self, index: Any) -> "Trial | Trials":
        chosen = np.arange(len(self))[index]
        if np.ndim(chosen) == 0:
            return self.trials[int(chosen)]
        return self.keep([self.trials[i] for i in chosen])

    def __repr__(self) -> str:
        samples = sum(map(len, self.trials))
        states = ", ".join(self.schema.states)
        return f"<Trials: {len(self)} trials of {len(self.objects)} objects, {samples} samples of {states}>"

    def keep(self, trials: Sequence[Trial], note: str | None = None) -> "Trials":
        """Return a collection of `trials` with this one's schema, properties of their objects, and notes."""
        names = {trial.object for trial in trials}
        properties = {name: values for name, values in self.properties.items() if name in names}
        notes = self.notes if note is None else (*self.notes, note)
        return Trials(tuple(trials), self.schema, properties, notes)

    def of(self, name: str) -> tuple[Trial, ...]:
        """Return the trials of one object."""
        return tuple(trial for trial in self.trials if trial.object == name)

    def clip_irregular(self, tolerance: float = 0.005) -> "Trials":
        """Return the trials without their irregular ends; see `commonlaw.trials.clip.clip_irregular`."""
        from commonlaw.trials.clip import clip_irregular

        return clip_irregular(self, tolerance)

    def check(self, tolerance: float = 0.005) -> "Report":
        """Return what there is to know about the trials before use; see `commonlaw.trials.check.check`."""
        from commonlaw.trials.check import check

        return check(self, tolerance)

    def to_frame(self) -> "pd.DataFrame":
        """Return a pandas frame with a row for each sample; see `commonlaw.trials.export.to_frame`."""
        from commonlaw.trials.export import to_frame

        return to_frame(self)

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write a CSV file with a row for each sample; see `commonlaw.trials.export.to_csv`."""
        from commonlaw.trials.export import to_csv

        to_csv(self, path)

    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Write a Parquet file that `read` gives back exactly; see `commonlaw.trials.export.to_parquet`."""
        from commonlaw.trials.export import to_parquet

        to_parquet(self, path)

    def select(self, object: object = None, trial: object = None, **properties: object) -> "Trials":
        """Return the trials that fit every condition.

        Parameters
        ----------
        object, trial
            A name or a list of names; numbers are taken by their text, so ``trial=1`` finds the trial ``"1"``.
        **properties
            For a property of the objects: a value, a list of values, or a function of the value that says whether
            it fits.

        Raises
        ------
        CommonlawError
            If a name is not known or nothing fits.
        """
        conditions = {"object": object, "trial": trial, **properties}
        tests = {name: self._test(name, wanted) for name, wanted in conditions.items() if wanted is not None}
        kept = [each for each in self.trials if all(test(each) for test in tests.values())]
        if not kept:
            raise CommonlawError(f"no trial fits {', '.join(f'{name}={conditions[name]}' for name in tests)} together")
        return self.keep(kept)

    def split(self, **conditions: object) -> tuple["Trials", "Trials"]:
        """Return the trials that `select` keeps with these conditions, and all others."""
        chosen = self.select(**conditions)
        inside = {id(each) for each in chosen}
        rest = [each for each in self.trials if id(each) not in inside]
        if not rest:
            raise CommonlawError("the split leaves nothing on the other side: every trial fits the conditions")
        return chosen, self.keep(rest)

    def _check_properties(self) -> None:
        objects = set(self.objects)
        orphans = [name for name in self.properties if name not in objects]
        if orphans:
            raise CommonlawError(
                f"properties are given for objects without trials: {', '.join(orphans)}; "
                f"objects with trials: {', '.join(self.objects)}"
            )
        schema = self.schema
        columns = {schema.object, schema.trial, schema.time, *schema.states, *schema.inputs}
        first: dict[str, tuple[str, Property]] = {}
        for name, values in self.properties.items():
            for key, value in values.items():
                if key in columns:
                    raise CommonlawError(f"{key!r} is the name of a column and of a property: rename one of them")
                if value == "" or (isinstance(value, float) and not math.isfinite(value)):
                    raise CommonlawError(f"property {key!r} of {name} is {value!r}: leave out what is not known")
                other, known = first.setdefault(key, (name, value))
                if type(known) is not type(value):
                    raise CommonlawError(
                        f"property {key!r} is {known!r} for {other} and {value!r} for {name}: give numbers for all "
                        "objects or text for all, and leave out what is not known"
                    )

    def _test(self, name: str, wanted: object) -> Callable[[Trial], bool]:
        """Return the function that says whether a trial fits one condition."""
        if name in ("object", "trial"):
            labels = [label(each) for each in _listed(wanted)]
            present = [_name_of(trial, name) for trial in self.trials]
            for each in labels:
                if each not in present:
                    raise unknown(name, each, dict.fromkeys(present))
            return lambda trial: _name_of(trial, name) in labels
        known = dict.fromkeys(key for values in self.properties.values() for key in values)
        if name not in known:
            raise unknown("property", name, known)
        fits = wanted if callable(wanted) else _listed(wanted).__contains__
        return lambda trial: bool(
            name in self.properties.get(trial.object, {}) and fits(self.properties[trial.object][name])
        )


def _name_of(trial: Trial, what: str) -> str:
    return trial.object if what == "object" else trial.name


def _listed(value: object) -> list[Any]:
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str) else [value]


def _settled(properties: Mapping[str, Mapping[str, Property]]) -> dict[str, dict[str, Property]]:
    """Return properties with labels for objects, floats for numbers, and no object that has none."""
    return {
        label(name): {
            key: float(value) if isinstance(value, numbers.Real) else str(value).strip()
            for key, value in values.items()
        }
        for name, values in properties.items()
        if values
    }
