"""One run of one object, repeated measurements in it, and the names of what was measured."""

import math
import numbers
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats, Indices, same_content
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.forking import cached_property
from commonlaw.trials.headers import label, plain


@dataclass(frozen=True, eq=False)
class Repeats:
    """Counts of measurements averaged in each sample, and sums of their squared deviations, shape (n, states).

    With white noise of standard deviation s the mean of n measurements has s / sqrt(n), and

        sum_i (y_i - x)^2 = n (mean - x)^2 + sum_i (y_i - mean)^2,

    so that weighted least squares of the means are those of all measurements, and the second sum, which no law changes,
    estimates s^2 with n - 1 degrees of freedom (pure error; Draper and Smith 1998, section 2.1).
    """

    counts: Floats
    squares: Floats

    def taken(self, rows: Any) -> "Repeats":
        """Return those of some samples, by whatever chooses rows of an array."""
        return Repeats(self.counts[rows], self.squares[rows])

    def placed(self, rows: Indices, count: int) -> "Repeats":
        """Return those of so many samples, of which these are at some rows; each other has one measurement."""
        counts, squares = np.ones((count, self.counts.shape[1])), np.zeros((count, self.counts.shape[1]))
        counts[rows], squares[rows] = self.counts, self.squares
        return Repeats(counts, squares)

    def wider(self, states: int) -> "Repeats":
        """Return those of trials with so many further states, each with one measurement."""
        columns = ((0, 0), (0, states))
        return Repeats(np.pad(self.counts, columns, constant_values=1.0), np.pad(self.squares, columns))

    def scaled(self, factors: Floats) -> "Repeats":
        """Return those of states that are multiplied with factors, of a shape that fits."""
        return Repeats(self.counts, self.squares * np.square(factors))

    @property
    def freedom(self) -> Floats:
        """The degrees of freedom of the squares of each state, shape (states,)."""
        return np.asarray(np.sum(self.counts - 1, axis=0))

    @property
    def most(self) -> int:
        """The largest number of measurements."""
        return int(self.counts.max())


def merged(
    first: Indices, states: Floats, noise: Floats, repeats: Repeats | None
) -> tuple[Floats, Floats, Repeats | None]:
    """Return states, noise and repeats with one sample for each time, given the first row of each, shape (times,).

    Measurements with standard deviations are weighted by their inverse squares.
    """
    seen = np.isfinite(states)
    counts = np.where(seen, 1.0 if repeats is None else repeats.counts, 0.0)
    squares = np.where(seen & (repeats is not None), 0.0 if repeats is None else repeats.squares, 0.0)
    values = np.where(seen, states, 0.0)
    known = np.isfinite(noise) & seen
    weights = np.where(known, 1 / np.where(known, noise, 1.0) ** 2, counts)
    total, number = (np.add.reduceat(array, first) for array in (weights, counts))
    rows = np.repeat(np.arange(len(first)), np.diff(first, append=len(states)))
    with np.errstate(divide="ignore", invalid="ignore"):
        means = np.add.reduceat(weights * values, first) / total
        deviations = np.where(seen, counts * (values - means[rows]) ** 2, 0.0)
        std = np.where(np.add.reduceat(known, first), np.sqrt(1 / total), np.nan)
    pooled = Repeats(np.maximum(number, 1.0), np.add.reduceat(squares + deviations, first))
    return means, std, pooled if pooled.most > 1 else None


def joined(parts: Sequence[tuple[Repeats | None, tuple[int, ...]]]) -> Repeats | None:
    """Return those of samples of several parts, one behind the other, each with the shape of its states."""
    if all(repeats is None for repeats, _ in parts):
        return None
    whole = [repeats or Repeats(np.ones(shape), np.zeros(shape)) for repeats, shape in parts]
    return Repeats(*(np.concatenate([getattr(repeats, name) for repeats in whole]) for name in ("counts", "squares")))


def pure_error(repeats: Sequence[Repeats | None], states: int) -> tuple[Floats, Floats]:
    """Return the sum of squares of repeated measurements of each state and its degrees of freedom, shape (states,)."""
    known = [repeat for repeat in repeats if repeat is not None]
    squares = sum((repeat.squares.sum(axis=0) for repeat in known), np.zeros(states))
    return squares, sum((repeat.freedom for repeat in known), np.zeros(states))


