"""Telling hypotheses apart by measurements that are normal, against closed forms and published designs."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal, norm

from commonlaw.experiments.gaussian import Draws, Evidence, Gaussian
from commonlaw.experiments.predictive import Point, refitted

NOTHING = np.zeros((1, 0))


def point(mean, slopes, noise=1.0):
    """Return what a hypothesis says of one measurement without a start of its own."""
    return Gaussian(np.array([mean]), np.array([slopes], dtype=float), NOTHING, np.array([noise**2]))


def test_evidence_is_that_of_normal_densities():
    random = np.random.default_rng(0)
    parts = [
        Gaussian(random.normal(size=5), random.normal(size=(5, p)), np.zeros((5, 0)), random.uniform(1, 2, 5))
        for p in (2, 3)
    ]
    draws = Draws.of((2, 3), 5, 4, (1,), 0)
    found = Evidence.of(parts, draws)
    for i, (made, own) in enumerate(zip(parts, draws.unknowns, strict=True)):
        values = made.mean + own @ made.by_unknowns.T + draws.noise @ made.root.T
        for k, each in enumerate(parts):
            wanted = multivariate_normal(each.mean, np.diag(each.noise) + each.by_unknowns @ each.by_unknowns.T).logpdf(
                values
            )
            np.testing.assert_allclose(found.log_densities[i, :, k] - 2.5 * np.log(2 * np.pi), wanted, rtol=1e-10)


def test_trials_that_share_coefficients_add_up_as_if_they_were_one():
    random = np.random.default_rng(1)
    slopes, means = random.normal(size=(6, 2)), random.normal(size=(2, 6))
    whole = [Gaussian(mean, slopes, np.zeros((6, 0)), np.ones(6)) for mean in means]
    parts = [
        [Gaussian(m[own], slopes[own], np.zeros((3, 0)), np.ones(3)) for m in means] for own in (slice(3), slice(3, 6))
    ]
    unknowns, noise = tuple(random.normal(size=(2, 4, 2))), random.normal(size=(4, 6))
    together = Evidence.of(whole, Draws(unknowns, noise))
    one, two = (
        Evidence.of(part, Draws(unknowns, own)) for part, own in zip(parts, np.split(noise, 2, axis=1), strict=True)
    )
    np.testing.assert_allclose((one + two).log_densities, together.log_densities)


def test_a_free_start_is_the_limit_of_a_wide_prior():
    random = np.random.default_rng(2)
    times = np.linspace(0, 1, 8)
    starts = np.column_stack([np.ones(8), times])
    parts = [Gaussian(random.normal(size=8), random.normal(size=(8, 1)), starts, np.ones(8)) for _ in range(2)]
    draws = Draws.of((1, 1), 8, 5, (3,), 0)
    found = Evidence.of(parts, draws).log_densities
    wide = [
        Gaussian(each.mean, np.column_stack([each.by_unknowns, 1e4 * starts]), np.zeros((8, 0)), each.noise)
        for each in parts
    ]
    made = Draws(tuple(np.column_stack([own, np.zeros((5, 2))]) for own in draws.unknowns), draws.noise)
    limit = Evidence.of(wide, made).log_densities
    np.testing.assert_allclose(np.diff(found, axis=2), np.diff(limit, axis=2), atol=1e-5)


def test_chance_and_information_of_two_known_means():
    parts, prior, apart = [point(0.0, []), point(1.5, [])], np.array([0.5, 0.5]), 1.5
    found = Evidence.of(parts, Draws.of((0, 0), 1, 200_000, (0,), 0))
    assert found.chance(prior) == pytest.approx(norm.cdf(apart / 2), abs=2e-3)
    grid = np.linspace(-9, 11, 20001)
    one, two = norm.pdf(grid), norm.pdf(grid - apart)
    mixed = (one + two) / 2
    wanted = np.trapezoid(-mixed * np.log(mixed) + one * np.log(one) / 2 + two * np.log(two) / 2, grid)
    assert found.information_about_law(prior) == pytest.approx(wanted, abs=3e-3)


def test_repeats_count_as_independent_measurements():
    repeated = Gaussian(np.zeros(3), np.ones((3, 1)), np.zeros((3, 0)), np.ones(3), repeats=4)
    draws = Draws.of((1,), 3, 2, (0,), 0)
    (gain,) = Evidence.of([repeated], draws).gain()
    assert gain == pytest.approx(np.log(1 + 12) / 2)


def test_straight_line_is_measured_at_both_ends():
    """The D-optimal design of a straight line has half of its weight at each end."""
    grid = np.linspace(-1, 1, 21)
    gains = {
        both: np.linalg.slogdet(np.eye(2) + 1e6 * sum(np.outer((1, x), (1, x)) for x in both))[1]
        for both in combinations_with_replacement(grid, 4)
    }
    best = max(gains, key=gains.__getitem__)
    assert best == (-1, -1, 1, 1)
    trial = Gaussian(np.zeros(4), 1e3 * np.column_stack([np.ones(4), best]), np.zeros((4, 0)), np.ones(4))
    (gain,) = Evidence.of([trial], Draws.of((2,), 4, 1, (0,), 0)).gain()
    assert 2 * gain == pytest.approx(gains[best])


def weight(points, shares, noise, truth, rival):
    """Return the weight of evidence for a truth against what imitates it by coefficients of columns, at its means."""
    found = []
    for x, share in zip(points, shares, strict=True):
        level = noise / np.sqrt(share)
        hypotheses = [point(truth(x), [], level), point(0.0, 1e3 * np.array(rival(x)), level)]
        found.append(Evidence.of(hypotheses, Draws((np.zeros((1, 0)), np.zeros((1, len(rival(x))))), np.zeros((1, 1)))))
    total = found[0]
    for each in found[1:]:
        total += each
    return float(total.log_densities[0, 0, 0] - total.log_densities[0, 0, 1])


def test_a_line_is_told_from_a_constant_at_both_ends():
    points = np.linspace(-1, 1, 9)

    def value(at):
        return weight(at, np.full(len(at), 1.0), 0.01, lambda x: 1 + x, lambda _: [1.0])

    chosen = [0.0]
    for _ in range(31):
        chosen.append(max(points, key=lambda x: value([*chosen, x])))
    counts = np.array([chosen.count(x) for x in points])
    assert counts[[0, -1]].tolist() == [16, 15] or counts[[0, -1]].tolist() == [15, 16]


def test_discrimination_agrees_with_the_published_t_optimal_design():
    """Atkinson and Fedorov (1975), Biometrika 62, example 1: 4.5 - 1.5 exp(x) - 2 exp(-x) against a parabola.

    Measured at -1, -0.669, 0.144 and 0.957 with weights 0.253, 0.428, 0.247 and 0.072.
    """
    support, shares = np.array([-1, -0.669, 0.144, 0.957]), np.array([0.253, 0.428, 0.247, 0.072])
    noise = 1e-5

    def value(at, weights):
        found = weight(at, weights, noise, lambda x: 4.5 - 1.5 * np.exp(x) - 2 * np.exp(-x), lambda x: [1, x, x**2])
        return 2 * noise**2 * found

    best = value(support, shares)
    assert best == pytest.approx(1.087e-3, rel=2e-3)
    # A measurement elsewhere brings nowhere more than those that are there (the equivalence theorem)
    points, small = np.linspace(-1, 1, 41), 1e-4
    more = [value(np.append(support, x), np.append((1 - small) * shares, small)) for x in points]
    assert max(more) < (1 + 1e-5) * best
    assert value(points, np.full(41, 1 / 41)) < 0.7 * best


def test_fits_to_lines_are_the_lines():
    """Where a law is linear, lines about other coefficients and another start say the same of all measurements."""
    random = np.random.default_rng(2)
    matrices = [(random.normal(size=6), random.normal(size=(6, 2)), random.normal(size=(6, 1))) for _ in range(2)]

    def linearise(k):
        mean, slopes, by_start = matrices[k]
        return lambda _, points: [
            Gaussian(mean + slopes @ each.unknowns + by_start @ each.shifts, slopes, by_start, np.full(6, 0.04))
            for each in points
        ]

    draws = Draws.of((2, 2), 6, 5, (0,), 0)
    begin = Point(np.zeros(2), np.zeros(1))
    lines = [linearise(k)(0, [begin])[0] for k in range(2)]
    made = [each.mean + own @ each.by_unknowns.T for each, own in zip(lines, draws.unknowns, strict=True)]
    measured = [row + 0.2 * noise for each in made for row, noise in zip(each, draws.noise, strict=True)]
    fits = [refitted([lines[k]] * 10, [begin] * 10, measured, linearise(k)) for k in range(2)]
    np.testing.assert_allclose(
        Evidence.refitted(measured, fits).log_densities, Evidence.of(lines, draws).log_densities, rtol=1e-8
    )


def test_coefficients_are_fitted_within_their_errors():
    """Of exp(u t) with u standard normal the fit is nearly that of nonlinear least squares; a line goes through it."""
    times, measured = np.linspace(0.1, 1, 8), np.exp(0.7 * np.linspace(0.1, 1, 8))

    def linearise(_, points):
        values = [np.exp(each.unknowns[0] * times) for each in points]
        return [Gaussian(own, (times * own)[:, np.newaxis], np.zeros((8, 0)), np.full(8, 0.04)) for own in values]

    begin = Point(np.zeros(1), np.zeros(0))
    (found,) = refitted(linearise(0, [begin]), [begin], [measured], linearise)

    def deviance(u):
        return np.sum((measured - np.exp(u * times)) ** 2) / 0.04 + u**2

    unknown = np.log(found.by_unknowns[0, 0] / times[0]) / times[0]
    assert deviance(unknown) < minimize_scalar(deviance).fun + 1 < deviance(0)
    np.testing.assert_allclose(found.mean, np.exp(unknown * times) * (1 - unknown * times))


@pytest.mark.parametrize("common", [None, np.full((3, 3), 0.5)], ids=["white", "common"])
def test_errors_are_turned_white(common):
    own = Gaussian(np.zeros(3), np.zeros((3, 0)), np.zeros((3, 0)), np.array([1.0, 4.0, 9.0]), common=common, repeats=4)
    turned = own.white(np.eye(3))
    covariance = np.diag([0.25, 1.0, 2.25]) + (0.0 if common is None else common)
    np.testing.assert_allclose(turned @ covariance @ turned.T, np.eye(3), atol=1e-12)


def test_errors_whose_numbers_are_too_far_apart_say_nothing():
    near, far = np.diag([1.0, 1.0]), np.array([[1e40, 1e40], [1e40, 1e40 * (1 + 1e-15)]])
    for coloured, is_finite in ((near, True), (-far, False), (np.diag([np.inf, np.inf]), False)):
        said = Gaussian(np.zeros(2), np.zeros((2, 0)), np.zeros((2, 0)), np.ones(2), coloured)
        assert said.is_finite == is_finite
