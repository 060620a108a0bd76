"""The likelihood of trajectories: states and coefficients fitted together to what was measured."""

from commonlaw.likelihood.collocation import Dynamics
from commonlaw.likelihood.expansion import Expansion, expand, whitened
from commonlaw.likelihood.fitting import Estimate, Problem, fit
from commonlaw.likelihood.measurement import Measurement
from commonlaw.likelihood.mesh import Mesh, meshes, spread
from commonlaw.likelihood.normal_equations import NotPositiveError

__all__ = [
    "Dynamics",
    "Estimate",
    "Expansion",
    "Measurement",
    "Mesh",
    "NotPositiveError",
    "Problem",
    "expand",
    "fit",
    "meshes",
    "spread",
    "whitened",
]