class Replication(NamedTuple):
    """Numbers of measurements of each state, and the pure error of repeated ones, each of shape (states,)."""

    counts: Floats
    squares: Floats
    freedom: Floats


def replication(trials: "Iterable[Trial]") -> "list[tuple[Trial, Replication]]":
    """Return the trials, each with its own."""
    return [
        (trial, Replication(trial.counts.sum(axis=0), *pure_error([trial.repeats], trial.states.shape[1])))
        for trial in trials
    ]


Property = float | str
ObjectProperties = Mapping[str, Mapping[str, Property]]
PropertyTable = Mapping[Any, Mapping[str, Property]]
Start = float | str | Mapping[str, float] | None
"""A number, the name of a property, a number for each object, or None for what is to be found in each trial."""

_ARRAYS = ("times", "states", "inputs", "noise", "below")
"""Fields of a trial with a row for each sample."""
EXTREME = float(np.finfo(np.float64).max ** (1 / 6))
"""Largest time and value, and inverse of the smallest step. Squares of second derivatives go with the fourth power of
the step, and the rest is left for the size of the states; the squares of their cubes, as in `poly:3`, are finite."""


@dataclass(frozen=True)
class Dose:
    """An amount that enters a compartment at a time, at once or as an infusion at a constant rate.

    Parameters
    ----------
    time, amount, duration
        When it begins, how much it is (0 of a reset, which empties all compartments), and how long an infusion takes.
    compartment
        The number of the compartment, 0 if the table has none.
    interval
        The time between doses of this kind that led to a steady state before it; 0 if there were none.
    is_before
        Whether a measurement at the same time shows it.
    """

    time: float
    amount: float
    duration: float = 0.0
    compartment: int = 0
    interval: float = 0.0
    is_before: bool = False


