"""From a law and trials to the function that its objects share in what the law leaves."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from commonlaw.discrepancy.function import Compared, Discrepancy
from commonlaw.discrepancy.setting import (
    CandidateFunction,
    Setting,
    candidates,
    descriptions,
    equations_of,
    expression,
    shares,
    with_known_properties,
)
from commonlaw.discrepancy.trajectories import FunctionFit, annealed, best, converged
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.covariance import errors_of
from commonlaw.law import Law, Provenance, Step, Uncertainty
from commonlaw.law.alignment import refuse_observation
from commonlaw.law.parameters import left_hand_sides
from commonlaw.law.script import call
from commonlaw.library import Terms
from commonlaw.library.notation import quoted
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.trials import Trials


def discrepancy(
    law: Law,
    trials: Trials,
    of: str | None = None,
    *,
    times: str = "1",
    equation: str | None = None,
    zero_at: float | str | None = "auto",
    noise: Mapping[str, float] | None = None,
    huber_threshold: float = HUBER_THRESHOLD,
) -> Discrepancy[Law]:
    """Return the smooth function of a coordinate that all objects share in addition to a law, see `Law.discrepancy`."""
    called = call(discrepancy, locals(), "law.discrepancy", "trials") + ".law"
    refuse_observation(law)
    if law.terms.parameters:
        inside = ", ".join(law.terms.variables.parameters)
        raise CommonlawError("discrepancy-with-parameters", parameters=inside)
    trials = with_known_properties(trials, law)
    setting = Setting.of(law, trials, [times, *([of] if of else [])], noise, huber_threshold)
    names = setting.law.terms.variables.names
    own = [of] if of else [quoted(name) for name in law.terms.variables.names]
    coordinates = [expression(each, names) for each in own]
    listed = candidates(setting, coordinates, expression(times, names), equations_of(setting, equation), zero_at)
    first = listed[0]
    setting = setting.resolving(first.basis)
    model = setting.with_function(first.basis, first.equation, zero_at)
    alone, shared = (annealed(setting.problem, each) for each in (setting.alone, model))
    law_alone, found = (converged(setting.problem, best(each)) for each in (alone, shared))
    # What the choice among several costs: all of them are as probable beforehand
    evidence = law_alone.value - found.value - 2 * float(np.log(len(listed)))
    visited = setting.visited.evaluate(first.basis.coordinate)
    left = left_hand_sides(law)
    return Discrepancy(
        law=_refitted(law, setting, found, first, called),
        equation=left[first.equation],
        basis=first.basis,
        weights=found.posterior.weights,
        covariance=found.posterior.covariance,
        zero_at=model.zero_at,
        holds_nothing_of=tuple(setting.law.terms.names[i] for i in model.held),
        visited=visited,
        evidence=evidence,
        shares=shares(setting.problem, setting.law.coefficients, alone, shared, found),
        descriptions=descriptions(found, first.basis, visited),
        compared=tuple(
            Compared(each.basis.coordinate, left[each.equation], evidence + first.value - each.value) for each in listed
        ),
    )


def _refitted(law: Law, setting: Setting, found: FunctionFit, chosen: CandidateFunction, called: str) -> Law:
    """Return the law with coefficients as they are with the function, which it carries."""
    own, posterior = law.select(setting.problem.trials.objects), found.posterior
    whole = _whole(law, setting, found)
    size, wide = setting.law.terms, found.model.terms
    shape = (len(law.schema.states), len(wide))
    in_law = np.zeros(shape, dtype=np.bool_)
    in_law[:, : len(size)] = setting.law.support
    coefficients = own.coefficients.copy()
    coefficients[:, own.support] = whole.coefficients[:, in_law]
    inner = in_law[whole.support]
    uncertainty = whole.uncertainty.restrict(inner)
    step = Step(
        "discrepancy",
        f"a function of {chosen.basis.coordinate} in {left_hand_sides(law)[chosen.equation]}",
        f"coefficients estimated jointly with it; noise scaled by {posterior.noise_factor:.3g}",
    )
    return replace(
        own,
        coefficients=coefficients,
        uncertainty=replace(uncertainty, inclusion_probabilities=own.uncertainty.inclusion_probabilities),
        provenance=replace(
            law.provenance,
            history=(*law.history, step),
            calls=(*law.provenance.calls, called),
            with_discrepancy=whole,
        ),
    )


def _whole(law: Law, setting: Setting, found: FunctionFit) -> Law:
    """Return the law with the functions as further terms."""
    problem, model, posterior = setting.problem, found.model, found.posterior
    objects, terms = problem.trials.objects, Terms(setting.law.terms.variables, model.terms.terms)
    coefficients = np.array([each.coefficients for each in found.estimates])
    coefficients[:, model.own], coefficients[:, model.shared] = posterior.coefficients, posterior.weights
    support = np.any(coefficients != 0, axis=0)
    order = np.concatenate([np.flatnonzero(model.own), np.flatnonzero(model.shared)])
    factor = posterior.shared_factor
    shared = np.zeros((len(objects), support.size, factor.shape[1]))
    shared[:, order] = np.concatenate([posterior.follow @ factor, np.tile(factor, (len(objects), 1, 1))], axis=1)
    covariance = shared @ shared.transpose(0, 2, 1)
    own = np.flatnonzero(model.own)
    covariance[:, own[:, np.newaxis], own] += posterior.own_covariance
    kept = support.ravel()
    uncertainty = Uncertainty(
        covariance=covariance[:, kept][:, :, kept],
        shared_factor=shared[:, kept],
        noise=posterior.noise_factor * problem.noise,
        error_model=errors_of(problem, posterior.noise_factor * found.model_error if found.has_model_error else 0.0),
    )
    schema, provenance = setting.law.schema, Provenance(law.provenance.differentiation, domain=law.provenance.domain)
    return Law(terms, schema, law.order, objects, coefficients, uncertainty, provenance, setting.law.properties)
