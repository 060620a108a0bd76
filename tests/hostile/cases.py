"""Hostile cases, each made from its kind and its seed alone: files, and a command that is to be done or refused."""

import io
import json
import os
import random
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import click
import openpyxl
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

import commonlaw as cl
from commonlaw.cli.main import commonlaw
from commonlaw.cli.options import WrittenFile
from commonlaw.law import to_json
from tests.hostile import command_cases, equation_cases, law_cases, packed_cases, table_cases
from tests.hostile.case import Case

EXECUTED = "executed"
"""A file that is there after a case if something in it was run."""

CODE = f"__import__('pathlib').Path('{EXECUTED}').touch()"

WORDS = (
    "", " ", "0", "-1", "1", "2", "3", "1e999", "nan", "inf", "-inf", "1e308", "1e-320", "999999999999", "abc",
    "None", "True", CODE, "../secret.csv", "secret.csv", "pipe", "/dev/zero", ".", "..", "a" * 300,
    "\x1b[2J\x1b]0;a\x07", "日本", "\udcff", "\u202e", "=", "x=", "=1", "self=1", "t=1", "height=m", "height=5",
    "height=1e999", "ball=golf", "ball=", ":", "a:b:c", "-", "%s", "{}", "\n", "\r", ",", "1,2", "`", "'", '"',
    "$\\input{/etc/passwd}$", "<script>", "golf", "height", "t", "ball", "drop", "v", "x", "1=-9.8", "1=abc",
    "height:1", "height:v=1", "drops.csv", "law.json", "poly:3", "poly:100", "poly:-1", "poly:2:height",
    "fourier:1000", "fourier:2", "rational:1:1+v**2", "constant", "poly:1 * fourier:1", "stlsq:1", "group-stlsq:0",
    "best-subset:3", "lasso:1", "sr3:1", "forward:99", "savgol:35:3", "savgol:4:9", "finite:2", "finite:999",
    "spline", "median:3", "wiener:3", "spectral", "tv:1", "robust", "linear-drag", "linear-drag:gravity=abc",
    "linear-drag:samples=5:trials=1", "lorenz:samples=20:trials=1", "lotka-volterra:noise=-1",
)  # fmt: skip
"""What options and arguments are given."""

NUMBERS = WORDS.index("999999999999") + 1
"""How many of them, from the first, are numbers."""

TARGETS = (
    "out.json", "out.csv", "out.parquet", "out.svg", "out.png", "out.pdf", "out", "out.xyz", "drops.csv", "law.json",
    "", ".", "nowhere/out.json", "a" * 300 + ".json", "./drops.csv", "o\nut.json", "日本.svg", "\udcff.csv",
    "link.csv",
)  # fmt: skip
"""Where commands are to write: never a device, nor outside of the folder of the case."""

TOKENS = (
    "height", "v", "t", "x", "1", "2", "0", "1e9", "1e400", ".5", "+", "-", "*", "/", "**", "^", "(", ")", ",",
    "sin(", "exp(", "log(", "abs(", "eval(", "`", "``", "'", "''", "=", ";", " ", " + ", " * ", "terms:", "poly:2",
    "_", "__", ".", "[", "]", "{", "}", "lambda", CODE, "a", "b", "\n", "日", "\x1b", "d/dt", "dheight/dt",
)  # fmt: skip

ODD_JSON: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2, 3, 10**30, 1e308, -0.0, 1e-308, 0.5, "", "x", "v", "t", CODE, "a\n\\input{/etc/passwd}",
    "\x1b[2J", [], {}, [[]], [None], ["v", "v"], {"x": 1}, [[[[]]]], "savgol:999999999999:3", "exp(exp(x))",
    "x" * 2000, "`", [1e308] * 3,
)  # fmt: skip


def make(kind: str, seed: int) -> Case:
    """Return the case of a kind and a seed, always the same."""
    return KINDS[kind](random.Random(f"{kind} {seed}"))


