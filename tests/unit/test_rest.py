"""Objects at rest, such as blanks, are named and left out of a law in which each object has its own coefficients."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import OutcomeKind
from commonlaw.trials.transformations import objects_at_rest, states_at_rest

TIMES = np.linspace(0, 12, 40)
RATES = {"A1": 0.9, "A2": 1.1, "A3": 1.3}


def plate(blanks, inputs=None, noise=0.002):
    """Logistic growth x' = r x (1 - x) of three wells, and constant wells."""
    generator = np.random.default_rng(4)
    curves = {name: 1 / (1 + 49 * np.exp(-r * TIMES)) for name, r in RATES.items()} | blanks
    states = [curve[:, np.newaxis] + noise * generator.standard_normal((len(TIMES), 1)) for curve in curves.values()]
    objects = list(curves)
    return cl.Trials.from_arrays([TIMES] * len(states), states, object=objects, inputs=inputs)


BLANKS = {"B1": np.full(40, 0.05), "B2": np.full(40, 0.1)}


def test_wells_are_fitted_as_without_the_blanks_which_are_named():
    with_blanks, without = plate(BLANKS), plate({})
    law, alone = (cl.fit("x' = a x + b x^2", each, errors="white") for each in (with_blanks, without))
    assert law.objects == tuple(RATES)
    np.testing.assert_allclose(law.coefficients, alone.coefficients, rtol=1e-9)
    (found,) = (diagnostic for diagnostic in law.diagnostics if diagnostic.kind is OutcomeKind.NOT_IDENTIFIABLE)
    assert found.code == "objects-at-rest"
    assert "B1, B2" in found.text
    assert law.coefficients[:, 0, 0] == pytest.approx([*RATES.values()], abs=0.01)


def test_coefficients_that_all_objects_share_are_fitted_to_blanks_too():
    assert cl.fit("x' = a x + b x^2", plate(BLANKS), shared=["a", "b"]).objects == (*RATES, "B1", "B2")


@pytest.mark.parametrize(
    "curve",
    [0.05 * np.exp(-TIMES / 12), 0.05 * TIMES / 12, 0.05 + 0.02 * np.sin(TIMES)],
    ids=["decay", "drift", "oscillation"],
)
def test_small_motions_count(curve):
    assert objects_at_rest(plate({"B1": curve})) == ()


def test_where_all_objects_rest_none_is_left_out():
    states = [np.random.default_rng(k).standard_normal((40, 1)) for k in range(3)]
    assert objects_at_rest(cl.Trials.from_arrays([TIMES] * 3, states, object=["A", "B", "C"])) == ()


def tracked(across, count=2):
    """Damped oscillations x of some trials, with what was measured across."""
    generator = np.random.default_rng(5)
    states = [
        np.column_stack([np.exp(-0.1 * TIMES) * np.cos(2 * TIMES + k), across(TIMES, generator)]) for k in range(count)
    ]
    noise = 0.002 * generator.standard_normal((count, len(TIMES), 2))
    return cl.Trials.from_arrays([TIMES] * count, [*(states + noise)], names=["x", "y"])


def test_a_state_that_never_changes_is_left_out_of_a_law_that_takes_tables_with_it():
    trials = tracked(lambda t, _: np.full_like(t, 0.3))
    law = cl.discover(trials, order=2, library="poly:1")
    assert law.structure == ("x'' = a x + b v",)
    assert "states-at-rest" in {diagnostic.code for diagnostic in law.diagnostics}
    again = cl.law.from_json(cl.law.to_json(law))
    assert again.predict(trials).score() > 0.99
    assert cl.refine(again, trials).provenance.domain.constant == ("y",)


@pytest.mark.parametrize(
    "across",
    [
        lambda t, _: 0.3 + 0.001 * t,
        lambda t, _: 0.3 + 0.005 * np.exp(-0.1 * t) * np.cos(2 * t),
        lambda t, generator: np.full_like(t, generator.normal()),
    ],
    ids=["drift", "small oscillation", "other values in other trials"],
)
def test_states_that_change_are_kept(across):
    assert states_at_rest(tracked(across, 4)) == ()


def test_states_of_noise_alone_are_kept():
    states = [np.random.default_rng(k).standard_normal((40, 2)) for k in range(3)]
    assert states_at_rest(cl.Trials.from_arrays([TIMES] * 3, states, names=["x", "y"])) == ()
