"""Maximum likelihood of given equations: observation equations, known initial values, shared parameters, bounds.

Solutions are computed from their initial values (single shooting) with exact derivatives, and parameters are found by
nonlinear least squares from several first values.
"""

from commonlaw.estimation.beginning import beyond_collocation
from commonlaw.estimation.profile import Profile, likelihood_profile

__all__ = [
    "Profile",
    "beyond_collocation",
    "likelihood_profile",
]
