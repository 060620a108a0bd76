"""Sheets of a workbook: an object each, a quantity each, or one that holds measurements among others that do not."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timedelta
from itertools import zip_longest
from typing import Any

from commonlaw.errors import CommonlawError
from commonlaw.text import counted
from commonlaw.trials.columns import Table, column_of, filled_table
from commonlaw.trials.headers import label, split_header
from commonlaw.trials.layouts.cells import table_in_cells
from commonlaw.trials.layouts.grid import SORTED, Grid, Sample, labels_of, merged
from commonlaw.trials.reading import READ_AS
from commonlaw.trials.recognition import is_time_header
from commonlaw.trials.rows import Layout, Row, is_value, layout_of

Rows = list[tuple[int, list[Any]]]
"""Numbers, from the first row with a cell on, and cells of rows that are not empty."""
_REMARKS = "Metadata"
"""How sheets of phyphox begin that hold no measurements."""


def table_in_sheets(source: str, sheets: Mapping[str, Rows]) -> Table:
    """Return the table in sheets, none of which is empty.

    Sheets of the same header are an object or, by their names, a trial each, unless there is a column ``object``; those
    that have only the header of their times in common are quantities of one object. Those without times are left out
    where others have them.
    """
    in_cells = {name: table for name, rows in sheets.items() if (table := _table_in_cells(source, rows)) is not None}
    layouts = {name: _layout(rows) for name, rows in sheets.items()}
    timed = [name for name in sheets if name in in_cells or _is_measured(name, sheets[name], layouts[name])]
    left_out = [name for name in sheets if timed and name not in timed]
    measured = {name: sheets[name] for name in sheets if name not in left_out}
    layouts = {name: layouts[name] for name in measured}
    if len(measured) == 1 and in_cells:
        (table,) = in_cells.values()
    elif in_cells:
        raise CommonlawError("workbook-layouts", where=source, sheets=[*measured], first=next(iter(measured)))
    else:
        table = _of_quantities(source, measured, layouts) or _of_objects(source, measured, layouts)
    facts = [f"{counted(len(left_out), 'sheet')} left out: {', '.join(left_out)}"] if left_out else []
    return replace(table, facts=(*table.facts, *facts))


def _table_in_cells(source: str, rows: Rows) -> Table | None:
    """Return the table in the rows of a sheet if they have a layout of cells, with a blank row in place of any gap."""
    listed, last = list[Row](), -1
    for number, cells in rows:
        if number > last + 1:
            listed.append(Row(number, number, []))
        values = [*map(_without_dates, cells)]
        listed.append(Row(number + 1, number + 1, [*map(label, values)], values=values))
        last = number
    return table_in_cells(Grid(source, listed, "row"))


def _without_dates(cell: Any) -> Any:
    """Return a duration as on a clock, 26:10:00, also one that a sheet shows as a date of 1900."""
    if isinstance(cell, datetime) and cell.year in (1899, 1900):
        cell -= datetime(1899, 12, 31)
    if not isinstance(cell, timedelta):
        return cell
    minutes, seconds = divmod(cell.total_seconds(), 60)
    return f"{int(minutes) // 60}:{int(minutes) % 60:02d}:{seconds:02g}"


def _layout(rows: Rows) -> Layout:
    # The header is among the first rows
    return layout_of([Row(number, number, [*map(label, cells)]) for number, cells in rows[:1000]], [])


def _is_measured(name: str, rows: Rows, layout: Layout) -> bool:
    """Say whether a sheet has a column of times."""
    if name.startswith(_REMARKS):
        return False
    written = {cell.strip() for _, cells in rows[:1000] for cell in cells if isinstance(cell, str)}  # Not made up
    written |= {title for title in layout.header if split_header(title)[0] in written}
    times = [j for j, title in enumerate(layout.header) if title.strip() in written and is_time_header(title)]
    return any(sum(is_value(label(cells[j])) for _, cells in _below(rows, layout)) for j in times)


def _differing(source: str, layouts: Mapping[str, Layout]) -> CommonlawError:
    headers = {name: " | ".join(map(str.strip, layout.header)).rstrip(" |") for name, layout in layouts.items()}
    shown = "; ".join(f"{name!r} ({header})" for name, header in headers.items())
    return CommonlawError("workbook-sheets", where=source, sheets=shown)


def _below(rows: Rows, layout: Layout) -> Rows:
    """Return the rows of the table below the header, without remarks at their end."""
    last = len(rows)
    while last and layout.is_below([str(cell) for cell in rows[last - 1][1]]):
        last -= 1
    return [(number, cells) for number, cells in rows[:last] if number >= layout.first_line]


def _of_objects(source: str, sheets: Mapping[str, Rows], layouts: Mapping[str, Layout]) -> Table:
    """Return the table in sheets of the same header, whose rows stand below each other."""
    titles = max((layout.header for layout in layouts.values()), key=lambda header: len("".join(header)))
    bare = [split_header(title)[0] for title in titles]  # A row of units may be in the first sheet alone
    for layout in layouts.values():
        pairs = zip_longest(map(str.strip, layout.header), map(str.strip, titles), bare, fillvalue="")
        if any(title not in names for title, *names in pairs):
            raise _differing(source, layouts)
    many, listed = len(sheets) > 1, list[tuple[str, int, list[Any]]]()
    for name, rows in sheets.items():
        begin = layouts[name].first_line
        listed += [(name, number - begin + 1, cells) for number, cells in _below(rows, layouts[name])]
    cells = [[None if cell == "" else cell for cell in row] + [None] * (len(titles) - len(row)) for *_, row in listed]
    made = [column_of([row[i] for row in cells]) for i in range(len(titles))]
    columns, loose = [column for column, _ in made], [i for i, (_, is_mixed) in enumerate(made) if is_mixed]
    notes, labels = tuple[str, ...](), dict[str, dict[str, str]]()
    if many and "object" not in {title.strip().casefold() for title in titles}:
        labels = {role: dict(zip(sheets, names, strict=True)) for role, names in labels_of([*sheets]).items()}
        what = "a trial" if "trial" in labels else "an object"
        notes = (f"{READ_AS}{len(sheets)} sheets of the same header, each {what} named by its sheet",)
    titles = [*titles, *labels]
    columns += [column_of([names[name] for name, *_ in listed])[0] for names in labels.values()]

    def locate(row: int) -> str:
        name, number, _ = listed[row]
        return f"row {number}" + f" of sheet {name!r}" * many

    table = filled_table(source, titles, columns, loose=loose, locate=locate, number=lambda row: listed[row][1])
    facts = tuple(dict.fromkeys(fact for layout in layouts.values() for fact in layout.facts))
    return replace(table, facts=facts, notes=notes)


def _of_quantities(source: str, sheets: Mapping[str, Rows], layouts: Mapping[str, Layout]) -> Table | None:
    """Return the table in sheets with times under the same header and different quantities, None if they are not such.

    A single quantity in each has another unit, or is called as its sheet; else sheets could be objects.
    """
    headers = {name: [*map(str.strip, layout.header)] for name, layout in layouts.items()}
    times = [[title for title in header if is_time_header(title)] for header in headers.values()]
    others = [title for header in headers.values() for title in header if title and not is_time_header(title)]
    if len(sheets) < 2 or any(time != times[0] or len(time) != 1 for time in times) or len({*others}) < len(others):
        return None
    units = [split_header(title)[1] for title in others]
    is_named = all(any(name.casefold() in title.casefold() for title in headers[name]) for name in sheets)
    if not (is_named or len({*units}) == len(units)):
        return None
    (time,) = times[0]
    samples = list[Sample]()
    for name, rows in sheets.items():
        counts = Counter[object]()
        for number, cells in _below(rows, layouts[name]):
            row = {title: cell for title, cell in zip(headers[name], cells, strict=False) if title}
            counts[row[time]] += 1
            place = f"row {number - layouts[name].first_line + 1} of sheet {name!r}"
            samples.append(Sample((row[time], counts[row[time]]), row, place, number))
    if all(isinstance(sample.cells[time], int | float) for sample in samples):
        samples.sort(key=lambda sample: float(str(sample.cells[time])))
    note = f"{READ_AS}{len(sheets)} sheets with a quantity each, at the times of each: {', '.join(sheets)}"
    return replace(merged(source, samples), roles=SORTED, notes=(note,))
