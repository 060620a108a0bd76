from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from commonlaw.differentiation import FiniteDifference
from commonlaw.formulation import (
    CompressedTrials,
    LeastSquaresProblem,
    WeakForm,
    law_variables,
    merge,
    reweight,
    rows_by_object,
)
from commonlaw.formulation.weak import MIN_RADIUS, CompactTestFunctions, corner_radius
from commonlaw.library import PolynomialLibrary, parse_library
from commonlaw.solvers import BestSubset
from commonlaw.trials import Schema, Trial, Trials
from tests.refusals import refused

LORENZ = np.array([[-10.0, 10, 0, 0, 0], [28, -1, 0, 0, -1], [0, 0, -8 / 3, 1, 0]])
LORENZ_TERMS = "terms:x,y,z,x*y,x*z"
SWING = np.array([[0, 1.0, 0], [-1, -0.3, -0.8]])
SWING_TERMS = "terms:x,y,x**3"


def regular(samples, length):
    return np.linspace(0, length, samples)


def uneven(samples, length):
    times = regular(samples, length)
    return times + 0.3 * times[1] * np.random.default_rng(5).uniform(-1, 1, samples)


@cache
def solution(problem):
    """Return exact trajectories as functions of time."""
    field, start, length = {
        "lorenz": (lambda _, y: LORENZ @ [*y, y[0] * y[1], y[0] * y[2]], [-8.0, 8, 27], 5.5),
        "swing": (lambda _, y: SWING @ [*y, y[0] ** 3], [2.0, 0], 12.5),
        "drag": (lambda _, y: [y[1], -9.8 - 0.38 * y[1]], [40.0, 0], 4.0),
        "van der pol": (lambda _, y: [y[1], (1 - y[0] ** 2) * y[1] - y[0]], [1.0, 0.5], 12.5),
        "v squared": (lambda _, y: [y[1], -0.1 * y[1] - y[0] + 0.2 * y[1] ** 2], [1.0, 0.5], 12.5),
    }[problem]
    return solve_ivp(field, (-0.1, length), start, method="DOP853", rtol=1e-13, atol=1e-13, dense_output=True).sol


def trials_of(problem, times, noise=0.0, seed=0, states=2):
    exact = solution(problem)(times).T[:, :states]
    noisy = exact + noise * exact.std(axis=0) * np.random.default_rng(seed).standard_normal(exact.shape)
    return Trials((Trial("it", "1", times, noisy),), Schema(("x", "y", "z")[:states]))


def bound(library, form, trials):
    return parse_library(library).bind(law_variables(trials.schema, form.order))


