"""Laws of some of the objects of a law, of their mean, or with other coefficients of each."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.law.law import Law, object_index
from commonlaw.law.parameters import named_parameters
from commonlaw.law.uncertainty import ObjectEstimates, OneSidedLimit, PlausibleLaw, Uncertainty
from commonlaw.runtime.arguments import checks_types


@checks_types
def select_objects(law: Law, objects: Sequence[str]) -> Law:
    """Return the law of a subset of the objects.

    Raises `CommonlawError` if there is no such object.

    Examples
    --------
    >>> import commonlaw as cl
    >>> law = cl.Law.from_text("T' = -k T", {"k": {"cup": 0.1, "mug": 0.05}})
    >>> cl.law.select_objects(law, ["mug"])
    <Law of mug: T' = -k T>
    """
    indices = [object_index(law, name) for name in objects]
    others = law.uncertainty.map_other_laws(lambda plausible: select_objects(plausible, objects))
    return _of_others(law, tuple(objects), law.coefficients[indices], law.uncertainty.select(indices), others)


@checks_types
def average_law(law: Law) -> Law:
    """Return the law of one object, "average", whose coefficients are the means over all objects.

    Their covariance is that of the mean of independent objects, or of partially pooled ones if the law is pooled. Where
    some objects have only a limit of a parameter, the mean has that of the ends of all intervals.

    Examples
    --------
    >>> import commonlaw as cl
    >>> law = cl.Law.from_text("T' = -k T", {"k": {"cup": 0.1, "mug": 0.05}})
    >>> cl.law.average_law(law).equations()
    ("T' = -0.075 T",)
    """
    mean = law.coefficients.mean(axis=0, keepdims=True)
    others = law.uncertainty.map_other_laws(average_law)
    known = replace(law.uncertainty.average(), limits=tuple(_mean_limits(law)))
    return _of_others(law, ("average",), mean, known, others)


def _mean_limits(law: Law) -> Iterator[OneSidedLimit]:
    """Yield limits of the mean over objects of parameters of which some objects have only a limit."""
    parameters = named_parameters(law)
    for p, name in enumerate(parameters.names):
        for end, is_lower in zip(parameters.intervals(), (True, False), strict=True):
            if parameters.limited[:, p].any() and np.isfinite(value := end[:, p].mean()):
                yield OneSidedLimit("average", name, float(value), is_lower)


def _of_others(
    law: Law,
    objects: tuple[str, ...],
    coefficients: Floats,
    uncertainty: Uncertainty,
    other_laws: tuple[PlausibleLaw[Law], ...],
) -> Law:
    """Return a law of other objects, their uncertainty still that of all terms in the law."""
    kept = np.any(coefficients != 0, axis=0)[law.support]
    return replace(
        law,
        objects=objects,
        coefficients=coefficients,
        uncertainty=replace(uncertainty.restrict(kept), other_laws=other_laws),
        properties={name: law.properties[name] for name in objects if name in law.properties},
    )


def with_estimates(law: Law, estimates: ObjectEstimates) -> Law:
    """Return a law with these coefficients, of objects that do not depend on each other."""
    coefficients = law.coefficients.copy()
    coefficients[:, law.support] = estimates.coefficients
    known = replace(law.uncertainty, covariance=estimates.covariance, shared_factor=None, pooled=None)
    return replace(law, coefficients=coefficients, uncertainty=known)


def of_all_objects(laws: Sequence[Law]) -> tuple[Floats, Floats]:
    """Return coefficients and covariances of the objects of several laws with the same terms, one law after another.

    They have the shapes (objects, equations, terms) and (objects, parameters, parameters).
    """
    coefficients = np.concatenate([law.coefficients for law in laws])
    support, covariances = np.any(coefficients != 0, axis=0), list[Floats]()
    for law in laws:
        known, inner = law.uncertainty.known_covariance(), np.flatnonzero(law.support[support])
        covariances.append(np.zeros((len(known), support.sum(), support.sum())))
        covariances[-1][:, inner[:, np.newaxis], inner] = known
    return coefficients, np.concatenate(covariances)
