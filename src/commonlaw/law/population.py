"""Objects that a law has never seen, as drawn from the same population as those that it knows."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite import hermgauss

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.hierarchy import Relation
from commonlaw.law import average_law, pool_objects, select_objects
from commonlaw.law.law import Law, object_index, with_other_laws
from commonlaw.law.objects import with_estimates
from commonlaw.law.parameters import named_parameters, standard_errors
from commonlaw.law.quantiles import mixture_interval, two_sided
from commonlaw.law.uncertainty import ObjectEstimates
from commonlaw.trials import Schema, Trials
from commonlaw.trials.trial import Property, property_names
from commonlaw.trials.units import Conversion


class Population(NamedTuple):
    """Coefficients of objects, shape (objects, equations, terms), and covariances, where they are known; a remark."""

    coefficients: Floats
    covariances: Floats | None
    note: str


def with_pooled_forecasts(law: Law, shared: Bools, others: bool) -> Law:
    """Return the law of each object's own coefficients, but for shared ones, that forecasts by pooled ones.

    Pooled coefficients have the smaller mean square error over objects, and intervals by each object's own trials hold
    the truth where the population is not as pooling takes it (Efron and Morris 1971).

    Parameters
    ----------
    law
        Whose objects do not depend on each other.
    shared, others
        See `commonlaw.law.pool_objects`.
    """
    pooled = pool_objects(law, shared, False)
    drawn = pool_objects(law, shared, True) if others else pooled
    if not others or drawn.uncertainty.unpooled is None:
        return pooled
    estimates = ObjectEstimates(drawn.coefficients[:, law.support], drawn.uncertainty.known_covariance())
    return replace(pooled, uncertainty=replace(pooled.uncertainty, pooled=estimates), provenance=drawn.provenance)


def with_objects_of(law: Law, trials: Trials) -> tuple[Law, tuple[str, ...]]:
    """Return the law of the objects of these trials, and a remark on each that it does not know.

    Coefficients of known objects are the pooled ones, if it has them. Those of others follow the relations, if
    `Law.explain` found them and the properties that they take are there; else an object has those of the typical one.
    How far objects stray from that is in the covariance.

    Raises `CommonlawError` if a property cannot be what a relation takes.
    """
    known_objects = {*law.objects}
    unseen = [name for name in trials.objects if name not in known_objects]
    drawn = [_with_properties(law, name, trials, _drawn(law, name, trials)) for name in unseen]
    law = _by_pooled(law)
    if not unseen:
        return law, ()
    seen = [name for name in trials.objects if name in known_objects]
    indices = [object_index(law, name) for name in seen]
    known = law.uncertainty.covariance
    covariance = None
    if known is not None:
        covariance = np.array([*known[indices], *(population.covariances for population in drawn)])
    result = replace(
        law,
        objects=(*seen, *unseen),
        coefficients=np.array([*law.coefficients[indices], *(population.coefficients for population in drawn)]),
        uncertainty=replace(
            law.uncertainty,
            covariance=covariance,
            shared_factor=None,
            unpooled=None,
            pooled=None,
            explanation=None,
            other_laws=law.uncertainty.map_other_laws(lambda plausible: with_objects_of(plausible, trials)[0]),
        ),
        properties={},
    )
    return result, tuple(population.note for population in drawn)


def _by_pooled(law: Law) -> Law:
    pooled = law.uncertainty.pooled
    if pooled is None:
        return law
    return with_other_laws(with_estimates(law, pooled), law.uncertainty.map_other_laws(_by_pooled))


def is_typical(law: Law, name: str, trials: Trials) -> bool:
    """Whether a law takes an object for the typical one: it does not know it, nor what relations take."""
    return name not in law.objects and (law.uncertainty.explanation is None or bool(_unknown(law, name, trials)))


def _unknown(law: Law, name: str, trials: Trials) -> list[str]:
    values = trials.properties.get(name, {})
    wanted = law.uncertainty.explanation.properties if law.uncertainty.explanation else ()
    return [attribute for attribute in wanted if not isinstance(values.get(attribute), float)]


def _drawn(law: Law, name: str, trials: Trials) -> Population:
    """Return what is known of the coefficients of an object that the law has not seen."""
    if is_typical(law, name, trials):
        missing = _unknown(law, name, trials)
        why = f", as its {' and '.join(missing)} is not known" if missing else ""
        return _typical(law, f"{name} is not in the law: it has the mean coefficients of the others{why}")
    explanation, values = law.uncertainty.explanation, trials.properties.get(name, {})
    assert explanation is not None
    given = {key: _in_unit(key, values[key], trials.schema, law.schema) for key in explanation.properties}
    coefficients, indices = law.coefficients[0].copy(), np.argwhere(law.support)
    covariance = explanation.covariance
    turn, scatter = np.zeros((len(indices), len(covariance))), np.zeros(len(indices))
    first = 0
    for i, relation in enumerate(explanation.relations):
        if relation is not None:
            part = slice(first, first + len(relation.factors))
            numbers = [given[attribute] for attribute in relation.properties]
            for property_name, value in zip(relation.properties, numbers, strict=True):
                if relation.exponents and not value > 0:
                    raise CommonlawError("property-not-positive", property=property_name, object=name, value=value)
            columns = relation.columns(np.array([numbers]).reshape(1, -1))[0]
            mean, share, scatter[i] = _moments(relation, float(columns @ relation.factors))
            coefficients[tuple(indices[i])], turn[i, part], first = mean, share * columns, part.stop
    followed = f"that follow from its {' and '.join(given)}" if given else "of the typical object"
    total = turn @ covariance @ turn.T + np.diag(scatter)
    return Population(coefficients, total, f"{name} is not in the law: it has the coefficients {followed}")


def _with_properties(law: Law, name: str, trials: Trials, drawn: Population) -> Population:
    """Return the same with the object's own properties where these stand in the equations of the law."""
    known, given = property_names(law.properties) if law.provenance.equations else [], trials.properties.get(name, {})
    errors, places = standard_errors(law), [*map(tuple, np.argwhere(law.support).tolist())]
    coefficients, covariances, taken = drawn.coefficients.copy(), drawn.covariances, list[str]()
    for product in named_parameters(law).products:
        names, place = [attribute for attribute, _ in product.coefficients], (product.equation, product.term)
        if not names or not all(attribute in known for attribute in names) or np.any(errors[:, *place] > 0):
            continue
        for attribute in names:
            if not isinstance(given.get(attribute), float):
                raise CommonlawError("property-missing", object=name, property=attribute)
        values = {key: np.asarray(_in_unit(key, given[key], trials.schema, law.schema)) for key in names}
        coefficients[place] = product.value(values)
        taken += [attribute for attribute in names if attribute not in taken]
        if covariances is not None:
            covariances = covariances.copy()
            covariances[places.index(place)] = covariances[:, places.index(place)] = 0.0
    note = f"{drawn.note}, and its own {' and '.join(taken)}" if taken else drawn.note
    return Population(coefficients, covariances, note)


