"""The likelihood of trajectories: states and coefficients fitted together to what was measured."""

from commonlaw.likelihood.collocation import jacobians
from commonlaw.likelihood.computing import fit, fit_each, linearize, linearize_each, threads_pay, whitened
from commonlaw.likelihood.error_model import NO_ERRORS, ErrorKind, ErrorModel
from commonlaw.likelihood.fitting import Estimate, Prior, TrajectoryModel, without_states
from commonlaw.likelihood.latent import LatentProcesses
from commonlaw.likelihood.levels import AboutEstimates
from commonlaw.likelihood.linearization import Linearization, variance_of_rates, whitened_from_starts
from commonlaw.likelihood.mesh import LONGEST_MESH, Mesh, interpolate, meshes
from commonlaw.likelihood.normal_equations import NotPositiveError
from commonlaw.likelihood.observation_model import HUBER_THRESHOLD, ObservationModel
from commonlaw.likelihood.sensitivities import Regression

__all__ = [
    "HUBER_THRESHOLD",
    "LONGEST_MESH",
    "NO_ERRORS",
    "AboutEstimates",
    "ErrorKind",
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
