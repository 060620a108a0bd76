"""The right-hand side of a law for one object with its exact derivatives, vectorized, and its inputs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import check_choice
from commonlaw.library import Order, Terms, highest_columns, with_rates
from commonlaw.runtime.forking import cached_property

_NODES = (1 - np.cos(np.pi * (np.arange(8) + 0.5) / 8)) / 2
"""Chebyshev nodes of the unit interval, interior, so that a function may jump at its ends."""

BETWEEN = ("held", "linear", "cubic")
"""Interpolation of inputs: zero-order hold, linear, or cubic spline (not-a-knot)."""

InputFunction = Callable[[float], ArrayLike]
"""Inputs at a time: one number, or one for each."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs as piecewise polynomials of the time since a knot.

    Knots increase, shape (n,); coefficients are in order of increasing power, shape (n, powers, inputs).
    """

    knots: Floats
    coefficients: Floats

    @classmethod
    def of(cls, times: Floats, values: Floats, between: str = "linear") -> "Inputs":
        """Return inputs that interpolate values, shape (n, inputs), at times of shape (n,), and are constant outside.

        Raises `CommonlawError` if `between` is not one of `BETWEEN`.
        """
        check_choice("interpolation of inputs between samples", between, BETWEEN)
        coefficients = np.zeros((len(times), 4, values.shape[1]))
        coefficients[:, 0] = values
        if between == "linear":
            coefficients[:-1, 1] = np.diff(values, axis=0) / np.diff(times)[:, np.newaxis]
        elif between == "cubic" and len(times) > 1:
            from scipy.interpolate import CubicSpline

            coefficients[:-1] = CubicSpline(times, values).c[::-1].swapaxes(0, 1)
        powers = {"held": 1, "linear": 2, "cubic": 4}[between]
        # No knot where the polynomial does not change
        changes = np.any(np.diff(coefficients, axis=0), axis=(1, 2)) | np.any(coefficients[1:, 1:], axis=(1, 2))
        kept = np.concatenate([[True], changes])
        return cls(np.asarray(times[kept]), coefficients[kept, :powers])

    @classmethod
    def of_function(cls, function: Callable[[Floats], Floats], mesh: Floats, tolerance: float) -> "Inputs":
        """Return the piecewise Chebyshev interpolation of a function of time, from shape (m,) to (m, inputs).

        Polynomials have degree 7; intervals of the mesh are halved until the errors are below the tolerance, relative
        to the largest value, or down to a jump.
        """
        if len(mesh) == 1:
            return cls.of(mesh, function(mesh), "held")
        starts, widths = mesh[:-1], np.diff(mesh)
        to_powers = np.linalg.inv(np.vander(_NODES, increasing=True))
        knots, coefficients, largest = list[Floats](), list[Floats](), float(np.finfo(float).tiny)

        def values(shares: Floats) -> Floats:
            times = starts[:, np.newaxis] + shares * widths[:, np.newaxis]
            return function(times.ravel()).reshape(*times.shape, -1)

        compared = np.array([0.03, 0.5, 0.97])
        for halving in range(41):  # Down to rounding
            seen, checked = values(_NODES), values(compared)
            polynomials = to_powers @ seen
            largest = max(largest, float(np.abs(seen).max(initial=0.0)))
            errors = np.abs(np.vander(compared, len(_NODES), increasing=True) @ polynomials - checked)
            done = (errors.max(axis=(1, 2)) <= tolerance * largest) | (halving == 40)
            knots.append(starts[done])
            powers = widths[done, np.newaxis, np.newaxis] ** np.arange(len(_NODES))[:, np.newaxis]
            coefficients.append(polynomials[done] / powers)
            halves = widths[~done] / 2
            starts, widths = np.concatenate([starts[~done], starts[~done] + halves]), np.tile(halves, 2)
            if not len(starts):
                break
        order = np.argsort(np.concatenate(knots), kind="stable")
        return cls(np.concatenate(knots)[order], np.concatenate(coefficients)[order])

    @property
    def held(self) -> bool:
        """Whether they are piecewise constant."""
        return self.powers == 1

    @property
    def powers(self) -> int:
        """Number of coefficients of a polynomial."""
        return int(self.coefficients.shape[1])

    def at(self, times: Floats) -> Floats:
        """Return the inputs at times of shape (m,), shape (m, inputs)."""
        pieces = np.maximum(self.knots.searchsorted(times, side="right") - 1, 0)
        return self._values(np.maximum(times - self.knots[pieces], 0.0)[:, np.newaxis], self.coefficients[pieces])

    def __call__(self, time: float) -> Floats:
        """Return the inputs at one time, shape (inputs,)."""
        piece = self.piece(time)
        return self._values(max(time - self.knots[piece], 0.0), self.coefficients[piece])

    def piece(self, time: float) -> int:
        """Return the index of the polynomial at a time; a knot belongs to the later one."""
        return max(int(self.knots.searchsorted(time, side="right")) - 1, 0)

    def _values(self, since: Floats | float, polynomials: Floats) -> Floats:
        """Return values of polynomials, from shape (..., powers, inputs) to (..., inputs)."""
        values = polynomials[..., -1, :]
        for power in reversed(range(self.powers - 1)):
            values = values * since + polynomials[..., power, :]
        return np.asarray(values)


def runge_kutta_step(rates: Callable[[Floats, float], Floats], z: Floats, h: Floats | float) -> Floats:
    """Return the states after a step h of the classical Runge-Kutta method, of order 4.

    `rates` are derivatives at states and at a share of the step: 0, 1/2 or 1.
    """
    first = rates(z, 0.0)
    second = rates(z + h / 2 * first, 0.5)
    third = rates(z + h / 2 * second, 0.5)
    return z + h / 6 * (first + 2 * (second + third) + rates(z + h * third, 1.0))


class LinearizedField(NamedTuple):
    """A vector field at n points (n, D), its derivatives by states (n, D, D) and by parameters (n, D, parameters)."""

    derivatives: Floats
    by_states: Floats
    by_parameters: Floats


@dataclass(frozen=True, eq=False)
class VectorField:
    """The vector field ``z' = f(z, u, t)`` of D states: the states of the law, then rates of those of second order.

    Methods take the variables (states, inputs, time) at n points, shape (n, variables); a call takes one time and
    state, as integrators do. Log-scaled states are z = log x: for x' = f(x), ``z' = f(exp(z)) / exp(z)``. Nonlinear
    parameters have the values of their coefficients, and are parameters like these.

    Coefficients are those of the highest derivatives, shape (equations, terms); a law in discrete time, of order 0,
    gives the next states instead. Inputs as functions of time are required to integrate a law with inputs. Derivatives
    are taken by `free` coefficients, by default those that are not zero; the support of all objects keeps the
    parameters the same where a coefficient is zero.
    """

    terms: Terms
    coefficients: Floats
    order: Order = 1
    inputs: Inputs | None = None
    free: Bools | None = None

    def __call__(self, t: float, z: Floats) -> Floats:
        """Return ``f`` at one time and state, shape (D,)."""
        return np.asarray(self.derivatives(self.point(t, z))[0])

    def jacobian(self, t: float, z: Floats) -> Floats:
        """Return the derivatives of ``f`` with respect to the states at one time and state, shape (D, D)."""
        return np.asarray(self._by_states(self.point(t, z), *self._nonzero)[0])

    def point(self, t: float, z: Floats) -> Floats:
        """Return the values of the variables at one time and state, shape (1, variables)."""
        inputs = self.inputs(t) if self.inputs is not None and self.terms.variables.inputs else ()
        return np.concatenate([z, inputs, (t,)])[np.newaxis]

    def derivatives(self, values: Floats) -> Floats:
        """Return ``f``, or the next states in discrete time, shape (n, D)."""
        terms, coefficients = self._nonzero
        natural = self._natural(values)
        return self._with_rates(values, self._relative(natural, terms.evaluate(natural) @ coefficients.T))

    def linearize(self, values: Floats) -> LinearizedField:
        """Return ``f`` and its exact derivatives."""
        terms, coefficients = self._kept
        natural = self._natural(values)
        matrix = terms.evaluate(natural)
        states, columns = self._of_parameters
        by_parameters = np.zeros((len(matrix), self.width, len(states)))
        by_parameters[:, states, range(len(states))] = matrix[:, columns]
        if self.terms.parameters:
            gradients = terms.jacobian(natural)
            first = gradients.shape[2] - len(self.terms.parameters)
            indices = np.argwhere(self.parameter_mask)[:, 1]
            for i, index in enumerate(self.terms.parameters):
                slopes = (gradients[:, :, first + i] @ coefficients.T)[:, :, np.newaxis]
                by_parameters[:, self.highest[:, np.newaxis], np.flatnonzero(indices == index)] = slopes
        return LinearizedField(
            self._with_rates(values, self._relative(natural, matrix @ coefficients.T)),
            self._by_states(values, terms, coefficients),
            self._relative(natural, by_parameters),
        )

    @property
    def width(self) -> int:
        """The number of states, D."""
        return len(self.coefficients) + len(self.second)

    @cached_property
    def second(self) -> Indices:
        """The states of second order, whose rates follow all states."""
        return with_rates(self.order, len(self.coefficients))

    @cached_property
    def highest(self) -> Indices:
        """Index of the derivative of each equation among those of states and rates."""
        return highest_columns(self.order, len(self.coefficients))

    @cached_property
    def parameter_mask(self) -> Bools:
        """Which coefficients are parameters, shape (equations, terms), in the order of `numpy.argwhere`."""
        return np.asarray(self.coefficients != 0) if self.free is None else self.free

    @property
    def parameters(self) -> Floats:
        """The values of the parameters, shape (parameters,)."""
        return np.asarray(self.coefficients[self.parameter_mask])

    @cached_property
    def kept(self) -> Bools:
        """Coefficients that are parameters or not zero, shape (equations, terms)."""
        return np.asarray(self.parameter_mask | (self.coefficients != 0))

    @cached_property
    def _nonzero(self) -> tuple[Terms, Floats]:
        """The terms with a nonzero coefficient, and these coefficients."""
        return self._taken(self.coefficients != 0)

    @cached_property
    def _kept(self) -> tuple[Terms, Floats]:
        """The terms with a kept coefficient, and these coefficients."""
        return self._taken(self.kept)

    def _taken(self, mask: Bools) -> tuple[Terms, Floats]:
        indices = np.flatnonzero(mask.any(axis=0))
        return self.terms.take([int(k) for k in indices]), self.coefficients[:, indices]

    def _natural(self, values: Floats) -> Floats:
        return self.terms.at(self.terms.variables.natural(values), self.coefficients)

    def _with_rates(self, values: Floats, highest: Floats) -> Floats:
        """Return the derivatives of all states from the highest ones, shape (n, D)."""
        if not len(self.second):
            return highest
        derivatives = np.empty((len(values), self.width))
        derivatives[:, self.second] = values[:, len(self.coefficients) : self.width]
        derivatives[:, self.highest] = highest
        return derivatives

    def _by_states(self, values: Floats, terms: Terms, coefficients: Floats) -> Floats:
        width, equations = self.width, len(coefficients)
        jacobian, natural = np.zeros((len(values), width, width)), self._natural(values)
        gradients = terms.jacobian(natural)[:, :, :width]
        jacobian[:, self.highest] = np.tensordot(gradients, coefficients, (1, 1)).transpose(0, 2, 1)
        jacobian[:, self.second, range(equations, width)] = 1.0
        if terms.variables.logarithmic:
            jacobian = self._relative(natural, jacobian)
            relative = self._relative(natural, terms.evaluate(natural) @ coefficients.T)
            for j in terms.variables.logarithmic_columns:
                jacobian[:, :, j] *= natural[:, j, np.newaxis]
                jacobian[:, j, j] -= relative[:, j]
        return jacobian

    def _relative(self, natural: Floats, derivatives: Floats) -> Floats:
        """Return derivatives, shape (n, D, ...), with those of log-scaled states divided by the state."""
        for j in self.terms.variables.logarithmic_columns:
            derivatives[:, j] /= natural[:, j].reshape(-1, *(1,) * (derivatives.ndim - 2))
        return derivatives

    @cached_property
    def _of_parameters(self) -> tuple[Indices, Indices]:
        """The state of each parameter, and the index of its term among the kept ones."""
        equations, columns = np.nonzero(self.parameter_mask[:, self.kept.any(axis=0)])
        return self.highest[equations], columns
