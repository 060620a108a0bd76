"""Laws that are fitted by collocation: coefficients over terms, with free initial states."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.estimation.fitting import refused_settings
from commonlaw.estimation.profile import with_one_sided_limits
from commonlaw.inference import settings
from commonlaw.inference.diagnose.scale_origin import with_origin_outcomes
from commonlaw.inference.fit.convergence import apart, converged
from commonlaw.inference.fit.covariance import (
    fitted_law,
    joint_coefficients,
    residual_degrees_of_freedom,
    total_degrees_of_freedom,
)
from commonlaw.inference.fit.latent_initialization import latent_state_ranges
from commonlaw.inference.fit.misfit import with_misfit
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.nonlinear_parameters import empirical_priors
from commonlaw.inference.result.held_out_forecasts import best_forecaster, standardized_errors
from commonlaw.inference.result.history import (
    fit_steps,
    noise_step,
    outcomes_of_fit,
    outcomes_of_unmeasured,
    sample_steps,
    with_approximation,
    without_outcomes_of_fit,
)
from commonlaw.inference.search.error_models import choose_errors
from commonlaw.inference.search.law_search import choose_interpolation, fit_terms
from commonlaw.inference.search.setup import FitSetup, RefitOptions, error_kinds
from commonlaw.inference.verbs.chunks import fitted_by_parts, objects_apart, typical
from commonlaw.inference.verbs.parameter_bounds import is_near, is_within, refuse_outside
from commonlaw.inference.verbs.scheme import AbstractFit
from commonlaw.inference.verbs.shooting import ShootingFit
from commonlaw.law import Law, Step, pool_objects, select_objects
from commonlaw.law.parameters import (
    refuse_infinite,
    restrictions_of,
    shared_coefficients,
    shared_parameters,
    state_rates,
    with_equations,
)
from commonlaw.law.provenance import Domain
from commonlaw.law.uncertainty import ObjectEstimates
from commonlaw.library.bounds import bounds_in
from commonlaw.likelihood import Estimate, NotPositiveError, fit, linearize
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback, part, silent
from commonlaw.text import counted
from commonlaw.trials import Trials, TrialStream


@dataclass(frozen=True, eq=False)
class CollocationFit(AbstractFit):
    """A law of states that were measured; what collocation does not hold within bounds is fitted by shooting."""

    takes_rows_of_inputs = False
    law: Law

    @property
    def has_joint_objects(self) -> bool:
        return bool(shared_parameters(self.law))

    def refitted(
        self,
        trials: Trials,
        options: RefitOptions,
        progress: ProgressCallback,
        equations: Sequence[str] | None = None,
    ) -> Law:
        law, bounds = self.law, bounds_in(restrictions_of(self.law).bounds)
        result = refined(with_equations(law, equations) if equations else law, trials, options, progress)
        refused, of_law = refused_settings(options.changed), result.uncertainty.error_model.of_law
        if not is_within(result, bounds):
            if refused:
                refuse_outside(result, bounds, refused)
            return ShootingFit(result).refitted(trials, options, progress)
        if is_near(result, bounds) and not refused and not of_law:
            return ShootingFit(result).refitted(trials, options, progress)
        # Laws of a search have neither
        is_given = law.provenance.calls or law.provenance.equations
        return with_one_sided_limits(result, trials) if is_given and not equations else result

    def by_file(self, stream: TrialStream, options: RefitOptions, progress: ProgressCallback) -> Law:
        law = self.law
        if law.terms.parameters or law.schema.initial_values:
            what = "nonlinear parameters" if law.terms.parameters else "latent states"
            raise CommonlawError("not-refined-file-by-file", what=what)
        parts, known = stream.files, {*law.objects}
        light = replace(law, uncertainty=replace(law.uncertainty, shared_factor=None, unpooled=None, pooled=None))
        names = objects_apart(parts, part(progress, 0.0, 0.1))
        laws = [select_objects(light, name) if known.issuperset(name) else typical(law, name) for name in names]
        of_part = replace(options, partial_pooling=False)
        fits = [partial(refined, law_of_part, options=of_part, progress=silent) for law_of_part in laws]
        result = fitted_by_parts(fits, parts, part(progress, 0.1, 1.0), options.errors)
        step = Step("coefficients", counted(len(parts), "file"), "each object was fitted to its trials, file by file")
        provenance = replace(law.provenance, outcomes=(), history=(*law.history, step), domain=result.provenance.domain)
        pooled = pool_objects(replace(result, provenance=provenance), None, options.partial_pooling)
        refuse_outside(pooled, bounds_in(restrictions_of(law).bounds))
        return pooled

    def updated(self, trials: Trials) -> Law:
        known, law = self.law.uncertainty, self.law
        # What is not normal, weighted by solutions, or of several objects
        if known.error_model or known.limits or restrictions_of(law).bounds or shared_parameters(law):
            return ShootingFit(law).updated(trials)
        return _updated(law, trials)


def collocated(law: Law, trials: Trials, options: RefitOptions) -> Law:
    """Return a law with coefficients fitted by collocation under white noise, without their uncertainty.

    Raises `CommonlawError` as `refine` does.
    """
    setup = FitSetup.of(law, trials, options)
    setup.check_determined()
    estimates = fit_terms(setup).best.estimates
    return replace(setup.law, coefficients=np.array([estimate.coefficients for estimate in estimates]))


def refined(law: Law, trials: Trials, options: RefitOptions, progress: ProgressCallback) -> Law:
    """Return a law fitted to trials, whatever its bounds; objects that are pooled say where nonlinear parameters begin.

    Raises `CommonlawError` as `refine` does.
    """
    with threads(options.n_jobs):
        return _refined(law, trials, options, progress)


def _refined(law: Law, trials: Trials, options: RefitOptions, progress: ProgressCallback) -> Law:
    alike = options.partial_pooling
    setup = FitSetup.of(law, trials, options)
    error_kinds(options.errors, setup.trials.schema)  # Refused before the work
    setup.check_determined()
    progress("estimating noise, smoothing, fitting coefficients")
    if alike and setup.law.terms.parameters and not trials.schema.initial_values:
        setup = replace(setup, priors=empirical_priors(setup.problem(), setup.law.coefficients))
    pool, steps = choose_interpolation(
        lambda varied, _: fit_terms(replace(setup, trials=varied)),
        setup.trials,
        input_interpolation=setup.input_interpolation,
        progress=progress,
    )
    # Of few measurements the residuals do not show what kind of errors they have
    errors = "white" if options.errors == "auto" and pool.best.has_few_measurements else options.errors
    pool = choose_errors(pool, errors=errors, propose=lambda _: None, progress=progress)
    if pool.deterministic:
        errors_of_best = standardized_errors(pool.best, lambda law: law)
        pool, _ = best_forecaster(pool, errors_of_best, (), lambda law: law, progress)
    shared = shared_coefficients(setup.law)
    is_joint = bool(shared.any()) and len(pool.best.estimates) > 1
    fit, is_converged = converged(replace(pool.best, shared=shared if is_joint else None), options.least_squares)
    if not is_converged and fit.shared is not None:
        raise CommonlawError("parameters-not-identified", names=shared_parameters(law))
    problem = fit.problem
    if (
        not (problem.noise_given or problem.noise_is_identifiable)
        and total_degrees_of_freedom(residual_degrees_of_freedom(fit)) < 1
    ):
        count, name = sum(problem.measured), trials.schema.states[0]
        raise CommonlawError("no-degrees-of-freedom", measurements=count, name=name)
    schema = replace(setup.law.schema, input_interpolation=problem.trials.schema.input_interpolation)
    law, trials = replace(setup.law, schema=schema), setup.trials
    result = with_misfit(fitted_law(law, fit, options.covariance, options.seed), fit)
    chosen = *steps, *sample_steps(problem), *fit.steps, noise_step(problem), *fit_steps(fit)
    before = law.provenance.domain
    domain = Domain.of(trials, state_rates(law)).with_left_out(before)
    provenance = replace(
        law.provenance,
        outcomes=(
            *with_origin_outcomes(without_outcomes_of_fit(law.diagnostics), result, trials),
            *with_approximation(
                pool, outcomes_of_fit(result, fit, is_converged, tried_errors=options.errors == "auto")
            ),
            *outcomes_of_unmeasured(result, problem),
        ),
        history=(*law.history, *chosen),
        domain=replace(domain, visited={**domain.visited, **latent_state_ranges(problem.trials, fit.estimates)}),
    )
    pooled = pool_objects(replace(result, provenance=provenance), shared, alike)
    if fit.shared is not None:  # Pooling has rounding errors where coefficients are nearly collinear
        coefficients = np.where(shared | (not alike), joint_coefficients(fit), pooled.coefficients)
        pooled = replace(pooled, coefficients=coefficients)
    if fit.shared is not None and pooled.uncertainty.unpooled is not None:
        alone = fitted_law(law, apart(fit), options.covariance, options.seed)
        estimates = ObjectEstimates(alone.coefficients[:, alone.support], alone.uncertainty.known_covariance())
        pooled = replace(pooled, uncertainty=replace(pooled.uncertainty, unpooled=estimates))
    refuse_infinite(pooled)
    return pooled


def _updated(law: Law, trials: Trials) -> Law:
    """Return a law of white noise updated by trials of its objects, which may be chaotic."""
    threshold = law.uncertainty.huber_threshold
    setup = FitSetup.of(law, trials, RefitOptions(huber_threshold=threshold))
    before, trials = setup.law, setup.trials
    problem = prepare(trials, law.terms, before.coefficients, noise=law.uncertainty.noise, huber_threshold=threshold)
    covariances, coefficients = before.uncertainty.known_covariance().copy(), before.coefficients.copy()
    support, last = before.support, settings.FINAL_MODEL_ERRORS[-1]
    fixed = np.zeros(support.shape, dtype=np.bool_)
    # The prior is normal; the likelihood of the trials is that of linear regression, about the last coefficients
    for o, (model, start) in enumerate(zip(problem.models, problem.starts, strict=True)):
        prior_mean, prior, theta = coefficients[o][support], covariances[o], before.coefficients[o].copy()
        errors: tuple[float, ...] = (*settings.MODEL_ERRORS, *settings.FINAL_MODEL_ERRORS)
        estimate = Estimate(start.states, theta)
        for _ in range(settings.MAX_ITERATIONS):
            estimate = fit(model, replace(estimate, coefficients=theta.copy()), fixed, errors)
            errors, model = (last,), replace(model, observation=replace(model.observation, rejects=True))
            try:
                factor = linearize(model, estimate, last, support).problem.factor
            except NotPositiveError:
                raise CommonlawError("pooled-start-diverges", where=before.objects[o]) from None
            rows, target = factor[:-1, :-1], factor[:-1, -1]
            # By the gain, which takes coefficients that are known, without variance, as they are
            weighted = rows @ prior
            gain = np.linalg.solve(weighted @ rows.T + np.eye(len(rows)), weighted).T
            covariance = prior - gain @ weighted
            posterior_mean = prior_mean + gain @ (target - rows @ prior_mean)
            deviations = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
            change = np.abs(posterior_mean - theta[support])
            theta[support] = posterior_mean
            if np.all(change <= settings.CONVERGED * deviations):
                break
        coefficients[o], covariances[o] = theta, (covariance + covariance.T) / 2
    uncertainty = replace(
        before.uncertainty, covariance=covariances, shared_factor=None, unpooled=None, explanation=None, other_laws=()
    )
    return replace(
        before,
        coefficients=coefficients,
        uncertainty=uncertainty,
        properties=trials.properties,
    )
