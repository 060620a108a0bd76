"""The parts of the study on learned terms and on thresholds agree with the print where the study says so."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.report import Table
from studies.falling_balls import learned_terms as terms_part, sparsity_path as path_part
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.learned_terms import learned_terms
from studies.falling_balls.report import Section
from studies.falling_balls.sparsity_path import sparsity_path


@pytest.fixture(scope="module")
def inquiry(drops: cl.Trials) -> Inquiry:
    return Inquiry(drops, "", 100)


@pytest.fixture(scope="module")
def terms(inquiry: Inquiry) -> Section:
    return learned_terms(inquiry)


@pytest.fixture(scope="module")
def path(inquiry: Inquiry) -> Section:
    return sparsity_path(inquiry)


def table(section: Section, name: str) -> Table:
    return next(block for block in section.blocks if isinstance(block, Table) and block.name == name)


def kinds(section: Section) -> list[str]:
    return [verdict.kind for verdict in section.verdicts]


def test_the_printed_models_and_the_results_are_reproduced_and_the_conclusions_are_not(terms: Section) -> None:
    assert kinds(terms) == ["reproduced", "reproduced", "differs"]
    assert "40 of the 40 coefficients" in terms.verdicts[0].text
    assert "13 of 20 (6 of 10 in drop 1, 7 of 10 in drop 2)" in terms.verdicts[2].text
    assert table(terms, "learned-models").frame["agrees"].all()


def test_results_hold_every_model_by_drop_ball_and_term(terms: Section) -> None:
    assert terms.results["group_models"]["2"]["Volleyball"] == pytest.approx({"1": -9.64, "v": -0.23}, abs=0.005)
    assert terms.results["single_models"]["2"]["Golf Ball"] == pytest.approx({"1": -9.089}, abs=0.0005)
    assert terms.results["single_models"]["1"]["Whiffle Ball 2"] == pytest.approx({"1": -9.808, "v": -0.5569}, abs=5e-4)
    assert terms.results["single_model_counts"]["both"] == {
        "models": 20, "terms": 54, "with_height": 13, "without_speed": 2, "constant_only": 2,
    }  # fmt: skip


def test_both_tables_of_thresholds_are_reproduced_but_for_the_erratum(path: Section) -> None:
    assert kinds(path) == ["reproduced", "reproduced with correction", "reproduced"]
    assert "70 of 70 cells" in path.verdicts[0].text
    assert "99 of 100 cells come out to the digits printed, but not v at threshold 0.005" in path.verdicts[1].text
    assert path.results["threshold_path_group"]["0.005"]["v"] == pytest.approx(0.874, abs=5e-4)
    assert path.results["threshold_path_single"]["2"] == pytest.approx({"1": -7.6344}, abs=5e-5)
    assert path.results["threshold_path_single"]["10"] == {}


def test_every_printed_threshold_stands_in_the_stretch_that_holds_it(path: Section) -> None:
    intervals = table(path, "threshold-intervals").frame
    for method, part in intervals.groupby("method"):
        kind = "group" if "group" in method else "single"
        listed = ", ".join(part["printed"].dropna()).split(", ")
        assert sorted(listed) == sorted(path.results[f"threshold_path_{kind}"])
        for row in part.dropna().to_dict("records"):
            for text in row["printed"].split(", "):
                assert row["from"] <= float(text) < row["to"]
                assert len(path.results[f"threshold_path_{kind}"][text]) == row["number"]


def test_the_held_out_drop_chooses_the_terms_of_the_paper_for_the_group(path: Section) -> None:
    choice = path.results["choices"]["group"]["held-out"]
    assert choice["terms"] == ["1", "v"]
    ((low, high),) = choice["thresholds"]
    assert low < 1.5 < high


def test_the_held_out_error_is_that_of_fitting_one_drop_and_testing_the_other(inquiry: Inquiry, path: Section) -> None:
    form = cl.formulation.StrongForm(
        cl.differentiation.SmoothedDifference(cl.differentiation.SavitzkyGolay(35, 3)), order=2
    )
    errors = []
    for ball in inquiry.drops.objects:
        rates = [form.rates(trial).derivatives for trial in inquiry.drops.of_object(ball)]
        columns = [np.column_stack([np.ones(len(speeds)), speeds[:, 0]]) for speeds, _ in rates]
        targets = [accelerations[:, 0] for _, accelerations in rates]
        scale = np.mean(np.concatenate(targets) ** 2)
        for learn, test in ((0, 1), (1, 0)):
            fit = np.linalg.lstsq(columns[learn], targets[learn])[0]
            errors.append(np.mean((columns[test] @ fit - targets[test]) ** 2) / scale)
    assert path.results["choices"]["group"]["held-out"]["held_out_error"] == pytest.approx(np.mean(errors), rel=1e-9)


def test_verdicts_turn_when_a_number_moves(terms: Section, path: Section) -> None:
    models = {drop: dict(balls) for drop, balls in terms.results["group_models"].items()}
    models["1"]["Volleyball"] = {"1": -8.11, "v": -0.09}
    assert terms_part._printed_models(models).kind == "differs"
    models["1"]["Volleyball"] = {"1": -8.11, "v": -0.08, "x": 0.1}
    assert "Some have the terms 1, v, x" in terms_part._printed_models(models).text
    printed, found = path_part._printed("group"), dict(path.results["threshold_path_group"])
    found["65"] = {"1": -7.1}
    assert path_part._group_table(printed, found).kind == "differs"
    printed["0.005"]["v"] = "0.87"
    assert path_part._group_table(printed, path.results["threshold_path_group"]).kind == "reproduced"
