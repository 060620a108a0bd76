"""A law says how accurate it is: in numbers, text, frames and JSON."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st
from scipy.stats import norm

from commonlaw.diagnostics import Diagnostic
from commonlaw.law import (
    History,
    Law,
    Provenance,
    Step,
    Uncertainty,
    average_law,
    from_json,
    select_objects,
    to_frame,
    to_json,
    to_latex,
)
from commonlaw.law.objects import of_all_objects
from commonlaw.law.parameters import named_parameters, standard_errors
from commonlaw.law.tables import readable
from commonlaw.law.text import latex_with_error, with_error
from commonlaw.library import PolynomialLibrary, Variables
from commonlaw.trials import Schema
from tests.refusals import refused

HEIGHT = Schema(("x",), object="ball", trial="drop", units={"x": "m", "t": "s"})
STEPS = (Step("noise", "x: 0.05 m", "from differences of order 4"), Step("support", "1, v", "evidence " * 12))


@pytest.fixture
def drag():
    """``x'' = a + b v`` with a known for the light ball."""
    terms = PolynomialLibrary(2).bind(Variables(("x", "v")))
    coefficients = np.zeros((2, 1, len(terms)))
    coefficients[:, 0, terms.index("1")] = [-9.4412, -9.8]
    coefficients[:, 0, terms.index("v")] = [-0.48, 0.0466]
    covariance = [[[0.1234**2, 1e-3], [1e-3, 0.02**2]], [[0, 0], [0, 0.0051**2]]]
    inclusion = np.linspace(0, 1, len(terms))[np.newaxis]
    uncertainty = Uncertainty(covariance, noise=[0.05], inclusion_probabilities=inclusion)
    return Law(terms, HEIGHT, 2, ("heavy", "light"), coefficients, uncertainty, Provenance(history=STEPS))


def without(law, *names):
    """The law without these parts of its uncertainty."""
    return replace(law, uncertainty=replace(law.uncertainty, **dict.fromkeys(names)))


@pytest.fixture
def predators():
    """Two equations, the hare's without the second term of the fox's."""
    terms = PolynomialLibrary(2).bind(Variables(("x", "y")))
    coefficients = np.zeros((2, 2, len(terms)))
    coefficients[:, 0, terms.index("x")] = [1.0, 2.0]
    coefficients[1, 0, terms.index("x y")] = -0.5
    coefficients[:, 1, terms.index("y")] = [-3.0, -4.0]
    covariance = np.array([np.diag([0.1, 0.0, 0.3]) ** 2, np.diag([0.2, 0.05, 0.4]) ** 2])
    return Law(terms, Schema(("x", "y")), 1, ("hare", "fox"), coefficients, uncertainty=Uncertainty(covariance))


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (-9.4412, 0.1234, "-9.44 ± 0.12"),
        (0.48, 0.02, "0.480 ± 0.020"),
        (9.87, 0.0996, "9.87 ± 0.10"),
        (0.012, 0.34, "0.01 ± 0.34"),
        (-0.0001, 0.34, "0.00 ± 0.34"),
        (3.0, 21.4, "3 ± 21"),
        (1234.5, 678.9, "1230 ± 680"),
        (999999.0, 12.0, "999999 ± 12"),
        (2.5e7, 1.5e6, "(2.50 ± 0.15)e+07"),
        (1.2e-5, 3.4e-7, "(1.200 ± 0.034)e-05"),
        (-1.2e-5, 3.4e-3, "0.0000 ± 0.0034"),
        (1.2e-7, 3.4e-5, "(0.0 ± 3.4)e-05"),
        (-9.8, 1.2e-9, "-9.8 ± 1.2e-09"),
        (-9.8, 0.0, "-9.8"),
        (1.23456e-7, 0.0, "1.235e-07"),
    ],
)
def test_numbers_are_written_as_far_as_their_error_lets_them_be(value, error, text):
    assert with_error(value, error) == text


def test_latex_numbers_have_powers_and_brackets():
    assert latex_with_error(1.2e-5, 3.4e-7) == r"\left(1.200 \pm 0.034\right) \times 10^{-5}"
    assert latex_with_error(0.48, 0.02, bracket=True) == r"\left(0.480 \pm 0.020\right)"
    assert latex_with_error(9.8, 1.2e-9) == r"9.8 \pm 1.2 \times 10^{-9}"
    assert latex_with_error(1.23456e-7, 0.0) == r"1.235 \times 10^{-7}"


@given(
    st.floats(1e-12, 1e12), st.floats(1e-7, 1e5), st.sampled_from([1, -1]), st.booleans(),
)  # fmt: skip
def test_a_written_number_is_within_half_a_unit_of_the_errors_second_digit(size, ratio, sign, bracket):
    value, error = sign * size, size * ratio
    text = with_error(value, error, bracket=bracket)
    mantissas, _, power = text.partition(")")
    scale = 10.0 ** int(power[1:] or 0) if power else 1.0
    number, doubt = (float(part) * scale for part in mantissas.strip("(").split(" ± "))
    unit = 10.0 ** (math.floor(math.log10(error)) - 1)
    assert abs(number - value) <= 0.51 * 10 * unit
    assert abs(doubt - error) <= 0.51 * unit * 1.001
    assert bracket <= text.startswith("(")


def test_equations_show_errors_where_they_are_known_and_not_if_not_wanted(drag):
    assert drag.equations("heavy") == ("x'' = -9.44 ± 0.12 - (0.480 ± 0.020) v",)
    assert drag.equations("light") == ("x'' = -9.8 + (0.0466 ± 0.0051) v",)
    assert drag.equations("heavy", errors=False) == ("x'' = -9.441 - 0.48 v",)
    assert without(drag, "covariance").equations("heavy") == ("x'' = -9.441 - 0.48 v",)


def test_a_constant_that_follows_another_term_is_in_brackets():
    terms = PolynomialLibrary(1).bind(Variables(("x",))).take([1, 0])
    law = Law(
        terms, Schema(("x",)), 1, ("one",), np.array([[[-2.0, -1.0]]]), uncertainty=Uncertainty([np.diag([0.01, 0.01])])
    )
    assert law.equations() == ("x' = -(2.00 ± 0.10) x - (1.00 ± 0.10)",)


def test_print_shows_errors_of_one_object_and_in_the_table_of_several(drag, predators):
    assert str(select_objects(drag, ["heavy"])).startswith("x'' = -9.44 ± 0.12 - (0.480 ± 0.020) v\n")
    assert str(drag).split("\n")[2:5] == [
        "           a [m/s²]          b [1/s]",
        "heavy  -9.44 ± 0.12   -0.480 ± 0.020",
        "light          -9.8  0.0466 ± 0.0051",
    ]
    assert "fox:\n  x' = (2.00 ± 0.20) x - (0.500 ± 0.050) x y" in str(predators)


def test_latex_shows_errors(drag):
    text = to_latex(drag, "heavy")
    assert r"\ddot{x} &= -9.44 \pm 0.12 - \left(0.480 \pm 0.020\right)\, v" in text
    assert r"\pm" not in to_latex(drag, "heavy", errors=False)


def test_standard_errors_are_zero_where_known_and_nan_where_there_is_nothing(drag):
    errors = standard_errors(drag)[:, 0, [drag.terms.index("1"), drag.terms.index("v")]]
    np.testing.assert_allclose(errors, [[0.1234, 0.02], [0, 0.0051]])
    assert np.isnan(standard_errors(drag)).sum() == 2 * (len(drag.terms) - 2)
    assert np.isnan(standard_errors(without(drag, "covariance"))).all()


def test_intervals_are_those_of_the_normal_distribution(drag):
    frame = drag.conf_int(0.9)
    columns = ["object", "equation", "term", "parameter", "estimate", "standard error", "low", "high", "unit"]
    assert list(frame.columns) == [*columns, "inclusion probability"]
    assert frame["parameter"].tolist() == ["a", "b"] * 2
    assert frame["unit"].tolist() == ["m/s²", "1/s"] * 2
    assert (
        frame["inclusion probability"].tolist() == [*drag.uncertainty.inclusion_probabilities[0, drag.support[0]]] * 2
    )
    assert list(without(drag, "inclusion_probabilities").conf_int().columns) == columns
    assert frame["object"].tolist() == ["heavy", "heavy", "light", "light"]
    for end, share in (("low", 0.05), ("high", 0.95)):
        np.testing.assert_allclose(frame[end], frame["estimate"] + norm.ppf(share) * frame["standard error"])
    assert frame.loc[2, ["low", "high"]].tolist() == [-9.8, -9.8]
    with refused("level-range", level=95):
        drag.conf_int(95)


def test_the_frame_has_a_column_of_errors_after_each_term(drag, predators):
    assert to_frame(drag).equals(to_frame(without(drag, "covariance")))
    frame = to_frame(drag, errors=True)
    assert frame.columns.tolist() == ["1", "1 ±", "v", "v ±"]
    np.testing.assert_allclose(frame.loc["heavy"], [-9.4412, 0.1234, -0.48, 0.02])
    assert to_frame(predators, errors=True)["x'", "x y ±"].tolist() == [0.0, pytest.approx(0.05)]


def test_what_is_not_known_is_not_made_up(drag):
    bare = without(drag, "covariance")
    for ask in (
        bare.conf_int,
        lambda: bare.equations("heavy", errors=True),
        lambda: to_latex(bare, "heavy", errors=True),
        lambda: to_frame(bare, errors=True),
    ):
        with refused("uncertainty-unknown"):
            ask()


def test_the_covariance_of_an_average_is_that_of_a_mean_of_independent_objects(drag):
    average = average_law(drag)
    np.testing.assert_allclose(average.uncertainty.covariance[0], drag.uncertainty.covariance.sum(axis=0) / 4)
    assert average.uncertainty.noise.tolist() == [0.05]


def test_selected_objects_keep_their_covariance_for_the_terms_that_are_left(drag, predators):
    np.testing.assert_array_equal(
        select_objects(drag, ["light"]).uncertainty.covariance, drag.uncertainty.covariance[1:]
    )
    hare = select_objects(predators, ["hare"])
    np.testing.assert_allclose(hare.uncertainty.covariance, [np.diag([0.1, 0.3]) ** 2])
    assert hare.equations() == ("x' = (1.00 ± 0.10) x", "y' = -(3.00 ± 0.30) y")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("covariance", np.eye(2), Diagnostic("law-array-shape", {"array": "covariance"})),
        ("covariance", np.full((2, 2, 2), np.nan), Diagnostic("law-array-not-finite", {"array": "covariance"})),
        ("covariance", [[[1, 0.5], [0.4, 1]]] * 2, Diagnostic("law-covariance-asymmetric", {"name": "heavy"})),
        ("covariance", np.array([np.eye(2), -np.eye(2)]), Diagnostic("law-variance-negative", {"name": "light"})),
        ("noise", [0.1, 0.2], Diagnostic("law-array-shape", {"array": "noise", "axes": "measured quantities"})),
        ("noise", [-0.1], Diagnostic("law-array-range", {"array": "noise", "value": -0.1, "low": 0})),
        ("inclusion_probabilities", [[0, 0, 2, 0, 0, 0]], Diagnostic("law-array-range", {"value": 2.0, "high": 1})),
    ],
)
def test_what_is_no_covariance_noise_or_probability_is_refused(drag, field, value, message):
    with refused(message):
        replace(drag, uncertainty=replace(drag.uncertainty, **{field: value}))


def test_the_covariance_cannot_be_changed_and_is_symmetric_to_the_last_digit(drag):
    matrix = np.array([[[1.0, 0.5], [0.5 + 1e-12, 1.0]]] * 2)
    law = replace(drag, uncertainty=replace(drag.uncertainty, covariance=matrix))
    np.testing.assert_array_equal(law.uncertainty.covariance, law.uncertainty.covariance.transpose(0, 2, 1))
    for array in (law.uncertainty.covariance, law.uncertainty.noise, law.uncertainty.inclusion_probabilities):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_the_history_prints_as_a_table(drag):
    assert isinstance(drag.provenance.history, tuple)
    assert drag.provenance.history == STEPS
    assert str(drag.provenance.history).split("\n") == [
        "stage    choice     reason",
        "noise    x: 0.05 m  from differences of order 4",
        "support  1, v       " + " ".join(["evidence"] * 6),
        "                    " + " ".join(["evidence"] * 6),
    ]
    assert str(History()) == "no choices are on record"


def test_a_saved_law_keeps_its_uncertainty_to_the_last_bit(drag, predators):
    for law in (drag, predators, without(drag, "covariance", "noise", "inclusion_probabilities")):
        again = from_json(to_json(law))
        assert again == law
        assert again.history == law.history


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda saved: saved["covariance"]["heavy"].append(None), "not-a-law"),
        (lambda saved: saved["covariance"]["heavy"].append(math.nan), "not-a-law"),
        (lambda saved: saved["covariance"]["heavy"].pop(), Diagnostic("law-covariance-size", {"expected": 3})),
        (lambda saved: saved["covariance"].pop("heavy"), Diagnostic("law-covariance-size", {"name": "heavy"})),
        (lambda saved: saved["inclusion_probabilities"][0].pop(), Diagnostic("law-table-size", {"columns": 6})),
    ],
)
def test_damaged_uncertainty_is_refused(drag, damage, message):
    document = json.loads(to_json(drag))
    damage(document["uncertainty"])
    with refused(message):
        from_json(json.dumps(document))


def test_draws_scatter_as_the_covariance_says(drag):
    draws = drag.sample(20000)
    assert draws.columns.tolist() == ["a", "b"]
    assert draws.index.names == ["draw", "object"]
    for name, mean, covariance in zip(
        drag.objects, drag.coefficients[:, drag.support], drag.uncertainty.covariance, strict=True
    ):
        own = draws.xs(name, level="object")
        # Five standard errors of means and of covariances of so many draws
        spread = np.sqrt(np.diag(covariance))
        assert np.all(np.abs(own.mean() - mean) <= 5 * spread / np.sqrt(20000) + 1e-12)
        np.testing.assert_allclose(own.cov(), covariance, atol=5 * np.sqrt(2 / 20000) * spread.max() ** 2, rtol=0.05)
    assert (draws.xs("light", level="object")["a"] == -9.8).all()
    assert draws.equals(drag.sample(20000))
    assert not draws.equals(drag.sample(20000, seed=1))


def test_draws_of_objects_go_together_as_far_as_objects_learned_from_each_other(drag):
    factor = np.array([[[0.1], [0.01]], [[0.0], [0.004]]])
    own = np.array([np.diag([0.05, 0.02]) ** 2, np.diag([0.0, 0.003]) ** 2])
    covariance = own + factor @ factor.transpose(0, 2, 1)
    law = replace(drag, uncertainty=Uncertainty(covariance, shared_factor=factor))
    found = np.cov(law.sample(40000).unstack("object").to_numpy(), rowvar=False)  # a heavy, a light, b heavy, b light
    expected = np.array([0.1 * 0.004, 0.01 * 0.004])
    np.testing.assert_allclose(found[[0, 2], 3], expected, rtol=0.1)
    np.testing.assert_allclose(np.diag(found)[[0, 2, 3]], [0.0125, 0.0005, 2.5e-5], rtol=0.05)


def test_draws_of_a_given_law_are_of_its_own_parameters():
    given = Law.from_text("x'' = -g - v/c", {"g": 9.81, "c": 4.0})
    law = replace(given, uncertainty=Uncertainty(np.zeros((1, 2, 2))))
    assert law.sample(3).to_numpy() == pytest.approx(np.array([[9.81, 4.0]] * 3))


def test_draws_need_a_covariance_and_a_number(drag):
    with refused("uncertainty-unknown"):
        without(drag, "covariance").sample()
    with refused("whole-number", name="n", value=0):
        drag.sample(0)
    with refused("argument-type", name="n"):
        drag.sample(2.5)


def test_tables_that_are_read_have_the_digits_that_mean_something():
    columns = {"coefficient": [0.447096, 12345.6], "standard error": [0.0050877, 678.0], "low": [0.4370344, 11016.7]}
    shown = readable(
        pd.DataFrame(
            {"term": ["x", "1"], **columns, "term probability": [4e-320, 0.123456], "probability": [np.nan, 1.0]}
        )
    )
    assert shown.loc[0].tolist() == ["x", "0.4471", "0.0051", "0.4370", "< 1e-9", ""]
    assert shown.loc[1].tolist() == ["1", "12350", "680", "11020", "0.1235", "1"]


def test_the_covariance_of_parameters_is_that_of_their_standard_errors(drag):
    for i, name in enumerate(drag.objects):
        covariance = drag.cov_params(name)
        assert covariance.index.tolist() == covariance.columns.tolist() == [*named_parameters(drag).names]
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)), named_parameters(drag).errors[i])


def test_laws_of_several_objects_join_where_each_has_its_terms():
    both = Law.from_text("x' = a + b x", {"a": {"A": 1.0, "B": 2.0}, "b": {"A": -0.5, "B": -0.25}})
    without = Law.from_text("x' = a + b x", {"a": {"C": 3.0}, "b": {"C": 0.0}})
    assert without.support.sum() == 1
    matrices = np.array([[[4.0, 1.0], [1.0, 2.0]], [[5.0, -1.0], [-1.0, 3.0]]])
    laws = [
        replace(both, uncertainty=Uncertainty(matrices)),
        replace(without, uncertainty=Uncertainty(np.array([[[0.09]]]))),
    ]
    coefficients, covariance = of_all_objects(laws)
    assert coefficients[:, 0].tolist() == [[1.0, -0.5], [2.0, -0.25], [3.0, 0.0]]
    assert covariance.tolist() == [*matrices.tolist(), [[0.09, 0.0], [0.0, 0.0]]]
