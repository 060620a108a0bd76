"""Libraries that offer more where what they offered first may be said in fewer numbers."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import commonlaw as cl
from commonlaw.inference.propose import parametric
from commonlaw.inference.search import law_search
from commonlaw.library import AbstractLibrary, Offer, Terms, Variables, parametric_term, parse_library


@dataclass(frozen=True)
class _InTurn(AbstractLibrary):
    """Polynomials; beside them some terms, and then what another library offers."""

    terms: tuple[str, ...]
    later: str

    def bind(self, variables: Variables) -> Terms:
        return cl.PolynomialLibrary(1).bind(variables)

    def offers(self, variables: Variables) -> Iterator[Offer]:
        first = Offer(tuple(parametric_term(each, variables) for each in self.terms))
        return iter((first, *parse_library(self.later).offers(variables)))


@dataclass(frozen=True)
class _Later(AbstractLibrary):
    """Polynomials; beside them a saturating term, and then a logarithm."""

    def bind(self, variables: Variables) -> Terms:
        return cl.PolynomialLibrary(2).bind(variables)

    def offers(self, variables: Variables) -> Iterator[Offer]:
        return (Offer((parametric_term(each, variables),)) for each in ("x/(K + x)", "exp(x/U)"))


def _rate(_: float, s: np.ndarray, rate: float, half: float, inhibition: float) -> np.ndarray:
    return -rate * s / (half + s + s**2 / inhibition)


def _predation(_: float, z: np.ndarray, growth: float, gain: float) -> list[float]:
    return [z[0] * (growth - z[1]), z[1] * (gain * z[0] - 1)]


@pytest.fixture(scope="module")
def inhibited() -> cl.Trials:
    """s' = -V s/(K + s + s^2/L), an enzyme that its substrate inhibits (Haldane)."""
    generator, times = np.random.default_rng(1), np.linspace(0, 8, 50)
    states = list[np.ndarray]()
    for rate, half, inhibition in ((1.2, 0.5, 2.0), (1.8, 0.7, 3.0)):
        for start in (6.0, 3.0):
            found = solve_ivp(_rate, (0, 8), [start], t_eval=times, rtol=1e-9, args=(rate, half, inhibition))
            states.append(found.y.T + 0.02 * generator.standard_normal((len(times), 1)))
    names = [name for name in "ab" for _ in range(2)]
    return cl.Trials.from_arrays([times] * 4, states, object=names, names=["s"])


def test_a_ratio_is_taken_where_it_says_as_much_in_fewer_numbers(inhibited):
    library = _InTurn(("s/(K + s)",), "ratio(terms:s, poly:2)")
    law = cl.discover(inhibited, library=library, order=1)
    assert law.structure == ("s' = a s/(K + L*s + s^2)",)
    np.testing.assert_allclose(law.parameters.values[:, 2], [2.0, 3.0], rtol=0.15)  # L is the inhibition


def test_what_is_offered_later_is_not_tried_where_a_law_of_few_numbers_leaves_noise(monkeypatch):
    monkeypatch.setattr(parametric, "matching_ratios", lambda *_: pytest.fail("ratios were proposed"))
    times = np.linspace(0, 3, 60)
    noise = 0.01 * np.random.default_rng(2).standard_normal((60, 1))
    decay = cl.Trials.from_arrays([times], [np.exp(-times)[:, np.newaxis] + noise], names=["s"])
    law = cl.discover(decay, library=_InTurn(("s/(K + s)",), "ratio(poly:2, poly:2)"), order=1)
    assert law.structure == ("s' = a s",)


