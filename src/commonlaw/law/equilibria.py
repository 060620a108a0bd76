"""Equilibria of a law with their stability, and the modes of linear laws."""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.law.law import Law
from commonlaw.law.quantiles import Function
from commonlaw.library import with_rates
from commonlaw.library.grammar import columns_in

Complexes = NDArray[np.complex128]

_TOLERANCE = 1e-9
_NEUTRAL = 1e-7
"""Real part of an eigenvalue, relative to its size, that is zero but for rounding."""


class Quantity(NamedTuple):
    """A number that follows from a law: how it is called, its function of the coefficients, and its unit."""

    name: str
    symbol: str
    function: Function
    unit: str


class Equilibrium(NamedTuple):
    """A state at which a law stays, shape (states,), with standard errors, and its kind: stable node, saddle, ..."""

    states: Floats
    errors: Floats
    kind: str


class _System:
    """The equations of a law at constant inputs, for coefficients of shape (equations, terms)."""

    def __init__(self, law: Law, inputs: Mapping[str, float]) -> None:
        self.law, self.states = law, len(law.schema.states)
        self.rest = np.zeros(len(law.terms.variables.measured))
        for name, value in inputs.items():
            self.rest[law.terms.variables.index(name)] = value
        self.second = with_rates(law.order, self.states)

    def coefficients(self, parameters: Floats) -> Floats:
        """Return coefficients from those in the support, shape (parameters,)."""
        result = np.zeros(self.law.support.shape)
        result[self.law.support] = parameters
        return result

    def at(self, coefficients: Floats, states: Floats) -> tuple[Floats, Floats]:
        """Return highest derivatives at states at rest, shape (n, states), and their Jacobians.

        Jacobians have the shape (n, states, states + rates).
        """
        terms = self.law.terms
        points = np.tile(self.rest, (len(states), 1))
        points[:, : self.states] = states
        values = terms.at(points, coefficients)
        with np.errstate(all="ignore"):
            factors = coefficients * terms.is_factor
            slopes = np.einsum("jk,nkv->njv", factors, terms.jacobian(values)[:, :, : len(terms.variables.states)])
            return terms.evaluate(values) @ factors.T, slopes

    def newton(self, coefficients: Floats, states: Floats, span: Floats) -> Floats:
        """Return where Newton's method goes from states, shape (n, states); NaN where it does not converge.

        Convergence is relative to how much derivatives change over the `span` of each state.
        """
        for _ in range(60):
            residuals, slopes = self.at(coefficients, states)
            inner = slopes[:, :, : self.states]
            usable = np.flatnonzero(np.isfinite(inner).all(axis=(1, 2)) & np.isfinite(residuals).all(axis=1))
            usable = usable[np.abs(np.linalg.det(inner[usable])) > 0]
            steps = np.full(states.shape, np.nan)
            steps[usable] = np.linalg.solve(inner[usable], residuals[usable, :, np.newaxis])[..., 0]
            states = states - steps
            if np.all(np.abs(steps[usable]) <= 1e-14 * (1 + np.abs(states[usable]))):
                break
        residuals, slopes = self.at(coefficients, states)
        converged = np.all(np.abs(residuals) <= _TOLERANCE * np.abs(slopes[:, :, : self.states]) @ span, axis=1)
        return np.where(converged[:, np.newaxis], states, np.nan)

    def slopes(self, parameters: Floats, point: Floats) -> Floats:
        """Return the derivatives of an equilibrium by the parameters, shape (states, parameters)."""
        inner = self.at(self.coefficients(parameters), point[np.newaxis])[1][0, :, : self.states]
        by_parameter = np.empty((self.states, len(parameters)))
        for i, step in enumerate(1e-6 * np.where(parameters == 0, 1.0, np.abs(parameters))):
            ahead, behind = (
                self.at(self.coefficients(parameters + sign * step * np.eye(len(parameters))[i]), point[np.newaxis])[0]
                for sign in (1, -1)
            )
            by_parameter[:, i] = (ahead - behind)[0] / (2 * step)
        return np.asarray(-np.linalg.solve(inner, by_parameter))

    def eigenvalues(self, coefficients: Floats, states: Floats) -> Complexes:
        """Return the eigenvalues of the Jacobian of the system of first order, shape (states + rates,), at rest."""
        slopes = self.at(coefficients, states[np.newaxis])[1][0]
        result = np.zeros((slopes.shape[1], slopes.shape[1]))
        result[: self.states] = slopes
        result[self.states :] = slopes[self.second]
        for i, j in enumerate(self.second.tolist()):
            result[j] = np.eye(slopes.shape[1])[self.states + i]
        return np.asarray(np.linalg.eigvals(result), dtype=np.complex128)


