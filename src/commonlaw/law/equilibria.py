"""Equilibria of a law with their stability, and the modes of linear laws."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats, Indices
from commonlaw.integration import VectorField
from commonlaw.integration.vector_field import LinearizedField
from commonlaw.law.law import Law
from commonlaw.law.quantiles import Function
from commonlaw.library import Terms, highest_columns, with_rates
from commonlaw.library.grammar import columns_in

Complexes = NDArray[np.complex128]

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


def _used(law: Law) -> Indices:
    """Return the terms in the support, and those of parameters."""
    return np.flatnonzero(law.support.any(axis=0) | ~law.terms.is_factor)


def _natural(law: Law) -> Terms:
    """Return these terms over states, not their logarithms."""
    terms = law.terms.take(_used(law).tolist())
    return Terms(replace(terms.variables, logarithmic=()), terms.terms)


def _fields(law: Law) -> Callable[[Floats], VectorField]:
    """Return the function that gives the vector field over states, not their logarithms, by coefficients.

    These have the shape (equations, terms), or that of the parameters in the support.
    """
    support, used, terms = law.support, _used(law), _natural(law)

    def field(coefficients: Floats) -> VectorField:
        if coefficients.ndim == 1:
            given, coefficients = coefficients, np.zeros(support.shape)
            coefficients[support] = given
        return VectorField(terms, coefficients[:, used], law.order, free=support[:, used])

    return field


def _at_rest(field: VectorField, states: Floats, inputs: Mapping[str, float] = {}) -> LinearizedField:
    """Return a vector field at states at rest, shape (n, states), and constant inputs, with its derivatives."""
    variables = field.terms.variables
    values = np.zeros((len(states), len(variables.measured)))
    values[:, : states.shape[1]] = states
    for name, value in inputs.items():
        values[:, variables.index(name)] = value
    with np.errstate(all="ignore"):
        return field.linearize(values)


@np.errstate(all="ignore")
def _newton(highest: Callable[[Floats], tuple[Floats, Floats]], states: Floats, span: Floats) -> Floats:
    """Return where Newton's method goes from states, shape (n, states); NaN where it does not converge.

    `highest` gives the highest derivatives and their Jacobians. Convergence is relative to how much derivatives change
    over the `span` of each state.
    """
    for _ in range(60):
        residuals, slopes = highest(states)
        usable = np.flatnonzero(np.isfinite(slopes).all(axis=(1, 2)) & np.isfinite(residuals).all(axis=1))
        usable = usable[np.abs(np.linalg.det(slopes[usable])) > 0]
        steps = np.full(states.shape, np.nan)
        steps[usable] = np.linalg.solve(slopes[usable], residuals[usable, :, np.newaxis])[..., 0]
        states = states - steps
        if np.all(np.abs(steps[usable]) <= 1e-14 * (1 + np.abs(states[usable]))):
            break
    residuals, slopes = highest(states)
    converged = np.all(np.abs(residuals) <= 1e-9 * np.abs(slopes) @ span, axis=1)
    return np.where(converged[:, np.newaxis], states, np.nan)


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
    visited, sizes = law.provenance.domain.visited, law.provenance.domain.sizes
    ends = [visited.get(name, (-sizes.get(name, 1e3), sizes.get(name, 1e3))) for name in law.schema.states]
    low, high = np.array(ends).T
    # The range of the states with as much on both sides, but no negative values of what was none
    width = np.maximum(high - low, 1e-3 * np.abs(high) + 1e-12)
    low, high = np.where(low >= 0, np.minimum(0.0, low), low - width), high + width

    def leading(at: Floats, state: Floats) -> float:
        """Return the largest real part of the eigenvalues."""
        return float(_eigenvalues(fields(at), state).real.max())

    fields = _fields(law)
    rows, states = highest_columns(law.order, len(low)), slice(0, len(low))
    for point, eigenvalues in fixed_points(law, parameters, low, high, {}):
        errors, is_sure = np.full(len(point), np.nan), True
        if covariance is not None:
            _, by_states, by_parameters = _at_rest(fields(parameters), point[np.newaxis])
            slopes = -np.linalg.solve(by_states[0, rows, states], by_parameters[0, rows])
            errors = np.sqrt(np.maximum(np.einsum("jp,pq,jq->j", slopes, covariance, slopes), 0.0))
            errors[errors <= 1e-9 * width] = 0.0  # Of equilibria at the same place for all coefficients
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

    Coefficients have the shape (equations, terms), or that of the parameters in the support, and the box (states,).
    """
    random, span, rows = np.random.default_rng(0), high - low, highest_columns(law.order, len(low))
    field = _fields(law)(coefficients)

    def highest(states: Floats) -> tuple[Floats, Floats]:
        derivatives, by_states, _ = _at_rest(field, states, inputs)
        return derivatives[:, rows], by_states[:, rows, : len(low)]

    # Starts besides zero
    starts = np.concatenate([np.zeros((1, len(low))), low + random.random((200, len(low))) * span])
    with np.errstate(all="ignore"):
        changes = np.abs(highest(starts)[1]) @ span
    largest = np.max(changes, axis=0, where=np.isfinite(changes), initial=0.0)
    usual = np.where(largest > 0, largest, np.inf)
    reached = _newton(highest, starts, span)
    reached = np.where(np.abs(reached) <= 1e-12 * span, 0.0, reached)  # Zero but for rounding
    reached = reached[np.isfinite(reached).all(axis=1) & np.all((reached >= low) & (reached <= high), axis=1)]
    # Up to this singular value, relative to the size nearby, equilibria are not isolated
    with np.errstate(all="ignore"):
        relative = highest(reached)[1] * span / usual[:, np.newaxis]
    usable = np.isfinite(relative).all(axis=(1, 2))
    reached = reached[usable][np.linalg.norm(relative[usable], -2, axis=(1, 2)) > 1e-10]
    isolated = list[Floats]()
    while len(reached):
        isolated.append(reached[0])
        reached = reached[~np.isclose(reached, reached[0], rtol=1e-6, atol=1e-9 * np.max(span)).all(axis=1)]
    points = np.array(isolated).reshape(-1, len(low))
    for point in points[np.lexsort(points.T[::-1])]:
        eigenvalues = _eigenvalues(field, point, inputs)
        if np.isfinite(eigenvalues).all():
            yield point, eigenvalues


