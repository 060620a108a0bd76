"""Functions of vectors: forces toward a point, and drag along a velocity."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.inference.fit.annealing import fit_solutions
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.candidate_laws import ParametricSearch
from commonlaw.inference.propose.integral_ranking import CandidateSupport, Start
from commonlaw.library import AutoLibrary, Offer, PolynomialLibrary, Variables, parametric_term, parse_library

PLANE = Variables(("x", "y", "v_x", "v_y"))


def test_positions_and_velocities_are_vectors():
    texts = [each.text(PLANE) for each in parse_library("central").parametric(PLANE)]
    assert len(texts) == 16
    assert {"x*(x^2 + y^2)^p", "y/(x^2 + y^2)^1.5", "v_x*sqrt(v_x^2 + v_y^2)"} <= {*texts}
    assert not any("y^2 + v_x" in text for text in texts)
    named = [each.text(PLANE) for each in parse_library("central:x,y").parametric(PLANE)]
    assert named == texts[:8]


def test_the_exponent_is_called_otherwise_where_a_variable_is():
    variables = Variables(("p", "q"))
    assert parse_library("central").parametric(variables)[0].text(variables) == "p*(p^2 + q^2)^p2"


def test_a_single_state_has_no_direction():
    assert parse_library("central:x").parametric(PLANE) == ()
    assert len([*AutoLibrary().offers(Variables(("x", "v")))]) + 1 == len([*AutoLibrary().offers(PLANE)])


@pytest.mark.parametrize("constant", [0.5, 2.0])
def test_of_a_sigmoid_beside_a_constant_the_form_without_is_proposed(constant):
    times = np.linspace(0, 4, 41)
    trials = cl.Trials.from_arrays(times, np.exp(-times) + 0.01 * np.sin(40 * times), names=["x"])
    variables = Variables(("x",))
    terms = PolynomialLibrary(1).bind(variables)
    problem = prepare(trials, terms, np.full((1, 1, 2), np.nan))
    search = ParametricSearch(fit_solutions(problem, np.array([[False, True]])), (), problem, Offer(()))
    sigmoid = parametric_term("1/(1 + exp(-(a*x + c)))", variables)
    row = CandidateSupport(
        (0, 1), (sigmoid,), (Start(np.array([[constant, -1.0, -constant]]), (np.array([[3.0, 0.2]]),)),)
    )
    (found,) = search._reflected(row)
    assert (found.plain, found.others) == ((1,), (sigmoid,))
    (start,) = found.starts
    points = np.column_stack([np.linspace(-2, 2, 9), np.zeros(9)])

    def rates(coefficients, parameters):
        values = np.column_stack([points, np.tile(parameters, (9, 1))])
        return coefficients[0] * points[:, 0] + coefficients[1] * sigmoid.term.evaluate(values)

    before = constant + rates([-1.0, -constant], [3.0, 0.2])
    np.testing.assert_allclose(rates(start.coefficients[0], start.parameters[0][0]), before, rtol=1e-12)
    other = parametric_term("x/(K + x)", variables)
    assert not [*search._reflected(CandidateSupport((0,), (other,), (Start(np.ones((1, 2)), (np.ones((1, 1)),)),)))]
