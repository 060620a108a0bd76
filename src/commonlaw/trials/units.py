"""Measurements in other units, and angles in radians."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.headers import known_unit, parse_unit, registry
from commonlaw.trials.trial import ObjectProperties, Schema, Trial, TrialData

_DEGREES = re.compile(r"\b(degrees?|deg|arcdeg)\b|°")


class Conversion(NamedTuple):
    """From one unit to another: ``scale * value + offset``."""

    scale: float = 1.0
    offset: float = 0.0

    @classmethod
    def between(cls, name: str, given: str | None, wanted: str | None) -> "Conversion":
        """Return the conversion of a variable, refused if there is none; nothing if a unit is not known.

        >>> Conversion.between("x", "mm", "m").scale, Conversion.between("T", "degC", "K").offset
        (0.001, 273.15)
        """
        if given is None or wanted is None or given == wanted:
            return cls()
        import pint

        given_unit, wanted_unit = parse_unit(given), parse_unit(wanted)
        try:
            with np.errstate(all="ignore"):  # The logarithm of zero, as of decibels, is infinite
                zero, first, second = (
                    float(registry().Quantity(i, given_unit).to(wanted_unit).magnitude) for i in (0.0, 1.0, 2.0)
                )
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


def converted(trial: Trial, schema: Schema, changed: Mapping[str, Conversion]) -> Trial:
    inputs, earlier, factors = trial.inputs.copy(), trial.earlier.copy(), np.ones(len(schema.states))
    functions = dict[int, Callable[[Floats], Floats]]()
    for j, name in enumerate(schema.states):
        how = changed.get(name, Conversion())
        functions[j] = Conversion(1.0, float(np.log(how.scale))).of if name in schema.logarithmic else how.of
        factors[j] = 1.0 if name in schema.logarithmic else how.scale
    for j, name in enumerate(schema.inputs):
        inputs[:, j] = changed.get(name, Conversion()).of(inputs[:, j])
    for column, name in zip(earlier.T, (schema.time, *schema.inputs), strict=False):
        column[:] = changed.get(name, Conversion()).of(column)
    clock = changed.get(schema.time, Conversion())
    amount = changed.get(schema.administered[0], Conversion()) if schema.administered else Conversion()
    doses = tuple(
        replace(
            dose,
            time=clock.scale * dose.time + clock.offset,
            amount=amount.scale * dose.amount,
            duration=clock.scale * dose.duration,
            interval=clock.scale * dose.interval,
        )
        for dose in trial.doses
    )
    times, corners, cycle = clock.of(trial.times), clock.of(trial.corners), clock.scale * trial.cycle
    changed_trial = replace(
        trial, times=times, inputs=inputs, earlier=earlier, doses=doses, cycle=cycle, corners=corners
    )
    return mapped(changed_trial, functions, factors)


def mapped(trial: Trial, functions: Mapping[int, Callable[[Floats], Floats]], factors: Floats) -> Trial:
    """Return a trial with functions of some states, by column; `factors` are their derivatives at the measurements."""
    states, below = trial.states.copy(), trial.below.copy()
    for values, (j, function) in product((states, below), functions.items()):
        values[:, j] = function(values[:, j])
    repeats = trial.repeats and trial.repeats.scaled(factors)
    return replace(trial, states=states, below=below, noise=trial.noise * np.abs(factors), repeats=repeats)


def with_converted_properties(properties: ObjectProperties, changed: Mapping[str, Conversion]) -> ObjectProperties:
    """Return properties of which some, by name, are in other units; texts stay."""
    result = {owner: dict(values) for owner, values in properties.items()}
    for values, name in product(result.values(), changed):
        if isinstance(value := values.get(name), float):
            values[name] = changed[name].scale * value + changed[name].offset
    return result


def in_radians(data: TrialData) -> TrialData:
    """Return data whose angles in degrees, and their rates, are in radians, as sines take them; a note says so."""
    schema = data.schema
    known = {name: known_unit(unit) for name, unit in schema.units.items() if name != schema.time}
    parts = {name: dict(registry().Quantity(1, unit).unit_items()) for name, unit in known.items() if unit}
    given = {name: schema.units[name] for name, powers in parts.items() if "degree" in powers}
    if not given:
        return data
    units = {name: _DEGREES.sub("rad", unit) for name, unit in given.items()}
    changed = {name: Conversion.between(name, given[name], unit) for name, unit in units.items()}
    changes = ", ".join(f"{name} from {given[name]} to {unit}" for name, unit in units.items())
    return data._replace(
        trials=tuple(converted(trial, schema, changed) for trial in data.trials),
        schema=replace(schema, units={**schema.units, **units}),
        properties=with_converted_properties(data.properties, changed),
        notes=(
            *data.notes,
            f"converted into radians, which sines and cosines take; a given noise is in radians, too: {changes}",
        ),
    )
