"""What can be set in an experiment, and one experiment with its trials and its cost."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from numbers import Real
from typing import cast

import numpy as np

from commonlaw.array_types import Floats, evenly_spaced
from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.forecast.simulation import inputs_of_doses
from commonlaw.integration import Inputs
from commonlaw.law import Law
from commonlaw.law.parameters import state_rates, units_with_rates
from commonlaw.text import counted
from commonlaw.trials import Schema

Value = float | str | tuple[float, ...]
"""A number; the name of an object or of a shape; or the times of the samples."""

SHAPES = ("constant", "step", "ramp", "sine", "square")
"""Of an input: its level throughout, from half of the duration on, or reached at its end; or it swings by its level."""

EACH = "each"
"""The object that stands for each of them: a trial of every one."""

TIMING = ("duration", "rate", "samples", "times", "repeats", "object")


@dataclass(frozen=True)
class Range:
    """Numbers between two ends, that are given."""

    low: float
    high: float

    def at(self, share: float) -> float:
        """Return the number so far along, rounded to a number that can be set.

        >>> Range(5.0, 60.0).at(0.523), Range(0.02, 0.1).at(0.4)
        (34.0, 0.052)
        """
        value = self.low + share * (self.high - self.low)
        return float(np.clip(rounded_to(value, (self.high - self.low) / 20), self.low, self.high))


def rounded_to(value: float, resolution: float) -> float:
    """Return a number rounded to the largest power of ten below a resolution, which is positive."""
    return round(value, -int(np.floor(np.log10(resolution))))


Options = Range | tuple[Value, ...]


@dataclass(frozen=True)
class Settings:
    """All that can be set, in ranges or lists; a point in the unit cube is one choice of all.

    Of more than 20 objects so many are taken, evenly spread. For the names of options see `design`.
    """

    objects: tuple[str, ...]
    options: Mapping[str, Options]

    @classmethod
    def of(cls, law: Law, vary: Mapping[str, object], usual: Mapping[str, Options]) -> "Settings":
        """Return the settings of experiments with a law, from options as users write them, and defaults.

        Raises `CommonlawError` if a setting is unknown, cannot be read, or is missing.
        """
        given = {name: read(name, value) for name, value in vary.items()}
        schema, states = law.observation.measured, law.terms.variables.states
        details = ("at", "every") if schema.doses else ("shape", "period")
        inputs = [name for u in schema.inputs for name in (u, *(f"{u}.{detail}" for detail in details))]
        for name in given:
            if name not in (*TIMING, *states, *inputs) and not (name.startswith("object.") and name != "object."):
                raise unknown("setting of an experiment", name, (*states, *inputs, *TIMING, "object.<property>"))
        replaced = {"rate", "samples"} if {"rate", "samples", "times"} & {*given} else set[str]()
        replaced |= {"duration"} if "times" in given else set()
        replaced |= {"object"} if any(name.startswith("object.") for name in given) else set()
        options = {**{name: value for name, value in usual.items() if name not in replaced}, **given}
        if any(name.startswith("object.") for name in options):
            if "object" in options:
                raise CommonlawError("setting-object-twice")
            properties = law.uncertainty.explanation.properties if law.uncertainty.explanation else ()
            for name in options:
                head, dot, tail = name.partition(".")
                if head == "object" and dot and tail not in properties:
                    if not properties:
                        raise CommonlawError("setting-without-properties", name=name)
                    raise CommonlawError("setting-not-a-property", name=name, properties=properties)
            missing = [f"object.{attribute}" for attribute in properties if f"object.{attribute}" not in options]
            if missing:
                raise CommonlawError("setting-properties-missing", properties=missing)
            objects = _some(law.objects)
        else:
            named = tuple(dict.fromkeys(_words_of(options.get("object", law.objects))))
            for name in named:
                check_choice("object of this law", name, (*law.objects, EACH))
            objects = _some(law.objects if EACH in named else named)
            options["object"] = named if EACH in named else objects
        _check_complete(options, law)
        return cls(objects, options)

    @property
    def varied(self) -> tuple[str, ...]:
        """What there is a choice of."""
        return tuple(name for name, option in self.options.items() if isinstance(option, Range) or len(option) > 1)

    def at(self, point: Floats) -> dict[str, Value]:
        """Return the settings at a point of the unit cube, shape (varied settings,)."""
        result, shares = dict[str, Value](), dict(zip(self.varied, point.tolist(), strict=True))
        for name, option in self.options.items():
            share = shares.get(name, 0.0)
            if isinstance(option, Range):
                result[name] = option.at(share)
            else:
                result[name] = option[min(int(share * len(option)), len(option) - 1)]
        return result

    def spread(self, count: int, seed: int, all_corners: int = 6) -> Floats:
        """Return points all over the unit cube, shape (points, varied): corners, and as many more (Sobol 1967).

        Of more ranges than `all_corners` some corners are drawn.
        """
        from scipy.stats import qmc

        if not self.varied:
            return np.zeros((1, 0))
        ranges = [j for j, name in enumerate(self.varied) if isinstance(self.options[name], Range)]
        inner = qmc.Sobol(len(self.varied), seed=seed).random_base2(int(np.ceil(np.log2(count))))
        if len(ranges) > all_corners:
            ends = np.random.default_rng(seed).integers(2, size=(2**all_corners, len(ranges))).astype(float)
        else:
            ends = np.array(list(product((0.0, 1.0), repeat=len(ranges))))
        lists = [len(options) for name in self.varied if not isinstance(options := self.options[name], Range)]
        corners = np.tile(ends, (max(1, *lists, 1), 1))
        result = qmc.Sobol(len(self.varied), seed=seed + 1).random_base2(int(np.ceil(np.log2(len(corners) + 1))))
        result = result[: len(corners)]
        result[:, ranges] = corners
        return np.concatenate([result, inner])

    def near(self, point: Floats, width: float, count: int, seed: int) -> Floats:
        """Return points about one, shape (count, varied): numbers within a width, one of the lists' values anew."""
        random = np.random.default_rng(seed)
        result = np.clip(point + width * random.uniform(-1, 1, (count, len(point))), 0.0, 1.0)
        for j, name in enumerate(self.varied):
            if not isinstance(self.options[name], Range):
                result[:, j] = np.where(random.uniform(size=count) < width, random.uniform(size=count), point[j])
        return result


