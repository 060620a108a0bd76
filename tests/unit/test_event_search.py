"""Events whose times are found only from many initial guesses."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.estimation.beginning import begin
from commonlaw.estimation.model import ModelText
from commonlaw.estimation.search import EVENT_SHARES, STEPS_PER_SAMPLE, _growing, with_step_limit
from tests.unit.decays import fitted, trials_of


def masses(times, rate, threshold, first):
    """Return the masses of a cell that grows steadily and divides where it has a mass."""
    cycle, begun = threshold / 2 / rate, (threshold - first) / rate
    since = np.where(times <= begun, times + first / rate, threshold / 2 / rate + (times - begun) % cycle)
    return rate * since


def test_cells_that_divide_have_the_estimates_of_least_squares():
    times, truth = np.linspace(0, 10, 81), (0.5, 2.0, 1.3)
    data = masses(times, *truth) + 0.03 * np.random.default_rng(3).standard_normal(len(times))
    law = cl.fit("y' = k; y > top: y = y/2", trials_of({"A": (times, data)}))
    own = [*law.params["estimate"], law.trial_estimates[0].value]
    expected, errors = fitted(lambda p: masses(times, *p), own, data)
    assert own == pytest.approx(expected, rel=1e-5)
    assert law.params["standard error"].to_numpy() == pytest.approx(errors[:2], rel=1e-3)
    # The likelihood jumps where a division moves over a sample; that of the true values is no larger
    assert np.sum((masses(times, *own) - data) ** 2) <= np.sum((masses(times, *truth) - data) ** 2)
    assert np.all(np.abs(np.subtract(own, truth)) < 4 * errors)


@pytest.mark.slow
def test_the_time_of_a_dose_is_found_from_poor_guesses():
    """An early event explains the first samples at wrong values of the other parameters."""
    times, random = np.linspace(0, 16, 40), np.random.default_rng(101)

    def course(ka, ke, volume, tau):
        def after(t):
            return np.where(t > 0, 10 * ka / volume / (ka - ke) * (np.exp(-ke * t) - np.exp(-ka * t)), 0.0)

        return after(times) + after(times - tau)

    data = course(1.2, 0.25, 4.0, 5.3) + 0.02 * random.standard_normal(len(times))
    model = "A' = -ka A; y' = ka A/V - ke y; A(0) = 10; y(0) = 0; t > tau: A = A + 10"
    law = cl.fit(model, trials_of({"A": (times, data)}), guesses={"ka": 0.3, "ke": 1.0, "V": 16.0, "tau": 21.2})
    expected, errors = fitted(lambda p: course(*p), [1.2, 0.25, 4.0, 5.3], data)
    params = law.params.set_index("parameter")
    assert params["estimate"][["ka", "ke", "V", "tau"]].tolist() == pytest.approx(expected, rel=1e-4)
    assert params["standard error"][["ka", "ke", "V", "tau"]].tolist() == pytest.approx(errors, rel=0.02)


def test_each_first_part_of_the_trials_has_new_samples():
    times = [0.1 * np.arange(6)] * 2
    trials = cl.Trials.from_arrays(times, [np.exp(-t) for t in times], object=["a", "b"], names=["x"])
    problem = begin(ModelText.of("x' = -k x; t > tau: x = 0"), trials, {}).problem
    parts = _growing(problem, EVENT_SHARES)
    assert [sum(len(data.rows) for data in part.trials) for part in parts] == [4, 6, 12]
    single = begin(ModelText.of("x' = -k x; t > tau: x = 0"), cl.Trials(trials[:1].trials, trials.schema), {}).problem
    assert _growing(single, (1.0,)) == [single]


def test_solutions_take_steps_by_samples_and_more_where_those_of_first_values_do():
    trials = cl.Trials.from_arrays(0.25 * np.arange(8), np.cos(np.arange(8.0)), names=["x"])
    begun = begin(ModelText.of("x'' = -k x; x < 0: v = v"), trials, {})
    slow, fast = (np.array([k, 1.0, 0.0]) for k in (30.0, 1e7))
    assert with_step_limit(begun.problem, slow).max_steps == 8 * STEPS_PER_SAMPLE < begun.problem.max_steps
    assert with_step_limit(begun.problem, fast) is begun.problem
