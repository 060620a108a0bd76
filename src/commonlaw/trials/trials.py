"""The collection of trials that everything downstream takes."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isnan
from typing import TYPE_CHECKING, Any, Self, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from commonlaw.array_types import Floats, same_content
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.runtime.arguments import check_type, checks_types
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.text import counted
from commonlaw.trials.check import Report, check, regular_length
from commonlaw.trials.columns import frame_table
from commonlaw.trials.files import TablePath, columns_of, read_table, to_csv, to_parquet
from commonlaw.trials.headers import label
from commonlaw.trials.reading import Reading
from commonlaw.trials.tables import rows_of, trials_from_arrays
from commonlaw.trials.trial import (
    NoSuchTrialError,
    ObjectProperties,
    PropertyTable,
    Schema,
    Trial,
    TrialData,
    check_noise_columns,
    check_properties,
    normalized,
    property_names,
)

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Named:
    """Keeps trials whose ``object`` and ``trial`` are among the names given for each role, or all `others`."""

    names: dict[str, frozenset[str]]
    others: bool = False

    def __call__(self, trial: Trial) -> Trial | None:
        return trial if self.fits(trial) != self.others else None

    def fits(self, trial: Trial) -> bool:
        """Return whether a trial has these names."""
        return all(name_of(trial, role) in name for role, name in self.names.items())


@dataclass(frozen=True)
class Until:
    """Keeps the samples up to a time, and nothing of trials that begin later."""

    time: float

    def __post_init__(self) -> None:
        if isnan(self.time):
            raise CommonlawError("finite-number", name="time", value=self.time)

    def __call__(self, trial: Trial) -> Trial | None:
        stop = int(np.searchsorted(trial.times, self.time, side="right"))
        return trial.cut(stop) if stop else None


def name_of(trial: Trial, role: str) -> str:
    """Return the name of a trial, or of its object."""
    return trial.object if role == "object" else trial.name


def labels(wanted: object) -> list[str]:
    """Return the labels of a name, or of several."""
    return [label(name) for name in listed(wanted)]


def listed(value: object) -> list[Any]:
    """Return a list of values, or one of a single value, which may be a text."""
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str) else [value]


@dataclass(frozen=True, eq=False)
class Trials(ShownInNotebooks):
    """Immutable collection of trials, with variable names, units and properties of the objects.

    It is indexed like a NumPy array of trials: ``trials[0]`` is a `Trial`, ``trials[[0, 2]]`` and ``trials[:3]`` are
    `Trials`, so that splitters of scikit-learn work on it. Collections are equal if their trials, schemas and
    properties are.

    Raises `CommonlawError` if there is no trial, the columns of a trial do not match the schema, an object has two
    trials of the same name, or a property has an invalid value or an object without trials.

    Parameters
    ----------
    trials, schema
        The trials, and the names and units of their variables.
    properties
        Values by object and property name: ``{"Golf Ball": {"radius": 0.022}}``, all numbers or
        all texts; units are in ``schema.units``.
    notes
        What was inferred from the table and done to the data (roles, sorting, clipping), in words.
    nameless
        Whether the table had no column of objects, so that the only one is named after the file, or ``object``.
    guessed
        Columns that are constant for each object or in each trial, and were read as properties or inputs for that.
    text_columns
        Columns of text that were left out.
    unread
        Columns of numbers that were left out.
    """

    trials: tuple[Trial, ...]
    schema: Schema
    properties: ObjectProperties = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    nameless: bool = False
    guessed: tuple[str, ...] = ()
    text_columns: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()

    def __new__(cls, trials: Sequence[Trial] = (), *_: object, **__: object) -> Self:
        """Refuse tables, which `from_frame` and `read` take."""
        check_type("trials", trials, Sequence, "a sequence of Trial, or take Trials.from_frame or Trials.read")
        for trial in trials:
            check_type("trials", trial, Trial, "a sequence of Trial, or take Trials.from_frame or Trials.read")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        check_type("schema", self.schema, Schema, "a Schema")
        if not self.trials:
            raise CommonlawError("no-trial")
        seen: set[tuple[str, str]] = set()
        for trial in self.trials:
            if (trial.object, trial.name) in seen:
                raise CommonlawError("trial-twice", trial=trial.label)
            seen.add((trial.object, trial.name))
            for kind, values, names in (
                ("states", trial.states, self.schema.states),
                ("inputs", trial.inputs, self.schema.inputs),
            ):
                if values.shape[1] != len(names):
                    raise CommonlawError(
                        "columns-of-trial", trial=trial.label, given=values.shape[1], kind=kind, expected=names
                    )
            check_noise_columns(trial, self.schema)
        object.__setattr__(self, "properties", normalized(self.properties))
        check_properties(self.properties, self.objects, self.schema)

    @classmethod
    @checks_types
    def read(cls, path: TablePath, *, sheet: str | None = None, **roles: Unpack[Reading]) -> "Trials":
        """Read trials from a table with a row for each sample: CSV, TSV, Parquet or Excel, recognized by its content.

        The role of each column is inferred unless it is given; `notes` lists the roles. An empty cell of a state is a
        missing measurement. Rows without any measured state are left out, except those after the last measurement,
        which can be forecast.

        Raises `CommonlawError` if the file or a column does not exist, a value is invalid, or a state was measured in
        too few samples; the message names the column and the row, counted from 1 below the header.

        Parameters
        ----------
        path
            The file, optionally compressed by gzip, bzip2 or xz; or several files with the same columns, a folder of
            them or a pattern such as ``"runs/*.csv"``. Objects and trials are then named after the files:
            ``golf_1.csv`` and ``golf_2.csv`` are trials of one object if there are other objects. Text is separated by
            commas, semicolons, tabs, bars or blanks; comments, rows above and below the table, and a row of units are
            recognized. A Parquet file written by `to_parquet` contains its roles.
        sheet
            The sheet of a workbook. Default: all that hold measurements; those with the same header are an object each,
            named by the sheet, unless there is a column ``object``.
        **roles
            Roles of columns and rules for reading: `object`, `trial`, `time`, `states`, `inputs`, `properties`,
            `noise_columns`, `units`, `wide`, `missing`, `decimal`, `dates`, ...; the page "Data format" describes them.
            Without a column of objects there is one object, named after the file.

        See Also
        --------
        from_frame : From a data frame in memory.
        from_arrays : From NumPy arrays.
        check : Check the data for irregularities.
        commonlaw.TrialStream.from_parquet : Files that exceed memory.

        Examples
        --------
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     path = Path(folder, "cup.csv")
        ...     rows = "cup,time [min],T [degC]", "A,0,80", "A,5,62", "B,0,79", "B,5,70"
        ...     _ = path.write_text(chr(10).join(rows))
        ...     trials = Trials.read(path, object="cup")
        >>> trials, trials.schema.units["T"]
        (<Trials: 2 trials of 2 objects, 4 samples of T>, 'degC')
        """
        return cls(*rows_of(read_table(path, sheet), roles).data)

    @classmethod
    @checks_types
    def from_frame(cls, frame: Any, **roles: Unpack[Reading]) -> "Trials":
        """Return the trials in a data frame with a row for each sample.

        The frame is from pandas, polars or pyarrow, a mapping from names to columns, a structured NumPy array, or an
        xarray Dataset, whose dimensions and coordinates become columns. Columns of pint quantities keep their units.
        Dates become times since the earliest. Roles of columns are those of `read`.

        Without a column of objects there is one object, named ``object``. Raises `CommonlawError` if a column does not
        exist, or a value is invalid; the message names the column and the row, counted from 1.
        """
        return cls(*rows_of(frame_table(frame), roles).data)

    @classmethod
    @checks_types
    def from_arrays(
        cls,
        times: Sequence[Any] | NDArray[Any] | float,
        states: ArrayLike,
        *,
        object: object = "object",
        trial: object = None,
        inputs: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
        properties: str | os.PathLike[str] | PropertyTable | Any = None,
    ) -> "Trials":
        """Return the trials in arrays: one trial, or lists with an entry for each trial.

        Raises `CommonlawError` if shapes or numbers of trials disagree, a value is invalid, or a state was measured in
        too few samples; the message names trial and sample.

        Parameters
        ----------
        times, states, inputs, noise
            Sample times, shape (n,), states, inputs and standard deviations, shape (n,) or (n, variables); or lists of
            such arrays. One array of times serves all trials; a number is the time step. Pint quantities keep their
            units, and dates become times since the earliest. NaN is a missing measurement; samples without any measured
            state are left out, except the last ones.
        object, trial
            The object's name and the trial's label, or lists of them. Default: the trials of each object count from 1.
        names
            Names of the states and then of the inputs. Default: ``x`` or ``x1``, ``x2``, ..., and ``u`` or ``u1``, ...
        units
            Units by name: of states, inputs, properties, and of the time, which is called ``t``.
        properties
            A mapping from object to property values by name; or a table (a file, a frame) with a row for each object
            and the objects' names in its column ``object``.

        Examples
        --------
        >>> trials = Trials.from_arrays([0.0, 0.1], [5.0, 4.9], object="ball", names=["height"], units={"height": "m"})
        >>> trials, trials.schema.units
        (<Trials: 1 trial of 1 object, 2 samples of height>, {'height': 'm'})
        """
        return cls(*trials_from_arrays(times, states, object, trial, inputs, noise, names, units, properties))

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the objects, in order of first appearance."""
        return tuple(self._by_object)

    @cached_property
    def _by_object(self) -> dict[str, tuple[Trial, ...]]:
        by_name = dict[str, list[Trial]]()
        for trial in self.trials:
            by_name.setdefault(trial.object, []).append(trial)
        return {name: tuple(trials) for name, trials in by_name.items()}

    @property
    def _data(self) -> TrialData:
        return TrialData(
            self.trials,
            self.schema,
            self.properties,
            self.notes,
            self.nameless,
            self.guessed,
            self.text_columns,
            self.unread,
        )

    @property
    def shape(self) -> tuple[int]:
        """Number of trials in a tuple, for splitters of scikit-learn."""
        return (len(self.trials),)

    def __len__(self) -> int:
        return len(self.trials)

    def __eq__(self, other: object) -> bool:
        return (
            same_content(self, other, ("notes", "nameless", "guessed", "text_columns", "unread"))
            if isinstance(other, Trials)
            else NotImplemented
        )

    def __hash__(self) -> int:
        return hash(self.trials)

    def __iter__(self) -> Iterator[Trial]:
        return iter(self.trials)

    @overload
    def __getitem__(self, index: int) -> Trial: ...
    @overload
    def __getitem__(self, index: Any) -> "Trials": ...
    def __getitem__(self, index: Any) -> "Trial | Trials":
        try:
            chosen = np.arange(len(self))[index]
        except IndexError as error:
            raise NoSuchTrialError("trial-index", trials=len(self), error=error) from None
        if np.ndim(chosen) == 0:
            return self.trials[int(chosen)]
        return self.with_trials([self.trials[i] for i in chosen])

    def __repr__(self) -> str:
        of = f"{counted(len(self), 'trial')} of {counted(len(self.objects), 'object')}"
        return f"<Trials: {of}, {counted(sum(map(len, self.trials)), 'sample')} of {', '.join(self.schema.states)}>"

    @checks_types
    def with_trials(self, trials: Sequence[Trial], note: str | None = None) -> "Trials":
        """Return a collection of `trials` with the schema, notes and properties of this one."""
        names = {trial.object for trial in trials}
        properties = {name: values for name, values in self.properties.items() if name in names}
        notes = self.notes if note is None else (*self.notes, note)
        return Trials(*self._data._replace(trials=tuple(trials), properties=properties, notes=notes))

    @checks_types
    def with_properties(self, values: ObjectProperties) -> "Trials":
        """Return the trials with further properties of their objects.

        Raises `CommonlawError` if an object has no trial, or a value is invalid.

        Parameters
        ----------
        values
            By object and property name: ``{"Ball 1": {"mass": 0.3}}``.
        """
        given = {name: {**self.properties.get(name, {}), **value} for name, value in values.items()}
        return replace(self, properties={**self.properties, **given})

    @checks_types
    def of_object(self, name: str) -> tuple[Trial, ...]:
        """Return the trials of one object."""
        return self._by_object.get(name, ())

    @checks_types
    def until(self, time: float) -> "Trials":
        """Return the samples up to a time, without trials that begin later.

        Raises `CommonlawError` if no trial begins by that time.
        """
        kept = [trial for trial in map(Until(time), self.trials) if trial is not None]
        if not kept:
            raise CommonlawError("trials-begin-later", time_name=self.schema.time, time=time)
        return self.with_trials(kept)

    @checks_types
    def exclude(self, /, *, between: tuple[float, float] | None = None, **conditions: object) -> "Trials":
        """Return the trials without those that meet all conditions of `select`.

        With `between` only their measurements between two times are removed; the inputs stay. Trials without
        measurements are dropped.

        Raises `CommonlawError` if a name is unknown, nothing is selected, or no measurement remains.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.01)
        >>> len(drops.exclude(object="Ball 1")), len(drops.exclude(trial=1, between=(0.0, 1.0))[0]) < len(drops[0])
        (8, True)
        """
        chosen = {id(trial) for trial in self.select(**conditions)}
        first, last = (-np.inf, np.inf) if between is None else between
        kept = list[Trial]()
        for trial in self.trials:
            inside = (trial.times >= first) & (trial.times <= last)
            if id(trial) in chosen and inside.any():
                seen = ~inside & (np.isfinite(trial.states) | np.isfinite(trial.below)).any(axis=1)
                # Rows with inputs alone stay, but for those ahead of what was measured
                rows = np.logical_or.accumulate(seen) & (~inside | (trial.inputs.shape[1] > 0))
                if not rows.any():
                    continue
                states, below = (
                    np.where(inside[:, np.newaxis], np.nan, values) for values in (trial.states, trial.below)
                )
                trial = replace(trial.rows(rows), states=states[rows], below=below[rows])
            kept.append(trial)
        if not kept:
            raise CommonlawError("everything-excluded")
        return self.with_trials(kept)

    @checks_types
    def subtract_blanks(self, *blanks: str) -> "Trials":
        """Return the trials of all other objects minus the mean of the blanks, such as wells with medium only.

        ``y(t) - b(t)``, where b is the mean of the blanks at each time, with linear interpolation and constant
        extrapolation. Limits of quantification are lowered in the same way.

        Raises `CommonlawError` if a name is unknown, or all objects are blanks.

        Examples
        --------
        >>> import numpy as np, commonlaw as cl
        >>> times = np.arange(3.0)
        >>> plate = cl.Trials.from_arrays(times, [times + 0.1, 0.1 + 0 * times], object=["A1", "A2"], names=["OD"])
        >>> plate.subtract_blanks("A2")[0].states[:, 0]
        array([0., 1., 2.])
        """
        chosen = self.select(object=list(blanks))
        kept = [trial for trial in self.trials if trial.object not in labels(blanks)]
        if not kept:
            raise CommonlawError("blanks-only")
        times = np.concatenate([blank.times for blank in chosen])
        states = np.concatenate([blank.states for blank in chosen])
        means = list[tuple[Floats, Floats]]()
        for column in states.T:
            seen = np.isfinite(column)
            at, places = np.unique(times[seen], return_inverse=True)
            if not len(at):
                raise CommonlawError("blank-not-measured", names=labels(blanks))
            means.append((at, np.bincount(places, column[seen]) / np.bincount(places)))
        changed = []
        for trial in kept:
            level = np.column_stack([np.interp(trial.times, *mean) for mean in means])
            changed.append(replace(trial, states=trial.states - level, below=trial.below - level))
        return self.with_trials(changed, f"subtracted as blanks: {', '.join(labels(blanks))}")

    @checks_types
    def clip_irregular(self, tolerance: float | None = None) -> "Trials":
        """Return the trials clipped at their last irregular time step (de Silva et al. 2020); a note lists them.

        A step is irregular if it differs from the median step of the trial by more than `tolerance`, in the unit of
        time; the default is 7.5 % of the median, 5 ms for video at 15 frames a second. All samples after it are
        removed.

        Raises `CommonlawError` if the tolerance is not positive.
        """
        kept = [trial.cut(regular_length(trial.times, tolerance)) for trial in self.trials]
        shorter = [
            f"{before.label} from {len(before)} to {len(after)} samples"
            for before, after in zip(self.trials, kept, strict=True)
            if len(after) < len(before)
        ]
        off = "7.5 %" if tolerance is None else f"{tolerance:g}"
        reason = f"irregular frame, a step more than {off} off the trial's median step"
        return self.with_trials(kept, f"clipped {'; '.join(shorter)}: {reason}") if shorter else self

    def without_noise(self) -> "Trials":
        """Return the trials without the standard deviations of their measurements."""
        bare = tuple(replace(trial, noise=np.empty((0, 0))) for trial in self.trials)
        return replace(self, trials=bare, schema=replace(self.schema, noise_columns={}))

    @checks_types
    def check(self, tolerance: float | None = None, *, order: int | None = None, library: Any = None) -> Report:
        """Check the data: summary of each trial, irregularities, outliers, copies, and confounded variables.

        Parameters
        ----------
        tolerance
            Deviation from the median step beyond which `clip_irregular` would clip.
        order, library
            Order and library of the laws in which variables may be confounded, see `discover`; order 0 skips this.
            Default: order 2 for a single state, 1 for several; polynomials of degree 3, or lower for few samples.
        """
        from commonlaw.discovery.hints import confounded_variables

        confounded = confounded_variables(self, order, library)
        report = check(self._data, tolerance)
        return replace(report, found=(*report.found, *confounded))

    def to_frame(self) -> "pd.DataFrame":
        """Return a pandas data frame with a row for each sample and the column names of the schema."""
        import pandas as pd

        return pd.DataFrame(
            {name: pd.Series(column).infer_objects() for name, column in columns_of(self._data).items()}
        )

    @checks_types
    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write a CSV file with the columns of `to_frame` and units in the headers: ``height [m]``.

        Numbers are written without loss, so that reading the file with the same roles gives the same trials; only a
        text property that looks like a number is read as a number.

        Raises `CommonlawError` if pint does not know a unit, or the file cannot be written.
        """
        to_csv(self._data, path)

    @checks_types
    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Write a Parquet file that includes the roles of its columns, so that `read` needs no keywords.

        Raises `CommonlawError` if pyarrow is not installed, pint does not know a unit, or the file cannot be written.
        """
        to_parquet(self._data, path)

    def select(self, /, object: object = None, trial: object = None, **properties: object) -> "Trials":
        """Return the trials that meet all conditions.

        `object` and `trial` are a name or a list of names, ``trial=1`` the same as ``"1"``; a property is a value, a
        list of values, or a function of the value. Raises `CommonlawError` if a name is unknown or nothing is selected.
        """
        conditions = {"object": object, "trial": trial, **properties}
        tests = {name: self._test(name, wanted) for name, wanted in conditions.items() if wanted is not None}
        kept = [candidate for candidate in self.trials if all(test(candidate) for test in tests.values())]
        if not kept:
            raise CommonlawError("no-trial-fits", conditions=", ".join(f"{name}={conditions[name]}" for name in tests))
        return self.with_trials(kept)

    def split(self, /, **conditions: object) -> tuple["Trials", "Trials"]:
        """Return the trials that `select` returns for these conditions, and all others.

        Raises `CommonlawError` if a name is unknown, or if one of the two parts is empty.
        """
        chosen = self.select(**conditions)
        inside = {id(trial) for trial in chosen}
        rest = [trial for trial in self.trials if id(trial) not in inside]
        if not rest:
            raise CommonlawError("split-one-sided")
        return chosen, self.with_trials(rest)

    def _test(self, name: str, wanted: object) -> Callable[[Trial], bool]:
        """Return the function that says whether a trial fits one condition."""
        if name in ("object", "trial"):
            names = labels(wanted)
            present = dict.fromkeys(name_of(trial, name) for trial in self.trials)
            for choice in names:
                check_choice(name, choice, present)
            return lambda trial: name_of(trial, name) in names
        known = property_names(self.properties)
        check_choice("property", name, known)
        fits = wanted if callable(wanted) else listed(wanted).__contains__
        return lambda trial: bool(
            name in self.properties.get(trial.object, {}) and fits(self.properties[trial.object][name])
        )
