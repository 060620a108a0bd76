"""Speeds as the authors estimated them."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import parse_differentiation
from commonlaw.formulation import StrongForm
from commonlaw.trials import Trial
from studies.falling_balls.settings import DIFFERENTIATION

FORM = StrongForm(parse_differentiation(DIFFERENTIATION), order=2)
"""How heights become speeds and accelerations."""


def speeds(trial: Trial) -> Floats:
    """Return the speed at each sample of a drop, m/s, never negative, shape (n,)."""
    return np.abs(FORM.rates(trial).derivatives[0][:, 0])
