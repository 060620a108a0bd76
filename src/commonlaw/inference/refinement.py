"""From a law whose terms are known to the coefficients that its trajectories need."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, get_args

from commonlaw.errors import check_choice
from commonlaw.inference.covariance import CovarianceKind, fitted_law
from commonlaw.inference.error_search import ErrorKind
from commonlaw.inference.fit_setup import FitSetup
from commonlaw.inference.law_search import begin_search, choose_errors, fit_terms
from commonlaw.inference.provenance import (
    fit_steps,
    noise_step,
    outcomes_of_fit,
    outcomes_of_unmeasured,
    sample_steps,
    without_outcomes_of_fit,
)
from commonlaw.inference.search import to_scale
from commonlaw.inference.unmeasured import visited_besides
from commonlaw.integration import BETWEEN
from commonlaw.law import Law
from commonlaw.law.domain import Domain
from commonlaw.law.script import call
from commonlaw.law.zero import with_outcomes_of_zero
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.parallel import threads
from commonlaw.progress import ProgressCallback, on_terminal
from commonlaw.trials import Trials


def refine(
    law: Law,
    trials: Trials,
    *,
    positive: Sequence[str] | None = None,
    input_between: str | None = None,
    noise: Mapping[str, float] | None = None,
    errors: ErrorKind | Literal["auto"] = "auto",
    huber_threshold: float = HUBER_THRESHOLD,
    covariance: CovarianceKind = "likelihood",
    partial_pooling: bool = True,
    seed: int = 0,
    n_jobs: int = -1,
    progress: ProgressCallback | None = None,
) -> Law:
    """Fit a law's coefficients, and the states of each trial, to what was measured: maximum likelihood.

    The terms stay, whatever method found them; the law gets standard errors. Initial states are free, chaotic laws are
    welcome, and values may be missing (multiple shooting with a shot for each step, see `commonlaw.likelihood`).

    Parameters
    ----------
    law
        Of order 1 or 2. Coefficients whose standard error is zero are known and stay.
    trials
        Of objects of the law.
    positive
        States that are above zero and modelled on a logarithmic scale, see `TrajectoryLikelihood`. Default: those of
        the law.
    input_between
        The interpolation of inputs between samples, or ``"auto"``, see `TrajectoryLikelihood`. Default: as in the law.
    noise
        Standard deviation of each state's measurement noise by name. Default: it is estimated, but for states whose
        measurements have standard deviations of their own (``noise_columns`` of the trials).
    errors
        Those beside white noise, see `TrajectoryLikelihood`.
    huber_threshold
        Standard deviations of noise beyond which a measurement counts as an outlier, infinite for none.
    covariance
        How the covariance is found: ``"likelihood"``, from its curvature, or ``"bootstrap"``, from the scatter of
        coefficients when blocks of the trials are drawn anew.
    partial_pooling
        Whether coefficients are drawn to their means as far as the objects are alike, see `Law.partial_pooling`.
    seed
        Of the bootstrap.
    n_jobs
        Threads that share the objects, see `TrajectoryLikelihood`.
    progress
        Takes what is being done, step by step. Default: it is written to the terminal after two seconds.

    Returns
    -------
    Law
        Of the objects of the trials.

    Raises
    ------
    CommonlawError
        If the law is of discrete time, its objects do not share their terms, an object or a variable is not in it, a
        setting does not exist, or a trial cannot be used; the message says which.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> method = cl.DerivativeRegression(differentiation="savgol:25:3", solver="group-stlsq:1.5")
    >>> law = cl.discover(drops, order=2, library="poly:1", method=method)
    >>> print(cl.refine(law, drops).average())
    x'' = -9.836 ± 0.045 - (0.3834 ± 0.0040) v
    <BLANKLINE>
    with v = x'
    """
    calls = (*law.provenance.calls, call(refine, locals(), "cl.refine", "law", "trials"))
    check_choice("covariance", covariance, get_args(CovarianceKind))
    check_choice("errors", errors, ("auto", *get_args(ErrorKind)))
    check_choice("input_between", input_between, (None, "auto", *BETWEEN))
    setup = FitSetup.of(law, trials, noise, huber_threshold, input_between, positive)
    progress = on_terminal() if progress is None else progress
    progress("estimating noise, smoothing, fitting coefficients")
    with threads(n_jobs):
        found, steps = begin_search(
            lambda own, _: fit_terms(replace(setup, trials=own)),
            setup.trials,
            input_between=setup.input_between,
            errors=errors,
            progress=progress,
        )
        found = choose_errors(found, errors=errors, propose=lambda _: None, progress=progress)
        problem, state = to_scale(found.problem, found.state)
        schema = replace(setup.law.schema, input_between=problem.trials.schema.input_between)
        law, trials = replace(setup.law, schema=schema), setup.trials
        refined = fitted_law(law, problem, state, covariance, seed)
    chosen = *steps, *sample_steps(problem), noise_step(problem), *fit_steps(problem, state)
    domain = Domain.of(trials, law.state_rates)
    provenance = replace(
        law.provenance,
        outcomes=(
            *with_outcomes_of_zero(without_outcomes_of_fit(law.outcomes), refined, trials),
            *outcomes_of_fit(problem, state),
            *outcomes_of_unmeasured(refined, problem),
        ),
        history=(*law.history, *chosen),
        calls=calls,
        domain=replace(domain, visited={**domain.visited, **visited_besides(problem.trials, state.estimates)}),
    )
    return replace(refined, provenance=provenance).partial_pooling(None, partial_pooling)
