"""The report of a law: all its parts, on data whose law is known, unknown and hopeless."""

import re
from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.experiments.design import usual
from commonlaw.law import Provenance, to_latex
from commonlaw.law.parameters import named_parameters
from commonlaw.report import law_report
from commonlaw.report.document import Fold, Gallery, Picture, Table, Text
from commonlaw.report.markup import formula, law_latex
from commonlaw.report.sections import coefficients, forecasts, residuals
from commonlaw.summary import Summary
from commonlaw.verdict import find

SECTIONS = [
    "fit", "coefficients", "forecasts", "candidates", "residuals", "ranges", "experiments", "data-checks", "choices",
    "methods", "again",
]  # fmt: skip


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=2, noise=0.05)


@pytest.fixture(scope="module")
def law(drops):
    return cl.discover(drops.select(trial=1), order=2, library="poly:1")


@pytest.fixture(scope="module")
def report(law, drops):
    return law_report(find(law, drops, drops.select(trial=1)), "commonlaw report drops.csv", "drops.csv")


def blocks_of(report, name):
    return next(section.blocks for section in report.sections if section.name == name)


def table_of(report, name):
    return next(each.frame for each in report.named_blocks() if isinstance(each, Table) and each.name == name)


def test_the_report_has_its_parts_in_order_and_says_what_the_verdict_says(report, law, drops):
    assert [section.name for section in report.sections] == SECTIONS
    verdict = law.assess(drops, drops.select(trial=1))
    assert verdict.usable
    words = re.sub(r"\\(.)", r"\1", report.summary + report.blocks[-1].text)
    assert all(sentence in words for sentence in verdict.sentences)
    assert r"\ddot{x} &= a + b\, v" in report.summary
    texts = [block.text for part in (report, *report.sections) for block in part.blocks if isinstance(block, Text)]
    page = re.sub(r"\\(.)", r"\1", "\n".join([report.summary, *texts]))
    assert "commonlaw report drops.csv" in page
    assert "4 trials of 2 objects, 196 samples; training data: 2 trials, 98 samples." in page
    assert "Forecasts of 2 held-out trials from the first 10 samples" in page
    assert "Tested on held-out trials" in page
    assert "'drops.csv'" in page or '"drops.csv"' in page


def test_tables_hold_the_numbers_of_the_law(report, law, drops):
    learned, held_out = drops.select(trial=1), drops.select(trial=2)
    shown, parameters = table_of(report, "values"), law.params.query("term == '1'")
    columns = ["estimate", "standard error", "low", "high"]
    for cell, numbers in zip(shown["a (m/s²)"], parameters[columns].to_numpy(), strict=True):
        found = [float(text) for text in re.split(" ± | to |\n", cell)]
        np.testing.assert_allclose(found, numbers, atol=0.06 * numbers[1])
    sizes = table_of(report, "sizes")
    assert {*sizes["terms"]} == {1, 2, 3}
    assert sizes["terms"].is_monotonic_increasing
    assert sizes.loc[sizes[""] == "*", "terms"].item() == 2
    score = law.predict(held_out, start=10).score()
    assert sizes.loc[sizes[""] == "*", "1 − R² of forecasts"].item() == pytest.approx(1 - score)
    visited = table_of(report, "visited").set_index("")
    heights = np.concatenate([trial.states for trial in learned])
    assert visited.loc["x", ["from", "to"]].tolist() == [heights.min(), heights.max()]
    assert visited.loc["v", "unit"] == "m/s"
    assert visited.loc["trial duration"].tolist() == [3.2, 3.2, "s"]
    fit, forecast = table_of(report, "fit-by-state"), table_of(report, "forecast-by-state")
    residuals = law.residuals(learned).to_frame()["x residual/noise"] * law.uncertainty.noise[0]
    assert fit["RMS residual"].item() == pytest.approx(np.sqrt(np.mean(residuals**2)))
    tolerance = 1e-8 * heights.max()  # Of both integrations, relative to the states
    assert fit["mean residual"].item() == pytest.approx(np.mean(residuals), abs=tolerance)
    frame = law.predict(held_out, start=10).to_frame()
    assert forecast["RMS error"].item() == pytest.approx(np.sqrt(np.mean(frame["x error"] ** 2)))