@pytest.mark.parametrize("grid", [regular, uneven])
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_weights_integrate_what_adaptive_quadrature_integrates(grid, derivative):
    times = grid(200, 4 * np.pi)
    test_functions = CompactTestFunctions.over(times, 20, MIN_RADIUS)
    weights = test_functions.weights(times, 2)[derivative]

    def bump(s):
        powers = np.polynomial.Polynomial([1, 0, -1]) ** 16
        return powers.deriv(derivative)(s) if derivative else powers(s)

    for row in (0, len(test_functions.centres) // 2):
        centre, radius = test_functions.centres[row], test_functions.radii[row]
        value, _ = quad(
            lambda s, c=centre, r=radius: bump(s) * np.cos(c + r * s) * r ** (1 - derivative), -1, 1, epsabs=1e-13
        )
        scale = quad(lambda s, r=radius: np.abs(bump(s)) * r ** (1 - derivative), -1, 1, limit=200)[0]
        assert (weights @ np.cos(times))[row] == pytest.approx(value, abs=1e-9 * scale)


@pytest.mark.parametrize("grid", [regular, uneven])
@pytest.mark.parametrize(
    ("problem", "library", "truth", "samples", "length"),
    [("lorenz", LORENZ_TERMS, LORENZ, 1000, 5.0), ("swing", SWING_TERMS, SWING, 600, 12.0)],
)
def test_without_noise_rows_balance_below_1e_8(grid, problem, library, truth, samples, length):
    trials = trials_of(problem, grid(samples, length), states=len(truth))
    form = WeakForm()
    rows, targets = form.rows(trials[0], bound(library, form, trials))
    assert np.abs(rows @ truth.T - targets).max() < 1e-8 * np.abs(targets).max()
    found = np.linalg.lstsq(rows, targets, rcond=None)[0].T
    np.testing.assert_allclose(found, truth, atol=1e-7)


def test_terms_by_parts_need_no_rates():
    trials = trials_of("van der pol", regular(600, 12.0), noise=0.05, states=1)
    library = "terms:x,v,x**2*v,v**2,x*v**2"
    plain, coarse = (
        WeakForm(2, differentiation=FiniteDifference(accuracy)).rows(trials[0], bound(library, WeakForm(2), trials))[0]
        for accuracy in (2, 6)
    )
    np.testing.assert_array_equal(plain[:, :3], coarse[:, :3])
    assert not np.allclose(plain[:, 3:], coarse[:, 3:])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("grid", "order", "library", "truth"), [(regular, 1, SWING_TERMS, SWING), (uneven, 2, "terms:x,v,x**3", SWING[1:])]
)
def test_covariance_is_that_of_many_draws(grid, order, library, truth):
    draws, noise, times = 300, 0.02, grid(150, 10.0)
    clean = trials_of("swing", times, states=3 - order)
    deviations = tuple(noise * clean[0].states.std(axis=0))
    form = WeakForm(order, noise=deviations, radii=(15.0,), differentiation=FiniteDifference(6))
    terms = bound(library, form, clean)
    expected = form.tested(clean[0], terms)
    residuals = []
    for seed in range(draws):
        tested = form.tested(trials_of("swing", times, noise, seed, 3 - order)[0], terms)
        residuals.append(tested.targets - tested.library @ truth.T)
    for equation, row in enumerate(truth):
        covariance = expected.covariance(row, equation).toarray()
        sample = np.array(residuals)[:, :, equation]
        variances = np.diag(covariance)
        # The sampling error of a variance is sqrt(2 / draws) = 8 %
        np.testing.assert_allclose(np.mean(sample**2, axis=0), variances, rtol=0.35)
        correlation = (sample.T @ sample / draws - covariance) / np.sqrt(np.outer(variances, variances))
        assert np.abs(correlation).max() < 0.35
        assert np.sqrt(np.mean(correlation**2)) < 1.5 / np.sqrt(draws)


def test_whitened_rows_leave_residuals_of_unit_variance():
    left = []
    for seed in range(8):
        trials = trials_of("swing", regular(300, 12.0), 0.03, seed, 1)
        form = WeakForm(2, noise=tuple(0.03 * trials_of("swing", regular(300, 12.0), states=1)[0].states.std(axis=0)))
        terms = bound("terms:x,v,x**3", form, trials)
        form, coefficients = reweight(trials, terms, form)
        rows, targets = form.rows(trials[0], terms)
        left.append(targets - rows @ coefficients["it"].T)
    assert np.mean(np.square(left[0].ravel())) < 3
    everything = np.concatenate([each.ravel() for each in left])
    assert np.mean(everything**2) == pytest.approx(1, abs=0.15)


def test_whitening_is_generalised_least_squares_with_the_dense_covariance():
    trials = trials_of("swing", regular(150, 10.0), 0.02)
    terms = bound(SWING_TERMS, WeakForm(), trials)
    form = WeakForm(coefficients={"it": SWING}, equation=1)
    tested = form.tested(trials[0], terms)
    inverse = np.linalg.inv(tested.covariance(SWING[1], 1).toarray())
    normal = tested.library.T @ inverse @ tested.library
    expected = np.linalg.solve(normal, tested.library.T @ inverse @ tested.targets[:, 1])
    found = merge(form.problems(trials[0], terms)).least_squares(np.ones(3, dtype=bool), 1)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_systems_are_the_parts_of_the_rows_and_merge():
    trials = trials_of("swing", uneven(400, 12.0), 0.02)
    terms = bound(SWING_TERMS, WeakForm(), trials)
    form, _ = reweight(trials, terms, WeakForm())
    rows, everything = form.rows(trials[0], terms), np.ones(3, dtype=bool)
    problems = form.problems(trials[0], terms, 4)
    assert len(problems) == 4
    whole = LeastSquaresProblem.of(*rows)
    np.testing.assert_allclose(
        merge(problems).least_squares(everything, 1), whole.least_squares(everything, 1), rtol=1e-9
    )


