"""Trials in other variables: units, logarithms, rates, properties and doses as inputs, latent states, without rest."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.diagnostics import Outcome, note
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.text import shown
from commonlaw.trials.headers import find_name
from commonlaw.trials.recognition import difference_noise, is_amount, last_digit, note_on_pulses
from commonlaw.trials.trial import Schema, Start, Trial, property_names, pure_error
from commonlaw.trials.trials import Trials
from commonlaw.trials.units import Conversion, converted, mapped, with_converted_properties


def in_units(trials: Trials, units: Mapping[str, str]) -> Trials:
    """Return trials in the units that are given by name of time, states, inputs or properties; a note says so.

    What has no unit in the trials or among the given ones stays as it is.
    """
    schema = trials.schema
    given = {name: unit for name, unit in schema.units.items() if name in units}
    conversions = {name: Conversion.between(name, unit, units[name]) for name, unit in given.items()}
    changed = {name: conversion for name, conversion in conversions.items() if conversion}
    if not changed:
        return trials
    shifted = [name for name in schema.logarithmic if name in changed and changed[name].offset]
    if shifted:
        raise CommonlawError("unit-of-logarithm", name=shifted[0], unit=units[shifted[0]])
    changes = ", ".join(f"{name} from {given[name]} to {units[name]}" for name in changed)
    return replace(
        trials,
        trials=tuple(converted(trial, schema, changed) for trial in trials),
        schema=replace(schema, units={**schema.units, **{name: units[name] for name in changed}}),
        properties=with_converted_properties(trials.properties, changed),
        notes=(*trials.notes, f"converted into the units of the law: {changes}"),
    )


def with_logarithms(trials: Trials, states: Sequence[str]) -> Trials:
    """Return trials with logarithms of some states, which must be positive, and standard deviations as shares."""
    schema = trials.schema
    names = dict.fromkeys((*schema.logarithmic, *(find_name(name, schema.states, "state") for name in states)))
    new = [schema.states.index(name) for name in names if name not in schema.logarithmic]
    if not new:
        return trials
    changed = tuple(_with_logarithms(trial, new, schema.states) for trial in trials)
    return replace(trials, trials=changed, schema=replace(schema, logarithmic=tuple(names)))


def as_measured(followed: Trials, measured: Trials) -> Trials:
    """Return measured trials at the samples of trials that were made of them by logarithms, and with their notes."""
    by_label = {(trial.object, trial.name): trial for trial in measured}
    trials = []
    for wanted in followed:
        trial = by_label[wanted.object, wanted.name]
        there = np.isin(wanted.times, trial.times)
        rows = np.searchsorted(trial.times, wanted.times[there])
        trials.append(replace(wanted, **_among(trial, np.flatnonzero(there), len(wanted), rows)))
    return replace(measured.with_trials(trials), notes=followed.notes)


def _among(trial: Trial, places: Indices, count: int, rows: Indices | slice = slice(None)) -> dict[str, Any]:
    """Return what was measured in so many samples: in some places that of a trial's rows, NaN elsewhere."""
    states, noise, below = np.full((3, count, trial.states.shape[1]), np.nan)
    states[places], noise[places], below[places] = trial.states[rows], trial.noise[rows], trial.below[rows]
    repeats = trial.repeats and trial.repeats.taken(rows).placed(places, count)
    return {"states": states, "noise": noise, "below": below, "repeats": repeats}


def natural(states: Floats, schema: Schema) -> Floats:
    """Return states, shape (n, states), that stand by their logarithms in a schema as they are themselves."""
    if not schema.logarithmic:
        return states
    result, columns = states.copy(), [schema.states.index(name) for name in schema.logarithmic]
    with np.errstate(over="ignore"):
        result[:, columns] = np.exp(result[:, columns])
    return result