def test_richer_terms_and_orders_are_not_tried_where_only_the_noise_is_heteroscedastic():
    times, random, states = np.linspace(0, 8, 80), np.random.default_rng(0), list[np.ndarray]()
    for rates in ((1.0, 0.8), (1.4, 1.1)):
        for start in ((0.8, 1.2), (2.0, 0.6)):
            found = solve_ivp(_predation, (0, 8), start, t_eval=times, args=rates, rtol=1e-9).y.T
            states.append(found + 0.01 * found.std(axis=0) * random.standard_normal(found.shape))  # By the swing
    trials = cl.Trials.from_arrays([times] * 4, states, object=["a", "a", "b", "b"], names=["x", "y"])
    steps = list[str]()
    law = cl.discover(trials, cache=False, progress=steps.append)
    assert law.structure == ("x' = a x + b x y", "y' = c y + d x y")
    assert any("heteroscedastic: estimating errors" in each for each in steps)
    assert not any("of order 2" in each or "constants inside" in each or "nobody measured" in each for each in steps)


def test_what_is_offered_later_is_sought_in_equations_that_may_be_simpler(monkeypatch):
    sought = list[dict[int, int]]()

    def proposed(*arguments):
        _, _, _, most, _ = arguments
        sought.append(dict(most))
        return {}

    monkeypatch.setattr(parametric, "matching_sets", proposed)
    trials = cl.datasets.lorenz(samples=120, trials=2, noise=0.02, seed=1)
    cl.discover(trials, library=_Later(), cache=False, order=1)
    assert sought[0].keys() == {0, 1, 2}  # The first offer
    assert sought[-1].keys() == {1}  # y' = a x + b y + c x z has three numbers


@pytest.mark.parametrize("text", ["auto + terms:exp(s)", "terms:exp(s) + auto"])
def test_a_sum_offers_what_each_of_its_libraries_does(text):
    variables = Variables(("s",))
    alone, library = parse_library("auto"), parse_library(text)
    (first, families, ratios), offers = alone.offers(variables), list(library.offers(variables))
    assert offers[:2] == [first, families]
    assert first.count == 0
    more = offers[2]
    assert [each.text(variables.names) for each in ratios.ratios[0].beside] == ["1", "s"]
    assert [each.text(variables.names) for each in more.ratios[0].beside] == ["1", "s", "exp(s)"]
    assert library.seeks_unmeasured
    assert not parse_library("poly:3 + terms:exp(s)").seeks_unmeasured
    assert set(library.higher.bind(variables).names) == {"1", "s", "s^2", "s^3", "s^4", "exp(s)"}
    assert parse_library("poly:3 + terms:exp(s)").higher is library.higher.higher is None


def swung(rates, starts, noise, times):
    """Positions of one object from each start, of a law of second order."""
    generator = np.random.default_rng(0)
    solved = [solve_ivp(rates, times[[0, -1]], each, t_eval=times, rtol=1e-9).y[0] for each in starts]
    return cl.Trials.from_arrays([times] * len(starts), [x + noise * generator.standard_normal(len(x)) for x in solved])


def test_nothing_richer_and_no_finer_mesh_is_tried_where_polynomials_explain(monkeypatch):
    monkeypatch.setattr(cl.AutoLibrary, "_families", lambda *_: pytest.fail("families were offered"))
    monkeypatch.setattr(law_search, "on_finer_mesh", lambda *_: pytest.fail("the first order was sought again"))
    starts, times = [(1.5, 0), (-0.4, 1)], np.linspace(0, 9, 90)
    duffing = swung(lambda _, z: (z[1], z[0] - z[0] ** 3 - 0.2 * z[1]), starts, 0.01, times)
    assert cl.discover(duffing, cache=False).structure == ("x'' = a x + b v + c x^3",)


def test_a_law_of_fourth_degree_is_found_before_terms_with_constants_inside_are_offered(monkeypatch):
    monkeypatch.setattr(cl.AutoLibrary, "_families", lambda *_: pytest.fail("families were offered"))
    generator, times = np.random.default_rng(0), np.linspace(0, 6, 61)
    cooled = [
        solve_ivp(lambda _, x, h=heating: h - x**4, (0, 6), [start], t_eval=times, rtol=1e-9).y.T
        for heating in (0.3, 0.8)
        for start in (0.1, 1.4, 2.0)
    ]
    measured = [each + 0.002 * generator.standard_normal(each.shape) for each in cooled]
    trials = cl.Trials.from_arrays([times] * 6, measured, object=["a"] * 3 + ["b"] * 3, names=["T"])
    law = cl.discover(trials, cache=False)
    assert law.structure == ("T' = a + b T^4",)
    assert np.allclose(law.coefficients[:, 0, list(law.support[0])], [[0.3, -1], [0.8, -1]], atol=0.01)


