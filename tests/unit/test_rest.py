"""Objects at rest, such as blanks, are named and left out of a law in which each object has its own coefficients."""

from dataclasses import replace

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
    assert cl.fit("x' = a x + b x^2", plate(BLANKS), shared=["a", "b"], errors="white").objects == (*RATES, "B1", "B2")


@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
@pytest.mark.usefixtures("few_starts")
def test_blanks_stay_out_where_a_law_is_refined_again(scheme):
    trials = plate(BLANKS).select(object=["A1", "B1"])
    law = cl.fit("x' = r x (1 - x)", trials.select(object=["A1"]), errors="white", scheme=scheme)
    law = replace(law, provenance=replace(law.provenance, domain=replace(law.provenance.domain, at_rest=("B1",))))
    again = cl.refine(cl.refine(law, trials, errors="white"), trials, errors="white")
    assert (again.objects, again.provenance.domain.at_rest) == (("A1",), ("B1",))


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


def test_a_small_oscillation_of_few_samples_a_period_counts():
    """Differences of neighbours are then as large as those of white noise."""
    times = np.arange(14.0)
    generator = np.random.default_rng(2)
    grown = [100 / (1 + 40 * np.exp(-rate * times)) for rate in (0.8, 0.9, 1.0)]
    states = [*grown, 2 + 1.5 * np.sin(2 * np.pi * times / 4.6)]
    noisy = [curve[:, np.newaxis] + 0.1 * generator.standard_normal((14, 1)) for curve in states]
    trials = cl.Trials.from_arrays([times] * 4, noisy, object=["A", "B", "C", "small"])
    assert objects_at_rest(trials) == ()


def tracked(across, count=2, names=("x", "z", "y"), digits=2):
    """Damped rotations x and z of some trials, with what was measured across, rounded."""
    generator = np.random.default_rng(5)
    states = [
        np.column_stack(
            [
                *(np.exp(-0.1 * TIMES) * turn(2 * TIMES + k) for turn in (np.cos, np.sin)[: len(names) - 1]),
                across(TIMES, generator),
            ]
        )
        for k in range(count)
    ]
    noisy = np.array(states) + 0.002 * generator.standard_normal((count, len(TIMES), len(names)))
    noisy[:, :, -1] = noisy[:, :, -1].round(digits)
    return cl.Trials.from_arrays([TIMES] * count, [*noisy], names=names)


def test_a_state_that_never_changes_is_left_out_of_a_law_that_takes_tables_with_it():
    trials = tracked(lambda t, _: np.full_like(t, 0.305))
    assert states_at_rest(trials) == ("y",)
    law = cl.discover(trials, order=1, library="poly:1", method=cl.DerivativeRegression(solver="stlsq:0.01"))
    assert law.structure == ("x' = a x + b z", "z' = c x + d z")
    assert "states-at-rest" in {diagnostic.code for diagnostic in law.diagnostics}
    again = cl.law.from_json(cl.law.to_json(law))
    refined = cl.refine(again, trials, errors="white")
    assert refined.predict(trials).score() > 0.99
    assert refined.provenance.domain.constant == ("y",)


def test_one_of_two_states_and_one_that_exceeds_its_resolution_are_kept():
    assert states_at_rest(tracked(lambda t, _: np.full_like(t, 0.305), names=("x", "y"))) == ()
    assert states_at_rest(tracked(lambda t, _: np.full_like(t, 0.305), digits=3)) == ()


def test_a_predator_of_few_samples_is_kept():
    """Lotka-Volterra, five samples a period, the predator measured later."""
    times = np.arange(15.0)
    law = cl.Law.from_text("x' = 1.4 x - 0.09 x y; y' = -1.2 y + 0.06 x y")
    (curve,) = law.simulate(times, [6.0, 8.0]).values()
    states = curve.states * (1 + 0.03 * np.random.default_rng(3).standard_normal((15, 2)))
    states[:2, 1] = np.nan
    trials = cl.Trials.from_arrays(times, states.round(2), names=["x", "y"])
    assert states_at_rest(trials) == ()
    other = np.column_stack([states.round(2), np.linspace(0, 1, 15) ** 2])
    assert states_at_rest(cl.Trials.from_arrays(times, other, names=["x", "y", "z"])) == ()


def test_known_noise_is_what_a_state_may_scatter_by():
    generator = np.random.default_rng(1)
    y = 0.3 + 0.002 * np.clip(generator.standard_normal(40), -1.4, 1.4)
    states = np.column_stack([np.cos(TIMES), np.sin(TIMES), y])
    noise = np.full_like(states, 0.002)
    kept, dropped = (
        cl.Trials.from_arrays(TIMES, states, names=["x", "z", "y"], noise=given) for given in (None, noise)
    )
    assert (states_at_rest(kept), states_at_rest(dropped)) == ((), ("y",))


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