def _with_logarithms(trial: Trial, columns: Sequence[int], names: Sequence[str]) -> Trial:
    factors = np.ones(trial.states.shape)
    for j in columns:
        least = np.fmin(trial.states[:, j], trial.below[:, j])
        low = np.flatnonzero(least <= 0)
        if len(low):
            i = int(low[0])
            raise CommonlawError(
                "log-state-not-positive",
                where=trial.label,
                state=names[j],
                value=least[i],
                sample=i + 1,
                time=trial.times[i],
                count=len(low),
            )
        factors[:, j] = 1 / trial.states[:, j]
    return mapped(trial, dict.fromkeys(columns, np.log), factors)


def without_rates(trials: Trials, rates: Mapping[str, str]) -> Trials:
    """Return trials without the columns that are rates of states; their schema and a note say which these are."""
    kept = without_states(trials, [*rates.values()])
    if kept is trials:
        return trials
    notes = (*trials.notes, f"left out: {rates_in_words(rates)}")
    return replace(kept, schema=replace(kept.schema, rates=rates), notes=notes)


def without_states(trials: Trials, names: Collection[str]) -> Trials:
    """Return trials without the columns of these states, and without samples in which only they were measured."""
    schema = trials.schema
    kept = [j for j, name in enumerate(schema.states) if name not in names]
    if len(kept) == len(schema.states):
        return trials
    states, changed = tuple(schema.states[j] for j in kept), []
    gone = {*schema.states} - {*states}
    for trial in trials:
        known = np.isfinite(trial.states) | np.isfinite(trial.below)
        seen, measured = known[:, kept].any(axis=1), known.any(axis=1)
        if not seen.any():
            raise CommonlawError("state-not-in-trial", where=trial.label, names=states)
        part = trial.rows(np.asarray(seen | ~measured))
        repeats = part.repeats and part.repeats.taken((slice(None), kept))
        parts = {name: getattr(part, name)[:, kept] for name in ("states", "noise", "below")}
        changed.append(replace(part, **parts, repeats=repeats))
    return replace(
        trials,
        trials=tuple(changed),
        schema=replace(
            schema,
            states=states,
            units={name: unit for name, unit in schema.units.items() if name not in gone},
            noise_columns={name: column for name, column in schema.noise_columns.items() if name not in gone},
        ),
    )


def rates_in_words(rates: Mapping[str, str]) -> str:
    """Return which column is the rate of which state.

    >>> rates_in_words({"theta": "omega"})
    'omega is the rate of theta'
    """
    return ", ".join(f"{rate} is the rate of {state}" for state, rate in rates.items())


def with_property_inputs(trials: Trials, names: Sequence[str]) -> Trials:
    """Return trials with these properties of their objects, which must be numbers, as further inputs."""
    if not names:
        return trials
    changed = []
    for trial in trials:
        values = [number_of(name, trial.object, trials) for name in names]
        inputs, earlier = (
            np.column_stack([rows, np.tile(values, (len(rows), 1))]) for rows in (trial.inputs, trial.earlier)
        )
        changed.append(replace(trial, inputs=inputs, earlier=earlier if len(earlier) else trial.earlier))
    owner = "object" if trials.schema.object in names else trials.schema.object
    schema = replace(trials.schema, object=owner, inputs=(*trials.schema.inputs, *names))
    properties = {
        name: {key: value for key, value in attribute.items() if key not in names}
        for name, attribute in trials.properties.items()
    }
    return replace(trials, trials=tuple(changed), schema=schema, properties=properties)


def number_of(name: str, owner: str, trials: Trials) -> float:
    """Return the value of a property of an object; refused if it has none, or one that is no number."""
    value = trials.properties.get(owner, {}).get(name)
    if value is None:
        known = property_names(trials.properties)
        check_choice("property", name, known)
        raise CommonlawError("property-missing", object=owner, property=name)
    if not isinstance(value, float):
        raise CommonlawError("property-number", property=name, object=owner, value=value)
    return value


