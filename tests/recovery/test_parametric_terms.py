"""Candidate terms with parameters inside that are to be found: families, which sets fit, and the laws of discover."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit

import commonlaw as cl
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.integral_form import CurveData
from commonlaw.inference.fit.parameter_grid import ParameterGrids, frequencies_in_time
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.integral_ranking import CandidateSupport, rank_supports
from commonlaw.inference.propose.parametric import are_parameters_identifiable, reflected
from commonlaw.inference.score.score import Score
from commonlaw.law.parameters import named_parameters, standard_errors
from commonlaw.library import PolynomialLibrary, Term, Terms, Variables, parametric_term, parse_library
from tests.recovery.golden import recovered
from tests.refusals import refused
from tests.simulations import simulated

ENZYMES = {"a": (1.0, 0.5), "b": (2.0, 1.5), "c": (1.5, 1.0)}


def saturation(_, s, rate, half):
    return -rate * s / (half + s)


@pytest.fixture(scope="module")
def enzymes():
    return simulated(saturation, ENZYMES, [[5.0], [2.5]], np.linspace(0, 5, 50), noise=0.01)


@pytest.fixture(scope="module")
def law():
    return recovered("enzymes")[0]


@pytest.mark.parametrize(
    "library", ["poly:1 + saturating", pytest.param("poly:1 + ratio(poly:1, poly:1)", marks=pytest.mark.slow)]
)
def test_coefficients_that_are_known_stay_in_laws_with_constants_inside(library):
    def rates(t, s, rate, half):
        return saturation(t, s, rate, half) + 0.3

    fed = simulated(rates, ENZYMES, [[5.0], [2.5]], np.linspace(0, 5, 50), noise=0.01)
    law = cl.discover(fed, library=library, known={"1": 0.25}, cache=False, order=1)
    assert law.terms.variables.parameters
    column = law.terms.index("1")
    assert (law.coefficients[:, 0, column] == 0.25).all()
    assert (standard_errors(law)[:, 0, column] == 0).all()


def test_families_of_variables_and_products_of_them_are_read_from_text():
    variables = Variables(("s", "x"))
    library = parse_library("poly:1 + poly:1:x * saturating:s + terms:abs(s)**p,s**2")
    assert library.bind(variables).names == ("1", "s", "x", "s^2")
    texts = [each.text(variables) for each in library.parametric(variables)]
    assert texts == ["s/(K + s)", "s x/(K + s)", "1/(K + s)", "x/(K + s)", "abs(s)^p"]


def test_a_constant_has_a_name_that_no_variable_has():
    variables = Variables(("K",))
    (first, _) = parse_library("saturating").parametric(variables)
    assert first.text(variables) == "K/(K2 + K)"
    assert first.parameters == ("K2",)


def test_a_constant_is_absorbed_by_a_sigmoid_and_by_nothing_else():
    """2 - 2 s(k, b) is 2 s(-k, -b)."""
    variables = Variables(("s",))
    sigmoid, saturation = (parametric_term(text, variables) for text in ("1/(1 + exp(k*s + b))", "s/(K + s)"))
    plain, values = PolynomialLibrary(1).bind(variables), np.array([[2.0, -2.0, 0.3, 0.4]])
    (found,) = reflected(plain, CandidateSupport((plain.index("1"),), (sigmoid,), (values,)))
    assert (found.plain, found.others) == ((), (sigmoid,))
    np.testing.assert_array_equal(found.starts, [[[2.0, -0.3, -0.4]]])
    assert not [*reflected(plain, CandidateSupport((plain.index("1"),), (saturation,), (values[:, :3],)))]


@pytest.mark.parametrize("library", ["saturating", "terms:s/(K+s)"])
def test_terms_with_constants_inside_alone_are_refused(library, enzymes):
    with refused("library-parametric-only"):
        cl.discover(enzymes, library=library, order=1)


def test_a_method_that_finds_no_constants_refuses_them_by_name(enzymes):
    with refused("parametric-terms-unsupported", term="s/(K + s)", method="DerivativeRegression"):
        cl.discover(enzymes, library="poly:1 + saturating", method=cl.DerivativeRegression(), order=1)
    with refused("parametric-terms-unsupported", method="DiscreteTimeRegression"):
        cl.discover(enzymes, library="poly:1 + saturating", order=0)


def test_where_all_sets_have_more_numbers_than_are_wanted_there_are_none(enzymes):
    plain = PolynomialLibrary(1).bind(Variables(("s",)))
    problem = prepare(enzymes, plain, np.zeros((3, 1, 2)))
    others = parse_library("saturating").parametric(plain.variables)
    assert rank_supports(problem, problem.starts, others, {0: 1}) == {0: []}
    assert {each.numbers for each in rank_supports(problem, problem.starts, others, {0: 2})[0]} == {2}


def test_the_law_of_enzymes_is_found_among_plain_terms_and_families(law):
    assert law.structure == ("x' = a x/(K + x)",)
    parameters = named_parameters(law)
    assert (np.abs(parameters.values - [(-1.0, 0.7), (-2.0, 1.5)]) < 4 * parameters.errors).all()


def test_it_says_what_else_it_could_be(law):
    chosen, *others = law.provenance.alternatives
    assert (chosen.terms, chosen.chosen) == (("x/(K + x)",), True)
    assert others
    assert law.uncertainty.inclusion_probabilities[0][law.support[0]].min() > 0.9
    assert any(step.stage == "library" and step.choice == "5 terms" for step in law.history)


def test_equations_share_a_term_without_constants(tmp_path):
    def rates(_, z, own, other, pull):
        return [own + pull * np.sin(z[1] - z[0]), other + pull * np.sin(z[0] - z[1])]

    objects, starts = {"a": (1.0, 1.4, 0.4), "b": (0.9, 1.6, 0.5)}, ([0.0, 1.5], [-1.0, 1.0])
    trials = simulated(rates, objects, starts, np.linspace(0, 10, 60), 0.02, ["x", "y"], absolute=True)
    law = cl.discover(trials, library="poly:1 + trigonometric", cache=False, order=1)
    assert law.structure == ("x' = a + b sin(x - y)", "y' = c + d sin(x - y)")
    assert len(set(law.terms.names)) == len(law.terms)
    law.save(tmp_path / "law.json")
    assert cl.Law.load(tmp_path / "law.json").structure == law.structure


@pytest.mark.slow
def test_a_course_that_turns_by_a_force_over_the_speed_is_found():
    """A glider: its angle is that of its velocity (Strogatz 1994, exercise 6.5.14)."""

    def rates(_, z):
        return [-np.sin(z[1]) - 0.06 * z[0] ** 2, z[0] - np.cos(z[1]) / z[0]]

    trials = simulated(rates, {"glider": ()}, [(1.5, 0.4)], np.linspace(0, 12, 200), 0.01, ["v", "a"], absolute=True)
    law = cl.discover(trials, library="poly:2 + trigonometric + polar", cache=False, order=1)
    assert law.structure == ("v' = b v^2 + c sin(a)", "a' = d v + f cos(a)/v")


def test_what_is_divided_by_a_state_that_changes_its_sign_is_not_tried():
    terms = parametric_term("cos(y)/x", Variables(("x", "y")))
    values = np.column_stack([np.linspace(-1, 1, 50), np.linspace(0, 3, 50), np.linspace(0, 1, 50)])
    assert not ParameterGrids.along(Variables(("x", "y")), values, [terms]).columns.size
    assert ParameterGrids.along(Variables(("x", "y")), np.abs(values), [terms]).columns.shape == (50, 1)


@pytest.mark.parametrize(
    ("text", "columns"), [("cos(w*t + p)", [2]), ("x*sin(t*w)", [2]), ("exp(-r*t)", []), ("cos(w*x)", [])]
)
def test_frequencies_are_what_time_is_multiplied_with_in_a_sine(text, columns):
    term = parametric_term(text, Variables(("x",)))
    places = (Term(parameter=2 + i) for i in range(len(term.parameters)))
    terms = Terms(Variables(("x",), parameters=term.parameters), (term.term, *places))
    assert frequencies_in_time(terms) == columns


@pytest.mark.parametrize(("frequency", "told"), [(0.3, False), (2.0, True), (2 * np.pi * 99 / 10 - 2.0, False)])
def test_a_drive_is_told_if_a_trial_has_a_whole_cycle_of_it_and_each_cycle_two_samples(frequency, told):
    times = np.linspace(0, 10, 100)
    exact = np.sin(frequency * times)[:, np.newaxis] / frequency
    trials = cl.Trials.from_arrays(times, exact + 0.001 * np.random.default_rng(0).standard_normal(exact.shape))
    variables = Variables(("x",), parameters=("w",))
    terms = Terms(variables, (parametric_term("cos(w*t)", Variables(("x",))).term, Term(parameter=2)))
    problem = prepare(trials, terms, np.full((1, 1, 2), np.nan), guess=np.array([[[1.0, frequency]]]))
    estimate = replace(problem.starts[0], states=(exact,), coefficients=np.array([[1.0, frequency]]))
    fit = Fit(problem, np.ones((1, 2), dtype=bool), (estimate,), 0.0, Score({}))
    assert are_parameters_identifiable(fit) == told


def test_products_with_terms_that_share_a_constant_share_it():
    variables = Variables(("x",))
    tied = parse_library("poly:1:x * periodic:t").parametric(variables)[4:]
    assert [each.text(variables) for each in tied] == ["cos(w*t), sin(w*t)", "x*cos(w*t), x*sin(w*t)"]
    assert [(each.size, each.shared_parameters, each.parameters) for each in tied] == [(2, ("w",), ("w", "p"))] * 2


def test_a_drive_of_unknown_phase_has_one_frequency_as_accurate_as_by_its_solution():
    def solution(t, k, level, cosine, sine, w, start):
        """x' = -k x + level + cosine cos(w t) + sine sin(w t)."""

        def driven(t):
            above = (cosine * k - sine * w) * np.cos(w * t) + (cosine * w + sine * k) * np.sin(w * t)
            return level / k + above / (k**2 + w**2)

        return driven(t) + (start - driven(0.0)) * np.exp(-k * t)

    times, truth = np.linspace(0, 20, 150), (0.5, 1.0, 0.4, -0.5, 1.3, 2.0)
    measured = solution(times, *truth) + 0.02 * np.random.default_rng(0).standard_normal(150)
    trials = cl.Trials.from_arrays(times, measured[:, np.newaxis], names=["x"])
    law = cl.discover(trials, library="poly:1 + periodic:t", order=1, cache=False)
    assert law.structure == ("x' = a + b x + c cos(w*t) + d sin(w*t)",)
    expected, covariance = curve_fit(solution, times, measured, truth)
    column = law.terms.index("w")
    assert law.coefficients[0, 0, column] == pytest.approx(expected[4], abs=0.05 * np.sqrt(covariance[4, 4]))
    assert standard_errors(law)[0, 0, column] == pytest.approx(np.sqrt(covariance[4, 4]), rel=0.05)


