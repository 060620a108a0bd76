"""What commands print and write."""

import re

import pytest

import commonlaw as cl
from commonlaw.cli.output import print_columns
from commonlaw.report import printing
from commonlaw.runtime import files


@pytest.mark.parametrize("paths", [["folder"], ["absent/law.json"], ["a" * 300], [""], ["s.svg", "folder/../s.svg"]])
def test_files_that_cannot_be_written_are_refused_before_work(fails, tmp_path, monkeypatch, paths):
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr(cl.Trials, "read", lambda *_, **__: pytest.fail("read"))
    err = fails("discover", "in.csv", *(word for path in paths for word in ("--save", path)))
    assert err.startswith(f"commonlaw: cannot write {paths[-1]}: ")


def test_a_table_that_is_wider_than_the_terminal_has_a_row_for_each_column_and_nothing_is_cut(capsys):
    names = [f"ball {i}" for i in range(20)]
    columns = {"object": names} | {f"coefficient {j}": [(100.0 * i + j, 0.5) for i in range(20)] for j in range(15)}
    print_columns(columns)
    wide = capsys.readouterr().out
    assert "\N{HORIZONTAL ELLIPSIS}" not in wide
    assert max(map(len, wide.splitlines())) <= 160
    heads = [line for line in wide.splitlines() if line.startswith(" object")]
    assert [part.strip() for line in heads for part in line.split("  ") if "ball" in part] == names
    assert sum(line.startswith(" coefficient 3 ") for line in wide.splitlines()) == len(heads) > 1
    assert "1903.00 \N{PLUS-MINUS SIGN} 0.50" in wide
    print_columns({name: columns[name] for name in ("object", "coefficient 1", "coefficient 2")})
    narrow = capsys.readouterr().out
    assert len(narrow.splitlines()) == 22
    print_columns({f"number {j}": [f"{j}{'x' * 17}"] for j in range(8)})  # Whose cells alone would be narrow enough
    assert f"7{'x' * 17}" in capsys.readouterr().out


@pytest.mark.usefixtures("browser")
def test_a_file_called_report_pdf_is_a_printed_report_and_others_are_figures(run, tmp_path):
    cl.datasets.linear_drag(drag=-0.3, trials=1, noise=0.05).to_csv(tmp_path / "drops.csv")
    words = ("fit", "drops.csv", "x'' = -g - c v", "--save", "my-report.pdf", "--save", "law.pdf")
    code, out, _ = run(*words)
    assert (code, out.splitlines()[-2:]) == (0, ["Wrote my-report.pdf", "Wrote law.pdf"])
    pages = [
        len(re.findall(rb"/Type */Page\b", (tmp_path / f"{name}.pdf").read_bytes())) for name in ("my-report", "law")
    ]
    assert pages[0] in range(2, 8)
    assert pages[1] == 1


def test_a_report_is_not_printed_without_a_browser(fails, monkeypatch):
    monkeypatch.setattr(printing, "_BROWSERS", ())
    assert "report-without-browser" in fails("discover", "absent.csv", "--save", "report.pdf")


@pytest.mark.slow
def test_a_table_becomes_a_page_that_opens_by_itself(run, tmp_path, check_page):
    cl.datasets.linear_drag(drag=-0.3, noise=0.05).to_csv(tmp_path / "drops.csv")
    arguments = ("drops.csv", "--order", 2, "--library", "poly:1", "--set", "errors=white", "--hold-out", "trial=2")
    code, out, err = run("discover", *arguments, "--save", "drops.html")
    assert "Note: columns recognized as time: t; object: object; trial: trial; state: x; prop" in err
    assert (code, out.splitlines()[-1]) == (0, "Wrote drops.html")
    page = (tmp_path / "drops.html").read_text()
    assert "commonlaw discover drops.csv --order 2" in page
    assert "held-out trials" in page
    check_page(tmp_path / "drops.html")


QUICK = ["--order", "2", "--library", "poly:1", "--set", "solver=group-stlsq:1.5"]


def fails(*_, **__):
    raise ZeroDivisionError("by accident")