@dataclass(frozen=True)
class Schema:
    """Names, roles and units of the columns of a table of trials.

    Raises `CommonlawError` if there is no state, two columns have the same name, or a named column is missing.

    Parameters
    ----------
    states, inputs
        Names of the measured states, such as ``("x", "y")``, and of measured inputs (controls, forcing).
    object, trial, time
        Names of the columns of objects, labels of trials and times.
    units
        Units by column, in any form that pint reads (``"m/s^2"``), where there are any.
    noise_columns
        Names of the columns of standard deviations by state, where there are any.
    logarithmic
        Log-scaled states, which stand here by their logarithms.
    input_interpolation
        The interpolation of inputs between samples, see `Law.predict`.
    rates
        Columns that are the rate of a state, by that state: ``{"theta": "omega"}``; they are no states.
    initial_values, initial_time
        Initial values of latent states, see `commonlaw.fit`, and their time; None for that of each trial's first
        sample.
    calendar
        Whether times are dates or times of day, whose origin has no meaning.
    doses
        Inputs that hold what is added in a moment.
    wide
        Columns that each held an object, in a table without a column of objects.
    administered
        What ``Trial.doses`` are called, their amounts and, where a table has them, their rates; none once these are
        inputs.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    object: str = "object"
    trial: str = "trial"
    time: str = "t"
    units: Mapping[str, str] = field(default_factory=dict)
    noise_columns: Mapping[str, str] = field(default_factory=dict)
    logarithmic: tuple[str, ...] = ()
    input_interpolation: str = "linear"
    rates: Mapping[str, str] = field(default_factory=dict)
    initial_values: Mapping[str, Start] = field(default_factory=dict)
    initial_time: float | None = None
    calendar: bool = False
    doses: tuple[str, ...] = ()
    wide: tuple[str, ...] = ()
    administered: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_types(Schema, vars(self))
        names = [self.object, self.trial, self.time, *self.states, *self.inputs, *{*self.noise_columns.values()}]
        names += [*self.rates.values(), *self.administered]
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise CommonlawError("column-name-twice", name=twice[0])
        if not self.states:
            raise CommonlawError("no-state-named")
        for name in (*self.noise_columns, *self.logarithmic, *self.initial_values):
            check_choice("state", name, self.states)
        for name in self.doses:
            check_choice("input", name, self.inputs)
        if len({*self.logarithmic}) < len(self.logarithmic):
            raise CommonlawError("log-state-twice", states=self.logarithmic)

    @property
    def measured(self) -> tuple[str, ...]:
        """The states that have a column: all but those of which only starts are known."""
        return tuple(name for name in self.states if name not in self.initial_values)

    @property
    def is_latent(self) -> Bools:
        """Which states are latent, so that only their initial values are known, shape (states,)."""
        return np.array([name in self.initial_values for name in self.states], dtype=np.bool_)

    @property
    def with_free_start(self) -> Bools:
        """Which of these have unknown initial values, shape (states,)."""
        return np.array([self.initial_values.get(name, 0.0) is None for name in self.states], dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class Trial:
    """One experiment on one object: times, states and inputs.

    Raises `CommonlawError` if there is no sample or no label, shapes disagree, a value is not finite, the first sample
    has no measured state, a measurement lacks its standard deviation, times go back, or inputs differ at one time; the
    message names the sample.

    Parameters
    ----------
    object, name
        The name of the object, and the label of the trial, unique for its object.
    times
        Sample times, increasing, shape (n,). Several measurements at one time become one sample, see `Repeats`.
    states
        Measured states, shape (n, states); NaN where one was not measured, or is to be forecast.
    inputs
        Measured inputs, shape (n, inputs).
    noise
        Standard deviations, shape (n, states): of all measurements of a state or of none; NaN where not known.
    repeats
        Counts and scatter of measurements that were averaged; None if each is one.
    earlier
        Times and inputs before the first sample, where some are not zero, shape (m, 1 + inputs).
    below
        Limits of quantification, shape (n, states), of left-censored values, whose state is NaN; NaN elsewhere.
    begins_with_dose
        Whether a dose is given at the first sample: states that were not measured there are zero before it.
    doses
        Doses that the table records, in the order of time, before `with_doses` makes inputs of them.
    cycle
        The period of a steady state: the states return to those at the first sample after it; 0 without such.
    corners
        Times of samples that `with_doses` adds, and, where such a sample ends a dose at once, of this dose, else NaN,
        shape (k, 2).
    """

    object: str
    name: str
    times: Floats
    states: Floats
    inputs: Floats = field(default_factory=lambda: np.empty((0, 0)))
    noise: Floats = field(default_factory=lambda: np.empty((0, 0)))
    repeats: Repeats | None = None
    earlier: Floats = field(default_factory=lambda: np.empty((0, 0)))
    below: Floats = field(default_factory=lambda: np.empty((0, 0)))
    begins_with_dose: bool = False
    doses: tuple[Dose, ...] = ()
    cycle: float = 0.0
    corners: Floats = field(default_factory=lambda: np.empty((0, 2)))

    def __post_init__(self) -> None:
        for name in ("object", "name"):
            object.__setattr__(self, name, label(getattr(self, name)))
        try:
            parts = {name: _frozen(getattr(self, name), 1 if name == "times" else 2) for name in _ARRAYS}
        except CommonlawError as error:
            raise error.at(self.label) from None
        if parts["inputs"].size == 0:
            parts["inputs"] = _frozen(np.empty((len(parts["times"]), 0)), 2)
        unknown = np.isnan(parts["noise"]).all()
        for name, values in parts.items():
            if name in ("noise", "below") and np.isnan(values).all():
                values = np.broadcast_to(np.nan, parts["states"].shape)  # Takes no memory
            object.__setattr__(self, name, values)
        self._check()
        if not unknown:
            if self.noise.shape != self.states.shape:
                raise CommonlawError(
                    "deviations-shape", where=self.label, given=self.noise.shape, expected=self.states.shape
                )
            missing = np.isnan(self.noise) & np.isfinite(self.states) & self.known_noise
            bad = np.argwhere(missing | (self.noise <= 0) | np.isinf(self.noise))
            if len(bad):
                raise CommonlawError(
                    "deviation-not-positive",
                    where=self.label,
                    state=bad[0][1] + 1,
                    value=self.noise[tuple(bad[0])],
                    sample=bad[0][0] + 1,
                )
        if (np.diff(self.times) == 0).any():
            self._merge()

    def __len__(self) -> int:
        return len(self.times)

    def __eq__(self, other: Any) -> bool:
        return same_content(self, other) if isinstance(other, Trial) else NotImplemented

    def __hash__(self) -> int:
        return hash((self.object, self.name, len(self)))

    @property
    def label(self) -> str:
        """Object and trial as shown in messages: ``Golf Ball, trial 1``."""
        return f"{self.object}, trial {self.name}"

    @cached_property
    def known_noise(self) -> Bools:
        """Of which states standard deviations of measurements are known, shape (states,)."""
        seen = self.noise if any(self.noise.strides) else self.noise[:1]
        return np.asarray(np.isfinite(seen).any(axis=0))

    @cached_property
    def complete(self) -> bool:
        """Whether every state was measured in every sample."""
        return not np.isnan(self.states).any()

    def cut(self, stop: int) -> "Trial":
        """Return the trial's first `stop` samples."""
        return self.rows(slice(stop))

    def measured(self) -> "Trial":
        """Return the trial without samples in which no state was measured."""
        if self.complete:
            return self
        kept = np.asarray(np.isfinite(self.states).any(axis=1))
        return self if kept.all() else self.rows(kept)

    def rows(self, chosen: slice | Bools) -> "Trial":
        """Return the chosen samples of the trial."""
        parts = {name: getattr(self, name)[chosen] for name in _ARRAYS}
        repeats = None if self.repeats is None else self.repeats.taken(chosen)
        is_whole = len(parts["times"]) > 0 and parts["times"][0] == self.times[0]
        earlier = self.earlier if is_whole else np.empty((0, 0))
        begins_with_dose = self.begins_with_dose and is_whole
        cycle = self.cycle if is_whole else 0.0
        return replace(self, **parts, repeats=repeats, earlier=earlier, begins_with_dose=begins_with_dose, cycle=cycle)

    @property
    def elapsed(self) -> Floats:
        """Times since the first sample, shape (n,)."""
        return np.asarray(self.times - self.times[0])

    def std(self, typical: Floats) -> Floats:
        """Return the standard deviation of each state, shape (n, states).

        Where it is not known it follows from the typical one of a single measurement, shape (states,).
        """
        return with_typical(self.noise, typical) * self.averaging

    @property
    def averaging(self) -> Floats | float:
        """By what repeats lower a noise that is not known, shape (n, states), or 1."""
        return 1.0 if self.repeats is None else np.where(np.isnan(self.noise), self.repeats.counts**-0.5, 1.0)

    @property
    def absent(self) -> Bools:
        """Which states are exactly zero wherever they were measured, twice at least: no noise is, shape (states,)."""
        seen = np.isfinite(self.states)
        return np.asarray((seen.sum(axis=0) > 1) & ~np.any(seen & (self.states != 0), axis=0))

    @property
    def counts(self) -> Floats:
        """How many measurements of each state there are at each sample, shape (n, states)."""
        return np.isfinite(self.states) * (1.0 if self.repeats is None else self.repeats.counts)

    def _merge(self) -> None:
        """Make one sample of those at one time; an input that is zero in some of them is what it is in the others."""
        first = np.flatnonzero(np.diff(self.times, prepend=-np.inf) > 0)
        below = np.broadcast_to(np.nan, (len(first), self.states.shape[1]))
        if np.isfinite(self.below).any():
            seen = np.isfinite(self.below) | np.isfinite(self.states)
            several = (np.add.reduceat(seen, first, dtype=int) > 1) & np.logical_or.reduceat(
                np.isfinite(self.below), first
            )
            if several.any():
                time = self.times[first[np.argwhere(several)[0][0]]]
                raise CommonlawError("censored-replicates", where=self.label, time=time)
            below = np.fmax.reduceat(self.below, first)
        rows = np.repeat(np.arange(len(first)), np.diff(first, append=len(self)))
        # An input of a row of inputs alone, such as a dose, counts where the other rows of its time have zero
        low, high = np.minimum.reduceat(self.inputs, first), np.maximum.reduceat(self.inputs, first)
        alone = np.logical_or.reduceat(np.isnan(self.states).all(axis=1), first)[:, np.newaxis]
        inputs = np.where(alone, np.where(high > 0, high, low), self.inputs[first])
        differ = ~((self.inputs == inputs[rows]) | (alone[rows] & (self.inputs == 0))).all(axis=1)
        if differ.any():
            i = int(np.argmax(differ))
            here = int(first[rows[i]])
            raise CommonlawError("inputs-differ", where=self.label, time=self.times[i], first=here + 1, second=i + 1)
        states, noise, repeats = merged(first, self.states, self.noise, self.repeats)
        for name, values in zip(_ARRAYS, (self.times[first], states, inputs, noise, below), strict=True):
            object.__setattr__(self, name, _frozen(values, values.ndim))
        object.__setattr__(self, "repeats", repeats)

    def _check(self) -> None:
        if not self.object or not self.name:
            raise CommonlawError("label-empty", where=self.label)
        if not len(self.times):
            raise CommonlawError("trial-without-samples", trial=self.label)
        if not len(self.times) == len(self.states) == len(self.inputs):
            raise CommonlawError(
                "rows-differ", where=self.label, times=len(self.times), states=len(self.states), inputs=len(self.inputs)
            )
        for what, values in (("time", self.times), ("state", self.states), ("input", self.inputs)):
            wrong = np.isinf(values) if what == "state" else ~np.isfinite(values)
            if wrong.any():
                bad = np.argwhere(wrong)
                where = f"sample {bad[0][0] + 1}" + (f", {what} {bad[0][1] + 1}" if values.ndim == 2 else "")
                raise CommonlawError(
                    "sample-not-finite", where=self.label, quantity=what, value=values[tuple(bad[0])], place=where
                )
        if self.below.shape != self.states.shape or np.any(np.isfinite(self.below) & np.isfinite(self.states)):
            raise CommonlawError("censored-shape", where=self.label)
        is_empty = self.states.shape[1] and np.isnan(self.states[0]).all() and np.isnan(self.below[0]).all()
        if is_empty and not self.begins_with_dose:
            raise CommonlawError("first-sample-empty", where=self.label)
        steps = np.diff(self.times)
        steps = steps[steps != 0]
        smallest, largest = steps.min(initial=np.inf), max(abs(self.times[0]), abs(self.times[-1]))
        if smallest < 0:
            i = int(np.argmax(steps < 0))
            raise CommonlawError(
                "time-before", where=self.label, time=self.times[i + 1], sample=i + 2, before=self.times[i]
            )
        if largest > EXTREME or smallest < 1 / EXTREME:
            what = f"times up to {largest:.3g}" if largest > EXTREME else f"a time step of {smallest:.3g}"
            raise CommonlawError("times-too-large", trial=self.label, times=what)


