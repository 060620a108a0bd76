"""What a fit says of itself: the reasons that decided, what it does not explain, and what was found in residuals."""

import re

import numpy as np
import pytest

import commonlaw as cl
from commonlaw import verdict
from commonlaw.diagnostics import OutcomeKind
from commonlaw.law import select_objects
from commonlaw.law.parameters import named_parameters
from commonlaw.law.text import with_error
from commonlaw.verdict import find
from tests.refusals import refused

TIMES = np.arange(40) * 0.1
NOISE = 0.02


@pytest.fixture(scope="module")
def swayed():
    """Decays that something unknown sways, slowly."""
    draws = np.random.default_rng(0)
    curves = [
        start * np.exp(-0.5 * TIMES) + 0.3 * np.sin(2 * TIMES + start) + NOISE * draws.standard_normal(40)
        for start in (5.0, 6.0)
    ]
    return cl.Trials.from_arrays([TIMES] * 2, curves, names=["x"], units={"x": "m", "t": "s"})


@pytest.fixture(scope="module")
def white(swayed):
    return cl.fit("x' = -k x", swayed, errors="white")


def step(law, stage):
    return next(each for each in law.history if each.stage == stage)


def kinds(law):
    return [diagnostic.kind for diagnostic in law.diagnostics]


def test_white_noise_that_does_not_explain_what_a_law_leaves_is_said_to_fail(white):
    assert kinds(white) == [OutcomeKind.RESIDUALS]
    assert "autocorrelated" in white.diagnostics[0].text
    assert "autocorrelated" in step(white, "model error").reason


def test_a_fit_that_departs_from_the_measurements_says_so_as_a_discovery_does(swayed):
    given = cl.fit("x' = -k x", swayed)
    assert OutcomeKind.RESIDUALS not in kinds(given)
    assert given.uncertainty.error_model.of_law
    assert "beyond the law: " in str(given)
    verdict = given.assess(swayed)
    assert (verdict.exact, verdict.none_exact) == (False, False)


def test_noise_that_was_given_is_said_to_be_given(swayed):
    for errors in ("white", "autocorrelated"):
        law = cl.fit("x' = -k x", swayed, noise={"x": 0.3}, errors=errors)
        assert law.uncertainty.noise[0] == 0.3
        assert step(law, "noise").reason == "as given"


def test_a_law_that_is_fitted_again_keeps_no_outcome_of_the_fit_before(white):
    draws = np.random.default_rng(1)
    clean = 5 * np.exp(-0.5 * TIMES) + NOISE * draws.standard_normal(40)
    trials = cl.Trials.from_arrays(TIMES, clean, names=["x"], units={"x": "m", "t": "s"})
    assert kinds(cl.refine(select_objects(white, white.objects[:1]), trials)) == []


def test_errors_that_were_chosen_are_said_with_what_they_change():
    exact = 20 * np.exp(-0.5 * np.linspace(0, 8, 60))
    noisy = exact * (1 + 0.15 * np.random.default_rng(0).standard_normal(60))
    trials = cl.Trials.from_arrays(np.linspace(0, 8, 60), noisy, names=["c"])
    law, white = (cl.fit("c' = -k c", trials, errors=errors) for errors in ("auto", "white"))
    said = step(law, "misfit")
    assert said.choice == "proportional noise"
    assert float(re.search(r"(\S+) over white noise", said.reason).group(1)) > 10
    (here, error), (there, other) = (
        tuple(map(np.ndarray.item, (named_parameters(each).values, named_parameters(each).errors)))
        for each in (law, white)
    )
    assert said.reason.endswith(f"k is {with_error(here, error)}, and {with_error(there, other)} under white noise")
    assert "misfit" not in {each.stage for each in white.history}


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05)


@pytest.fixture(scope="module")
def law(drops):
    return cl.fit("x'' = -g - c v", drops.select(trial="1"))


def test_trials_that_were_held_out_are_forecast_and_the_law_knows_how_far_it_is_good(law, drops):
    found = find(law, drops, drops.select(trial="1"))
    assert {trial.name for trial in found.forecast.trials} == {"2"}
    assert (found.is_held_out, found.has_later_samples, found.failures) == (True, False, ())
    assert found.sentences == law.assess(drops, drops.select(trial="1")).sentences
    assert found.law.provenance.domain.horizon == found.verdict.horizon > 0
    assert law.provenance.domain.horizon is None


def test_later_samples_are_forecast_with_those_before(law, drops):
    first = drops.select(trial="1")
    found = find(law, first, first.until(1.5), bands=False)
    assert (found.is_held_out, found.has_later_samples) == (False, True)
    assert found.forecast.std is None
    assert find(law, first).has_later_samples is False


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (cl.CommonlawError("other", text="too short"), "the forecast assessment failed: too short"),
        (np.linalg.LinAlgError("singular"), "the forecast assessment failed: LinAlgError: singular"),
    ],
)
def test_a_verdict_that_cannot_be_had_leaves_forecasts_and_its_reason(law, drops, monkeypatch, error, words):
    def fails(*_):
        raise error

    monkeypatch.setattr(verdict, "assess", fails)
    found = find(law, drops)
    assert (found.verdict, found.failures, found.sentences, found.is_exact) == (None, (words,), (words,), True)
    assert found.forecast is not None


def test_trials_of_other_variables_are_refused(law):
    with refused("columns-differ", kind="states"):
        find(law, cl.datasets.lotka_volterra())
