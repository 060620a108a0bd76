"""Files of instruments from the command line: what is said of them first, and every command that reads them."""

import json

import numpy as np
import pytest

from tests.unit.tables import text, workbook

SECONDS = 600.0 * np.arange(12)
RATES = {"A1": 4e-4, "A2": 6e-4, "B1": 3e-4, "B2": 5e-4}


@pytest.fixture
def plate(tmp_path):
    random = np.random.default_rng(0)
    lines = ["," + ",".join(f"{t:.0f}s" for t in SECONDS), "," + ",".join(["37.0 °C", "37.1 °C"] * 6)]
    for well, rate in RATES.items():
        sizes = 0.05 * np.exp(rate * SECONDS) + 1e-4 * random.standard_normal(12)
        lines.append(f"{well}," + ",".join(f"{size:.5f}" for size in sizes))
    return text(tmp_path / "plate.csv", "\n".join([*lines, "", "Date of measurement: 2024-02-11"]))


@pytest.mark.usefixtures("plate")
def test_a_plate_is_fitted_and_its_law_saved_and_used(done):
    out = done("fit", "plate.csv", "N' = r N", "--save", "law.json")
    assert out.startswith("Read as a plate: 4 wells, 12 times in s\n")
    fitted = json.loads(done("fit", "plate.csv", "N' = r N", "--json"))["intervals"]
    for row in fitted:
        assert row["low"] < RATES[row["object"]] < row["high"]
    assert "A1" in done("predict", "plate.csv", "law.json")
    done("refine", "plate.csv", "law.json")
    assert done("data", "check", "plate.csv", "--save", "plate.toml").startswith("Read as a plate: ")
    assert done("fit", "plate.csv", "value' = r value", "--schema", "plate.toml").startswith("Read as a plate: ")


def test_a_sheet_is_chosen_by_an_option(done, tmp_path):
    noise = 0.01 * np.random.default_rng(0).standard_normal(12)
    rows = [[float(t), float(np.exp(-0.4 * t) + noise[t])] for t in range(12)]
    sheets = {"first": [["t", "a"], *([t, 1 - x] for t, x in rows)], "second": [["t", "b"], *rows]}
    workbook(tmp_path / "cups.xlsx", sheets)
    intervals = json.loads(done("fit", "cups.xlsx", "b' = -k b", "--sheet", "second", "--json"))["intervals"]
    assert intervals[0]["low"] <= 0.4 <= intervals[0]["high"]


def test_trials_below_each_other_are_told_apart_by_an_option(done, tmp_path):
    rows = [f"{t},{start * np.exp(-0.3 * t):.5f}" for start in (1, 2) for t in range(10)]
    text(tmp_path / "runs.csv", "t,x\n" + "\n".join(rows))
    assert "2 trials" in done("fit", "runs.csv", "x' = -k x", "--restarts", "trials")


def decay(rate, start=1.0):
    return start * np.exp(-rate * np.arange(12)) + 0.002 * np.random.default_rng(1).standard_normal(12)


LAYOUTS = {
    "blocks": (
        "\n\n".join("".join(f"{t} {x:.4f}\n" for t, x in enumerate(decay(k))) for k in (0.2, 0.4)),
        "x",
        "2 blocks of rows",
    ),
    "runs": (
        "time A,x A,time B,x B\n"
        + "".join(f"{t},{x:.4f},{t},{y:.4f}\n" for t, (x, y) in enumerate(zip(decay(0.2), decay(0.4), strict=True))),
        "x",
        "columns of 2 runs",
    ),
    "points": (
        "#multi:\n\tA\t\tB\t\nt\tx\ty\tx\ty\n"
        + "".join(f"{t}\t{decay(0.2)[t]:.4f}\t{5 - t}\t{decay(0.4)[t]:.4f}\t{7 - t}\n" for t in range(12)),
        "x",
        "2 points, A, B, each an object",
    ),
    "PEtab": (
        "observableId\tsimulationConditionId\tmeasurement\ttime\n"
        + "".join(f"x\tc{start}\t{x:.4f}\t{t}\n" for start in (1, 2) for t, x in enumerate(decay(0.3, start))),
        "x",
        "a long table: x in observableId",
    ),
}


@pytest.mark.parametrize("kind", LAYOUTS)
def test_other_layouts_are_fitted_and_forecast(done, tmp_path, kind):
    content, state, line = LAYOUTS[kind]
    text(tmp_path / "data.txt", content)
    assert done("fit", "data.txt", f"{state}' = -k {state}", "--save", "law.json").startswith(f"Read as {line}")
    assert f"{state}" in done("predict", "data.txt", "law.json")
    done("data", "check", "data.txt", "--save", "roles.toml")
    assert "2 trials" in done("discover", "data.txt", "--schema", "roles.toml", "--order", "1", "--library", "poly:1")