def text(r: random.Random) -> Case:
    """Text tables whose line ends, separators and quotes are mixed; half of them damaged."""
    head, rows = ["ball", "drop", "t", "height"], drops(r)
    separator = r.choice(",;\t")
    ends = r.choice([["\n"], ["\r\n"], ["\r"], ["\n", "\r\n", "\r"]])

    def cell(value: object) -> str:
        shown = str(value)
        return f'"{shown}"' if r.random() < 0.2 else shown

    lines = [separator.join(map(cell, row)) + r.choice(ends) for row in [head, *rows]]
    lines = [line + r.choice(ends) * (r.random() < 0.1) for line in lines]
    content = r.choice([b"", b"\xef\xbb\xbf"]) + "".join(lines).encode()
    command = r.choice([CHECK, (*EXPORT, "out.csv")])
    if r.random() < 0.5:
        return Case((*CHECK, "--json"), {"drops.csv": content}, samples=len(rows))
    return Case(command, {"drops.csv": damaged(r, content), **SCHEMA}, frozenset({"out.csv"}))


def parquet(r: random.Random) -> Case:
    """Parquet files with odd columns and odd words of themselves; half of them damaged, and some as they should be."""
    frame = pd.DataFrame(drops(r), columns=["ball", "drop", "t", "height"])
    if r.random() < 0.2:
        return Case((*CHECK, "--json"), {"drops.csv": frame.to_parquet()}, samples=len(frame))
    for name in r.sample(list(frame), r.randrange(3)):
        frame[name] = [r.choice([value, None, str(value)]) for value in frame[name].map(str)]
    roles = {name: r.choice([*WORDS, ["height"], None, 5, {}]) for name in ("time", "states", "properties", "trial")}
    roles = roles if r.random() < 0.5 else {"time": "t", "states": ["height"]}
    kept = r.choice([json.dumps({"roles": roles}).encode(), b"{", b"[" * 1000, b"\xff", b"{}"])
    written = io.BytesIO()
    pq.write_table(pa.Table.from_pandas(frame).replace_schema_metadata({b"commonlaw": kept}), written)
    content = written.getvalue()
    command = r.choice([CHECK, (*EXPORT, "out.csv")])
    return Case(command, {"drops.csv": half(r, content), **SCHEMA}, frozenset({"out.csv"}))


def workbook(r: random.Random) -> Case:
    """Workbooks with odd cells; half of them damaged, and some as they should be."""
    book, rows, whole = openpyxl.Workbook(), drops(r), r.random() < 0.2
    for row in [["ball", "drop", "t", "height"], *rows]:
        book.active.append(row)
    for _ in range(0 if whole else r.randrange(4)):
        value = r.choice([5, "text", True, "=1/0", "#N/A", 1e308, "a" * 1000])
        book.active.cell(r.choice([1, 2, 5, 70_000, 1_048_576]), r.choice([1, 3, 9, 16_384])).value = value
    written = io.BytesIO()
    book.save(written)
    if whole:
        return Case((*CHECK, "--json"), {"drops.csv": written.getvalue()}, samples=len(rows))
    return Case(CHECK, {"drops.csv": half(r, written.getvalue())})


def law(r: random.Random) -> Case:
    """Law files with values of wrong types, sizes and meanings, or damaged."""
    document = json.loads(saved_law())
    for _ in range(r.choice([0, 1, 1, 1, 2, 5])):
        change(r, document)
    content = json.dumps(document).encode()
    content = damaged(r, content) if r.random() < 0.3 else content
    shown = ("show", "law.json", *r.choice([(), ("--latex",), ("--average",), ("--history",), ("--select", "golf")]))
    given = ("predict", "drops.csv", "law.json", "--save", "out.csv")
    command = r.choice([shown, shown, given])
    return Case(command, {"law.json": content, "drops.csv": table(r)}, frozenset({"out.csv"}))


def expression(r: random.Random) -> Case:
    """Libraries and equations of random words, and such that would be run if they were code."""
    written = "".join(r.choices(TOKENS, k=r.randrange(1, 12))) if r.random() < 0.3 else formula(r, r.randrange(4))
    if r.random() < 0.4:
        left, begun = r.choice(["height' =", "height'' ="]), r.choice(["a + b", "-k", "a *", ""])
        return Case(("fit", "drops.csv", f"{left} {begun} {written}", *COLUMNS), {"drops.csv": table(r)})
    library = f"terms:1,{written}" if r.random() < 0.7 else written
    return Case(("discover", "drops.csv", *COLUMNS, "--library", library, *REGRESSION), {"drops.csv": table(r)})


