"""Plates with wells, as readers of microplates write them: wells down and times across, or times down and wells across.

Above the first block stands what the instrument was set to, and above each its title. A block is one quantity, such as
an absorbance or a fluorescence, in the same wells.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, zip_longest

from commonlaw.errors import CommonlawError
from commonlaw.text import counted
from commonlaw.trials.columns import Table
from commonlaw.trials.dates import elapsed_in_names
from commonlaw.trials.headers import join_header, split_header
from commonlaw.trials.layouts.grid import SORTED, Grid, Sample, merged, table_of
from commonlaw.trials.reading import READ_AS, WrittenReading
from commonlaw.trials.recognition import is_time_header
from commonlaw.trials.rows import Row, is_value

_WELL = re.compile(r"[A-P]0?(?:[1-9]|1\d|2[0-4])")
"""Of a plate of up to 384 wells."""
_LABEL = re.compile(r"[A-Za-z]\d+")
"""Such as of a well, or of an object next to one: P0."""
_CLOCK = re.compile(r"(?:\d+ days?,? ?)?\d{1,4}:\d\d(?::\d\d(?:[.,]\d+)?)?")
_IN_WORDS = re.compile(r"(\d+) ?h (\d+) ?min(?: (\d+) ?s)?")
"""0 h 10 min."""
_DEGREES = re.compile(r"-?\d+(?:[.,]\d+)? ?°[CF]")
_MIN_TIMES = 3
_MAX_GAP = 2
"""Blank rows between a title and its block."""


@dataclass(frozen=True)
class _Block:
    """Wells across and times down, of a block with times across the rows as columns.

    Parameters
    ----------
    columns
        The cells below each header. Above the first time may stand conditions of the wells, with a name for a time.
    time
        The header of the times.
    rows
        The rows of the file, from the title on.
    places
        Where the cells of each time stand, for messages, and the numbers of these rows or columns.
    is_table
        Whether these are a table as it stands: times down, or headers that are times with a unit.
    """

    title: str
    columns: dict[str, list[object]]
    time: str
    rows: Sequence[Row]
    places: Sequence[tuple[str, int]]
    is_table: bool

    @property
    def wells(self) -> list[str]:
        """The headers that are names of wells."""
        return [name for name in self.columns if _WELL.fullmatch(name)]

    @property
    def first(self) -> int:
        """The index of the first time."""
        return next(i for i, cell in enumerate(self.columns[self.time]) if is_value(_text(cell)))

    def complete(self) -> "_Block":
        """Return the block without the times at which no well has a cell, as after a run that was stopped."""
        wells = [self.columns[name] for name in self.wells]
        kept = [i for i in range(len(self.places)) if any(_text(cells[i]) for cells in wells)]
        columns = {name: [cells[i] for i in kept] for name, cells in self.columns.items()}
        return replace(self, columns=columns, places=[self.places[i] for i in kept])

    def in_words(self) -> str:
        """Return the size, with the unit of the times."""
        times = [*map(_text, self.columns[self.time][self.first :])]
        unit = split_header(self.time)[1] or elapsed_in_names(times)[0] or ("s" if ":" in times[0] else "")
        return f"{counted(len(self.wells), 'well')}, {counted(len(times), 'time')}{f' in {unit}' if unit else ''}"


def plates(grid: Grid) -> Table | None:
    """Return the table of the plates in a grid, None if it has no wells with times, or is a table as it stands.

    One block becomes a wide table, with a column for each well; of several each is a column of a long one.
    """
    blocks = [block.complete() for block in _blocks(grid)]
    facts = grid.left_out([row for block in blocks for row in block.rows])
    if not blocks or (len(blocks) == 1 and blocks[0].is_table and not (blocks[0].title or facts)):
        return None
    if len(blocks) > 1:
        return _long(grid, blocks, facts)
    (block,) = blocks
    places, title = block.places, f", {block.title}" if block.title else ""
    table = table_of(grid.source, block.columns, lambda row: places[row][0], lambda row: places[row][1])
    roles: WrittenReading = {"wide": True, "states": block.wells}
    return replace(table, facts=facts, roles=roles, notes=(f"{READ_AS}a plate: {block.in_words()}{title}",))


def _text(cell: object) -> str:
    return "" if cell is None else str(cell).strip()


def _blocks(grid: Grid) -> list[_Block]:
    """Return the blocks in the order of their rows."""
    rows, result, i, end = grid.rows, list[_Block](), 0, 0
    lines = {row.line: number for number, row in enumerate(rows)}
    while i < len(rows):
        cells, block = rows[i].cells, None
        wells = [
            j for j, cell in enumerate(cells) if len(cell) < 5 and cell[:1].isalpha() and _WELL.fullmatch(cell.strip())
        ]
        if wells and not any(map(str.strip, cells[: wells[0]])) and _values(rows[i], wells[0]) >= _MIN_TIMES:
            block = _wells_down(grid, end, i, wells[0])
        elif len(wells) > 1:
            block = _wells_across(grid, end, i)
        if block is not None:
            result.append(block)
            i = end = lines[block.rows[-1].line] + 1
        else:
            i += 1
    return result


def _values(row: Row, left: int) -> int:
    """Return how many values stand in a row to the right of a column."""
    return sum(map(is_value, row.cells[left + 1 :]))


def _wells_down(grid: Grid, begin: int, first: int, left: int) -> _Block | None:
    """Return the block whose first well is in a row and a column, None if no times stand above it.

    It does not reach above the row `begin`. A well in several rows is an object of a long table.
    """
    rows, last, top, wells = grid.rows, first, first, {_text(grid.rows[first].value(left))}
    while last + 1 < len(rows) and _WELL.fullmatch(well := _text(rows[last + 1].value(left))):
        if well in wells:
            return None
        wells.add(well)
        last += 1
    while top > begin and not rows[top - 1].is_blank:
        top -= 1
    times = next((i for i in reversed(range(top, first)) if _holds_times(rows[i], left, i == first - 1)), None)
    if times is None or _LABEL.fullmatch(head := _text(rows[times].value(left))):
        return None
    while top < times and _values(rows[top], left) < _MIN_TIMES:
        top += 1
    used = [row for row in rows[top : last + 1] if row is rows[times] or _values(row, left)]
    width, columns = max(len(row.cells) for row in used), dict[str, list[object]]()
    for row in used:
        cells, name = [row.value(j) for j in range(left + 1, width)], _text(row.value(left))
        if row is rows[times]:
            name, cells = _named_times(rows[times], rows[times - 1] if times else row, left, width)
            time = name
        elif not name:
            is_temperature = all(_DEGREES.fullmatch(text) for text in map(_text, cells) if text)
            name = "temperature" if is_temperature else f"{grid.line} {row.line}"
        if name in columns:
            raise CommonlawError("plate-row-twice", where=grid.source, name=name, place=f"{grid.line} {row.line}")
        columns[name] = cells
    title, above = _title(grid, begin, top)
    places = [(f"column {j + 1}", j + 1) for j in range(left + 1, width)]
    is_table = times == first - 1 and bool(head) and bool(elapsed_in_names(rows[times].cells)[1])
    return _Block(title, columns, time, rows[above : last + 1], places, is_table)


def _named_times(row: Row, above: Row, left: int, width: int) -> tuple[str, list[object]]:
    """Return the header of the times in a row, and its cells, with names of conditions ahead of the first time.

    Where the header of the times stands in place of such a name, it is in the row above.
    """
    cells = [row.value(j) for j in range(left + 1, width)]
    cells = [_IN_WORDS.sub(_as_clock, cell) if isinstance(cell, str) else cell for cell in cells]
    unit, elapsed = elapsed_in_names(map(_text, cells))
    first = next(i for i, cell in enumerate(cells) if is_value(_text(cell)) or _text(cell) in elapsed)
    headers = [text for text in (_text(row.value(j)) for j in range(left + 1 + first)) if is_time_header(text)]
    header = headers[-1] if headers else "time"
    if elapsed.keys() >= {*map(_text, cells[first:])} - {""}:
        cells[first:] = [elapsed.get(_text(cell)) for cell in cells[first:]]
        header = join_header(split_header(header)[0], unit)
    for i in range(first):
        if not _text(cells[i]) or is_time_header(_text(cells[i])):
            cells[i] = _text(above.value(left + 1 + i)) or f"column {left + i + 2}"
    return header, cells


def _wells_across(grid: Grid, begin: int, head: int) -> _Block | None:
    """Return the block below a row with the names of wells, None if it has no column of times ahead of them."""
    rows, names = grid.rows, [*map(str.strip, grid.rows[head].cells)]
    first = next(j for j, name in enumerate(names) if _WELL.fullmatch(name))
    time = next((j for j, name in enumerate(names[:first]) if is_time_header(name)), None)
    if time is None:
        return None
    last = head
    while last + 1 < len(rows) and is_value(_text(rows[last + 1].value(time))):
        last += 1
    used = [j for j, name in enumerate(names) if name]
    if last == head or len({names[j] for j in used}) < len(used):
        return None
    columns = {names[j]: [row.value(j) for row in rows[head + 1 : last + 1]] for j in used}
    title, above = _title(grid, begin, head)
    places = [(f"{grid.line} {row.line}", row.line) for row in rows[head + 1 : last + 1]]
    return _Block(title, columns, names[time], rows[above : last + 1], places, is_table=True)


def _holds_times(row: Row, left: int, is_above_wells: bool) -> bool:
    """Say whether the cells of a row are times: with a unit, as on a clock, or behind a name or a unit of time.

    Directly above wells these may also be any numbers that increase, but not those of cycles: 1, 2, 3.
    """
    cells = [cell.strip() for cell in row.cells[left + 1 :]]
    elapsed = elapsed_in_names(cells)[1]
    cells = [cell for cell in cells if is_value(cell) or cell in elapsed]
    if len(cells) < _MIN_TIMES:
        return False
    if any(is_time_header(cell.strip()) for cell in row.cells if not is_value(cell)):
        return True
    timed = sum(bool(_CLOCK.fullmatch(cell) or _IN_WORDS.fullmatch(cell)) for cell in cells)
    if max(timed, len(elapsed)) >= len({*cells}):
        return True
    try:
        numbers = [float(cell.replace(",", ".")) for cell in cells]
    except ValueError:
        return False
    steps = [there - here for here, there in pairwise(numbers)]
    return is_above_wells and min(steps) > 0 and not (numbers[0] in (0, 1) and {*steps} == {1.0})


def _as_clock(match: re.Match[str]) -> str:
    return f"{match[1]}:{int(match[2]):02d}:{int(match[3] or 0):02d}"


def _title(grid: Grid, begin: int, top: int) -> tuple[str, int]:
    """Return the only cell of the last row above a block, and the index of this row; no title and the block's."""
    above = top - 1
    while above >= begin and grid.rows[above].is_blank and top - above <= _MAX_GAP:
        above -= 1
    if above < begin or sum(bool(cell.strip()) for cell in grid.rows[above].cells) != 1:
        return "", top
    return grid.rows[above].text, above


