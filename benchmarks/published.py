"""Write the tables of scores that the README and the documentation share, from the scores of the last whole run.

``python -m benchmarks.discovery --out FILE`` writes the scores of each problem; with that file their shares in
``benchmarks/scores.json`` are replaced first.
"""

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.discovery import LEVELS, ROOT, ROWS, Row, Score

SHARES = ROOT / "benchmarks" / "scores.json"
_COLUMNS = "Columns: standard deviation of the noise, relative to that of each state."
_EVERYWHERE, _MORE = ROOT / "docs" / "scores.md", ROOT / "docs" / "more-scores.md"

TABLES: Mapping[Path, Mapping[str, str]] = {
    _EVERYWHERE: {
        "grouped, every support right": "seven families of ten objects, two trials each",
        "chaotic, 1 trial, every support right": "41 chaotic systems, one trial",
    },
    _MORE: {
        "grouped, R2 > 0.9 from a fresh start": "grouped, R² > 0.9 from a new initial condition",
        "chaotic, 5 trials, every support right": "chaotic, five trials, every term right",
    },
}
"""The rows of each file, and their titles in it."""


def shares(scores: Sequence[Score]) -> dict[str, list[float]]:
    """Return for each row of the tables the share of problems at each level of noise.

    Raises `ValueError` if a row has no problem at a level, as after a run of a part.
    """
    found = dict[str, list[float]]()
    for row in ROWS:
        own = [score for score in scores if (score["bench"], score["trials"]) == (row.bench, row.trials)]
        values = [[each[row.measure] for each in own if each["noise"] == level] for level in LEVELS]
        if not all(values):
            raise ValueError(f"no scores at some level: {row.title}")
        found[row.title] = [round(float(np.mean(value)), 4) for value in values]
    return found


def table(titles: Mapping[str, str], known: Mapping[str, Sequence[float]]) -> str:
    """Return the Markdown table of rows with given titles and the baselines."""
    rows: dict[str, Row] = {each.title: each for each in ROWS}
    levels = " | ".join(f"{100 * level:g} %" for level in LEVELS)
    lines = [f"| problems, by noise | method | {levels} |", f"|---|---|{'---|' * len(LEVELS)}"]
    for name, title in titles.items():
        for first, who, values in ((title, "commonlaw", known[name]), ("", "baseline", rows[name].baseline)):
            lines.append(f"| {first} | {who} | {' | '.join(f'{value:.2f}' for value in values)} |")
    return "\n".join(lines) + "\n"


def published() -> dict[Path, str]:
    """Return the files with tables, the README among them, as they follow from the saved shares."""
    known = json.loads(SHARES.read_text())
    files = {path: table(titles, known) for path, titles in TABLES.items()}
    files[_EVERYWHERE] += f"\n{_COLUMNS}\n"
    readme = ROOT / "README.md"
    before = re.compile(r"\| problems, by noise .*?\n\n" + re.escape(f"{_COLUMNS}\n"), re.DOTALL)
    return files | {readme: before.sub(lambda _: files[_EVERYWHERE], readme.read_text())}


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the files, after scores of a run if they are given."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.published", description=__doc__)
    parser.add_argument("scores", nargs="?", type=Path, help="scores of each problem, from benchmarks.discovery --out")
    chosen = parser.parse_args(arguments)
    if chosen.scores:
        SHARES.write_text(json.dumps(shares(json.loads(chosen.scores.read_text())), indent=1) + "\n")
    for path, text in published().items():
        path.write_text(text)


if __name__ == "__main__":
    main()
