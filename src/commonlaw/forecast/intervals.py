"""How far off a trajectory may be: errors of coefficients and initial states carried along it."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.integration import Trajectory


def trajectory_std(trajectory: Trajectory, parameters: Floats, initial: Floats) -> Floats:
    """Return the standard deviation of every state of a trajectory, to first order, shape (n, states).

    Parameters
    ----------
    trajectory
        With sensitivities; where it has diverged it is NaN.
    parameters, initial
        Covariances of the parameters and of the initial states, which are independent of each other; shapes
        (parameters, parameters) and (states, states).

    Raises
    ------
    CommonlawError
        If the trajectory has no sensitivities.
    """
    if trajectory.sensitivities is None:
        raise CommonlawError("this trajectory has no derivatives: simulate with sensitivities=True")
    width, variances = len(initial), np.zeros(trajectory.states.shape)
    with np.errstate(all="ignore"):  # Chaos makes derivatives as large as one likes
        for derivatives, covariance in (
            (trajectory.sensitivities[:, :, :-width], parameters),
            (trajectory.sensitivities[:, :, -width:], initial),
        ):
            variances += np.sum((derivatives @ covariance) * derivatives, axis=2)
        return np.sqrt(np.maximum(variances, 0))
