"""Laws compared: the evidence for each of them, from the same measurements and with the same noise."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from commonlaw.diagnostics import Outcome, note
from commonlaw.errors import CommonlawError
from commonlaw.estimation.fitting import Fitted, checked_errors, refit
from commonlaw.inference.fit.annealing import fit_supports
from commonlaw.inference.fit.convergence import converged
from commonlaw.inference.fit.covariance import deviations_of, residual_degrees_of_freedom
from commonlaw.inference.fit.final_score import score_of_fit, score_of_order
from commonlaw.inference.fit.fit import ALL_MODEL_ERRORS, Fit
from commonlaw.inference.score.misfit import FittedResiduals
from commonlaw.inference.score.score import Score
from commonlaw.inference.score.trajectories import TrajectoryScore, canonical_order
from commonlaw.inference.search.error_models import among_errors, departures_of, kinds_for, with_error_models
from commonlaw.inference.search.law_search import fit_terms
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.setup import FitSetup, RefitOptions, error_kinds, on_log_scale
from commonlaw.inference.verbs.chunks import typical
from commonlaw.inference.verbs.parameter_bounds import is_within
from commonlaw.inference.verbs.schemes import fit_of
from commonlaw.law import Law, Provenance, average_law, select_objects
from commonlaw.law.alignment import matched, without_strange
from commonlaw.law.parameters import restrictions_of
from commonlaw.library import parse_terms
from commonlaw.library.bounds import bounds_in
from commonlaw.likelihood import ERRORS
from commonlaw.likelihood.levels import Whitened, states_of_open_scale
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.runtime.fit_options import ErrorKind, FitOptions, check_settings
from commonlaw.runtime.parallel import in_parallel, threads
from commonlaw.runtime.progress import ProgressCallback, on_terminal, part, unannounced
from commonlaw.trials import Schema, Trial, Trials, TrialStream
from commonlaw.trials.stream import in_memory_or_by_file

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client


def compare(
    laws: Mapping[str, Law] | Sequence[Law],
    trials: Trials | TrialStream,
    *,
    noise: Mapping[str, float] | None = None,
    errors: ErrorKind | Literal["auto"] = "auto",
    huber_threshold: float = FitOptions.huber_threshold,
    n_jobs: int = -1,
    client: "Client | None" = None,
) -> "pd.DataFrame":
    """Compare laws by their evidence for the same measurements.

    The coefficients of all laws are fitted to these trials; known ones are fixed. All laws have the same noise, if it
    explains the residuals of the best of them; else each has the error model of its largest evidence, as in `discover`.
    There is no penalty here for the library from which a law was chosen. States that one of the laws has on a
    logarithmic scale are on it in all; where none has, values far below their standard deviation count for nothing.

    A law lacks fit if it has a model error or its residuals are autocorrelated (by BIC) or larger than the noise: that
    of repeated measurements, known noise, or that by the most probable law (F-tests at 0.1 %).

    If one of the laws has observation equations, known initial values, shared parameters or estimates at bounds, all
    are fitted as by `cl.fit` with these, each with its own observation equations, shared parameters, priors and bounds;
    laws without observation equations are laws of the measured states.
    Their evidence is the same number, whichever way a law is fitted and written: with the likelihood linearized about
    the converged fit, initial values, the noise and scattering coefficients are integrated out. Other unknowns, as of
    an observation equation or at a bound, cost ``log n``, where n is the number of measurements that depend on one, or
    have their priors.

    Parameters
    ----------
    laws
        Laws by name, or a list of laws, which are then called ``law 1``, ``law 2``; of order 1 or 2, with the objects
        of the trials. They need not use all inputs of the trials.
    trials
        Measurements. For a stream the evidence is added over files, by default with white noise; each file has separate
        noise levels and scales of coefficients, and its objects need not be in the laws.
    noise, errors, huber_threshold, n_jobs
        Settings of the fit, see `FitOptions`.
    client
        A dask client, whose workers fit the files of a stream.

    Returns
    -------
    pandas.DataFrame
        One row for each law, the most probable first: name, equations, number of coefficients of each object, error
        model, lack of fit, 2 log B relative to the first (Kass and Raftery 1995), and the
        probability if one of these laws is true.

    Raises
    ------
    CommonlawError
        If the laws have different states, one that is not of order 1 has another scale than others, or `refine` would
        refuse one of them.

    See Also
    --------
    discover : Search for the law of largest evidence.
    bounds : Limits of coefficients of absent terms.
    Law.comparison : The candidates of a search.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05, trials=1)
    >>> laws = {text: cl.fit(text, drops) for text in ("x'' = a + b v", "x'' = a + b v^2")}
    >>> cl.compare(laws, drops)["law"].tolist()
    ["x'' = a + b v", "x'' = a + b v^2"]
    """
    check_settings("compare", locals())
    arguments = locals()
    if isinstance(laws, Sequence):
        laws = {f"law {i}": law for i, law in enumerate(laws, start=1)}
    if isinstance(laws, Mapping) and not (laws and all(isinstance(law, Law) for law in laws.values())):
        raise CommonlawError("laws-without-names")
    check_types(compare, arguments)
    are_joint = any(fit_of(law).has_joint_objects for law in laws.values())
    states = [law.observation.measured.measured if are_joint else law.schema.states for law in laws.values()]
    if len(listed := dict.fromkeys(", ".join(sorted(state)) for state in states)) > 1:
        raise CommonlawError("laws-of-other-states", states=listed)
    logarithmic = logarithmic_in(laws.values())
    if moved := [name for name, law in laws.items() if not _is_on_scale(law, logarithmic) and law.order != 1]:
        raise CommonlawError("log-states-differ", states=logarithmic, laws=moved)

    threshold = np.inf if errors == "white" else huber_threshold

    def in_memory(trials: Trials) -> "pd.DataFrame":
        return _compared(laws, trials, noise, errors, threshold, n_jobs)

    def by_file(stream: TrialStream) -> "pd.DataFrame":
        if are_joint:
            raise CommonlawError("not-refined-file-by-file", what="observation equations or shared parameters")
        kind = "white" if errors == "auto" else errors
        settings = {"noise": noise, "errors": kind, "threshold": threshold, "n_jobs": n_jobs}
        return compare_by_parts(laws, stream.files, settings, on_terminal())

    return in_memory_or_by_file(trials, client, in_memory, by_file)


def _compared(
    laws: Mapping[str, Law],
    trials: Trials,
    noise: Mapping[str, float] | None,
    errors: ErrorKind | Literal["auto"],
    threshold: float,
    n_jobs: int,
) -> "pd.DataFrame":
    """Return what `compare` does of trials in memory; the Huber threshold is infinite for least squares."""
    for law in laws.values():
        trials = without_strange(law, trials)
    _open_scale(laws, trials, errors, noise)
    are_joint = any(fit_of(law).has_joint_objects for law in laws.values())
    apart = None if are_joint else _fitted_apart(laws, trials, noise, errors, threshold, n_jobs)
    return _frame(laws, apart or _fitted_jointly(laws, trials, noise, errors, threshold))


class _FittedLaw(NamedTuple):
    """How many coefficients of an object were fitted, under which errors, residuals of solutions, and the score."""

    size: int
    errors: str
    residuals: FittedResiduals | None
    score: Score


def _fitted_apart(
    laws: Mapping[str, Law],
    trials: Trials,
    noise: Mapping[str, float] | None,
    errors: ErrorKind | Literal["auto"],
    huber_threshold: float,
    n_jobs: int,
) -> "list[_FittedLaw] | None":
    """Return laws that share no parameter, fitted by collocation; None if one leaves its bounds."""
    logarithmic = logarithmic_in(laws.values())
    same = [on_log_scale(written_alike(law, trials.schema), logarithmic) for law in laws.values()]
    converted = matched(same[0], trials)
    if any(matched(law, converted) is not converted for law in same[1:]):
        raise CommonlawError("laws-in-other-units")
    options = RefitOptions(noise=noise, huber_threshold=huber_threshold)
    setups = [FitSetup.of(law, trials, options) for law in same]
    for setup in setups:
        setup.check_determined()
    with threads(n_jobs):
        fitted = in_parallel(fit_terms, setups)
        finest = max(pool.best.problem.points for pool in fitted)
        # Evidence compares on one mesh alone
        fits = [pool.best for pool in fitted]
        fits = in_parallel(
            lambda fit: fit_supports(fit.problem.with_points(finest), fit.supports, ALL_MODEL_ERRORS), fits
        )
        pools = [Pool((fit,)) for fit in fits]
        best = min((pool.best for pool in pools), key=score_of_order)
        if errors != "auto" or best.departures or best.lack_of_fit:
            kinds = error_kinds(errors, setups[0].trials.schema)
            pools = in_parallel(lambda pool: with_error_models(pool, None, kinds, lambda _: None), pools)
        fits = in_parallel(lambda pool: converged(pool.best)[0], pools)
        if any(_is_outside(law, setup, fit) for law, setup, fit in zip(laws.values(), setups, fits, strict=True)):
            return None
        scores = in_parallel(score_of_fit, fits)
    return [
        _FittedLaw(
            fit.size,
            ERRORS[fit.errors].label,
            None if fit.has_process_noise or fit.diverges else residuals_of_fit(fit),
            score,
        )
        for fit, score in zip(fits, scores, strict=True)
    ]


def _open_scale(
    laws: Mapping[str, Law], trials: Trials, errors: ErrorKind | Literal["auto"], noise: Mapping[str, float] | None
) -> tuple[str, ...]:
    """Return the states whose scale is a choice in a comparison, see `states_of_open_scale`."""
    is_first_order = all(law.order == 1 for law in laws.values())
    scale = logarithmic_in(laws.values()) or None
    return states_of_open_scale(trials, errors=errors, noise=noise, log_states=scale, is_first_order=is_first_order)


def outcomes_of_scale(
    laws: Mapping[str, Law],
    trials: Trials,
    *,
    errors: ErrorKind | Literal["auto"] = "auto",
    noise: Mapping[str, float] | None = None,
    **_: object,
) -> tuple[Outcome, ...]:
    """Return a note if laws are compared, with settings of `compare`, on a scale that loses values or is not theirs."""
    logarithmic = logarithmic_in(laws.values())
    if not logarithmic:
        states = _open_scale(laws, trials, errors, noise)
        return (note("small-values-without-weight", states=states),) if states else ()
    names = [name for name, law in laws.items() if _is_on_scale(law, logarithmic)]
    return () if len(names) == len(laws) else (note("scale-of-comparison", states=logarithmic, laws=names),)


def logarithmic_in(laws: Iterable[Law]) -> tuple[str, ...]:
    """Return the states that are fitted by their logarithms in some laws, on whose scale all are compared."""
    return tuple(dict.fromkeys(name for law in laws for name in law.observation.measured.logarithmic))


def _is_on_scale(law: Law, logarithmic: Sequence[str]) -> bool:
    return {*law.observation.measured.logarithmic} == {*logarithmic}


def _is_outside(law: Law, setup: FitSetup, fit: Fit) -> bool:
    """Return whether a parameter of a law, whose terms may be in another order in its fit, is outside of its bounds."""
    narrow, names = select_objects(law, setup.trials.objects), setup.law.terms.names
    estimates = np.array([estimate.coefficients for estimate in fit.estimates])
    coefficients = np.zeros_like(narrow.coefficients)
    kept = [k for k, name in enumerate(law.terms.names) if name in names]
    coefficients[:, :, kept] = estimates[:, :, [names.index(law.terms.names[k]) for k in kept]]
    return not is_within(replace(narrow, coefficients=coefficients), bounds_in(restrictions_of(law).bounds))


def residuals_of_fit(fit: Fit) -> FittedResiduals:
    """Return the residuals of a fit by collocation without errors of the law."""
    problem, trials, whitened = fit.problem, list[Trial](), list[Whitened]()
    for deviation in (deviation for of_object in deviations_of(fit) for deviation in of_object):
        part = deviation.whitened(problem.noise, problem.errors)
        whitened.append(part._replace(z=np.where(deviation.seen, part.z, np.nan)))
        trials.append(deviation.trial)
    known = np.full(len(problem.noise), problem.noise_given)
    return FittedResiduals(trials, whitened, residual_degrees_of_freedom(fit), known)


def _frame(laws: Mapping[str, Law], compared: Sequence[_FittedLaw]) -> "pd.DataFrame":
    import pandas as pd

    lines = [law.observation.lines(law.objects, restrictions_of(law).shared) for law in laws.values()]
    equations = ["; ".join((*law.structure, *line)) for law, line in zip(laws.values(), lines, strict=True)]
    best = min(compared, key=lambda law: law.score)
    lacking = [  # Without residuals they do; those of the most probable law are the reference
        law.residuals is None or law.residuals.lacks_fit(best.residuals or law.residuals) for law in compared
    ]
    columns = {
        "law": list(laws),
        "equations": equations,
        "coefficients": [law.size for law in compared],
        "errors": [law.errors for law in compared],
        "lack of fit": lacking,
        "2 log B": np.array([law.score - best.score for law in compared]),
    }
    return _with_probabilities(pd.DataFrame(columns))


def _with_probabilities(frame: "pd.DataFrame") -> "pd.DataFrame":
    weights = np.exp(-frame["2 log B"] / 2)
    return frame.assign(probability=weights / weights.sum()).sort_values("2 log B", ignore_index=True)


def _fitted_jointly(
    laws: Mapping[str, Law],
    trials: Trials,
    noise: Mapping[str, float] | None,
    errors: ErrorKind | Literal["auto"],
    huber_threshold: float,
) -> list[_FittedLaw]:
    """Return laws fitted by shooting, all objects together."""
    units = dict[str, str]()
    for law in laws.values():
        units_of_law = law.observation.measured.units
        if any(units.get(name, unit) != unit for name, unit in units_of_law.items()):
            raise CommonlawError("laws-in-other-units")
        units |= units_of_law
    kind, logarithmic = checked_errors({"errors": errors}), logarithmic_in(laws.values())
    progress, fits = on_terminal(), list[Fitted]()
    for name, law in laws.items():
        own_progress = part(progress, len(fits) / len(laws), (len(fits) + 1) / len(laws))
        own_progress(f"fitting {name}")
        try:
            fitted = refit(
                law,
                trials,
                inputs="any",
                noise=noise,
                errors=kind or "white",
                huber_threshold=huber_threshold,
                log_states=logarithmic,
                progress=own_progress,
            )
        except CommonlawError as error:
            raise error.at(name) from error
        fits.append(fitted)
    scored = [TrajectoryScore(fit) for fit in fits]
    best = min(scored, key=lambda of_law: of_law.score)
    departures = departures_of(best) if kind is None else {}
    if departures and all(departures.values()):
        kinds = kinds_for("", replace(trials.schema, logarithmic=logarithmic))
        scored = [TrajectoryScore(among_errors(fit, kinds)) for fit in fits]
    return [
        _FittedLaw(of_law.fitted.parameters, ERRORS[of_law.fitted.begun.errors].label, of_law.residuals, of_law.score)
        for of_law in scored
    ]


def compare_by_parts(
    laws: Mapping[str, Law], parts: Sequence[TrialStream], settings: Mapping[str, Any], progress: ProgressCallback
) -> "pd.DataFrame":
    """Return what `compare` says of laws and the parts of a stream; `settings` are those of `_compared`."""
    import pandas as pd

    light = {name: average_law(law) for name, law in laws.items()}
    frames = done_in_parts(partial(_of_part, light, settings), parts, f"comparing {len(laws)} laws", progress)
    rows = pd.concat(frames).groupby("law", sort=False)
    merged: dict[str, Any] = dict.fromkeys(("equations", "coefficients"), "first")
    merged |= {"errors": lambda errors: ", ".join(dict.fromkeys(errors)), "lack of fit": "any", "2 log B": "sum"}
    frame = rows.agg(merged).reset_index()
    frame["2 log B"] -= frame["2 log B"].min()
    return _with_probabilities(frame)


def _of_part(laws: Mapping[str, Law], settings: Mapping[str, Any], part: TrialStream) -> "pd.DataFrame":
    trials = part.read()
    with unannounced():
        return _compared({name: typical(law, trials.objects) for name, law in laws.items()}, trials, **settings)


def written_alike(law: Law, schema: Schema) -> Law:
    """Return a law with its terms in an order of their own, over all inputs of a schema if its own are some of them."""
    wider = with_inputs_of(law, schema)
    order, known = canonical_order(wider.terms), wider.uncertainty
    places = np.cumsum(wider.support).reshape(wider.support.shape) - 1
    moved = places[:, order][wider.support[:, order]]
    covariance = None if known.covariance is None else known.covariance[:, moved][:, :, moved]
    return replace(
        wider,
        terms=wider.terms.take(order),
        coefficients=wider.coefficients[:, :, order],
        uncertainty=replace(
            known, covariance=covariance, shared_factor=None, unpooled=None, pooled=None, explanation=None
        ),
    )


def with_inputs_of(law: Law, schema: Schema) -> Law:
    """Return a law with no other terms than its own, over all inputs of a schema if its own are some of them."""
    before, used = law.terms.variables, np.any(law.support, axis=0)
    used |= (np.arange(used.size) == 0) & ~used.any()  # A law has a term, if only with a coefficient of zero
    wider = {*law.schema.inputs} <= {*schema.inputs}
    after = replace(before, inputs=schema.inputs) if wider else before
    terms = law.terms.take(np.flatnonzero(used).tolist()).terms
    return replace(
        law,
        terms=parse_terms([term.expression(before.names) for term in terms], after),
        schema=replace(law.schema, inputs=after.inputs),
        coefficients=law.coefficients[:, :, used],
        uncertainty=replace(law.uncertainty, inclusion_probabilities=None, other_laws=()),
        provenance=Provenance(),
    )
