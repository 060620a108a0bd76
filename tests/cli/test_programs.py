"""Programs of laws, from reports and from Python, run as they are."""

import html
import re

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import to_script
from commonlaw.law.script import Source

RATES = {"cup": 0.1, "mug": 0.2, "pot": 0.05}
TIMES = np.linspace(0.0, 20.0, 21)
QUICK = ("--order", "1", "--library", "poly:1")


def measured(rate, replicate):
    """Return temperatures of something that cools to 20 degrees."""
    noise = np.random.default_rng([round(100 * rate), replicate]).normal(0, 0.1, len(TIMES))
    return (20 + (60 + 5 * replicate) * np.exp(-rate * TIMES) + noise).round(3)


def long_table(roles):
    """Return a row for each sample, with these names of columns."""
    rows = [
        (name, run, t, temperature, rate)
        for name, rate in RATES.items()
        for run in (1, 2)
        for t, temperature in zip(TIMES, measured(rate, run), strict=True)
    ]
    return pd.DataFrame(rows, columns=roles)


def wide_table():
    return pd.DataFrame({"time [min]": TIMES, **{name: measured(rate, 1) for name, rate in RATES.items()}})


TABLES = {
    "guessed": (long_table(["vessel", "run", "t [min]", "T [degC]", "cooling"]), ()),
    "wide": (wide_table(), ("--wide", "T [degC]")),
    "sheet": (
        long_table(["A", "B", "C", "D", "E"]),
        (
            "--sheet",
            "second",
            "--object",
            "A",
            "--trial",
            "B",
            "--time",
            "C",
            "--state",
            "D",
            "--unit",
            "C=min",
            "--clip",
        ),
    ),
}
HELD_OUT = {
    "guessed": ("--hold-out", "run=2", "--exclude", "vessel=pot", "--set", "errors=white"),
    "sheet": ("--where", "A=cup,mug", "--learn-until", "12", "--set", "solver=group-stlsq:1"),
}


@pytest.fixture
def printed(tmp_path, monkeypatch, capsys):
    """Return what a program prints in the folder of the test."""
    monkeypatch.chdir(tmp_path)

    def run_here(program):
        capsys.readouterr()
        exec(compile(program, "program.py", "exec"), {"__name__": "__main__"})
        return capsys.readouterr().out

    return run_here


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("kind", [pytest.param("guessed", marks=pytest.mark.slow), "sheet"])
def test_the_program_of_a_report_prints_its_law_and_verdict(run, done, printed, tmp_path, kind):
    frame, roles = TABLES[kind]
    name = f"{kind}.xlsx" if kind == "sheet" else f"{kind}.csv"
    if kind == "sheet":
        with pd.ExcelWriter(tmp_path / name) as book:
            pd.DataFrame({"note": ["nothing"]}).to_excel(book, sheet_name="first", index=False)
            frame.to_excel(book, sheet_name="second", index=False)
    else:
        frame.to_csv(tmp_path / name, index=False)
    done("data", "check", name, *roles, "--save", "schema.toml")
    words = ("--schema", "schema.toml", *HELD_OUT[kind], *QUICK)
    code, _, err = run("discover", name, *words, "--save", "report.html", "--save", "law.json")
    assert code == 0, err
    page = (tmp_path / "report.html").read_text()
    (program,) = re.findall(r"<code[^>]*>(import commonlaw as cl\n.*?)</code>", page, flags=re.DOTALL)
    program = html.unescape(re.sub("<[^>]*>", "", program))
    out = printed(program)
    assert str(cl.Law.load(tmp_path / "law.json")) in out
    assert html.escape(out.splitlines()[-1], quote=False) in page


@pytest.mark.parametrize("kind", ["guessed", "wide"])
def test_the_program_of_a_fit_prints_its_law(printed, tmp_path, kind):
    path = tmp_path / "cups.csv"
    TABLES[kind][0].to_csv(path, index=False)
    trials = cl.Trials.read(path, wide="T [degC]" if kind == "wide" else None)
    law = cl.fit("T' = -k (T - a)", trials, errors="white")
    assert printed(to_script(law, "cups.csv")).startswith(str(law))
    half = cl.fit("T' = -k (T - a)", trials.until(10.0), errors="white")
    source = Source("cups.csv", training="measured.until(10.0)")
    assert printed(to_script(half, source)).startswith(str(half))
