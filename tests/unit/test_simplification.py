"""The simplest form of a law, held against least squares under constraints, and what it is within its errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2

import commonlaw as cl
from commonlaw.law import Provenance
from commonlaw.law.parameters import named_parameters
from commonlaw.law.simplify import within_errors
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.report.markup import law_markdown
from tests.refusals import message, refused


def law_of(equations, values, errors, correlation=0.0, **names):
    """A law with these estimates, numbers or one for each object, and standard errors that depend on each other."""
    law = cl.Law.from_text(equations, values, **names)
    covariance = np.outer(errors, errors) * (np.eye(len(errors)) * (1 - correlation) + correlation)
    covariances = np.tile(covariance, (len(law.objects), 1, 1))
    return replace(law, uncertainty=Uncertainty(covariance=covariances, noise=np.full(len(law.schema.states), 0.1)))


def replaced(law, **settings):
    return {each.parameter: each.form for each in law.simplify(**settings).replaced}


def test_numbers_that_are_known_well_become_ratios_that_are_shorter_to_write():
    law = law_of("x' = a + b x + c x^2", {"a": 0.6668, "b": -1.0004, "c": 1.3719}, [2e-4, 5e-4, 1e-3])
    found = law.simplify()
    assert {each.parameter: each.form for each in found.replaced} == {"a": "2/3", "b": "-1"}
    assert found.equations == ("x' = 2/3 - x + c*x^2",)
    assert found.parameters == ("c",)
    offs = {each.parameter: each.off for each in found.replaced}
    assert offs == pytest.approx({"a": (0.6668 - 2 / 3) / 2e-4, "b": 0.8})
    assert found.chi_square == pytest.approx(offs["a"] ** 2 + offs["b"] ** 2)
    assert found.p_value == pytest.approx(chi2.sf(found.chi_square, 2))
    assert "replaced: b = -1.00040 ± 0.00050 by -1, 0.8 standard errors off" in str(found).splitlines()


@pytest.mark.parametrize(
    ("value", "error", "form"),
    [
        (0.67, 0.05, None),
        (1.02, 0.02, "1"),
        (1.05, 0.02, None),
        (0.1, 0.3, "0"),
        (2.5004, 4e-4, "5/2"),
        (0.3, 0.1, None),
    ],
)
def test_what_is_not_known_well_or_is_far_off_stays(value, error, form):
    law = law_of("x' = a x + b x^3", {"a": value, "b": 0.73912}, [error, 1e-5])
    assert replaced(law).get("a") == form


def test_the_numbers_that_remain_follow_as_by_least_squares_under_the_constraints():
    values, errors = {"a": 0.6670, "b": -0.9995, "c": 1.3719}, [3e-4, 5e-4, 1e-3]
    law = law_of("x' = a + b x + c x^2", values, errors, correlation=0.7)
    found = law.simplify()
    assert found.parameters == ("c",)
    weights = np.linalg.inv(law.uncertainty.covariance[0])

    def distance(c):
        left = np.array([2 / 3, -1.0, c[0]]) - [*values.values()]
        return left @ weights @ left

    best = minimize(distance, [1.37], tol=1e-12)
    assert found.values == pytest.approx(best.x.reshape(1, 1), abs=1e-6)
    assert found.errors == pytest.approx(1 / np.sqrt(weights[2, 2]), abs=1e-9)
    assert found.chi_square == pytest.approx(best.fun, rel=1e-4)


def test_equal_and_opposite_numbers_get_one_parameter():
    law = law_of(
        "s' = a s i; i' = b s i + c i", {"a": -0.4372, "b": 0.4375, "c": -0.1393}, [4e-4, 4e-4, 3e-4], correlation=-0.2
    )
    found = law.simplify()
    assert [(each.parameter, each.form) for each in found.replaced] in ([("a", "-b")], [("b", "-a")])
    assert len(found.parameters) == 2


def test_numbers_with_units_become_each_other_and_no_ratios():
    units = {"t": "s", "x": "m", "y": "m"}
    law = law_of("x' = a x; y' = b x + c y", {"a": 1.0001, "b": 0.99995, "c": 0.5}, [1e-4, 1e-4, 1e-4], units=units)
    assert list(replaced(law).values()) in (["a"], ["b"])


def test_numbers_of_several_objects_are_replaced_if_all_of_them_are_near():
    near, far = {"p": 1.001, "q": 0.9995, "r": 0.9993}, {"p": 1.006, "q": 0.997, "r": 0.997}
    other = {"p": 0.3171, "q": 0.4618, "r": 0.1234}
    for values, expected in ((near, {"a": "1"}), (far, {})):
        law = law_of("x' = a - b x", {"a": values, "b": other}, [1e-3, 1e-4])
        assert np.mean([*values.values()]) == pytest.approx(1, abs=1e-3)
        assert replaced(law) == expected
    assert law.simplify().values.shape == (3, 2)


def test_all_replacements_together_may_be_as_improbable_as_one():
    names = "abcdfg"
    values = {name: 1 + 1.9e-4 * (-1) ** i for i, name in enumerate(names)}
    law = law_of("x' = " + " + ".join(f"{name} x^{i + 1}" for i, name in enumerate(names)), values, [1e-4] * 6)
    found = law.simplify()
    assert 0 < len(found.replaced) < 6
    assert found.p_value >= chi2.sf(4, 1)


@pytest.mark.slow
def test_numbers_without_meaning_are_seldom_replaced():
    generator, count = np.random.default_rng(0), 300
    law = law_of("x' = a x + b x^3", {"a": 1.0, "b": 0.739124}, [1e-3, 1e-7])
    found = sum(
        "a" in replaced(replace(law, coefficients=np.array([[[value, 0.739124]]])))
        for value in generator.uniform(0.5, 2, count)
    )
    assert found < 0.1 * count


def test_an_exponent_becomes_whole_and_the_form_shorter():
    law = law_of("x'' = -g + k*abs(v)^p", {"g": 9.7812, "k": 0.19371, "p": 2.003}, [1e-3, 1e-4, 2e-3])
    found = law.simplify()
    assert found.equations == ("x'' = k*v^2 - g",)
    assert found.parameters == ("g", "k")


def test_a_number_in_two_terms_is_replaced_in_both():
    law = law_of("T' = -k (T - a)", {"k": 0.2502, "a": 21.3713}, [3e-4, 1e-2])
    (equation,) = law.simplify().equations
    assert equation == "T' = (a - T)/4"


def test_the_form_is_fitted_again_to_what_follows_by_covariance():
    times, generator = np.linspace(0, 8, 100), np.random.default_rng(0)
    heat = [air + 60 * np.exp(-times / 4) + 0.01 * generator.standard_normal(100) for air in (21.37, 18.52)]
    trials = cl.Trials.from_arrays([times] * 2, heat, object=["cup", "mug"], names=["T"])
    found = cl.fit("T' = a + b T", trials).simplify()
    assert found.equations == ("T' = a - T/4",)
    law = found.fit(trials)
    assert law.structure == found.equations
    parameters = named_parameters(law)
    assert abs(parameters.values - found.values).max() < 0.2 * found.errors.max()
    np.testing.assert_allclose(parameters.errors, found.errors, rtol=0.05)


OWN_TERMS = replace(cl.Law.from_text("x' = a x", {"a": {"one": 1.0, "other": 0.0}}), provenance=Provenance())


@pytest.mark.parametrize(
    ("law", "tolerance", "expected"),
    [
        (cl.Law.from_text("x' = a x", {"a": 1.0}), 2.0, "uncertainty-unknown"),
        (law_of("x' = a x", {"a": 1.0}, [0.1]), 0.0, message("simplify-tolerance", tolerance=0.0)),
        (OWN_TERMS, 2.0, "simplify-own-terms"),
    ],
)
def test_what_cannot_be_simplified_is_refused(law, tolerance, expected):
    with refused(expected):
        law.simplify(tolerance)


def fraction_law(a, b, half, objects=("u", "v")):
    """A law with a fraction, of values that these objects have in common, known to one percent."""
    names = {"a": a, "b": b, "K": half}
    law = cl.Law.from_text("s' = a + b/(K + s)", {name: dict.fromkeys(objects, value) for name, value in names.items()})
    errors = np.abs(law.coefficients[:, law.support]) / 100
    covariances = errors[:, :, np.newaxis] * errors[:, np.newaxis, :] * np.eye(errors.shape[1])
    return replace(law, uncertainty=Uncertainty(covariance=covariances, noise=np.array([0.1])))


def test_what_remains_of_a_fraction_follows_as_by_least_squares():
    found = fraction_law(-1.2374, 0.631, 0.5113, objects=("u",)).simplify()
    given, sizes = np.array([-1.2374, 0.631, 0.5113]), np.array([1.2374, 0.631, 0.5113]) / 100

    def distance(own):
        return np.sum(((np.array([own[0], -own[0] * own[1], own[1]]) - given) / sizes) ** 2)

    best = minimize(distance, [-1.2, 0.5], tol=1e-14)
    values = dict(zip(found.parameters, found.values[0], strict=True))
    assert [values["a"], values["K"]] == pytest.approx(best.x, rel=1e-4)


def test_a_part_of_a_fraction_that_does_not_vanish_stays():
    found = fraction_law(-1.2374, 0.731, 0.5113).simplify()
    assert found.equations == ("s' = a + b/(K + s)",)
    assert not found.replaced


def test_the_same_law_in_other_words_gets_the_same_form():
    law = law_of("s' = V - V K/(K + s)", {"V": 1.2374, "K": 0.5372}, [0.0, 0.0, 0.01, 0.01])
    assert law.simplify().equations == ("s' = V*s/(K + s)",)


def law(
    equations: str | tuple[str, ...], values: dict[str, float], errors: dict[str, float], objects: int = 1
) -> cl.Law:
    names = tuple(f"o{k}" for k in range(objects))
    found = cl.Law.from_text(equations, {key: dict.fromkeys(names, value) for key, value in values.items()})
    places = {
        (part.equation, part.term): definition.name
        for definition in named_parameters(found).definitions
        for part in definition.parts
    }
    variances = [errors[places[index]] ** 2 for index in map(tuple, np.argwhere(found.support).tolist())]
    return replace(found, uncertainty=Uncertainty(np.tile(np.diag(variances), (objects, 1, 1))))


REPRESSION = ("u' = a/(K + w) - c u", "w' = d u - b w")
VALUES = {"a": 3.44, "K": 1.004, "c": 0.998, "d": 0.502, "b": 0.501}
ERRORS = {"a": 0.02, "K": 0.01, "c": 0.005, "d": 0.004, "b": 0.004}


def test_ones_and_ties_are_shown_in_one_line():
    first, second = within_errors(law(REPRESSION, VALUES, ERRORS))[0].split("; ")
    assert first == "within errors: u' = 3.440/(1 + w) - u"
    assert second in ("w' = 0.5015 u - 0.5015 w", "w' = 0.502 u - 0.502 w")


def test_parameters_that_agree_with_each_other_are_written_by_one():
    reaction = ("A' = a A B", "B' = b A B", "C' = c A B")
    values, errors = {"a": -0.2995, "b": -0.301, "c": 0.3}, {"a": 0.004, "b": 0.005, "c": 0.006}
    (line,) = within_errors(law(reaction, values, errors, objects=3))
    letters = [part.split("=")[1].split()[0].lstrip("-") for part in line.split("; ")]
    assert len(set(letters)) == 1


def test_nothing_is_shown_where_nothing_is_simpler():
    found = law("x' = a - b x", {"a": 2.0, "b": 0.7}, {"a": 0.01, "b": 0.01})
    assert within_errors(found) == []
    assert "within errors" not in str(found)


@pytest.mark.parametrize(
    ("value", "error", "is_one"),
    [(1.015, 0.01, True), (1.04, 0.01, False), (1 + 1.9e-6, 1e-6, True), (1 + 2.1e-6, 1e-6, False)],
)
def test_a_number_is_one_within_two_standard_errors(value, error, is_one):
    found = law("x' = -k x", {"k": value}, {"k": error})
    assert within_errors(found) == (["within errors: x' = -x"] if is_one else [])


def test_a_number_known_to_few_digits_is_not_called_one():
    assert within_errors(law("x' = -k x", {"k": 1.1}, {"k": 0.4})) == []


def test_objects_that_differ_by_more_than_their_errors_are_not_called_one():
    together = law("x' = -k x", {"k": 1.0}, {"k": 0.01}, objects=2)
    apart = replace(together, coefficients=together.coefficients * np.array([0.9, 1.1])[:, np.newaxis, np.newaxis])
    assert within_errors(together) == ["within errors: x' = -x"]
    assert within_errors(apart) == []


def test_a_number_with_a_unit_is_no_pure_number():
    trials = cl.datasets.linear_drag(drag=(-1.0,), noise=0.01)
    found = cl.fit("x'' = -g + c v", trials)
    assert abs(named_parameters(found).values[0, 1] + 1) < 0.02
    assert within_errors(found) == []


def test_print_and_report_show_the_line():
    found = law("x' = -k x", {"k": 1.001}, {"k": 0.01})
    assert str(found).splitlines()[-1] == "within errors: x' = -x"
    assert "within errors" in law_markdown(found)
