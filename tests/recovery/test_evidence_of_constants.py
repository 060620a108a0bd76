"""What counts against a law with nonlinear parameters besides its evidence: poles, unidentifiable parameters."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.inference.fit.annealing import fit_with
from commonlaw.inference.fit.lack_of_fit import has_pole
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.parametric import are_parameters_identifiable
from commonlaw.library import Term, Terms, Variables, parse_term
from tests.simulations import simulated

TIMES = np.linspace(0, 3, 30)
SATURATION = Variables(("s",), parameters=("K",))
TERMS = Terms(SATURATION, (parse_term("s/(K + s)", SATURATION), Term(parameter=SATURATION.index("K"))))


def decaying(half=np.inf, noise=0.01):
    """Trials of an object that decays by -s/(1 + s/half)."""
    return simulated(lambda _, s: -s / (1 + s / half), {"a": ()}, [[4.0], [2.0]], TIMES, noise, absolute=True)


def fitted(trials, values):
    """The fit of V s/(K + s) from these values of V and K of each object."""
    problem = prepare(trials, TERMS, np.full((len(trials.objects), 1, 2), np.nan), noise=np.array([0.01]))
    starts = [
        replace(start, coefficients=np.array([value])) for start, value in zip(problem.starts, values, strict=True)
    ]
    return fit_with(problem, problem.allowed, 0.0, starts)


@pytest.mark.parametrize(("constant", "has_one"), [(1.0, False), (-1.5, True), (-5.0, False), (-1.5001, True)])
def test_a_law_has_a_pole_where_a_denominator_vanishes_at_states_or_between_trials(constant, has_one):
    trials = cl.Trials.from_arrays(
        [TIMES] * 2, [np.exp(-TIMES) * 0.9, 2 + np.exp(-TIMES)], object=["a", "a"], names=["s"]
    )
    problem = prepare(trials, TERMS, np.full((1, 1, 2), np.nan))
    estimates = tuple(replace(start, coefficients=np.array([[1.0, constant]])) for start in problem.starts)
    assert any(has_pole(problem, o, estimate) for o, estimate in enumerate(estimates)) == has_one


def test_constants_are_told_where_a_term_bends_and_not_where_it_is_straight():
    fit = fitted(decaying(half=1.0), [(-1.0, 1.0)])
    np.testing.assert_allclose(fit.estimates[0].coefficients[0], [-1.0, 1.0], rtol=0.1)
    assert are_parameters_identifiable(fit)
    fit = fitted(decaying(noise=0.05), [(-60.0, 60.0)])
    assert not are_parameters_identifiable(fit)


def test_a_law_that_objects_would_share_only_where_it_is_linear_is_not_taken():
    """Of (a n + b n^2)/(K + n) three objects tell lines that meet, far from the logistic growth that they show."""
    generator, times, courses = np.random.default_rng(1013), np.linspace(0, 8, 50), []
    for rate, most in ((1.0, 3.0), (0.7, 4.0), (1.2, 5.0)):
        courses += [most / (1 + (most / start - 1) * np.exp(-rate * times)) for start in (0.3, 0.8)]
    noisy = [course + 0.05 * np.std(courses) * generator.standard_normal(len(times)) for course in courses]
    trials = cl.Trials.from_arrays([times] * 6, noisy, object=[*"aabbcc"], names=["n"])
    law = cl.discover(trials, library="ratio(poly:2, poly:2)", cache=False, order=1)
    assert law.structure == ("n' = a n + b n^2",)
