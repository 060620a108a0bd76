"""Files of instruments in the app, which reads them as programs and commands do."""

import numpy as np
import pytest

from commonlaw.app.preview import preview
from commonlaw.app.question import Columns, named

TIMES = np.arange(12) * 0.25
PLATE = ["," + ",".join(f"{600 * i}s" for i in range(12))]
PLATE += [f"{well}," + ",".join(f"{rate**i:.4f}" for i in range(12)) for well, rate in (("A1", 2), ("B1", 3))]
BLOCKS = [f"Cup {c}\nt,T\n" + "".join(f"{t},{k + t**k:.3f}\n" for t in TIMES) for k, c in ((1, "A"), (2, "B"))]
LONG = [f"{s},{t},{a},{k + t:.3f}" for s in "ab" for k, a in enumerate("xy", 1) for t in TIMES]
FILES = {
    "plate": ("\n".join(PLATE), ("A1", "B1")),
    "blocks": ("\n".join(BLOCKS), ("Cup A", "Cup B")),
    "long": ("\n".join(["subject,time,analyte,conc", *LONG]), ("a", "b")),
}


@pytest.mark.parametrize("kind", FILES)
def test_a_file_is_previewed_as_it_is_read(kind):
    content, objects = FILES[kind]
    shown = preview(named("file.csv", content.encode()), Columns())
    assert shown["problem"] == ""
    assert shown["objects"] == objects
    assert any(note.startswith("read as ") for note in shown["notes"])


def test_pairs_are_refused_with_what_decides_and_read_so():
    rows = "".join(f"{t},{t + 1:.3f},{t},{t**2:.3f}\n" for t in TIMES)
    table = named("pairs.csv", f"t,WT,t,mut\n{rows}".encode())
    assert "[pairs-ambiguous]" in preview(table, Columns())["problem"]
    assert preview(table, Columns(wide="OD"))["objects"] == ("WT", "mut")
