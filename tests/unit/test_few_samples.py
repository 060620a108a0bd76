"""The law of a long trial is sought in some of its samples first, and all of them decide."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.inference import few_samples, law_search
from commonlaw.inference.search import search


def swinging(damping, noise, samples):
    """Return the course of a spring that is hardly damped: ``x'' = -x - damping v``."""
    times, generator = 0.05 * np.arange(samples), np.random.default_rng(5)
    course = np.exp(-damping * times / 2) * np.cos(np.sqrt(1 - damping**2 / 4) * times)
    return cl.Trials.from_arrays(times, course + noise * generator.standard_normal(samples))


@pytest.fixture
def few(monkeypatch):
    """Have supports be sought in 200 samples first, and say how many samples were searched."""
    searched = []

    def counting(problem, *rest):
        searched.append(sum(map(len, problem.trials)))
        return search(problem, *rest)

    monkeypatch.setattr(law_search, "FEW_SAMPLES", 200)
    monkeypatch.setattr(few_samples, "search", counting)
    return searched


def test_all_samples_tell_terms_and_coefficients_that_few_cannot(few):
    trials, question = swinging(3e-4, 0.02, 2500), {"order": 2, "library": "terms:1,x,v"}
    law = cl.discover(trials, **question)
    assert len(few) == 1
    assert few[0] <= 200
    assert law.structure() == ("x'' = a x + b v",)
    errors = law.standard_errors[0][law.support]
    assert np.all(np.abs(law.coefficients[0][law.support] - [-1, -3e-4]) < 4 * errors)
    alone = cl.discover(trials, **question, method=cl.TrajectoryLikelihood(max_samples=200))
    assert alone.structure() == ("x'' = a x",)


def test_where_few_samples_depart_from_every_law_all_are_searched(few):
    generator = np.random.default_rng(2)
    wandering = np.cumsum(generator.standard_normal(500)) + 0.01 * generator.standard_normal(500)
    method = cl.TrajectoryLikelihood(errors="white")
    cl.discover(cl.Trials.from_arrays(np.arange(500.0), wandering), library="terms:1,x", method=method)
    assert few[0] < 500
    assert few[-1] == 500