def test_the_residuals_of_the_first_state_are_shown_and_others_folded():
    trials = cl.datasets.lotka_volterra(growth=(1.0,), trials=1, samples=60, noise=0.1)
    law = cl.fit("x' = a x - b x y; y' = -c y + d x y", trials, errors="white", noise={"x": 0.1, "y": 0.1})
    shown = [*residuals(Summary(find(law, trials)))]
    (gallery,) = [each for each in shown if isinstance(each, Gallery)]
    (fold,) = [each for each in shown if isinstance(each, Fold) and each.title == "Residuals of y"]
    assert [len(each.pictures) for each in (gallery, *fold.blocks)] == [6, 6]
    assert "Against y" in gallery.pictures[2].caption
    axes = gallery.pictures[2].draw().axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("y", "residual / noise")


def test_of_many_objects_some_from_the_best_to_the_worst_are_shown_and_the_others_folded(law, drops):
    first = [drop for drop in drops if drop.name == "1"]
    off = np.linspace(0, 3, 8)
    copies = [
        replace(
            trial,
            object=f"ball {2 * i + j}",
            states=trial.states + bend * np.maximum(trial.times[:, None] - 1.5, 0) ** 2,
        )
        for i, bend in enumerate(off)
        for j, trial in enumerate(first)
    ]
    some = np.tile([0, 1], len(off))
    many = replace(
        law,
        objects=tuple(copy.object for copy in copies),
        coefficients=law.coefficients[some],
        uncertainty=replace(
            law.uncertainty,
            covariance=law.uncertainty.covariance[some],
            shared_factor=None,
            unpooled=None,
            pooled=None,
            other_laws=(),
        ),
        properties={},
    )
    trials = replace(drops, trials=tuple(copies), properties={})
    case = Summary(find(many, trials))
    blocks = [*forecasts(case)]
    picture, rest = (next(block for block in blocks if isinstance(block, kind)) for kind in (Picture, Fold))
    shown = {axes.get_title() for axes in picture.draw().axes} - {""}
    assert len(shown) == 12
    assert {"ball 0", "ball 15"} & shown
    missed = [float(each) for each in re.findall(r" ([\d.]+) m", picture.caption)]
    assert len(missed) == 2
    assert missed[0] < missed[1]
    others = {axes.get_title() for block in rest.blocks for axes in block.draw().axes} - {""}
    assert shown | others == set(trials.objects)
    assert len(others) == 16 - 12


def test_a_hopeless_law_is_called_so_and_what_ran_away_is_said(drops):
    runaway = cl.Law.from_text("x'' = a v^3", {"a": 5.0})
    trials = cl.Trials.from_arrays(drops[0].times, drops[0].states[:, 0], names=["x"])
    report = law_report(find(runaway, trials))
    assert report.summary.startswith("**Do not use this law for forecasts")
    assert "diverge" in str(blocks_of(report, "forecasts")[0])
    assert "diverged after" in table_of(report, "forecast-errors")
    assert "Their standard errors are unknown" in str(blocks_of(report, "coefficients"))


def test_names_cannot_write_into_the_page():
    name, times = "<script>alert(1)</script> *b* $x$ `c`", np.arange(20.0)
    trials = cl.Trials.from_arrays(times, np.exp(-0.5 * times), object=name, names=["x"])
    page = cl.Law.from_text("x' = -k x", {"k": {name: 0.5}}).report(trials).html
    assert "<script" not in page
    assert "*b* $x$ `c`" in page


def test_a_law_that_was_explained_shows_its_relations():
    drops = cl.datasets.linear_drag(trials=1, noise=0.02)
    explained = cl.fit("x'' = -g - c v", drops, errors="white").explain([])
    report = law_report(find(explained, drops))
    assert table_of(report, "relations")["kind"].tolist() == ["universal", "own"]
    assert "\\ddot{x}" in report.summary
    assert table_of(report, "values").columns[1] == "g (m/s²)"
    intervals = next(each for each in report.named_blocks() if each.name == "intervals")
    assert [panel.get_xlabel() for panel in intervals.draw().axes] == ["(m/s²)", "(1/s)"]


