"""Which variables trials cannot tell apart, before any law, and which further trials would."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw.array_types import Floats
from commonlaw.diagnostics import OutcomeKind
from commonlaw.discovery.hints import outcomes_of_confounding, outcomes_of_rivals
from commonlaw.inference.diagnose.confounding import confounded_sets
from commonlaw.law import Law, PlausibleLaw, Provenance
from commonlaw.law.law import with_other_laws
from commonlaw.law.provenance import Domain
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library import Terms, Variables, parse_library, parse_term
from commonlaw.trials import Schema
from tests.refusals import refused
from tests.simulations import simulated

_BALLS = {"golf": (0.05, 0.004), "tennis": (0.1, 0.012)}
"""Linear and quadratic drag."""


def drops(*heights, scales=(1, 1, 1, 1)):
    """Return drops of both balls from rest, each of 40 samples in 2.7 s, their heights multiplied by scales."""

    def rates(_, y, linear, square):
        return [y[1], -9.8 - linear * y[1] + square * y[1] ** 2]

    trials = simulated(rates, _BALLS, [[h, 0] for h in heights], np.arange(40) / 15, 0.05, ("x",), absolute=True)
    scaled = [replace(trial, states=scale * trial.states) for trial, scale in zip(trials, scales, strict=True)]
    return cl.Trials(tuple(scaled), Schema(("x",), units={"x": "m"}))


@pytest.mark.parametrize("library", ["poly:2", None])
def test_drops_from_one_height_cannot_tell_height_from_velocity_and_from_two_they_can(library):
    (found,) = confounded_sets(drops(47, 47), 2, library)
    assert found.sets == (("x",), ("v",))
    assert not found.by_trial
    # Both leave the noise: neither is better than what was measured allows
    assert found.rms == pytest.approx([0.05, 0.05], rel=0.25)
    assert found.rms_of_all == pytest.approx(0.05, rel=0.25)
    assert found.starts["x"] == pytest.approx((47, 47), abs=0.15)
    assert not confounded_sets(drops(47, 38), 2, library)


def test_a_height_that_stands_in_for_what_makes_trials_differ_is_told():
    (found,) = confounded_sets(drops(47, 47, scales=np.array([1, 1.2, 1, 0.85])), 2)
    assert found.sets == (("x",), ("v",))
    assert found.by_trial


def test_states_that_sum_to_a_constant_stand_in_for_each_other():
    random, times = np.random.default_rng(0), np.linspace(0, 20, 80)

    def rates(_, y):
        infected = 1.5 * y[0] * y[1]
        return [-infected, infected - 0.5 * y[1], 0.5 * y[1]]

    paths = [solve_ivp(rates, (0, 20), [1 - i, i, 0], t_eval=times, rtol=1e-9).y.T for i in (0.01, 0.05)]
    states = [path + 0.003 * random.standard_normal(path.shape) for path in paths]
    trials = cl.Trials.from_arrays([times, times], states, names=["S", "I", "R"])
    found = {each.state: each.sets for each in confounded_sets(trials, 1, "poly:2")}
    assert {("S", "I"), ("S", "R")} <= set(found["I"])


def test_trials_too_short_for_all_terms_say_nothing():
    short = cl.Trials.from_arrays([0.0, 1, 2, 3, 4, 5], [5.0, 4, 3.5, 3, 2.6, 2.3])
    assert confounded_sets(short, 2, "poly:3") == ()


def test_the_data_check_says_what_trials_from_one_height_cannot_tell():
    trials = drops(47, 47)
    (said,) = (str(each) for each in trials.check(library="poly:2").found if each.column == "x")
    assert said.startswith("x'': x and v are confounded, because all trials have similar initial conditions, at x = 4")
    assert "laws in x alone or v alone fit equally well (RMS residual 0.0" in said
    assert said.endswith("other initial values of x")
    assert not any("confounded" in finding for finding in trials.check(order=0).findings)
    with refused("order-unsupported", order=3):
        trials.check(order=3)


_SCHEMA = Schema(("x",), units={"x": "m", "t": "s"})
_TIMES = np.linspace(0, 2, 21)
_FALL = cl.Trials.from_arrays(_TIMES, 40 - 4.9 * _TIMES**2, names=["x"], units={"x": "m", "t": "s"})


def law(coefficients, error=0.001):
    """Return a law over 1, x, v, with independent errors."""
    variables = Variables(("x", "v"))
    terms = Terms(variables, tuple(parse_term(each, variables) for each in ("1", "x", "v")))
    values: Floats = np.array([[coefficients]])
    covariance = error**2 * np.eye(int((values != 0).sum()))[np.newaxis]
    domain = Domain({"x": (20.4, 40.0), "v": (-19.6, 0.0)})
    known = Uncertainty(covariance=covariance, noise=np.array([0.05]))
    return Law(terms, _SCHEMA, 2, ("ball",), values, known, Provenance(domain=domain))


def test_a_height_that_stands_in_for_gravity_is_told_by_a_drop_from_elsewhere():
    rival = law([0, -0.3, 0])
    several, said = outcomes_of_rivals(with_other_laws(law([-9.8, 0, 0]), (PlausibleLaw(0.3, rival),)), _FALL)
    assert several.code == "several-laws-plausible"
    assert said.kind is OutcomeKind.NOT_IDENTIFIABLE
    assert said.code == "rival-plausible"
    assert "x in place of 1" in said.text
    # From any start the two are x = h - 4.9 t^2 and x = h cos(sqrt(0.3) t) for v = 0
    assert "and v = 0, ball reaches" in said.text
    found = re.search(r"From x = (\S+) m .* reaches x = (\S+) ± .* after (\S+) s by .* but (\S+) ±", said.text)
    assert found is not None
    start, by_law, after, by_rival = map(float, found.groups())
    assert by_law == pytest.approx(start - 4.9 * after**2, abs=0.1)
    assert by_rival == pytest.approx(start * np.cos(np.sqrt(0.3) * after), abs=0.1)


@pytest.mark.parametrize(
    ("rival", "probability"),
    [
        (law([0, -0.3, 0]), 0.01),  # Evidence is strong against it
        (law([-9.8, 0, -1e-3]), 0.3),  # It says the same everywhere
        (law([0, -0.3, 0], error=2.0), 0.3),  # Its bands hold what the other forecasts
    ],
    ids=["improbable", "alike", "uncertain"],
)
def test_nothing_is_said_of_rivals_that_no_trial_need_tell(rival, probability):
    asked = with_other_laws(law([-9.8, 0, 0], error=0.05), (PlausibleLaw(probability, rival),))
    codes = [outcome.code for outcome in outcomes_of_rivals(asked, _FALL)]
    assert codes == (["several-laws-plausible"] if probability > 0.1 else [])


def test_a_law_of_variables_that_trials_cannot_tell_apart_says_so():
    fallen = cl.datasets.linear_drag(drag=(-0.1, -0.3), noise=0.1)
    (said,) = outcomes_of_confounding(fallen, 2, parse_library("poly:2"))
    assert (said.kind, said.where) == (OutcomeKind.NOT_IDENTIFIABLE, "x''")
    assert str(said) in str(replace(law([-9.8, 0, 0]), provenance=Provenance(outcomes=(said,))))


def test_a_parameter_at_infinity_changes_nothing_and_is_refused():
    """A positive rate of falling values is best where it vanishes, at an exponent without limit."""
    times = np.linspace(0, 2, 8)
    with refused("parameters-not-identified", names=["b"]):
        cl.fit("x' = exp(-b (2 + x))", cl.Trials.from_arrays(times, np.exp(-times), names=["x"]))