def with_starts(trials: Trials, starts: Mapping[str, Start], at: float | None = None) -> Trials:
    """Return trials with latent states, whose initial values stand in the first sample of each trial.

    By state: a number, the name of a property of the objects, numbers by object, or None for unknown initial values.
    States that the trials have are passed over; the others have the unit of the property, unless they have one. `at` is
    the time of the initial values: trials that begin later get a sample there without measurements, and those at which
    inputs are known between.
    """
    new = {name: start for name, start in starts.items() if name not in trials.schema.states}
    if not new:
        return trials
    values = {owner: np.full(len(new), np.nan) for owner in trials.objects}
    for owner, (j, (state, start)) in product(trials.objects, enumerate(new.items())):
        if isinstance(start, str):
            values[owner][j] = number_of(start, owner, trials)
        elif start is not None:
            value = values[owner][j] = start.get(owner, np.nan) if isinstance(start, Mapping) else start
            if not np.isfinite(value):
                raise CommonlawError("initial-value-not-finite", state=state, value=value, object=owner)
    schema = trials.schema
    units = {name: schema.units[str(start)] for name, start in new.items() if str(start) in schema.units}
    schema = replace(
        schema,
        states=(*schema.states, *new),
        initial_values={**schema.initial_values, **new},
        initial_time=at,
        units={**units, **schema.units},
    )
    between = schema.input_interpolation
    changed = tuple(_with_first(trial, values[trial.object], at, between) for trial in trials)
    return replace(trials, trials=changed, schema=schema)


def _with_first(trial: Trial, values: Floats, at: float | None, between: str) -> Trial:
    """Return a trial with further states, which have these values in its first sample, and none in others."""
    times, inputs = trial.times, trial.inputs
    if at is not None and not starts_by(trial, at):
        times, inputs = known_inputs(trial)
        later = times > at
        begun = max(len(times) - int(later.sum()) - 1, 0)
        first = inputs[begun] if between == "held" else [np.interp(at, times, column) for column in inputs.T]
        times, inputs = np.append(at, times[later]), np.vstack([first, inputs[later]])
    count = len(times)
    samples = _among(trial, np.arange(count - len(trial), count), count)
    starts, unknown = np.full((2, count, len(values)), np.nan)
    starts[0] = values
    return replace(
        trial,
        repeats=samples["repeats"] and samples["repeats"].wider(len(values)),
        times=times,
        states=np.column_stack([samples["states"], starts]),
        inputs=inputs,
        noise=np.column_stack([samples["noise"], unknown]),
        below=np.column_stack([samples["below"], unknown]),
    )


def starts_by(trial: Trial, at: float) -> bool:
    """Return whether the first sample of a trial is at the time of initial values; refused if it is before."""
    first = float(trial.times[0])
    if first < at:
        raise CommonlawError("initial-time-late", trial=trial.label, time=first, initial_time=at)
    return first == at


def known_inputs(trial: Trial) -> tuple[Floats, Floats]:
    """Return times, shape (n,), and inputs, shape (n, inputs), of a trial, from before its first sample on."""
    if not len(trial.earlier):
        return trial.times, trial.inputs
    return np.append(trial.earlier[:, 0], trial.times), np.concatenate([trial.earlier[:, 1:], trial.inputs])


MOMENT = 1e-4
"""How long a dose takes, relative to the shortest step of a trial: less than it would show."""
RECORDED_MOMENT = 1e-6
"""The same of doses that a table records, whose solutions begin anew at each."""


