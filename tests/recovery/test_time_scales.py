"""Objects that differ in their time scale alone."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl

RATES = {"ceramic": 0.031, "steel": 0.012, "paper": 0.045}


@pytest.mark.parametrize("seed", [0, 3])
def test_cups_that_cool_at_different_rates_cool_by_newtons_law(seed):
    generator, minutes = np.random.default_rng(seed), np.arange(0, 61, 3.0)
    frames = []
    for cup, rate in RATES.items():
        for copy in "ab":
            drop = (66.5 - 3 * generator.random()) * np.exp(-rate * minutes)
            noisy = 21.5 + drop + 0.3 * generator.standard_normal(len(minutes))
            frames.append(pd.DataFrame({"cup": cup + copy, "t": minutes, "T": noisy}))
    law = cl.discover(pd.concat(frames, ignore_index=True), cache=False)
    assert law.structure == ("T' = a + b T",)
    ratios = -law.coefficients[:, 0, 0] / law.coefficients[:, 0, 1]
    np.testing.assert_allclose(np.median(ratios), 21.5, rtol=0.1)
