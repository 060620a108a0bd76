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
from commonlaw.likelihood.errors import (
    ERRORS,
    NO_ERRORS,
    AbstractErrors,
    ErrorModel,
    Heteroscedastic,
    Scales,
    heteroscedastic,
)
from commonlaw.likelihood.fitting import Estimate, NotPositiveError, Prior, TrajectoryModel, without_states
from commonlaw.likelihood.linearization import Linearization, Regression, variance_of_rates, whitened_from_starts
from commonlaw.likelihood.mesh import MAX_MESH_SAMPLES, Mesh, interpolate, meshes
from commonlaw.likelihood.observation_model import HUBER_THRESHOLD, LatentProcesses, ObservationModel

__all__ = [
    "ERRORS",
    "HUBER_THRESHOLD",
    "MAX_MESH_SAMPLES",
    "NO_ERRORS",
    "AboutEstimates",
    "AbstractErrors",
    "ErrorModel",
    "Estimate",
    "Heteroscedastic",
    "LatentProcesses",
    "Linearization",
    "Mesh",
    "NotPositiveError",
    "ObservationModel",
    "Prior",
    "Regression",
    "Scales",
    "TrajectoryModel",
    "fit",
    "fit_each",
    "heteroscedastic",
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
