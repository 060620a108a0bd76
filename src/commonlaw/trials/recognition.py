"""What columns are by their names, units and values: times, labels, standard deviations, inputs, or an object each."""

import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import product
from math import comb
from typing import Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Codes, Table
from commonlaw.trials.dates import holds_dates, is_clock, is_time
from commonlaw.trials.headers import known_unit, split_header


def vocabulary(text: str) -> frozenset[str]:
    """Return the words of a text."""
    return frozenset(text.split())


TIME = vocabulary(
    "time times timestamp datetime date elapsed clock epoch when "
    "second seconds sec secs minute minutes mins hour hours hr hrs day days week weeks month months year years age "
    "zeit messzeit laufzeit uhrzeit zeitpunkt datum sekunde sekunden minuten stunde stunden tag tage woche wochen jahr "
    "jahre temps heure heures jour jours tiempo tempo fecha hora horas"
)
_SHORT_TIME = vocabulary("t s h d min k n step steps iteration generation tick frame cycle")
"""What a time is called, too, and other quantities as well: taken where no other column is a time, if it increases."""
SEPARATE = vocabulary(
    "subject patient participant person individual animal mouse rat ball well vial tube flask colony strain sample "
    "specimen plant tree chick bird fish dog child infant replicate rep repeat repetition trial run cup mug bottle "
    "beaker motor engine pump battery"
)
"""What does not act on others of its kind."""
OBJECT = SEPARATE | vocabulary("object id body particle cell device board rig unit site station tank name")
TRIAL = vocabulary(
    "trial run replicate rep repeat repetition drop experiment exp test session series batch attempt throw shot pass "
    "round episode cond condition versuch lauf messung wiederholung"
)
MEASURED = vocabulary(
    "pos position vel velocity speed angle temp temperature pressure level height conc concentration current voltage "
    "mass"
)
QUANTITIES = MEASURED | vocabulary(
    "species node mode channel state var tank cell body particle site station patch compartment"
)
"""What one object may have several of."""
MEASURAND = vocabulary("quantity measurand analyte observable dvid")
"""What names quantities that stand below each other."""
SENSOR = vocabulary("variable parameter signal channel")
"""What names these, or objects."""
_MEASURAND = MEASURAND | SENSOR
_SURROUNDINGS = vocabulary("ambient amb tamb surroundings environment env tenv outdoor outdoors outside weather")
INPUT = _SURROUNDINGS | vocabulary(
    "input setpoint command control stimulus forcing dose amt solar irradiance insolation radiation sunlight sunshine "
    "rain rainfall precipitation throttle pwm duty"
)
_AMOUNT = vocabulary("dose doses dosage amt")
"""What names amounts that are given: an empty cell is none."""
_RATE = vocabulary("rate")
"""What names amounts per time, which are not added at once."""
_COVARIATE = vocabulary("sex gender race ethnicity smoker smoking genotype phenotype")
"""Codes of individuals, which neither name objects or trials nor are measured."""
_DEVIATION = vocabulary("std sd stdev stddev sigma err error stderr se sem unc uncertainty")
_VELOCITIES = vocabulary("v w")
"""Names next to which u is another velocity, and not an input."""
_MEAN = vocabulary("mean avg average")
_ROW_NUMBER = vocabulary("no nr number id index row record line obs observation point")
_COUNTER = vocabulary("frame frames sample samples scan scans tick ticks")
"""What is counted in each trial, if whole numbers go up with the time."""
_MIN_COUNTS = 4
"""Steps of one by which a column is a counter."""

_OF_TIME = {"[time]": 1.0}
_CLOCK = re.compile(r"\W*\d[\d\W_]*(T\d[\d\W]*Z?)?([ap]m)?\W*", re.IGNORECASE)
"""What may be a date or a time of day."""


