"""Coefficients that objects share: partial pooling, and relations to the objects' properties."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import note
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.hierarchy import PropertyTable, Relation, explain, informative, shrink
from commonlaw.hierarchy.relation import dimensions_of
from commonlaw.law.law import Law, shares_terms, with_other_laws
from commonlaw.law.objects import with_estimates
from commonlaw.law.parameters import coefficient_units, left_hand_sides, named_parameters, restrictions_of
from commonlaw.law.printing import dependence
from commonlaw.law.provenance import Step
from commonlaw.law.restrictions import ALL
from commonlaw.law.script import written
from commonlaw.law.text import MANY
from commonlaw.law.uncertainty import Explanation, ObjectEstimates
from commonlaw.runtime.arguments import checks_types
from commonlaw.text import shown
from commonlaw.trials.properties import Properties, given_properties
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    import pandas as pd


def _measured(law: Law) -> Bools:
    """Return which objects have an estimate of every parameter, and not only a limit, shape (objects,)."""
    return np.array([name not in law.uncertainty.limited_objects for name in law.objects])


@checks_types
def pool_objects(law: Law, shared: Bools | None = None, others: bool = True) -> Law:
    """Return a law with coefficients partially pooled over objects (parametric empirical Bayes; Morris 1983).

    ``c~_o = c_o - E_o (E_o + T)^-1 (c_o - mu)``: the coefficients c_o of object o with covariance E_o are shrunk to the
    population mean mu, the more so the smaller the between-object covariance T. ``provenance.history`` has the
    shrinkage of each coefficient, ``uncertainty.shared_factor`` the dependence of the objects' errors. `shared`
    coefficients, shape (equations, terms), become the same for all objects; the `others` are shrunk. Objects without
    information on any coefficient, such as blanks among cultures, or with only a limit of a parameter, are left as they
    are.

    Raises `CommonlawError` if the covariance is not known, or the law is already pooled.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05, trials=1)
    >>> law = cl.fit("x'' = -g - c v", drops)
    >>> pooled = cl.law.pool_objects(law)
    >>> bool(pooled.params["estimate"][::2].std() < law.params["estimate"][::2].std())  # Of g
    True
    """
    other_laws = law.uncertainty.map_other_laws(lambda candidate: pool_objects(candidate, shared, others))
    unchanged = with_other_laws(law, other_laws) if other_laws else law
    covariance, values = law.uncertainty.known_covariance(), law.coefficients[:, law.support]
    if law.uncertainty.shared_factor is not None:
        raise CommonlawError("already-pooled")
    in_common = np.zeros(values.shape[1], dtype=np.bool_) if shared is None else shared[law.support]
    # What is known, or what an object does not have, has no variance
    own_variances = np.diagonal(covariance, axis1=1, axis2=2)
    free = np.all(own_variances > 0, axis=0)
    if len(law.objects) == 1 or not free.any() or not (others or in_common.any()):
        return unchanged
    informed: Bools = np.ones(len(law.objects), dtype=np.bool_)
    if not in_common.any():
        informed = np.asarray(informative(values[:, free], own_variances[:, free]).any(axis=1)) & _measured(law)
    if informed.sum() < 2:
        return unchanged
    variances = np.where(in_common[free], 0.0, np.nan if others else np.inf)
    inner = np.ix_(informed, free, free)
    shrunk = shrink(values[np.ix_(informed, free)], covariance[inner], variances)
    drawn, errors, factor, shrinkage = values.copy(), covariance.copy(), np.zeros_like(covariance), np.zeros(len(free))
    drawn[np.ix_(informed, free)], shrinkage[free] = shrunk.estimates, shrunk.shrinkage
    errors[inner], factor[inner] = shrunk.covariances, shrunk.shared_factors
    choices, lefts = [], left_hand_sides(law)
    for (j, k), share in zip(np.argwhere(law.support).tolist(), shrinkage.tolist(), strict=True):
        how = "shared" if share > 0.9 else "object-specific" if share < 0.1 else "partly pooled"
        choices.append(f"{law.terms.names[k]} in {lefts[j]}: {how} ({share:.2f})")
    reason = "shrinkage of each object's coefficient to the mean, by the between-object variance"
    if not informed.all():
        apart = [name for name, is_informative in zip(law.objects, informed, strict=True) if not is_informative]
        diagnostics = (*law.diagnostics, note("not-pooled", objects=shown(apart, "object")))
        law = replace(law, provenance=replace(law.provenance, outcomes=diagnostics))
    if shared is not None:
        names = [
            entry.name
            for entry in named_parameters(law).definitions
            if all(shared[part.equation, part.term] for part in entry.parts)
        ]
        restrictions = restrictions_of(law)
        restrictions = replace(restrictions, shared={**restrictions.shared, **dict.fromkeys(names, ALL)})
        law = replace(law, restrictions=restrictions)
    known = {"covariance": errors, "shared_factor": factor, "unpooled": ObjectEstimates(values, covariance)}
    return _with_values(law, drawn, Step("pooling", "; ".join(choices), reason), other_laws=other_laws, **known)


def _with_values(law: Law, values: Floats, step: Step, **known: Any) -> Law:
    """Return a law with other coefficients in its support, shape (objects, parameters), their errors and a step."""
    coefficients = law.coefficients.copy()
    coefficients[:, law.support] = values
    provenance = replace(law.provenance, history=(*law.history, step))
    uncertainty = replace(law.uncertainty, pooled=None, **known)
    return replace(law, coefficients=coefficients, uncertainty=uncertainty, provenance=provenance)


def explained(law: Law, given: Any) -> Law:
    """Return a law whose coefficients follow from properties of the objects, see `Law.explain`."""
    if not shares_terms(law):
        raise CommonlawError("explain-own-terms")
    properties, names = _offered(law, given)
    related, measured = _by_properties(law, properties, names, _measured(law)), _measured(law)

    def other(each: Law) -> Law:
        try:
            return replace(_by_properties(each, properties, names, measured), provenance=each.provenance)
        except CommonlawError:  # Nothing decides its coefficients
            return each

    call = f"law.explain({'' if given is None else written(given)})"
    provenance = replace(related.provenance, calls=(*related.provenance.calls, call))
    return with_other_laws(replace(related, provenance=provenance), law.uncertainty.map_other_laws(other))


def by_properties(law: Law) -> list[str]:
    """Return a line of equations whose coefficients follow from properties of the objects; no line if none does."""
    measured = _measured(law)
    if not (shares_terms(law) and 2 < measured.sum() <= MANY and law.uncertainty.explanation is None):
        return []
    try:
        related = _by_properties(law, *_offered(law, None), measured)
    except CommonlawError:
        return []
    relations = related.uncertainty.explanation.relations if related.uncertainty.explanation else ()
    if not any(relation.properties for relation in relations if relation):
        return []
    apart = "" if measured.all() else f" (without {', '.join(compress(law.objects, ~measured))})"
    return [f"by properties{apart}: {'; '.join(related.equations())}"]


def _offered(law: Law, given: Any) -> tuple[Properties, list[str]]:
    """Return the properties of a law's objects, and the names of those that coefficients may follow."""
    names = given if isinstance(given, Sequence) and not isinstance(given, str) else None
    if given is not None and names is None:
        result = given_properties(given, law.schema.object, law.objects)
    else:
        result = Properties({name: {**values} for name, values in law.properties.items()})
    if not result.names and (names is None or names):
        raise CommonlawError("properties-unknown")
    if names is None:
        return result, [name for name in result.names if not _what_lacks(result, name, law.objects)]
    for name in names:
        check_choice("property", name, result.names)
        if lack := _what_lacks(result, name, law.objects):
            raise CommonlawError("property-not-a-number", property=name, lacking=lack)
    return result, list(names)


