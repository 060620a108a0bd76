"""The likelihood of several objects about estimates that stay, at one set of levels of errors after another."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.kernel import kernel
from commonlaw.likelihood.compiled.together import Together, together
from commonlaw.likelihood.computing import linearize
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.latent import LatentProcesses


@dataclass(frozen=True, eq=False)
class AboutEstimates:
    """Several objects, and the estimates about which they are linearised.

    Parameters
    ----------
    models
        One for each object, with latent processes of the kind that is asked for.
    estimates
        One for each object.
    columns
        Which coefficients are columns, shape (equations, terms), see `linearize`.
    """

    models: Sequence[TrajectoryModel]
    estimates: Sequence[Estimate]
    columns: Bools

    def linearize(self, std: Floats, latent: LatentProcesses, model_error: float) -> tuple[Floats, float]:
        """Return the likelihood at levels of errors, see `linearize`.

        Parameters
        ----------
        std
            Standard deviations of the white noise at all points of all meshes, one behind the other, shape (points, d).
        latent
            The levels of latent processes.
        model_error
            Standard deviation of the model error in each step, relative to the models' units.

        Returns
        -------
        tuple
            The triangular factor of each object's problem, shape (objects, columns + 1, columns + 1), and the sum of
            the log-determinants.

        Raises
        ------
        NotPositiveError
            If numbers are not finite, or too far apart.
        """
        library = kernel()
        if library is not None and self._together is not None:
            return self._together.linearize(library, std, latent, model_error)
        cuts = np.cumsum([sum(map(len, model.meshes)) for model in self.models])[:-1]
        linear = [
            linearize(_with_levels(model, own, latent), estimate, model_error, self.columns)
            for model, own, estimate in zip(self.models, np.split(std, cuts), self.estimates, strict=True)
        ]
        return np.array([each.problem.factor for each in linear]), sum(each.log_determinant for each in linear)

    @cached_property
    def _together(self) -> Together | None:
        return together(self.models, self.estimates, self.columns)


def _with_levels(model: TrajectoryModel, std: Floats, latent: LatentProcesses) -> TrajectoryModel:
    parts = np.split(std, np.cumsum([len(mesh) for mesh in model.meshes])[:-1])
    pairs = zip(model.meshes, parts, strict=True)
    meshes = [mesh.with_scale(own / model.observation.noise) for mesh, own in pairs]
    return replace(model, meshes=meshes, latent=latent)