def _eigenvalues_at_origin(law: Law) -> Callable[[Floats], Complexes]:
    """Return the function from parameters in the support, shape (n, p), to eigenvalues of the Jacobian at the origin.

    They have the shape (n, states + rates), the slowest first, and are NaN where the Jacobian is not finite.
    """
    terms, second = _natural(law), with_rates(law.order, len(law.support))
    used, highest = _used(law), highest_columns(law.order, len(law.support))
    width, places = len(law.support) + len(second), list(terms.parameters)

    def eigenvalues(parameters: Floats) -> Complexes:
        count = len(parameters)
        coefficients = np.zeros((count, *law.support.shape))
        coefficients[:, law.support] = parameters
        coefficients = coefficients[:, :, used]
        values = np.zeros((count, len(terms.variables.names)))
        values[:, len(terms.variables.measured) :] = coefficients[:, :, places].sum(axis=1)
        jacobians = np.zeros((count, width, width))
        jacobians[:, second, range(len(law.support), width)] = 1.0
        with np.errstate(all="ignore"):
            jacobians[:, highest] = coefficients @ terms.jacobian(values)[:, :, :width]
        finite = np.isfinite(jacobians).all(axis=(1, 2))
        result = np.full((count, width), np.nan, dtype=np.complex128)
        result[finite] = np.linalg.eigvals(jacobians[finite])
        return np.take_along_axis(result, np.lexsort((result.imag, np.abs(result.real))), axis=1)

    return eigenvalues


def _eigenvalues(field: VectorField, state: Floats, inputs: Mapping[str, float] = {}) -> Complexes:
    """Return the eigenvalues of the Jacobian of the system of first order, shape (states + rates,), at rest.

    NaN where the Jacobian is not finite.
    """
    jacobian = _at_rest(field, state[np.newaxis], inputs).by_states[0]
    if not np.isfinite(jacobian).all():
        return np.full(len(jacobian), np.nan, dtype=np.complex128)
    return np.asarray(np.linalg.eigvals(jacobian), dtype=np.complex128)


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

    A law is linear if its terms with states are the states themselves and their rates, without inputs or time, on which
    modes would depend. Modes that grow have doubling times.

    Parameters
    ----------
    parameters
        Coefficients of one object in the support.
    """
    variables = law.terms.variables
    dynamic = {*range(len(variables.states))}
    varying = {variables.index(name) for name in (*variables.inputs, variables.time)}
    used = [law.terms.terms[k] for k in np.flatnonzero(law.support.any(axis=0) & law.terms.is_factor)]
    used = [term for term in used if term.columns() & dynamic]
    of_states = [[pair for pair in term.powers if columns_in(pair[0]) & dynamic] for term in used]
    if not used or any(term.columns() & varying for term in used):
        return
    if any(len(powers) > 1 or powers[0][0].column is None or powers[0][1] != 1 for powers in of_states):
        return
    eigenvalues, unit = _eigenvalues_at_origin(law), law.schema.units.get(law.schema.time, "")
    here = eigenvalues(parameters[np.newaxis])[0]
    for i, eigenvalue in enumerate(here.tolist()):

        def of(change: Callable[[Complexes], Floats], i: int = i, oscillates: bool = eigenvalue.imag != 0) -> Function:
            def value(rows: Floats) -> Floats:
                values = eigenvalues(rows)[:, i]
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
