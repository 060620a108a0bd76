"""What the page of the app is sent: numbers of a law and its candidates, and forecasts from a start of one's own."""

import json
import re
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from scipy.stats import t as student

import commonlaw as cl
from commonlaw.app.preview import Budget, Sample, preview, sample_table, simulated, suggested
from commonlaw.app.question import Columns, HoldOut, Question, Table, named
from commonlaw.app.result import figure_file, of_terms, results, support_of
from commonlaw.app.sessions import answer
from commonlaw.diagnostics import Diagnostic
from commonlaw.forecast import fitted
from commonlaw.law import to_script
from commonlaw.law.parameters import named_parameters
from commonlaw.law.script import Source
from commonlaw.report.markup import formula, law_latex
from commonlaw.text import r_squared
from tests.refusals import refused


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), noise=0.05, trials=1)


@pytest.fixture(scope="module")
def law(drops):
    masses = zip(drops.objects, [0.3, 0.1, 0.06], strict=True)
    return cl.fit("x'' = -g - c v", drops).explain({name: {"mass": mass} for name, mass in masses})


@pytest.fixture(scope="module")
def found(law, drops):
    """What the page is sent of a law that was fitted, which has no rivals."""
    (only,) = results(law, drops, drops, lambda _: None)
    return only


def test_the_law_comes_first_and_its_rivals_after_it(drops):
    law = cl.discover(drops, order=2, library="terms:1,v")
    made = list(results(law, drops, drops, lambda _: None))
    assert [candidate.law for candidate in made[0].candidates] == [made[0].law]
    np.testing.assert_array_equal(made[0].law.coefficients, law.coefficients)
    assert [len(each.candidates) for each in made] == list(range(1, len(made) + 1))
    assert len(made) > 2
    for before, after in pairwise(made):
        assert after.candidates[:-1] == before.candidates
        assert not after.shown["candidates"][-1]["chosen"]


def test_the_nearest_textbook_law_follows_the_verdict(drops):
    law = cl.discover(drops, order=2, library="terms:1,v")
    first = next(results(law, drops, drops, lambda _: None))
    assert first.shown["verdict"][-1] == str(law.textbook(drops))
    figures = first.shown["candidates"][0]["figures"]
    assert "textbook" in [figure["name"] for figure in figures]
    assert b"<svg" in figure_file("textbook.svg", first, Source("drops.csv"))


def test_curves_and_coefficients_are_those_of_the_law(found, law, drops):
    shown = json.loads(msgspec.json.encode(found.shown))
    (candidate,) = shown["candidates"]
    curves = fitted(law, drops, return_std=True), law.predict(drops, start=10, return_std=True)
    assert [each["title"] for each in shown["views"]] == ["fit", "forecast from the first 10 samples"]
    for view, expected in zip(candidate["views"], curves, strict=True):
        assert r_squared(expected.score()) in view["score"]
        for trial, trajectory, curve in zip(drops, expected.trajectories, view["curves"], strict=True):
            measured, line, low, high = (np.array(each, dtype=float) for each in curve["states"][0])
            there = np.isfinite(measured)
            np.testing.assert_allclose(np.array(curve["t"])[there], trial.times, rtol=1e-4)
            np.testing.assert_allclose(measured[there], trial.states[:, 0], rtol=1e-4)
            np.testing.assert_allclose(line[there], trajectory.states[:, 0], rtol=1e-4)
            assert ((low < line) & (line < high)).all()
    assert [row[0] for row in candidate["table"]["rows"]] == list(drops.objects)
    assert candidate["table"]["head"] == ["object", "g (m/s²)", "c (1/s)", "RMS residual of x (m)"]
    assert shown["follows"] == ["mass"]


