"""What the study finds on rates from noisy heights."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.report import Picture, Table
from studies.falling_balls.drop_noise import noise_of_drops, noise_verdict
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.numerical_differentiation import numerical_differentiation
from studies.falling_balls.rate_errors import LARGEST, METHODS, NoisyFall, at, medians
from studies.falling_balls.rate_verdicts import method_verdict, window_verdict
from studies.falling_balls.settings import REPORTED_NOISES, SEED, WINDOWS


@pytest.fixture(scope="module")
def fall():
    return NoisyFall.simulated(SEED)


@pytest.fixture(scope="module")
def section(drops):
    return numerical_differentiation(Inquiry(drops, "", SEED))


def test_the_fall_and_its_rates_obey_their_law(fall):
    (path,) = cl.datasets.linear_drag.truth(drag=-0.5).simulate(fall.times, (40.0, 0.0)).values()
    np.testing.assert_allclose(np.column_stack([fall.heights, fall.rates[0]]), path.states, atol=1e-6)
    np.testing.assert_allclose(fall.rates[1], -9.8 - 0.5 * fall.rates[0])


def test_the_noise_added_has_the_level_that_it_is_said_to_have(fall):
    noise = fall.measured - fall.heights[:, np.newaxis, np.newaxis]
    np.testing.assert_allclose(noise.std(axis=(0, 2)) / fall.levels, 1, atol=0.05)
    assert (len(fall.levels), fall.levels[0], fall.levels[-1]) == (200, pytest.approx(1e-3), pytest.approx(1))


def test_errors_of_differences_are_those_of_a_direct_computation(fall):
    method = METHODS["smoothed centred"]
    errors, heights = fall.errors(method), fall.measured[:, 150, 7]
    rates = method.differentiate(fall.times, heights[:, np.newaxis], 2).derivatives
    for order, rate, exact in zip((1, 2), rates, fall.rates, strict=True):
        wanted = np.sqrt(np.sum((rate[:, 0] - exact) ** 2) / np.sum(exact**2))
        assert errors[order][150, 7] == pytest.approx(wanted)


def test_the_statements_on_methods_and_windows_hold(section):
    methods, windows, _ = section.verdicts
    assert methods.kind == windows.kind == "reproduced"
    assert "best at most levels (82% of them" in methods.text
    assert "$10^{-3}$ for the velocity and $10^{-2}$" in windows.text


def test_the_statements_hold_with_other_noise_too():
    section = numerical_differentiation(Inquiry(None, "not asked for", 1))
    assert [verdict.kind for verdict in section.verdicts] == ["reproduced", "reproduced", "left out"]
    assert "not asked for" in section.blocks[-1].text
    assert set(section.results) == {"differentiation_error", "window_error"}


def test_a_verdict_turns_when_a_number_moves(fall):
    errors = {name: fall.errors(method) for name, method in METHODS.items()}
    assert method_verdict(fall, medians(errors)).kind == "reproduced"
    swapped = {**errors, "smoothed centred": errors["forward"]}
    assert method_verdict(fall, medians(swapped)).kind == "differs"
    windows = {str(window): {order: np.ones((200, 2)) for order in (1, 2)} for window in WINDOWS}
    changes = {str(window): np.ones(200) for window in WINDOWS}
    assert window_verdict(fall, medians(windows), changes).kind == "differs"


def test_results_are_numbers_by_order_method_and_level(section):
    errors, windows = section.results["differentiation_error"], section.results["window_error"]
    assert list(errors) == list(windows) == ["1", "2"]
    assert list(errors["1"]) == ["forward", "centred", "smoothed forward", "smoothed centred"]
    assert list(windows["2"]) == [str(window) for window in WINDOWS]
    assert list(windows["2"]["7"]) == [f"{level:g}" for level in REPORTED_NOISES]
    assert errors["2"]["smoothed centred"] == windows["2"]["35"]
    assert errors["2"]["centred"]["1"] == pytest.approx(60, rel=0.2)
    assert errors["1"]["smoothed centred"]["0.001"] == pytest.approx(0.00455, rel=0.01)


def test_smoothing_changes_the_fall_as_much_as_the_formula_says(fall):
    lost, taken = fall.mean_change(LARGEST)
    size = np.sum(fall.heights**2)
    for level in (0.003, 0.03, 0.3):
        expected = np.sqrt((lost + taken * level**2) / (size + len(fall.heights) * level**2))
        assert at(fall.levels, fall.changes(LARGEST).mean(axis=1), level) == pytest.approx(expected, rel=0.05)


def test_the_noise_of_simulated_drops_is_found_in_both_ways(fall):
    drops = cl.datasets.linear_drag(drag=[-0.5] * 30, height=40.0, noise=0.05, trials=1, seed=1)
    found = noise_of_drops(drops, fall)["1"].values()
    for way in ("paper_method", "robust"):
        assert np.mean([each[way] for each in found]) == pytest.approx(0.05, rel=0.06)


def test_the_noise_of_every_drop_is_a_few_centimetres(section, fall):
    noise = section.results["noise_of_drops"]
    assert [len(noise[drop]) for drop in ("1", "2")] == [10, 10]
    estimates = np.array(
        [[ball["paper_method"], ball["robust"]] for balls in noise.values() for ball in balls.values()]
    )
    assert np.all((estimates > 0.015) & (estimates < 0.09))
    np.testing.assert_allclose(np.median(estimates, axis=0), [0.047, 0.039], atol=0.003)
    verdict = section.verdicts[-1]
    assert verdict.kind == "differs"
    assert "17 of 20 drops" in verdict.text
    assert "Volleyball, drop 1: 0.083 m" in verdict.text
    within = {drop: {ball: {"paper_method": 0.05} for ball in balls} for drop, balls in noise.items()}
    assert noise_verdict(within, fall).kind == "reproduced"


def test_one_height_that_went_wrong_makes_the_paper_s_estimate_too_large(drops, fall):
    (trial,) = drops.select(object="Volleyball", trial="1")
    shorter = noise_of_drops(drops.with_trials([trial.cut(len(trial) - 1)]), fall)["1"]["Volleyball"]
    whole = noise_of_drops(drops.with_trials([trial]), fall)["1"]["Volleyball"]
    assert shorter["paper_method"] < 0.7 * whole["paper_method"]
    assert shorter["robust"] == pytest.approx(whole["robust"], rel=0.3)


def test_every_figure_is_drawn_and_the_table_is_filled(section):
    pictures = [block for block in section.blocks if isinstance(block, Picture)]
    assert [picture.name for picture in pictures] == [
        "noisy-fall", "differentiation-errors", "window-errors", "smoothing-change", "noise-of-drops",
    ]  # fmt: skip
    assert [len(picture.draw().axes) for picture in pictures] == [3, 2, 2, 1, 2]
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert table.frame.shape == (10, 5)
    assert not table.frame.isna().any(axis=None)


def test_the_same_seed_gives_the_same_numbers(fall):
    np.testing.assert_array_equal(NoisyFall.simulated(SEED).measured, fall.measured)
    assert not np.array_equal(NoisyFall.simulated(1).measured, fall.measured)
