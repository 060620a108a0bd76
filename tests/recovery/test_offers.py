"""Libraries that offer more where what they offered first may be said in fewer numbers."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law.parameters import named_parameters
from commonlaw.library import AbstractLibrary, Offer, Terms, Variables, parametric_term, parse_library
from tests.simulations import simulated, solved


@dataclass(frozen=True)
class _InTurn(AbstractLibrary):
    """Polynomials; beside them some terms, and then what another library offers."""

    terms: tuple[str, ...]
    later: str

    def bind(self, variables: Variables) -> Terms:
        return cl.library.PolynomialLibrary(1).bind(variables)

    def offers(self, variables: Variables) -> Iterator[Offer]:
        first = Offer(tuple(parametric_term(term, variables) for term in self.terms))
        return iter((first, *parse_library(self.later).offers(variables)))


def test_a_ratio_is_taken_where_it_says_as_much_in_fewer_numbers():
    """An enzyme that its substrate inhibits (Haldane)."""
    objects = {"a": (1.2, 0.5, 2.0), "b": (1.8, 0.7, 3.0)}

    def rates(_: float, s: np.ndarray, rate: float, half: float, inhibition: float) -> np.ndarray:
        return -rate * s / (half + s + s**2 / inhibition)

    trials = simulated(rates, objects, [[6.0], [3.0]], np.linspace(0, 8, 50), 0.02, seed=1, absolute=True)
    law = cl.discover(trials, library=_InTurn(("s/(K + s)",), "ratio(terms:s, poly:2)"), order=1)
    assert law.structure == ("s' = a s/(K + L*s + s^2)",)
    np.testing.assert_allclose(named_parameters(law).values[:, 2], [2.0, 3.0], rtol=0.15)  # L is the inhibition


@pytest.mark.slow
def test_richer_terms_and_orders_are_not_tried_where_only_the_noise_differs():
    starts, steps = [(0.8, 1.2), (2.0, 0.6)], list[str]()

    def rates(_: float, z: np.ndarray) -> list[float]:
        return [z[0] * (1 - z[1]), z[1] * (0.8 * z[0] - 1)]

    trials = simulated(rates, {"a": ()}, starts, np.linspace(0, 8, 80), 0.01, ["x", "y"], seed=1)
    law = cl.discover(trials, cache=False, progress=steps.append)
    assert law.structure == ("x' = a x + b x y", "y' = c y + d x y")
    assert any("estimating errors" in step for step in steps)
    assert not any(text in step for step in steps for text in ("of order 2", "parametric", "latent state"))


@pytest.mark.parametrize("text", ["auto + terms:exp(s)", "terms:exp(s) + auto"])
def test_a_sum_offers_what_each_of_its_libraries_does(text):
    variables = Variables(("s",))
    alone, library = parse_library("auto"), parse_library(text)
    (first, families, ratios), offers = alone.offers(variables), list(library.offers(variables))
    assert offers[:2] == [first, families]
    assert first.count == 0
    more = offers[2]
    assert [each.text(variables.names) for each in ratios.ratios[0].added] == ["1", "s"]
    assert [each.text(variables.names) for each in more.ratios[0].added] == ["1", "s", "exp(s)"]
    assert library.seeks_latent_states
    assert not parse_library("poly:3 + terms:exp(s)").seeks_latent_states
    assert set(library.higher.bind(variables).names) == {"1", "s", "s^2", "s^3", "s^4", "exp(s)"}
    assert parse_library("poly:3 + terms:exp(s)").higher is library.higher.higher is None


@pytest.mark.slow
def test_a_law_of_fourth_degree_is_found_by_the_richest_polynomials():
    objects, times = {"a": (0.3,), "b": (0.8,)}, np.linspace(0, 6, 61)
    trials = simulated(lambda _, x, h: h - x**4, objects, [[0.1], [1.4], [2.0]], times, 0.002, ["T"], absolute=True)
    law = cl.discover(trials, cache=False)
    assert law.structure == ("T' = a + b T^4",)
    assert np.allclose(law.coefficients[:, 0, list(law.support[0])], [[0.3, -1], [0.8, -1]], atol=0.01)


@pytest.mark.slow
def test_terms_with_constants_inside_are_sought_again_where_noise_is_in_proportion():
    def respiration(_, z):
        taken = z[0] * z[1] / (1 + 0.48 * z[0] ** 2)
        return 18.3 - taken - z[0], 11.23 - taken

    times, generator = np.linspace(0, 10, 512), np.random.default_rng(3)
    states = solved(respiration, (0.1, 30.4), times)
    measured = states * (1 + 0.05 * generator.standard_normal(states.shape))
    law = cl.discover(
        cl.Trials.from_arrays([times], [measured], names=["x", "y"]), library="auto", cache=False, order=1
    )
    found = law.simulate(times, states[0])[law.objects[0]].states
    assert np.sum((found - states) ** 2) < 0.05 * np.sum((states - states.mean(axis=0)) ** 2)


@pytest.mark.slow
def test_central_forces_come_before_polynomials_of_higher_degree():
    def rates(_, z):
        return [z[2], z[3], *(-z[:2] / np.hypot(*z[:2]) ** 3)]

    steps = list[str]()
    starts = [(1, 0, 0, 0.8), (1, 0, 0, 1.1)]  # Along one orbit, velocities are functions of positions
    trials = simulated(rates, {"moon": ()}, starts, np.linspace(0, 10, 60), 0.001, ["x", "y"], absolute=True)
    law = cl.discover(trials, order=2, progress=steps.append)
    assert law.structure == ("x'' = a x/(x^2 + y^2)^1.5", "y'' = b y/(x^2 + y^2)^1.5")
    np.testing.assert_allclose(law.coefficients[0][law.support], -1, atol=0.002)
    assert not any("higher degree" in str(step) for step in steps)


def _monod(_: float, z: np.ndarray, rate: float, half: float, gain: float) -> list[float]:
    uptake = rate * z[1] / (half + z[1]) * z[0]
    return [uptake, -uptake / gain]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rates", "objects", "starts", "times", "names", "noise", "structure"),
    [
        (
            _monod,
            [(0.5, 0.3, 0.5), (0.4, 0.2, 0.45), (0.6, 0.5, 0.55)],
            [(0.1, 5.0)],
            np.linspace(0, 15, 31),
            ["x", "s"],
            (0.02, 0.04),
            ("x' = a x s/(K + s)", "s' = b x s/(K2 + s)"),
        ),
        (
            lambda _, z: [*z[2:], -0.22 * np.hypot(*z[2:]) * z[2], -9.81 - 0.22 * np.hypot(*z[2:]) * z[3]],
            [()],
            [(0.0, 1.5, 5.6, 5.6), (0.0, 1.5, 8.4, 8.4)],
            np.arange(0, 1.4, 0.07),
            ["x", "y"],
            0.005,
            ("x'' = a v_x*sqrt(v_x^2 + v_y^2)", "y'' = b + c v_y*sqrt(v_x^2 + v_y^2)"),
        ),
        pytest.param(
            lambda _, z, stiffness: [z[1], -stiffness * np.sin(z[0]) - 0.05 * z[1]],
            [(19.62,), (9.81,)],
            [(0.5, 0.0), (0.95, 0.0)],
            np.linspace(0, 6, 90),
            ["x"],
            0.005,
            ("x'' = a v + b sin(x)",),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["saturation, not a quartic or a Hill term", "drag in both directions", "a sine, not its series"],
)
def test_polynomials_that_fit_are_compared_with_shorter_laws(rates, objects, starts, times, names, noise, structure):
    objects = {str(i): numbers for i, numbers in enumerate(objects)}
    trials = simulated(rates, objects, starts, times, noise, names, absolute=True)
    law = cl.discover(trials, order=2 if rates is not _monod else 1, cache=False)
    assert law.structure == structure


def test_a_reciprocal_is_taken_for_a_polynomial_that_fits():
    """The square of the diameter of a drop that evaporates falls linearly, ``d' = -k/d``."""
    generator, diameters, times = np.random.default_rng(2), list[np.ndarray](), list[np.ndarray]()
    rates = {"water": 9e-4, "ethanol": 1.4e-3}
    for rate in rates.values():
        for start in (1.0, 1.2):
            times.append(np.linspace(0, 0.4 * start**2 / rate, 30))
            clean = np.sqrt(start**2 - 2 * rate * times[-1])
            diameters.append(clean[:, np.newaxis] + 0.004 * generator.standard_normal((30, 1)))
    names = [name for name in rates for _ in range(2)]
    law = cl.discover(cl.Trials.from_arrays(times, diameters, object=names, names=["d"]), order=1)
    assert law.structure == ("d' = a/d",)
    np.testing.assert_allclose(named_parameters(law).values[:, 0], [-9e-4, -1.4e-3], rtol=0.02)


