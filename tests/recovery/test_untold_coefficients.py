"""Objects whose trials tell nothing of a coefficient, as where an input is never on."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.inference.score.evidence import NoiseScale, minus_twice_log_evidence
from commonlaw.law.parameters import standard_errors

TIMES = np.linspace(0, 5, 50)
RATES = {"a": (1.0, 2.0), "b": (0.7, 1.5), "c": (1.3, 0.0)}


def test_a_law_is_found_where_an_input_is_never_on_for_an_object():
    """Two objects decay with an input that rises by exp(t/10), and one without it: s' = -r s + g i."""
    generator, parts = np.random.default_rng(0), []
    rise = np.exp(TIMES / 10)
    for name, (rate, gain) in RATES.items():
        forced = gain / (rate + 0.1)
        states = forced * rise + (3 - forced) * np.exp(-rate * TIMES)
        noisy = states + 0.02 * generator.standard_normal(len(TIMES))
        parts.append(pd.DataFrame({"object": name, "t": TIMES, "s": noisy, "i": rise * (gain > 0)}))
    switched = cl.Trials.from_frame(pd.concat(parts), object="object", time="t", states=["s"], inputs=["i"])
    law = cl.discover(switched, library="poly:1", cache=False, order=1)
    assert law.structure == ("s' = a s + b i",)
    column, rates = law.terms.names.index("s"), np.array([rate for rate, _ in RATES.values()])
    errors = standard_errors(law)[:, 0, column]
    assert (np.abs(-law.coefficients[:, 0, column] - rates) < 4 * errors).all()
    assert (errors < 0.05).all()


@pytest.mark.parametrize("kernel", ["compiled", "numpy"])
def test_an_object_that_tells_nothing_of_a_coefficient_counts_as_one_that_tells_next_to_nothing(kernel, monkeypatch):
    if kernel == "numpy":
        monkeypatch.setenv("COMMONLAW_KERNEL", "numpy")
    generator = np.random.default_rng(1)
    rows = generator.standard_normal((4, 60, 3))
    rows[:, :, 2] = rows[:, :, 0] + 0.5 * rows[:, :, 1] + 0.1 * generator.standard_normal((4, 60))
    found = []
    for size in (0.0, 1e-5):
        rows[3, :, 1] = size * generator.standard_normal(60)
        rows[3, :, 2] = rows[3, :, 0]
        factors = np.array([np.linalg.qr(row, mode="r") for row in rows])
        found.append(minus_twice_log_evidence(factors, np.array([0, 1]), NoiseScale(240)))
    noise = NoiseScale(240)
    alone = minus_twice_log_evidence(factors, np.array([], dtype=np.intp), noise)
    assert alone == pytest.approx(float(noise.deviance(np.sum(rows[:, :, 2] ** 2), 0)))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[0], found[1], atol=1e-3)