def option(r: random.Random) -> Case:
    """Every command with options of every kind of value."""
    command = r.choice(["discover", "fit", "refine", "predict", "show", "check", "export", "list"])
    path = ["data", command] if command in ("check", "export", "list") else [command]
    found: Any = commonlaw
    for step in path:
        found = found.get_command(click.Context(found), step)
    given, targets = [*path], set()
    for parameter in found.params:
        if isinstance(parameter, click.Argument):
            usual = {"law_path": "law.json", "path": "drops.csv", "equations": "height' = a + b height"}
            if parameter.name in usual or r.random() < 0.1:
                given.append(r.choice(WORDS) if r.random() < 0.1 else usual.get(str(parameter.name), "drops.csv"))
    options = [param for param in found.params if isinstance(param, click.Option)]
    names = {name for param in options for name in param.opts}
    given += [word for role in zip(COLUMNS[::2], COLUMNS[1::2], strict=True) if role[0] in names for word in role]
    for each in r.sample(options, min(len(options), r.randrange(4))):
        given.append(r.choice([*each.opts, *each.secondary_opts]))
        if isinstance(each.type, WrittenFile):
            given.append(r.choice(TARGETS))
            targets.add(given[-1])
        elif not each.is_flag:
            given.append(r.choice(values(each) if r.random() < 0.8 else WORDS))
    return Case((*given,), {"drops.csv": table(r), "law.json": saved_law()}, frozenset(targets))


def values(option: click.Option) -> Sequence[str]:
    """Return values of the kind that an option takes, which need not be allowed."""
    if isinstance(option.type, click.Choice):
        return option.type.choices
    return WORDS if option.type.name in ("text", "file") else WORDS[:NUMBERS]


def name(r: random.Random) -> Case:
    """Objects, columns and files whose names terminals, LaTeX, browsers or file systems might obey."""
    odd = [word.replace("\n", r.choice(["\n", ""])) for word in r.sample(WORDS, 3)]
    renamed = {"golf": odd[0], "height": odd[1]} if r.random() < 0.7 else {"golf": odd[0]}

    def cell(value: object) -> str:
        return '"' + renamed.get(str(value), str(value)).replace('"', '""') + '"'

    rows = [["ball", "drop", "t", "height"], *drops(r)]
    content = "\n".join(",".join(map(cell, row)) for row in rows).encode(errors="surrogateescape")
    file = r.choice(["drops.csv", "日本.csv", "-drops.csv", "\x1b[2J.csv", "a b'\".csv", "\udcff.csv"])
    found = ("discover", "--order", "1", *REGRESSION, "--library", "poly:1", "--save", "out.json")
    command = r.choice([("data", "check"), ("data", "export", "--save", "out.csv"), found])
    given = (*command, "--schema", "roles.toml", "--", file)
    schema = b'object = "ball"\ntrial = "drop"\ntime = "t"\n'
    return Case(given, {file: content, "roles.toml": schema}, frozenset({"out.csv", "out.json"}))


KINDS: Mapping[str, Callable[[random.Random], Case]] = {
    "text": text,
    "parquet": parquet,
    "workbook": workbook,
    "law": law,
    "expression": expression,
    "option": option,
    "name": name,
    "restarts": table_cases.restarts,
    "indices": table_cases.indices,
    "dates": table_cases.dates,
    "wide": table_cases.wide,
    "packed": packed_cases.packed,
    "endless": packed_cases.endless,
    "shared": packed_cases.shared,
    "nested": packed_cases.nested,
    "repeated": command_cases.repeated,
    "inputs": command_cases.inputs,
    "provenance": lambda r: law_cases.provenance(r, saved_law()),
    "units": lambda r: law_cases.units(r, saved_law(), table(r)),
    "fits": equation_cases.fits,
    "comparisons": equation_cases.comparisons,
    "searches": equation_cases.searches,
    "checks": equation_cases.checks,
    "programs": equation_cases.programs,
    "statements": equation_cases.statements,
    "uses": lambda r: equation_cases.uses(r, saved_law(), table(r)),
}

