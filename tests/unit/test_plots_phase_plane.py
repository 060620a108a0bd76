"""Phase planes and profile likelihoods, held against closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import commonlaw as cl
from commonlaw.estimation import likelihood_profile
from commonlaw.law import Law, select_objects
from commonlaw.law.equilibria import fixed_points, kind
from commonlaw.plots import plot_phase_plane, plot_profile
from commonlaw.trials import Trials
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("few_starts")


def points_of(law, low, high):
    """Return the fixed points in a box, with eigenvalues and kinds."""
    found = fixed_points(law, law.coefficients[0], np.array(low), np.array(high), {})
    return [(state, np.sort_complex(values), kind(values)) for state, values in found]


def test_fixed_points_of_predator_and_prey_are_a_saddle_and_a_centre():
    values = {"a": 1.0, "b": 0.1, "c": 1.5, "d": 0.075}
    law = Law.from_text("x' = a x - b x y; y' = -c y + d x y", values)
    saddle, centre = points_of(law, (-5.0, -5.0), (60.0, 40.0))
    np.testing.assert_allclose(saddle[0], (0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(saddle[1], (-1.5, 1.0), rtol=1e-6)
    np.testing.assert_allclose(centre[0], (1.5 / 0.075, 1.0 / 0.1), rtol=1e-9)
    np.testing.assert_allclose(np.abs(centre[1].imag), np.sqrt(1.0 * 1.5), rtol=1e-6)
    assert (saddle[2], centre[2]) == ("saddle", "centre of its linearization")


@pytest.mark.parametrize(
    ("damping", "name"),
    [(0.5, "stable focus"), (3.0, "stable node"), (-0.5, "unstable focus"), (-3.0, "unstable node")],
)
def test_the_pendulum_at_rest_is_a_node_or_a_focus_by_its_damping(damping, name):
    law = Law.from_text("x'' = -sin(x) - c v", {"c": damping})
    lowest, highest = points_of(law, [-1.0], [4.0])
    np.testing.assert_allclose([lowest[0], highest[0]], [[0.0], [np.pi]], atol=1e-9)
    assert (lowest[2], highest[2]) == (name, "saddle")
    np.testing.assert_allclose(lowest[1], np.sort_complex(np.roots([1.0, damping, 1.0])), atol=1e-9)


def test_a_fixed_point_follows_its_input():
    law = Law.from_text("x' = u - x^2", inputs=["u"])
    found = fixed_points(law, law.coefficients[0], np.array([0.1]), np.array([9.0]), {"u": 4.0})
    assert [(state.tolist(), values.tolist()) for state, values in found] == [([2.0], [-4.0])]


def test_phase_planes_have_nullclines_fixed_points_and_trajectories():
    pairs = cl.datasets.lotka_volterra(trials=1)
    figure = plot_phase_plane(cl.datasets.lotka_volterra.truth(), pairs, "Pair 1")
    (panel,) = figure.axes
    shown = [text.get_text() for text in figure.legends[0].get_texts()]
    fit = "fit, from its initial state"
    assert shown == ["$x$ constant", "$y$ constant", fit, "saddle", "centre of its linearization"]
    assert figure.get_figwidth() <= 9.0
    assert panel.get_title() == "Pair 1"
    two = select_objects(cl.datasets.lotka_volterra.truth(), ["Pair 1", "Pair 2"])
    several = plot_phase_plane(two, pairs.select(object=two.objects))
    assert [each.get_title() for each in several.axes] == ["Pair 1", "Pair 2"]
    assert len({(each.get_xlim(), each.get_ylim()) for each in several.axes}) == 1
    for each, at in zip(several.axes, two.coefficients, strict=True):
        (centre,) = (line.get_xydata()[0] for line in each.lines if line.get_marker() == "D")
        a, b, c, d = at[0][at[0] != 0].tolist() + at[1][at[1] != 0].tolist()
        np.testing.assert_allclose(centre, (-c / d, -a / b), rtol=1e-9)
    with refused("phase-plane-states"):
        plot_phase_plane(cl.datasets.lorenz.truth(), cl.datasets.lorenz())
    with refused("phase-plane-time"):
        law = Law.from_text("x'' = -x + sin(t)")
        plot_phase_plane(law, cl.Trials.from_arrays([0.0, 1.0, 2.0], [1.0, 0.5, 0.0], names=["x"]))


def test_phase_planes_of_laws_with_observation_equations_are_of_their_states():
    random, times = np.random.default_rng(3), np.linspace(0.0, 8.0, 50)
    exact = solve_ivp(lambda _, s: (s[1], -2 * s[0] - 0.4 * s[1]), (0, 8), (1.5, 0.0), t_eval=times, rtol=1e-10).y
    signal = 3 * exact[0] + 0.5 + 0.001 * random.standard_normal(50)
    trials = Trials.from_arrays(times, signal, names=["signal"])
    law = cl.fit("x'' = -k x - c v; signal = 3 x + 0.5", trials)
    forecast = law.predict(trials, start="all")
    np.testing.assert_allclose(forecast.latent[0], exact.T, atol=5e-3)
    (panel,) = plot_phase_plane(law, trials).axes
    (path,) = [line.get_xydata() for line in panel.lines if len(line.get_xdata()) > 50]
    np.testing.assert_allclose(path[[0, -1]], exact.T[[0, -1]], atol=5e-3)
    point = next(line for line in panel.lines if line.get_marker() == "o")
    np.testing.assert_allclose(point.get_xydata(), [[0.0, 0.0]], atol=1e-9)

    times = times[::2]
    first = solve_ivp(lambda _, s: (s[0] - s[0] * s[1], s[0] * s[1] - s[1]), (0, 8), (1.5, 1.0), t_eval=times).y
    counts = np.column_stack([first[0], first.sum(axis=0)]) + 0.001 * random.standard_normal((25, 2))
    trials = Trials.from_arrays(times, counts, names=["x", "all"])
    law = cl.fit("x' = a x - b x z; z' = c x z - d z; `all` = x + z", trials)
    figure = plot_phase_plane(law, trials)
    (panel,) = figure.axes
    (path,) = [line.get_xydata() for line in panel.lines if len(line.get_xdata()) > 50]
    np.testing.assert_allclose(path[0], [1.5, 1.0], atol=5e-3)
    shown = {text.get_text() for text in figure.legends[0].get_texts()}
    assert shown >= {"$z$ constant", "centre of its linearization"}


def test_a_profile_is_the_least_sum_of_squares_over_all_other_unknowns():
    times, noise = np.linspace(0.0, 4.0, 15), 0.2
    values = 5 * np.exp(-0.7 * times) + np.random.default_rng(1).normal(0, noise, 15)
    trials = Trials.from_arrays(times, values, names=["x"])
    law = cl.fit("x' = -k x", trials, noise={"x": noise})
    profile = likelihood_profile(law, trials, "k")

    def least(rate: float) -> float:
        shape = np.exp(-rate * times)
        start = shape @ values / (shape @ shape)
        return float(np.sum((values - start * shape) ** 2) / noise**2)

    best = min(map(least, np.linspace(0.5, 0.9, 4001)))
    np.testing.assert_allclose(profile.deviance, [least(value) - best for value in profile.values], atol=1e-4)
    ends = [brentq(lambda k: least(k) - best - 3.841, *ends) for ends in ((0.3, 0.7), (0.7, 1.5))]
    np.testing.assert_allclose(profile.interval, ends, rtol=5e-3)
    figure = plot_profile(law, trials, "k")
    assert figure.axes[0].get_xlabel() == "$k$"


def test_a_profile_shows_what_the_data_do_not_bound():
    times, text = np.linspace(0.0, 4.0, 12), "s' = -V s/(K + s)"
    path = Law.from_text(text, {"V": 1.5, "K": 2.0}).simulate(times, [1.0])["object"]
    trials = Trials.from_arrays(times, path.states, names=["s"])
    law = cl.fit(text, trials, noise={"s": 0.05})
    assert likelihood_profile(law, trials, "K").interval[1] == np.inf
    with refused("unknown-name"):
        likelihood_profile(law, trials, "W")


def test_coordinates_of_fixed_points_that_vanish_are_exactly_zero():
    law = Law.from_text("x' = 0.7 x - 0.005 x^2 - 0.0001 x y^2; y' = 0.5 y - 0.003 x y - 0.003 y^2")
    states = np.array([state for state, *_ in points_of(law, (0.0, 0.0), (300.0, 300.0))])
    assert len(states) >= 3
    assert np.all((states == 0) | (states > 1e-3))
