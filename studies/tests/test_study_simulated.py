"""The study's parts on simulated drops: their verdicts, and the numbers behind them."""

import numpy as np
import pytest

from commonlaw.datasets import linear_drag
from commonlaw.differentiation import parse_differentiation
from commonlaw.report import Picture
from studies.falling_balls import quadratic_drag, simulated_drops
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.reynolds_drag import _averages, _drops, reynolds_drag
from studies.falling_balls.settings import (
    DIFFERENTIATION,
    LINEAR_AVERAGES,
    NOISES,
    REYNOLDS_AVERAGES,
    RUN_THRESHOLDS,
    SEED,
)
from studies.falling_balls.simulation import agrees, captures, learned, on_grid, simulated

INQUIRY = Inquiry(None, "not needed", 7)


@pytest.fixture(scope="module")
def linear():
    with pytest.MonkeyPatch.context() as patch:
        # Fewer seeds than the study has, to save time
        patch.setattr(simulated_drops, "RECOVERY_SEEDS", 2)
        patch.setattr(quadratic_drag, "FINDING_SEEDS", 1)
        yield simulated_drops.simulated_drops(INQUIRY)


@pytest.fixture(scope="module")
def reynolds():
    return reynolds_drag(INQUIRY)


@pytest.mark.slow
def test_the_averages_of_linear_drag_are_those_of_the_authors_program_whatever_the_seed(linear):
    found = linear.results["linear_drag_averages"]
    assert [{term: round(value, 6) for term, value in found[f"{noise:g}"].items()} for noise in NOISES] == list(
        LINEAR_AVERAGES
    )
    assert [verdict.kind for verdict in linear.verdicts] == ["reproduced", "differs", "reproduced"]


@pytest.mark.slow
def test_the_group_method_finds_the_terms_more_often_than_the_single_trial_method(linear):
    shares = linear.results["recovery"]
    assert shares["group, all balls"]["0.01"] == 1
    assert all(
        shares["group, all balls"][noise] > shares["single, all balls"][noise] for noise in ("0.01", "0.1", "0.5")
    )
    assert shares["group, all balls"]["2"] < 0.6


@pytest.mark.slow
def test_a_squared_velocity_is_found_by_the_other_method_only_and_not_where_there_is_none(linear):
    found = linear.results["quadratic_findable"]
    assert found["paper"]["1.5"].keys() == {"1", "v"}
    assert found["exact"]["0.01"]["4"]["0.1"] == found["exact"]["0.03"]["4"]["0.03"] == 1
    assert found["exact"]["0.01"]["4"]["0"] == found["exact"]["0.1"]["4"]["0.1"] == 0
    assert found["smallest"]["0.01"]["4"] <= 0.01
    assert found["smallest"]["0.1"]["4"] is None


def test_the_averages_of_reynolds_drag_with_the_seed_of_the_program():
    averages = _averages(learned(simulated(_drops(), NOISES, SEED), RUN_THRESHOLDS))
    for noise, expected in zip(NOISES, REYNOLDS_AVERAGES, strict=True):
        assert averages[noise] == pytest.approx(expected, abs=1.1e-6)


@pytest.mark.slow
def test_the_averages_of_reynolds_drag_need_the_thresholds_that_the_program_ran_with(reynolds):
    assert [verdict.kind for verdict in reynolds.verdicts] == ["reproduced with correction", "reproduced"]
    found = reynolds.results["reynolds_drag_averages"]
    for noise, expected in zip(NOISES, REYNOLDS_AVERAGES, strict=True):
        assert found["printed viscosity"][f"{noise:g}"] == pytest.approx(expected, abs=1.1e-6)
    assert all(found["x kept at the printed threshold"].values())
    assert found["viscosity of air"]["0"] != found["printed viscosity"]["0"]
    others = [each["other method"] for each in reynolds.results["reynolds_drag_variants"].values()]
    assert all(each["v^2"] > 0 for each in others)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["linear", "reynolds"])
def test_the_figures_of_both_parts_can_be_drawn(part, request):
    pictures = [block for block in request.getfixturevalue(part).blocks if isinstance(block, Picture)]
    assert len(pictures) >= 2
    for picture in pictures:
        assert picture.draw().axes


def test_noise_is_drawn_drop_by_drop_with_the_noise_levels_innermost():
    clean = linear_drag(noise=0.0, trials=2)
    noisy, source = simulated(clean, (0.0, 1.0, 2.0), 5), np.random.RandomState(5)
    assert list(noisy) == [0.0, 1.0, 2.0]
    for index, trial in enumerate(clean):
        for noise in (0.0, 1.0, 2.0):
            expected = trial.states[:, 0] + noise * source.randn(49)
            np.testing.assert_allclose(noisy[noise][index].states[:, 0], expected, rtol=1e-15)


def test_averages_agree_only_in_terms_and_digits():
    found = {0.1: {"1": -9.6116053, "v": -0.3662832}}
    assert agrees(found, [{"1": -9.611605, "v": -0.366283}])
    assert not agrees(found, [{"1": -9.611606, "v": -0.366283}])
    assert agrees(found, [{"1": -9.611606, "v": -0.366283}], units=1.0)
    assert not agrees(found, [{"1": -9.611605}])


def test_a_squared_velocity_is_captured_only_with_its_sign_and_without_other_terms():
    law = linear_drag.truth(drag=(-0.1, 0.0, -0.1), quadratic=(0.1, 0.1, -0.1))
    np.testing.assert_array_equal(captures(law), [True, True, False])


def test_matrices_on_a_grid_give_the_rates_of_their_method():
    trial = linear_drag(noise=0.1)[0]
    found = on_grid(DIFFERENTIATION, trial.times).differentiate(trial.times, trial.states, 2)
    expected = parse_differentiation(DIFFERENTIATION).differentiate(trial.times, trial.states, 2)
    np.testing.assert_allclose(found.states, expected.states, atol=1e-11)
    np.testing.assert_allclose(found.derivatives, expected.derivatives, atol=1e-9)
