"""The likelihood of trajectories: states and coefficients fitted together to what was measured."""

from commonlaw.likelihood.fitting import Estimate, TrajectoryModel, fit
from commonlaw.likelihood.linearization import Linearization, linearize, whitened
from commonlaw.likelihood.mesh import Mesh, interpolate, meshes
from commonlaw.likelihood.normal_equations import NotPositiveError
from commonlaw.likelihood.observation_model import HUBER_THRESHOLD, ObservationModel

__all__ = [
    "HUBER_THRESHOLD",
    "Estimate",
    "Linearization",
    "Mesh",
    "NotPositiveError",
    "ObservationModel",
    "TrajectoryModel",
    "fit",
    "interpolate",
    "linearize",
    "meshes",
    "whitened",
]