def with_doses(trials: Trials, doses: Sequence[str]) -> Trials:
    """Return trials in which some inputs, amounts at samples, are what is added in the moment after these.

    There an input rises and falls on straight lines over two further samples, at which nothing was measured; these are
    `Trial.corners`, as are doses in rows without a measurement. The integral is the amount. A trial whose first dose is
    before its first measurement begins there. All inputs must be doses, and every object must have one: those without,
    of which nothing but zeros was measured, are left out.
    """
    new = [name for name in doses if name not in trials.schema.doses]
    if not new:
        return trials
    for name in new:
        check_choice("input", name, trials.schema.inputs)
    others = [name for name in trials.schema.inputs if name not in doses]
    if others:
        raise CommonlawError("doses-with-inputs", inputs=others)
    begun = list[Trial]()
    for trial in trials:
        earlier = trial.earlier[np.logical_or.accumulate(trial.earlier[:, 1:].any(axis=1))]
        if len(earlier):  # It begins at its first dose
            times, count = earlier[:, 0], len(earlier) + len(trial)
            samples = _among(trial, np.arange(len(times), count), count)
            times, inputs = np.append(times, trial.times), np.concatenate([earlier[:, 1:], trial.inputs])
            arrays = {"times": times, "inputs": inputs, "earlier": np.empty((0, 0)), **samples}
            trial = replace(trial, **arrays, begins_with_dose=True)
        elif trial.inputs[0].any():
            trial = replace(trial, earlier=np.empty((0, 0)), begins_with_dose=True)
        begun.append(trial)
    trials = _of_dosed(trials.with_trials(begun), {trial.object for trial in begun if trial.inputs[:-1].any()}, doses)
    schema = replace(trials.schema, doses=tuple(doses), input_interpolation="linear")
    changed = []
    for trial in trials:
        given = np.flatnonzero(trial.inputs[:-1].any(axis=1))
        moment = MOMENT * float(np.diff(trial.times).min(initial=np.inf))
        at, ends = trial.times[given], trial.times[given] + 2 * moment
        times = np.concatenate([trial.times, at + moment, ends])
        corners = _corners(trial, np.append(at, at + moment), ends, at)
        order, none = np.argsort(times, kind="stable"), np.zeros_like(trial.inputs[given])
        inputs = np.concatenate([np.zeros_like(trial.inputs), trial.inputs[given] / moment, none])
        samples = _among(trial, np.flatnonzero(order < len(trial)), len(times))
        changed.append(replace(trial, times=times[order], inputs=inputs[order], corners=corners, **samples))
    return replace(without_notes_on(doses, trials), trials=tuple(changed), schema=schema)


def _of_dosed(trials: Trials, dosed: set[str], doses: Sequence[str]) -> Trials:
    """Return the trials of objects with a dose; refused if another has a measurement that is not zero, or none has one.

    Of the others, such as subjects with a placebo, all states are zero whatever the parameters are.
    """
    apart = tuple(name for name in trials.objects if name not in dosed)
    for name in apart:
        if not dosed or any(np.nan_to_num(trial.states).any() for trial in trials.of_object(name)):
            raise CommonlawError("doses-after-end", object=name, doses=doses)
    if not apart:
        return trials
    kept = without_objects(trials, apart)
    return kept.with_trials(kept.trials, *map(str, outcome_of_undosed(apart)))


def _corners(trial: Trial, added: Floats, ends: Floats, at: Floats) -> Floats:
    """Return `Trial.corners` by times of samples, of a trial without them, and by the ends of doses at some times."""
    measured = trial.times[(np.isfinite(trial.states) | np.isfinite(trial.below)).any(axis=1)]
    alone = np.setdiff1d(added, measured)
    return np.concatenate([np.column_stack([alone, np.full(len(alone), np.nan)]), np.column_stack([ends, at])])


def with_zeros_before_doses(trials: Trials) -> Trials:
    """Return trials whose states are zero, as if measured, in first samples with a dose where they were not measured.

    So take them laws whose initial states are estimated from measurements.
    """
    if not any(trial.begins_with_dose and np.isnan(trial.states[0]).any() for trial in trials):
        return trials
    changed = []
    for trial in trials:
        states, noise = trial.states.copy(), trial.noise.copy()
        zero = np.flatnonzero(np.isnan(states[0]) & np.isnan(trial.below[0]) & trial.begins_with_dose)
        states[0, zero], noise[0, zero] = (
            0.0,
            trial.noise[np.isfinite(states).argmax(axis=0), np.arange(len(states.T))][zero],
        )
        changed.append(replace(trial, states=states, noise=noise))
    return trials.with_trials(changed)


