"""Laws of data that mislead: large swings, many short trials, time scales, and measurements more exact than a mesh."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw.law.parameters import standard_errors
from tests.simulations import solved


def _rates(_: float, z: np.ndarray) -> list[float]:
    return [-1.1 * z[0] + 0.031 * z[0] * z[1], 0.0109 * z[1] ** 2 - 0.00054 * z[0] * z[1] ** 2]


@pytest.mark.slow
def test_few_samples_of_large_swings_are_not_all_taken_for_outliers():
    generator, times = np.random.default_rng(22), np.arange(0.0, 13.0)
    states = solved(_rates, [4.0, 30.0], times)
    noise = generator.uniform(2, 5)
    states = np.abs(states + noise * generator.standard_normal(states.shape)).round(1) + 0.1
    law = cl.discover(cl.Trials.from_arrays([times], [states], names=["x", "y"]), library="poly:3", order=1)
    assert law.uncertainty.misfit.outliers == 0
    # The data hardly tell them apart
    plausible = {model.law.structure: model.probability for model in law.models}
    assert plausible["x' = a x + b x y", "y' = c y^2 + d x y^2"] > 0.3


@pytest.mark.slow
def test_what_objects_have_in_common_is_found_among_many():
    # From rest at one height, v^2 and x are nearly functions of each other, and many laws fit nearly as well
    drag = -np.random.default_rng([1, 30]).uniform(0.1, 0.8, 30)
    drops = cl.datasets.linear_drag(drag=tuple(drag), trials=1, noise=0.2, seed=1)
    law = cl.discover(drops, order=2, library="poly:2")
    assert law.structure == ("x'' = a + b v",)
    errors = standard_errors(law)[:, 0, law.terms.index("v")]
    misses = (law.coefficients[:, 0, law.terms.index("v")] - drag) / errors
    assert np.sqrt(np.mean(misses**2)) < 1.5


@pytest.mark.slow
def test_the_discretization_error_of_a_coarse_mesh_is_no_reason_for_richer_terms():
    def rates(_, y, s, r, b):
        return [s * (y[1] - y[0]), y[0] * (r - y[2]) - y[1], y[0] * y[1] - b * y[2]]

    times, messages = np.linspace(0, 1.5, 100), []
    first = solved(rates, (-5.0, -2.0, 20.0), times, 10.0, 28.0, 2.7)
    measured = [first, solved(rates, (3.0, 6.0, 25.0), times, 9.6, 26.5, 2.5)]
    trials = cl.Trials.from_arrays([times] * 2, measured, object=["a", "b"], names=["x", "y", "z"])
    law = cl.discover(trials, order=1, cache=False, progress=messages.append)
    assert law.structure == ("x' = a x + b y", "y' = c x + d y + f x z", "z' = g z + h x y")
    assert not any("proposing" in each for each in messages)


def test_cups_that_cool_at_different_rates_cool_by_newtons_law():
    generator, minutes = np.random.default_rng(3), np.arange(0, 61, 3.0)
    frames = []
    for cup, rate in {"ceramic": 0.031, "steel": 0.012, "paper": 0.045}.items():
        for copy in "ab":
            drop = (66.5 - 3 * generator.random()) * np.exp(-rate * minutes)
            noisy = 21.5 + drop + 0.3 * generator.standard_normal(len(minutes))
            frames.append(pd.DataFrame({"cup": cup + copy, "t": minutes, "T": noisy}))
    law = cl.discover(pd.concat(frames, ignore_index=True), cache=False)
    assert law.structure == ("T' = a + b T",)
    ratios = -law.coefficients[:, 0, 0] / law.coefficients[:, 0, 1]
    np.testing.assert_allclose(np.median(ratios), 21.5, rtol=0.1)


@pytest.mark.parametrize(
    ("rates", "starts", "duration", "expected"),
    [
        (lambda _, y: [y[0] - y[0] ** 3], [[0.1], [-1.8]], 6, [{"p", "p^3"}]),
        pytest.param(
            lambda _, y: [1.1 * y[0] - 0.4 * y[0] * y[1], 0.1 * y[0] * y[1] - 0.4 * y[1]],
            [[10, 10], [5, 3]],
            30,
            [{"p", "p q"}, {"q", "p q"}],
            marks=pytest.mark.slow,
        ),
    ],
    ids=["double well", "predation"],
)
def test_errors_of_a_solver_are_not_explained_by_terms(rates, starts, duration, expected):
    """Its local errors are smooth, and add up to more than any noise that samples show."""
    times = np.linspace(0, duration, 80 if duration < 10 else 300)
    curves = [solve_ivp(rates, (0, duration), start, t_eval=times, rtol=1e-5).y.T for start in starts]
    law = cl.discover(cl.Trials.from_arrays([times] * 2, curves, names=["p", "q"][: len(starts[0])]))
    assert [set(np.array(law.terms.names)[support]) for support in law.support] == expected
    assert not law.uncertainty.error_model
