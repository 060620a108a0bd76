"""One experiment: what was set, the trials that it makes, and what it costs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.experiments.settings import EACH, Value, check_amount
from commonlaw.forecast.prediction import inputs_of_doses
from commonlaw.integration import Inputs
from commonlaw.law import Law
from commonlaw.text import counted

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
        Initial states and rates, shape (D,), and their standard deviations, infinite where they are estimated.
    inputs
        From the first sample on, if there are any.
    properties
        Of a new object.
    repeats
        How often every trial is made.
    prices
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
    prices: Mapping[str, float]

    @classmethod
    def of(
        cls,
        law: Law,
        every: tuple[str, ...],
        settings: Mapping[str, Value],
        prices: Mapping[str, float],
        start_std: Mapping[str, float] | None = None,
    ) -> "Experiment":
        """Return the experiment with these settings, prices and standard deviations of initial conditions."""
        times = _times(settings)
        properties = {name.removeprefix("object."): _number(settings, name) for name in settings if "object." in name}
        chosen = str(settings.get("object", NEW))
        objects = every if chosen == EACH else (NEW,) if properties else (chosen,)
        repeats = round(_number(settings, "repeats", 1.0))
        start = np.array([_start(law, settings, name) for name in law.terms.variables.states])
        known = np.array([float((start_std or {}).get(name, np.inf)) for name in law.terms.variables.states])
        names, inputs = law.schema.inputs, None
        if law.schema.doses:
            amounts = [dict.fromkeys(dose_times(settings, name, times), _number(settings, name)) for name in names]
            inputs = inputs_of_doses(times, amounts)
        elif names:
            columns = np.column_stack([_course(settings, name, times) for name in names])
            inputs = Inputs.of(times, columns, law.schema.input_between)
        return cls(dict(settings), objects, times, start, known, inputs, properties, repeats, prices)

    def until(self, time: float) -> "Experiment":
        """Return the same with the samples up to a time, of which two stay."""
        count = max(2, int(np.searchsorted(self.times, time, side="right")))
        return replace(self, times=self.times[:count])

    def repeated(self, times: int) -> "Experiment":
        """Return the same made so many times."""
        return replace(self, repeats=times * self.repeats)

    @property
    def cost(self) -> float:
        """What all of its trials cost."""
        set_ = {name: own for name, own in self.settings.items() if isinstance(own, float) and name != "repeats"}
        set_ |= {"trial": 1.0, "sample": len(self.times), "duration": float(self.times[-1] - self.times[0])}
        each = sum(self.prices.get(name, 0.0) * abs(own) for name, own in set_.items())
        return self.repeats * sum(each + self.prices.get(name, 0.0) for name in self.objects)

    def described(self, law: Law) -> str:
        """Return the experiment in plain words."""
        units, time = dict(law.schema.units), law.schema.units.get(law.schema.time, "")
        units |= {rate: f"{units.get(state, '')}/{time}".strip("/") for state, rate in law.state_rates}

        def valued(name: str, value: float) -> str:
            return f"{name} = {value:.3g} {units.get(name, '')}".rstrip()

        chosen = self.settings.get("object")
        who = "each object" if chosen == EACH else self.objects[0]
        if self.properties:
            who = f"a new object with {', '.join(valued(*pair) for pair in self.properties.items())}"
        states = [name for name in law.terms.variables.states if name not in law.schema.starts]
        start = ", ".join(valued(name, self.start[law.terms.variables.states.index(name)]) for name in states)
        inputs = [self._input(name, law, units) for name in law.schema.inputs]
        span = f"{self.times[-1] - self.times[0]:.3g} {units.get(law.schema.time, '')}".rstrip()
        parts = [f"{who} from {start}", *inputs, f"{counted(len(self.times), 'sample')} over {span}"]
        return ", ".join(parts) + (f", {self.repeats} times" if self.repeats > 1 else "")

    def _input(self, name: str, law: Law, units: Mapping[str, str]) -> str:
        if name in law.schema.doses:
            given = dose_times(self.settings, name, self.times)
            if not given:
                return f"no {name}"
            first = f"{given[0] - self.times[0]:.3g} {units.get(law.schema.time, '')}".rstrip()
            amount = f"{_number(self.settings, name):.3g} {units.get(name, '')}".rstrip()
            often = f" and {counted(len(given) - 1, 'time')} more" if len(given) > 1 else ""
            return f"{name} of {amount} after {first}{often}"
        shape, level = self.settings.get(f"{name}.shape", "constant"), _number(self.settings, name)
        period = self.settings.get(f"{name}.period")
        every = f" with a period of {period:.3g}" if isinstance(period, float) and shape in ("sine", "square") else ""
        return f"{name} a {shape} of {level:.3g} {units.get(name, '')}".rstrip() + every


def check_prices(prices: Mapping[str, float], settings: Mapping[str, object], law: Law) -> None:
    """Refuse prices of what is no setting, or below zero."""
    known = ["trial", "sample", "duration", *(name for name in settings if name not in ("object", "times", "repeats"))]
    known += law.objects
    for name, price in prices.items():
        if name not in known:
            raise unknown("price", name, dict.fromkeys(known))
        check_amount(f"the price of {name} is", price)


def _number(settings: Mapping[str, Value], name: str, otherwise: float = 0.0) -> float:
    value = settings.get(name, otherwise)
    if not isinstance(value, float | int):
        raise CommonlawError("experiment-number", name=name, value=value)
    return float(value)


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


def _start(law: Law, settings: Mapping[str, Value], name: str) -> float:
    if name in settings:
        return _number(settings, name)
    value = law.schema.starts[name]
    if not isinstance(value, float | int):
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
