"""Hostile cases of laws beside trials: how a law says that it was made, and units that differ."""

import json
import random

from tests.hostile.case import Case

PIECES = (
    "open('executed', 'w')",
    "cl.discover(trials", "cl.fit('x', trials", "cl.refine(law, trials", "law.explain(", "law.discrepancy(trials",
    ")", ").law", ", order=2", ", library='poly:1'", ", method=cl.solvers.STLSQ(",
    ", method=cl.DerivativeRegression(", "\n",
    ";", "#", "'", '"', "\\", "*", "**", "lambda: ", ":=", "f'{", "}'", "[", "]", "{", "}", ",", " or ", " if 1 else ",
    "\x00", "\u2028", "\u202e", "\uff44", "-" * 5000, "(" * 300, "cl.Law.load('secret.csv')", "'secret.csv'", "0x",
    "1e999",
)  # fmt: skip
"""What recorded calls are made of."""

UNITS = ("m", "mm", "km", "ft", "s", "ms", "day", "kg", "degC", "K", "dB", "1", "%", "m/s", "cell", "", "m**", "q" * 99)


def recorded(r: random.Random) -> str:
    """Return what a stranger's law may say of how it was made."""
    begun = r.choice(["", "cl.discover(trials", "law.explain([]"])
    return begun + "".join(r.choices(PIECES, k=r.randrange(8))) + r.choice(["", ")"])


def provenance(r: random.Random, law: bytes) -> Case:
    """A law's file that says in hostile words how it was made."""
    document = json.loads(law)
    calls = [recorded(r) for _ in range(r.randrange(1, 4))]
    document["provenance"]["calls"] = [*calls, *document["provenance"]["calls"]][:: r.choice([1, -1])]
    return Case(("show", "law.json"), {"law.json": json.dumps(document).encode()})


def units(r: random.Random, law: bytes, rows: bytes) -> Case:
    """A law and a table whose units differ: forecast in the units of the law, or refused."""
    document = json.loads(law)
    document["schema"]["units"] = {name: r.choice(UNITS) for name in ("t", "height") if r.random() < 0.9}
    head = f"ball,drop,t [{r.choice(UNITS)}],height [{r.choice(UNITS)}]".encode()
    files = {"law.json": json.dumps(document).encode(), "drops.csv": head + b"\n" + rows.split(b"\n", 1)[1]}
    command = r.choice(
        [("predict", "--save", "out.csv"), ("refine", "--save", "out.json"), ("check",), ("discrepancy",)]
    )
    return Case((command[0], "drops.csv", "law.json", *command[1:]), files, frozenset({"out.csv", "out.json"}))
