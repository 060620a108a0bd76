"""Trials of an object that ask for different coefficients are named."""

import numpy as np
import pytest
from scipy.stats import f, kstest

import commonlaw as cl
from commonlaw.discovery import TrajectoryLikelihood
from commonlaw.inference.fit.annealing import fit_supports
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.result.history import p_value_of_trials
from commonlaw.law import Law

TIMES = np.linspace(0, 3, 20)


def balls(scatter: float, seed: int, trials: int = 4) -> cl.Trials:
    """Return trials of two balls; the rate of the second one scatters over its trials."""
    generator, states, objects = np.random.default_rng(seed), [], []
    for name, rate, own in (("ball 1", 0.5, 0.0), ("ball 2", 0.9, scatter)):
        for _ in range(trials):
            changed = rate * np.exp(own * generator.standard_normal())
            states.append((np.exp(-changed * TIMES) + 0.01 * generator.standard_normal(20))[:, np.newaxis])
            objects.append(name)
    return cl.Trials.from_arrays([TIMES] * len(states), states, object=objects, names=["x"])


def fitted(trials: cl.Trials) -> Fit:
    law = Law.from_text("x' = -a x", {"a": dict.fromkeys(trials.objects, 0.7)})
    problem = prepare(trials, law.terms, np.full((2, 1, 1), np.nan))
    return fit_supports(problem, problem.allowed, (0.3, 0.03))


def test_the_probability_is_that_of_an_f_test_on_rates_of_each_trial():
    """By nonlinear least squares of exponentials, with a start of its own for each trial."""
    from scipy.optimize import least_squares

    trials = balls(0.05, 3)
    own = [trial.states[:, 0] for trial in trials.of_object("ball 2")]

    def left(rates, starts):
        return np.concatenate([x - c * np.exp(-r * TIMES) for x, r, c in zip(own, rates, starts, strict=True)])

    together = 2 * least_squares(lambda p: left([p[0]] * 4, p[1:]), [0.9, 1, 1, 1, 1]).cost
    alone = 2 * least_squares(lambda p: left(p[:4], p[4:]), [0.9] * 4 + [1] * 4).cost
    expected = f.sf((together - alone) / 3 / (alone / 72), 3, 72)
    found = p_value_of_trials(fitted(trials), "ball 2")
    assert np.log(found) == pytest.approx(np.log(expected), rel=0.1)


def test_trials_that_do_not_differ_have_probabilities_as_even_as_chance():
    found = [
        p_value_of_trials(fitted(balls(0.0, seed, trials=3)), name)
        for seed in range(12)
        for name in ("ball 1", "ball 2")
    ]
    assert kstest(found, "uniform").pvalue > 0.01


def test_objects_whose_trials_differ_are_named_and_no_others():
    white = TrajectoryLikelihood(errors="white", noise={"x": 0.01})
    same, other = (cl.discover(balls(scatter, 1), library="poly:1", method=white, order=1) for scatter in (0.0, 0.2))
    assert not [diagnostic for diagnostic in same.diagnostics if diagnostic.kind == "trials differ"]
    (outcome,) = [diagnostic for diagnostic in other.diagnostics if diagnostic.kind == "trials differ"]
    assert "ball 2" in outcome.text
    assert "ball 1" not in outcome.text
