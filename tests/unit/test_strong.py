import numpy as np
import pytest

from commonlaw.differentiation import METHODS, CenteredDifference, parse_differentiation
from commonlaw.formulation import LeastSquaresProblem, StrongForm, law_variables, merge
from commonlaw.library import PolynomialLibrary
from commonlaw.trials import Schema, Trial

SCHEMA = Schema(("x", "y"))


def long_trial(samples=20_000):
    times = np.arange(samples) * 0.01
    noise = 1e-3 * np.random.default_rng(0).standard_normal((samples, 2))
    return Trial("swing", "1", times, np.column_stack([np.sin(times), np.cos(0.7 * times)]) + noise)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("text", ["centered", "forward", "finite:4", "savgol:35:3", "median:5", "wiener:5", "spline"])
def test_a_long_trial_is_differentiated_in_pieces_that_fit_together(text, order):
    assert text.split(":")[0] in METHODS
    form, trial = StrongForm(parse_differentiation(text), order, trim=3), long_trial()
    values, targets = form.samples(trial)
    whole = form.rates(trial)
    np.testing.assert_allclose(values[:, :2], whole.states[3:-3], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(targets, whole.derivatives[order - 1][3:-3], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("parts", [1, 3, 7])
def test_the_parts_of_a_trial_are_the_systems_of_its_rows(parts):
    form, trial = StrongForm(CenteredDifference(), trim=5), long_trial(9000)
    terms = PolynomialLibrary(2).bind(law_variables(SCHEMA, form.order))
    problems, rows = form.problems(trial, terms, parts), form.rows(trial, terms)
    assert len(problems) == parts
    assert sum(problem.rows for problem in problems) == 8990
    everything, whole = np.ones(6, dtype=bool), LeastSquaresProblem.of(*rows)
    np.testing.assert_allclose(
        merge(problems).least_squares(everything, 1), whole.least_squares(everything, 1), rtol=1e-9
    )
    first = LeastSquaresProblem.of(*(row[: problems[0].rows] for row in rows))
    np.testing.assert_allclose(problems[0].least_squares(everything, 0), first.least_squares(everything, 0), rtol=1e-9)


def test_names_of_rates_avoid_the_names_of_other_variables():
    assert law_variables(Schema(("x",)), 2).states == ("x", "v")
    assert law_variables(Schema(("x",), inputs=("v",)), 2).states == ("x", "x_rate")
    assert law_variables(Schema(("x", "y")), 2).states == ("x", "y", "v_x", "v_y")
