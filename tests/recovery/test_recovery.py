"""Laws of small problems stay what they are: terms, parameters, score, and what they take."""

import numpy as np
import pytest

from tests.recovery.golden import recovered, stored
from tests.recovery.problems import PROBLEMS

_SAME, _OF_ERRORS, _OF_SCORES = 1e-8, 1e-4, 1e-3
"""Differences by rounding on other machines: relative, in standard errors, and in twice the log-evidence."""
_VALLEYS = {"fit, free start": 0.05}
"""Such differences where a latent state's initial value is nearly unidentifiable: a fit ends anywhere in the valley."""
_MORE_FITS = 1.1
"""As rounding decides between steps that are next to equal."""
_SHARED = {
    "absorbed": "unmeasured_search",
    "enzymes": "parametric_terms",
    "growth, proportional": "error_models",
    "spring, defaults": "error_models",
}
"""Problems whose laws other tests look at, which one worker finds for all."""

_SLOW = (
    "cooperative, ratios",
    "decay, 10 %",
    "decay, without a latent state",
    "driven, unmeasured",
    "duffing",
    "falling balls, defaults",
    "fit, free start",
    "fit, proportional",
    "fit, reaction",
    "gompertz, auto",
    "linear terms of a Duffing oscillator",
    "lorenz",
    "lorenz, screened terms",
    "measured drops, linear drag",
    "missing values",
    "no outliers",
    "noise columns",
    "power, auto",
    "predators, defaults",
    "predators, many terms",
    "refine",
    "relaxation, any order",
    "relaxation, correlated",
    "spring, autocorrelated",
    "spring, drift",
    "spring, gp-forcing",
    "spring, proportional",
    "spring, random-walk",
    "spring, sensor-walk",
    "spring, white",
    "swung, cubic",
    "van der Pol",
    "van der Pol, many samples",
    "vials",
    "with a blank",
)


def _marks(name):
    shared = [pytest.mark.xdist_group(f"test_{_SHARED[name]}.py")] if name in _SHARED else []
    return [*shared, pytest.mark.slow] if name in _SLOW else shared


@pytest.mark.parametrize("name", [pytest.param(name, marks=_marks(name)) for name in PROBLEMS])
def test_the_law_is_the_same(name, request, monkeypatch):
    if name.startswith("measured"):
        monkeypatch.setenv("COMMONLAW_DATA", str(request.getfixturevalue("ball_drops_folder")))
    (_, found), golden = recovered(name), stored()[name]
    assert found.structure == golden.structure
    parameters, errors = np.array(golden.parameters), np.nan_to_num(golden.errors)
    assert (abs(found.parameters - parameters) <= _SAME * abs(parameters) + _OF_ERRORS * errors).all()
    assert found.score == pytest.approx(golden.score, rel=_SAME, abs=_VALLEYS.get(name, _OF_SCORES))
    assert found.fits <= _MORE_FITS * golden.fits
