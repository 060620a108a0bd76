"""Regressions of an object's measurements on the sensitivities of its states to first states and coefficients."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.formulation import column_scales
from commonlaw.likelihood.computing import sensitivities
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.levels import Deviations
from commonlaw.likelihood.mesh import segments
from commonlaw.trials import Trial


@dataclass(frozen=True, eq=False)
class Regression:
    """Regression of one object's coefficients, with the initial states of all segments eliminated.

    `factor` is the triangular factor of [columns | residuals], shape (p + 1, p + 1); the columns are Q times it. Over
    the measurements of each state, without those constant in a segment, `projected` is ``Q' Q``, shape (d, p, p), and
    `of_starts` the trace of the hat matrix of the initial states, shape (d,).
    """

    factor: Floats
    projected: Floats
    of_starts: Floats

    @property
    def leverage(self) -> Floats:
        """The trace of the hat matrix over the measurements of each state, shape (d,)."""
        return np.asarray(self.of_starts + np.trace(self.projected, axis1=1, axis2=2))

    @classmethod
    def of(cls, model: TrajectoryModel, estimate: Estimate, free: Bools) -> "Regression | None":
        """Return the regression about an estimate by the free coefficients, shape (equations, terms).

        None if initial states are not identifiable.
        """
        d, width, size = model.equations, model.width, int(free.sum())
        parts, states, leverage = list[Floats](), list[Indices](), np.zeros(d + 1)
        for index, (mesh, values) in enumerate(zip(model.meshes, estimate.states, strict=True)):
            points = np.asarray(mesh.observed.any(axis=1))
            with np.errstate(all="ignore"):
                derivatives = sensitivities(model, index, estimate, free, points)[:, :d]
                residuals = model.residuals(mesh, values)
                roots = np.sqrt(model.observation.weights(residuals, mesh.scale))[points, :, np.newaxis]
                rows = np.concatenate([derivatives, residuals[points, :, np.newaxis]], axis=2) * roots
            segments, observed = np.concatenate([[0], np.cumsum(~mesh.contiguous)])[points], mesh.observed[points]
            of_states = np.where(mesh.still[points], d, np.arange(d))
            for segment in range(np.count_nonzero(mesh.first)):
                seen = observed & (segments == segment)[:, np.newaxis]
                block, columns = rows[seen], of_states[seen]
                if not np.isfinite(block).all() or np.abs(block).max(initial=0.0) > np.sqrt(np.finfo(float).max):
                    return None
                initial = block[:, :width]
                basis, singular, _ = np.linalg.svd(initial / column_scales(initial), full_matrices=False)
                if len(basis) < width or not singular[-1] > 1e-10 * singular[0]:  # Collinear
                    return None
                parts.append(block[:, width:] - basis @ (basis.T @ block[:, width:]))
                states.append(columns)
                leverage += np.bincount(columns, np.sum(basis**2, axis=1), minlength=d + 1)
        stacked, columns = np.concatenate(parts), np.concatenate(states)
        scales, projected = column_scales(stacked), np.zeros((d, size, size))
        basis, factor = np.linalg.qr(stacked / scales)
        determined = np.flatnonzero(np.abs(np.diagonal(factor))[:size] > 0)
        for j in range(d):
            of_state = basis[columns == j][:, determined]
            projected[j][np.ix_(determined, determined)] = of_state.T @ of_state
        whole = np.vstack([factor * scales, np.zeros((size + 1 - len(factor), size + 1))])
        return cls(whole, projected, leverage[:d])


def deviations(
    model: TrajectoryModel, estimate: Estimate, free: Bools, trials: Sequence[Trial], omitted: Sequence[Bools]
) -> list[Deviations]:
    """Return the segments of an object's trials about the states of an estimate.

    Slopes are by the initial states of one segment after the other, then by the free coefficients, shape (n, d, k). Of
    each mesh some measurements are omitted, shape (points, d).
    """
    parts, width, size, d = list[Deviations](), model.width, int(free.sum()), model.equations
    cut, before = segments(trials), 0
    starts = width * sum(map(len, cut))
    quadruples = zip(model.meshes, estimate.states, cut, omitted, strict=True)
    for index, (mesh, values, of_mesh, without) in enumerate(quadruples):
        with np.errstate(all="ignore"):
            derivatives = sensitivities(model, index, estimate, free, np.ones(len(mesh), dtype=np.bool_))[:, :d]
        first = np.flatnonzero(mesh.first)
        for trial, begin, end in zip(of_mesh, first, [*first[1:], len(mesh)], strict=True):
            rows = np.linspace(begin, end - 1, len(trial)).round().astype(np.int64)
            slopes = np.zeros((len(rows), d, starts + size))
            slopes[:, :, before : before + width] = derivatives[rows, :, :width]
            slopes[:, :, starts:] = derivatives[rows, :, width:]
            states, before = values[rows, :d], before + width
            parts.append(Deviations(trial, states, slopes, states, (without | mesh.still)[rows]))
    return parts