@pytest.mark.slow
def test_positions_of_planets_give_the_law_of_gravity():
    """Along each ellipse rates are functions of the position too, with more coefficients, which vary."""

    def kepler(_: float, z: np.ndarray) -> list[float]:
        pull = -4 * np.pi**2 / np.hypot(z[0], z[1]) ** 3
        return [z[2], z[3], pull * z[0], pull * z[1]]

    generator, times, positions = np.random.default_rng(0), list[np.ndarray](), list[np.ndarray]()
    planets = {"mercury": (0.387, 0.206), "mars": (1.524, 0.093)}
    for size, eccentricity in planets.values():
        times.append(np.linspace(0, 1.9 * size**1.5, 50))
        speed = 2 * np.pi * np.sqrt((1 + eccentricity) / (size * (1 - eccentricity)))
        orbit = solved(kepler, [size * (1 - eccentricity), 0.0, 0.0, speed], times[-1])[:, :2]
        positions.append(orbit + 0.002 * generator.standard_normal(orbit.shape))
    law = cl.discover(cl.Trials.from_arrays(times, positions, object=[*planets], names=["x", "y"]))
    assert law.structure == ("x'' = a x/(x^2 + y^2)^1.5", "y'' = b y/(x^2 + y^2)^1.5")
    np.testing.assert_allclose(named_parameters(law).values, -4 * np.pi**2, rtol=0.01)