def _moments(relation: Relation, value: float) -> tuple[float, float, float]:
    """Return mean of a coefficient over objects, how it goes with the value that is typical, and its variance.

    The variance is that of a normal distribution whose 95 % band is the coefficient's.
    """
    spread = _spread(relation)
    if not relation.relative:
        size = value / (relation.factors[0] * relation.typical) if relation.exponents else 1.0
        return value, 1.0, (spread * size) ** 2
    variance = relation.scatter**2 + relation.scatter_error**2
    share = float(np.exp(variance / 2))
    return share * value, share, (share * value) ** 2 * float(np.expm1(spread**2))


def _spread(relation: Relation) -> float:
    """Return half of the band that holds 95 % of all objects, in standard deviations of a normal distribution.

    The scatter is known from few objects, with an error that is normal in its logarithm: tails are long.
    """
    if not relation.scatter:
        return relation.scatter_error
    nodes, weights = hermgauss(20)
    deviation = np.sqrt(np.log1p((relation.scatter_error / relation.scatter) ** 2))
    scales = relation.scatter * np.exp(np.sqrt(2) * deviation * nodes)
    _, high = mixture_interval(weights / weights.sum(), np.zeros_like(scales), scales, np.inf, 0.95)
    return float(high / two_sided(0.95))


def _typical(law: Law, note: str) -> Population:
    """Return the mean coefficients; the scatter of the objects, and of their mean, is added to its covariance.

    They are those of the population (random effects), which errors of single objects neither move nor widen. The fewer
    objects there are, the more is added (Student's t, for the 95 % band).
    """
    if law.uncertainty.covariance is not None and law.uncertainty.unpooled is None:
        law = pool_objects(with_other_laws(law, ()))
        factor = law.uncertainty.shared_factor
        if factor is not None:  # Objects without information keep their own, see `pooled`
            law = select_objects(law, [law.objects[i] for i in np.flatnonzero(factor.any(axis=(1, 2)))])
    mean, count = average_law(law), len(law.objects)
    covariance = mean.uncertainty.covariance
    if covariance is None or count == 1:
        return Population(mean.coefficients[0], covariance if covariance is None else covariance[0], note)
    widened = (1 + 1 / count) * float(two_sided(0.95, count - 1) / two_sided(0.95)) ** 2
    coefficients = law.coefficients[:, law.support]
    scatter = widened * np.cov(coefficients, rowvar=False).reshape(coefficients.shape[1], coefficients.shape[1])
    return Population(mean.coefficients[0], covariance[0] + scatter, note)


def _in_unit(name: str, value: Property, given: Schema, wanted: Schema) -> float:
    turn = Conversion.between(f"property {name!r}", given.units.get(name), wanted.units.get(name))
    return float(turn.scale * float(value) + turn.offset)