def test_solvers_find_the_law_in_compressed_trials():
    exact = trials_of("lorenz", regular(1000, 5.0), 0.02, states=3)
    trials = Trials((exact[0], Trial("it", "2", *_noisy(7)), Trial("other", "1", *_noisy(8))), exact.schema)
    terms = PolynomialLibrary(2).bind(law_variables(trials.schema, 1))
    form, _ = reweight(trials, terms, WeakForm())
    data = CompressedTrials.of(rows_by_object(trials, form, terms, segments=4), trials.schema)
    names = [{"x", "y"}, {"x", "y", "x z"}, {"z", "x y"}]
    for equation, wanted in enumerate(names):
        path = BestSubset().path(data.problems, equation, np.ones(10, dtype=bool))
        found = next(each for each in path if each.support[0].sum() == len(wanted))
        assert {terms.names[i] for i in np.flatnonzero(found.support[0])} == wanted


def _noisy(seed):
    trial = trials_of("lorenz", regular(1000, 5.0), 0.02, seed, 3)[0]
    return trial.times, trial.states


def test_the_radius_follows_the_slowness_of_the_state():
    times = regular(2000, 20.0)
    noise = np.random.default_rng(0).standard_normal((2000, 1)) * 0.05
    slow, fast = (
        corner_radius(times, np.sin(frequency * times)[:, None] + noise, np.array([0.05])) for frequency in (2, 8)
    )
    assert 1.5 < slow / fast < 8
    assert corner_radius(times, np.sin(times)[:, None], np.array([1e-12])) == MIN_RADIUS


def test_test_functions_over_a_gap_are_left_out():
    times = np.delete(regular(400, 8 * np.pi), slice(150, 200))
    test_functions = CompactTestFunctions.over(times, 15, MIN_RADIUS)
    inside = np.abs(test_functions.centres - times[149:151].mean()) < test_functions.radii
    assert len(test_functions.centres) > 20
    assert not inside.any()


def test_several_radii_give_the_test_functions_of_each():
    trials = trials_of("swing", regular(400, 12.0), 0.02)
    terms = bound(SWING_TERMS, WeakForm(), trials)
    counts = [len(WeakForm(radii=radii).rows(trials[0], terms)[0]) for radii in ((15.0,), (40.0,), (15.0, 40.0))]
    assert counts[2] == counts[0] + counts[1]


def test_what_cannot_be_is_said():
    with refused("order-one-or-two"):
        WeakForm((1, 2))
    short = trials_of("swing", regular(20, 1.0))
    with refused("weak-too-few-samples", samples=20, least=29, where="it, trial 1"):
        WeakForm().rows(short[0], bound(SWING_TERMS, WeakForm(), short))
    trials = trials_of("swing", regular(60, 3.0), 0.01)
    terms = bound(SWING_TERMS, WeakForm(), trials)
    with refused("weak-noise-size", given=1, states=2):
        WeakForm(noise=(0.1,)).rows(trials[0], terms)
    with refused("weak-whitening", given="none", object="it"):
        WeakForm(coefficients={}).rows(trials[0], terms)
    with refused("weak-equation", equation=2, equations=2):
        WeakForm(coefficients={"it": SWING}, equation=2).rows(trials[0], terms)
    with refused("weak-too-few-rows", segments=500):
        WeakForm().problems(trials[0], terms, 500)
    with refused("order-one-or-two", order=3):
        WeakForm(3)
    with refused("weak-radii"):
        WeakForm(radii=(1.0,))
    with refused("weak-noise"):
        WeakForm(noise=(-1.0,))
    line = Trials((Trial("it", "1", regular(60, 3.0), np.linspace(0, 1, 60)),), Schema(("x",)))
    with refused("term-not-finite", term="1/x", value="infinite", sample="1", where="it, trial 1"):
        WeakForm().rows(line[0], bound("terms:1/x", WeakForm(), line))