COLUMNS = ("--object", "ball", "--trial", "drop", "--time", "t", "--state", "height")
REGRESSION = ("--set", "solver=group-stlsq:1", "--set", "differentiation=finite:2")
CHECK = ("data", "check", "drops.csv", *COLUMNS)
EXPORT = ("data", "export", "drops.csv", "--schema", "drops.toml", "--save")
SCHEMA = {"drops.toml": b'object = "ball"\ntrial = "drop"\ntime = "t"\nstates = ["height"]\n'}


def drops(r: random.Random) -> list[list[object]]:
    """Return rows of two balls, each dropped once."""
    count = r.choice([3, 5, 8, 30])
    return [
        [ball, 1, round(i / 15, 6), round(50 - 4.9 * (i / 15) ** 2 * drag + r.gauss(0, 0.01), 6)]
        for ball, drag in (("golf", 1.0), ("tennis", 0.8))
        for i in range(count)
    ]


def table(r: random.Random) -> bytes:
    """Return drops as CSV, with units or without."""
    head = ["ball", "drop", *r.choice([("t", "height"), ("t [s]", "height [m]")])]
    return "\n".join(",".join(map(str, row)) for row in [head, *drops(r)]).encode()


def saved_law() -> bytes:
    """Return a law of these balls with all that laws know."""
    return _discovered()


@cache
def _discovered() -> bytes:
    frame = pd.DataFrame(drops(random.Random(3)), columns=["ball", "drop", "t", "height"])
    units = {"t": "s", "height": "m"}
    trials = cl.Trials.from_frame(frame, object="ball", trial="drop", states=["height"], units=units)
    return to_json(cl.discover(trials, order=2, library="poly:1")).encode()


def formula(r: random.Random, depth: int) -> str:
    """Return a formula that is nearly always one of the language of terms."""
    if not depth:
        return r.choice(["height", "height", "t", "2", "1e9", "0.5", "`height`", "1e400", CODE, "v"])
    inner = formula(r, depth - 1)
    other = formula(r, r.randrange(depth))
    return r.choice(
        [f"{inner} * {other}", f"{inner}*{other}", f"({inner}+{other})", f"{inner}/{other}", f"({inner})**{other}"]
        + [f"{each}({inner})" for each in ("sin", "exp", "log", "sqrt", "abs", "tan", "eval")]
    )


def half(r: random.Random, content: bytes) -> bytes:
    """Return bytes as they are or damaged."""
    return damaged(r, content) if r.random() < 0.5 else content


def damaged(r: random.Random, content: bytes) -> bytes:
    """Return bytes of which some are changed, left out, repeated or put in."""
    found = bytearray(content)
    for _ in range(r.randrange(1, 5)):
        start = r.randrange(len(found) + 1)
        end = min(len(found), start + r.choice([0, 1, 1, 4, 50]))
        odd = r.choice(WORDS).encode(errors="surrogateescape")
        same = r.randbytes(end - start)
        found[start:end] = r.choice([b"", same, same, same, bytes(found[start:end]) * 3, odd, odd, odd, b'"', b"\n"])
    return bytes(found)


def change(r: random.Random, document: Any) -> None:
    """Put an odd value somewhere into a document of JSON, often of the same kind, or leave one out."""
    here, key = document, r.choice([*document][2:] if r.random() < 0.9 else [*document])
    while isinstance(here[key], dict | list) and here[key] and r.random() < 0.8:
        here = here[key]
        key = r.choice([*here] if isinstance(here, dict) else range(len(here)))
    if r.random() < 0.1:
        del here[key]
    else:
        same = [value for value in ODD_JSON if type(value) is type(here[key])]
        here[key] = deepcopy(r.choice(same if same and r.random() < 0.7 else ODD_JSON))


def folder(case: Case, at: Path) -> None:
    """Put the files of a case into an empty folder."""
    for each, content in {**case.others, **case.files}.items():
        (at / each).write_bytes(content)
    os.mkfifo(at / "pipe")
    (at / "link.csv").symlink_to("drops.csv")


def shown(case: Case) -> str:
    """Return the command of a case as a line, or its program."""
    return "; ".join(case.program) or " ".join(map(repr, ("commonlaw", *case.arguments)))