def test_powers_up_to_the_highest_offered_may_be_a_series_and_a_function_is_found_for_them():
    generator, times = np.random.default_rng(0), np.linspace(0, 12, 60)
    sizes = [6 * np.exp(np.log(start / 6) * np.exp(-0.4 * times)) for start in (0.2, 0.8)]
    trials = cl.Trials.from_arrays(
        [times] * 2, [each + 0.02 * generator.standard_normal(60) for each in sizes], names=["n"]
    )
    plain = cl.discover(trials, order=1, library="poly:3", cache=False)
    assert plain.structure == ("n' = a + b n + c n^2 + d n^3",)
    assert not [each for each in plain.diagnostics if each.kind == "residuals"]  # Noise explains what it leaves
    assert cl.discover(trials, cache=False).structure == ("n' = a n + b n*log(n)",)  # Gompertz


def test_a_law_with_constants_inside_is_tried_with_one_plain_term_less(inhibited, monkeypatch):
    seen = []
    fewer = parametric._with_fewer

    def with_one_more_first(search, best, rows, progress):
        more = replace(rows[0], plain=(*rows[0].plain, 1), starts=tuple(map(_with_zero, rows[0].starts)))
        again = replace(search, fitted={})
        fitted = again.fit((more,), search.base.starts)
        seen.append((rows, fewer(again, fitted, (more,), progress)[1]))
        return best, rows

    monkeypatch.setattr(parametric, "_with_fewer", with_one_more_first)
    cl.discover(inhibited, library="poly:1 + terms:s/(K + s + s^2/L)", cache=False, order=1)
    rows, found = seen[-1]
    assert rows[0].plain == ()
    assert found == rows


def _with_zero(start):
    return replace(start, coefficients=np.insert(start.coefficients, 0, 0.0, axis=1))


@pytest.mark.slow
def test_terms_with_constants_inside_are_sought_again_where_noise_is_in_proportion():
    def respiration(_, z):
        taken = z[0] * z[1] / (1 + 0.48 * z[0] ** 2)
        return 18.3 - taken - z[0], 11.23 - taken

    times, generator = np.linspace(0, 10, 512), np.random.default_rng(3)
    states = solve_ivp(respiration, (0, 10), (0.1, 30.4), t_eval=times, rtol=1e-9).y.T
    measured = states * (1 + 0.05 * generator.standard_normal(states.shape))
    law = cl.discover(
        cl.Trials.from_arrays([times], [measured], names=["x", "y"]), library="auto", cache=False, order=1
    )
    found = law.simulate(times, states[0])[law.objects[0]].states
    assert np.sum((found - states) ** 2) < 0.05 * np.sum((states - states.mean(axis=0)) ** 2)


@pytest.mark.slow
def test_constants_inside_are_sought_under_errors_with_a_memory():
    generator, times = np.random.default_rng(3), np.linspace(0, 8, 60)
    states = list[np.ndarray]()
    for start in (4.0, 2.5):
        errors = lfilter([0.02], [1, -0.8], generator.standard_normal((60, 1)), axis=0)
        found = solve_ivp(lambda _, s: -s / (0.7 + s), (0, 8), [start], t_eval=times, rtol=1e-9)
        states.append(found.y.T + errors)
    trials = cl.Trials.from_arrays([times] * 2, states, object=["a", "a"], names=["s"])
    method = cl.TrajectoryLikelihood(errors="correlated")
    law = cl.discover(trials, library="poly:1 + terms:s/(K+s)", method=method, order=1)
    assert law.structure == ("s' = a s/(K + s)",)
    assert law.uncertainty.error_model.correlated is not None
    np.testing.assert_allclose(law.parameters.values[0], [-1.0, 0.7], rtol=0.15)
