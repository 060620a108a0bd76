"""The likelihood of trajectories by collocation, with states and coefficients estimated together."""

from commonlaw.likelihood.collocation import (
    jacobians as jacobians,
)
from commonlaw.likelihood.computing import (
    LinearizedObjects as LinearizedObjects,
    fit as fit,
    fit_each as fit_each,
    linearize as linearize,
    linearize_each as linearize_each,
    threads_are_worthwhile as threads_are_worthwhile,
    whitened as whitened,
)
from commonlaw.likelihood.errors import (
    ERRORS as ERRORS,
    WHITE_NOISE as WHITE_NOISE,
    AbstractErrors as AbstractErrors,
    ByGroup as ByGroup,
    ErrorModel as ErrorModel,
    Heteroscedastic as Heteroscedastic,
    Scales as Scales,
    by_group as by_group,
    groupings as groupings,
    heteroscedastic as heteroscedastic,
)
from commonlaw.likelihood.fitting import (
    Estimate as Estimate,
    NotPositiveError as NotPositiveError,
    Prior as Prior,
    TrajectoryModel as TrajectoryModel,
    eliminate_states_of_meshes as eliminate_states_of_meshes,
)
from commonlaw.likelihood.linearization import (
    Linearization as Linearization,
    prior_variances as prior_variances,
    propagated as propagated,
    whitened_with_initial_states as whitened_with_initial_states,
)
from commonlaw.likelihood.mesh import (
    MAX_MESH_SAMPLES as MAX_MESH_SAMPLES,
    Mesh as Mesh,
    interpolate as interpolate,
    meshes as meshes,
)
from commonlaw.likelihood.noise_scatter import (
    NoiseByGroup as NoiseByGroup,
    cost_of_scatter as cost_of_scatter,
    omitted_by_group as omitted_by_group,
)
from commonlaw.likelihood.observation_model import (
    HUBER_THRESHOLD as HUBER_THRESHOLD,
    LatentProcesses as LatentProcesses,
    ObservationModel as ObservationModel,
)
from commonlaw.likelihood.regression import (
    Regression as Regression,
    deviations as deviations,
)