def test_the_phase_plane_is_shown_of_laws_that_have_one(report):
    (plane,) = [each for each in report.named_blocks() if each.name == "phase-plane"]
    assert [(each.get_title(), each.get_ylabel()) for each in plane.draw().axes] == [
        ("Ball 1", "$v$ (m/s)"),
        ("Ball 2", ""),
    ]
    one = cl.Law.from_text("x' = -k x", {"k": 0.5})
    trials = cl.Trials.from_arrays(np.arange(20.0), np.exp(-0.5 * np.arange(20.0)), names=["x"])
    assert "phase-plane" not in [getattr(each, "name", "") for each in coefficients(Summary(find(one, trials)))]


def test_experiments_start_where_the_only_trial_did():
    law, times = cl.Law.from_text("x' = -k x", {"k": 0.5}), np.arange(20.0)
    settings = usual(law, cl.Trials.from_arrays(times, np.exp(-0.5 * times), names=["x"]))
    assert settings["x"] == pytest.approx([1.0])


def test_of_several_objects_many_coefficients_have_a_figure_each():
    names = ["one", "two"]
    law = cl.Law.from_text("x'' = a + b v + c x", {each: dict.fromkeys(names, 2.0) for each in "abc"})
    trials = cl.Trials.from_arrays([np.arange(20.0)] * 2, [np.arange(20.0)] * 2, object=names)
    shown = coefficients(Summary(find(law, trials)))
    (gallery,) = [each for each in shown if isinstance(each, Gallery)]
    captions = [picture.caption.replace("\\", "") for picture in gallery.pictures]
    assert captions == [f"Coefficients {term} in x''." for term in "abc"]
    (axes,) = gallery.pictures[1].draw().axes
    assert [each.get_text() for each in axes.get_yticklabels()] == names


@pytest.mark.slow
def test_known_coefficients_are_said_to_be_so_and_have_no_interval(drops):
    text, numbers = "x'' = -9.8 - c v", {"c": {"Ball 1": 0.1, "Ball 2": 0.5}}
    law = cl.refine(cl.Law.from_text(text, numbers, units={"x": "m", "t": "s"}), drops)
    report = law_report(find(law, drops))
    assert named_parameters(law).errors.all()
    sure = replace(
        law.uncertainty, covariance=0 * law.uncertainty.covariance, shared_factor=None, unpooled=None, pooled=None
    )
    known = law_report(find(replace(law, uncertainty=sure), drops))
    assert blocks_of(known, "coefficients")[1].text == "Fixed: c."
    assert " ± " not in table_of(known, "values")["c (1/s)"].iloc[0]
    assert " ± " in table_of(report, "values")["c (1/s)"].iloc[0]


def test_steps_that_differ_by_rounding_are_said_to_be_even(report):
    assert (table_of(report, "trials")["largest deviation (s)"] == 0).all()


def test_long_equations_go_on_in_further_lines():
    names = [f"x^{i} v^{j}" for i in range(3) for j in range(1, 3)]
    law = cl.Law.from_text("x'' = " + " + ".join(f"{2 + i}.25 {name}" for i, name in enumerate(names)))
    whole, shown = to_latex(law), law_latex(law)
    assert shown.count("&=") == 1
    assert shown.count(r"&\quad") >= 1
    bare = [re.sub(r"\\quad|\\\\|[&\s]", "", each) for each in (whole, shown)]
    assert bare[0] == bare[1]
    formula(shown)
    short = cl.Law.from_text("x'' = -9.8 - 0.2 v")
    assert law_latex(short).count("\n") == 2
    sure = cl.Law.from_text("x'' = " + " + ".join(f"{2 + i}.25 x^{i}" for i in range(1, 7)))
    covariance = 1e-12 * np.eye(6)[np.newaxis]
    sure = replace(sure, uncertainty=replace(sure.uncertainty, covariance=covariance), provenance=Provenance())
    rows = law_latex(sure).splitlines()[1:-1]
    assert len(rows) == 6
    assert not any(row.strip("&= ").endswith("=") for row in rows)


def test_quantities_of_a_law_of_a_known_form_are_a_table(report, law):
    shown, known = table_of(report, "quantities"), law.quantities().set_index(["quantity", "object"])
    assert [*shown] == ["object", "terminal speed v_t (m/s)", "time constant τ (s)"]
    for owner, *cells in shown.values.tolist():
        for name, cell in zip(("terminal speed", "time constant"), cells, strict=True):
            assert float(cell.split(" ± ")[0]) == pytest.approx(known.loc[name, owner]["estimate"], rel=0.01)