class NoSuchTrialError(CommonlawError, IndexError):
    """An index beyond the trials of a collection."""


class TrialData(NamedTuple):
    """What a collection of trials is made of: see `Trials`."""

    trials: tuple[Trial, ...]
    schema: Schema
    properties: ObjectProperties
    notes: tuple[str, ...]
    nameless: bool = False
    guessed: tuple[str, ...] = ()
    text_columns: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()


def with_typical(noise: Floats | float, typical: Floats) -> Floats:
    """Return the standard deviation of each measurement, shape (n, d), a typical one, shape (d,), where it is NaN."""
    return np.where(np.isnan(noise), typical, noise)


def value_range(values: Floats) -> tuple[float, float]:
    """Return the least and the largest of some values, NaN aside; NaN if there are no others."""
    return float(np.fmin.reduce(values)), float(np.fmax.reduce(values))


def property_names(properties: ObjectProperties) -> list[str]:
    """Return the names of properties of objects, in order of first appearance."""
    return list(dict.fromkeys(name for values in properties.values() for name in values))


def normalized(properties: ObjectProperties) -> dict[str, dict[str, Property]]:
    """Return properties with labels for objects, floats for numbers, and no object that has none."""
    return {
        label(name): {str(key): _property(f"property {key!r} of {name}", value) for key, value in values.items()}
        for name, values in properties.items()
        if values
    }


