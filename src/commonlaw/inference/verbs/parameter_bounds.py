"""Bounds of the parameters of a law that is fitted object by object."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.diagnostics import Outcome
from commonlaw.errors import CommonlawError
from commonlaw.estimation.fitting import estimate_at_bound
from commonlaw.law import Law, Uncertainty, select_objects
from commonlaw.law.objects import of_all_objects
from commonlaw.law.parameters import named_parameters, standard_errors
from commonlaw.law.text import with_error
from commonlaw.library.bounds import Bound
from commonlaw.trials import Trials


def outside(law: Law, bounds: Sequence[Bound]) -> Iterator[CommonlawError]:
    """Yield errors for parameters outside of their bounds, pooled or by the object alone."""
    unpooled, coefficients, parameters = law.uncertainty.unpooled, law.coefficients.copy(), named_parameters(law)
    if unpooled is not None:
        coefficients[:, law.support] = unpooled.coefficients
    for bound in bounds:
        index = parameters.names.index(bound.name)
        values, errors = parameters.values[:, index], parameters.errors[:, index]
        definition = next(definition for definition in parameters.definitions if definition.name == bound.name)
        for name, value, error, alone in zip(law.objects, values, errors, coefficients, strict=True):
            outside = next((estimate for estimate in (value, definition.of(alone)) if not bound.holds(estimate)), None)
            if outside is not None:
                shown = with_error(value, np.nan_to_num(error)) if outside == value else f"{outside:.3g}, by itself"
                yield _out_of_bounds(name, bound, shown)


def _out_of_bounds(owner: str, bound: Bound, value: str) -> CommonlawError:
    return CommonlawError("estimate-out-of-bounds", name=owner, parameter=bound.name, value=value, bound=bound.text)


def within_bounds(law: Law, bounds: Sequence[Bound]) -> Law:
    for error in outside(law, bounds):
        raise error
    return law


def released(law: Law, bounds: Sequence[Bound]) -> Law:
    """Return a law whose bounded parameters are all to be estimated, also those that were held at a bound.

    Those that are zero begin at 1.
    """
    known, is_bounded, names = law.uncertainty, np.zeros_like(law.support), {bound.name for bound in bounds}
    if known.covariance is None:
        return law
    for definition in named_parameters(law).definitions:
        for part in definition.parts if definition.name in names else ():
            is_bounded[part.equation, part.term] = True
    support = law.support | is_bounded
    before = np.flatnonzero(law.support[support])
    covariance = np.zeros((len(law.objects), int(support.sum()), int(support.sum())))
    covariance[:, before[:, np.newaxis], before] = known.covariance
    held = is_bounded[support] & (np.diagonal(covariance, axis1=1, axis2=2) == 0)
    covariance += held[:, :, np.newaxis] * np.eye(held.shape[1])
    return replace(
        law,
        coefficients=np.where(is_bounded & (law.coefficients == 0), 1.0, law.coefficients),
        uncertainty=replace(
            known, covariance=covariance, shared_factor=None, unpooled=None, pooled=None, explanation=None
        ),
    )


def at_bounds(begun: Law, trials: Trials, bounds: Sequence[Bound], fit: Callable[[Law, Trials], Law]) -> Law:
    """Return the fit of a law to each object, with coefficients that are outside of their bounds at these.

    An active set, object by object: what is at a bound is known there, and others are fitted again. Coefficients that
    are quotients or products of what stands before several terms stay as they are. Nothing is pooled.
    """
    law = fit(replace(begun, restrictions=None), trials)
    parts, outcomes = list[Law](), list[Outcome]()
    for owner in law.objects:
        start = alone = select_objects(law, [owner])
        coefficients, is_free = start.coefficients.copy(), start.support & (standard_errors(start) != 0)
        definitions = {definition.name: definition.parts for definition in named_parameters(start).definitions}
        held = {name for name, of_name in definitions.items() if len(of_name) > 1}
        while True:
            parameters, before = named_parameters(alone), len(held)
            for bound in (bound for bound in bounds if bound.name not in held):
                at, (part,) = parameters.names.index(bound.name), definitions[bound.name]
                value, error = float(parameters.values[0, at]), float(parameters.errors[0, at])
                if bound.holds(np.array(value)):
                    continue
                end = bound.low if value < bound.low else bound.high
                if end == 0 and part.power < 0:  # It is divided by: zero has no best fit
                    raise _out_of_bounds(owner, bound, f"{value:.3g}")
                degrees, is_low = float(parameters.degrees_of_freedom[0, at]), end == bound.low
                outcomes.append(estimate_at_bound(owner, bound.name, end, is_low, value, error, bound.text, degrees))
                coefficients[:, part.equation, part.term] = part.factor * end ** float(part.power)
                is_free[:, part.equation, part.term] = False
                held.add(bound.name)
            if len(held) == before:
                break
            is_inside = is_free[:, np.any(coefficients != 0, axis=0)]
            uncertainty = Uncertainty(is_inside[:, :, np.newaxis] * np.eye(is_inside.shape[1]))
            held_there = replace(start, coefficients=coefficients.copy(), uncertainty=uncertainty)
            alone = fit(held_there, trials.select(object=[owner]))
        parts.append(alone)
    coefficients, covariance = of_all_objects(parts)
    known, provenance = law.uncertainty, law.provenance
    if len(parts) == 1:
        known, provenance = parts[0].uncertainty, parts[0].provenance
    return replace(
        law,
        coefficients=coefficients,
        uncertainty=replace(known, covariance=covariance),
        provenance=replace(provenance, outcomes=(*provenance.outcomes, *outcomes)),
        restrictions=begun.restrictions,
    )
