"""Coefficients that objects share: partial pooling, and relations to the objects' properties."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.hierarchy import PropertyTable, Relation, explain, informative, shrink
from commonlaw.hierarchy.dimensions import dimensions_of
from commonlaw.law.explanation import Explanation, dependence
from commonlaw.law.provenance import Step
from commonlaw.law.uncertainty import ObjectEstimates, Uncertainty
from commonlaw.outcomes import Outcome, note
from commonlaw.text import shown
from commonlaw.trials.properties import Properties, given_properties
from commonlaw.trials.trial import ObjectProperties

_ALIKE, _OWN = 0.9, 0.1
"""Shrinkage above which coefficients count as alike in words, and below which as specific to the object."""


def partially_pooled(
    coefficients: Floats, uncertainty: Uncertainty, support: Bools, universal: Bools | None, others: bool
) -> tuple[Floats, Uncertainty, Floats, Bools] | None:
    """Return coefficients drawn to their means over objects; None where nothing is to be drawn.

    Beside them their uncertainty, how far each was drawn, from 0 to 1, shape (equations, terms), and which objects were
    pooled, shape (objects,): objects whose trials say nothing of any coefficient, such as blanks among cultures, keep
    their own. The arguments are those of `Law.pool`.
    """
    covariance = uncertainty.known_covariance()
    if uncertainty.shared_factor is not None:
        raise CommonlawError("already-pooled")
    shared = np.zeros_like(support) if universal is None else universal
    # What is known, or what an object does not have, has no variance
    free = np.all(np.diagonal(covariance, axis1=1, axis2=2) > 0, axis=0)
    if len(coefficients) == 1 or not free.any() or not (others or shared.any()):
        return None
    indices = np.argwhere(support)[free].T
    told: Bools = np.ones(len(coefficients), dtype=np.bool_)
    if not shared.any():
        variances = np.diagonal(covariance, axis1=1, axis2=2)[:, free]
        told = np.asarray(informative(coefficients[:, *indices], variances).any(axis=1))
    variances = np.where(shared[support][free], 0.0, np.nan if others else np.inf)
    if told.sum() < 2:
        return None
    found = shrink(coefficients[told][:, *indices], covariance[told][:, free][:, :, free], variances)
    pooled, errors, factor = coefficients.copy(), covariance.copy(), np.zeros_like(covariance)
    inner = np.ix_(told, free, free)
    pooled[np.flatnonzero(told)[:, np.newaxis], *indices] = found.estimates
    errors[inner], factor[inner] = found.covariances, found.shared_factors
    shrinkage = np.zeros(support.shape)
    shrinkage[*indices] = found.shrinkage
    own = ObjectEstimates(coefficients[:, support], covariance)
    return (
        pooled,
        replace(uncertainty, covariance=errors, shared_factor=factor, unpooled=own, pooled=None),
        shrinkage,
        told,
    )


def pooling_step(equations: Sequence[str], terms: Sequence[str], support: Bools, shrinkage: Floats) -> Step:
    """Return what was drawn how far, for the history of a law; names, and arrays of shape (equations, terms)."""
    words = []
    for equation, term in np.argwhere(support):
        share = shrinkage[equation, term]
        how = "alike" if share > _ALIKE else "specific to the object" if share < _OWN else "partly alike"
        words.append(f"{terms[term]} in {equations[equation]}: {how} ({share:.2f})")
    reason = "how far each object's coefficient is drawn to the mean of all, by how much these scatter beyond errors"
    return Step("pooling", "; ".join(words), reason)


def not_pooled(objects: Sequence[str], told: Bools) -> tuple[Outcome, ...]:
    """Return that objects were not pooled, as their trials say nothing of their coefficients."""
    left = [name for name, own in zip(objects, told, strict=True) if not own]
    if not left:
        return ()
    return (note("not-pooled", objects=shown(left, "object")),)


def offered(given: Any, known: ObjectProperties, objects: tuple[str, ...], key: str) -> tuple[Properties, list[str]]:
    """Return the properties of a law's objects, and the names of those that coefficients may follow.

    Parameters
    ----------
    given
        None, names of known properties, or properties by object, see `Law.explain`.
    known
        Those that the law has, by object.
    objects
        Of the law.
    key
        Column of the objects' names in a table.
    """
    names = given if isinstance(given, Sequence) and not isinstance(given, str) else None
    is_table = given is not None and names is None
    found = given_properties(given, key, objects) if is_table else Properties({name: {**known[name]} for name in known})
    if not found.names and (names is None or names):
        raise CommonlawError("properties-unknown")
    if names is None:
        return found, [each for each in found.names if _is_number(found, each, objects)]
    for each in names:
        if each not in found.names:
            raise unknown("property", each, found.names)
        lack = _what_lacks(found, each, objects)
        if lack:
            raise CommonlawError("property-not-a-number", property=each, lacking=lack)
    return found, list(names)


def explained(
    coefficients: Floats,
    uncertainty: Uncertainty,
    support: Bools,
    units: Sequence[str | None],
    table: PropertyTable,
    property_units: Mapping[str, str],
) -> tuple[Floats, Uncertainty]:
    """Return coefficients by their relations to properties, and their uncertainty, with these relations.

    The first arguments are those of a `Law`, with the unit of each parameter where it is known; the table has a row for
    each of its objects.
    """
    own = uncertainty.own_estimates(coefficients[:, support])
    # What is known has no variance
    free = np.all(np.diagonal(own.covariance, axis1=1, axis2=2) > 0, axis=0)
    if len(coefficients) < 2 or not free.any():
        raise CommonlawError("one-object-to-explain")
    known_units = {name: property_units[name] for name in table.names if name in property_units}
    dimensions = dimensions_of([unit for unit, own in zip(units, free, strict=True) if own], known_units)
    table = replace(table, dimensions=dimensions)
    try:
        found = explain(own.coefficients[:, free], own.covariance[:, free][:, :, free], table)
    except np.linalg.LinAlgError as error:
        deviations = np.sqrt(np.diagonal(own.covariance, axis1=1, axis2=2)[:, free])
        raise CommonlawError(
            "relations-not-comparable", error=str(error).lower(), least=deviations.min(), most=deviations.max()
        ) from None
    values, covariance = own.coefficients.copy(), np.zeros_like(own.covariance)
    factor = np.zeros((*values.shape, found.shared_factors.shape[2]))
    values[:, free], factor[:, free] = found.estimates, found.shared_factors
    covariance[np.ix_(np.arange(len(values)), free, free)] = found.covariances
    relations: list[Relation | None] = [None] * len(free)
    for index, relation in zip(np.flatnonzero(free).tolist(), found.relations, strict=True):
        relations[index] = relation
    changed = coefficients.copy()
    changed[:, support] = values
    explanation = Explanation(tuple(relations), found.factor_covariance)
    return changed, replace(
        uncertainty,
        covariance=covariance,
        shared_factor=factor,
        unpooled=own,
        pooled=None,
        explanation=explanation,
    )


def table_of(found: Properties, names: Sequence[str], objects: Sequence[str]) -> PropertyTable:
    """Return these properties of the objects as numbers."""
    rows = [[float(found.values[name][each]) for each in names] for name in objects]
    return PropertyTable(tuple(names), np.array(rows).reshape(len(objects), len(names)))


def explaining_step(uncertainty: Uncertainty, keys: Sequence[tuple[str, str]], names: Sequence[str]) -> Step:
    """Return what was found of each coefficient, by equation and term, for the history of a law."""
    words, relations = [], uncertainty.explanation.relations if uncertainty.explanation else ()
    for (equation, term), each in zip(keys, relations, strict=True):
        if each is not None:
            follows = " of ".join(filter(None, (str(each.kind), dependence(each))))
            words.append(f"{term} in {equation}: {follows} ({each.probability:.2g})")
    reason = f"largest evidence, and its probability; offered were {', '.join(names) or 'no properties'}"
    return Step("relations", "; ".join(words), reason)


def _is_number(found: Properties, name: str, objects: Sequence[str]) -> bool:
    return not _what_lacks(found, name, objects)


def _what_lacks(found: Properties, name: str, objects: Sequence[str]) -> str:
    """Return the first object for which a property is no number, and what it is there; nothing if there is none."""
    for each in objects:
        value = found.values.get(each, {}).get(name)
        if not isinstance(value, float | int):
            return f"{each} has {'none' if value is None else repr(value)}; give it, or leave the property out"
    return ""