def depends_on(law: Law, *names: str) -> bool:
    """Return whether a term of a law has some variables in it."""
    columns = {law.terms.variables.index(name) for name in names}
    return any(law.terms.terms[k].columns() & columns for k in np.flatnonzero(law.support.any(axis=0)).tolist())


def has_phase_plane(law: Law) -> bool:
    """Return whether a law has two states of first order, or one of second order, and no time in its terms."""
    return (law.order, len(law.schema.states)) in ((1, 2), (2, 1)) and not depends_on(law, law.terms.variables.time)


def equilibria(law: Law, parameters: Floats, covariance: Floats | None, reach: float) -> Iterator[Equilibrium]:
    r"""Yield the isolated equilibria near what was measured.

    Those that Newton's method finds from points in and about the range of the states; there may be others. A law with
    inputs or time in its terms has none. Errors are those of the delta method, with the derivatives
    :math:`-F_x^{-1} F_\theta` of the solution of :math:`F(x, \theta) = 0`. Stability is that of the linearization; it
    is uncertain if the interval of the largest real part of an eigenvalue includes zero.

    Parameters
    ----------
    parameters, covariance
        Coefficients of one object in the support, shape (p,), and their covariance if it is known.
    reach
        Standard errors from the estimate to the ends of intervals.
    """
    if depends_on(law, *law.terms.variables.inputs, law.terms.variables.time):
        return
    system = _System(law, {})
    visited, sizes = law.provenance.domain.visited, {} if law.observation is None else law.observation.sizes
    ends = [visited.get(name, (-sizes.get(name, 1e3), sizes.get(name, 1e3))) for name in law.schema.states]
    low, high = np.array(ends).T
    # The range of the states with as much on both sides, but no negative values of what was none
    width = np.maximum(high - low, 1e-3 * np.abs(high) + 1e-12)
    low, high = np.where(low >= 0, np.minimum(0.0, low), low - width), high + width

    def leading(at: Floats, state: Floats) -> float:
        """Return the largest real part of the eigenvalues."""
        return float(system.eigenvalues(system.coefficients(at), state).real.max())

    for point, eigenvalues in fixed_points(law, system.coefficients(parameters), low, high, {}):
        errors, is_sure = np.full(len(point), np.nan), True
        if covariance is not None:
            slopes = system.slopes(parameters, point)
            errors = np.sqrt(np.maximum(np.einsum("jp,pq,jq->j", slopes, covariance, slopes), 0.0))
            errors[errors <= _TOLERANCE * width] = 0.0  # Of equilibria at the same place for all coefficients
            steps = np.sqrt(np.diagonal(covariance)) * 1e-3
            ahead, behind = (
                [leading(parameters + sign * step, point + sign * slopes @ step) for step in np.diag(steps)]
                for sign in (1, -1)
            )
            gradient = (np.array(ahead) - np.array(behind)) / np.where(steps > 0, 2 * steps, 1.0)
            error = float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
            largest = abs(float(eigenvalues.real.max()))
            is_sure = largest > reach * error or largest <= _NEUTRAL * np.abs(eigenvalues).max()
        yield Equilibrium(point, errors, kind(eigenvalues) if is_sure else "stability uncertain")


