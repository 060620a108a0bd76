"""The law of a long trial, or of many objects, is sought in some of its samples first, and all of them decide."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import search
from commonlaw.inference.search import law_search
from commonlaw.law import average_law
from commonlaw.law.parameters import standard_errors


def swinging(damping, noise, samples, springs=1, step=0.05):
    """Return the courses of springs that are hardly damped: ``x'' = -x - damping v``."""
    times, generator = step * np.arange(samples), np.random.default_rng(5)
    course = np.exp(-damping * times / 2) * np.cos(np.sqrt(1 - damping**2 / 4) * times)
    courses = [course[:, np.newaxis] + noise * generator.standard_normal((samples, 1)) for _ in range(springs)]
    names = [f"spring {i + 1}" for i in range(springs)]
    return cl.Trials.from_arrays([times] * springs, courses, object=names, names=("x",))


@pytest.fixture
def few(monkeypatch):
    """Have supports be sought in 200 samples first, and say how many samples were searched."""
    searched = []

    def counting(problem, *rest, **options):
        searched.append(sum(map(len, problem.trials)))
        return search(problem, *rest, **options)

    monkeypatch.setattr(settings, "FEW_SAMPLES", 200)
    monkeypatch.setattr(law_search, "search", counting)
    return searched


def test_all_samples_tell_terms_and_coefficients_that_few_cannot(few):
    trials, question = swinging(3e-4, 0.02, 2500), {"order": 2, "library": "terms:1,x,v"}
    law = cl.discover(trials, **question)
    assert len(few) == 1
    assert few[0] <= 200
    assert law.structure == ("x'' = a x + b v",)
    errors = standard_errors(law)[0][law.support]
    assert np.all(np.abs(law.coefficients[0][law.support] - [-1, -3e-4]) < 4 * errors)
    alone = cl.discover(trials, **question, method=cl.TrajectoryLikelihood(max_samples=200))
    assert alone.structure == ("x'' = a x",)


@pytest.mark.slow
def test_all_objects_tell_a_term_that_groups_of_them_cannot():
    springs, question = swinging(1.2e-3, 0.03, 60, 60, 0.2), {"order": 2, "library": "terms:1,x,v", "cache": False}
    group = springs.with_trials(list(springs)[::6])
    assert cl.discover(group, **question).structure == ("x'' = a x",)
    law = cl.discover(springs, **question)
    assert law.structure == ("x'' = a x + b v",)
    average, v = average_law(law), law.terms.index("v")
    assert abs(average.coefficients[0, 0, v] + 1.2e-3) < 3 * standard_errors(average)[0, 0, v]
