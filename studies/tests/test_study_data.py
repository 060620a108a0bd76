"""The study's parts on the measurements: balls and drops, drag on a sphere, candidate terms."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trial, Trials
from studies.falling_balls.candidates import candidates
from studies.falling_balls.data import data
from studies.falling_balls.default_method import default_method
from studies.falling_balls.drag_regimes import drag_regimes
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.learned_terms import learned_terms
from studies.falling_balls.model_error import model_error
from studies.falling_balls.printed import printed_table, prints_as
from studies.falling_balls.report import Section
from studies.falling_balls.sparsity_path import sparsity_path
from studies.falling_balls.speeds import FORM

PARTS = (data, drag_regimes, candidates)


@pytest.fixture(scope="module")
def sections(drops):
    return {part.__name__: part(Inquiry(drops, "", 100)) for part in PARTS}


def kinds(section: Section) -> list[str]:
    return [verdict.kind for verdict in section.verdicts]


def frame(section: Section, name: str):
    return next(block.frame for block in section.blocks if isinstance(block, Table) and block.name == name)


def changed(drops: Trials, change: Callable[[Trial], Trial]) -> Inquiry:
    return Inquiry(drops.with_trials([change(trial) for trial in drops]), "", 100)


def test_the_verdicts_hold(sections):
    assert kinds(sections["data"]) == ["reproduced with correction", "reproduced", "reproduced with correction"]
    assert kinds(sections["drag_regimes"]) == ["reproduced with correction", "reproduced with correction"]
    assert kinds(sections["candidates"]) == ["reproduced"]


def test_results_have_the_keys_of_the_report(sections):
    keys = [key for section in sections.values() for key in section.results]
    assert keys == ["balls", "landing_time", "reynolds", "library"]


@pytest.mark.parametrize("part", [*PARTS, default_method, learned_terms, model_error, sparsity_path])
def test_without_the_drops_each_part_says_what_is_left_out(part):
    section = part(Inquiry(None, "the cellar is flooded", 100))
    assert kinds(section) == ["left out"]
    assert part is drag_regimes or not section.results
    assert "the cellar is flooded" in "".join(block.text for block in section.blocks if isinstance(block, Text))
    pictures = [block for block in section.blocks if isinstance(block, Picture)]
    assert [picture.name for picture in pictures] == (["drag-regimes"] if part is drag_regimes else [])
    assert all(len(picture.draw().axes) == 1 for picture in pictures)


def test_the_printed_properties_stand_beside_those_found(sections):
    balls, printed = sections["data"].results["balls"], printed_table("ball_properties").set_index("object")
    assert list(balls) == list(printed.index)
    for name, values in balls.items():
        assert prints_as(values["radius"], printed.loc[name, "radius_m"])
        assert prints_as(values["max_speed"], printed.loc[name, "max_speed_m_s"])
    assert balls["Golf Ball"]["mass"] == pytest.approx(1.62 * 0.028349523125)
    assert balls["Volleyball"].keys() == {"radius", "max_speed"}
    table = frame(sections["data"], "balls")
    assert table["mass (kg): printed"].tolist() == printed["mass_kg"].tolist()


def test_a_ball_lands_when_it_has_first_fallen_as_far_as_all_balls_at_the_last_common_sample(sections, drops):
    landing = sections["data"].results["landing_time"]
    shifted = {(trial.name, trial.object): trial.states[:, 0] - trial.states[0, 0] + 40 for trial in drops}
    level = max(heights[41] for heights in shifted.values())
    for trial in drops:
        heights = shifted[trial.name, trial.object]
        sample = next(i for i, height in enumerate(heights) if height <= level)
        assert landing[trial.name][trial.object] == trial.times[sample] - trial.times[0]
    assert landing["1"]["Golf Ball"] == pytest.approx(2.2033, abs=1e-3)
    assert landing["2"]["Golf Ball"] == pytest.approx(2.3367, abs=1e-3)
    delays = frame(sections["data"], "landing-times").set_index("ball")["drop 2 − drop 1 (s)"]
    assert delays["Orange Whiffle Ball"] == pytest.approx(0.202)
    assert str(delays["Tennis Ball"]) == "0.0"


def test_drop_one_in_both_panels_as_in_print_would_not_pass(drops):
    first = {trial.object: trial for trial in drops if trial.name == "1"}
    twice = changed(drops, lambda trial: replace(first[trial.object], name=trial.name))
    verdict = data(twice).verdicts[2]
    assert verdict.kind == "differs"
    assert "by a frame or more: none (the paper: Golf Ball," in verdict.text


def test_speeds_that_differ_turn_the_verdicts(drops):
    faster = changed(drops, lambda trial: replace(trial, states=1.01 * trial.states))
    assert data(faster).verdicts[0].kind == "differs"
    assert "max_speed of the Golf Ball" in data(faster).verdicts[0].text
    assert drag_regimes(faster).verdicts[0].kind == "differs"


def test_reynolds_numbers_are_printed_2_25_times_too_large(sections):
    reynolds = sections["drag_regimes"].results["reynolds"]
    assert len(reynolds) == 10
    for reynold in reynolds.values():
        assert reynold["as_printed"] == pytest.approx(reynold["printed"], abs=0.01e5)
        assert reynold["printed"] / reynold["corrected"] == pytest.approx(2.25, rel=0.01)
    holds = frame(sections["drag_regimes"], "reynolds-numbers").set_index("ball")["correlation holds"]
    assert holds[~holds].index.tolist() == ["Volleyball", "Blue Basketball", "Green Basketball"]


def test_samples_of_an_average_drop_come_out_by_order_of_magnitude(sections, drops):
    table = frame(sections["drag_regimes"], "reynolds-counts")
    samples = np.mean([len(trial) for trial in drops])
    for column in ("with the print's viscosity", "with the viscosity of the air"):
        assert table[column].iloc[:-1].sum() == pytest.approx(samples) == table[column].iloc[-1]
    found = table["with the print's viscosity"].tolist()[1:]
    assert [f"{value:.1f}" for value in found] == ["1.6", "13.3", "33.4", "48.5"]


def test_the_library_is_nearly_dependent_along_one_drop(sections, drops):
    library = sections["candidates"].results["library"]
    assert library["terms"] == ["1", "x", "v", "x^2", "x v", "v^2", "x^3", "x^2 v", "x v^2", "v^3"]
    (trial,) = drops.select(object="Green Basketball", trial=2)
    rates = FORM.rates(trial)
    x, v = rates.states[:, 0], rates.derivatives[0][:, 0]
    rows = np.stack([np.ones_like(x), x, v, x**2, x * v, v**2, x**3, x**2 * v, x * v**2, v**3], axis=1)
    singular, right = np.linalg.svd(rows / np.linalg.norm(rows, axis=0))[1:]
    assert library["condition_number"] == pytest.approx(singular[0] / singular[-1], rel=1e-6)
    table = frame(sections["candidates"], "candidate-terms").set_index("term")
    # What all other columns leave of a column of length one is the inverse root of the inverse Gram matrix's diagonal
    left = np.sum((right / singular[:, np.newaxis]) ** 2, axis=0) ** -0.5
    np.testing.assert_allclose(table["left over by the others"], left, rtol=1e-5)
    assert table.loc["x", "most alike"] == "v^2"
    assert table.loc["x", "correlation"] == pytest.approx(np.corrcoef(x, v**2)[0, 1])
    assert table.loc["v^2", "unit of coefficient"] == "1/m"


def test_the_pictures_can_be_drawn_and_show_each_drop(sections):
    pictures = {
        block.name: block for section in sections.values() for block in section.blocks if isinstance(block, Picture)
    }
    assert list(pictures) == ["strobe", "heights", "displacement", "landing-time", "drag-regimes", "library-terms"]
    panels = pictures["landing-time"].draw().axes
    heights = [[float(line.get_ydata()[0]) for line in panel.lines] for panel in panels]
    assert [panel.get_title() for panel in panels] == ["drop 1", "drop 2"]
    assert len(heights[0]) == len(heights[1]) == 9
    assert heights[0] != heights[1]
    assert len(pictures["library-terms"].draw().axes) == 10
    assert len(pictures["heights"].draw().axes[0].lines) == 13
