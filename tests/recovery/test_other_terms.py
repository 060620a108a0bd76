"""What else a law could be, where it has other terms with parameters inside."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import lambertw

import commonlaw as cl
from commonlaw.law import Law, Provenance, from_json, to_json
from commonlaw.law.alignment import with_parameters_of
from commonlaw.law.parameters import coefficient_intervals


@pytest.fixture(scope="module")
def trials() -> cl.Trials:
    """Of one object, at a noise at which other laws remain plausible."""
    generator, times = np.random.default_rng(3), np.linspace(0, 5, 25)
    # s' = -s/(0.8 + s)
    states = [0.8 * lambertw(start / 0.8 * np.exp((start - times) / 0.8)).real for start in (3.0, 1.5)]
    noisy = [state[:, np.newaxis] + 0.05 * generator.standard_normal((len(times), 1)) for state in states]
    return cl.Trials.from_arrays([times] * 2, noisy, names=["s"])


@pytest.fixture(scope="module")
def law(trials) -> Law:
    return cl.discover(trials, library="poly:2 + saturating", order=1)


def test_laws_with_other_terms_are_plausible_by_their_evidence(law, trials):
    assert law.structure == ("s' = a s/(K + s)",)
    assert sum(model.probability for model in law.models) == pytest.approx(1)
    second = law.uncertainty.other_laws[0]
    assert second.law.structure == ("s' = a + b/(K2 + s)",)
    behind = cl.compare([law, cl.fit("s' = a + b/(K2 + s)", trials)], trials)["2 log B"].max()
    # But for the prior of terms, which a comparison of laws leaves out
    assert np.log(law.models[0].probability / second.probability) == pytest.approx(behind / 2, abs=0.5)


def test_a_law_in_other_words_is_not_counted_twice(law):
    """``a + b s/(K + s)`` is ``a + b - b K/(K + s)``."""
    said = [model.law.structure for model in law.models]
    assert ("s' = a + b s/(K + s)",) not in said


def test_intervals_and_draws_are_of_the_same_terms_and_constants(law):
    with_it = sum(model.probability for model in law.models if "s/(K + s)" in model.law.terms.names)
    drawn = law.sample(200_000)
    assert np.mean(drawn["K"] == 0) == pytest.approx(1 - with_it, abs=0.01)
    (low,), (high,) = (ends[:, 0, law.terms.index("K")] for ends in coefficient_intervals(law, averaged=True))
    assert np.quantile(drawn["K"], [0.025, 0.975]) == pytest.approx([low, high], abs=0.03)


def test_forecasts_are_averaged_over_laws_of_other_terms(law, trials):
    forecast = law.predict(trials, return_std=True)
    assert len(forecast.parts) == len(law.models)
    alone = law.predict(trials, return_std=True, averaged=False)
    assert forecast.std[0].max() >= alone.std[0].max()


def test_laws_of_other_terms_are_kept(law):
    kept = from_json(to_json(law))
    assert to_json(kept) == to_json(law)
    for model, other in zip(kept.models, law.models, strict=True):
        assert model.law.terms == other.law.terms
        assert model.law.structure == other.law.structure
        np.testing.assert_array_equal(model.law.coefficients, other.law.coefficients)


def test_constants_have_one_name_where_they_are_inside_of_the_same_terms():
    law = Law.from_text("x' = x/(K + x) + y/(L + y); y' = x/(M + x)", dict.fromkeys("KLM", 1.0))
    other = Law.from_text("x' = y/(K + y) + y; y' = x/(L + x) + exp(x/M)", dict.fromkeys("KLM", 2.0))
    named = with_parameters_of(replace(other, provenance=Provenance()), law)
    assert named.terms.names == ("y/(L + y)", "y", "x/(M + x)", "exp(x/M2)", "L", "M", "M2")