def test_an_object_of_ones_own_falls_as_its_mass_says(found, drops):
    course = simulated(found, Sample(0, "stone", (50.0, 0.0), 2.0, {"mass": 0.1}))
    twin = simulated(found, Sample(0, drops.objects[1], (50.0, 0.0), 2.0))
    np.testing.assert_allclose(course["states"][0]["line"], twin["states"][0]["line"], rtol=0.01)
    for wrong, words in (
        (Sample(7, "stone", (50.0, 0.0), 2.0), Diagnostic("candidate-index", {"index": 7})),
        (Sample(0, "stone", (50.0, 0.0), 2.0), Diagnostic("unknown-name", {"name": "stone"})),
        (Sample(0, drops.objects[0], (50.0,), 2.0), Diagnostic("start-size", {"expected": 2})),
        (Sample(0, drops.objects[0], (50.0, float("nan")), 2.0), "forecast-settings"),
    ):
        with refused(words):
            simulated(found, wrong)


def test_bands_of_a_forecast_of_ones_own_are_as_wide_as_drawn_coefficients_and_noise_scatter(found, law, drops):
    course = simulated(found, Sample(0, drops.objects[0], (50.0, 0.0), 2.0))
    line, low, high = (np.array(course["states"][0][each]) for each in ("line", "low", "high"))
    drawn = law.sample(4000, seed=1).xs(drops.objects[0], level="object")
    g, c, t = drawn["g"].to_numpy(), drawn["c"].to_numpy(), course["t"][-1]
    ends = 50.0 - g / c * (t - (1 - np.exp(-c * t)) / c)
    std = np.hypot(ends.std(), law.uncertainty.noise[0])
    assert line[-1] == pytest.approx(ends.mean(), abs=0.1 * std)
    assert high[-1] - low[-1] == pytest.approx(2 * 1.96 * std, rel=0.05)
    width = student.ppf(0.975, law.uncertainty.degrees_of_freedom[0])  # As the noise itself is estimated
    assert high[0] - low[0] == pytest.approx(2 * width * law.uncertainty.noise[0], rel=0.01)  # The start is certain


def test_equations_are_cut_where_a_line_may_break_and_lose_nothing(found, law):
    (candidate,) = found.shown["candidates"]
    (parts,) = candidate["formula"]
    texts = [re.sub("<[^>]*>", "", part).strip() for part in parts]
    assert len(texts) == 2
    assert texts[0].startswith("x")
    assert texts[1][0] in "-+\N{MINUS SIGN}"
    whole = re.sub("<[^>]*>", "", formula(law_latex(law)))
    assert "".join(texts).replace(" ", "") == whole.replace(" ", "")


def test_a_law_of_other_terms_is_shown_after_the_candidates(found, law):
    after = found.with_laws(of_terms(found, support_of(law, [["1"]]), lambda _: None))
    first, other = after.shown["candidates"]
    assert first is found.shown["candidates"][0]
    assert (other["terms"], other["own"], other["chosen"]) == ([["1"]], True, False)
    assert [each["score"] for each in other["views"]] != [each["score"] for each in first["views"]]
    taken = after.of_candidate(1)
    assert taken.law.structure == ("x'' = a",)
    curves = taken.findings.fit, taken.findings.forecast
    assert all(r_squared(curve.score()) in each["score"] for curve, each in zip(curves, other["views"], strict=True))
    assert after.of_candidate(0) is after
    for terms, words in (
        ([], Diagnostic("equation-count", {"equations": 1})),
        ([["w"]], Diagnostic("unknown-name", {"kind": "term", "name": "w"})),
    ):
        with refused(words):
            support_of(law, terms)


def test_columns_are_recognised_and_can_be_named():
    table = sample_table("linear-drag")
    assert preview(table, Columns())["roles"]["states"] == ("x",)
    renamed = Table("t.csv", b"who,then,a,b\n" + b"".join(b"p,%d,%d,%d\n" % (i, i * i, -i) for i in range(8)))
    assert "which column holds the time" in preview(renamed, Columns())["problem"]
    seen = preview(renamed, Columns(object="who", time="then", states=("a",), inputs=("b",)))
    assert (seen["roles"]["states"], seen["roles"]["inputs"], seen["objects"]) == (("a",), ("b",), ("p",))


SAMPLES = b"Sample;Run;Time (h);OD600;Note\n" + b"".join(
    b"%s;%d;%d;0,%d;\n" % (sample, run, hour, 100 + 10 * hour * run)
    for sample in (b"a", b"b")
    for run in (1, 2)
    for hour in range(5)
)


