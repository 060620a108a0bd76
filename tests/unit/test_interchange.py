"""Parameters that change places without a change of the measurements: absorption and elimination."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.law.parameters import named_parameters

HOURS = np.array([0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 24.0])
TRUTH = {"a": (1.2, 8.0, 0.1), "b": (1.5, 10.0, 0.12)}
ORAL = "depot' = -ka depot; C' = ka depot/V - k C; depot(0) = 100; C(0) = 0"


def absorbed(p, times=HOURS):
    ka, volume, k = p
    return 100 / volume * ka / (ka - k) * (np.exp(-k * times) - np.exp(-ka * times))


@pytest.fixture(scope="module")
def swallowed():
    """Trials, and the estimates of least squares with the faster rate as absorption."""
    random = np.random.default_rng(0)
    measured = {name: absorbed(p) + 0.05 * random.standard_normal(len(HOURS)) for name, p in TRUTH.items()}
    best = [least_squares(lambda p, y=y: absorbed(p) - y, TRUTH[name], xtol=1e-12).x for name, y in measured.items()]
    return cl.Trials.from_arrays([HOURS] * 2, [*measured.values()], object=[*TRUTH], names=["C"]), np.array(best)


def flipped(best):
    ka, volume, k = best.T
    return np.column_stack([k, volume * k / ka, ka])


def ambiguous(law):
    return [diagnostic for diagnostic in law.diagnostics if diagnostic.code == "latent-state-ambiguous"]


@pytest.mark.parametrize("names", [("ka", "k"), ("z", "a")])
def test_absorption_is_the_faster_one_whatever_it_is_called(swallowed, names):
    trials, best = swallowed
    text = ORAL.replace("ka ", f"{names[0]} ").replace("- k C", f"- {names[1]} C")
    law = cl.fit(text, trials)
    parameters = named_parameters(law)
    columns = [parameters.names.index(name) for name in (names[0], "V", names[1])]
    errors = np.abs(parameters.values[:, columns] - best) / parameters.errors[:, columns]
    assert (errors < 0.01).all()
    (outcome,) = ambiguous(law)
    for value in flipped(best).ravel():
        assert f"{value:.3g}" in outcome.text


def test_bounds_and_priors_choose_between_equal_maxima(swallowed):
    trials, best = swallowed
    bounded = cl.fit(f"{ORAL}; ka < 0.5", trials)
    priors = cl.fit(ORAL, trials, priors={"V": (1.0, 1.0)})
    free = cl.fit("depot' = -ka depot; C' = ka depot/V - k C; ka < 0.5", trials, initial_values={"depot": 100.0})
    for law, tolerance in ((bounded, 1e-3), (priors, 0.05), (free, 0.1)):
        parameters = named_parameters(law)
        columns = [parameters.names.index(name) for name in ("ka", "V", "k")]
        np.testing.assert_allclose(parameters.values[:, columns], flipped(best), rtol=tolerance)
    assert not ambiguous(bounded)
    assert not ambiguous(priors)


def test_a_shared_absorption_is_no_elimination_of_each_object():
    """Objects with one ka and a k each have one maximum."""
    random = np.random.default_rng(1)
    truth = ((1.2, 8.0, 0.1), (1.2, 10.0, 0.2))
    measured = [absorbed(p) + 0.02 * random.standard_normal(len(HOURS)) for p in truth]
    trials = cl.Trials.from_arrays([HOURS] * 2, measured, object=["a", "b"], names=["C"])
    law = cl.fit(ORAL, trials, shared=["ka"])
    parameters = named_parameters(law)
    columns = [parameters.names.index(name) for name in ("ka", "V", "k")]
    np.testing.assert_allclose(parameters.values[:, columns], truth, rtol=0.1)
    assert not ambiguous(law)


def test_exponentials_of_one_signal_are_in_one_order():
    """Two pools of which the sum is measured, neither of which comes first."""
    times = np.linspace(0, 10, 30)
    values = 3 * np.exp(-1.5 * times) + 2 * np.exp(-0.2 * times)
    values += 0.01 * np.random.default_rng(2).standard_normal(30)
    trials = cl.Trials.from_arrays(times, values, names=["y"])
    law = cl.fit("u' = -a u; w' = -b w; y = u + w; u(0) = A; w(0) = B", trials)
    parameters = dict(zip(named_parameters(law).names, named_parameters(law).values[0], strict=True))
    assert parameters["a"] == pytest.approx(1.5, rel=0.05)
    assert parameters["B"] == pytest.approx(2.0, rel=0.05)


def test_an_object_without_its_input_has_no_infinite_parameter():
    times, noise = np.arange(12.0), 0.05 * np.random.default_rng(3).standard_normal(12)
    decay, pulse = 5 * np.exp(-0.3 * times) + noise, np.where(times < 3, 1.0, 0.0)
    trials = cl.Trials.from_arrays(
        [times] * 2, [decay, decay], inputs=[pulse, 0 * pulse], object=["a", "b"], names=["c", "u"]
    )
    with pytest.raises(cl.CommonlawError) as refusal:
        cl.fit("c' = -k c + u/V", trials)
    assert (refusal.value.code, refusal.value.parameters["names"]) == ("parameters-not-identified", ["V of b"])
    shared = cl.fit("c' = -k c + u/V", trials, shared=["V"])
    assert np.isfinite(named_parameters(shared).values).all()
