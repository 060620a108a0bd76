"""A law of given terms, whose coefficients are estimated from trials."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import compress
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.diagnostics import Outcome, OutcomeKind, marked, note
from commonlaw.discovery.hints import outcomes_of_units
from commonlaw.discovery.known_physics import known_coefficients
from commonlaw.discovery.measured_rates import without_measured_rates
from commonlaw.discovery.method import Known, ModelStructure
from commonlaw.discovery.regression import DiscreteTimeRegression, suitable_differentiation
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.estimation import beyond_collocation
from commonlaw.estimation.beginning import (
    FREE,
    InitialGiven,
    begin,
    initial_time_of,
    refuse_zero_columns,
    with_values_of,
    written_starts,
)
from commonlaw.estimation.doses import usual_initial_time, with_doses_in_equations
from commonlaw.estimation.fitting import checked_errors, estimate_at_bound, fit_model, threshold_of
from commonlaw.estimation.model import ModelText, read_model
from commonlaw.estimation.profile import with_one_sided_limits
from commonlaw.inference import refine
from commonlaw.inference.diagnose.scale_origin import with_origin_outcomes
from commonlaw.inference.propose.nonlinear_parameters import outcomes_of_parameters, with_initial_parameters
from commonlaw.inference.settings import STRONG
from commonlaw.inference.verbs.chunks import fitted_by_parts
from commonlaw.inference.verbs.refinement import collocated, refine_shared
from commonlaw.integration import BETWEEN
from commonlaw.law import Law, Provenance, Step, Uncertainty, pool_objects, select_objects
from commonlaw.law.models import model_named
from commonlaw.law.objects import of_all_objects
from commonlaw.law.observation import ALL
from commonlaw.law.parameters import named_parameters, standard_errors
from commonlaw.law.parse import GivenEquations, read_equations
from commonlaw.law.provenance import Domain
from commonlaw.law.script import call
from commonlaw.law.text import with_error
from commonlaw.law.uncertainty import OneSidedLimit
from commonlaw.library import ExpressionLibrary
from commonlaw.library.bounds import Bound, check_equations
from commonlaw.library.equation import split_equations
from commonlaw.library.functions import functions_in
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.cluster import on_cluster, refuse_client
from commonlaw.runtime.fit_options import (
    CovarianceKind,
    ErrorKind,
    FitOptions,
    changed_settings,
    check_settings,
    settings_of,
)
from commonlaw.runtime.progress import ProgressCallback, on_terminal, silent
from commonlaw.solvers import STLSQ
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.equation_columns import as_named
from commonlaw.trials.transformations import (
    amounts_at_samples,
    objects_at_rest,
    outcome_of_rest,
    outcome_of_undosed,
    with_doses,
    with_starts,
    without_objects,
)
from commonlaw.trials.trial import Start, property_names

if TYPE_CHECKING:
    from distributed import Client

_OTHER_ERRORS = ("proportional noise", "autocorrelated errors", "model error")
"""Stages of a history that say which errors a law has besides white noise."""


def fit(
    equations: str | Sequence[str],
    trials: Trials | TrialStream | Any,
    *,
    initial_values: Mapping[str, InitialGiven] | None = None,
    initial_time: float | Literal["first"] | None = None,
    doses: str | Sequence[str] = (),
    shared: str | Sequence[str] | Mapping[str, str] = (),
    guesses: Mapping[str, float] | None = None,
    observe: Mapping[str, str] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    functions: Iterable[Callable[..., Any]] = (),
    scheme: Literal["auto", "collocation", "shooting"] = "auto",
    log_states: Sequence[str] | None = None,
    input_interpolation: str | None = None,
    noise: Mapping[str, float | str] | None = None,
    errors: ErrorKind | Literal["auto"] = "auto",
    huber_threshold: float = FitOptions.huber_threshold,
    covariance: CovarianceKind = "likelihood",
    partial_pooling: bool = False,
    seed: int = 0,
    n_jobs: int = -1,
    progress: ProgressCallback | None = None,
    client: "Client | None" = None,
) -> Law:
    """Fit given equations to trials: estimate their parameters for each object.

    Trajectories are fitted by maximum likelihood, as by `refine`; laws in discrete time are fitted to the next sample
    by least squares, without settings.

    Models with observation equations, initial values of measured states, priors, parameters shared by property, inputs
    with a dead time ``u(t - d)``, switches, events, or values below a limit of quantification are fitted by nonlinear
    least squares from the fit without these, or from many initial guesses (multi-start): exact maximum likelihood
    estimates within bounds, jointly over all objects. Noise is that of restricted maximum likelihood, white unless
    ``errors`` names another kind of measurement errors; see `commonlaw.estimation`. So are parameters of quotients that
    are shared, such as K in ``r x (1 - x/K)``.

    Parameters
    ----------
    equations
        One for each state, as a list or separated by semicolons, see `Law.from_text`; or the name of one of
        `commonlaw.named_models`: ``"logistic"``, with the columns of its variables if these are ambiguous,
        ``"logistic:x=weight"``. Other names are parameters to be estimated. Numbers, pi, and properties of the objects
        are fixed: ``"x'' = -9.81 - c v"``, or ``"n' = r n (1 - n/K)"`` if K is a property. v is the rate of x, as is
        ``x'``; t is time, whatever the name of its column.

        Parentheses with parameters are expanded: ``"T' = -k (T - a)"`` is fitted as ``-k T + k a``, from which k and a
        follow, with standard errors to first order. The number of terms must equal the number of parameters.

        Parameters inside functions, powers and denominators are nonlinear: ``"s' = -V s/(K + s)"``, ``"x'' = -k
        abs(v)^p sign(v)"``, ``"i' = a (exp(u/U) - 1) - b i"``, ``"x'' = -k x + A cos(w t + p)"``. The fit starts from a
        grid of values, within the bounds that follow the equations: ``"s' = -V s/(K + s); K > 0"``, ``1 < p < 2``. An
        estimate at its bound is noted, with a one-sided interval.

        Switches: ``"x' = -k x + a (t > t0)"``, ``where(x > c, a, b)``, ``max(a, b, ...)``, ``min(a, b, ...)``, and the
        unit step ``step(x)``. ``floor``, ``ceil`` and ``mod`` take times and inputs, whose jumps are given. Other
        functions: see `commonlaw.library.parse_term`.

        Events give states and rates new values where a condition becomes true: ``"x'' = -g; x < 0: x = 0, v = -c v"``,
        ``"t > tau: conc = f conc + d"``.
    trials
        Measurements: trials, or a table that `Trials.from_frame` accepts. A stream is fitted file by file, see
        `refine`, without nonlinear parameters and latent states.
    initial_values
        Initial values of states at time zero of each trial, by name: a number, the name of a property of the
        objects, such as a dose, an expression of parameters and properties, numbers by object or trial, a mean and a
        standard deviation, or None (or ``"free"``) to estimate it for each trial. States with an initial value need no
        column: ``cl.fit("depot' = -ka depot; conc' = ka depot/V - k conc", trials, initial_values={"depot": "dose"})``.
        Those of measured states are estimated by default. In the equations: ``"x(0) = 1"``, for one trial ``'x(0) = 1 @
        "control"'``.
    initial_time
        Time of the initial values, or ``"first"`` for that of each trial's first sample, which it may precede but not
        follow. Default: 0 if initial values are given, else, and where times are dates or times of day, the first
        sample. A default of 0 is refused more than the length of a trial before the first sample, such as years.
    doses
        Inputs that are amounts added at once, at the times of their rows and after the measurements there; zero
        elsewhere: ``cl.fit("conc' = -k conc + dose/V", trials, doses="dose")``. A trial that begins with a dose is
        zero before it, ``x(0) = 0``, in all states that were not measured there.
    shared
        Parameters that all objects share, ``shared="k2"``; the others are object-specific. The likelihood is that of
        all objects together. A mapping names groups: with ``shared={"k2": "strain"}`` objects of the same strain share
        k2 (a property, or an input that is constant in each trial), ``{"c": "all"}`` is one value for all trials, and
        ``{"b": "trial"}`` one for each.
        If a parameter differs between trials, the law has its mean for each object, ``law.observation.estimated`` the
        values, and `Law.predict` estimates it from each trial like an initial value.
    guesses
        Initial guesses of nonlinear parameters, ``guesses={"w": 0.3}``, in place of the grid.
    observe
        Observation equations by column, as expressions of states, rates, inputs, time and parameters:
        ``cl.fit("x' = -k x", trials, observe={"signal": "c x (1 + x) + b"})``; other columns are states. They may
        also follow the equations: ``"x' = -k x; signal = c x"``.
    priors
        Mean and standard deviation of parameters with a normal prior, by name: ``priors={"k": (0.5, 0.1)}``.
    functions
        Python functions that the equations call by name, from arrays to an array: ``cl.fit("x'' = -k x - drag(v)",
        trials, functions=[drag])``, see `commonlaw.library.ExpressionLibrary`.
    scheme
        How solutions are fitted: ``"collocation"``, at mesh points together with the parameters, such that they follow
        the equations; or ``"shooting"``, computed from initial values. By default the former, where it can fit what was
        given, which the history of the law says. Both have the same maximum of the likelihood.
    log_states
        See `FitOptions`.
    input_interpolation
        See `FitOptions`. With `doses` the default is linear.
    noise
        Standard deviations by state, see `FitOptions`; with the name of a property of the objects,
        ``{"signal": "lab"}``, one is estimated for each of its values.
    errors, huber_threshold, covariance, partial_pooling, seed, n_jobs
        See `FitOptions`.
    progress, client
        See `refine`.

    Raises
    ------
    CommonlawError
        If the equations cannot be parsed (the message names the character and lists the variables), a state has neither
        a column nor an initial value, a scale or parameter is not identifiable, or a setting or the trials cannot be
        used.

    See Also
    --------
    discover : Search for the equations.
    compare : Compare laws by their evidence.
    refine : Refit a law to other trials.
    NamedModel : Textbook models with a name.
    Law.from_text : A law with given coefficients.

    Examples
    --------
    >>> import commonlaw as cl
    >>> from commonlaw.law import average_law
    >>> drops = cl.datasets.linear_drag(noise=0.0)
    >>> print(average_law(cl.fit("x'' = -g - c v", drops)))
    x'' = -9.8000 ± 0.0010 - (0.380000 ± 0.000093) v
    <BLANKLINE>
    with v = x', g [m/s²] = 9.8000 ± 0.0010, c [1/s] = 0.380000 ± 0.000093
    """
    if isinstance(equations, Trials | TrialStream) or isinstance(trials, str):
        raise CommonlawError("arguments-swapped")
    if not isinstance(trials, Trials | TrialStream):
        trials = Trials.from_frame(trials)
    check_equations(equations)
    arguments = locals()
    settings = {name: value for name, value in arguments.items() if name in settings_of(FitOptions, "fit")}
    check_settings("fit", settings)
    check_types(fit, arguments)
    check_choice("scheme", scheme, ("auto", "collocation", "shooting"))
    settings["progress"] = progress
    if named := model_named(equations):
        properties = property_names(trials.properties) if isinstance(trials, Trials) else []
        textbook = named[0].over_columns(trials.schema, properties, named[1])
        equations, doses = textbook.equations, doses or textbook.doses
    called = functions_in(functions)
    if isinstance(trials, TrialStream):
        if initial_values or doses or shared or guesses or observe or priors or called or scheme == "shooting":
            raise CommonlawError("not-for-streams")
        return _of_stream(equations, trials, settings, client)
    refuse_client(client)
    doses = (doses,) if isinstance(doses, str) else tuple(doses)
    shared = (shared,) if isinstance(shared, str) else shared
    groups = shared if isinstance(shared, Mapping) else dict.fromkeys(shared, ALL)
    whole = equations if isinstance(equations, str) else "; ".join(equations)
    owners = trials.objects
    equations, trials = with_doses_in_equations(equations, trials, doses)
    doses = () if trials.schema.doses else doses  # The table records them
    model = ModelText.of(equations, observe)
    written = [equations] if isinstance(equations, str) else equations
    trials = as_named(trials, model.named, "; ".join([*written, *model.observed.values()]))
    if input_interpolation is None:
        _refuse_interpolated_amounts(model, trials, doses)
    dosed = with_doses(trials, doses)
    if not called:
        _refuse_zero_columns(model, dosed)
    starts = written_starts(model, initial_values or {})
    initial_time = usual_initial_time(trials) if initial_time is None else initial_time
    at = initial_time_of(dosed, initial_time, starts)
    recorded = "first" if at is None and starts else at
    model_settings = {
        "initial_values": initial_values,
        "initial_time": at,
        "shared": shared,
        "guesses": guesses,
        "priors": priors,
    }
    changed = changed_settings("fit", settings)
    asked_of = {
        "observe": observe,
        "doses": doses,
        **model_settings,
        "initial_time": recorded,
        "scheme": scheme,
        **changed,
    }
    calls: tuple[str, ...] = (call(fit, asked_of, "cl.fit", repr(whole), "trials"),)
    _refuse_free_starts(dosed, [name for name, start in (initial_values or {}).items() if start in (None, FREE)])
    undosed = tuple(name for name in owners if name not in dosed.objects)

    def jointly(reason: str, resting: tuple[str, ...] = ()) -> Law:
        """Return the law by shooting; without objects at rest, where these do not determine a parameter."""
        moving, given = without_objects(dosed, resting), model_settings | {"shared": groups}
        try:
            law = _of_model(model, moving, calls, given, changed)
        except CommonlawError as error:
            others = objects_at_rest(moving)
            if error.code != "parameters-not-identified" or not others:
                raise
            return jointly(reason, others)
        outcomes = (*law.diagnostics, *outcome_of_undosed(undosed), *outcome_of_rest(resting))
        domain, history = replace(law.provenance.domain, at_rest=resting), list(law.history)
        history.insert(1, Step("scheme", "shooting", reason))
        provenance = replace(law.provenance, outcomes=outcomes, domain=domain, history=tuple(history))
        return replace(law, provenance=provenance)

    beyond = beyond_collocation(model, dosed, initial_values or {}, groups, priors, noise)
    beyond += ["doses"] * bool(trials.schema.doses)
    if beyond or scheme == "shooting":
        if called:
            raise CommonlawError("function-with-observation", function=called[0].text)
        if scheme == "collocation":
            raise CommonlawError("beyond-collocation", reasons=beyond)
        return jointly("as given" if scheme == "shooting" else f"for {', '.join(beyond)}")
    asked = split_equations(equations)
    second = [equation.state for equation in asked if equation.order == 2]
    trials, rates = without_measured_rates(trials, second, [equation.state for equation in asked])
    initial_values = {name: None if start == "free" else start for name, start in (initial_values or {}).items()}
    shared = tuple(name for name, by in groups.items() if by == ALL)
    resting = () if shared or initial_values else objects_at_rest(trials)
    trials = without_objects(trials, resting)
    trials, states = with_doses(trials, doses), [equation.state for equation in asked]
    for name in initial_values:
        check_choice("state of the equations", name, states)
        if name in trials.schema.inputs:
            raise CommonlawError("equation-of-input", name=name)
    columns = (*trials.schema.states, *trials.schema.inputs, *initial_values)
    if initial_values and (missing := [name for name in states if name not in columns]):
        raise CommonlawError("equation-without-column", name=missing[0])
    if latent := [equation.state for equation in asked if equation.state in initial_values and equation.order != 1]:
        raise CommonlawError("latent-of-second-order", state=latent[0])
    if initial_time is not None and not initial_values:
        raise CommonlawError("initial-time-without-values")
    trials = with_starts(trials, cast(dict[str, Start], initial_values), at)
    if doses and input_interpolation is None:
        settings["input_interpolation"] = "linear"
    own_properties = property_names(trials.properties)
    given = read_equations(equations, trials.schema, properties=own_properties, functions=called)
    text = "; ".join((*given.texts, *(bound.text for bound in given.bounds)))
    when = "the first sample of each trial" if at is None else f"t = {at:g}"
    names = {coefficient.name for coefficient in given.coefficients}
    history = (
        Step("equations", text, "as given"),
        Step("scheme", "collocation", "as given" if scheme == "collocation" else "the equations need nothing else"),
        *(
            Step("start", f"{name} = {start} at {when}", "as given, for a latent state")
            if start is not None
            else Step("start", name, "latent state; the initial value was estimated in each trial")
            for name, start in initial_values.items()
        ),
        *(Step("property", name, "given for each object, not estimated") for name in own_properties if name in names),
    )
    values: dict[str, Any] = {
        "initial_values": initial_values or None,
        "initial_time": recorded,
        "doses": doses,
        "shared": shared,
        "guesses": guesses,
        "scheme": scheme,
        **settings,
    }
    # Functions are no text
    calls = () if called else (call(fit, values, "cl.fit", repr(text), "trials"),)
    if given.order == 0:
        if given.terms.parameters:
            variables = given.terms.variables
            names_inside = ", ".join(variables.parameters)
            raise CommonlawError("discrete-with-parameters", names=names_inside, variables=variables.measured)
        law = _next_samples(given, trials, {**settings, "shared": shared or None})
        # Of what a search says, only this concerns terms that were given
        ill_conditioned = (
            diagnostic for diagnostic in law.diagnostics if diagnostic.kind is OutcomeKind.ILL_CONDITIONED
        )
        outcomes = with_origin_outcomes(ill_conditioned, law, trials)
        outcomes, domain = (*outcomes, *outcome_of_rest(resting)), Domain(at_rest=resting)
        made = Provenance(None, outcomes, history=history, equations=given.texts, calls=calls, domain=domain)
        return _within_bounds(replace(law, provenance=made), given.bounds)
    differentiation = suitable_differentiation(trials, given.order)
    known, domain = (*rates, *outcome_of_undosed(undosed), *outcome_of_rest(resting)), Domain(at_rest=resting)
    provenance = Provenance(differentiation, known, history=history, equations=given.texts, domain=domain)
    settings["input_interpolation"] = settings["input_interpolation"] or "auto"
    may_shoot = scheme != "collocation" and not called
    unfitted = _unfitted(given, trials, provenance)
    parameters = named_parameters(unfitted)
    for name, value in (guesses or {}).items():
        check_choice("coefficient", name, parameters.names)
        within = [bound for bound in given.bounds if bound.name == name]
        if not np.isfinite(value) or value == 0 or not all(bound.holds(np.array(value)) for bound in within):
            raise CommonlawError("guess-out-of-bounds", name=name, value=value)
    if guesses and initial_values:
        raise CommonlawError("guess-with-latent-states")

    def or_jointly(error: CommonlawError) -> Law:
        """Return a fit of the model, which may give limits or share parameters, where one of objects apart failed."""
        codes, reason = ("more-unknowns-than-measurements", "no-degrees-of-freedom"), "objects determine it together"
        if error.code == "state-constant-of-object" and shared and may_shoot:
            is_shared = {*parameters.names} <= {*shared}
            if is_shared or (resting := objects_at_rest(dosed)):
                return jointly(reason, () if is_shared else resting)
        if not may_shoot or not (error.code == "parameters-not-identified" or (shared and error.code in codes)):
            raise error
        try:
            return jointly(reason)
        except CommonlawError as of_model:
            raise (of_model if shared else error) from None

    try:
        begun = with_initial_parameters(unfitted, trials, given.bounds, guesses, **settings)
    except CommonlawError as error:
        return or_jointly(error)
    equal = np.zeros(begun.support.shape, dtype=np.bool_)  # Coefficients that all objects share
    named_definitions = {definition.name: definition for definition in named_parameters(begun).definitions}
    for name in shared:
        check_choice("coefficient", name, [*named_definitions])
        if len(named_definitions[name].parts) > 1:
            if not may_shoot:
                raise CommonlawError("parameter-is-quotient", parameter=name)
            return jointly(f"for {name}, a shared quotient")
        equal[named_definitions[name].equation, named_definitions[name].term] = True
    apart = settings | {"partial_pooling": False}
    try:
        law = refine_shared(begun, trials, equal, **settings) if shared else refine(begun, trials, **settings)
    except CommonlawError as error:
        if shared:
            return or_jointly(error)
        raise
    outside = any(_outside(law, given.bounds))
    if outside and initial_values and may_shoot:  # Another maximum of the likelihood may be inside
        return jointly("for bounds of parameters")
    if outside:
        law = _at_bounds(refine(begun, trials, **apart), trials, given.bounds, apart)
        law = pool_objects(law, equal, partial_pooling)

    def under_white_noise() -> Law:
        return refine_shared(begun, trials, equal, **settings | {"errors": "white"})

    chosen_errors = _chosen_errors(law, under_white_noise) if errors == "auto" else ()
    law = law if called else with_one_sided_limits(law, trials)
    # Latent states have a note of their own
    is_vague = not initial_values and _is_undetermined(law)
    if may_shoot and (is_vague or any(_is_misfit(law, limit) for limit in law.uncertainty.limits)):
        # Other estimates, and their errors, are those given a value that has no meaning
        try:
            return jointly("for a parameter that has no estimate, but a limit")
        except CommonlawError as error:
            if error.code == "parameters-not-identified" and not law.uncertainty.limits:
                raise
    outcomes = (*law.diagnostics, *outcomes_of_parameters(law), *chosen_errors, *outcomes_of_units(law))
    made = replace(law.provenance, calls=calls, outcomes=outcomes)
    return _within_bounds(replace(law, provenance=made), given.bounds)


def _refuse_interpolated_amounts(model: ModelText, trials: Trials, doses: Sequence[str]) -> None:
    """Refuse equations with an input that is called an amount and holds single ones, unless these are doses."""
    for name in amounts_at_samples(trials):
        occurrence = re.compile(rf"(?<!\w)`?{re.escape(name)}`?(?!\w)")
        if name not in doses and any(occurrence.search(equation) for equation in model.equations):
            raise CommonlawError("doses-interpolated", name=name)


def _refuse_zero_columns(text: ModelText, trials: Trials) -> None:
    """Refuse parameters of columns of zeros; what else may be wrong with equations is refused where they are fitted."""
    try:
        model = read_model(text, trials.schema, property_names(trials.properties))
    except CommonlawError:
        return
    refuse_zero_columns(model, trials)


def _refuse_free_starts(trials: Trials, states: Sequence[str]) -> None:
    """Refuse free initial values of states that are zero before the first dose of a trial."""
    for trial in trials:
        measured = {
            name for name, value in zip(trials.schema.states, trial.states[0], strict=True) if np.isfinite(value)
        }
        if trial.begins_with_dose and (zero := [name for name in states if name not in measured]):
            raise CommonlawError(
                "free-start-with-dose", trial=trial.label, state=zero[0], start=f"{zero[0]}(0) = {zero[0]}0"
            )


def _of_model(
    text: ModelText, trials: Trials, calls: tuple[str, ...], given: dict[str, Any], settings: dict[str, Any]
) -> Law:
    errors = checked_errors(settings) or "white"
    between = settings.get("input_interpolation") or ("linear" if trials.schema.doses else "auto")
    if between != "auto" or not any(np.ptp(trial.inputs, axis=0).any() for trial in trials):
        tried = [between.replace("auto", trials.schema.input_interpolation)]
    else:
        tried = ["linear", *(interpolation for interpolation in BETWEEN if interpolation != "linear")]
    noise, log_states = settings.get("noise"), settings.get("log_states") or ()
    given, laws = given | {"initial_values": given["initial_values"] or {}}, list[Law]()
    for interpolation in tried:
        interpolated = replace(trials, schema=replace(trials.schema, input_interpolation=interpolation))
        begun = begin(text, interpolated, **given, log_states=log_states, noise=noise, errors=errors)
        begun = replace(begun, huber_threshold=threshold_of(settings))
        near = laws[0] if laws else None if given["guesses"] else _by_collocation(text, interpolated, settings)
        if near is not None:
            begun = replace(with_values_of(near, begun), is_fitted=True)
        fitted = fit_model(begun, settings.get("seed", 0), settings.get("progress") or on_terminal())
        law = fitted.law(calls)
        noted = replace(law.provenance, outcomes=(*law.provenance.outcomes, *outcomes_of_units(law)))
        laws.append(replace(law, provenance=noted))
    likelihoods = np.array([law.observation.log_likelihood for law in laws if law.observation is not None])
    gains = 2 * (likelihoods - likelihoods[0])
    best = int(np.argmax(gains)) if max(gains) > STRONG else 0
    if len(tried) == 1:
        return laws[best]
    law, plausible = laws[best], np.flatnonzero(gains > gains[best] - STRONG).tolist()
    why = f"between samples; twice the log-likelihood ratio to straight lines is {gains[best]:.3g}"
    history = (*law.history, Step("inputs", tried[best], why))
    # Dead times that depend on how inputs go between samples, where measurements do not decide it
    named, outcomes = named_parameters(law), [*law.provenance.outcomes]
    for name in dict.fromkeys(name for signal in law.schema.inputs for name in re.findall(r"\(t - (\w+)\)$", signal)):
        at = named.names.index(name)
        value, error = named.values[0, at], named.errors[0, at]
        delays = {tried[i]: named_parameters(laws[i]).values[0, at] for i in plausible if i != best}
        if apart := [
            f"{delay:.4g} ({interpolation})"
            for interpolation, delay in delays.items()
            if abs(delay - value) > 2 * error
        ]:
            where = "" if np.ptp(named.values[:, at]) == 0 else law.objects[0]
            outcomes.append(
                note("delay-by-interpolation", where, name=name, value=value, between=tried[best], others=apart)
            )
    return replace(law, provenance=replace(law.provenance, history=history, outcomes=tuple(outcomes)))


def _by_collocation(text: ModelText, trials: Trials, settings: Mapping[str, Any]) -> Law | None:
    """Return the law of the same equations by collocation, where the fit of the model begins.

    None of models with latent states, observation equations, events, jumps, delays or doses, and where it does not
    fit each object by itself.
    """
    states = {equation.state for equation in split_equations(text.equations)}
    if states != {*trials.schema.states} or trials.schema.doses or replace(text, initial={}).beyond_equations:
        return None
    try:
        given = read_equations(text.equations, trials.schema, properties=property_names(trials.properties))
        provenance = Provenance(suitable_differentiation(trials, given.order), equations=given.texts)
        unfitted = _unfitted(given, trials, provenance)
        log_states, between = settings.get("log_states"), trials.schema.input_interpolation
        inside = {coefficient.name for coefficient in given.coefficients}  # Others are in initial values alone
        bounds = [bound for bound in text.bounds if bound.name in inside]
        begun = with_initial_parameters(unfitted, trials, bounds, log_states=log_states, progress=silent)
        return collocated(begun, trials, log_states, between)
    except CommonlawError:
        return None


def _is_misfit(law: Law, limit: OneSidedLimit) -> bool:
    """Whether an estimate that has only a limit is beyond it, or less than its standard error."""
    parameters = named_parameters(law)
    place = law.objects.index(limit.object), parameters.names.index(limit.parameter)
    value, error = float(parameters.values[place]), float(parameters.errors[place])
    return (value < limit.value) == limit.is_lower or error > abs(value)


def _is_undetermined(law: Law) -> bool:
    """Whether two parameters or more have no limit and standard errors above their estimates in all objects.

    One of them is inside of a term.
    """
    parameters = named_parameters(law)
    vague = np.all(parameters.errors > np.abs(parameters.values), axis=0).tolist()
    names = {*compress(parameters.names, vague)}
    return len(names) > 1 and not names.isdisjoint(law.terms.variables.parameters)


def _chosen_errors(law: Law, under_white_noise: Callable[[], Law]) -> tuple[Outcome, ...]:
    """Return which errors were chosen in place of white noise, and what they change, if there are any."""
    steps = {step.stage: step.choice for step in law.history if step.choice != "none"}
    chosen = [f"{stage}: {steps[stage]}" for stage in _OTHER_ERRORS if stage in steps]
    parameters = named_parameters(law)
    if not chosen or not parameters.names:
        return ()
    try:
        white = under_white_noise()
    except CommonlawError as error:
        return (note("errors-without-comparison", errors=chosen, error=error.sentence(marked)),)
    here, errors = parameters.values, parameters.errors
    comparison = named_parameters(white)
    there, others = comparison.values, comparison.errors
    with np.errstate(divide="ignore", invalid="ignore"):
        changes = np.nan_to_num(abs(there - here) / errors)
    i, j = np.unravel_index(np.argmax(changes), here.shape)
    of = f" of {law.objects[i]}" if len(law.objects) > 1 else ""
    under = with_error(there[i, j], float(np.nan_to_num(others[i, j])))
    changed = f"{parameters.names[j]}{of} is {with_error(here[i, j], errors[i, j])}, and {under} under white noise"
    return (note("errors-chosen", errors=chosen, changed=changed),)


def _of_stream(
    equations: str | Sequence[str], stream: TrialStream, settings: dict[str, Any], client: "Client | None"
) -> Law:
    given = read_equations(equations, stream.schema)
    if given.terms.parameters or given.order == 0:
        what = "a discrete-time law is" if given.order == 0 else "nonlinear parameters are"
        raise CommonlawError("not-file-by-file", what=what)
    errors = "white" if settings["errors"] == "auto" else settings["errors"]
    of_part = settings | {"errors": errors, "partial_pooling": False, "progress": silent}
    one, parts = partial(fit, equations, **of_part), stream.parts or (stream,)
    with on_cluster(client):
        law = fitted_by_parts([one] * len(parts), parts, settings["progress"] or on_terminal())
    made = (call(fit, settings, "cl.fit", repr(equations), "trials"),)
    provenance = replace(law.provenance, calls=made)
    return pool_objects(replace(law, provenance=provenance), None, settings["partial_pooling"])


def _outside(law: Law, bounds: Sequence[Bound]) -> Iterator[CommonlawError]:
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


def _within_bounds(law: Law, bounds: Sequence[Bound]) -> Law:
    for error in _outside(law, bounds):
        raise error
    return law


def _at_bounds(law: Law, trials: Trials, bounds: Sequence[Bound], settings: dict[str, Any]) -> Law:
    """Return a law that is not pooled with coefficients that are outside of their bounds at these, others fitted again.

    An active set, object by object: what is at a bound is known there. Coefficients that are quotients or products of
    what stands before several terms stay as they are.
    """
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
            uncertainty = _unit_uncertainty(is_free[:, np.any(coefficients != 0, axis=0)])
            begun = replace(start, coefficients=coefficients.copy(), uncertainty=uncertainty)
            alone = refine(begun, trials.select(object=[owner]), **settings)
        parts.append(alone)
    if not outcomes:
        return law
    coefficients, covariance = of_all_objects(parts)
    known, provenance = law.uncertainty, law.provenance
    if len(parts) == 1:
        known, provenance = parts[0].uncertainty, parts[0].provenance
    return replace(
        law,
        coefficients=coefficients,
        uncertainty=replace(known, covariance=covariance),
        provenance=replace(provenance, outcomes=(*provenance.outcomes, *outcomes)),
    )


def _unfitted(given: GivenEquations, trials: Trials, provenance: Provenance) -> Law:
    """Return the law of given equations; coefficients that are to be found are 1 or -1, and only they have an error.

    They have the signs of the text.
    """
    known = known_coefficients(given, trials)
    signs = np.ones(known.shape[1:])
    for product in given.products:
        signs[product.equation, product.term] = np.sign(product.factor)
    coefficients = np.where(np.isnan(known), signs, known)
    uncertainty = _unit_uncertainty(np.isnan(known)[:, np.any(coefficients != 0, axis=0)])
    return Law(
        given.terms, trials.schema, given.order, trials.objects, coefficients, uncertainty, provenance=provenance
    )


def _unit_uncertainty(free: Bools) -> Uncertainty:
    """Return a standard error of one for free coefficients, shape (objects, parameters), and of zero for others."""
    return Uncertainty(free[:, :, np.newaxis] * np.eye(free.shape[1]))


def _next_samples(given: GivenEquations, trials: Trials, settings: dict[str, Any]) -> Law:
    """Return the law in discrete time whose coefficients are those of least squares."""
    taken = ("n_jobs", "progress")
    if refused := ", ".join(name for name in changed_settings("fit", settings) if name not in taken):
        raise CommonlawError("discrete-without-option", refused=refused)
    names, terms, values = given.terms.variables.names, given.terms.terms, known_coefficients(given, trials)
    functions = given.terms.variables.functions
    library = ExpressionLibrary(*(term.expression(names) for term in terms), functions=functions)
    known: Known = {
        (trials.schema.states[j], given.terms.names[k]): dict(
            zip(trials.objects, values[:, j, k].tolist(), strict=True)
        )
        for j, k in np.argwhere(~np.isnan(values).any(axis=0)).tolist()
    }
    progress = settings.get("progress") or on_terminal()
    return DiscreteTimeRegression(solver=STLSQ(0.0)).find(trials, ModelStructure(0, library, known), progress)