def test_roles_that_are_clear_are_shown_with_the_problem_and_stay_when_others_are_chosen():
    table = Table("plate.csv", SAMPLES)
    seen = preview(table, Columns(object="", trial="Run", time="Time", states=("OD600",)))
    assert "(such as 'Sample')" in seen["problem"]
    shown = seen["recognised"]
    assert (shown["object"], shown["trial"], shown["time"], shown["states"]) == (None, "Run", "Time", ("OD600",))
    for columns in (Columns(), Columns(object="Sample", trial="Run", time="Time", states=("OD600",))):
        seen = preview(table, columns)
        assert (seen["problem"], seen["objects"], seen["count"]) == ("", ("a", "b"), 4)
        assert bool(seen["guessed"]) == (columns == Columns())


def test_a_plate_is_read_long_where_this_is_asked_and_so_does_the_program():
    rows = "".join(f"{i},{0.1 * 1.2**i},{0.1 * 1.3**i},{0.1 * 1.4**i},{0.1 * 1.5**i}\n" for i in range(9))
    table = Table("plate.csv", f"time [h],A1,A2,B1,B2\n{rows}".encode())
    seen = preview(table, Columns())
    assert (seen["problem"], seen["recognised"]["wide"], seen["roles"]["states"]) == ("", "value", ("value",))
    assert seen["recognised"]["states"] == seen["objects"] == ("A1", "A2", "B1", "B2")
    columns = Columns(wide="OD [OD]", states=("A1", "B2"))
    assert preview(table, columns)["objects"] == ("A1", "B2")
    source = Question("plate", columns).source(table)
    assert source.reading == {"wide": "OD [OD]", "restarts": None}


def test_what_is_odd_comes_with_the_rows_of_the_file_and_the_cell_that_is_meant():
    rows = [
        f"b{each},{i},{(each + 1) * i * i if (each, i) != (2, 6) else 999},{i}" for each in range(8) for i in range(9)
    ]
    rows[20], rows[26] = rows[26], rows[20]  # Times of an object need not be in order
    rows[40] = "b4,4,,4"
    seen = preview(Table("t.csv", "\n\n".join(["object,t [s],x [m],y [m]", *rows, "c,0,1,1"]).encode()), Columns())
    jump, missing, short = (each for each in seen["checks"] if each["cases"][0]["rows"])
    (case,) = jump["cases"]
    assert (
        case["text"] == "b2, trial 1: x jumps by 924 m from sample 6 to sample 7: 999 m at t = 6 s may be a stray value"
    )
    assert case["rows"][case["row"]] == [51, "b2", "6", "999", "6"]
    assert [row[0] for row in case["rows"]] == [45, 47, 49, 51, 53, 43]
    (case,) = missing["cases"]
    assert (case["rows"][case["row"]], case["column"]) == ([83, "b4", "4", "", "4"], "x")
    assert (short["text"], short["cases"][0]["rows"]) == (
        "c, trial 1: very short, 1 samples",
        [[147, "c", "0", "1", "1"]],
    )


def test_of_many_cases_some_are_shown_in_the_words_of_the_page():
    rows = [f"b{each},{i},{i * i}" for each in range(40) for i in range(3)]
    seen = preview(Table("t.csv", "\n".join(["object,t,x", *rows]).encode()), Columns())
    short, units = seen["checks"]
    assert (short["text"], short["count"]) == ("in 40 cases, such as b0, trial 1: very short, 3 samples", 40)
    assert len(short["cases"]) == 12
    assert units["text"].startswith("no unit is known for t, x: write it in the header, as in 'x [m]', or ")


def test_what_is_held_out_is_not_learned_from(drops):
    assert HoldOut("object", drops.objects[0]).training(drops).objects == drops.objects[1:]
    assert max(trial.times[-1] for trial in HoldOut("after", "0.7").training(drops)) <= 1.5
    with refused("hold-out-time"):
        HoldOut("after", "noon").training(drops)