def _what_lacks(found: Properties, name: str, objects: Sequence[str]) -> str:
    """Return the first object for which a property is no number, and what it is there; nothing if there is none."""
    for owner in objects:
        value = found.values.get(owner, {}).get(name)
        if not isinstance(value, float | int):
            return f"{owner} has {'none' if value is None else repr(value)}; give it, or leave the property out"
    return ""


def _by_properties(law: Law, properties: Properties, names: Sequence[str], measured: Bools) -> Law:
    """Return a law by properties of these names, with the other laws that it has.

    Objects that were not `measured`, shape (objects,), count for no relation and keep their own coefficients.
    """
    estimates = law.uncertainty.own_estimates(law.coefficients[:, law.support])
    # What is known has no variance
    free = np.all(np.diagonal(estimates.covariance, axis1=1, axis2=2)[measured] > 0, axis=0)
    if len(law.objects) < 2 or not free.any():
        raise CommonlawError("one-object-to-explain")
    if measured.sum() < 2:
        limited = [*dict.fromkeys(limit.parameter for limit in law.uncertainty.limits)]
        raise CommonlawError("explain-with-limits", objects=[*compress(law.objects, ~measured)], names=limited)
    related = [*compress(law.objects, measured)]
    rows = [[float(properties.values[name][column]) for column in names] for name in related]
    units, named = {**law.schema.units, **properties.units}, coefficient_units(law)
    lefts = left_hand_sides(law)
    keys = [(lefts[j], law.terms.names[k]) for j, k in np.argwhere(law.support)]
    dimensions = dimensions_of(
        [named.get(key) for key, is_free in zip(keys, free, strict=True) if is_free],
        {name: units[name] for name in names if name in units},
    )
    table = PropertyTable(tuple(names), np.array(rows).reshape(len(related), len(names)), dimensions)
    inner, blocks = np.ix_(measured, free), np.ix_(measured, free, free)
    deviations = np.sqrt(np.diagonal(estimates.covariance, axis1=1, axis2=2)[inner])
    try:
        if (deviations.min(axis=0) < np.sqrt(np.finfo(float).eps) * deviations.max(axis=0)).any():
            raise np.linalg.LinAlgError("Rounding errors are as large as a variance")
        fitted = explain(estimates.coefficients[inner], estimates.covariance[blocks], table)
    except np.linalg.LinAlgError as error:
        raise CommonlawError(
            "relations-not-comparable", error=str(error).lower(), least=deviations.min(), most=deviations.max()
        ) from None
    values = estimates.coefficients.copy()
    covariance = np.where(measured[:, np.newaxis, np.newaxis], 0.0, estimates.covariance)
    factor = np.zeros((*values.shape, fitted.shared_factors.shape[2]))
    values[inner], factor[inner], covariance[blocks] = fitted.estimates, fitted.shared_factors, fitted.covariances
    relations: list[Relation | None] = [None] * len(free)
    choices = []
    for index, relation in zip(np.flatnonzero(free).tolist(), fitted.relations, strict=True):
        relations[index], (equation, term) = relation, keys[index]
        follows = " of ".join(filter(None, (str(relation.kind), dependence(relation))))
        choices.append(f"{term} in {equation}: {follows} ({relation.probability:.2g})")
    reason = f"largest evidence, with its posterior probability; offered: {', '.join(names) or 'no properties'}"
    explanation = Explanation(tuple(relations), fitted.factor_covariance)
    known = {"covariance": covariance, "shared_factor": factor, "unpooled": estimates, "explanation": explanation}
    result = _with_values(law, values, Step("relations", "; ".join(choices), reason), **known)
    if not measured.all():
        left_out = note("not-explained", objects=shown([*compress(law.objects, ~measured)], "object"))
        outcomes = (*(outcome for outcome in law.diagnostics if outcome.code != left_out.code), left_out)
        result = replace(result, provenance=replace(result.provenance, outcomes=outcomes))
    return replace(result, schema=replace(law.schema, units=units), properties=properties.values)


