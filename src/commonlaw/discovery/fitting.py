"""A law of given terms, whose coefficients are estimated from trials."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Literal

from commonlaw.discovery.collocation import by_collocation
from commonlaw.discovery.log_scale import likelier_scale
from commonlaw.discovery.request import FitRequest
from commonlaw.discovery.shooting import by_shooting
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.estimation.beginning import InitialGiven
from commonlaw.inference.verbs.chunks import fitted_by_parts, objects_apart
from commonlaw.law import Law, pool_objects
from commonlaw.law.models import model_named
from commonlaw.law.parse import read_equations
from commonlaw.law.script import call
from commonlaw.library.bounds import check_equations
from commonlaw.library.functions import functions_in
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.fit_options import (
    CovarianceKind,
    ErrorKind,
    FitOptions,
    check_settings,
    settings_of,
)
from commonlaw.runtime.progress import ProgressCallback, on_terminal, part, silent
from commonlaw.trials import Schema, Trials, TrialStream
from commonlaw.trials.stream import in_memory_or_by_file, measured
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    from distributed import Client


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
    estimates within bounds, jointly over all objects. Noise is that of restricted maximum likelihood. By default it is
    white, or grows with the states if residuals are very strong evidence for it; a lack of fit is noted, and
    autocorrelated errors are taken where ``errors`` has their name, see `commonlaw.estimation`. So are parameters of
    quotients that are shared, such as K in ``r x (1 - x/K)``.

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
        If a parameter differs between trials, the law has its mean for each object, ``law.trial_estimates`` the
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
    trials = measured(trials)
    check_equations(equations)
    arguments = locals()
    settings = {name: value for name, value in arguments.items() if name in settings_of(FitOptions, "fit")}
    check_settings("fit", settings)
    check_types(fit, arguments)
    check_choice("scheme", scheme, ("auto", "collocation", "shooting"))
    settings["progress"] = progress
    called = functions_in(functions)

    def in_memory(trials: Trials) -> Law:
        texts, inputs = _of_textbook(equations, doses, trials.schema, property_names(trials.properties))
        request = FitRequest.of(
            texts,
            trials,
            initial_values=initial_values,
            initial_time=initial_time,
            doses=inputs,
            shared=shared,
            guesses=guesses,
            observe=observe,
            priors=priors,
            functions=called,
            scheme=scheme,
            settings=settings,
        )
        if not called:  # Functions are no text
            whole = texts if isinstance(texts, str) else "; ".join(texts)
            known = {
                "doses": request.doses,
                "initial_time": request.said_time,
                "initial_values": initial_values or None,
            }
            request = replace(request, calls=(call(fit, arguments | known, "cl.fit", repr(whole), "trials"),))
        return _on_likelier_scale(request)

    def by_file(stream: TrialStream) -> Law:
        texts, inputs = _of_textbook(equations, doses, stream.schema, ())
        if initial_values or inputs or shared or guesses or observe or priors or called or scheme == "shooting":
            raise CommonlawError("not-for-streams")
        return _of_stream(texts, stream, settings)

    return in_memory_or_by_file(trials, client, in_memory, by_file)


def _of_textbook(
    equations: str | Sequence[str], doses: str | Sequence[str], schema: Schema, properties: Sequence[str]
) -> tuple[str | Sequence[str], str | Sequence[str]]:
    """Return equations and doses, those of a textbook model over these columns if the equations are its name."""
    named = model_named(equations)
    if not named:
        return equations, doses
    textbook = named[0].over_columns(schema, properties, named[1])
    return textbook.equations, doses or textbook.doses


def _on_likelier_scale(request: FitRequest) -> Law:
    """Return the law with states over decades on their own scale or a logarithmic one, whichever is likelier."""
    states = request.open_scale
    if not states:
        return _of_request(request)
    logarithmic = replace(request, settings={**request.settings, "log_states": states})
    on_own_scale = cache(partial(_of_request, request))
    return likelier_scale(partial(_of_request, logarithmic), on_own_scale, lambda _: on_own_scale(), request.dosed)


def _of_request(request: FitRequest) -> Law:
    reason = request.why_shooting
    return by_shooting(request, reason) if reason else by_collocation(request)


def _of_part(equations: str | Sequence[str], settings: dict[str, Any], trials: Trials) -> Law:
    """Return the law of a part of a stream, by default under white noise, whose outliers count linearly."""
    errors = "white" if settings["errors"] == "auto" else settings["errors"]
    request = FitRequest.of(
        equations,
        trials,
        initial_values=None,
        initial_time=None,
        doses=(),
        shared=(),
        guesses=None,
        observe=None,
        priors=None,
        functions=(),
        scheme="collocation",
        settings=settings | {"errors": errors},
    )
    return _on_likelier_scale(replace(request, least_squares=settings["errors"] == "white"))


def _of_stream(equations: str | Sequence[str], stream: TrialStream, settings: dict[str, Any]) -> Law:
    given = read_equations(equations, stream.schema)
    if given.terms.parameters or given.order == 0:
        what = "a discrete-time law is" if given.order == 0 else "nonlinear parameters are"
        raise CommonlawError("not-file-by-file", what=what)
    one, parts = partial(_of_part, equations, settings | {"partial_pooling": False, "progress": silent}), stream.files
    progress = settings["progress"] or on_terminal()
    objects_apart(parts, part(progress, 0.0, 0.1))
    law = fitted_by_parts([one] * len(parts), parts, part(progress, 0.1, 1.0), settings["errors"])
    made = (call(fit, settings, "cl.fit", repr(equations), "trials"),)
    provenance = replace(law.provenance, calls=made)
    return pool_objects(replace(law, provenance=provenance), None, settings["partial_pooling"])
