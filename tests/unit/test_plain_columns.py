"""Columns of plain numbers are read at once; what they hold is what reading cell by cell gives."""

from dataclasses import replace

import numpy as np
import pytest

from commonlaw.errors import CommonlawError
from commonlaw.trials.cells import Notation, Unreadable, numerals
from commonlaw.trials.columns import filled_table, with_numbers
from commonlaw.trials.files import read_table, table_in

KINDS = {
    "fractions": ["0.25", "-1.50", "12.", ".5", "1e-3", "+2.5E2", "0.1000000000000000055511151231257827"],
    "whole": ["0", "12", "-7", "1234", "2000000"],
    "of one": ["1.0", "2.00", "3.", "4.0"],
    "with zeros": ["007", "7", "010", "8"],
    "with signs": ["+5", "-0", "5", "-5"],
    "huge": ["99999999999999999999", "9007199254740993", "1" * 40, "1"],
    "infinite": ["1e999", "inf", "2.5", "3"],
    "commas": ["0,5", "1,25", "12,0", "1234,5"],
    "commas and whole": ["0,123", "1,234", "+2,5e-1", "-0", "007", ",5", "3,"],
    "commas and infinite": ["0,5", "1e999", "inf", "2,5"],
    "whole and thousands": ["1.234", "2.345", "999", "1.000"],
    "large and small": ["1234", "1.234", "12345.5"],
    "marked": ["1.5", "NA", "2.25", "n.d.", "<0.5", "10.125"],
    "whole and marked": ["1", "NA", "2", "2000", "-"],
    "units": ["5 V", "6.5 V", "7 V"],
    "other digits": ["1_000", "２", "3.5"],
    "quoted": ['"1.5"', '"2"', '"NA"', '""'],
    "quoted whole numbers": ['"01"', '"1"', '"2"'],
    "texts in quotes": ['"a;b"', '"say ""x"""', '"c"'],
    "words": ["ball A", "ball B", "1.5"],
    "truths": ["true", "false"],
    "dates": ["2024-01-02", "2024-01-03"],
    "blanks": [" 1.5", "2.5 ", " 3"],
    "empty": [""],
}


def drawn(rng):
    """Return a table with columns of random kinds, some of the cells empty, in text and with every cell as text."""
    kinds = rng.choice([*KINDS], size=rng.integers(2, 6))
    rows = int(rng.integers(3, 30))
    columns = [rng.choice(np.array(KINDS[kind], dtype=object), size=rows) for kind in kinds]
    for column in columns:
        if rng.random() < 0.4:
            column[rng.random(rows) < 0.2] = ""
    header, times = ["t", *(f"c{i}" for i in range(len(kinds)))], [f"{row / 8}" for row in range(rows)]
    lines = [";".join(cells) for cells in zip(times, *columns, strict=True)]
    text = "\n".join([";".join(header), *lines, *[""] * int(rng.integers(0, 2))])
    columns = [np.array([*map(as_text, column)], dtype=object) for column in [times, *columns]]
    return text, filled_table("t.csv", header, columns, loose=range(len(header)))


def as_text(cell):
    """Return a cell as text, NaN if it is empty or a word for that which is not in quotation marks."""
    bare = cell[1:-1].replace('""', '"') if cell.startswith('"') else cell
    return np.nan if cell == "NA" or not bare else bare


def outcome(table, name):
    """Return the numbers of a column, or the code of the refusal."""
    try:
        return table.numbers(name, missing=True)
    except CommonlawError as error:
        return error.code


NOTATIONS = [
    *(Notation(), Notation(","), Notation("."), Notation(missing=("7", "2.5"))),
    *(Notation(missing=("0,5", "12,0")), Notation(below={"1,25": 2.0})),
]


@pytest.mark.parametrize("notation", NOTATIONS, ids=str)
def test_columns_are_the_same_as_read_cell_by_cell(notation):
    rng, plain, commas = np.random.default_rng(1), 0, 0
    for _ in range(20):
        text, careful = drawn(rng)
        raw = table_in("t.csv", text.encode())
        plain, commas = plain + len(raw.plain), commas + len(raw.commas)
        table, expected = with_numbers(raw, notation), with_numbers(careful, notation)
        assert [*table.columns] == [*expected.columns]
        for name in table.columns:
            np.testing.assert_array_equal(outcome(table, name), outcome(expected, name), err_msg=text)
            assert table.is_numeric(name) == expected.is_numeric(name), text
            assert table.is_switch(name) == expected.is_switch(name)
            (codes, labels), (same, words) = table.encoded(name), expected.encoded(name)
            assert [str(label) for label in labels] == [str(word) for word in words], text
            np.testing.assert_array_equal(codes, same)
        assert {*table.facts} == {*expected.facts, *raw.facts}, text
    assert plain > 20
    assert commas > 4


@pytest.mark.parametrize(
    ("cells", "expected"),
    [("5 2 7", [0.5, 0.25, 5, 2, 7]), ("1,5 2 7,0", [0.5, 0.25, 1.5, 2, 7]), ("1.5 2.5", "cell-unreadable")],
)
def test_files_below_each_other_have_one_decimal_mark(tmp_path, cells, expected):
    for name, texts in (("a", "0,5 0,25"), ("b", cells)):
        lines = [f"{t};{x}" for t, x in enumerate(texts.split())]
        (tmp_path / f"{name}.csv").write_text("\n".join(["t;x", *lines, ""]))
    numbers = outcome(with_numbers(read_table(tmp_path), Notation()), "x")
    assert (numbers if isinstance(numbers, str) else numbers.tolist()) == expected


def test_cells_that_show_nothing_more_are_read_as_all_are():
    rng = np.random.default_rng(2)
    pool = [cell for cells in KINDS.values() for cell in cells if '"' not in cell] + ["1,234", "1.234,5", "5 mV", "BLQ"]
    notations = [Notation(), Notation(","), Notation("."), Notation(usual=frozenset(",")), Notation(below={"1": 2.0})]
    for _ in range(100):
        cells = rng.choice(np.array(pool, dtype=object), size=rng.integers(1, 5))
        repeated = np.append(np.repeat(cells, 2), ["2.5", "3.5", "12", "2000", "13"][: rng.integers(0, 5)])
        for notation in notations:
            result = numerals(repeated, notation)
            for i, cell in enumerate(repeated):
                if isinstance(result, Unreadable) or not np.isfinite(result.values[i]):
                    continue
                alone = numerals(np.array([cell], dtype=object), replace(notation, decimal=result.decimal or "."))
                assert isinstance(alone, Unreadable) or alone.values[0] == result.values[i]


def test_rows_of_several_blocks_are_those_of_one():
    line = b'%d;"a;' + b"b" * 3000 + b'";%d.5\n'
    content = b"t;word;x\n" + b"".join(line % (i, i % 7) if i % 1000 else b"\n" for i in range(1, 6_001))
    table = table_in("t.csv", content)
    assert len(content) > 2**24
    assert len(table) == 5_994
    np.testing.assert_array_equal(table.numbers("x"), table.numbers("t") % 7 + 0.5)
    assert table.number(999) == 1002
    assert table.locate(len(table) - 1) == "row 5994 (line 6000)"
