"""The likelihood of trajectories: states and coefficients fitted together to what was measured."""

from commonlaw.likelihood.collocation import jacobians
from commonlaw.likelihood.computing import (
    AboutEstimates,
    fit,
    fit_each,
    linearize,
    linearize_each,
    threads_pay,
    whitened,
)
from commonlaw.likelihood.fitting import Estimate, NotPositiveError, Prior, TrajectoryModel, without_states
from commonlaw.likelihood.linearization import Linearization, Regression, variance_of_rates, whitened_from_starts
from commonlaw.likelihood.mesh import MAX_MESH_SAMPLES, Mesh, interpolate, meshes
from commonlaw.likelihood.observation_model import (
    HUBER_THRESHOLD,
    NO_ERRORS,
    ErrorModel,
    LatentProcesses,
    ObservationModel,
)

__all__ = [
    "HUBER_THRESHOLD",
    "MAX_MESH_SAMPLES",
    "NO_ERRORS",
    "AboutEstimates",
    "ErrorModel",
    "Estimate",
    "LatentProcesses",
    "Linearization",
    "Mesh",
    "NotPositiveError",
    "ObservationModel",
    "Prior",
    "Regression",
    "TrajectoryModel",
    "fit",
    "fit_each",
    "interpolate",
    "jacobians",
    "linearize",
    "linearize_each",
    "meshes",
    "threads_pay",
    "variance_of_rates",
    "whitened",
    "whitened_from_starts",
    "without_states",
]
