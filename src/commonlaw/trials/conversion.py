"""Trials in other units."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.trial import Property, Trial
from commonlaw.trials.trials import Trials
from commonlaw.trials.units import parse_unit, registry


class Conversion(NamedTuple):
    """From one unit to another: ``scale * value + offset``."""

    scale: float = 1.0
    offset: float = 0.0

    @classmethod
    def between(cls, name: str, given: str | None, wanted: str | None) -> "Conversion":
        """Return the conversion of a variable; none if a unit is not known.

        Raises
        ------
        CommonlawError
            If one unit is not a multiple of the other, but for where its zero is.

        Examples
        --------
        >>> Conversion.between("x", "mm", "m").scale, Conversion.between("T", "degC", "K").offset
        (0.001, 273.15)
        """
        import pint

        if given is None or wanted is None or given == wanted:
            return cls()
        one, other = parse_unit(given), parse_unit(wanted)
        try:
            zero, first, second = (float(registry().Quantity(i, one).to(other).magnitude) for i in (0.0, 1.0, 2.0))
        except (pint.PintError, ArithmeticError, ValueError):
            zero = first = second = np.nan
        bend, largest = abs(second - 2 * first + zero), max(abs(zero), abs(first), abs(second))
        if not (np.isfinite(largest) and first != zero and bend <= 1e-9 * largest):
            raise CommonlawError("units-incompatible", name=name, unit=given, law_unit=wanted)
        return cls(first - zero, zero)

    def __bool__(self) -> bool:
        """Whether it changes anything."""
        return self != (1.0, 0.0)

    def of(self, values: Floats) -> Floats:
        """Return values in the other unit."""
        return self.scale * values + self.offset


class _Conversions(NamedTuple):
    time: Conversion
    states: tuple[Conversion, ...]
    inputs: tuple[Conversion, ...]
    logarithmic: tuple[bool, ...]


def in_units(trials: Trials, units: Mapping[str, str]) -> Trials:
    """Return trials in the units that are given by name of time, states, inputs or properties; a note says so.

    What has no unit in the trials or among the given ones stays as it is.

    Raises
    ------
    CommonlawError
        If a unit cannot be converted into the other.
    """
    schema = trials.schema
    given = {name: unit for name, unit in schema.units.items() if name in units}
    found = {name: Conversion.between(name, unit, units[name]) for name, unit in given.items()}
    changed = {name: each for name, each in found.items() if each}
    if not changed:
        return trials
    shifted = [name for name in schema.logarithmic if name in changed and changed[name].offset]
    if shifted:
        raise CommonlawError("unit-of-logarithm", name=shifted[0], unit=units[shifted[0]])
    how = _Conversions(
        changed.get(schema.time, Conversion()),
        tuple(changed.get(name, Conversion()) for name in schema.states),
        tuple(changed.get(name, Conversion()) for name in schema.inputs),
        tuple(name in schema.logarithmic for name in schema.states),
    )
    said = ", ".join(f"{name} from {given[name]} to {units[name]}" for name in changed)
    return replace(
        trials,
        trials=tuple(_converted(each, how) for each in trials),
        schema=replace(schema, units={**schema.units, **{name: units[name] for name in changed}}),
        properties={
            owner: {name: _property(value, changed.get(name)) for name, value in own.items()}
            for owner, own in trials.properties.items()
        },
        notes=(*trials.notes, f"converted into the units of the law: {said}"),
    )


def _converted(trial: Trial, how: _Conversions) -> Trial:
    states, noise, inputs = trial.states.copy(), trial.noise.copy(), trial.inputs.copy()
    for j, (each, is_logarithm) in enumerate(zip(how.states, how.logarithmic, strict=True)):
        states[:, j] = states[:, j] + np.log(each.scale) if is_logarithm else each.of(states[:, j])
        noise[:, j] *= 1.0 if is_logarithm else abs(each.scale)
    for j, each in enumerate(how.inputs):
        inputs[:, j] = each.of(inputs[:, j])
    factors = [1.0 if log else each.scale for each, log in zip(how.states, how.logarithmic, strict=True)]
    repeats = None if trial.repeats is None else trial.repeats.scaled(np.array(factors))
    earlier, by_column = trial.earlier.copy(), (how.time, *how.inputs)
    for j, each in enumerate(by_column[: earlier.shape[1]]):
        earlier[:, j] = each.of(earlier[:, j])
    found = replace(trial, times=how.time.of(trial.times), states=states, noise=noise, inputs=inputs)
    return replace(found, repeats=repeats, earlier=earlier)


def _property(value: Property, how: Conversion | None) -> Property:
    return value if how is None or isinstance(value, str) else float(how.scale * value + how.offset)
