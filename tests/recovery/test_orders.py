"""The order of a law is found: by measured rates, or by the evidence for laws of both orders."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from scipy.stats import multivariate_normal

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.discovery import orders
from commonlaw.discovery.method import ModelStructure
from commonlaw.discovery.orders import is_first_order_possible
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.annealing import fit_with
from commonlaw.inference.fit.final_score import score_of_order
from commonlaw.inference.fit.problem import prepare
from commonlaw.law.parameters import standard_errors
from commonlaw.library import parse_library
from tests.refusals import refused
from tests.simulations import solved

discover = partial(cl.discover, order="auto", cache=False)


def simulated(rates, numbers, starts, times, noise, seed=0, columns=1):
    """Trials of one object for each set of numbers, from each start, of the first so many states."""
    generator, states, owners = np.random.default_rng(seed), [], []
    for i, number in enumerate(numbers):
        for start in starts:
            states.append(solved(rates, start, times, *number)[:, :columns])
            owners.append(f"object {i}")
    scale = noise * np.mean([state.std(axis=0) for state in states], axis=0)
    measured = [state + scale * generator.standard_normal(state.shape) for state in states]
    return cl.Trials.from_arrays([times] * len(states), measured, object=owners, names=["x", "y", "z"][:columns])


relaxations = partial(
    simulated, lambda _, x, k, a: k * (a - x), [(1.1, 2.0), (0.7, 2.9)], [(-1.0,), (6.0,)], np.linspace(0, 5, 60)
)
swings = partial(
    simulated,
    lambda _, z, k, c: [z[1], -k * np.sin(z[0]) - c * z[1]],
    [(2.0, 0.1)],
    [(1.2, 0.0), (2.2, 0.3)],
    np.linspace(0, 8, 80),
)


@pytest.mark.slow
def test_a_measured_rate_makes_the_law_more_certain():
    both = discover(swings(0.05, columns=2), library="poly:1 + fourier:1")
    alone = discover(swings(0.05), order=2, library="poly:1 + fourier:1")
    damping, of_y = (law.terms.names.index(name) for law, name in ((alone, "v"), (both, "y")))
    errors = standard_errors(both)
    assert errors[0, 1, of_y] < 0.8 * standard_errors(alone)[0, 0, damping]
    assert both.coefficients[0, 1, of_y] == pytest.approx(-0.1, abs=4 * errors[0, 1, of_y])


def test_of_states_without_measured_rates_the_evidence_says_the_order():
    both = swings(0.001, columns=2)
    other = [np.exp(-each.times)[:, np.newaxis] for each in both]
    states = [np.column_stack([each.states, own]) for each, own in zip(both, other, strict=True)]
    trials = cl.Trials.from_arrays([each.times for each in both], states, names=["x", "y", "z"])
    found = orders.possible_orders(trials, "auto")
    assert found.trials.schema.states == ("x", "y", "z")
    assert found.of_each == ((1,), (1,), (1, 2))
    assert (found.steps[0].choice, found.steps[0].reason) == (
        "x 1, y 1", "y is the rate of x; the rate of z was not measured"
    )  # fmt: skip
    law = discover(trials, library="poly:1 + terms:sin(x)")
    assert law.structure == ("x' = a y", "y' = b y + c sin(x)", "z' = d z")


@pytest.mark.slow
def test_richer_terms_of_a_law_of_first_order_come_before_many_terms_of_second_order():
    switches = simulated(
        lambda _, x, a, b, c, k: a - b * x + c * x**2 / (k**2 + x**2),
        [(0.1, 0.55, 1.2, 0.7), (0.09, 0.67, 1.57, 0.58)],
        [(0.05,), (3.0,), (0.4,)],
        np.linspace(0, 10, 60),
        0.0,
    )
    law = discover(switches)
    assert law.order == 1
    x = np.linspace(0.1, 3, 30)
    truth = 0.1 - 0.55 * x + 1.2 * x**2 / (0.7**2 + x**2)
    np.testing.assert_allclose(law.rhs("object 0", x[:, np.newaxis])[:, 0], truth, atol=1e-6)


@pytest.mark.slow
def test_a_law_of_second_order_whose_coefficients_are_within_their_errors_gives_way_to_one_of_first():
    enzymes = simulated(
        lambda _, s, rate, half: -rate * s / (half + s),
        [(1.45, 1.4), (1.42, 0.56), (1.31, 0.55), (0.67, 1.16)],
        [(5.0,), (2.0,)],
        np.linspace(0, 8, 60),
        0.05,
        seed=13,
    )
    assert discover(enzymes).structure == ("x' = a x/(K + x)",)


def test_an_order_of_which_no_law_can_be_found_is_left_out():
    times = np.linspace(0, 4, 60)
    measured = 2 + 3 * np.exp(-times) * (1 + 0.01 * np.random.default_rng(0).standard_normal(60))
    law = discover(cl.Trials.from_arrays(times, measured, names=["x"]), library="terms:1,v")
    assert law.order == 2
    assert law.history[0].reason.startswith("no law of another order was found: ")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"library": "terms:1,w"}, Diagnostic("unknown-name", {"term": "w", "name": "w"})),
        ({"known": lambda v: -v}, "known-physics-order-missing"),
        ({"known": "-9.8"}, "known-physics-order-missing"),
        ({"order": "first"}, Diagnostic("order-not-offered", {"order": "first"})),
    ],
)
def test_what_an_order_cannot_be_found_with_is_refused(settings, message):
    with refused(message):
        discover(cl.datasets.linear_drag(drag=(-0.1,), trials=1), **settings)


@pytest.mark.parametrize("known", ["x'' = -9.8", cl.Law.from_text("x'' = -9.8")])
def test_the_order_is_that_of_known_physics(known):
    law = discover(cl.datasets.linear_drag(drag=(-0.1,), trials=1), known=known, library="poly:1")
    assert law.order == 2


@pytest.mark.parametrize("method", [cl.DerivativeRegression(), cl.WeakRegression()])
def test_regressions_take_the_first_order_and_polynomials_and_say_so(method):
    law = cl.discover(relaxations(0.01), method=method, cache=False)
    assert law.order == 1
    assert law.terms.names == ("1", "x", "x^2", "x^3")
    (said,) = [diagnostic for diagnostic in law.diagnostics if diagnostic.kind == "method"]
    assert said.code == "order-without-evidence"
    assert type(method).__name__ in said.text
    assert not [
        diagnostic
        for diagnostic in cl.discover(relaxations(0.01), method=method, order=1).diagnostics
        if diagnostic.kind == "method"
    ]


def test_streams_are_of_the_first_order_and_say_so(tmp_path):
    relaxations(0.01).to_parquet(tmp_path / "cups.parquet")
    law = cl.discover(cl.TrialStream.from_parquet(tmp_path / "cups.parquet"))
    assert law.order == 1
    assert law.terms.names == ("1", "x", "x^2", "x^3")
    assert "order-without-evidence" in {diagnostic.code for diagnostic in law.diagnostics}


@pytest.mark.parametrize(
    ("rate", "starts", "is_one"),
    [
        # A relaxation has one rate at each state
        (lambda _, x, k: -k * x, [(1.0,), (0.5,)], True),
        # An oscillator passes a state in two directions
        (lambda _, x, k: [x[1], -k * x[0]], [(1.0, 0.0)], False),
    ],
)
def test_rates_are_a_function_of_states_or_not(rate, starts, is_one):
    trials = simulated(rate, [(4.0,)], starts, np.linspace(0, 3, 60), 0.001)
    terms = ModelStructure(2, parse_library("poly:1")).terms(trials.schema)
    problem = prepare(trials, terms, np.full((1, 1, len(terms)), np.nan))
    assert is_first_order_possible(fit_with(problem, problem.allowed, 0.0)) is is_one


def test_laws_of_both_orders_that_are_about_as_probable_are_said():
    law = cl.fit("x' = a", relaxations(0.05))
    (said,) = orders.with_order_step(law, [(2, 4.2)], ()).diagnostics[len(law.diagnostics) :]
    assert said.code == "order-not-identifiable"
    assert "2 (2 log B is 4.2)" in said.text
    assert orders.with_order_step(law, [(2, 6.5)], ()).diagnostics == law.diagnostics


@pytest.mark.parametrize("points", [1, 2])
@pytest.mark.parametrize(("speeds", "acceleration"), [((1.0, -0.5, 2.0), -0.3), ((1.0, 1.2, 0.9), -0.5)])
def test_the_evidence_of_both_orders_is_the_density_of_the_same_measurements(points, speeds, acceleration):
    """Of laws without free coefficients it is known: starts anywhere, rates at starts as wide as smoothed rates."""
    generator, times, noise = np.random.default_rng(0), np.linspace(0, 2, 20), 0.05
    course = acceleration / 2 * times**2
    measured = [v * times + course + noise * generator.standard_normal(20) for v in speeds]
    trials = cl.Trials.from_arrays([times] * 3, measured, names=["x"])
    found = {}
    for order, value in {1: 0.7, 2: acceleration}.items():
        structure = ModelStructure(order, parse_library("terms:1"), {"1": value})
        terms, known = structure.terms(trials.schema), structure.known_coefficients(trials.schema, trials.objects)
        problem = prepare(trials, terms, known, noise=np.array([noise]), huber_threshold=np.inf)
        while problem.points < points:
            problem = problem.finer()
        found[order] = score_of_order(fit_with(problem, problem.allowed, 0.0))
    rates = np.array([each[:, 1] for own in problem.smoothed for each in own])

    def log_density(mean, covariance):
        """Of what is measured after each start, given this, as any start is as likely."""
        wide = covariance + noise**2 * (np.eye(20) + 1e6)
        return sum(
            multivariate_normal.logpdf(each, mean, wide) - multivariate_normal.logpdf(each[0], mean[0], wide[0, 0])
            for each in measured
        )

    first = log_density(0.7 * times, 0.0)
    second = log_density(course, max(np.mean(rates**2), np.mean(rates[:, 0] ** 2)) * np.outer(times, times))
    assert found[1] - found[2] == pytest.approx(2 * (second - first), abs=0.2)


def test_what_fails_for_some_orders_is_left_out_and_refused_if_it_does_for_all():
    def step(number):
        if number > 1:
            raise CommonlawError("no-law-near-measurements")
        return 10 * number

    found, failed = orders.apply_to_each(step, [1, 2, 0])
    assert found == [10, 0]
    assert [each.code for each in failed] == ["no-law-near-measurements"]
    with refused("no-law-near-measurements"):
        orders.apply_to_each(step, [2, 3])


def test_a_rate_that_is_the_same_everywhere_is_a_function_of_states():
    """The columns of inputs and rates do not vary, and cannot be divided by their range."""
    table = {"t": [0.0, 1.0], "x": [-3.0, -1.1], "u": [1e9, 1e9]}
    trials = cl.Trials.from_frame(pd.DataFrame(table), states=["x"], inputs=["u"])
    terms = ModelStructure(2, parse_library("poly:1")).terms(trials.schema)
    problem = prepare(trials, terms, np.full((1, 1, len(terms)), np.nan))
    assert is_first_order_possible(fit_with(problem, problem.allowed, 0.0))
