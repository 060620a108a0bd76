"""Laws fitted again: by all that was measured, or by few samples and other objects."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from commonlaw.diagnostics import Outcome, note
from commonlaw.errors import CommonlawError
from commonlaw.inference.search.setup import RefitOptions
from commonlaw.inference.verbs.schemes import fit_of
from commonlaw.law import Law, Step
from commonlaw.law.alignment import matched
from commonlaw.law.population import with_objects_of
from commonlaw.law.script import call
from commonlaw.likelihood.levels import states_of_open_scale
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.fit_options import (
    CovarianceKind,
    ErrorKind,
    FitOptions,
    check_settings,
    settings_of,
)
from commonlaw.runtime.progress import ProgressCallback, on_terminal
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.stream import in_memory_or_by_file

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
    options, fit = RefitOptions(**known, least_squares=errors == "white"), fit_of(law)

    def in_memory(trials: Trials) -> Law:
        scale = log_states if log_states is not None else law.observation.measured.logarithmic or None
        states = states_of_open_scale(
            trials, errors=errors, noise=noise, log_states=scale, is_first_order=law.order == 1
        )
        notes = (note("small-values-without-weight", states=states),) if states else ()
        return noted(fit.refitted(trials, options, progress), notes)

    def by_file(stream: TrialStream) -> Law:
        return fit.by_file(stream, replace(options, errors="white" if errors == "auto" else errors), progress)

    result = in_memory_or_by_file(trials, client, in_memory, by_file)
    return replace(result, provenance=replace(result.provenance, calls=calls))


def noted(law: Law, outcomes: tuple[Outcome, ...]) -> Law:
    """Return a law with more notes, after those that it has."""
    return replace(law, provenance=replace(law.provenance, outcomes=(*law.provenance.outcomes, *outcomes)))


def adapt(law: Law, trials: Trials) -> Law:
    """Return the law of the objects of these trials, their coefficients updated by them, see `Law.update`."""
    known = law.uncertainty
    known.known_covariance()
    if known.noise is None or known.error_model.of_law:
        lacks = "has no noise estimate" if known.noise is None else "has process noise"
        raise CommonlawError("weights-unknown", lacking=lacks)
    trials = matched(law, trials)
    before = with_objects_of(law, trials)[0]
    result = fit_of(before).updated(trials)
    count = f"{len(trials.trials)} trials"
    step = Step("adaptation", count, "coefficients estimated from these trials, with the other objects as prior")
    return replace(result, provenance=replace(result.provenance, history=(*law.history, step)))