@pytest.fixture
def table(tmp_path):
    """A table of drops, a law of them, and the same law without any uncertainty."""
    trials = cl.datasets.linear_drag(noise=0.01, seed=1)
    trials.to_csv(tmp_path / "drops.csv")
    method = cl.DerivativeRegression(solver="group-stlsq:1.5")
    cl.discover(trials, order=2, library="poly:1", method=method).save(tmp_path / "law.json")


@pytest.mark.parametrize(
    ("step", "options", "words"),
    [
        ("commonlaw.law.law.Law.explain", ["--explain"], "the coefficients were not explained"),
        ("commonlaw.verdict.find", [], "the law was not checked"),
        ("commonlaw.verdict.assess", [], "the forecast assessment failed"),
        ("commonlaw.law.law.Law.predict", [], "the law was not checked by forecasts"),
    ],
)
@pytest.mark.usefixtures("table")
def test_a_later_step_that_fails_does_not_cost_the_law(run, tmp_path, monkeypatch, step, options, words):
    monkeypatch.setattr(step, fails)
    code, out, err = run("discover", "drops.csv", *QUICK, *options, "--save", "found.json")
    assert (code, "x'' = a + b v" in out, "Wrote found.json" in out) == (0, True, True)
    assert f"Note: {words}: ZeroDivisionError: by accident\n" in err
    assert cl.Law.load(tmp_path / "found.json").support.sum() == 2


@pytest.mark.usefixtures("table")
def test_the_law_is_on_disk_before_the_next_step_begins(run, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        assert cl.Law.load(tmp_path / "found.json").support.sum() == 2
        raise SystemExit(130)

    monkeypatch.setattr("commonlaw.verdict.assess", interrupted)
    code, _, _ = run("discover", "drops.csv", *QUICK, "--save", "found.json")
    assert code == 130
    assert cl.Law.load(tmp_path / "found.json").support.sum() == 2


@pytest.mark.parametrize(
    ("words", "plot"),
    [(["check", "drops.csv", "law.json"], "plot_residuals"), (["predict", "drops.csv", "law.json"], "plot_forecast")],
)
@pytest.mark.usefixtures("table")
def test_a_figure_that_fails_does_not_cost_the_table(run, tmp_path, monkeypatch, words, plot):
    monkeypatch.setattr(f"commonlaw.plots.{plot}", fails)
    code, out, err = run(*words, "--save", "table.csv", "--save", "figure.svg")
    assert (code, "Wrote table.csv" in out) == (1, True)
    assert "commonlaw: figure.svg was not made: ZeroDivisionError" in err
    assert not (tmp_path / "figure.svg").exists()
    assert (tmp_path / "table.csv").stat().st_size > 100


@pytest.mark.usefixtures("table")
def test_a_law_that_cannot_be_written_is_printed_and_the_command_fails(run, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "_stage", full)
    code, out, err = run("discover", "drops.csv", *QUICK, "--save", "found.json")
    assert (code, "x'' = a + b v" in out, "Wrote" in out) == (1, True, False)
    assert "commonlaw: cannot write found.json: No space left on device" in err


@pytest.mark.usefixtures("table")
def test_a_program_of_several_objects_is_refused_once_with_the_option_that_chooses_one(run, tmp_path):
    code, _, err = run("discover", "drops.csv", *QUICK, "--save", "law.xml")
    first = cl.Trials.read(tmp_path / "drops.csv").objects[0]
    assert (code, err.count("law.xml was not made"), err.count(f"--where object='{first}'")) == (1, 1, 1)
    assert run("discover", "drops.csv", *QUICK, "--save", "law.xml", "--where", f"object={first}")[0] == 0


@pytest.mark.usefixtures("table")
def test_a_report_that_fails_prints_and_saves_the_law_that_was_found(run, tmp_path, monkeypatch):
    monkeypatch.setattr("commonlaw.report.law_report", fails)
    code, out, err = run("discover", "drops.csv", *QUICK, "--save", "found.json", "--save", "report.html")
    assert (code, "x'' = a + b v" in out) == (1, True)
    assert "commonlaw: report.html was not made: ZeroDivisionError: by accident" in err
    assert cl.Law.load(tmp_path / "found.json").support.sum() == 2
