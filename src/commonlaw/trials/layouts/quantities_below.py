"""Quantities below each other: a column names them, another has their values, as in the measurement tables of PEtab.

Schmiester et al. (2021), PEtab: Interoperable specification of parameter estimation problems, PLOS Comput. Biol. 17.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Codes, Table
from commonlaw.trials.headers import join_header, known_unit, label
from commonlaw.trials.layouts.grid import Sample, merged
from commonlaw.trials.nonmem import items_of
from commonlaw.trials.reading import READ_AS, Reading, WrittenReading
from commonlaw.trials.recognition import (
    OBJECT,
    SENSOR,
    TRIAL,
    deviation_columns,
    is_called,
    is_covariate,
    names_quantities,
    readable,
    time_column,
    vocabulary,
    words,
)
from commonlaw.trials.roles import free_columns

_VALUE = vocabulary("measurement value values dv y result conc concentration observation response reading amount")
_UNIT = vocabulary("unit units")
_OWNER = (OBJECT | TRIAL) - vocabulary("id name")
_CONDITIONS = ("preequilibrationConditionId", "simulationConditionId", "replicateId")
"""Of a PEtab problem, which name its trials together."""


def quantities_below(table: Table, reading: Reading) -> Table | None:
    """Return a table with a column for each quantity that a column names, None if there is no such column.

    Raises
    ------
    CommonlawError
        If it is not clear which column has the values, or if a quantity has several units.
    """
    free = free_columns(table, reading)
    kinds = [name for name in free if _names_quantities(table, name, reading)]
    if len(kinds) != 1 or reading.get("wide") or items_of(table, reading):
        return None
    named = reading.get("time")
    time = table.find(named) if named else time_column(table)
    if time is None:
        return None
    (kind,) = kinds
    numbers = [name for name in table.numeric if name not in (kind, time) and not _is_label(table, name)]
    deviations = deviation_columns(table, numbers)
    values = [name for name in numbers if name in free and name not in deviations.values() and not is_covariate(name)]
    values = [name for name in values if is_called(name, _VALUE)] or values
    if not values:
        return None
    if len(values) > 1:
        raise CommonlawError("long-table-values", where=table.source, column=kind, values=values)
    (value,) = values
    noise = deviations.get(value)
    codes, cells = table.encoded(kind)
    names = [cell if isinstance(cell, str) else f"{value}{label(cell)}" for cell in cells]
    names = [f"{value} {name}" if name in table.columns else name for name in names]
    of_units = [name for name in free if is_called(name, _UNIT) and not table.is_numeric(name)]
    units = _units(table, kind, of_units[0]) if of_units else [table.units.get(value, "")] * len(names)
    rest = [name for name in table.columns if name not in (kind, time, value, noise, *of_units)]
    table, conditions = _with_conditions(table, rest)
    kept, groups = _common(table, [name for name in rest if name not in conditions[:-1]], codes, table.codes(time))
    headers = [join_header(name, unit) for name, unit in zip(names, units, strict=True)]
    known = {join_header(name, table.units.get(name, "")): table.columns[name] for name in (*kept, time)}
    samples, counts, order = list[tuple[float, Sample]](), Counter[object](), readable(table, time)
    for row in np.flatnonzero(codes >= 0).tolist():
        counts[groups[row], codes[row]] += 1
        of_row = {header: column[row] for header, column in known.items()}
        of_row |= {headers[codes[row]]: table.columns[value][row]}
        of_row |= {f"{names[codes[row]]} sd": table.columns[noise][row]} if noise else {}
        key = groups[row], counts[groups[row], codes[row]]
        samples.append((float(order[row]), Sample(key, of_row, table.locate(row), table.number(row))))
    if np.isfinite(order).all():
        samples.sort(key=lambda pair: pair[0])
    roles: WrittenReading = {"states": names}
    if noise:
        roles["noise_columns"] = {name: f"{name} sd" for name in names}
    if conditions and reading.get("object") != conditions[-1]:
        roles |= {"object": "", "trial": conditions[-1]}
    left_out = [name for name in rest if name not in (*kept, *conditions)]
    notes = [f"{READ_AS}a long table: {', '.join(names)} in {kind}, with their values in {value}"]
    notes += [f"columns left out, as they differ between quantities: {', '.join(left_out)}"] if left_out else []
    return replace(
        merged(table.source, [sample for _, sample in samples]),
        notation=table.notation,
        label=table.label,
        roles={**table.roles, **roles},
        notes=(*table.notes, *notes),
    )


def _names_quantities(table: Table, name: str, reading: Reading) -> bool:
    """Say whether a column is called like one that names quantities, or like one of sensors whose names are states."""
    if not names_quantities(name) and not is_called(name, SENSOR):
        return False
    cells = [label(cell) for cell in table.encoded(name)[1]]
    states = reading.get("states") or ()
    is_said = not {*cells}.isdisjoint([states] if isinstance(states, str) else states)
    return (names_quantities(name) or is_said) and 2 * len(cells) <= len(table)


def _is_label(table: Table, name: str) -> bool:
    """Say whether a column may name objects or trials."""
    if table.is_numeric(name) and not is_called(name, OBJECT | TRIAL):
        return False
    return 2 * len(table.encoded(name)[1]) <= len(table)


def _units(table: Table, kind: str, unit_column: str) -> list[str]:
    """Return the unit of each quantity, of a column of units."""
    codes, cells = table.encoded(kind)
    units, texts = table.encoded(unit_column)
    result = list[str]()
    for code, cell in enumerate(cells):
        of_quantity = {str(texts[unit]) for unit in np.unique(units[(codes == code) & (units >= 0)])}
        if len(of_quantity) > 1:
            raise CommonlawError("long-table-units", where=table.source, quantity=cell, units=sorted(of_quantity))
        unit = next(iter(of_quantity), "")
        result.append(unit if known_unit(unit) is not None else "")
    return result


def _with_conditions(table: Table, names: Sequence[str]) -> tuple[Table, list[str]]:
    """Return the table of a PEtab problem with its conditions in one column, the last of those that name them."""
    conditions = [name for name in _CONDITIONS if name in names] if _CONDITIONS[1] in names else []
    if conditions:
        cells = zip(*table.texts(conditions), strict=True)
        labels = [", ".join(filter(None, map(label, row))) for row in cells]
        columns = {**table.columns, conditions[-1]: np.array(labels, dtype=object)}
        plain, loose = table.plain - {conditions[-1]}, table.loose - {conditions[-1]}
        table = replace(table, columns=columns, plain=plain, loose=loose)
    return table, conditions


def _common(table: Table, names: Sequence[str], kinds: Codes, times: Codes) -> tuple[list[str], Codes]:
    """Return the columns that all quantities of a sample have in common, and codes of the rows of a sample, shape (n,).

    Texts that follow from the quantity at each time, such as remarks on it, name no objects.
    """
    labels = [name for name in names if _is_label(table, name) and (table.codes(name) >= 0).all()]
    for name in [name for name in labels if not is_called(name, _OWNER) and words(name) != ["id"]]:
        codes = [table.codes(label_column) for label_column in labels if label_column != name]
        alone, of_quantity = _groups(times, *codes), _groups(times, kinds, *codes)
        if not _are_constant(table.codes(name), alone) and _are_constant(table.codes(name), of_quantity):
            labels = [label_column for label_column in labels if label_column != name]
    groups = _groups(times, *(table.codes(name) for name in labels))
    return [name for name in names if name in labels or _are_constant(table.codes(name), groups)], groups


def _groups(*codes: Codes) -> Codes:
    """Return codes of the combinations of others, each of shape (n,)."""
    return np.asarray(np.unique(np.column_stack(codes), axis=0, return_inverse=True)[1], dtype=np.int64).reshape(-1)


def _are_constant(codes: Codes, groups: Codes) -> bool:
    return len(np.unique(_groups(groups, codes))) == len(np.unique(groups))