@checks_types
def contrasts(law: Law, by: str, reference: str | float | None = None, level: float = 0.95) -> "pd.DataFrame":
    """Return differences of parameters between groups of objects, such as treatments and a control.

    The estimate of object i with standard error s_i varies about the mean of its group with variance ``s_i^2 + tau^2``
    (random effects). The between-object variance tau^2 is estimated by Paule and Mandel (1982, J. Res. NBS 87, 377);
    means are weighted, and intervals of their differences use Student's t with the number of objects minus groups as
    degrees of freedom (Knapp and Hartung 2003). With equal standard errors this is the t test.

    Parameters
    ----------
    law
        With coefficients of each object.
    by
        A property of the objects with at least two values, and fewer values than objects.
    reference
        Value of the reference group; default: the first in order.
    level
        Probability of the intervals.

    Returns
    -------
    pandas.DataFrame
        A row for each parameter that objects do not share and each value but the reference: parameter, value,
        reference, difference, standard error, low, high, unit.

    Raises
    ------
    CommonlawError
        If there is no such property, it has one value or none twice, the law has no standard errors, or of a parameter
        of an object only a limit is known.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(drag=(-0.1, -0.11, -0.5, -0.52), noise=0.001)
    >>> hull = dict(zip(drops.objects, ["bare", "bare", "finned", "finned"]))
    >>> drops = drops.with_properties({name: {"hull": value} for name, value in hull.items()})
    >>> frame = cl.law.contrasts(cl.fit("x'' = -9.8 - c v", drops), "hull")
    >>> print(frame[["parameter", "value", "reference", "difference"]].round(2).to_string(index=False))
    parameter  value reference  difference
            c finned      bare         0.4
    """
    import pandas as pd
    from scipy.special import stdtrit

    names = property_names(law.properties)
    check_choice("property", by, names)
    # Pooled estimates depend on those of the other groups
    unpooled = law if law.uncertainty.unpooled is None else with_estimates(law, law.uncertainty.unpooled)
    groups = [law.properties.get(owner, {}).get(by) for owner in law.objects]
    if None in groups:
        raise CommonlawError("property-missing", object=law.objects[groups.index(None)], property=by)
    values = sorted(set(groups), key=lambda value: (str(type(value)), value))
    freedom = len(groups) - len(values)
    if len(values) < 2 or freedom < 1:
        raise CommonlawError("contrast-groups", property=by, groups=len(values), objects=len(groups))
    if reference is not None:
        check_choice(f"value of {by}", reference, values)
    base = values[0] if reference is None else reference
    inside = np.array([[group == value for value in values] for group in groups], dtype=np.float64)
    named, rows = named_parameters(unpooled), list[dict[str, object]]()
    shared = np.ptp(named_parameters(law).values, axis=0) == 0
    columns = zip(named.names, shared, named.values.T, named.errors.T, named.units, strict=True)
    for name, is_shared, estimates, errors, unit in columns:
        if is_shared or not errors.any():
            continue
        if limited := [limit.object for limit in law.uncertainty.limits if limit.parameter == name]:
            raise CommonlawError("contrast-with-limits", parameter=name, objects=limited)
        if not np.isfinite(errors).all():
            raise CommonlawError("contrast-without-errors", parameter=name)
        weights = 1 / (errors**2 + _between(estimates, errors, inside))
        totals = weights @ inside
        means = (weights * estimates) @ inside / totals
        residual = float(weights @ (estimates - inside @ means) ** 2) / freedom
        for value, mean, total in zip(values, means, totals, strict=True):
            if value != base:
                at = values.index(base)
                error = np.sqrt(max(residual, 1.0) * (1 / total + 1 / totals[at]))
                half = float(stdtrit(freedom, (1 + level) / 2)) * error
                difference = mean - means[at]
                row = {"parameter": name, "value": value, "reference": base, "difference": difference}
                row |= {"standard error": error, "low": difference - half, "high": difference + half, "unit": unit}
                rows.append(row)
    heads = ["parameter", "value", "reference", "difference", "standard error", "low", "high", "unit"]
    return pd.DataFrame(rows, columns=heads)


