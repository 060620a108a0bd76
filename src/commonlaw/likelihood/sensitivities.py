"""Measured states of a law's solutions by their initial states and coefficients: the regression of least squares.

Along a mesh the derivatives Z of the states by both follow from the defects c of each step, which stay zero:

    dc/dz1 Z1 + dc/dz0 Z0 + dc/dtheta = 0,    Z = [1 | 0] at the start of a segment.

All steps are composed at once, pairwise (Blelloch 1990). A chaotic law forgets its start: what follows from there has
no digits, and `Regression.of` returns nothing.
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.formulation import column_scales
from commonlaw.likelihood.collocation import jacobians
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.mesh import Mesh

_FEWEST_DIGITS = 1e-10
"""Singular values, relative to the largest of columns of unit norm, below which initial states are not told apart."""


@dataclass(frozen=True, eq=False)
class Regression:
    """Least squares of one object's coefficients, with the initial states of all segments eliminated.

    Parameters
    ----------
    factor
        Triangular, of coefficients and residuals, which have unit variance, shape (p + 1, p + 1).
    leverage
        The trace of the hat matrix over the measurements of each state, shape (d,): how many of the initial states and
        coefficients they determine. States that are the same throughout a segment do not count.
    """

    factor: Floats
    leverage: Floats

    @classmethod
    def of(cls, model: TrajectoryModel, estimate: Estimate, free: Bools) -> "Regression | None":
        """Return the regression about an estimate, by the coefficients that are free, shape (equations, terms).

        Nothing if some initial states cannot be told from what is measured, or the law forgets them.
        """
        d, width, size = model.equations, model.width, int(free.sum())
        parts, states, leverage = list[Floats](), list[Indices](), np.zeros(d + 1)
        for mesh, values in zip(model.meshes, estimate.states, strict=True):
            with np.errstate(all="ignore"):
                found = _along(model, mesh, values, estimate.coefficients, free)[:, :d]
                residuals = model.residuals(mesh, values)
                roots = np.sqrt(model.observation.weights(residuals, mesh.scale))
                rows = np.concatenate([found, residuals[:, :, np.newaxis]], axis=2) * roots[:, :, np.newaxis]
            segments = np.concatenate([[0], np.cumsum(~mesh.contiguous)])
            for each in range(segments[-1] + 1):
                seen = mesh.observed & (segments == each)[:, np.newaxis]
                own, columns = rows[seen], np.where(mesh.still, d, np.arange(d))[seen]
                if not np.isfinite(own).all() or np.abs(own).max(initial=0.0) > np.sqrt(np.finfo(float).max):
                    return None
                basis = _basis(own[:, :width])
                if basis is None:
                    return None
                parts.append(own[:, width:] - basis @ (basis.T @ own[:, width:]))
                states.append(columns)
                leverage += np.bincount(columns, np.sum(basis**2, axis=1), minlength=d + 1)
        stacked, columns = np.concatenate(parts), np.concatenate(states)
        scales = column_scales(stacked)
        basis, factor = np.linalg.qr(stacked / scales)
        told = np.abs(np.diagonal(factor))[:size] > 0
        leverage += np.bincount(columns, np.sum(basis[:, :size][:, told] ** 2, axis=1), minlength=d + 1)
        return cls(np.vstack([factor * scales, np.zeros((size + 1 - len(factor), size + 1))]), leverage[:d])


def _along(model: TrajectoryModel, mesh: Mesh, states: Floats, coefficients: Floats, free: Bools) -> Floats:
    """Return the derivatives of the states at all points by the start of their segment and coefficients, (n, D, q)."""
    width, size = model.width, int(free.sum())
    linear = jacobians(model.field(coefficients, free), mesh, states[:, :width])
    steps, begins = np.zeros((len(mesh), width, width)), np.zeros((len(mesh), width, width + size))
    begins[mesh.first] = np.eye(width, width + size)
    on = mesh.contiguous
    solved = np.linalg.solve(linear.end[on], -np.concatenate([linear.start[on], linear.coefficients[on]], axis=2))
    after = np.flatnonzero(on) + 1
    steps[after], begins[after, :, width:] = solved[:, :, :width], solved[:, :, width:]
    stride = 1
    while stride < len(mesh):
        begins[stride:] += steps[stride:] @ begins[:-stride]
        steps[stride:] = steps[stride:] @ steps[:-stride]
        stride *= 2
    return begins


def _basis(columns: Floats) -> Floats | None:
    """Return an orthonormal basis of columns; None if these are not told apart."""
    basis, values, _ = np.linalg.svd(columns / column_scales(columns), full_matrices=False)
    return basis if len(basis) >= columns.shape[1] and values[-1] > _FEWEST_DIGITS * values[0] else None