def with_recorded_doses(trials: Trials, names: Sequence[str]) -> Trials:
    """Return trials in which the doses that a table records are inputs of these names: amounts per time.

    ``AMT`` is all doses, ``AMT1`` those into compartment 1; an amount at once is a narrow triangle as in `with_doses`,
    an infusion the constant rate ``amount/duration`` with narrow ramps. ``RATE`` is the same where all doses are
    infusions. Between samples inputs are straight. Trials begin with the first dose or sample, and before it all
    states are zero which no sample measures; where doses led to a steady state, one of their intervals is put before
    it, see `Trial.cycle`. Every object must have a dose, as in `with_doses`.
    """
    schema = trials.schema
    if schema.inputs:
        raise CommonlawError("doses-with-inputs", inputs=schema.inputs)
    parts = [_dose_name(name, schema.administered) for name in names]
    doses = [dose for trial in trials for dose in trial.doses if dose.amount]
    into = sorted({dose.compartment for dose in doses})
    numbers = [number for _, number in parts]
    if lacking := [number for number in into if number not in numbers] if None not in numbers else into[1:]:
        raise CommonlawError("doses-into-other-compartments", compartments=lacking, names=names)
    at_once = [dose for dose in doses if not dose.duration]
    if at_once and any(stem != schema.administered[0] for stem, _ in parts):
        raise CommonlawError("doses-without-rate", time=at_once[0].time, rate=names[0], amount=schema.administered[0])
    dosed = {t.object for t in trials if any(dose.time < t.times[-1] and dose.amount for dose in t.doses)}
    trials = _of_dosed(trials, dosed, names)
    units = {name: schema.units[schema.administered[0]] for name in names if schema.administered[0] in schema.units}
    schema = replace(
        schema,
        inputs=tuple(names),
        doses=tuple(names),
        input_interpolation="linear",
        units={**schema.units, **units},
        administered=(),
    )
    return replace(trials, trials=tuple(_with_rates_of_doses(trial, numbers) for trial in trials), schema=schema)


def _dose_name(name: str, administered: Sequence[str]) -> tuple[str, int | None]:
    """Return which column of doses a name is of, and the number of its compartment, None of all."""
    stem = name.rstrip("0123456789")
    if name in administered:
        return name, None
    check_choice("dose", stem if stem != name else name, administered)
    return stem, int(name.removeprefix(stem))


def _with_rates_of_doses(trial: Trial, compartments: Sequence[int | None]) -> Trial:
    """Return a trial whose inputs are the rates of its doses into compartments, None for all, shape (n, inputs)."""
    doses = [*trial.doses]
    cycle = doses[0].interval if doses else 0.0
    times = np.unique(np.concatenate([trial.times, *([dose.time, dose.time + dose.duration] for dose in doses)]))
    steps = np.diff(times)
    moment = RECORDED_MOMENT * float(steps[steps > 1e-9 * (times[-1] - times[0])].min(initial=cycle or np.inf))
    begins = min([trial.times[0], *(dose.time - 2 * moment * dose.is_before for dose in doses)]) - cycle
    if cycle:  # Doses before the first that act within the interval before it
        first = doses[0]
        before = range(1, 1 + max(1, int(np.ceil(first.duration / cycle))))
        doses += [replace(first, time=first.time - k * cycle) for k in before]
    curves, ends = list[tuple[int, Floats, Floats]](), list[tuple[float, float]]()
    for dose in doses:
        start = dose.time - 2 * moment * dose.is_before
        knots, heights = start + moment * np.arange(3.0), np.array([0.0, 1.0, 0.0])
        if dose.duration:
            knots = start + np.array([0.0, moment, dose.duration, dose.duration + moment])
            heights = np.array([0.0, 1.0, 1.0, 0.0])
        elif not dose.is_before:
            ends.append((float(knots[-1]), start))
        area = np.sum(np.diff(knots) * (heights[1:] + heights[:-1])) / 2
        curves.append((dose.compartment, knots, heights * dose.amount / area))
    grid = np.unique(np.concatenate([[begins], trial.times, *(knots for _, knots, _ in curves)]))
    grid = grid[grid >= begins]
    inputs = np.zeros((len(grid), len(compartments)))
    for compartment, knots, heights in curves:
        chosen = [number in (None, compartment) for number in compartments]
        inputs[:, chosen] += np.interp(grid, knots, heights, left=0.0, right=0.0)[:, np.newaxis]
    samples = _among(trial, np.searchsorted(grid, trial.times), len(grid))
    corners = _corners(trial, np.setdiff1d(grid, trial.times), *np.array(ends).reshape(-1, 2).T)
    return replace(
        trial, times=grid, inputs=inputs, **samples, doses=(), cycle=cycle, begins_with_dose=True, corners=corners
    )


