"""How coefficients depend on properties of objects: possible relations, weighed and chosen."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.hierarchy.joint_model import CoefficientModel, Estimates, JointModel, log_evidence
from commonlaw.hierarchy.random_effects import JITTER
from commonlaw.hierarchy.relation import MAX_DENOMINATOR, ONE_MORE, PropertyTable, Relation, RelationKind, exponent_sets
from commonlaw.runtime.forking import cached_property

_ODDS = {RelationKind.UNIVERSAL: 3.0, RelationKind.OWN: 1.0, RelationKind.POWER_LAW: 0.1, RelationKind.AFFINE: 0.1}
"""Prior odds of each kind: indistinguishable coefficients are rather universal. Irrelevant properties together have
more than ten times the evidence of the true kind in at most a tenth of all cases (Markov's inequality)."""

_TYPICAL_SCATTER, _SCATTERS = 0.5, np.geomspace(1e-3, 5.0, 27)
"""Relative scatters between objects are integrated over by a half Cauchy distribution of that width, at these values:
with ten objects neighbours are hardly distinguishable."""


@dataclass(frozen=True, eq=False)
class RelationChoice:
    """A relation of one coefficient, with the model that follows from it; properties are indices in the table.

    `score` is the logarithm of prior times evidence, but for what all relations share; `gain` its lead over
    object-specific coefficients, and `log_weight` the part of the score that is not the evidence of its model: prior,
    and possible scatters.
    """

    kind: RelationKind
    properties: tuple[int, ...]
    exponents: tuple[float, ...]
    scatter: float
    scatter_error: float
    model: CoefficientModel
    score: float
    probability: float = 1.0
    gain: float = 0.0
    log_weight: float = 0.0

    @property
    def form(self) -> tuple[object, ...]:
        """What it is but for numbers that are estimated."""
        return self.kind, self.properties, self.exponents


@dataclass(frozen=True, eq=False)
class RelationComparison:
    """All relations of one coefficient, given the models of the others.

    `deviations` are standard errors of its points, as estimates and other models give them, shape (objects,); its own
    model among `models` is ignored, and `properties` are those that differ between objects.
    """

    measured: Estimates
    deviations: Floats
    models: Sequence[CoefficientModel]
    index: int
    properties: PropertyTable

    def choice(self, scatter: bool = True) -> RelationChoice:
        """Return the most probable relation, of the most probable kind; without scatter if that is not wanted."""
        every = [*self._power_laws(), *self._affine()]
        allowed = [candidate for candidate in every if scatter or not candidate.scatter]
        totals = {
            kind: _total([candidate for candidate in allowed if candidate.kind is kind])
            for kind in {candidate.kind for candidate in allowed}
        }
        best = max(totals, key=lambda kind: totals[kind])
        relations: dict[object, list[RelationChoice]] = {}
        for candidate in allowed:
            if candidate.kind is best:
                relations.setdefault(candidate.form, []).append(candidate)
        score, alike = max(((_total(relation), relation) for relation in relations.values()), key=lambda pair: pair[0])
        chosen = max(alike, key=lambda candidate: candidate.score)
        probability = float(np.exp(score - np.logaddexp.reduce(list(totals.values()))))
        each_its_own = _total([candidate for candidate in every if candidate.kind is RelationKind.OWN])
        weight = chosen.score - float(self._evidence(chosen.model.alone)[0])
        return replace(chosen, probability=probability, gain=totals[best] - each_its_own, log_weight=weight)

    @cached_property
    def _points(self) -> Floats:
        return np.asarray(self.measured.points[:, self.index])

    @cached_property
    def _sure(self) -> bool:
        """Whether all objects have the same sign, by four standard errors: then logarithms mean something."""
        signs = np.unique(np.sign(self._points))
        return len(signs) == 1 and bool(np.all(abs(self._points) > 4 * self.deviations))

    @cached_property
    def _scale(self) -> float:
        if self._sure:
            return float(np.exp(np.mean(np.log(abs(self._points)))))
        weights = 1 / self.deviations**2
        return float(np.sqrt(np.sum(weights * self._points**2) / np.sum(weights)))

    @cached_property
    def _unit(self) -> float:
        """In which the scatter of models counts: that of a logarithm is relative already."""
        return 1.0 if self._sure else self._scale

    def _power_laws(self) -> Iterator[RelationChoice]:
        """Yield the power laws worth a look, with scatter and without, among them that of no property."""
        usable = [i for i, column in enumerate(self.properties.values.T) if (column > 0).all()]
        logs = np.log(self.properties.values[:, usable])
        # Of three properties at most, and two fewer than there are objects
        sets = exponent_sets(len(usable), min(3, len(logs) - 2))
        exponents = np.concatenate([np.zeros((1, len(usable))), sets.exponents])
        weights, dimensions = sets.log_prior, self.properties.dimensions
        if dimensions is not None and len(weights):
            names = [self.properties.names[i] for i in usable]
            weights = weights + dimensions.log_odds(self.index, names, sets.exponents)
            weights = weights - np.logaddexp.reduce(weights)
        log_prior = np.append(0.0, weights + np.log(_ODDS[RelationKind.POWER_LAW] / 2))
        shapes = exponents @ (logs - logs.mean(axis=0)).T

        def scattered(rows: Indices | slice, scatter: float) -> CoefficientModel:
            variances = np.full((1, len(logs)), (scatter * self._unit) ** 2)
            return CoefficientModel.powers(shapes[rows], variances, self._sure)

        exact = CoefficientModel.powers(shapes, np.zeros((1, len(logs))), False)
        plain = self._scores(exact) + log_prior
        # Only the best 300, without a scatter and at every fifth one, are integrated over all scatters
        coarse = [self._scores(scattered(slice(None), scatter)) for scatter in _SCATTERS[::5]]
        best = np.max(coarse, axis=0) + log_prior
        kept = np.unique(np.concatenate([[0], np.argsort(-plain)[:300], np.argsort(-best)[:300]]))
        scores = np.array([self._scores(scattered(kept, scatter)) for scatter in _SCATTERS])
        summed, sizes, errors = _over_scatters(scores)
        for i, row in enumerate(kept.tolist()):
            columns = tuple(usable[k] for k in np.flatnonzero(exponents[row]))
            powers = tuple(exponents[row][exponents[row] != 0].tolist())
            kinds = (RelationKind.POWER_LAW,) * 2 if columns else (RelationKind.UNIVERSAL, RelationKind.OWN)
            model = scattered(np.array([row]), sizes[i]).some(0)
            universal = 0.0 if columns else np.log(_ODDS[RelationKind.UNIVERSAL])
            yield RelationChoice(kinds[0], columns, powers, 0.0, 0.0, exact.some(row), float(plain[row] + universal))
            score = float(summed[i] + log_prior[row])
            scatter, error = float(sizes[i] * self._unit), float(errors[i] * self._unit)
            yield RelationChoice(kinds[1], columns, powers, scatter, error, model, score)

    def _affine(self) -> Iterator[RelationChoice]:
        """Yield affine functions, with scatter and without, where coefficient or properties are not of one sign."""
        kind, objects = RelationKind.AFFINE, len(self._points)
        usable = [i for i, values in enumerate(self.properties.values.T) if not (self._sure and (values > 0).all())]
        for size in range(1, min(2, len(usable), objects - 2) + 1):  # Slopes
            chosen = list(combinations(usable, size))
            log_prior = np.log(_ODDS[kind] / 2 / len(chosen)) + (size - 1) * np.log(ONE_MORE)
            exact = self._affine_models(chosen, 0.0)
            plain = self._scores(exact) + log_prior
            scores = np.array([self._scores(self._affine_models(chosen, scatter)) for scatter in _SCATTERS])
            summed, sizes, errors = _over_scatters(scores)
            for i, columns in enumerate(chosen):
                yield RelationChoice(kind, columns, (), 0.0, 0.0, exact.some(i), float(plain[i]))
                model, score = self._affine_models([columns], sizes[i]).some(0), float(summed[i] + log_prior)
                scatter, error = float(sizes[i] * self._scale), float(errors[i] * self._scale)
                yield RelationChoice(kind, columns, (), scatter, error, model, score)

    def _affine_models(self, chosen: Sequence[tuple[int, ...]], scatter: float) -> CoefficientModel:
        """Return the affine functions of some properties each, as many of them, with a scatter relative to the size."""
        values = self.properties.standardized
        objects, ones = len(values), np.ones((len(chosen), len(values), 1))
        columns = np.concatenate([ones, np.array([values[:, subset] for subset in chosen])], axis=2)
        precision = np.append(0.0, np.full(len(chosen[0]), self._scale**-2))
        variances = np.full((1, objects), (scatter * self._scale) ** 2)
        return CoefficientModel(columns, np.zeros((1, objects)), variances, False, precision)

    def _scores(self, tried: CoefficientModel) -> Floats:
        """Return the logarithms of the evidence of several models, with the prior of their factors, shape (models,)."""
        # A factor's logarithm is as probable anywhere, and so is the factor near the size of the coefficients
        return self._evidence(tried) - (0.0 if tried.in_logs else np.log(self._scale))

    def _evidence(self, tried: CoefficientModel) -> Floats:
        left_out = CoefficientModel.left_out(len(self._points), tried.in_logs)
        models = [left_out if k == self.index else model for k, model in enumerate(self.models)]
        others = JointModel.of(self.measured, models)
        # Relations times objects that are computed together take memory
        count, step = max(map(len, (tried.columns, tried.offsets))), max(1, 200_000 // len(self._points))
        parts = [log_evidence(others, self.index, tried.some(slice(i, i + step))) for i in range(0, count, step)]
        return np.asarray(np.concatenate(parts))


def _over_scatters(scores: Floats) -> tuple[Floats, Floats, Floats]:
    """Return scores integrated over scatters, from shape (scatters, models), the scatters' means, and their errors."""
    density = np.gradient(_SCATTERS) / (1 + (_SCATTERS / _TYPICAL_SCATTER) ** 2)
    weighted = scores + np.log(density / density.sum())[:, np.newaxis]
    total = np.logaddexp.reduce(weighted, axis=0)
    weights = np.exp(weighted - total)
    # The mean of the logarithm: zero is far away
    means = np.exp(weights.T @ np.log(_SCATTERS))
    return total, means, np.sqrt(np.sum(weights * (_SCATTERS[:, np.newaxis] - means) ** 2, axis=0))


def _total(choices: Sequence[RelationChoice]) -> float:
    """Return the logarithm of the sum of what speaks for several relations."""
    return float(np.logaddexp.reduce([choice.score for choice in choices]))


@dataclass(frozen=True, eq=False)
class Explained:
    """The relations of all coefficients, and the coefficients that follow for each object.

    Parameters
    ----------
    relations
        One for each coefficient.
    factor_covariance
        Of the factors of all relations, in their order, shape (factors, factors).
    estimates, covariances
        Of the objects' coefficients, shapes (objects, k) and (objects, k, k).
    shared_factors
        Shape (objects, k, factors): one object's matrix times another's transposed is the covariance of their
        estimates.
    """

    relations: tuple[Relation, ...]
    factor_covariance: Floats
    estimates: Floats
    covariances: Floats
    shared_factors: Floats


def explain(estimates: Floats, covariances: Floats, properties: PropertyTable) -> Explained:
    """Select the relations of coefficients to properties of objects by evidence.

    Coefficients are ``C f(properties)``, with the same f for all objects, times the exponential of a scatter that is
    normal over objects (plus a scatter where signs are not sure), and estimated with normal errors of known covariance.
    Factors are integrated out in closed form, scatters on a grid; evidence times prior compares relations. Relations of
    different coefficients depend on each other through the errors: the surest is chosen first, then the others, until
    none changes.

    Parameters
    ----------
    estimates, covariances
        Object-specific estimates, shape (objects, k), and their covariances, shape (objects, k, k).
    properties
        Of the objects.

    Raises `numpy.linalg.LinAlgError` if a covariance is singular.

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
    scaled = Estimates(estimates / units, lifted / np.outer(units, units), estimates / units)
    return _explained(scaled, _most_probable(scaled, properties.varying), properties.varying, units)


def _most_probable(own: Estimates, properties: PropertyTable) -> list[RelationChoice]:
    """Return the relations of all coefficients that fit each other, and are together the most probable."""
    objects, size = own.estimates.shape
    # In units of its mean square, the variance of a coefficient of which nothing is known yet is a hundred
    free = CoefficientModel.powers(np.zeros((1, objects)), np.full((1, objects), 1e2), False).some(0)
    known: dict[int, RelationChoice] = {}
    while len(known) < size:
        models = [known[k].model if k in known else free for k in range(size)]
        chosen = {k: _chosen(own, models, k, properties) for k in range(size) if k not in known}
        best = max(chosen, key=lambda k: chosen[k].gain)
        known[best] = chosen[best]
    choices = _swept(own, [known[k] for k in range(size)], properties, list(range(size)))
    score = _score(own, choices)
    # With correlated errors the scatters of coefficients are confounded, and the first coefficient took it
    for k in [k for k in range(size) if size > 1 and choices[k].scatter]:
        exact = _chosen(own, [choice.model for choice in choices], k, properties, scatter=False)
        order = [*(j for j in range(size) if j != k), k]
        tried = _swept(own, [exact if j == k else choice for j, choice in enumerate(choices)], properties, order)
        if _score(own, tried) > score:
            choices, score = tried, _score(own, tried)
    return choices


def _swept(
    own: Estimates, choices: Sequence[RelationChoice], properties: PropertyTable, order: Sequence[int]
) -> list[RelationChoice]:
    """Return relations that are each the most probable given the others, chosen in this order."""
    result = list(choices)
    for _ in range(5 if len(result) > 1 else 0):
        before = [choice.form for choice in result]
        for k in order:
            result[k] = _chosen(own, [choice.model for choice in result], k, properties)
        if before == [choice.form for choice in result]:
            break
    return result


def _chosen(
    own: Estimates, models: Sequence[CoefficientModel], index: int, properties: PropertyTable, scatter: bool = True
) -> RelationChoice:
    measured, deviations = _pointed(own, models)
    return RelationComparison(measured, deviations[:, index], models, index, properties).choice(scatter)


def _score(own: Estimates, choices: Sequence[RelationChoice]) -> float:
    """Return the logarithm of prior times evidence of the relations of all coefficients together."""
    models = [choice.model for choice in choices]
    measured, _ = _pointed(own, models)
    logs = np.array([model.in_logs for model in models])
    density = JointModel.of(measured, models).log_evidence(np.concatenate([model.precision for model in models]))
    return density - float(np.log(abs(measured.points[:, logs])).sum()) + sum(choice.log_weight for choice in choices)


def _pointed(own: Estimates, models: Sequence[CoefficientModel]) -> tuple[Estimates, Floats]:
    """Return estimates linearized about what they and other coefficients give, with standard errors, (objects, k)."""
    objects, size = own.estimates.shape
    points, variances = np.empty((2, objects, size))
    for k in range(size):
        others = [CoefficientModel.left_out(objects) if j == k else model for j, model in enumerate(models)]
        points[:, k], variances[:, k] = JointModel.of(own, others).without(k)
    return replace(own, points=points), np.sqrt(variances)


def _explained(
    own: Estimates, choices: Sequence[RelationChoice], properties: PropertyTable, units: Floats
) -> Explained:
    """Return what follows from the relations of all coefficients, in units of the estimates."""
    from scipy.linalg import block_diag

    models = [choice.model for choice in choices]
    measured, _ = _pointed(own, models)
    joint = JointModel.of(measured, models)
    factors, covariance = joint.factors(np.concatenate([model.precision for model in models]))
    # What scatter leaves of the model, T - T P T, is nothing to the last digit where there is none
    drawn = joint.variances[:, :, np.newaxis] * joint.precisions
    estimates = joint.design @ factors + np.einsum("okl,ol->ok", drawn, joint.residuals - joint.design @ factors)
    estimates += np.array([model.offsets for model in models]).T
    given = np.eye(len(units)) * joint.variances[:, np.newaxis] - drawn * joint.variances[:, np.newaxis]
    shared = (joint.design - drawn @ joint.design) @ np.linalg.cholesky(covariance)
    logs = np.array([model.in_logs for model in models])
    signs = np.sign(measured.points)
    values = np.where(logs, signs * np.exp(np.where(logs, estimates, 0.0)), estimates)
    slopes = units * np.where(logs, values, 1.0)
    total = (given + shared @ shared.swapaxes(1, 2)) * slopes[:, :, np.newaxis] * slopes[:, np.newaxis]
    relations, turns, first = [], [], 0
    for k, (choice, unit) in enumerate(zip(choices, units.tolist(), strict=True)):
        part = slice(first, first + choice.model.columns.shape[1])
        relation, turn = _in_given_units(choice, properties, factors[part], unit, signs[0, k])
        errors = np.sqrt(np.diag(turn @ covariance[part, part] @ turn.T))
        relations.append(replace(relation, errors=tuple(errors.tolist())))
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
        tuple(Fraction(exponent).limit_denominator(MAX_DENOMINATOR) for exponent in choice.exponents),
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
    return replace(relation, factors=tuple(known.tolist()), typical=float(given[0, 0] / inner[0, 0])), turn