def read(name: str, value: object) -> Options:
    """Return the options that a setting was given.

    >>> read("x", "5..60"), read("rate", "15, 30"), read("x", (5, 60)), read("object", ["Ball 1"])
    (Range(low=5.0, high=60.0), (15.0, 30.0), Range(low=5.0, high=60.0), ('Ball 1',))
    """
    in_words = _is_in_words(name)
    if isinstance(value, Range) and not in_words:
        return value
    if isinstance(value, str):
        low, dots, high = value.partition("..")
        if dots and not in_words:
            return _range(name, low, high)
        return tuple(_plain(name, part.strip()) for part in value.split(","))
    if isinstance(value, tuple) and len(value) == 2 and name != "times" and not in_words:
        return _range(name, *value)
    values = value if isinstance(value, list | tuple) else [value]
    if name == "times" and values and not isinstance(values[0], list | tuple | np.ndarray):
        values = [values]
    if not values:
        raise CommonlawError("setting-empty", name=name)
    return tuple(_plain(name, part) for part in values)


def _range(name: str, low: object, high: object) -> Range:
    first, last = _plain(name, low), _plain(name, high)
    if not (isinstance(first, float) and isinstance(last, float) and first < last):
        raise CommonlawError("setting-range", name=name, low=low, high=high)
    return Range(first, last)


def _plain(name: str, value: object) -> Value:
    if name == "times":
        return tuple(np.asarray(value, dtype=np.float64).tolist())
    if _is_in_words(name):
        return str(value)
    try:
        number = float(str(value))
    except ValueError:
        raise CommonlawError("setting-syntax", name=name, value=value) from None
    if not np.isfinite(number):
        raise CommonlawError("setting-not-finite", name=name, value=value)
    return number


def _is_in_words(name: str) -> bool:
    """Whether the values of a setting are words: names of objects, and of the shapes of inputs."""
    return name == "object" or name.endswith(".shape")


def numbers_of(options: Options) -> tuple[float, ...]:
    """Return the ends of a range, or the numbers of a list."""
    listed = (options.low, options.high) if isinstance(options, Range) else options
    return tuple(value for value in listed if isinstance(value, float))


def _words_of(options: Options) -> tuple[str, ...]:
    return () if isinstance(options, Range) else tuple(map(str, options))


def check_amount(what: str, value: object) -> None:
    """Refuse what is no finite number from zero on."""
    if not (isinstance(value, float | int | np.floating | np.integer) and 0 <= value < np.inf):
        raise CommonlawError("setting-negative", name=what, value=value)


def _some(names: tuple[str, ...], most: int = 20) -> tuple[str, ...]:
    """Return names, of many some that are evenly spread."""
    return tuple(names[i] for i in evenly_spaced(len(names), most))


