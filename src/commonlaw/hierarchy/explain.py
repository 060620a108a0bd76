"""What decides the coefficients of objects: nothing but the law, the objects' properties, or each object for itself."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from commonlaw.array_types import Floats
from commonlaw.hierarchy.exponents import simple_fraction
from commonlaw.hierarchy.joint_model import CoefficientModel, Estimates, JointModel
from commonlaw.hierarchy.random_effects import JITTER
from commonlaw.hierarchy.relation import PropertyTable, Relation
from commonlaw.hierarchy.relation_choice import RelationChoice, RelationComparison

_SWEEPS = 5
"""How often relations are chosen again, given those of the other coefficients."""

_FREE = 1e2
"""Variance of a coefficient of which nothing is known yet, in units of its mean square."""


@dataclass(frozen=True, eq=False)
class Explained:
    """The relations of all coefficients, and what the objects' coefficients are by them.

    Parameters
    ----------
    relations
        One for each coefficient.
    factor_covariance
        Of the factors of all relations together, in their order, shape (factors, factors).
    estimates, covariances
        Of the objects' coefficients, shapes (objects, k) and (objects, k, k).
    shared_factors
        What errors have in common through the factors: the covariance of the estimates of two objects is the product of
        one's matrix with the other's transposed. Shape (objects, k, factors).
    """

    relations: tuple[Relation, ...]
    factor_covariance: Floats
    estimates: Floats
    covariances: Floats
    shared_factors: Floats


def explain(estimates: Floats, covariances: Floats, properties: PropertyTable) -> Explained:
    """Find the relations of coefficients to their objects by evidence, and what follows from them.

    Each object's coefficients are ``C f(properties)``, the same function for all, times e to a scatter that is normal
    over objects (or plus a scatter, where signs are not sure); they were estimated with normal errors of known
    covariance. Factors are integrated out in closed form, scatters on a grid; what remains, times the prior, compares
    relations, see `RelationComparison`. Those of different coefficients depend on each other through the errors of the
    estimates: the one that is surest is chosen first, then the others, and all again until none changes.

    Parameters
    ----------
    estimates
        Each object's own, shape (objects, k), without regard to the others.
    covariances
        Of their errors, shape (objects, k, k).
    properties
        Numbers that the objects carry.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is singular.

    Examples
    --------
    >>> mass = np.array([[1.0], [2.0], [3.0], [5.0], [8.0]])
    >>> drag = 0.3 / mass * [[1.01], [0.995], [1.0], [1.005], [0.99]]
    >>> (found,) = explain(drag, 1e-4 * drag[..., np.newaxis] ** 2, PropertyTable(("mass",), mass)).relations
    >>> str(found.kind), found.exponents, round(found.factors[0], 2)
    ('power law', (Fraction(-1, 1),), 0.3)
    """
    units = np.sqrt(np.mean(estimates**2, axis=0))
    errors = np.sqrt(np.mean(np.diagonal(covariances, axis1=1, axis2=2), axis=0))
    lifted = covariances + JITTER * np.diag(errors**2)
    own = Estimates(estimates / units, lifted / np.outer(units, units), estimates / units)
    choices = _most_probable(own, properties.varying)
    return _explained(own, choices, properties.varying, units)


def _most_probable(own: Estimates, properties: PropertyTable) -> list[RelationChoice]:
    """Return the relations of all coefficients that fit each other, and are together the most probable."""
    objects, size = own.estimates.shape
    free = CoefficientModel.powers(np.zeros((1, objects)), np.full((1, objects), _FREE), False).some(0)
    known: dict[int, RelationChoice] = {}
    while len(known) < size:
        models = [known[k].model if k in known else free for k in range(size)]
        found = {k: _chosen(own, models, k, properties) for k in range(size) if k not in known}
        best = max(found, key=lambda k: found[k].gain)
        known[best] = found[best]
    choices = _swept(own, [known[k] for k in range(size)], properties, list(range(size)))
    score = _score(own, choices)
    # Where errors hang together, scatter of one coefficient is hardly told from that of another, and the first took it
    for k in [k for k in range(size) if size > 1 and choices[k].scatter]:
        exact = _chosen(own, [each.model for each in choices], k, properties, scatter=False)
        order = [*(j for j in range(size) if j != k), k]
        tried = _swept(own, [exact if j == k else each for j, each in enumerate(choices)], properties, order)
        if _score(own, tried) > score:
            choices, score = tried, _score(own, tried)
    return choices


def _swept(
    own: Estimates, choices: Sequence[RelationChoice], properties: PropertyTable, order: Sequence[int]
) -> list[RelationChoice]:
    """Return relations that are each the most probable given the others, chosen in this order."""
    found = list(choices)
    for _ in range(_SWEEPS if len(found) > 1 else 0):
        before = [each.form for each in found]
        for k in order:
            found[k] = _chosen(own, [each.model for each in found], k, properties)
        if before == [each.form for each in found]:
            break
    return found


def _chosen(
    own: Estimates, models: Sequence[CoefficientModel], index: int, properties: PropertyTable, scatter: bool = True
) -> RelationChoice:
    measured, deviations = _pointed(own, models)
    return RelationComparison(measured, deviations[:, index], models, index, properties).choice(scatter)


def _score(own: Estimates, choices: Sequence[RelationChoice]) -> float:
    """Return the logarithm of prior times evidence of the relations of all coefficients together."""
    models = [each.model for each in choices]
    measured, _ = _pointed(own, models)
    logs = np.array([each.in_logs for each in models])
    density = JointModel.of(measured, models).log_evidence(np.concatenate([each.precision for each in models]))
    return density - float(np.log(abs(measured.points[:, logs])).sum()) + sum(each.log_price for each in choices)


def _pointed(own: Estimates, models: Sequence[CoefficientModel]) -> tuple[Estimates, Floats]:
    """Return the estimates with logarithms about what they and the models of the other coefficients say of each.

    Beside them the standard errors of those points, shape (objects, k).
    """
    objects, size = own.estimates.shape
    points, variances = np.empty((2, objects, size))
    for k in range(size):
        others = [CoefficientModel.left_out(objects) if j == k else each for j, each in enumerate(models)]
        points[:, k], variances[:, k] = JointModel.of(own, others).without(k)
    return replace(own, points=points), np.sqrt(variances)


def _explained(
    own: Estimates, choices: Sequence[RelationChoice], properties: PropertyTable, units: Floats
) -> Explained:
    """Return what follows from the relations of all coefficients, in units of the estimates."""
    models = [each.model for each in choices]
    measured, _ = _pointed(own, models)
    joint = JointModel.of(measured, models)
    factors, covariance = joint.factors(np.concatenate([each.precision for each in models]))
    # What scatter leaves of the model, T - T P T, is nothing to the last digit where there is none
    drawn = joint.variances[:, :, np.newaxis] * joint.precisions
    estimates = joint.design @ factors + np.einsum("okl,ol->ok", drawn, joint.residuals - joint.design @ factors)
    estimates += np.array([each.offsets for each in models]).T
    given = np.eye(len(units)) * joint.variances[:, np.newaxis] - drawn * joint.variances[:, np.newaxis]
    shared = (joint.design - drawn @ joint.design) @ np.linalg.cholesky(covariance)
    logs = np.array([each.in_logs for each in models])
    signs = np.sign(measured.points)
    values = np.where(logs, signs * np.exp(np.where(logs, estimates, 0.0)), estimates)
    slopes = units * np.where(logs, values, 1.0)
    total = (given + shared @ shared.swapaxes(1, 2)) * slopes[:, :, np.newaxis] * slopes[:, np.newaxis]
    relations, turns, first = [], [], 0
    for k, (choice, unit) in enumerate(zip(choices, units.tolist(), strict=True)):
        part = slice(first, first + choice.model.columns.shape[1])
        found, turn = _in_given_units(choice, properties, factors[part], unit, signs[0, k])
        relations.append(
            replace(found, errors=tuple(np.sqrt(np.diag(turn @ covariance[part, part] @ turn.T)).tolist()))
        )
        turns.append(turn)
        first = part.stop
    whole = block_diag(*turns)
    return Explained(
        tuple(relations),
        whole @ covariance @ whole.T,
        values * units,
        (total + total.swapaxes(1, 2)) / 2,
        slopes[:, :, np.newaxis] * shared,
    )


def _in_given_units(
    choice: RelationChoice, properties: PropertyTable, factors: Floats, unit: float, sign: float
) -> tuple[Relation, Floats]:
    """Return a relation in terms of the properties as they were given, and the derivatives of its factors."""
    used, model = properties.choose(choice.properties), choice.model
    relation = Relation(
        choice.kind,
        tuple(factors.tolist()),
        (),
        used.names,
        tuple(map(simple_fraction, choice.exponents)),
        choice.scatter * (1.0 if model.in_logs else unit),
        choice.scatter_error * (1.0 if model.in_logs else unit),
        model.in_logs,
        choice.probability,
    )
    given = relation.columns(used.values)
    inner = np.exp(model.offsets)[:, np.newaxis] if model.in_logs else model.columns
    turn: Floats = float(unit) * np.asarray(np.linalg.lstsq(given, inner, rcond=None)[0], dtype=np.float64)
    if model.in_logs:
        turn = sign * np.exp(factors) * turn
    known = turn[0] if model.in_logs else turn @ factors
    typical = float(given[0, 0] / inner[0, 0])
    return replace(relation, factors=tuple(known.tolist()), typical=typical), turn
