"""How well a law fits trials: residuals, and the patterns that tests find in them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import commonlaw as cl
from commonlaw import Law, Trials
from commonlaw.discrepancy.residual_tests import correlations, patterns
from commonlaw.law.uncertainty import ObjectEstimates
from commonlaw.plots import plot_residuals, render
from tests.refusals import refused


def decays(disturb, samples: int = 60) -> Trials:
    """Return ten decays with noise of 0.01, to which disturbances of shape (samples,) by time and state are added."""
    times, rng = np.linspace(0.0, 3.0, samples), np.random.default_rng(3)
    states = [start * np.exp(-times) for start in np.linspace(1.0, 2.0, 10)]
    noisy = [own + disturb(times, own, rng) for own in states]
    return Trials.from_arrays([times] * 10, noisy, trial=list(range(10)))


DECAY = Law.from_text("x' = -k x", {"k": 1.0})
WHITE = replace(DECAY, uncertainty=replace(DECAY.uncertainty, noise=[0.01]))


def white(times, _states, rng):
    return rng.normal(0.0, 0.01, len(times))


def found(disturb) -> dict[str, str]:
    """Return what the patterns that are there mean, by pattern."""
    return {each.pattern: each.meaning for each in WHITE.residuals(decays(disturb)).significant}


def test_white_noise_has_no_pattern():
    assert found(white) == {}
    residuals = WHITE.residuals(decays(white))
    assert "no pattern is significant" in str(residuals)
    assert repr(residuals) == "<Residuals of 10 trials: 0 of 6 patterns are significant>"


@pytest.mark.parametrize(
    ("disturb", "pattern", "meaning"),
    [
        (lambda t, x, r: 2 * white(t, x, r), "RMS over noise", "lack of fit, or the noise is underestimated"),
        (lambda t, x, r: white(t, x, r) + 0.03 * np.sin(t), "trend with t", "an unmodelled change with time"),
        (lambda t, x, r: white(t, x, r) + 0.03 * (x - 0.5) ** 2, "trend with x", "a term in x, or in a collinear"),
        (lambda t, x, r: white(t, x, r) * 2 * x, "heteroscedasticity", "errors='proportional'"),
        (lambda t, _, r: np.convolve(r.normal(0, 0.006, len(t) + 3), np.ones(4), "valid"), "autocorrelation",
         "autocorrelated: "),
        (lambda t, _, r: np.diff(r.normal(0, 0.007, len(t) + 1)), "autocorrelation",
         "negatively autocorrelated"),
        (lambda t, _, r: 0.006 * r.standard_t(3, len(t)), "normality (excess kurtosis)", "tails are heavy"),
        (lambda t, _, r: 0.01 * (r.exponential(size=len(t)) - 1), "normality (excess kurtosis)", "lean to one side"),
    ],
)  # fmt: skip
def test_each_pattern_is_found_and_has_its_meaning(disturb, pattern, meaning):
    assert meaning in found(disturb).get(pattern, "")


def test_residuals_of_states_that_err_together_are_correlated():
    truth = Law.from_text(["x' = -k x", "y' = -c y"], {"k": 1.0, "c": 1.0})
    law = replace(truth, uncertainty=replace(truth.uncertainty, noise=[0.01, 0.01]))
    times, rng = np.linspace(0.0, 3.0, 100), np.random.default_rng(1)
    decay = np.exp(-times)[:, np.newaxis] * [1.0, 2.0]
    both = rng.normal(0.0, 0.009, (100, 1)) + rng.normal(0.0, 0.004, (100, 2))
    trials = Trials.from_arrays(times, decay + both, names=["x", "y"])
    found = law.residuals(trials)
    (pattern,) = [each for each in found.patterns if each.pattern == "correlation with residuals of x"]
    assert pattern.significant
    own = np.concatenate(found.standardized)
    assert pattern.statistic == pytest.approx(stats.pearsonr(*own.T).statistic)
    assert render(plot_residuals(found), "svg").startswith(b"<?xml")


def test_correlations_are_within_trials_and_leave_gaps_out():
    first, second = np.array([1.0, -1.0, np.nan, 1.0, 2.0]), np.array([3.0, -3.0])
    mean, variance = np.nanmean(np.append(first, second)), np.nanvar(np.append(first, second))
    pairs = [(1, -1), (1, 2), (3, -3)]
    value, count = correlations([first, second], 1)
    assert count[0] == 3
    assert value[0] == pytest.approx(np.mean([(a - mean) * (b - mean) for a, b in pairs]) / variance)


@pytest.mark.parametrize(("samples", "trials"), [(8, 12), (12, 10), (49, 10)])
def test_white_noise_has_no_memory_after_a_fit_to_short_trials(samples, trials):
    curves = np.linalg.qr(np.vander(np.linspace(-1, 1, samples), 4))[0]
    found = []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(size=(trials, samples))
        left = list((noise - noise @ curves @ curves.T)[:, :, np.newaxis])
        columns = {"t": np.tile(np.arange(float(samples)), trials), "x": noise.ravel()}
        tested = patterns(["x"], left, columns, "t", [4 * trials])
        found.append(next(each.p_value for each in tested if each.pattern == "autocorrelation"))
    assert np.mean(np.array(found) < 0.01) <= 0.05
    assert np.mean(np.array(found) < 0.5) > 0.2


def test_coefficients_that_all_objects_share_are_spent_once():
    trials = decays(white)
    names = [f"object {i}" for i in range(10)]
    apart = trials.with_trials([replace(own, object=name) for own, name in zip(trials, names, strict=True)])
    law = Law.from_text("x' = -k x", {"k": dict.fromkeys(names, 1.0)})
    own = np.full((10, 1, 1), 1e-4)
    for covariance, spent in ((own, 20), (own / 10, 11)):
        unpooled = ObjectEstimates(law.coefficients[:, 0], own)
        uncertain = replace(law.uncertainty, noise=[0.01], covariance=covariance, unpooled=unpooled)
        found = replace(law, uncertainty=uncertain).residuals(apart)
        squares = np.concatenate(found.standardized) ** 2
        (level,) = [each.statistic for each in found.patterns if each.pattern == "RMS over noise"]
        assert level == pytest.approx(np.sqrt(squares.sum() / (len(squares) - spent)))


def test_few_samples_are_not_tested_and_discrete_time_is_refused():
    short = decays(white, 60).select(trial=0).until(0.5)
    assert str(WHITE.residuals(short)) == "There are too few residuals to test."
    steps = cl.Law.from_text("x[k+1] = 0.9 x")
    with refused("discrete-without-trajectories"):
        steps.residuals(short)


def test_a_law_that_does_not_know_its_noise_takes_it_from_the_samples():
    table = DECAY.residuals(decays(white)).to_frame()
    assert table["x residual/noise"].std() == pytest.approx(1.0, rel=0.1)


def test_means_of_residuals_are_of_several():
    few = WHITE.residuals(decays(white, 30).select(trial=0))
    axes = plot_residuals(few).axes[0]
    (means,) = [each for each in axes.lines if each.get_marker() == "o"]
    assert len(means.get_xdata()) == 30 // 4


@pytest.mark.parametrize(("spent", "is_seen"), [(0.0, True), (0.05, False)])
def test_sizes_may_grow_by_what_the_fit_took_of_the_noise(spent, is_seen):
    generator, n = np.random.default_rng(0), 20_000
    x = generator.uniform(1, 2, n)
    residuals = (1 + 0.1 * x) * generator.standard_normal(n)
    found = patterns(["x"], [residuals[:, np.newaxis]], {"t": np.arange(n, dtype=np.float64), "x": x}, "t", [spent * n])
    (growth,) = (each for each in found if each.pattern == "heteroscedasticity")
    assert 0.01 < growth.statistic < 0.05
    assert growth.significant == is_seen
