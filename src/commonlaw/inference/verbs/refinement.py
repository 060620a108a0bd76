"""From a law whose terms are known to coefficients: by all that was measured, or by few samples and other objects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from commonlaw.diagnostics import Outcome, note
from commonlaw.errors import CommonlawError
from commonlaw.estimation.fitting import checked_errors, refit, refused_settings, threshold_of, updated
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
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.nonlinear_parameters import empirical_priors
from commonlaw.inference.result.approximation import choose_deterministic, with_approximation
from commonlaw.inference.result.history import (
    fit_steps,
    noise_step,
    outcomes_of_fit,
    outcomes_of_unmeasured,
    sample_steps,
    without_outcomes_of_fit,
)
from commonlaw.inference.search.error_models import choose_errors
from commonlaw.inference.search.law_search import choose_interpolation, fit_terms
from commonlaw.inference.search.setup import FitSetup, error_kinds
from commonlaw.inference.verbs.chunks import fitted_by_parts, typical
from commonlaw.inference.verbs.parameter_bounds import is_within, refuse_outside
from commonlaw.law import Law, Step, pool_objects, select_objects
from commonlaw.law.alignment import matched
from commonlaw.law.parameters import (
    refuse_infinite,
    restrictions_of,
    shared_coefficients,
    shared_parameters,
    state_rates,
    with_equations,
)
from commonlaw.law.population import with_objects_of
from commonlaw.law.provenance import Domain
from commonlaw.law.script import call
from commonlaw.law.uncertainty import ObjectEstimates
from commonlaw.library.bounds import bounds_in
from commonlaw.likelihood import HUBER_THRESHOLD, Estimate, NotPositiveError, fit, linearize
from commonlaw.likelihood.levels import over_decades, refuse_over_decades
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.fit_options import (
    CovarianceKind,
    ErrorKind,
    FitOptions,
    changed_settings,
    check_settings,
    settings_of,
)
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback, on_terminal, part, silent
from commonlaw.text import counted
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.stream import in_memory_or_by_file, objects_of_parts

if TYPE_CHECKING:
    from distributed import Client


def refine(
    law: Law,
    trials: Trials | TrialStream,
    *,
    log_states: Sequence[str] | None = None,
    input_interpolation: str | None = None,
    noise: Mapping[str, float] | None = None,
    errors: ErrorKind | Literal["auto"] = "auto",
    huber_threshold: float = FitOptions.huber_threshold,
    covariance: CovarianceKind = "likelihood",
    partial_pooling: bool = False,
    seed: int = 0,
    n_jobs: int = -1,
    progress: ProgressCallback | None = None,
    client: "Client | None" = None,
) -> Law:
    """Refit the coefficients of a law to trials by maximum likelihood.

    The terms are fixed; the law gets standard errors. Initial states are free, the law may be chaotic, and values may
    be missing (multiple shooting with a shot for each step, see `commonlaw.likelihood`). A law with observation
    equations keeps these, its given initial values, shared parameters, priors and bounds, and is fitted as by
    `commonlaw.fit`.

    Parameters
    ----------
    law
        A law of order 1 or 2. Coefficients with a standard error of zero are fixed.
    trials
        Measurements of objects of the law. A stream is fitted file by file, by default with white noise of a separate
        level for each file; objects that are not in the law start from its mean coefficients.
    log_states, input_interpolation, noise, errors, huber_threshold, covariance, partial_pooling, seed, n_jobs
        See `FitOptions`; the defaults of `log_states` and `input_interpolation` are those of the law.
    progress
        Called with the text of each step. Default: the terminal shows it after two seconds.
    client
        A dask client whose workers fit the files of a stream.

    Returns
    -------
    Law
        The law of the objects in the trials.

    Raises
    ------
    CommonlawError
        If the law is in discrete time, its objects do not share their terms, an object or variable is not in it, a
        setting or trial cannot be used, or the measurements do not determine a parameter.

    See Also
    --------
    fit : Fit given equations.
    Law.update : Use the law as prior of its coefficients.

    Examples
    --------
    >>> import commonlaw as cl
    >>> from commonlaw.law import average_law
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> method = cl.DerivativeRegression(differentiation="savgol:25:3", solver="group-stlsq:1.5")
    >>> law = cl.discover(drops, order=2, library="poly:1", method=method)
    >>> print(average_law(cl.refine(law, drops)))
    x'' = -9.835 ± 0.046 - (0.3830 ± 0.0042) v
    <BLANKLINE>
    with v = x'
    """
    given = locals()
    check_settings("refine", given)
    check_types(refine, given)
    known = {name: given[name] for name in settings_of(FitOptions, "refine")}
    calls = (*law.provenance.calls, call(refine, given, "cl.refine", "law", "trials"))
    progress = on_terminal() if progress is None else progress
    bounds = bounds_in(restrictions_of(law).bounds)

    def in_memory(trials: Trials) -> Law:
        scale = law.observation.measured.logarithmic if log_states is None else log_states
        refuse_over_decades(trials, errors, noise, scale)
        is_open = errors == "auto" and noise is None and not scale and law.order == 1
        lost = [*over_decades(trials)] if is_open else []
        notes = (note("small-values-without-weight", states=lost),) if lost else ()
        if law.scheme == "shooting":
            return noted(_of_observation(law, trials, known, calls, progress), notes)
        result = refined(law, trials, **known, progress=progress)
        if not is_within(result, bounds):
            if refused := refused_settings(changed_settings("refine", known)):
                refuse_outside(result, bounds, refused)
            return noted(_of_observation(result, trials, known, calls, progress), notes)
        result = noted(replace(result, provenance=replace(result.provenance, calls=calls)), notes)
        # Laws of a search have neither
        return with_one_sided_limits(result, trials) if law.provenance.calls or law.provenance.equations else result

    def by_file(stream: TrialStream) -> Law:
        kind = "white" if errors == "auto" else errors
        how = _Fit(log_states, input_interpolation, noise, kind, errors == "white", huber_threshold, covariance, seed)
        result = _by_parts(law, stream, how, progress)
        domain, history = result.provenance.domain, result.provenance.history
        provenance = replace(law.provenance, outcomes=(), history=history, calls=calls, domain=domain)
        pooled = pool_objects(replace(result, provenance=provenance), None, partial_pooling)
        refuse_outside(pooled, bounds)
        return pooled

    return in_memory_or_by_file(trials, client, in_memory, by_file)


def noted(law: Law, outcomes: tuple[Outcome, ...]) -> Law:
    """Return a law with more notes, after those that it has."""
    return replace(law, provenance=replace(law.provenance, outcomes=(*law.provenance.outcomes, *outcomes)))


def with_other_equations(law: Law, trials: Trials, equations: Sequence[str], noise: Mapping[str, float]) -> Law:
    """Return the law of other equations, fitted to trials under the errors of a law, whose estimates are first values.

    Restrictions are those of the law, and some noise may be known. Raises `CommonlawError` as `refine` does.
    """
    if law.scheme == "shooting":
        return refit(law, trials, equations=equations, noise=noise, progress=silent).law(())
    result = refined(
        with_equations(law, equations),
        trials,
        log_states=None,
        input_interpolation=None,
        noise=noise or None,
        errors=law.uncertainty.error_model.kind,
        huber_threshold=HUBER_THRESHOLD,
        covariance="likelihood",
        partial_pooling=False,
        seed=0,
        n_jobs=-1,
        progress=silent,
    )
    if not is_within(result, bounds_in(restrictions_of(law).bounds)):
        return refit(result, trials, noise=noise, progress=silent).law(())
    return result


def refined(
    law: Law,
    trials: Trials,
    *,
    log_states: Sequence[str] | None,
    input_interpolation: str | None,
    noise: Mapping[str, float] | None,
    errors: ErrorKind | Literal["auto"],
    huber_threshold: float,
    covariance: CovarianceKind,
    partial_pooling: bool,
    seed: int,
    n_jobs: int,
    progress: ProgressCallback | None,
) -> Law:
    """Return a law fitted as by `refine`, but for its bounds and limits on one side."""
    how = _Fit(log_states, input_interpolation, noise, errors, errors == "white", huber_threshold, covariance, seed)
    with threads(n_jobs):
        return how.refined(law, trials, partial_pooling, on_terminal() if progress is None else progress)


def collocated(law: Law, trials: Trials, log_states: Sequence[str] | None, input_interpolation: str) -> Law:
    """Return a law with coefficients fitted by collocation under white noise, without their uncertainty.

    Raises `CommonlawError` as `refine` does.
    """
    setup = FitSetup.of(law, trials, input_interpolation=input_interpolation, log_states=log_states)
    setup.check_determined()
    estimates = fit_terms(setup).best.estimates
    return replace(setup.law, coefficients=np.array([estimate.coefficients for estimate in estimates]))


def _of_observation(
    law: Law, trials: Trials, settings: Mapping[str, Any], calls: tuple[str, ...], progress: ProgressCallback
) -> Law:
    changed = changed_settings("refine", settings)
    errors, threshold = checked_errors(changed), threshold_of(changed)
    taken = {name: changed[name] for name in ("log_states", "input_interpolation", "noise", "seed") if name in changed}
    if taken.get("input_interpolation") == "auto":
        raise CommonlawError("not-with-observation", settings=["input_interpolation='auto'"])
    fitted = refit(law, trials, **taken, errors=errors, huber_threshold=threshold, progress=progress)
    refined = fitted.law(calls)
    history, rates = (*law.history, refined.provenance.history[-1]), law.provenance.differentiation
    return replace(refined, provenance=replace(refined.provenance, differentiation=rates, history=history))


@dataclass(frozen=True)
class _Fit:
    """How a law is fitted, see `refine`; by least squares, no measurement counts as an outlier."""

    log_states: Sequence[str] | None
    input_interpolation: str | None
    noise: Mapping[str, float] | None
    errors: ErrorKind | Literal["auto"]
    least_squares: bool
    huber_threshold: float
    covariance: CovarianceKind
    seed: int

    def refined(self, law: Law, trials: Trials, alike: bool, progress: ProgressCallback) -> Law:
        """Return a law fitted to trials; objects may be alike, and say where parameters inside terms begin."""
        setup = FitSetup.of(law, trials, self.noise, self.huber_threshold, self.input_interpolation, self.log_states)
        error_kinds(self.errors, setup.trials.schema)  # Refused before the work
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
        errors = "white" if self.errors == "auto" and pool.best.has_few_measurements else self.errors
        pool = choose_errors(pool, errors=errors, propose=lambda _: None, progress=progress)
        pool = choose_deterministic(pool, progress)
        shared = shared_coefficients(setup.law)
        is_joint = bool(shared.any()) and len(pool.best.estimates) > 1
        fit, is_converged = converged(replace(pool.best, shared=shared if is_joint else None), self.least_squares)
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
        refined = fitted_law(law, fit, self.covariance, self.seed)
        chosen = *steps, *sample_steps(problem), noise_step(problem), *fit_steps(fit)
        before = law.provenance.domain
        domain = replace(Domain.of(trials, state_rates(law)), at_rest=before.at_rest, constant=before.constant)
        provenance = replace(
            law.provenance,
            outcomes=(
                *with_origin_outcomes(without_outcomes_of_fit(law.diagnostics), refined, trials),
                *with_approximation(
                    pool, outcomes_of_fit(refined, fit, is_converged, tried_errors=self.errors == "auto")
                ),
                *outcomes_of_unmeasured(refined, problem),
            ),
            history=(*law.history, *chosen),
            domain=replace(domain, visited={**domain.visited, **latent_state_ranges(problem.trials, fit.estimates)}),
        )
        pooled = pool_objects(replace(refined, provenance=provenance), shared, alike)
        if fit.shared is not None:  # Pooling has rounding errors where coefficients are nearly collinear
            coefficients = np.where(shared | (not alike), joint_coefficients(fit), pooled.coefficients)
            pooled = replace(pooled, coefficients=coefficients)
        if fit.shared is not None and pooled.uncertainty.unpooled is not None:
            alone = fitted_law(law, apart(fit), self.covariance, self.seed)
            estimates = ObjectEstimates(alone.coefficients[:, alone.support], alone.uncertainty.known_covariance())
            pooled = replace(pooled, uncertainty=replace(pooled.uncertainty, unpooled=estimates))
        refuse_infinite(pooled)
        return pooled


def _by_parts(law: Law, stream: TrialStream, how: _Fit, progress: ProgressCallback) -> Law:
    if law.scheme == "shooting":
        raise CommonlawError("not-refined-file-by-file", what="observation equations")
    if law.terms.parameters or law.schema.initial_values:
        what = "nonlinear parameters" if law.terms.parameters else "latent states"
        raise CommonlawError("not-refined-file-by-file", what=what)
    parts, known = stream.files, {*law.objects}
    light = replace(law, uncertainty=replace(law.uncertainty, shared_factor=None, unpooled=None, pooled=None))
    names = objects_of_parts(parts, part(progress, 0.0, 0.1))
    laws = [select_objects(light, name) if known.issuperset(name) else typical(law, name) for name in names]
    fits = [partial(how.refined, law_of_part, alike=False, progress=silent) for law_of_part in laws]
    result = fitted_by_parts(fits, parts, part(progress, 0.1, 1.0))
    step = Step("coefficients", counted(len(parts), "file"), "each object was fitted to its trials, file by file")
    return replace(result, provenance=replace(result.provenance, history=(*law.history, step)))


def adapt(law: Law, trials: Trials) -> Law:
    """Return the law of the objects of these trials, their coefficients updated by them, see `Law.update`."""
    known, bounds = law.uncertainty, restrictions_of(law).bounds
    known.known_covariance()
    if known.noise is None or known.error_model.of_law:
        lacks = "has no noise estimate" if known.noise is None else "has process noise"
        raise CommonlawError("weights-unknown", lacking=lacks)
    trials = matched(law, trials)
    before = with_objects_of(law, trials)[0]
    # What is not normal, weighted by solutions, or of several objects is fitted by shooting
    if law.scheme == "shooting" or known.error_model or known.limits or bounds or shared_parameters(law):
        result = updated(before, trials)
    else:
        result = _updated_by_collocation(before, trials)
    count = f"{len(trials.trials)} trials"
    step = Step("adaptation", count, "coefficients estimated from these trials, with the other objects as prior")
    return replace(result, provenance=replace(result.provenance, history=(*law.history, step)))


def _updated_by_collocation(law: Law, trials: Trials) -> Law:
    """Return a law of white noise updated by trials of its objects, which may be chaotic."""
    setup = FitSetup.of(law, trials)
    before, trials = setup.law, setup.trials
    problem = prepare(trials, law.terms, before.coefficients, noise=law.uncertainty.noise)
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
            errors = (last,)
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
