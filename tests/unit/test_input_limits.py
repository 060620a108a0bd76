"""Limits of what is read, asked while it is read: bombs of a few kilobytes, long lines and cells, nested input."""

import bz2
import gzip
import lzma
import tracemalloc
from time import process_time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import commonlaw as cl
from commonlaw.cli.source import read_schema
from commonlaw.runtime.files import LONGEST_LINE, MOST_LINES, MOST_ROWS, check_size, unpacked
from commonlaw.trials.files import table_in
from commonlaw.trials.rows import is_value
from tests.refusals import refused

HEAD = b"t,x\n0,1\n1,2\n2,3\n"

STREAMS = {
    "gzip": gzip.compress,
    "bzip2": bz2.compress,
    "xz": lzma.compress,
}


@pytest.mark.parametrize("pack", STREAMS.values(), ids=STREAMS)
def test_a_bomb_of_rows_is_refused_before_it_is_unpacked(pack):
    bomb = pack(HEAD) + pack(b"\n" * 2**16) * 20_000  # 1.3 GB
    with refused("table-too-large", source="t.csv", cells="lines", limit=MOST_LINES):
        table_in("t.csv", bomb)


def test_text_that_unpacks_to_a_hundred_times_its_size_is_refused():
    line = b"0." + b"0" * 1000 + b",1\n"
    bomb = gzip.compress(HEAD) + gzip.compress(line * 1000) * 1000
    with refused("unpacked-too-large", limit=2**28):
        table_in("t.csv", bomb)


@pytest.mark.parametrize("filling", [b" ", b",", b'"', b"a", b"1"])
def test_a_line_without_end_is_refused(filling):
    with refused("line-too-long", line=5, limit=LONGEST_LINE):
        table_in("t.csv", HEAD + filling * (LONGEST_LINE + 2**21))
    assert unpacked("t.csv", HEAD * 2**20)


@pytest.mark.parametrize(("rows", "ending"), [(18_000, b"\n50000,3\n"), (10, b""), (10, b"\n"), (10, b"\n50000,3\n")])
def test_a_cell_that_is_too_long_is_refused_wherever_it_stands(rows, ending):
    lines = b"".join(b"%d,%d.25\n" % (i, i * i % 97) for i in range(rows))
    with refused("cell-too-long", line=rows + 2, limit=131_072):
        table_in("t.csv", b"t,x\n" + lines + b"50000," + b"1" * 131_073 + ending)
    with refused("cell-too-long"):
        table_in("t.csv", b"t,x\n" + lines + b'50000,"' + b"1," * 70_000 + b'"' + ending)


def test_a_header_of_too_many_columns_is_refused():
    header = b",".join(b"x%d" % i for i in range(20_000))
    with refused("table-too-large", count=20_000, cells="columns"):
        table_in("t.csv", header + b"\n" + b"\n".join([b"1," * 19_999 + b"1"] * 3))


def test_only_rows_are_counted():
    check_size("t.csv", MOST_ROWS, 2)
    table = table_in("t.csv", b"# of a logger\n\n" + HEAD + b"\n" * 5)
    assert len(table) == 3


def test_comments_between_rows_are_taken_out_in_linear_time():
    taken = list[float]()
    for rows in (1_000, 10_000):
        begin = process_time()
        table = table_in("t.csv", b"t,x\n" + b"".join(b"%d,2\n# a remark\n" % i for i in range(rows)) + b"50000,3\n")
        taken.append(process_time() - begin)
        assert len(table) == rows + 1
    assert taken[1] < 40 * taken[0]


LONG_CELLS = {
    "blanks": "1" + " " * 100_000 + "a1",
    "digits": "1" * 100_000 + "a1",
    "blanks before a unit": "1" + " " * 100_000 + "[m]",
    "numbers": "1 " * 3_000 + "a1",
}


@pytest.mark.parametrize("cell", LONG_CELLS.values(), ids=LONG_CELLS)
def test_a_long_cell_takes_no_time_in_proportion_to_its_square(cell):
    begin = process_time()
    is_value(cell)
    table_in("t.csv", HEAD + f"3,{cell}\n".encode())
    assert process_time() - begin < 5


DEEP = {
    "a key": "a." * 100_000 + "a = 1\n",
    "a table": "[" + "a." * 100_000 + "a]\n",
    "texts as keys": '".".' * 50_000 + "a = 1\n",
    "a comment that begins a text": "# it's\n" + "a." * 100_000 + "a = 1 # it's\n",
    "an inline table": "time = {" + "a . " * 50_000 + "a = 1}\n",
    "lists": "time = " + "[" * 100_000,
    "inline tables": "time = " + "{a=" * 100_000,
    "a number": "time = " + "9" * 1_000_000,
}


@pytest.mark.parametrize("content", DEEP.values(), ids=DEEP)
def test_a_schema_that_is_nested_too_deeply_is_refused_before_it_is_unfolded(tmp_path, content):
    (tmp_path / "schema.toml").write_text(content)
    tracemalloc.start()
    try:
        with refused("table-schema"):
            read_schema(str(tmp_path / "schema.toml"))
        assert tracemalloc.get_traced_memory()[1] < 2**27
    finally:
        tracemalloc.stop()


def test_points_in_texts_of_a_schema_separate_no_keys(tmp_path):
    name = ".".join("a" * 100)
    (tmp_path / "schema.toml").write_text(
        f'time = "{name}"\nobject = \'{name}\'\nunits = {{"{name}" = "m"}} # {name}\n'
    )
    assert read_schema(str(tmp_path / "schema.toml")) == {"time": name, "object": name, "units": {name: "m"}}


def test_a_text_that_stands_in_every_row_of_a_parquet_file_is_gone_through_once_or_refused(tmp_path):
    rows = 10_000
    for count, expected in ((100_000, 1), (300_000, 0)):
        text = pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), [" y" * (count // 2) + " "])
        table = pa.table({"t": np.arange(rows) / 8, "x": np.arange(rows) % 97.0, "text": text})
        pq.write_table(table, tmp_path / "t.parquet", store_schema=False)
        if expected:
            assert len(cl.Trials.read(tmp_path / "t.parquet")) == expected
        else:
            with refused("parquet-too-large"):
                cl.Trials.read(tmp_path / "t.parquet")
