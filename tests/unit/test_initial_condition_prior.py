"""Starts that trials have alike, in the evidence for laws: beside normal distributions written out whole."""

from itertools import product

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from commonlaw.inference.fit.annealing import fit_with
from commonlaw.inference.fit.initial_condition_prior import InitialConditionPrior
from commonlaw.inference.fit.problem import prepare
from commonlaw.likelihood import linearize, whitened_with_initial_states
from commonlaw.trials import Schema, Trial, Trials
from tests.unit.trajectories import SUPPORT, of_prey, prey, terms_of

NOISE = 0.3


def falling(std, seed=0, trials=6):
    """Trials of one object with the acceleration -2, ever longer, from starts of these standard deviations."""
    generator = np.random.default_rng(seed)
    found = []
    for i in range(trials):
        start, rate = np.array([40.0, 1.0]) + np.array(std) * generator.standard_normal(2)
        times = np.linspace(0, 2 + i / 2, 31)
        heights = start + rate * times - times**2 + NOISE * generator.standard_normal(31)
        found.append(Trial("ball", f"{i}", times, heights[:, np.newaxis], np.empty((31, 0))))
    return Trials(tuple(found), Schema(("x",), time="t"))


def fitted(trials, term):
    """The fit of these trials with one term, of 1 and t."""
    terms = terms_of("terms:1,t", ("x", "v"), order=2)
    problem = prepare(trials, terms, np.full((1, 1, 2), np.nan), noise=np.array([NOISE]))
    return fit_with(problem, np.array([[name == term for name in terms.names]]), 0.0)


def expected(trials, effect):
    """Minus twice the log-density with starts that are normal, less that with any start."""
    heights = np.concatenate([trial.states[:, 0] for trial in trials])
    own = [np.column_stack([np.ones_like(trial.times), trial.times]) for trial in trials]
    starts, of_means = block_diag(*own), np.vstack(own)
    effects = np.concatenate([effect(trial.times) for trial in trials])[:, np.newaxis]
    columns = np.column_stack([starts, effects])
    found = np.linalg.lstsq(columns, heights, rcond=None)[0]
    free = np.sum((heights - columns @ found) ** 2) / NOISE**2 + np.linalg.slogdet(starts.T @ starts)[1]
    asked = found[:-1].reshape(-1, 2)
    typical = np.mean((asked - asked.mean(axis=0)) ** 2, axis=0)
    values = []
    for shares in product(10.0 ** np.arange(-4, 2), repeat=2):
        scatter = np.diag(np.tile(typical * shares, len(trials)))
        density = multivariate_normal(
            np.zeros(len(heights)), NOISE**2 * np.eye(len(heights)) + starts @ scatter @ starts.T
        )
        white = np.linalg.cholesky(density.cov_object.covariance)
        fixed = np.linalg.solve(white, np.column_stack([of_means, effects]))
        best = np.linalg.lstsq(fixed, np.linalg.solve(white, heights), rcond=None)[0]
        values.append(-2 * density.logpdf(heights - np.column_stack([of_means, effects]) @ best))
    return min(values) - free


@pytest.mark.parametrize("std", [(0.1, 0.05), (3.0, 0.05), (3.0, 2.0)])
def test_the_price_of_starts_is_that_of_their_normal_distribution(std):
    trials = falling(std)
    found = InitialConditionPrior(fitted(trials, "1")).correction(fitted(trials, "t"))
    wanted = expected(trials, lambda t: t**3) - expected(trials, np.square)
    assert found == pytest.approx(wanted, abs=0.1)


def test_starts_far_apart_hardly_tell_laws_apart():
    corrections = []
    for std in (0.05, 20.0):
        right, wrong = (fitted(falling((std, std)), term) for term in "1t")
        corrections.append(InitialConditionPrior(right).correction(wrong))
    assert corrections[0] > 3
    assert abs(corrections[1]) < 1


def test_few_trials_say_nothing_of_starts():
    trials = falling((0.1, 0.1), trials=2)
    right, other = (fitted(trials, term) for term in "1t")
    starts = InitialConditionPrior(right)
    assert starts.correction(other) == 0
    assert starts.near(right)(other.supports) == 0


def test_what_is_promised_near_a_law_is_the_price_of_it_where_starts_scatter_alike():
    right = fitted(falling((0.1, 0.05)), "1")
    starts = InitialConditionPrior(right)
    assert starts.near(right)(right.supports) == pytest.approx(0, abs=1e-6)
    more = starts.near(right)(np.array([[True, True]]))
    assert more == pytest.approx(starts.correction(fit_with(right.problem, np.array([[True, True]]), 0.0)), abs=0.5)


def test_rows_with_starts_as_columns_are_those_with_starts_eliminated():
    model, start = of_prey(prey()[1])
    rows, log_determinant = whitened_with_initial_states(model, start, 0.1, SUPPORT)
    left = []
    for row in rows:
        factor = np.asarray(np.linalg.qr(row, mode="r"))
        log_determinant += 2 * np.sum(np.log(np.abs(np.diag(factor)[:2])))
        left.append(factor[2:, 2:])
    whole = linearize(model, start, 0.1, SUPPORT)
    eliminated = np.abs(whole.problem.factor)
    factor = np.abs(np.asarray(np.linalg.qr(np.concatenate(left), mode="r")))
    np.testing.assert_allclose(factor, eliminated, rtol=1e-6, atol=1e-6 * eliminated.max())
    noise = np.concatenate([np.broadcast_to(mesh.scale, mesh.measured.shape)[mesh.first] for mesh in model.meshes])
    # Given where each trial starts, less what was measured there
    assert log_determinant + 2 * np.sum(np.log(noise * model.observation.noise)) == pytest.approx(
        whole.log_determinant, abs=1e-6
    )