def acts_later(trial: Trial) -> bool:
    """Say whether a dose of a trial acts after its first sample."""
    return any(
        dose.amount
        and (dose.time + dose.duration > trial.times[0] or (dose.time == trial.times[0] and not dose.is_before))
        for dose in trial.doses
    )


def refuse_standing_time(trials: Trials) -> None:
    """Refuse repeated measurements that all have the same time."""
    times = {float(time) for trial in trials for time in trial.times}
    if len(times) == 1 and any(trial.repeats is not None for trial in trials):
        raise CommonlawError("time-stands-still", time=times.pop(), column=trials.schema.time)


def refuse_amounts(trials: Trials) -> None:
    """Refuse inputs that are called amounts and hold single ones after first samples, where no input is on lines.

    So are doses that a table records.
    """
    for trial in trials:
        if trials.schema.administered and acts_later(trial):
            raise CommonlawError("doses-recorded", name=trials.schema.administered[0], where=trial.label)
    for name in amounts_at_samples(trials):
        j = trials.schema.inputs.index(name)
        for trial in trials:
            if trial.inputs[1:, j].any():
                raise CommonlawError("doses-in-search", name=name, where=trial.label)


def amounts_at_samples(trials: Trials) -> list[str]:
    """Return the inputs that are called amounts and hold single ones, as read from a table."""
    return [name for name in trials.schema.inputs if is_amount(name) and note_on_pulses(name) in trials.notes]


def without_notes_on(doses: Sequence[str], trials: Trials) -> Trials:
    """Return the trials without the notes that inputs may be doses, of those that are given as such."""
    answered = {*map(note_on_pulses, doses)}
    return replace(trials, notes=tuple(note for note in trials.notes if note not in answered))


MAX_RANGE_AT_REST = 3.0
"""Of a state that is constant, relative to its resolution or to noise known from elsewhere."""
MAX_STD_AT_REST = 2.0
"""Of an object that is constant, relative to the noise of all."""
_MIN_STATES_WITH_REST = 3
"""The fewest states of which one may be left out."""
_MIN_DIFFERENCES = 10
"""Differences of neighbouring samples by which a state at rest is known."""