def words(name: str) -> list[str]:
    """Return the words and numbers in a name, in small letters.

    >>> words("elapsedTime_s"), words("OD600 std")
    (['elapsed', 'time', 's'], ['od', '600', 'std'])
    """
    return [word.casefold() for word in re.findall(r"[^\W\d_]+|\d+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name))]


def is_called(name: str, kind: frozenset[str]) -> bool:
    """Say whether a word of a name is among those of a kind."""
    return not kind.isdisjoint(words(name))


def is_time_header(header: str) -> bool:
    """Say whether a header is that of times: it has a unit of time; or none, and a word for a time, or is ``t``.

    >>> is_time_header("t"), is_time_header("Elapsed [s]"), is_time_header("T [°C]")
    (True, True, False)
    """
    name, unit = split_header(header)
    if unit:
        known = known_unit(unit)
        return known is not None and dict(known.dimensionality) == _OF_TIME
    return name.casefold() == "t" or is_called(name, TIME)


def names_quantities(header: str) -> bool:
    """Say whether a column is called like one of the names of quantities, ``analyte`` or ``observableId``."""
    return is_called(header, MEASURAND) and {*words(header)} <= MEASURAND | {"id", "name"}


def readable(table: Table, name: str) -> Floats:
    """Return a column as numbers, shape (n,), NaN where it is empty; all NaN if a cell is none, which others refuse."""
    try:
        return table.numbers(name, missing=True)
    except CommonlawError:
        return np.full(len(table), np.nan)


def time_column(table: Table) -> str | None:
    """Return the column that holds the time, None if there is no such; refuse several that are as likely.

    ``t`` and ``time`` are the time by convention. Else it is the column with a word or a unit of time in its header; of
    several the one that increases from row to row. Then come short names, ``T`` and counts of steps, if they increase;
    and, whatever it is called, the column that holds dates, times of day, or numbers that increase by equal steps.
    """
    names = list(table.columns)
    folded = {name.casefold(): name for name in reversed(names)}
    for name in ("t", "time"):
        if name in names:
            return name
    if "time" in folded:
        return folded["time"]
    able = [
        name
        for name in names
        if _dimensions(table, name) in ({}, _OF_TIME)
        and (table.is_numeric(name) or any(is_time(cell) for cell in table.columns[name] if cell == cell and cell))
    ]
    by_word = [name for name in able if is_called(name, TIME) or _dimensions(table, name) == _OF_TIME]
    short = [name for name in able if name.casefold() in _SHORT_TIME or words(name)[:1] == ["t"]]
    rising = {name for name in able if _rises(table, name)}
    texts = [name for name in names if not table.is_numeric(name)]
    for likely in (
        [name for name in by_word if name in rising],
        [name for name in by_word if is_called(name, TIME)],
        [name for name in short if name in rising],
        [name for name in texts if holds_dates(table.columns[name])],
        [name for name in texts if is_clock(table.columns[name])],
        [name for name in names if _is_even(table, name, names)],
    ):
        if len(likely) > 1:
            raise CommonlawError("time-ambiguous", where=table.source, columns=likely)
        if likely:
            return likely[0]
    return None


def _dimensions(table: Table, name: str) -> dict[str, Any]:
    """Return the powers of dimensions of a column, none if it has no unit."""
    unit = known_unit(table.units[name]) if name in table.units else None
    return {} if unit is None else {str(dimension): power for dimension, power in unit.dimensionality.items()}


def unit_in_name(time: str) -> dict[str, str]:
    """Return the unit of a column of times that is called like one or ends in one, by its name; nothing otherwise.

    >>> unit_in_name("Minutes"), unit_in_name("timestamp_ms"), unit_in_name("Test_Time_s"), unit_in_name("t")
    ({'Minutes': 'min'}, {'timestamp_ms': 'ms'}, {'Test_Time_s': 's'}, {})
    """
    *what, last = words(time) or [""]
    is_time = not {*what[-1:]}.isdisjoint({"t", "time", "timestamp", "elapsed", "clock", "epoch", "age", "zeit"})
    unit = known_unit(last) if is_time or (not what and last in TIME | {"min"}) else None
    return {time: f"{unit:~}"} if unit is not None and dict(unit.dimensionality) == _OF_TIME else {}


_SUFFIXES = {
    "pos position displacement": "nm um mm m km",
    "x y z": "mm km",
    "height altitude alt elevation depth level length width distance radius diameter": "nm um mm cm m km",
    "speed velocity vel": "mm_s cm_s m_s km_h rpm",
    "mass weight": "mg g kg",
    "dose": "ug mg g",
    "volume vol": "uL mL L mm3 cm3",
    "conc concentration": "ng_mL ug_mL mg_mL ug_L mg_L g_L mg_dL nM uM mM",
    "temp temperature": "C degC F degF K",
    "voltage": "uV mV V kV",
    "current": "nA uA mA A",
    "pressure": "Pa hPa kPa MPa mbar bar",
    "force": "mN N kN",
    "power": "mW W kW",
    "angle theta phi psi pitch roll yaw": "rad deg",
    "omega": "rad_s deg_s rpm",
}
"""Units at the end of names, by quantities. The cm of a position may be its centre of mass, and x_m any x of an m."""


def units_in_names(names: Sequence[str]) -> dict[str, str]:
    """Return the units that names of quantities end in, by the name; where others begin alike, the end is an index.

    >>> units_in_names(["water temp_C", "x_mm", "speed_m_s", "V_m", "y_cm", "current_A", "current_B", "mass_g_sd"])
    {'water temp_C': 'degC', 'x_mm': 'mm', 'speed_m_s': 'm/s'}
    """
    result = dict[str, str]()
    exact, folded = sorted(names), sorted(column.casefold() for column in names)

    def count(ordered: Sequence[str], begin: str) -> int:
        """Return how many of some names in order begin so."""
        return bisect_left(ordered, f"{begin}\U0010ffff") - bisect_left(ordered, begin)

    for name, (quantities, suffixes) in product(names, _SUFFIXES.items()):
        for suffix in suffixes.split():
            stem = name.removesuffix(f"_{suffix}")
            if stem == name or {*words(stem)[-1:]}.isdisjoint(quantities.split()):
                continue
            if count(folded, f"{stem}_".casefold()) == count(exact, name):
                result[name] = {"C": "degC", "F": "degF"}.get(suffix, suffix.replace("_", "/"))
    return result


def _rises(table: Table, name: str) -> bool:
    """Say whether values go up at least twice as often as down, as times do even in trials of three samples."""
    if not table.is_numeric(name):
        return True  # dates
    steps = np.diff(readable(table, name))
    return bool((steps > 0).any() and np.mean(steps > 0) >= 2 * np.mean(steps < 0))


def _is_even(table: Table, name: str, names: Sequence[str]) -> bool:
    """Say whether a column goes up by equal steps, to its last digit, as sampled times do and measurements do not."""
    if not table.is_numeric(name) or len(table) < 5 or is_called(name, _ROW_NUMBER):
        return False
    values = readable(table, name)
    begins = np.flatnonzero(np.append(True, np.diff(values) <= 0))
    lengths = np.diff(np.append(begins, len(values)))
    if not np.isfinite(values).all() or 2 * len(begins) > len(values):
        return False
    longest = begins[np.argmax(lengths)], begins[np.argmax(lengths)] + max(lengths) - 1
    step, digit = np.ptp(values[[*longest]]) / (max(lengths) - 1), last_digit(values)
    lines = np.repeat(values[begins], lengths) + step * (np.arange(len(values)) - np.repeat(begins, lengths))
    rounding = digit if step > 10 * digit else 0.0
    if (np.abs(values - lines) > rounding + 1e-5 * step).any():
        return False
    others = [column for column in names if column != name and table.is_numeric(column)]
    is_count = bool(step == 1 and values[0] in (0, 1))
    return not (is_count and (table.is_index(name) or any((np.diff(readable(table, c)) > 0).all() for c in others)))


def object_column(table: Table, times: Floats, names: Sequence[str]) -> str | None:
    """Return the column of these that names the objects, None if there is no such; refuse several that are as likely.

    Where a column labels trials, several that separate times only together name them together, see `Table.joined`.

    It is the one of text, but for what names trials, or of whole numbers that are called like an individual; a column
    that another one determines is a property. Without such, it is the one of numbers that separates times which repeat.
    """
    able = [name for name in names if is_label(table, name, times) and not _holds_clocks(table, name)]
    texts = [name for name in able if not table.is_numeric(name)]
    numbers = [name for name in able if name not in texts and is_called(name, OBJECT - TRIAL)]
    pool = [name for name in texts if not is_called(name, TRIAL)] or texts
    pool = [name for name in pool if not is_covariate(name)] or pool
    codes = {name: table.codes(name) for name in (*pool, *numbers)}
    # A number names an object alone if it is never used twice
    pool += [name for name in numbers if all(_determines(codes[name], codes[text]) for text in pool)]
    # A remark changes within trials, too
    pool = [name for name in pool if (np.diff(times)[np.diff(codes[name]) != 0] <= 0).all()] or pool
    codes = {name: codes[name] for name in pool}
    finest = _finest(codes)
    for likely in (
        finest,
        [name for name in finest if is_called(name, OBJECT)],
        [name for name in finest if increase_within(codes[name], times)],
    ):
        if len(likely) == 1:
            if is_called(likely[0], _MEASURAND):
                raise _long_table(table, likely[0])
            return likely[0]
    if not finest:
        return _separating_column(table, times, names)
    trials = [table.codes(name) for name in able if is_called(name, TRIAL) and name not in finest]
    if any(_separate(times, trial, *(codes[name] for name in finest)) for trial in trials):
        return ", ".join(finest)
    first, second = finest[:2]
    raise CommonlawError("object-ambiguous", where=table.source, columns=finest, first=first, second=second)


def _long_table(table: Table, column: str) -> CommonlawError:
    names = [str(cell) for cell in table.encoded(column)[1]]
    return CommonlawError("long-table", where=table.source, column=column, names=names)


def _separating_column(table: Table, times: Floats, names: Sequence[str]) -> str | None:
    """Return the column of numbers without which times would repeat or go back, None if there is no such or no need.

    It numbers the objects, or is a condition such as a temperature that is held in consecutive rows; at least three
    rows share a number on average. Of several, one that determines the others is taken. Trials of an object are
    numbered by a column that is called so or, without such, by one that counts.
    """
    called = [name for name in names if is_called(name, TRIAL) and is_label(table, name, times)]
    numbers = [name for name in names if table.is_numeric(name) and not is_covariate(name)]
    counted = [[name] for name in numbers if _counts(table, name)]
    for run in [called[:1]] if called else [[], *counted]:
        runs = table.codes(run[0]) if run else np.zeros(len(table), dtype=np.int64)
        if increase_within(runs, times):
            return None
        codes = {name: table.codes(name) for name in numbers if name not in (*called, *run)}
        for name, code in tuple(codes.items()):
            last, changes = int(code.max()), int(np.sum(np.diff(code) != 0))
            is_label_of_rows = code.min() >= 0 and (changes == last or _counts(table, name)) and 3 * last < len(table)
            if not (is_label_of_rows and increase_within(runs * (last + 1) + code, times)):
                del codes[name]
        finest = _finest(codes)
        if finest:
            return finest[0] if len(finest) == 1 else None
    return None


def is_quantity(table: Table, name: str) -> bool:
    """Say whether the numbers in a column are measured, and no labels, as they have a unit."""
    has_unit = name in table.units or bool(units_in_names([name]))
    return has_unit and bool(np.isfinite(readable(table, name)).all())


def joint_objects(table: Table, times: Floats, names: Sequence[str], groups: Codes) -> list[str]:
    """Return columns of conditions that separate times which repeat within groups of rows; none if all do not.

    A condition does not change while time increases, or is text or counts.
    """
    able = [name for name in names if not (table.is_numeric(name) and is_covariate(name))]
    codes = {name: table.codes(name) for name in able}
    for name, code in tuple(codes.items()):
        is_held = (np.diff(times)[np.diff(code) != 0] <= 0).all()
        if code.min() < 0 or 3 * code.max() >= len(table) or not (is_held or _counts(table, name)):
            del codes[name]
    result = list(codes) if _separate(times, groups, *codes.values()) else []
    if quantities := [name for name in result if is_called(name, _MEASURAND)]:
        raise _long_table(table, quantities[0])
    for name in sorted(result, key=lambda name: int(codes[name].max())):
        rest = [condition for condition in result if condition != name]
        result = rest if _separate(times, groups, *(codes[condition] for condition in rest)) else result
    return result


def _separate(times: Floats, *codes: Codes) -> bool:
    """Say whether times increase among the rows of the same codes, each of shape (n,)."""
    groups = np.zeros(len(times), dtype=np.int64)
    for code in codes:
        groups = np.unique(groups * (code.max() + 1) + code, return_inverse=True)[1]
    return increase_within(groups, times)


def _finest(codes: dict[str, Codes]) -> list[str]:
    """Return the columns that are not properties of others: of several spellings of one column it is the first."""
    partitions = dict[bytes, str]()
    for name, code in codes.items():
        partitions.setdefault(_numbered(code).tobytes(), name)
    by_size = sorted(partitions.values(), key=lambda name: -len(np.unique(codes[name])))
    result = list[str]()
    while by_size:  # The finest of the rest is determined by none, and what it determines is a property
        name, *rest = by_size
        result.append(name)
        by_size = [label for label in rest if not _determines(codes[name], codes[label])]
        if len(result) > _MAX_COMPARED:
            result += by_size
            break
    return [name for name in codes if name in {*result}]


def _numbered(codes: Codes) -> Codes:
    """Return codes of the same partition that are numbered as they first occur."""
    _, first, which = np.unique(codes, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[which]


def _determines(codes: Codes, others: Codes) -> bool:
    _, first, which = np.unique(codes, return_index=True, return_inverse=True)
    return np.array_equal(others, others[first][which])


def trial_column(table: Table, times: Floats, names: Sequence[str], owners: Codes, *, named: bool) -> str | None:
    """Return the column of these that labels the trials of objects, shape (n,) in `owners`; None if there is no such.

    It has the name of one; or, where objects are `named`, it is text or counts from 0 or 1, and without it times of an
    object would go back. Several that are as likely are refused.
    """
    able = [name for name in names if is_label(table, name, times) and not is_covariate(name)]
    if called := [name for name in able if is_called(name, TRIAL)]:
        return called[0]
    if increase_within(owners, times) or not named:
        return None
    counted = [
        name
        for name in able
        if not is_called(name, INPUT)
        and _counts(table, name)
        and increase_within(owners * len(table) + table.codes(name), times)
    ]
    if len(counted) > 1:
        raise CommonlawError(
            "trial-ambiguous", where=table.source, columns=counted, first=counted[0], second=counted[1]
        )
    return counted[0] if counted else None


def is_counter(table: Table, name: str, times: Floats) -> bool:
    """Say whether numbers go up by one wherever times increase from row to row, as those of frames and samples do."""
    rising = np.diff(times) > 0
    return bool(np.sum(rising) >= _MIN_COUNTS and (np.diff(readable(table, name))[rising] == 1).all())


def is_label(table: Table, name: str, times: Floats) -> bool:
    """Say whether a column of text or whole numbers has the same cell in several rows, as names of objects do.

    What changes while times increase throughout the table is a remark, unless it is called a name and its rows follow
    each other, or is text where whose cell changes the measurements begin anew, see `_begins_anew`.
    """
    is_text = not table.is_numeric(name)
    if not is_text:
        values = readable(table, name)
        if not np.array_equal(values, np.round(values)) or (
            not is_called(name, OBJECT | TRIAL | _ROW_NUMBER) and (not _counts(table, name))
        ):
            return False
        if is_counter(table, name, times):
            return False
    try:
        codes = table.codes(name)
    except CommonlawError:
        return False
    labels = int(codes.max(initial=-1)) + 1
    if (codes < 0).any() or 2 * labels > len(table):
        return False
    if labels == 1 or not (np.diff(times) > 0).all():
        return True
    if is_called(name, OBJECT | TRIAL) and np.sum(np.diff(codes) != 0) == labels - 1:
        return True
    return is_text and _begins_anew(table, codes, times)


_MIN_JUMP = 3.0
"""Of what is measured where a label changes, relative to the root mean square of steps at the same label."""
_MIN_GAP = 1.5
"""Of a clock where a label changes, relative to nearly all steps at the same label."""
_MAX_COMPARED = 50
"""Columns of numbers that are compared with a label."""
_MIN_RUN = 3
"""Mean number of rows of the same label that follow each other; of fewer, a logger takes turns."""


def _begins_anew(table: Table, codes: Codes, times: Floats) -> bool:
    """Say whether a clock that increases throughout goes over several objects, whose labels are codes, shape (n,).

    There is a gap of the clock wherever the label changes; or, nearly everywhere there, a column of numbers jumps to
    where it returns from in the rows of the next label. What changes in a single object, such as a phase of heating,
    does neither. Where a logger takes turns, rows of three or more labels are nearer to those of the same label.
    """
    changes = np.diff(codes) != 0
    steps = np.diff(times)
    is_in_turns = len(codes) < _MIN_RUN * (np.sum(changes) + 1)
    if not is_in_turns and steps[changes].min() > _MIN_GAP * np.quantile(steps[~changes], 0.9):
        return True
    if is_in_turns and codes.max() < 2:
        return False
    columns = [readable(table, name) for name in table.numeric[:_MAX_COMPARED]]
    parts = [(codes[known], values[known]) for values in columns if np.sum(known := np.isfinite(values)) > _MIN_RUN]
    return any(_is_nearer_to_same(*part) if is_in_turns else _jumps_between(*part) for part in parts)


def _is_nearer_to_same(codes: Codes, values: Floats) -> bool:
    """Say whether values differ far less from those before of the same label than from those before of another."""
    order, changes = np.argsort(codes, kind="stable"), np.diff(codes) != 0
    same, others = np.diff(values[order])[np.diff(codes[order]) == 0], np.diff(values)[changes]
    return bool(len(same) and len(others) and np.mean(others**2) > _MIN_JUMP**2 * np.mean(same**2))


def _jumps_between(codes: Codes, values: Floats) -> bool:
    """Say whether values jump where the label changes, and return from there, at three quarters of the changes."""
    changes, steps = np.flatnonzero(np.diff(codes)), np.diff(values)
    same = np.delete(steps, changes)
    if not len(changes) or not len(same):
        return False
    runs = np.split(values, changes + 1)[1:]
    returns = np.array([run.mean() - run[0] for run in runs])
    far = np.abs(steps[changes]) > _MIN_JUMP * np.sqrt(np.mean(same**2))
    return bool(np.mean(far & (steps[changes] * returns < 0)) >= 0.75)


def runs_of_labels(codes: Codes, times: Floats) -> Codes:
    """Return the number of the run of each row within those of its label, shape (n,), on a clock over several objects.

    Zero throughout where the clock goes back, or some rows of the same label that follow each other are fewer than
    three.
    """
    changes, steps = np.diff(codes) != 0, np.diff(times)
    begins = np.append(0, np.flatnonzero(changes) + 1)
    lengths = np.diff(np.append(begins, len(codes)))
    if lengths.min() < _MIN_RUN or (steps < 0).any() or not (steps > 0)[~changes].all():
        return np.zeros(len(codes), dtype=np.int64)
    order = np.argsort(codes[begins], kind="stable")
    _, first, counts = np.unique(codes[begins][order], return_index=True, return_counts=True)
    number = np.empty_like(begins)
    number[order] = np.arange(len(begins)) - np.repeat(first, counts)
    return np.repeat(number, lengths)


def _holds_clocks(table: Table, name: str) -> bool:
    """Say whether the cells of a column of text look like dates or times of day, which name no objects."""
    return not table.is_numeric(name) and all(
        not isinstance(cell, str) or _CLOCK.fullmatch(cell) for cell in table.columns[name]
    )


def _counts(table: Table, name: str) -> bool:
    """Say whether a column is text, or has all whole numbers from 0 or 1 to some."""
    if not table.is_numeric(name):
        return True
    numbers = np.unique(readable(table, name))
    return any(np.array_equal(numbers, np.arange(first, first + len(numbers))) for first in (0, 1))


def increase_within(codes: Codes, times: Floats) -> bool:
    """Say whether times increase from row to row among those of the same code, at least two each on average."""
    order = np.argsort(codes, kind="stable")
    same = np.diff(codes[order]) == 0
    return bool(np.mean(same) >= 0.5 and (np.diff(times[order]) > 0)[same].all()) if len(times) > 1 else True


def other_clocks(table: Table, names: Sequence[str], times: Floats, runs: Codes) -> list[str]:
    """Return columns of numbers that are further times or row numbers, and increase with the times.

    They are called so, or like counters and hold whole numbers, or have no unit and go up by one from sample to sample.
    """
    order = np.lexsort((times, runs))
    same = np.diff(runs[order]) == 0

    def increases(name: str) -> bool:
        return bool((np.diff(readable(table, name)[order]) > 0)[same].all())

    def counts_on(name: str) -> bool:
        values = readable(table, name)[order]
        steps = np.diff(values)[same]
        if is_called(name, _COUNTER) and np.array_equal(values, np.round(values)):
            return True
        return name not in table.units and len(steps) >= _MIN_COUNTS and bool((steps == 1).all())

    clocks = [
        name
        for name in names
        if (is_called(name, TIME | _ROW_NUMBER) or _dimensions(table, name) == _OF_TIME or counts_on(name))
        and increases(name)
    ]
    return clocks if len(clocks) < len(names) else []


def deviation_columns(table: Table, names: Sequence[str]) -> dict[str, str]:
    """Return columns of standard deviations by the column of their measurements, as far as names pair them.

    ``x_std`` goes with ``x``, ``std1`` with the only column whose name ends in 1, ``sd`` with the only other column.
    """
    deviations = [name for name in names if is_called(name, _DEVIATION) and (readable(table, name) > 0).all()]
    measured = [name for name in names if name not in deviations]
    pairs = dict[str, str]()
    for name in deviations:
        rest = [word for word in words(name) if word not in _DEVIATION]
        if not rest:
            fitting = measured
        elif all(map(str.isdigit, rest)):
            fitting = [column for column in measured if words(column)[-len(rest) :] == rest]
        else:
            fitting = [column for column in measured if [word for word in words(column) if word not in _MEAN] == rest]
        if len(fitting) == 1 and fitting[0] not in pairs:
            pairs[fitting[0]] = name
    return pairs


CONSTANT_IN_TRIALS = "constant in each trial"


def input_columns(table: Table, names: Sequence[str], times: Floats, trials: Sequence[Codes]) -> dict[str, str]:
    """Return columns of numbers that the experimenter set, and what shows it; at least one is left as measured.

    Times are of all rows, shape (n,), and trials the indices of their rows in order of time.
    """
    cells = {name: readable(table, name) for name in names}
    known = {name: values[np.isfinite(values)] for name, values in cells.items()}
    spans = {name: float(np.ptp(values)) or 1.0 if len(values) else 1.0 for name, values in known.items()}
    digits = {name: last_digit(values) / spans[name] for name, values in cells.items()}
    noise = {name: difference_noise([values[rows] for rows in trials]) / spans[name] for name, values in cells.items()}
    # Estimates of white noise are alike by all orders of differences that leave nothing of a course
    white = [name for name in names if noise[name][2:].max() < 1.5 * noise[name][2:].min()]
    noisiest = max((low for name in white if (low := noise[name].min()) > 3 * digits[name]), default=0.0)
    complete, reasons = {name for name, values in cells.items() if np.isfinite(values).all()}, dict[str, str]()
    for name, values in cells.items():
        runs = [values[rows] for rows in trials]
        courses = [(times[rows].tobytes(), values[rows].tobytes()) for rows in trials if np.ptp(values[rows]) > 0]
        if is_called(name, INPUT) or (name == "u" and not _VELOCITIES.intersection(names)):
            reasons[name] = "by its name"
        elif not np.isfinite(values).all() or np.ptp(values) == 0:
            continue
        elif all(np.ptp(run) == 0 for run in runs):
            reasons[name] = CONSTANT_IN_TRIALS
        elif 2 * sum(map(is_held, runs)) >= sum(np.ptp(run) > 0 for run in runs):
            reasons[name] = "held at levels"
        elif len(complete) > 1 and len({*courses}) < len(courses):
            reasons[name] = "the same in several trials"
        elif (
            0 < digits[name] < 1 / 300  # Fewer are the steps of a coarse sensor
            and noise[name].min() < max(digits[name], 1e-5)  # Less than that of instruments
            and noisiest > 3 * noise[name].min()
        ):
            reasons[name] = "smooth to its last digit"
    return reasons if len(reasons) < len(names) else {}


def is_covariate(name: str) -> bool:
    """Say whether a column is called like a code of individuals, such as their sex."""
    return is_called(name, _COVARIATE)


def absent_states(table: Table, names: Sequence[str], codes: Codes) -> dict[str, bool]:
    """Return the columns of numbers that are zero, or empty, in all rows of some labels, as a species not put in.

    With each is whether it is zero there.

    Labels of the rows are codes, shape (n,). Elsewhere these columns vary, as another does in the same rows; they are
    not called inputs and have no negative values.
    """
    labels, which = np.unique(codes, return_inverse=True)
    measured = [name for name in names if not is_called(name, INPUT | _DEVIATION)]
    values = np.array([readable(table, name) for name in measured]).reshape(len(measured), len(table))
    low, high = (np.full((len(measured), len(labels)), sign * np.inf) for sign in (1, -1))
    for j, column in enumerate(values):
        finite = np.isfinite(column)
        np.minimum.at(low[j], which[finite], column[finite])
        np.maximum.at(high[j], which[finite], column[finite])
    varies = high > low
    is_zero = (low == 0) & (high == 0)
    is_absent = is_zero | (high == -np.inf)
    with_others = is_absent & (varies.sum(axis=0) >= 1)
    states = with_others.any(axis=1) & (varies | is_absent).all(axis=1) & varies.any(axis=1) & ~(low < 0).any(axis=1)
    triples = zip(measured, states, is_zero.any(axis=1).tolist(), strict=True)
    return {name: is_zero for name, is_state, is_zero in triples if is_state}


def is_amount(name: str) -> bool:
    """Say whether a column is called like amounts that are given."""
    return is_called(name, _AMOUNT)


def common_inputs(table: Table, inputs: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    """Return those inputs that are no object of a wide table: of another unit than most columns, or of surroundings."""
    units = Counter(table.units.get(name) for name in names)
    return {
        name: reason
        for name, reason in inputs.items()
        if units[table.units.get(name)] < max(units.values()) or is_called(name, _SURROUNDINGS)
    }


def input_values(table: Table, name: str) -> Floats:
    """Return an input as numbers, shape (n,): an empty cell is zero in a column of amounts, and refused in others."""
    if is_amount(name):
        return np.nan_to_num(table.numbers(name, missing=True))
    return table.numbers(name)


def pulsed_inputs(table: Table, names: Sequence[str], trials: Sequence[Codes]) -> list[str]:
    """Return the columns that are zero but for single samples, or empty but for amounts, as these are added at once."""

    def is_pulsed(name: str) -> bool:
        values = input_values(table, name)
        given = [np.flatnonzero(values[rows]) for rows in trials]
        single = np.isnan(readable(table, name)).any() or all((np.diff(indices) > 1).all() for indices in given)
        return single and not values.all() and bool(np.mean(values) > 0)

    return [name for name in names if not is_called(name, _RATE) and is_pulsed(name)]


def note_on_pulses(name: str) -> str:
    """Return what is said of an input that may hold doses, unless it is given as such."""
    return (
        f"{name} is zero but for single samples, between which it is interpolated: if it holds amounts that are added "
        f"at once, fit an equation with `doses=[{name!r}]`"
    )


def is_held(values: Floats) -> bool:
    """Say whether a trial of values stays at levels, within noise, and jumps between them, or has single pulses."""
    is_same = np.diff(values) == 0
    if 2 * np.sum(is_same) < len(is_same):
        return _jumps_twice(values)
    levels, ranks = np.unique(values, return_inverse=True)
    jumps = np.diff(ranks)
    kept = np.diff(np.flatnonzero(np.concatenate([[1], jumps, [1]])))
    if len(levels) < 2 or 2 * np.sum(kept > 1) < len(kept):
        return _jumps_twice(values)
    # A coarse sensor passes through neighbouring levels; it skips few, and none at multiples of a number of samples
    skips, intervals = np.abs(jumps) > 1, np.diff(np.flatnonzero(jumps))
    is_timed = len(intervals) >= 4 and int(np.gcd.reduce(intervals)) >= 3 and skips.any()
    return len(levels) <= 3 or bool(is_timed or 2 * np.sum(skips) > np.sum(jumps != 0))


def _jumps_twice(values: Floats) -> bool:
    """Say whether values jump at least twice between levels that explain all but a hundredth of their variance.

    Jumps are ten times a usual difference, and levels last at least three samples.
    """
    steps = np.abs(np.diff(values))
    if len(values) < 9:
        return False
    jumps = np.flatnonzero(steps > 10 * np.median(steps)) + 1
    if len(jumps) < 2 or np.diff(jumps, prepend=0, append=len(values)).min() < 3:
        return False
    within = sum(float(np.sum((part - part.mean()) ** 2)) for part in np.split(values, jumps))
    return within < 0.01 * len(values) * float(np.var(values))


def last_digit(values: Floats) -> float:
    """Return the decimal place that values are written to, 0 if they have more than twelve digits.

    >>> last_digit(np.array([0.0, 0.25, 10.0])), last_digit(np.array([1 / 3]))
    (0.01, 0.0)
    """
    finite = values[np.isfinite(values)]
    largest = np.abs(finite).max(initial=0.0)
    if not largest:
        return 0.0
    first = int(np.floor(np.log10(largest)))
    for place in range(first, max(first - 12, -308), -1):  # Smaller powers of ten are zero
        for part in (finite[:1000], finite):  # The first ones rule out most places
            scaled = part / 10.0**place
            if not (np.abs(scaled - np.round(scaled)) < 1e-3).all():
                break
        else:
            return float(10.0**place)
    return 0.0


def difference_noise(runs: Sequence[Floats]) -> Floats:
    """Return the standard deviation of noise of evenly spaced values by differences of neighbours of orders 2 to 8.

    The difference of order m of white noise of variance s^2 has variance (2m choose m) s^2; of a smooth course high
    orders leave least (Gasser, Sroka and Jennen-Steinmetz 1986). Infinite where there are too few samples.
    """
    result, differences = np.full(7, np.inf), np.diff(np.concatenate(runs))
    run = np.repeat(np.arange(len(runs)), [len(values) for values in runs])
    for i, order in enumerate(range(2, 9)):
        differences = np.diff(differences)
        parts = differences[run[order:] == run[:-order]]
        parts = parts[np.isfinite(parts)]
        if len(parts) > order:
            result[i] = np.sqrt(np.mean(parts**2) / comb(2 * order, order))
    return result