def check_properties(properties: ObjectProperties, objects: Sequence[str], schema: Schema) -> None:
    """Refuse properties of objects without trials, with the names of columns, or with values that cannot be used.

    A property that names the objects, such as a mass, has the name of their column.
    """
    known_objects = {*objects}
    orphans = [name for name in properties if name not in known_objects]
    if orphans:
        raise CommonlawError("properties-of-no-trial", names=orphans, objects=objects)
    columns = {schema.trial, schema.time, *schema.states, *schema.inputs}
    first: dict[str, tuple[str, Property]] = {}
    for name, values in properties.items():
        for key, value in values.items():
            if key in columns:
                raise CommonlawError("property-named-like-column", name=key)
            if value == "" or (isinstance(value, float) and not math.isfinite(value)):
                raise CommonlawError("property-unknown-value", property=key, object=name, value=value)
            first_name, known = first.setdefault(key, (name, value))
            if type(known) is not type(value):
                raise CommonlawError(
                    "property-of-two-kinds", property=key, known=known, first=first_name, value=value, second=name
                )


def _property(what: str, value: object) -> Property:
    if isinstance(value, numbers.Real):
        return nearest(value)
    if not isinstance(value, str):
        raise CommonlawError("property-value", property=what, value=value)
    return plain(value)