def objects_at_rest(trials: Trials) -> tuple[str, ...]:
    """Return the objects whose states stay constant within their noise while those of others change, with no input.

    Differences d of neighbouring samples and deviations e from the mean of a trial are those of white noise alone (von
    Neumann 1941): sum d^2 / sum e^2 = 2 with a standard deviation of 2 / sqrt(n), of n differences; the variance is
    less than a hundredth of the mean of all objects; and the standard deviation is at most `MAX_STD_AT_REST` times the
    median noise of the objects, or the resolution.
    """
    names, states = trials.objects, len(trials.schema.states)
    count, differences, deviations, noise = np.zeros((4, len(names), states))
    driven = np.zeros(len(names), dtype=np.bool_)
    for o, name in enumerate(names):
        trials_of_object = trials.of_object(name)
        inputs = np.concatenate([trial.inputs for trial in trials_of_object])
        driven[o] = (inputs != inputs[0]).any()
        sums = [_sums_of_squares(trial) for trial in trials_of_object]
        count[o], differences[o], deviations[o] = np.sum(sums, axis=0)
        noise[o] = [
            difference_noise([trial.states[np.isfinite(trial.states[:, j]), j] for trial in trials_of_object]).min()
            for j in range(states)
        ]
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = deviations / count
    counted = np.where(count >= _MIN_DIFFERENCES, variance, np.nan)
    if np.isnan(counted).all(axis=0).any():
        return ()
    resolution = [last_digit(np.concatenate([trial.states[:, j] for trial in trials])) for j in range(states)]
    level = np.maximum(MAX_STD_AT_REST * np.median(noise, axis=0), resolution)
    is_small = (variance < 0.01 * np.nanmean(counted, axis=0)) & (variance <= level**2)
    at_rest = (_is_white(count, differences, deviations) & is_small).all(axis=1) & ~driven
    return tuple(name for name, rests in zip(names, at_rest, strict=True) if rests)


def states_at_rest(trials: Trials) -> tuple[str, ...]:
    """Return the states, of three or more, that stay constant within their noise in all trials while others change.

    Their range is at most `MAX_RANGE_AT_REST` times their resolution or known noise: differences of neighbouring
    samples cannot show it, as those of an oscillation of few samples a period are as large as those of noise. These
    and deviations from the mean of all trials are those of white noise alone, as in `objects_at_rest`, and the linear
    regression on all other states and inputs is not significant (F test at 1 %).
    """
    from scipy.special import fdtrc

    values = np.concatenate([trial.states for trial in trials])
    if values.shape[1] < _MIN_STATES_WITH_REST or np.isnan(values).all(axis=0).any():
        return ()
    ranges, levels = np.nanmax(values, axis=0) - np.nanmin(values, axis=0), _known_levels(trials, values)
    sums = np.sum([_sums_of_squares(trial, np.nanmean(values, axis=0)) for trial in trials], axis=0)
    at_rest, inputs = list[str](), np.concatenate([trial.inputs for trial in trials])
    for j in np.flatnonzero(_is_white(*sums) & (ranges <= MAX_RANGE_AT_REST * levels * (1 + 1e-9))):
        rows = np.column_stack([np.ones(len(values)), np.delete(values, j, axis=1), inputs, values[:, j]])
        rows = rows[np.isfinite(rows).all(axis=1)]
        rows = rows / np.maximum(np.abs(rows).max(axis=0, initial=0.0), np.finfo(float).tiny)
        regressors, target = rows[:, :-1], rows[:, -1] - rows[:, -1].mean()
        coefficients, _, rank, _ = np.linalg.lstsq(regressors, target)
        residuals = target - regressors @ coefficients
        explained, unexplained = float(target @ target - residuals @ residuals), float(residuals @ residuals)
        free = len(rows) - int(rank)
        if free > 0 and (
            rank < 2 or fdtrc(rank - 1, free, explained / (rank - 1) * free / max(unexplained, 1e-300)) > 0.01
        ):
            at_rest.append(trials.schema.states[j])
    return tuple(at_rest) if len(at_rest) < values.shape[1] else ()


def _known_levels(trials: Trials, values: Floats) -> Floats:
    """Return the largest of resolution, given noise and that of repeated measurements of each state, shape (d,)."""
    squares, freedom = pure_error([trial.repeats for trial in trials], values.shape[1])
    std = np.concatenate([np.where(np.isfinite(trial.states), trial.noise, np.nan) for trial in trials])
    known = np.array([np.nanmedian(column) if np.isfinite(column).any() else 0.0 for column in std.T])
    resolution = np.array([last_digit(column) for column in values.T])
    return np.asarray(np.max([resolution, known, np.sqrt(squares / np.maximum(freedom, 1))], axis=0))