def fixed_points(
    law: Law, coefficients: Floats, low: Floats, high: Floats, inputs: Mapping[str, float]
) -> Iterator[tuple[Floats, Complexes]]:
    """Yield the isolated states of rest in a box at constant inputs, with the eigenvalues of the Jacobian there.

    Coefficients have the shape (equations, terms), `low` and `high` (states,).
    """
    system = _System(law, inputs)
    random, span = np.random.default_rng(0), high - low
    # Starts besides zero
    starts = np.concatenate([np.zeros((1, len(low))), low + random.random((200, len(low))) * span])
    changes = np.abs(system.at(coefficients, starts)[1][:, :, : system.states]) @ span
    largest = np.max(changes, axis=0, where=np.isfinite(changes), initial=0.0)
    usual = np.where(largest > 0, largest, np.inf)
    reached = system.newton(coefficients, starts, span)
    reached = reached[np.isfinite(reached).all(axis=1) & np.all((reached >= low) & (reached <= high), axis=1)]
    isolated = list[Floats]()
    for state in reached:
        slopes = system.at(coefficients, state[np.newaxis])[1][0, :, : system.states]
        known = any(np.allclose(state, point, rtol=1e-6, atol=1e-9 * np.max(span)) for point in isolated)
        # Up to this singular value, relative to the size nearby, equilibria are not isolated
        if not known and np.linalg.norm(slopes * span / usual[:, np.newaxis], -2) > 1e-10:
            isolated.append(state)
    points = np.array(isolated).reshape(-1, system.states)
    for point in points[np.lexsort(points.T[::-1])]:
        yield point, system.eigenvalues(coefficients, point)


def kind(eigenvalues: Complexes) -> str:
    """Return ``stable node``, ``saddle``, ``centre of its linearization`` or another kind by its eigenvalues."""
    real, is_complex = eigenvalues.real, np.any(eigenvalues.imag != 0)
    neutral = np.abs(real) <= _NEUTRAL * np.abs(eigenvalues).max(initial=0.0)
    if neutral.any():
        return "centre of its linearization" if is_complex and neutral.all() else "neutral"
    if len(real) == 1:
        return "stable" if real[0] < 0 else "unstable"
    if (real > 0).any() and (real < 0).any():
        return "saddle"
    return f"{'stable' if real[0] < 0 else 'unstable'} {'focus' if is_complex else 'node'}"


def modes(law: Law, parameters: Floats) -> Iterator[Quantity]:
    """Yield time constants, periods and damping ratios of the modes of a linear law, the slowest first.

    A law is linear if its terms with states are the states themselves and their rates. Modes that grow have doubling
    times.

    Parameters
    ----------
    parameters
        Coefficients of one object in the support.
    """
    system, variables = _System(law, {}), law.terms.variables
    dynamic = {*range(len(variables.states))}
    used = [law.terms.terms[k] for k in np.flatnonzero(law.support.any(axis=0) & law.terms.is_factor)]
    of_states = [[pair for pair in term.powers if columns_in(pair[0]) & dynamic] for term in used]
    of_states = [powers for powers in of_states if powers]
    if not of_states or any(
        len(powers) > 1 or powers[0][0].column is None or powers[0][1] != 1 for powers in of_states
    ):
        return
    origin, unit = np.zeros(system.states), law.schema.units.get(law.schema.time, "")

    def eigenvalues(row: Floats) -> Complexes:
        values = system.eigenvalues(system.coefficients(row), origin)
        return values[np.lexsort((values.imag, np.abs(values.real)))]

    here = eigenvalues(parameters)
    for i, eigenvalue in enumerate(here.tolist()):

        def of(change: Callable[[Complexes], Floats], i: int = i, oscillates: bool = eigenvalue.imag != 0) -> Function:
            def value(rows: Floats) -> Floats:
                values = np.array([eigenvalues(row)[i] for row in rows])
                return np.where((values.imag != 0) == oscillates, change(values), np.nan)

            return value

        label = f"mode {i + 1}"
        if abs(eigenvalue) == 0 or eigenvalue.imag < 0:
            continue
        if eigenvalue.imag > 0:
            yield Quantity(f"period of {label}", "T", of(lambda values: 2 * np.pi / values.imag), unit)
            yield Quantity(f"damping ratio of {label}", "ζ", of(lambda values: -values.real / np.abs(values)), "")
        elif eigenvalue.real < 0:
            yield Quantity(f"time constant of {label}", "τ", of(lambda values: -1 / values.real), unit)
            yield Quantity(f"half-life of {label}", "t½", of(lambda values: -np.log(2) / values.real), unit)
        else:
            yield Quantity(f"doubling time of {label}", "T2", of(lambda values: np.log(2) / values.real), unit)
