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

BETWEEN = ("held", "linear", "cubic", "jumps")
"""Interpolation of inputs: zero-order hold, linear, cubic spline (not-a-knot), or cubic splines between jumps."""

InputFunction = Callable[[float], ArrayLike]
"""Inputs at a time: one number, or one for each."""

_FAR = 5.0
"""A jump departs from its neighbours' slope this many times as far as intervals nearby do."""
_RARE = 6.0
"""A jump departs as far, in standard deviations by the median of all intervals: one in 5e8 of normal noise."""


def jumps(times: Floats, values: Floats) -> Bools:
    """Return in which intervals between samples inputs jump, shape (n - 1, inputs), by their values, (n, inputs).

    There, the slope is more than twice those of the two intervals on either side, and the input changes by more than
    their slopes explain: by `_FAR` times as much as in the second and third interval on either side, and by `_RARE`
    standard deviations. So there are at least five samples from one jump to the next, and kinks are none. Of a switched
    input, which is constant in most intervals, every change jumps that no neighbour continues, unless these are more
    than a fifth of the intervals. Intervals of less than half the median step are ramps that were recorded as such.
    """
    steps, jump = np.diff(times)[:, np.newaxis], np.zeros((max(len(times) - 1, 0), values.shape[1]), dtype=np.bool_)
    if len(steps) < 7:
        return jump
    slopes = np.diff(values, axis=0) / steps
    size, unexplained = np.abs(slopes), np.zeros(slopes.shape)
    unexplained[1:-1] = np.abs(slopes[1:-1] - (slopes[:-2] + slopes[2:]) / 2) * steps[1:-1]
    middle = np.arange(3, len(steps) - 3)
    around = np.max([size[middle + k] for k in (-2, -1, 1, 2)], axis=0)
    nearby = np.max([unexplained[middle + k] for k in (-3, -2, 2, 3)], axis=0)
    spread = 1.4826 * np.median(unexplained[1:-1], axis=0)
    least = np.maximum(_FAR * nearby, np.maximum(_RARE * spread, np.sqrt(np.finfo(float).eps) * np.ptp(values, axis=0)))
    jump[middle] = (size[middle] > 2 * around) & (unexplained[middle] > least)
    signs = np.pad(np.sign(slopes), ((1, 1), (0, 0)))
    alone = (signs[1:-1] != 0) & (signs[:-2] != signs[1:-1]) & (signs[2:] != signs[1:-1])
    jump |= alone & (2 * np.sum(signs != 0, axis=0) < len(steps)) & (5 * np.sum(alone, axis=0) <= len(steps))
    return jump & (steps >= np.median(steps) / 2)


def _pieces(times: Floats, values: Floats, between: str) -> Floats:
    """Return the coefficients of polynomials from each sample to the next, shape (n, 4, inputs)."""
    coefficients = np.zeros((len(times), 4, values.shape[1]))
    coefficients[:, 0] = values
    if between == "linear":
        coefficients[:-1, 1] = np.diff(values, axis=0) / np.diff(times)[:, np.newaxis]
    elif between in ("cubic", "jumps") and len(times) > 1:
        from scipy.interpolate import CubicSpline

        coefficients[:-1] = CubicSpline(times, values).c[::-1].swapaxes(0, 1)
    return coefficients


def _shifted(coefficients: Floats, by: Floats | float) -> Floats:
    """Return the coefficients of cubic polynomials, shape (4, ...), of the time since a knot that is later by this."""
    a, b, c, d = coefficients
    return np.array([a + by * (b + by * (c + by * d)), b + by * (2 * c + 3 * by * d), c + 3 * by * d, d])


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs as piecewise polynomials of the time since a knot.

    Knots increase, shape (n,); coefficients are in order of increasing power, shape (n, powers, inputs). A knot in the
    middle of an interval of length `unknown`, shape (n,), is a jump at an unknown time within it; others have zero.
    """

    knots: Floats
    coefficients: Floats
    unknown: Floats | float = 0.0

    @classmethod
    def of(cls, times: Floats, values: Floats, between: str = "linear") -> "Inputs":
        """Return inputs that interpolate values, shape (n, inputs), at times of shape (n,), and are constant outside.

        With ``"jumps"``, those that jump between two samples do so in the middle, from one spline to the next, see
        `jumps`. Raises `CommonlawError` if `between` is not one of `BETWEEN`.
        """
        check_choice("interpolation of inputs between samples", between, BETWEEN)
        coefficients, steps = _pieces(times, values, between), np.diff(times)
        jump = jumps(times, values) & (between == "jumps")
        for j in np.flatnonzero(jump.any(axis=0)).tolist():
            last = np.flatnonzero(jump[:, j])
            for rows in np.split(np.arange(len(times)), last + 1):
                coefficients[rows, :, j] = _pieces(times[rows], values[rows, j : j + 1], between)[:, :, 0]
            last = last[np.diff(last, prepend=-1) > 1]  # After a single sample its value goes on
            coefficients[last, :, j] = _shifted(coefficients[last - 1, :, j].T, steps[last - 1]).T
        at = np.flatnonzero(jump.any(axis=1))
        half = steps[at, np.newaxis] / 2
        before, after = (coefficients[rows].swapaxes(0, 1) for rows in (at, at + 1))
        inner = np.where(jump[at], _shifted(after, -half), _shifted(before, half)).swapaxes(0, 1)
        knots = np.insert(times, at + 1, times[at] + half[:, 0])
        unknown = np.insert(np.zeros(len(times)), at + 1, steps[at])
        coefficients = np.insert(coefficients, at + 1, inner, axis=0)
        powers = {"held": 1, "linear": 2}.get(between, 4)
        # No knot where the polynomial does not change
        changes = np.any(np.diff(coefficients, axis=0), axis=(1, 2)) | np.any(coefficients[1:, 1:], axis=(1, 2))
        kept = np.concatenate([[True], changes])
        return cls(np.asarray(knots[kept]), coefficients[kept, :powers], unknown[kept])

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

    @property
    def jumps_within(self) -> list[tuple[float, float]]:
        """The times in the middle of intervals in which they jump, and the lengths of these."""
        unknown = np.broadcast_to(self.unknown, self.knots.shape)
        return list(zip(self.knots[unknown > 0].tolist(), unknown[unknown > 0].tolist(), strict=True))

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