def _check_complete(options: Mapping[str, Options], law: Law) -> None:
    """Refuse settings that leave open what every experiment needs, or have values that it cannot have."""
    known, schema = {*options, *given_starts(law)}, law.observation.measured
    missing = [name for name in (*law.terms.variables.states, *schema.inputs) if name not in known]
    if "times" not in options:
        missing += [name for name in ("duration",) if name not in options]
        missing += ["rate"] if not {"rate", "samples"} & {*options} else []
    if missing:
        visited = law.provenance.domain.visited
        shown = {"duration": "1..5", "rate": "10..100"}
        shown |= {name: f"{visited[name][0]:.3g}..{visited[name][1]:.3g}" for name in missing if name in visited}
        ways = ", ".join(f"{name}={shown.get(name, '0..1')}" for name in missing)
        raise CommonlawError("setting-missing", settings=ways)
    above = {"duration": 0.0, "rate": 0.0, "samples": 1.0, "repeats": 0.0}
    above |= {f"{name}.every": 0.0 for name in schema.doses}
    for name, least in above.items():
        for number in numbers_of(options.get(name, ())):
            if not number > least:
                raise CommonlawError("setting-too-small", name=name, value=number, least=least)
    for name in schema.doses:
        for number in numbers_of(options.get(f"{name}.at", ())):
            check_amount(f"{name}.at is", number)
    for name in schema.logarithmic:
        if any(not number > 0 for number in numbers_of(options.get(name, ()))):
            raise CommonlawError("setting-not-positive", name=name)
    for name in schema.inputs:
        for shape in _words_of(options.get(f"{name}.shape", ())):
            check_choice("shape of an input", shape, SHAPES)


NEW = "new object"

_MAX_SAMPLES = 1_000_000


@dataclass(frozen=True, eq=False)
class Experiment:
    """An experiment: one trial, or one of each object, and its repeats.

    Parameters
    ----------
    settings
        By name, see `Settings`.
    objects
        Of which there is a trial each.
    times
        Of the samples, shape (n,).
    start, start_std
        Initial states and rates, shape (D,), NaN where observations of the law give them, and their standard
        deviations, infinite where they are estimated.
    inputs
        From the first sample on, if there are any.
    properties
        Of a new object.
    repeats
        How often every trial is made.
    unit_costs
        Of a ``trial``, a ``sample``, a unit of any numeric setting, and a trial of an object by its name.
    """

    settings: Mapping[str, Value]
    objects: tuple[str, ...]
    times: Floats
    start: Floats
    start_std: Floats
    inputs: Inputs | None
    properties: Mapping[str, float]
    repeats: int
    unit_costs: Mapping[str, float]

    @classmethod
    def of(
        cls,
        law: Law,
        every: tuple[str, ...],
        settings: Mapping[str, Value],
        unit_costs: Mapping[str, float],
        start_std: Mapping[str, float] | None = None,
    ) -> "Experiment":
        """Return the experiment with these settings, unit_costs and standard deviations of initial conditions."""
        times = _times(settings)
        properties = {name.removeprefix("object."): _number(settings, name) for name in settings if "object." in name}
        chosen = str(settings.get("object", NEW))
        objects = every if chosen == EACH else (NEW,) if properties else (chosen,)
        repeats = round(_number(settings, "repeats", 1.0))
        start = np.array([_start(law, settings, name) for name in law.terms.variables.states])
        known = np.array([float((start_std or {}).get(name, np.inf)) for name in law.terms.variables.states])
        names, inputs = law.observation.measured.inputs, None
        if law.observation.measured.doses:
            amounts = [dict.fromkeys(dose_times(settings, name, times), _number(settings, name)) for name in names]
            inputs = inputs_of_doses(times, amounts)
        elif names:
            columns = np.column_stack([_course(settings, name, times) for name in names])
            inputs = Inputs.of(times, columns, law.observation.measured.input_interpolation)
        return cls(dict(settings), objects, times, start, known, inputs, properties, repeats, unit_costs)

    def until(self, time: float) -> "Experiment":
        """Return the same with the samples up to a time, of which two stay."""
        return replace(self, times=self.times[: max(2, int(np.searchsorted(self.times, time, side="right")))])

    def repeated(self, times: int) -> "Experiment":
        """Return the same made so many times."""
        return replace(self, repeats=times * self.repeats)

    @property
    def cost(self) -> float:
        """What all of its trials cost."""
        numbers = {key: value for key, value in self.settings.items() if isinstance(value, float) and key != "repeats"}
        numbers |= {"trial": 1.0, "sample": len(self.times), "duration": float(self.times[-1] - self.times[0])}
        per_object = sum(self.unit_costs.get(name, 0.0) * abs(setting) for name, setting in numbers.items())
        return self.repeats * sum(per_object + self.unit_costs.get(name, 0.0) for name in self.objects)

    def described(self, law: Law) -> str:
        """Return the experiment in plain words."""
        units = units_with_rates(law)

        def valued(name: str, value: float) -> str:
            return f"{name} = {value:.3g} {units.get(name, '')}".rstrip()

        who = "each object" if self.settings.get("object") == EACH else self.objects[0]
        if self.properties:
            who = f"a new object with {', '.join(valued(*pair) for pair in self.properties.items())}"
        given, schema = given_starts(law), law.observation.measured
        pairs = zip(law.terms.variables.states, self.start.tolist(), strict=True)
        start = ", ".join(valued(name, value) for name, value in pairs if name in self.settings or name not in given)
        inputs = [self._input(name, schema, units) for name in schema.inputs]
        span = f"{self.times[-1] - self.times[0]:.3g} {units.get(law.schema.time, '')}".rstrip()
        parts = [f"{who} from {start}" if start else who, *inputs, f"{counted(len(self.times), 'sample')} over {span}"]
        return ", ".join(parts) + (f", {self.repeats} times" if self.repeats > 1 else "")

    def _input(self, name: str, schema: Schema, units: Mapping[str, str]) -> str:
        if name in schema.doses:
            given = dose_times(self.settings, name, self.times)
            if not given:
                return f"no {name}"
            first = f"{given[0] - self.times[0]:.3g} {units.get(schema.time, '')}".rstrip()
            amount = f"{_number(self.settings, name):.3g} {units.get(name, '')}".rstrip()
            often = f" and {counted(len(given) - 1, 'time')} more" if len(given) > 1 else ""
            return f"{name} of {amount} after {first}{often}"
        shape, level = self.settings.get(f"{name}.shape", "constant"), _number(self.settings, name)
        period = self.settings.get(f"{name}.period")
        every = f" with a period of {period:.3g}" if isinstance(period, float) and shape in ("sine", "square") else ""
        return f"{name} a {shape} of {level:.3g} {units.get(name, '')}".rstrip() + every