def _long(grid: Grid, blocks: Sequence[_Block], facts: Sequence[str]) -> Table:
    """Return the table with a row for each well and time, and a column for each title."""
    names = [re.sub(r"\W+", "_", block.title).strip("_") or "value" for block in blocks]
    names = [f"value_{name}" if name[0].isdigit() else name for name in names]
    titles, times = [block.title or "no title" for block in blocks], [block.time for block in blocks]
    pairs = [(name, well) for name, block in zip(names, blocks, strict=True) for well in block.wells]
    if len({*pairs}) < len(pairs) or len({*times}) > 1:
        raise CommonlawError("plate-blocks", where=grid.source, titles=titles, times=times)
    counts, by_well = Counter(header for block in blocks for header in block.columns), dict[str, list[list[Sample]]]()
    for name, block in zip(names, blocks, strict=True):
        for well, samples in _samples(name, block, counts).items():
            by_well.setdefault(well, []).append(samples)
    in_turns = [zip_longest(*of_well) for of_well in by_well.values()]  # Blocks are measured one after the other
    ordered = [sample for turns in in_turns for turn in turns for sample in turn if sample is not None]
    roles: WrittenReading = {"object": "well", "time": split_header(times[0])[0], "states": [*dict.fromkeys(names)]}
    shown = "; ".join(f"{block.title}: {block.in_words()}" for block in blocks)
    note = f"{READ_AS}a plate of {counted(len(by_well), 'well')} in {counted(len(blocks), 'block')}: {shown}"
    return replace(merged(grid.source, ordered), facts=tuple(facts), roles=roles | SORTED, notes=(note,))


def _samples(name: str, block: _Block, counts: Mapping[str, int]) -> dict[str, list[Sample]]:
    """Return what a block has of each well at its times, with the conditions of the well, by their headers.

    Other columns that several blocks have, as `counts` says, have the name of the block behind theirs.
    """
    columns, wells, first = block.columns, block.wells, block.first
    times, others = columns[block.time], dict[str, list[object]]()
    for header in [header for header in columns if header not in (block.time, *wells)]:
        title, unit = split_header(header)
        others[join_header(f"{title} {name}", unit) if counts[header] > 1 else header] = columns[header]
    result = dict[str, list[Sample]]()
    for well in wells:
        conditions = {_text(times[j]): columns[well][j] for j in range(first)}
        result[well] = [
            Sample(
                (well, _text(times[i])),
                {"well": well, block.time: times[i]}
                | conditions
                | {header: cells[i] for header, cells in others.items()}
                | {name: columns[well][i]},
                f"{block.places[i][0]}, well {well}",
                block.places[i][1],
            )
            for i in range(first, len(times))
        ]
    return result