def comparable_groups(law: Law) -> dict[str, list[str | float]]:
    """Return the values of each property by which objects can be compared, two or more of a value on average."""
    result = dict[str, list[str | float]]()
    for name in property_names(law.properties) if shares_terms(law) else ():
        groups = [law.properties.get(owner, {}).get(name) for owner in law.objects]
        values = sorted({group for group in groups if group is not None}, key=lambda value: (str(type(value)), value))
        if None not in groups and 1 < len(values) <= len(groups) / 2:
            result[name] = values
    return result


def _between(estimates: Floats, errors: Floats, inside: Floats) -> float:
    """Return the variance between objects of one group, by Paule and Mandel; zero where errors explain the scatter."""
    from scipy.optimize import brentq

    freedom = int(len(estimates) - inside.shape[1])

    def excess(variance: float) -> float:
        weights = 1 / (errors**2 + variance)
        means = (weights * estimates) @ inside / (weights @ inside)
        return float(weights @ (estimates - inside @ means) ** 2) - freedom

    if excess(0.0) <= 0:
        return 0.0
    # At half of this the excess may be zero but for rounding
    largest = 2 * float(np.sum((estimates - estimates.mean()) ** 2))
    result: float = brentq(excess, 0.0, largest, xtol=1e-14 * largest, rtol=1e-12)
    return result
