"""Files of few bytes that stand for many: packed rows, endless lines, shared texts, nested keys and numbers."""

import bz2
import gzip
import io
import lzma
import random
import zipfile
from collections.abc import Callable, Mapping

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.hostile.case import Case

CHECK = ("data", "check", "t.csv", "--json")

PACKERS: tuple[Callable[[bytes], bytes], ...] = (gzip.compress, bz2.compress, lzma.compress)

FILLINGS = (
    b"1,2\n",
    b"\n",
    b"\r",
    b" ",
    b",",
    b'"',
    b"#\n",
    b"1",
    b"a",
    b"\0",
    b'"1","2"\n',
    b"1;2\n",
    b"0." + b"0" * 500 + b",1\n",
)


def packed(r: random.Random) -> Case:
    """Streams of which each unpacks to a part of a table, or to what never ends."""
    pack, rows = r.choice(PACKERS), r.choice([5, 40])
    lines = [b"t,x\n", *(b"%d,%d\n" % (i, i * i) for i in range(rows))]
    if r.random() < 0.4:
        cuts = sorted(r.sample(range(len(lines) + 1), 2))
        parts = [b"".join(lines[i:j]) for i, j in zip([0, *cuts], [*cuts, None], strict=True)]
        return Case(CHECK, {"t.csv": b"".join(map(pack, parts))}, samples=rows)
    filling = r.choice(FILLINGS)
    block = pack(filling * (2**20 // len(filling)))
    return Case(CHECK, {"t.csv": pack(b"".join(lines)) + block * 1100}, refused=True)


def endless(r: random.Random) -> Case:
    """Tables of text with a line or a cell that is too long, far too many columns, or values whose powers overflow."""
    lines = [b"t,x", *(b"%d,%d" % (i, i * i) for i in range(r.choice([10, 20_000])))]
    odd = r.choice(
        [
            b"9," + r.choice([b"1", b"a", b"1,", b" 1", b"- "]) * 200_000,
            b'9,"' + b"1," * 100_000 + b'"',
            b"," * 20_000,
            b"99999,%.3fe%d" % (r.uniform(-9, 9) or 1, r.choice([53, 100, 155, 200, 307])),
            b"99999," + b"9" * r.choice([60, 400, 5000]),
        ]
    )
    lines.insert(r.choice([len(lines), len(lines) // 2]), odd)
    return Case(CHECK, {"t.csv": b"\n".join(lines) + r.choice([b"", b"\n"])}, refused=True)


def shared(r: random.Random) -> Case:
    """Parquet files and workbooks that hold a text or a number once for all rows."""
    if r.random() < 0.3:
        written = io.BytesIO()
        with zipfile.ZipFile(written, "w", zipfile.ZIP_DEFLATED) as book:
            for name in ("[Content_Types].xml", "xl/workbook.xml", "xl/sharedStrings.xml", "xl/worksheets/sheet1.xml"):
                book.writestr(name, r.choice(["<a>", "<row><c><v>1</v></c></row>", " "]) * r.choice([10, 2**22]))
        return Case(CHECK, {"t.csv": written.getvalue()}, refused=True)
    rows, length = r.choice([(10, 10), (1000, 300_000), (100_000, 300_000), (1_000_000, 10)])
    text = pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), [r.choice(["a", "1", " ", "1 "]) * length])
    table = pa.table({"t": np.arange(rows) / 8, "x": np.arange(rows) % 97.0, "text": text})
    written = io.BytesIO()
    pq.write_table(table, written, store_schema=False)
    return Case(CHECK, {"t.csv": written.getvalue()})


NESTED: Mapping[str, str] = {
    "key": "{open}" + "a." * 50_000 + "a{close} = 1\n",
    "text": '"".' * 50_000 + "a = 1\n",
    "list": "time = " + "[" * 50_000,
    "table": "time = " + "{{a = " * 50_000,
    "number": "time = " + "9" * 200_000,
}


def nested(r: random.Random) -> Case:
    """Schemas and laws that are nested deeply, or hold a number of very many digits."""
    table = b"t,x\n" + b"".join(b"%d,%d\n" % (i, i * i) for i in range(9))
    if r.random() < 0.6:
        opening, closing = r.choice([("", ""), ("[", "]"), ("[[", "]]")])
        schema = NESTED[r.choice([*NESTED])].format(open=opening, close=closing).encode()
        return Case((*CHECK, "--schema", "s.toml"), {"t.csv": table, "s.toml": schema}, refused=True)
    inner = r.choice(["[" * 100_000, '{"a":' * 100_000, "9" * 1_000_000, "1e" + "9" * 100_000, "[]," * 500_000 + "[]"])
    return Case(("show", "law.json"), {"law.json": f'{{"version": [{inner}]}}'.encode()}, refused=True)
