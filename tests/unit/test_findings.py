"""What is found out about a law is found out once, and told as it is."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.verdict import assessment, find
from tests.refusals import refused


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05)


@pytest.fixture(scope="module")
def law(drops):
    return cl.fit("x'' = -g - c v", drops.select(trial="1"))


def test_trials_that_were_held_out_are_forecast_and_the_law_knows_how_far_it_is_good(law, drops):
    found = find(law, drops, drops.select(trial="1"))
    assert {trial.name for trial in found.forecast.trials} == {"2"}
    assert (found.is_held_out, found.has_later_samples, found.lacking) == (True, False, ())
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

    monkeypatch.setattr(assessment, "judge", fails)
    found = find(law, drops)
    assert (found.verdict, found.lacking, found.sentences, found.is_exact) == (None, (words,), (words,), True)
    assert found.forecast is not None


def test_trials_of_other_variables_are_refused(law):
    with refused("columns-differ", kind="states"):
        find(law, cl.datasets.lotka_volterra())