def _number(settings: Mapping[str, Value], name: str, otherwise: float = 0.0) -> float:
    return float(cast(float, settings.get(name, otherwise)))


def _times(settings: Mapping[str, Value]) -> Floats:
    listed = settings.get("times")
    if listed is not None:
        times = np.array(listed)
        if times.ndim != 1 or len(times) < 2 or not np.all(np.diff(times) > 0):
            raise CommonlawError("experiment-times")
        return times
    duration = _number(settings, "duration")
    count = _number(settings, "samples") if "samples" in settings else duration * _number(settings, "rate") + 1
    if count > _MAX_SAMPLES:
        raise CommonlawError("experiment-too-many-samples", count=count)
    return np.asarray(np.linspace(0.0, duration, max(2, round(count))))


def given_starts(law: Law) -> frozenset[str]:
    """Return the states and rates whose initial values a law gives for all of its objects."""
    rates = {f"{state}'": rate for state, rate in state_rates(law)}
    given = law.observation.initial.items()
    partly = [name for name, start in given if isinstance(start, Mapping) and not {*start} >= {*law.objects}]
    return frozenset(rates.get(name, name) for name, _ in given if name not in partly) | {*law.schema.initial_values}


def _start(law: Law, settings: Mapping[str, Value], name: str) -> float:
    if name in settings:
        return _number(settings, name)
    value = law.schema.initial_values.get(name, np.nan)  # NaN where it follows from the law
    if not isinstance(value, Real):
        raise CommonlawError("experiment-start", name=name)
    return float(value)


def dose_times(settings: Mapping[str, Value], name: str, times: Floats) -> list[float]:
    """Return when a dose is given: once, or again and again; not from the last sample on."""
    first = float(times[0]) + _number(settings, f"{name}.at")
    every, last = _number(settings, f"{name}.every", np.inf), float(times[-1])
    if first >= last:
        return []
    if (last - first) / every > _MAX_SAMPLES:
        raise CommonlawError("experiment-too-many-doses", count=(last - first) / every, name=name)
    return [first, *(first + k * every for k in range(1, int(np.ceil((last - first) / every))))]


def _course(settings: Mapping[str, Value], name: str, times: Floats) -> Floats:
    """Return an input at the times of the samples."""
    level, shape = _number(settings, name), settings.get(f"{name}.shape", "constant")
    since, span = times - times[0], times[-1] - times[0]
    period = _number(settings, f"{name}.period", span)
    courses = {
        "constant": np.ones_like(since),
        "step": (since >= span / 2).astype(float),
        "ramp": since / span,
        "sine": np.sin(2 * np.pi * since / period),
        "square": np.where(since % period < period / 2, 1.0, -1.0),
    }
    return np.asarray(level * courses[str(shape)])