def _sums_of_squares(trial: Trial, mean: Floats | None = None) -> Floats:
    """Return counts and sums of squares of differences, and of deviations from the mean, of each state, shape (3, d).

    The mean is that of the trial, unless another is given.
    """
    result = np.zeros((3, trial.states.shape[1]))
    for j, column in enumerate(trial.states.T):
        seen = column[np.isfinite(column)]
        if len(seen) > 1:
            result[:, j] = (
                len(seen) - 1,
                np.sum(np.diff(seen) ** 2),
                np.sum((seen - (seen.mean() if mean is None else mean[j])) ** 2),
            )
    return result


def _is_white(count: Floats, differences: Floats, deviations: Floats) -> Bools:
    """Return where the ratio of von Neumann is that of white noise."""
    with np.errstate(divide="ignore", invalid="ignore"):
        is_noise = differences >= (2 - 4 / np.sqrt(count)) * deviations
    return np.asarray((count >= _MIN_DIFFERENCES) & is_noise)


def without_objects(trials: Trials, names: tuple[str, ...]) -> Trials:
    """Return the trials of other objects than those of these names."""
    return trials.with_trials([trial for trial in trials if trial.object not in names]) if names else trials


def outcome_of_rest(names: tuple[str, ...]) -> tuple[Outcome, ...]:
    """Return that objects at rest were left out, by name; nothing if there are none."""
    return (note("objects-at-rest", objects=shown(names, "object")),) if names else ()


def outcome_of_undosed(names: tuple[str, ...]) -> tuple[Outcome, ...]:
    """Return that objects without a dose were left out, by name; nothing if there are none."""
    return (note("objects-without-dose", objects=shown(names, "object")),) if names else ()


def outcome_of_constants(names: tuple[str, ...]) -> tuple[Outcome, ...]:
    """Return that states at rest were left out, by name; nothing if there are none."""
    return (note("states-at-rest", states=names),) if names else ()


def with_noise(trials: Trials, noise: Mapping[str, float | Mapping[str, float]]) -> Trials:
    """Return trials whose measurements of quantities have known standard deviations, of all objects or by object."""
    if not noise:
        return trials
    changed = []
    for trial in trials:
        std = trial.noise.copy()
        for name, given in noise.items():
            k = trials.schema.states.index(name)
            level = given.get(trial.object, np.nan) if isinstance(given, Mapping) else given
            std[:, k] = level * (1.0 if trial.repeats is None else trial.repeats.counts[:, k] ** -0.5)
        changed.append(replace(trial, noise=std))
    names = {name: f"standard deviation of {name}" for name in noise}
    schema = replace(trials.schema, noise_columns={**names, **trials.schema.noise_columns})
    return replace(trials, trials=tuple(changed), schema=schema)


MAX_RELATIVE_NOISE = float(np.finfo(np.float64).eps ** -0.5)
"""Noise relative to the largest value of a quantity: squares of residuals relative to more are below rounding."""


def refuse_overwhelming_noise(trials: Trials, noise: Mapping[str, float]) -> None:
    """Refuse noise by quantity, relative where it is log-scaled, under which the likelihood is constant to rounding."""
    for name, level in noise.items():
        k = trials.schema.states.index(name)
        sizes = [np.fmax(np.abs(trial.states[:, k]), np.abs(trial.below[:, k])) for trial in trials]
        largest = max(float(np.nanmax(size, initial=0.0)) for size in sizes)
        limit = MAX_RELATIVE_NOISE * (max(largest, 1.0) if name in trials.schema.logarithmic else largest)
        if largest > 0 and level > limit:
            raise CommonlawError("noise-overwhelming", name=name, level=level, largest=largest, limit=limit)
