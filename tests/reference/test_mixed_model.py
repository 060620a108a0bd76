"""The random-effects model beside statsmodels' linear mixed model, on rates that are linear in the coefficients."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize_scalar

from commonlaw.hierarchy import RandomEffects


@pytest.fixture(scope="module")
def rates():
    """Rates of eight objects, a - b x with a for all and b of each, in white noise; the columns, by object."""
    generator = np.random.default_rng(4)
    frame = pd.DataFrame({"object": np.repeat(np.arange(8), 30), "x": generator.uniform(0.5, 3, 240)})
    slopes = -0.7 + 0.2 * generator.standard_normal(8)
    frame["rate"] = 1.2 + slopes[frame["object"]] * frame["x"] + 0.15 * generator.standard_normal(240)
    return frame


def test_means_their_errors_and_the_scatter_are_those_of_the_mixed_model(rates):
    from statsmodels.regression.mixed_linear_model import MixedLM

    design = np.column_stack([np.ones(len(rates)), rates["x"]])
    mixed = MixedLM(rates["rate"], design, rates["object"], exog_re=rates[["x"]]).fit(reml=True)

    # From each object its least-squares estimate and what it is worth, with the noise that the mixed model found
    estimates, information = [], []
    for _, own in rates.groupby("object"):
        columns = np.column_stack([np.ones(len(own)), own["x"]])
        estimates.append(np.linalg.lstsq(columns, own["rate"], rcond=None)[0])
        information.append(columns.T @ columns / mixed.scale)
    effects = RandomEffects(np.array(estimates), np.array(information))

    def deviance(log_variance):
        return effects.marginal(np.array([[0.0, np.exp(log_variance)]])).restricted_deviance[0]

    scatter = np.exp(minimize_scalar(deviance, bounds=(-10, 2), method="bounded").x)
    assert scatter == pytest.approx(float(np.asarray(mixed.cov_re).item()), rel=0.01)
    found = effects.marginal(np.array([[0.0, scatter]]))
    np.testing.assert_allclose(found.means[0], mixed.fe_params, rtol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(found.total[0]))), mixed.bse_fe, rtol=0.01)
