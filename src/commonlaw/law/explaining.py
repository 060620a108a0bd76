"""From a law and the properties of its objects to what decides its coefficients."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.hierarchy import PropertyTable, Relation, explain
from commonlaw.law.dimensions import dimensions_of
from commonlaw.law.explanation import Explanation, dependence
from commonlaw.law.provenance import Step
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.trials.properties import Properties, given_properties
from commonlaw.trials.trial import ObjectProperties


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
