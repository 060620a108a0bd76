"""Noise that grows with the states shows in differences of neighbouring samples, before any law."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.differentiation import noise_order
from commonlaw.formulation import law_variables
from commonlaw.inference.fit.annealing import fit_supports
from commonlaw.inference.fit.lack_of_fit import proportional_noise_gain, with_heteroscedastic_noise
from commonlaw.inference.fit.problem import prepare
from commonlaw.library import PolynomialLibrary
from tests.simulations import solved

KINDS = ("white", "proportional", "by-object")
TIMES = np.linspace(0, 4, 300)
DECAY = 5 * np.exp(-TIMES)[:, np.newaxis]


def problem_of(*states, **settings):
    trials = cl.Trials.from_arrays([TIMES] * len(states), states, names=["x"])
    terms = PolynomialLibrary(1).bind(law_variables(trials.schema, 1))
    return prepare(trials, terms, np.full((1, 1, len(terms)), np.nan), **settings)


def noise(seed=0):
    return np.random.default_rng(seed).standard_normal(DECAY.shape)


def with_noise(problem):
    return with_heteroscedastic_noise(problem, KINDS)


def test_noise_in_proportion_is_seen_with_its_share():
    found = [with_noise(problem_of(DECAY * (1 + 0.05 * noise(seed)))) for seed in range(10)]
    shares = [each.errors.heteroscedastic["proportional"][0] for each in found]
    assert np.mean(shares) == pytest.approx(0.05, rel=0.1)
    assert all(each.noise[0] < 0.02 for each in found)  # Where the noise is 0.25 at first


def test_white_noise_and_exact_states_show_none():
    white = [with_noise(problem_of(DECAY + 0.05 * noise(seed))) for seed in range(50)]
    assert sum(bool(each.errors) for each in white) <= 1
    assert not with_noise(problem_of(DECAY)).errors


def test_trials_that_change_too_fast_between_samples_hide_neither_growth_nor_its_absence():
    fast = 5 + np.sin(np.pi / 2 * np.arange(len(TIMES)) + 0.1)[:, np.newaxis]
    assert noise_order(TIMES, fast[:, 0]) is None
    slow = [DECAY * (1 + 0.05 * noise(seed)) for seed in range(2)]
    share = with_noise(problem_of(*slow, fast)).errors.heteroscedastic["proportional"][0]
    assert share == pytest.approx(0.05, rel=0.1)
    white = [DECAY + 0.05 * noise(seed) for seed in range(2)]
    assert not with_noise(problem_of(*white, fast)).errors
    assert not with_noise(problem_of(slow[0], fast)).errors


def test_noise_that_is_given_stays():
    given = problem_of(DECAY * (1 + 0.05 * noise()), noise=np.array([0.1]))
    assert with_noise(given) is given


def test_outliers_are_seldom_taken_for_growth():
    seen = 0
    for seed in range(30):
        states = DECAY + 0.05 * noise(seed)
        states[[10, 200]] += 2.0
        seen += bool(with_noise(problem_of(states)).errors)
    assert seen <= 4


def test_noise_that_is_too_small_makes_no_law_probable_by_calling_the_rest_outliers():
    problem, support = problem_of(DECAY + 0.05 * noise()), np.array([[False, True]])
    values = [
        fit_supports(problem.with_scaled_noise(factor, "tried"), support).score.total for factor in (1.0, 0.1, 0.02)
    ]
    assert values[0] < min(values[1:]) - 100  # Minus twice the log-evidence


def test_the_gain_is_that_of_the_likeliest_levels():
    generator, sizes = np.random.default_rng(1), np.linspace(0, 3, 4000)
    squared = (np.hypot(0.1, 0.2 * sizes) * generator.standard_normal(4000)) ** 2
    gain, (constant, share) = proportional_noise_gain(squared, sizes)
    assert (constant, share) == (pytest.approx(0.1, rel=0.25), pytest.approx(0.2, rel=0.1))

    def deviance(variances):
        return float(np.sum(squared / variances + np.log(variances)))

    free = deviance(np.full(4000, squared.mean()))
    assert gain == pytest.approx(free - deviance(constant**2 + (share * sizes) ** 2))


@pytest.mark.slow
def test_an_epidemic_that_dies_down_under_noise_in_proportion_is_found():
    """Its first states are ten thousand times its last ones: under noise of one level most say nothing, or too much."""
    times = np.linspace(0, 10, 300)
    clean = solved(lambda _, z: [-0.4 * z[0] * z[1], 0.4 * z[0] * z[1] - 0.3 * z[1]], [7.2, 1.0], times)
    measured = clean * (1 + 0.05 * np.random.default_rng(5).standard_normal(clean.shape))
    law = cl.discover(cl.Trials.from_arrays(times, measured, names=["s", "i"]), library="poly:2", order=1)
    assert law.structure == ("s' = a s i", "i' = b i + c s i")
    assert law.uncertainty.error_model.heteroscedastic["proportional"] == pytest.approx([0.05, 0.05], rel=0.2)
