"""What a law is within its errors: ones, opposites and equal numbers, in one line beside it."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import Uncertainty
from commonlaw.law.parameters import named_parameters
from commonlaw.law.simplify import within_errors
from commonlaw.report.markup import law_markdown


def law(
    equations: str | tuple[str, ...], values: dict[str, float], errors: dict[str, float], objects: int = 1
) -> cl.Law:
    names = tuple(f"o{k}" for k in range(objects))
    found = cl.Law.from_text(equations, {key: dict.fromkeys(names, value) for key, value in values.items()})
    places = {
        (part.equation, part.term): each.name for each in named_parameters(found).definitions for part in each.parts
    }
    variances = [errors[places[index]] ** 2 for index in map(tuple, np.argwhere(found.support).tolist())]
    return replace(found, uncertainty=Uncertainty(np.tile(np.diag(variances), (objects, 1, 1))))


REPRESSION = ("u' = a/(K + w) - c u", "w' = d u - b w")
VALUES = {"a": 3.44, "K": 1.004, "c": 0.998, "d": 0.502, "b": 0.501}
ERRORS = {"a": 0.02, "K": 0.01, "c": 0.005, "d": 0.004, "b": 0.004}


def test_ones_and_ties_are_shown_in_one_line():
    (first, second) = within_errors(law(REPRESSION, VALUES, ERRORS))
    assert first == "u' = 3.440/(1 + w) - u"
    assert second in ("w' = 0.5015 u - 0.5015 w", "w' = 0.502 u - 0.502 w")


def test_of_several_objects_letters_stay():
    (first, second) = within_errors(law(REPRESSION, VALUES, ERRORS, objects=3))
    assert first == "u' = a/(1 + w) - u"
    assert second in ("w' = d u - d w", "w' = b u - b w")


def test_nothing_is_shown_where_nothing_is_simpler():
    found = law("x' = a - b x", {"a": 2.0, "b": 0.7}, {"a": 0.01, "b": 0.01})
    assert within_errors(found) == ()
    assert "within errors" not in str(found)


@pytest.mark.parametrize(("value", "is_one"), [(1.015, True), (1.04, False)])
def test_a_number_is_one_within_two_standard_errors(value, is_one):
    found = law("x' = -k x", {"k": value}, {"k": 0.01})
    assert within_errors(found) == (("x' = -x",) if is_one else ())


def test_a_number_known_to_few_digits_is_not_called_one():
    assert within_errors(law("x' = -k x", {"k": 1.1}, {"k": 0.4})) == ()


def test_objects_that_differ_by_more_than_their_errors_are_not_called_one():
    together = law("x' = -k x", {"k": 1.0}, {"k": 0.01}, objects=2)
    apart = replace(together, coefficients=together.coefficients * np.array([0.9, 1.1])[:, np.newaxis, np.newaxis])
    assert within_errors(together) == ("x' = -x",)
    assert within_errors(apart) == ()


def test_a_number_with_a_unit_is_no_pure_number():
    trials = cl.datasets.linear_drag(drag=(-1.0,), noise=0.01)
    found = cl.fit("x'' = -g + c v", trials)
    assert abs(named_parameters(found).values[0, 1] + 1) < 0.02
    assert within_errors(found) == ()


def test_print_and_report_show_the_line():
    found = law("x' = -k x", {"k": 1.001}, {"k": 0.01})
    assert str(found).splitlines()[-1] == "within errors: x' = -x"
    assert "within errors" in law_markdown(found)