@pytest.mark.parametrize(
    ("rates", "starts", "family", "expected"),
    [
        pytest.param(
            lambda x, v: -1.7 * x - 0.15 * v / (0.1 + abs(v)),
            ((2.0, 0.0), (-1.0, 1.0)),
            "friction:v",
            "x'' = a x + b v/(e + abs(v))",
            marks=pytest.mark.slow,
        ),
        (
            lambda x, _: -1.6 * (np.exp(-0.9 * x) - np.exp(-1.8 * x)),
            ((2.0, 0.0), (-0.5, 0.1)),
            "morse:x",
            "x'' = a exp(x/U) + b exp(2*x/U)",
        ),
    ],
)
def test_smooth_friction_and_pairs_of_exponentials_are_found(rates, starts, family, expected):
    times = np.linspace(0, 12, 120)
    trials = simulated(lambda _, y: [y[1], rates(*y)], {"mass": ()}, starts, times, 0.005, ["x"], absolute=True)
    law = cl.discover(trials, library=f"poly:1 + {family}", order=2, cache=False)
    assert law.structure == (expected,)


def test_terms_are_not_compared_that_another_with_as_few_constants_repeats():
    variables = Variables(("x",))
    texts = ("abs(x)^p", "x/(K + x)", "sqrt(x)", "x/(e + abs(x))", "abs(x)^p*sign(x)")
    terms = [parametric_term(text, variables) for text in texts]
    values = np.column_stack([np.linspace(0.5, 2, 50), np.linspace(0, 1, 50)])
    assert ParameterGrids.along(variables, values, terms).redundant.tolist() == [False, False, False, True, True]
    assert not ParameterGrids.along(variables, values - [1, 0], terms).redundant.any()


def test_functions_of_all_families_are_offered_by_the_library_for_whom_none_comes_to_mind():
    variables = Variables(("x", "v"))
    offered = {term.text(variables) for offer in parse_library("auto").offers(variables) for term in offer.terms}
    assert {"cos(w*t), sin(w*t)", "v/(e + abs(v))", "exp(x/U), exp(2*x/U)"} <= offered


def test_no_frequency_is_compared_that_samples_do_not_tell_from_a_slower_one():
    times = np.linspace(0, 10, 41)
    trials = cl.Trials.from_arrays(times, np.sin(2 * times)[:, np.newaxis], names=["x"])
    plain = PolynomialLibrary(1).bind(Variables(("x",)))
    problem = prepare(trials, plain, np.full((1, 1, 2), np.nan)).finer()
    course = CurveData.of(problem, 0, problem.starts[0], [parametric_term("cos(w*t)", plain.variables)])
    assert len(course.grids.values) == 81
    assert course.grids.parameters[0].max() < 1.03 * np.pi / 0.25
