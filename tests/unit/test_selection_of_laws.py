"""Selection on the data sets: from trials to the law that made them."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.differentiation import parse_differentiation
from commonlaw.formulation import StrongForm, differentiation_bias, effective_share, law_variables, merge
from commonlaw.law import Law, Provenance
from commonlaw.library import PolynomialLibrary
from commonlaw.selection.cross_validation import ForecastError, make_folds
from commonlaw.selection.rules import choose
from commonlaw.solvers import STLSQ
from tests.refusals import refused


class Problem:
    """Trials on their way to a law: systems of parts, and what the rates are worth."""

    def __init__(self, trials, order, differentiation, trim=0):
        self.trials = trials
        self.form = StrongForm(parse_differentiation(differentiation), order, "smoothed", trim)
        self.terms = PolynomialLibrary(3).bind(law_variables(trials.schema, order))
        self.allowed = np.ones(len(self.terms), dtype=bool)
        self.of = [trials.of_object(name) for name in trials.objects]
        self.parts = [[self.form.problems(trial, self.terms, 4) for trial in own] for own in self.of]
        self.problems = [merge(block for trial in part for block in trial) for part in self.parts]

    def fits(self, support):
        """Coefficients of every object, shape (objects, equations, terms)."""
        return np.array([[s.least_squares(own, j) for j, own in enumerate(support)] for s in self.problems])

    def choose(self, target, **options):
        def accuracy(coefficients):
            pairs = zip(self.of, coefficients, strict=True)
            return np.array([differentiation_bias(self.form, self.terms, own, target, fit) for own, fit in pairs])

        cut = 2 * self.form.trim
        rows = np.array([sum(effective_share(self.form, each) * (len(each) - cut) for each in own) for own in self.of])
        candidates = STLSQ().path(self.problems, target, self.allowed)
        options = {"rows": rows, "differentiation_bias": accuracy, **options}
        return choose(candidates, self.parts, target, self.allowed, **options)

    def names(self, choice):
        inside = choice.chosen.support.all(axis=0)
        return [name for name, used in zip(self.terms.names, inside, strict=True) if used]


@pytest.mark.parametrize("seed", range(2))
def test_linear_drag_is_found_in_noise(seed):
    drops = Problem(cl.datasets.linear_drag(noise=0.05, seed=seed), 2, "savgol:25:3", 8)
    assert drops.names(drops.choose(0)) == ["1", "v"]


@pytest.mark.parametrize(("noise", "differentiation"), [(0.0, "finite:2"), (0.1, "savgol:9:3")])
def test_prey_and_predators_are_found_with_and_without_noise(noise, differentiation):
    pairs = Problem(cl.datasets.lotka_volterra(noise=noise), 1, differentiation)
    assert pairs.names(pairs.choose(0)) == ["x", "x y"]
    assert pairs.names(pairs.choose(1)) == ["y", "x y"]


def test_without_the_resolution_terms_are_found_that_the_differentiator_made():
    pairs = Problem(cl.datasets.lotka_volterra(), 1, "finite:2")
    assert len(pairs.names(pairs.choose(0, differentiation_bias=None))) > 2


def two_pairs(**options):
    rates = {"growth": [1.0, 0.8], "predation": 0.1, "decline": 1.2, "reproduction": 0.06}
    return cl.datasets.lotka_volterra(**rates, **options)


def forecasts(problem, target):
    """The score of an equation's supports by forecasts of trials that were held out, the truth in the others."""
    truth = [np.isin(problem.terms.names, names) for names in (["x", "x y"], ["y", "x y"])]
    trials = problem.trials
    provenance = Provenance(problem.form.differentiation)
    law = Law(problem.terms, trials.schema, 1, trials.objects, problem.fits(truth), provenance=provenance)
    free = np.ones((2, len(problem.terms)), dtype=bool)
    return ForecastError(make_folds(problem.parts), target, law, free, trials)


def test_forecast_errors_are_those_of_laws_fitted_to_the_other_trials():
    pairs = Problem(two_pairs(), 1, "finite:6")
    score = forecasts(pairs, 0)
    found = score(np.repeat([np.isin(pairs.terms.names, ["x", "x y"])], 2, axis=0))
    assert found.errors.shape == (4,)
    name = pairs.trials.objects[1]
    held, rest = pairs.trials.select(object=name)[[0]], pairs.trials.select(object=name)[[1]]
    library, targets = pairs.form.rows(rest[0], pairs.terms)
    coefficients = np.zeros((1, 2, library.shape[1]))
    for j, support in enumerate((["x", "x y"], ["y", "x y"])):
        indices = [pairs.terms.index(term) for term in support]
        coefficients[0, j, indices] = np.linalg.lstsq(library[:, indices], targets[:, j], rcond=None)[0]
    forecast = Law(pairs.terms, held.schema, 1, (name,), coefficients).predict(held)
    gaps = forecast.trajectories[0].states - held[0].states
    spread = np.var(np.concatenate([held[0].states, rest[0].states]), axis=0)
    assert found.errors[2] == pytest.approx(np.mean(np.mean(gaps**2, axis=0) / spread), rel=1e-4)


def test_forecasts_choose_a_law_too():
    pairs = Problem(two_pairs(noise=0.05, samples=100), 1, "savgol:9:3")
    choice = pairs.choose(0, score=forecasts(pairs, 0))
    assert set(pairs.names(choice)) >= {"x", "x y"}
    assert choice.table[choice.index].held_out.mean < 0.05


def test_a_single_trial_cannot_be_held_out_and_forecast():
    pairs = Problem(cl.datasets.lotka_volterra(trials=1), 1, "finite:6")
    with refused("one-trial-to-forecast", object="Pair 1"):
        forecasts(pairs, 0)
