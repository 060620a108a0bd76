"""The likelihood of trajectories by collocation, with states and coefficients estimated together."""

from commonlaw.likelihood.collocation import jacobians
from commonlaw.likelihood.computing import (
    LinearizedObjects,
    fit,
    fit_each,
    linearize,
    linearize_each,
    threads_are_worthwhile,
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
from commonlaw.likelihood.fitting import Estimate, NotPositiveError, Prior, TrajectoryModel, eliminate_states_of_meshes
from commonlaw.likelihood.linearization import (
    Linearization,
    Regression,
    variance_of_rates,
    whitened_with_initial_states,
)
from commonlaw.likelihood.mesh import MAX_MESH_SAMPLES, Mesh, interpolate, meshes
from commonlaw.likelihood.observation_model import HUBER_THRESHOLD, LatentProcesses, ObservationModel

__all__ = [
    "ERRORS",
    "HUBER_THRESHOLD",
    "MAX_MESH_SAMPLES",
    "NO_ERRORS",
    "AbstractErrors",
    "ErrorModel",
    "Estimate",
    "Heteroscedastic",
    "LatentProcesses",
    "Linearization",
    "LinearizedObjects",
    "Mesh",
    "NotPositiveError",
    "ObservationModel",
    "Prior",
    "Regression",
    "Scales",
    "TrajectoryModel",
    "eliminate_states_of_meshes",
    "fit",
    "fit_each",
    "heteroscedastic",
    "interpolate",
    "jacobians",
    "linearize",
    "linearize_each",
    "meshes",
    "threads_are_worthwhile",
    "variance_of_rates",
    "whitened",
    "whitened_with_initial_states",
]
