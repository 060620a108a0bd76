"""Coefficients of an object of which few samples are known, by these and by what other objects say of it."""

from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast.population import with_objects_of
from commonlaw.inference import settings
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.search.setup import FitSetup
from commonlaw.law import Law, Step
from commonlaw.law.alignment import matched, refuse_observation
from commonlaw.likelihood import Estimate, NotPositiveError, TrajectoryModel, fit, linearize
from commonlaw.trials import Trials


def adapt(law: Law, trials: Trials) -> Law:
    """Return the law of the objects of these trials, their coefficients updated by them, see `Law.update`."""
    refuse_observation(law)
    law.uncertainty.known_covariance()
    if law.uncertainty.noise is None or law.uncertainty.error_model:
        lacks = "has errors other than white noise" if law.uncertainty.noise is not None else "has no noise estimate"
        raise CommonlawError("weights-unknown", lacking=lacks)
    trials = matched(law, trials)
    setup = FitSetup.of(with_objects_of(law, trials)[0], trials)
    before, trials = setup.law, setup.trials
    problem = prepare(trials, law.terms, before.coefficients, noise=law.uncertainty.noise)
    coefficients, covariances = before.coefficients.copy(), np.zeros_like(before.uncertainty.known_covariance())
    for o, (model, start) in enumerate(zip(problem.models, problem.starts, strict=True)):
        coefficients[o][law.support], covariances[o] = _posterior(model, start, before, o)
    uncertainty = replace(
        before.uncertainty, covariance=covariances, shared_factor=None, unpooled=None, explanation=None, other_laws=()
    )
    step = Step(
        "adaptation",
        f"{len(trials)} trials",
        "coefficients estimated from these trials, with the other objects as prior",
    )
    return replace(
        before,
        coefficients=coefficients,
        uncertainty=uncertainty,
        properties=trials.properties,
        provenance=replace(law.provenance, history=(*law.history, step)),
    )


def _posterior(model: TrajectoryModel, start: Estimate, law: Law, index: int) -> tuple[Floats, Floats]:
    """Return the coefficients in the law's support of one object, and their covariance.

    Those beforehand are normal; the likelihood of the trials is that of linear regression, about the last coefficients.
    """
    name, support = law.objects[index], law.support
    expected = law.coefficients[index][support]
    spread = law.uncertainty.known_covariance()[index]
    own, last, estimate = expected, settings.FINAL_MODEL_ERRORS[-1], Estimate(start.states, law.coefficients[index])
    for _ in range(settings.MAX_ITERATIONS):
        whole = np.zeros(support.shape)
        whole[support] = own
        errors = (*settings.MODEL_ERRORS, *settings.FINAL_MODEL_ERRORS) if own is expected else (last,)
        estimate = fit(model, replace(estimate, coefficients=whole), np.zeros(support.shape, dtype=np.bool_), errors)
        try:
            factor = linearize(model, estimate, last, support).problem.factor
        except NotPositiveError:
            raise CommonlawError("pooled-start-diverges", where=name) from None
        rows, target = factor[:-1, :-1], factor[:-1, -1]
        # By the gain, which takes coefficients that are known, without variance, as they are
        weighted = rows @ spread
        gain = np.linalg.solve(weighted @ rows.T + np.eye(len(rows)), weighted).T
        covariance = spread - gain @ weighted
        found = expected + gain @ (target - rows @ expected)
        deviations = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        converged, own = bool(np.all(abs(found - own) <= settings.CONVERGED * deviations)), found
        if converged:
            break
    return own, (covariance + covariance.T) / 2
