"""How far states on a mesh are from obeying a law, step by step, and how that depends on everything.

Hermite-Simpson collocation (Hargraves and Paris 1987): over a step h from z0 to z1 a solution of z' = f(z) has

    z1 - z0 - h/6 (f0 + 4 fm + f1) = O(h^5),    with fm at zm = (z0 + z1)/2 + h/8 (f0 - f1).

The error is h^5/720 times a fifth derivative for x' = x, and a quarter of that where f depends on time alone. The rule
is implicit, so that stiff laws need no small steps. All steps are worked on at once.
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.library import Terms
from commonlaw.likelihood.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Jacobians:
    """Defects of all steps and their derivatives, zero between segments.

    Parameters
    ----------
    defects
        Shape (n - 1, D).
    start, end
        Their derivatives with respect to the states at the start and at the end of the step, shape (n - 1, D, D).
    coefficients
        Their derivatives with respect to the coefficients of `support`, equation by equation, shape (n - 1, D,
        parameters).
    """

    defects: Floats
    start: Floats
    end: Floats
    coefficients: Floats


@dataclass(frozen=True, eq=False)
class Dynamics:
    """A family of laws over some terms, of order 1 or 2; states are z = x, or z = (x, x').

    Parameters
    ----------
    terms
        Over the states (and rates), inputs and time.
    equations
        Number of measured states d, one equation each.
    order
        1 or 2.
    """

    terms: Terms
    equations: int
    order: int

    @property
    def width(self) -> int:
        """Number of states, D."""
        return self.equations * self.order

    def defects(self, mesh: Mesh, states: Floats, coefficients: Floats) -> Floats:
        """Return the defects of all steps, shape (n - 1, D).

        Parameters
        ----------
        mesh
            The points.
        states
            Shape (n, D).
        coefficients
            Shape (equations, terms).
        """
        terms, own = self._used(coefficients != 0, coefficients)
        rates = self._rates(terms, _at_points(mesh, states), own)
        middles = _middles(mesh, states, rates)
        return _defects(mesh, states, rates, self._rates(terms, _at_middles(mesh, middles), own))

    def jacobians(self, mesh: Mesh, states: Floats, coefficients: Floats, support: Bools) -> Jacobians:
        """Return the defects of all steps and their derivatives.

        Parameters
        ----------
        mesh, states, coefficients
            As for `defects`.
        support
            The coefficients by which derivatives are wanted, shape (equations, terms).
        """
        kept = support | (coefficients != 0)
        terms, own = self._used(kept, coefficients)
        wanted = support[:, kept.any(axis=0)]
        rates, by_states, by_own = self._linear(terms, _at_points(mesh, states), own, wanted)
        middles = _middles(mesh, states, rates)
        middle, mid_by_states, mid_by_own = self._linear(terms, _at_middles(mesh, middles), own, wanted)
        h, one = mesh.steps[:, np.newaxis, np.newaxis], np.eye(self.width)
        on = mesh.contiguous[:, np.newaxis, np.newaxis]
        start = -one - h / 6 * (by_states[:-1] + 4 * np.matmul(mid_by_states, one / 2 + h / 8 * by_states[:-1]))
        end = one - h / 6 * (by_states[1:] + 4 * np.matmul(mid_by_states, one / 2 - h / 8 * by_states[1:]))
        shifted = mid_by_own + np.matmul(h / 8 * mid_by_states, by_own[:-1] - by_own[1:])
        by_coefficients = -h / 6 * (by_own[:-1] + 4 * shifted + by_own[1:])
        return Jacobians(_defects(mesh, states, rates, middle), start * on, end * on, by_coefficients)

    def _used(self, kept: Bools, coefficients: Floats) -> tuple[Terms, Floats]:
        """Return the terms that are in some equation, and the coefficients of these."""
        indices = np.flatnonzero(kept.any(axis=0))
        return self.terms.take([int(k) for k in indices]), coefficients[:, indices]

    def _rates(self, terms: Terms, values: Floats, coefficients: Floats) -> Floats:
        """Return z' at the rows of values, shape (n, D)."""
        highest = terms.evaluate(values) @ coefficients.T
        return highest if self.order == 1 else np.column_stack([values[:, self.equations : self.width], highest])

    def _linear(
        self, terms: Terms, values: Floats, coefficients: Floats, support: Bools
    ) -> tuple[Floats, Floats, Floats]:
        """Return z', (n, D), and its derivatives by states, (n, D, D), and by coefficients, (n, D, parameters)."""
        first, matrix = self.width - self.equations, terms.evaluate(values)
        by_states = np.zeros((len(values), self.width, self.width))
        gradients = terms.jacobian(values)[:, :, : self.width]
        by_states[:, first:] = np.tensordot(gradients, coefficients, (1, 1)).transpose(0, 2, 1)
        by_own = np.zeros((len(values), self.width, int(support.sum())))
        ends = np.cumsum([0, *support.sum(axis=1)])
        for j, own in enumerate(support):
            by_own[:, first + j, ends[j] : ends[j + 1]] = matrix[:, own]
        highest = matrix @ coefficients.T
        if self.order == 1:
            return highest, by_states, by_own
        by_states[:, range(self.equations), range(self.equations, self.width)] = 1.0
        return np.column_stack([values[:, self.equations : self.width], highest]), by_states, by_own


def _at_points(mesh: Mesh, states: Floats) -> Floats:
    """Return the values of the variables at the points, shape (n, variables)."""
    return np.column_stack([states, mesh.inputs, mesh.times])


def _at_middles(mesh: Mesh, states: Floats) -> Floats:
    """Return the values of the variables in the middle of the steps, shape (n - 1, variables)."""
    inputs, times = mesh.inputs, mesh.times
    return np.column_stack([states, (inputs[:-1] + inputs[1:]) / 2, (times[:-1] + times[1:]) / 2])


def _middles(mesh: Mesh, states: Floats, rates: Floats) -> Floats:
    """Return the states in the middle of the steps, shape (n - 1, D)."""
    return (states[:-1] + states[1:]) / 2 + mesh.steps[:, np.newaxis] / 8 * (rates[:-1] - rates[1:])


def _defects(mesh: Mesh, states: Floats, rates: Floats, middle: Floats) -> Floats:
    defects = np.diff(states, axis=0) - mesh.steps[:, np.newaxis] / 6 * (rates[:-1] + 4 * middle + rates[1:])
    return np.where(mesh.contiguous[:, np.newaxis], defects, 0.0)
