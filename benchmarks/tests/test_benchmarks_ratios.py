"""What ratios of two sums are measured by is right: the bounds, and what a line of the table says."""

import numpy as np
from scipy.optimize import curve_fit
from scipy.special import lambertw

from benchmarks.ratios import KINETICS, line


def test_bounds_are_the_standard_errors_of_least_squares_on_the_exact_solution():
    known = KINETICS["Michaelis-Menten"]

    def both(times, rate, half, *starts):
        parts = [half * lambertw(s / half * np.exp((s - rate * times) / half)).real for s in starts]
        return np.concatenate(parts)

    noise = known.noise(0.05)
    for name, bound in zip(known.objects.values(), known.bounds(0.05), strict=True):
        exact = both(known.times, *name, *known.starts)
        np.testing.assert_allclose(exact, np.concatenate([known.solution(s, name) for s in known.starts]), rtol=1e-7)
        given = [*name, *known.starts]
        _, covariance = curve_fit(both, known.times, exact, given, np.full(len(exact), noise), absolute_sigma=True)
        np.testing.assert_allclose(bound, np.sqrt(np.diag(covariance))[:2], rtol=1e-3)


def test_a_line_says_how_many_laws_are_right():
    assert line("decay", 0.05, 1).startswith("| decay | 5 % | 1 of 1 |  |  |")
