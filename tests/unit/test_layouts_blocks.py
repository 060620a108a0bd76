"""Blocks of rows below each other: behind blank rows, titles, comments, or the header again."""

import pytest

from commonlaw.trials import Trials
from tests.unit.tables import text, workbook

RUNS = {"Cup A": [80.0, 72.0, 65.0], "Cup B": [78.0, 60.5, 51.0], "Cup C": [90.0, 81.0, 73.0]}
TIMES = [0, 5, 10]
HEADER = "time [min],T [°C]\n"
BODIES = ["".join(f"{t},{x}\n" for t, x in zip(TIMES, values, strict=True)) for values in RUNS.values()]
NUMBERS, TITLES = ("1", "2", "3"), tuple(RUNS)


def titled(before, after=""):
    return "\n".join(f"{before}{name}{after}\n{body}" for name, body in zip(RUNS, BODIES, strict=True))


BLOCKS = {
    "blank rows": (HEADER + "\n".join(BODIES), NUMBERS),
    "two blank rows": (HEADER + "\n\n".join(BODIES), NUMBERS),
    "the header again": (HEADER + HEADER.join(BODIES), NUMBERS),
    "the header behind blank rows": ("\n".join(HEADER + body for body in BODIES), NUMBERS),
    "header and units again": ("\n".join("time,T\nmin,°C\n" + body for body in BODIES), NUMBERS),
    "a comment as header": ("# " + HEADER + "\n\n".join(BODIES), NUMBERS),
    "titles": (titled("", f"\n{HEADER}".rstrip("\n")), TITLES),
    "titles and empty cells": (titled("", f",\n{HEADER}".rstrip("\n")), TITLES),
    "comments and a header": (HEADER + titled("# "), TITLES),
    "a title of all": ("Cups\nby Anna\n" + HEADER + "\n".join(BODIES) + "\nEnd\n", NUMBERS),
}


@pytest.mark.parametrize("kind", BLOCKS)
def test_each_block_is_an_object_named_by_its_title(tmp_path, kind):
    content, names = BLOCKS[kind]
    trials = Trials.read(text(tmp_path / "cups.csv", content))
    assert trials.objects == names
    assert [trial.states[:, 0].tolist() for trial in trials] == [*RUNS.values()]
    assert [trial.times.tolist() for trial in trials] == [TIMES] * 3
    assert trials.schema.units == {"time": "min", "T": "°C"}
    assert any(note.startswith("read as 3 blocks") for note in trials.notes)
    for roles in ({"restarts": "trials"}, {"object": "", "trial": "block"}):
        one = Trials.read(tmp_path / "cups.csv", **roles)
        assert (len(one), one.objects) == (3, ("cups",))


def test_blocks_without_any_header_are_told_apart_by_comments(tmp_path):
    content = titled("# ").replace(",", " ")
    assert Trials.read(text(tmp_path / "cups.dat", content)).objects == TITLES


def test_a_sheet_with_blocks_is_read_like_a_text(tmp_path):
    rows = []
    for name, values in RUNS.items():
        rows += [[name], ["time [min]", "T [°C]"], *map(list, zip(TIMES, values, strict=True)), []]
    trials = Trials.read(workbook(tmp_path / "cups.xlsx", {"all": rows, "Info": [["by", "Anna"]]}))
    assert trials.objects == TITLES
    assert trials[1].states[:, 0].tolist() == RUNS["Cup B"]


def test_titles_with_numbers_name_trials(tmp_path):
    bodies = zip(["golf 1", "golf 2", "tennis 1"], BODIES, strict=True)
    trials = Trials.read(text(tmp_path / "balls.csv", HEADER + "\n".join(f"# {name}\n{body}" for name, body in bodies)))
    assert [trial.label for trial in trials] == ["golf, trial 1", "golf, trial 2", "tennis, trial 1"]
    content = titled("").replace("Cup A", "run 1").replace("Cup B", "run 2").replace("Cup C", "run 3")
    trials = Trials.read(text(tmp_path / "runs.csv", "time,T\n" + content))
    assert ([trial.name for trial in trials], trials.objects) == (["1", "2", "3"], ("run",))


def test_points_of_tracker_below_each_other_are_objects(tmp_path):
    rows = {
        name: "".join(f"{0.1 * i:.1f}\t{i * (0.3 + i / speed):.3f}\t{(i - speed) ** 2:.3f}\n" for i in range(6))
        for name, speed in (("A", 2.5), ("B", 4.2))
    }
    tracks = [f"mass {name}\nt\tx\ty\n{body}" for name, body in rows.items()]
    trials = Trials.read(text(tmp_path / "pucks.txt", "\n".join(tracks)))
    assert (trials.objects, trials.schema.states) == (("mass A", "mass B"), ("x", "y"))


def test_blank_rows_and_remarks_within_a_record_do_not_end_it(tmp_path):
    rows = [f"{t},{x}" for t, x in zip(range(9), [9, 8, 7.5, 7, 6, 5.5, 5.1, 4.8, 4.6], strict=True)]
    pauses = "\n\n".join("\n".join(rows[i : i + 3]) for i in (0, 3, 6))
    remarks = "\n# stirred\n".join("\n".join(rows[i : i + 3]) for i in (0, 3, 6))
    again = "\nt,x\n".join("\n".join(rows[i : i + 3]) for i in (0, 3, 6))
    for content in (pauses, remarks, again):
        trials = Trials.read(text(tmp_path / "cup.csv", f"t,x\n{content}\n"))
        assert (len(trials), trials.objects) == (1, ("cup",))
        assert trials[0].times.tolist() == [*range(9)]


def test_blocks_that_a_column_names_keep_these_names(tmp_path):
    content = "\n".join("".join(f"{name},{t},{x}\n" for t, x in zip(TIMES, RUNS[name], strict=True)) for name in RUNS)
    for blocks in (content, content.replace("\n\n", "\ncup,t,T\n")):
        assert Trials.read(text(tmp_path / "cups.csv", f"cup,t,T\n{blocks}")).objects == TITLES
