"""Parameters near a bound, where solutions bend between two samples and the likelihood has several maxima."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import wrightomega

import commonlaw as cl

TIMES = np.linspace(0, 5, 40)
STARTS = (4.0, 2.5)


def substrate(start, velocity, constant):
    """The solution of s' = -V s/(K + s), K ω(log(s0/K) + (s0 - V t)/K) (Schnell and Mendoza 1997)."""
    return constant * wrightomega(np.log(start / constant) + (start - velocity * TIMES) / constant)


def measured(seed, constant=0.05):
    random = np.random.default_rng(seed)
    return [substrate(start, 1.0, constant) + 0.05 * random.standard_normal(len(TIMES)) for start in STARTS]


def likeliest(states):
    """V and K of least squares, the best from many values of K."""

    def residuals(unknowns):
        velocity, constant, *starts = unknowns
        return np.concatenate(
            [substrate(start, velocity, constant) - values for start, values in zip(starts, states, strict=True)]
        )

    fits = [
        least_squares(residuals, [1.0, constant, *STARTS], bounds=([0, 1e-6, 0, 0], np.inf), x_scale=[1, 0.01, 1, 1])
        for constant in (0.003, 0.01, 0.03, 0.1, 0.3)
    ]
    return min(fits, key=lambda fit: fit.cost).x[:2]


@pytest.mark.parametrize("seed", [0, 4, 12, 15])
def test_a_small_constant_has_the_estimate_of_the_exact_solution(seed):
    states = measured(seed)
    trials = cl.Trials.from_arrays([TIMES] * 2, states, names=["s"])
    law = cl.fit("s' = -V s/(K + s); K > 0", trials, errors="white")
    found, known = law.params.set_index("parameter"), likeliest(states)
    near = found["standard error"] / 20
    assert np.all(abs(found.estimate[["V", "K"]] - known) < near[["V", "K"]])


def test_a_law_without_a_fit_by_collocation_is_fitted_by_shooting():
    trials = cl.Trials.from_arrays([TIMES] * 2, measured(14), names=["s"])
    law = cl.fit("s' = -V s/(K + s); K > 0", trials, errors="white")
    assert law.scheme == "shooting"
    assert law.params.set_index("parameter").estimate["V"] == pytest.approx(1.0, abs=0.05)


def test_next_to_a_bound_errors_of_others_are_those_of_the_whole_likelihood():
    """Moments of V about its estimate, by the exact likelihood on a grid of V and K, each start at its best value."""
    states = measured(3)
    law = cl.fit("s' = -V s/(K + s); K > 0", cl.Trials.from_arrays([TIMES] * 2, states, names=["s"]), errors="white")
    (limit,) = law.uncertainty.limits
    assert (limit.parameter, limit.is_lower) == ("K", False)
    found, noise = law.params.set_index("parameter").loc["V"], law.uncertainty.noise[0]
    velocities, constants = np.linspace(0.92, 1.06, 57), np.linspace(0.0005, 0.12, 40)
    costs = np.zeros((len(velocities), len(constants)))
    for i, velocity in enumerate(velocities):
        for j, constant in enumerate(constants):
            for start, values in zip(STARTS, states, strict=True):
                starts = start + np.linspace(-0.1, 0.1, 41)
                curves = np.array([substrate(begin, velocity, constant) for begin in starts])
                costs[i, j] += np.min(np.sum((curves - values) ** 2, axis=1)) / noise**2
    weights = np.exp((costs.min() - costs) / 2).sum(axis=1)
    moment = np.sqrt(weights @ (velocities - found.estimate) ** 2 / weights.sum())
    assert found["standard error"] == pytest.approx(moment, rel=0.3)
    assert moment > 1.5 * 0.0075  # Given K