def check_measured(trials: Sequence[Trial], states: Sequence[str]) -> None:
    """Refuse states that were measured in no trial."""
    for j, name in enumerate(states):
        if not any((np.isfinite(trial.states[:, j]) | np.isfinite(trial.below[:, j])).any() for trial in trials):
            raise CommonlawError(
                "state-with-gaps", where=trials[0].label, state=name, measured=0, samples=len(trials[0]), least=1
            )


def check_gaps(trials: Sequence[Trial], schema: Schema) -> None:
    """Refuse trials in which a state with gaps has too few values for a curve; one will do if rows are to be forecast.

    `commonlaw.fit` takes such trials.
    """
    if (gap := _sparse(trials, schema)) is not None:
        i, j, least = gap
        measured = np.isfinite(trials[i].states[:, j]).sum()
        raise CommonlawError(
            "state-with-gaps",
            where=trials[i].label,
            state=schema.states[j],
            measured=measured,
            samples=len(trials[i]),
            least=least,
        )


def has_sparse_states(trials: Sequence[Trial], schema: Schema) -> bool:
    """Return whether `check_gaps` refuses trials."""
    return _sparse(trials, schema) is not None


def _sparse(trials: Sequence[Trial], schema: Schema) -> tuple[int, int, int] | None:
    """Return the first trial and state with too few values, and how many are needed; None if there is none."""
    if all(trial.complete for trial in trials):
        return None
    counts = np.array([np.sum(~np.isnan(trial.states), axis=0) for trial in trials])
    samples = [int(np.sum(~np.isnan(trial.states).all(axis=1))) for trial in trials]  # Others have inputs alone
    least = [
        # Fewer measured values leave nothing to draw a curve through
        min(1 if np.isnan(trial.states[-1]).all() else 5, sample)
        for trial, sample in zip(trials, samples, strict=True)
    ]
    few = np.argwhere((counts < np.array(least)[:, np.newaxis]) & (counts > 0) & ~schema.is_latent).tolist()
    return (few[0][0], few[0][1], least[few[0][0]]) if few else None


def check_noise_columns(trial: Trial, schema: Schema) -> None:
    """Refuse a trial with standard deviations of a state for which the schema names no column, or without others."""
    for j, name in enumerate(schema.states):
        named, known = name in schema.noise_columns, bool(trial.known_noise[j])
        if known and not named and name not in schema.initial_values:
            raise CommonlawError("deviations-without-column", trial=trial.label, state=name)
        if named and not known and np.isfinite(trial.states[:, j]).any():
            raise CommonlawError("deviations-missing", trial=trial.label, state=name, column=schema.noise_columns[name])


def as_numbers(values: ArrayLike) -> Floats:
    """Return a copy of `values`, NaN where they are masked, refused if they are no real numbers."""
    try:
        if isinstance(values, np.ma.MaskedArray):
            return np.array(np.ma.filled(values.astype(np.float64), np.nan), dtype=np.float64)
        if isinstance(values, np.ndarray) and values.dtype == np.float64:
            return values.astype(np.float64, subok=False)
        if np.iscomplexobj(values):
            raise TypeError("these are complex ones, give their real and imaginary parts")
        if np.asarray(values).dtype.kind in "mM":
            raise TypeError("these are dates or durations; as times of Trials.from_arrays they are read")
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise CommonlawError("not-an-array", error=error) from None


def nearest(value: Any) -> float:
    """Return the float nearest to a number, infinite if that is too large for one."""
    try:
        return float(value)
    except OverflowError:
        return np.inf if value > 0 else -np.inf


def _frozen(values: Floats, dimensions: int) -> Floats:
    """Return a read-only copy of `values` with the given number of dimensions."""
    array = as_numbers(values)
    if array.ndim == 1 and dimensions == 2:
        array = array[:, np.newaxis]
    if array.ndim != dimensions:
        raise CommonlawError("array-dimensions", dimensions=dimensions, shape=array.shape)
    array.flags.writeable = False
    return array