def test_of_a_name_only_the_last_part_is_taken():
    assert [named(each, b"").name for each in ("../../a.csv", r"C:\x\b.csv", "")] == ["a.csv", "b.csv", "table"]


@pytest.mark.parametrize(
    "asked",
    [
        pytest.param({"hold_out": HoldOut("object", "Ball 2")}, marks=pytest.mark.slow),
        {"hold_out": HoldOut("after", "0.7"), "settings": {"errors": ["white"]}},
        {"known": {"1": -9.8}, "columns": Columns(states=("x",), properties=("mass",)), "explain": True},
    ],
)
def test_the_program_finds_the_law_again_that_the_app_found(asked, drops, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frame = drops.until(1.0).to_frame()
    frame["mass"] = frame["object"].map(dict(zip(drops.objects, [0.3, 0.1, 0.06], strict=True)))
    table = Table("drops.csv", frame.to_csv(index=False).encode())
    (tmp_path / table.name).write_bytes(table.content)
    check_program(Question("", order=2, library="terms:1,v", **asked), table)


def test_the_program_of_a_data_set_finds_its_law_again_without_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    question = Question("", order=2, library="terms:1,v", hold_out=HoldOut("trial", "2"))
    check_program(question, sample_table("linear-drag"))


def check_program(question, table):
    """Check that the program of a question makes the law that a search finds, and judges it as the page does."""
    made = next(answer(question, table, None, lambda _: None))
    scope = {}
    exec(to_script(made.law, question.source(table)), scope)
    assert scope["law"].terms.names == made.law.terms.names
    np.testing.assert_array_equal(scope["law"].coefficients, made.law.coefficients)
    assert (scope["law"].uncertainty.explanation is None) == (made.law.uncertainty.explanation is None)
    assert [*scope["law"].assess(scope.get("measured", scope["trials"]), scope["trials"]).sentences] == [
        *made.findings.sentences
    ]


def test_experiments_are_suggested_for_a_budget(found):
    made = suggested(found, Budget(2))["suggestions"]
    assert made[0]["purpose"] == "To know all coefficients better"
    assert all(len(each["experiments"]) == each["trials"] == 2 for each in made)
    assert all(each["settles"] for each in made)
    with refused("design-budget", trials=9, limit=6):
        suggested(found, Budget(9))


def test_numbers_stand_beside_the_formula_with_the_ends_of_their_intervals(found, law):
    table = found.candidates[0].shown["table"]
    low, high = named_parameters(law).intervals()
    for row, *ends in zip(table["rows"], low, high, strict=True):
        shown = [[float(each) for each in cell.split("\n")[1].split(" to ")] for cell in row[1:3]]
        np.testing.assert_allclose(np.transpose(shown), ends, rtol=0.02)


def test_quantities_stand_below_the_coefficients_with_their_intervals():
    times = np.linspace(0, 12, 40)
    sizes = [1 / (1 + 19 * np.exp(-rate * times)) for rate in (0.6, 0.9)]
    noisy = np.array(sizes) + 0.01 * np.random.default_rng(0).standard_normal((2, 40))
    trials = cl.Trials.from_arrays([times] * 2, list(noisy), object=["A", "B"], names=["n"])
    law = cl.fit("n' = r n (1 - n/K)", trials)
    table = next(results(law, trials, trials, lambda _: None)).candidates[0].shown["quantities"]
    assert [row[0] for row in table["rows"]] == ["A", "B"]
    column = table["head"].index("carrying capacity K")
    expected = law.quantities().set_index(["quantity", "object"]).loc["carrying capacity"]
    for name, *cells in table["rows"]:
        value, interval = cells[column - 1].split("\n")
        assert float(value.split(" ± ")[0]) == pytest.approx(expected.loc[name, "estimate"], rel=0.01)
        ends = [float(each) for each in interval.split(" to ")]
        np.testing.assert_allclose(ends, expected.loc[name, ["low", "high"]].astype(float), rtol=0.01)
    plain = cl.fit("n'' = a + b v + c n v", trials)
    assert not next(results(plain, trials, trials, lambda _: None)).candidates[0].shown["quantities"]["rows"]
