"""Where a further trial tells a law from what else it could be."""

import re
from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.array_types import Floats
from commonlaw.discovery.hints import outcomes_of_confounding, outcomes_of_rivals
from commonlaw.law import Law, PlausibleLaw, Provenance
from commonlaw.law.law import with_other_laws
from commonlaw.law.provenance import Domain
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library import Terms, Variables, parse_library, parse_term
from commonlaw.outcomes import OutcomeKind
from commonlaw.trials import Schema

_SCHEMA = Schema(("x",), units={"x": "m", "t": "s"})
_TIMES = np.linspace(0, 2, 21)
_FALL = cl.Trials.from_arrays(_TIMES, 40 - 4.9 * _TIMES**2, names=["x"], units={"x": "m", "t": "s"})


def law(coefficients: list[float], error: float = 1e-3) -> Law:
    """Return a law over 1, x, v, with independent errors."""
    variables = Variables(("x", "v"))
    terms = Terms(variables, tuple(parse_term(each, variables) for each in ("1", "x", "v")))
    values: Floats = np.array([[coefficients]])
    covariance = error**2 * np.eye(int((values != 0).sum()))[np.newaxis]
    domain = Domain({"x": (20.4, 40.0), "v": (-19.6, 0.0)})
    known = Uncertainty(covariance=covariance, noise=np.array([0.05]))
    return Law(terms, _SCHEMA, 2, ("ball",), values, known, Provenance(domain=domain))


def test_a_height_that_stands_in_for_gravity_is_told_by_a_drop_from_elsewhere() -> None:
    rival = law([0, -0.3, 0])
    (said,) = outcomes_of_rivals(with_other_laws(law([-9.8, 0, 0]), (PlausibleLaw(0.3, rival),)), _FALL)
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
def test_nothing_is_said_of_rivals_that_no_trial_need_tell(rival: Law, probability: float) -> None:
    asked = with_other_laws(law([-9.8, 0, 0], error=0.05), (PlausibleLaw(probability, rival),))
    assert outcomes_of_rivals(asked, _FALL) == ()


def test_a_law_of_variables_that_trials_cannot_tell_apart_says_so() -> None:
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3), noise=0.1)
    (said,) = outcomes_of_confounding(drops, 2, parse_library("poly:2"))
    assert (said.kind, said.where) == (OutcomeKind.NOT_IDENTIFIABLE, "x''")
    assert str(said) in str(replace(law([-9.8, 0, 0]), provenance=Provenance(outcomes=(said,))))
