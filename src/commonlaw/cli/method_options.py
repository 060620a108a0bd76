"""Options of a law and of the method that finds it, in the words of the library."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial, wraps
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from commonlaw.cli.artifacts import LaterSteps
from commonlaw.cli.options import Decorator, ReadLaw, as_one, by_name, is_law_file, numbers, option, with_options

if TYPE_CHECKING:
    from commonlaw.discovery import AbstractMethod
    from commonlaw.discovery.known_physics import Base
    from commonlaw.discovery.orders import AskedOrder
    from commonlaw.law import Law
    from commonlaw.trials import Trials, TrialStream


METHODS = {
    "trajectory-likelihood": "TrajectoryLikelihood",
    "derivative-regression": "DerivativeRegression",
    "weak-regression": "WeakRegression",
    "discrete-time-regression": "DiscreteTimeRegression",
}

_LIKELIHOOD = "Options of trajectory-likelihood"
_REGRESSIONS = (
    "Options of derivative-regression, weak-regression and discrete-time-regression",
    "Options of derivative-regression",
    "Options of weak-regression",
)
_likelihood = partial(option, _LIKELIHOOD)
_regression, _derivative, _weak = (partial(option, heading) for heading in _REGRESSIONS)

_ERROR_OPTIONS = (
    _likelihood(
        "--positive",
        metavar="STATE",
        multiple=True,
        help="A state above zero that is modelled on a logarithmic scale: it and its bands stay positive, and noise is "
        "a share of it (--noise weight=0.05 is 5 %); repeat for more.  [default: none; for refine those of the law]",
    ),
    _likelihood(
        "--input-between",
        type=click.Choice(["auto", "held", "linear", "cubic"]),
        help="Inputs between samples: held at the earlier value, as a controller does, on lines, or on a cubic spline; "
        "auto for lines unless the evidence for another is strong.  [default: auto; for refine as the law was learned]",
    ),
    _likelihood(
        "--noise",
        metavar="STATE=VALUE",
        multiple=True,
        help="Known standard deviation of a state's measurement noise; repeat for each state. Goes with "
        "weak-regression too.  [default: estimated]",
    ),
    _likelihood(
        "--errors",
        type=click.Choice(["auto", "white", "proportional", "correlated", "walk", "force"]),
        default="auto",
        help="Errors that are estimated with the law: white noise; noise that grows with the states; errors of the "
        "measurements that have a memory; a random walk of the law, or a smooth force on it; auto for those that the "
        "measurements ask for.",
    ),
    _likelihood(
        "--huber-threshold",
        type=float,
        default=4.0,
        help="Standard deviations of noise beyond which a measurement counts as an outlier; inf for none.",
    ),
    _likelihood(
        "--jobs",
        "n_jobs",
        type=int,
        help="Threads that share the work, or for the regressions processes; -1 for one a core. The result is the "
        "same. Goes with every method.  [default: -1; for the regressions 1]",
    ),
)

_LIKELIHOOD_OPTIONS = (
    *_ERROR_OPTIONS,
    _likelihood(
        "--covariance",
        type=click.Choice(["likelihood", "bootstrap"]),
        default="likelihood",
        help="How standard errors are found: from the curvature of the likelihood, "
        "or by drawing blocks of the trials anew.",
    ),
    _likelihood(
        "--partial-pooling/--no-partial-pooling",
        default=True,
        help="Whether forecasts shrink coefficients to their mean over objects (partial pooling).",
    ),
    _likelihood(
        "--seed",
        type=click.IntRange(0),
        default=0,
        help="Of whatever is drawn at random. Goes with every method.",
    ),
)

_REGRESSION_OPTIONS = (
    _regression(
        "--solver",
        metavar="SPEC",
        help="How terms are chosen: group-stlsq[:THRESHOLD[:IMPORTANCE[:LEVEL]]], best-subset[:TERMS], "
        "forward[:TERMS], backward[:TERMS], lasso[:PENALTY], sr3[:THRESHOLD] (one set of terms for all objects), "
        "stlsq[:THRESHOLD] (terms specific to each object). Without its value a solver offers all its candidates, and "
        "--rule chooses; so it goes with trajectory-likelihood too.  [default: group-stlsq and best-subset; "
        "best-subset for trajectory-likelihood]",
    ),
    _regression(
        "--rule",
        metavar="RULE",
        default="one-standard-error",
        help="How a candidate is chosen: one-standard-error or held-out (by the error on trials held out), aic, aicc, "
        "bic, ebic.",
    ),
    _regression(
        "--scoring",
        type=click.Choice(["residuals", "forecasts"]),
        default="residuals",
        help="What candidates are compared by on trials held out.",
    ),
    _regression(
        "--resamples",
        "n_resamples",
        type=click.IntRange(0),
        default=20,
        help="Bootstrap resamples to assess the stability of candidates.",
    ),
    _derivative(
        "--differentiation",
        metavar="SPEC",
        help="How derivatives are estimated: savgol:WINDOW:POLYNOMIAL, centered, forward, finite:ACCURACY, spline, "
        "median:WINDOW, wiener:WINDOW, spectral, tv:STRENGTH, robust. Goes with weak-regression too, where it smooths."
        "  [default: finite:2 for order 1, savgol:35:3 for order 2]",
    ),
    _derivative(
        "--library-states",
        type=click.Choice(["smoothed", "measured"]),
        default="smoothed",
        help="States that terms are evaluated on.",
    ),
    _derivative(
        "--trim",
        type=click.IntRange(0),
        default=0,
        help="Rows left out at each end of a trial, where smoothing is least accurate.",
    ),
    _weak(
        "--radius",
        "radii",
        type=float,
        multiple=True,
        help="Radius of the test functions in samples; repeat for more.  [default: by the spectrum of each trial]",
    ),
)

_METHOD = option(
    "Method",
    "--method",
    type=click.Choice(list(METHODS)),
    help="How the law is found: by the likelihood of whole trajectories, with standard errors; by regression on "
    "estimated derivatives; in the weak form; in discrete time.  [default: trajectory-likelihood, for hundreds "
    "of objects with long trials derivative-regression, for --order 0 discrete-time-regression; or the one whose "
    "options are given]",
)


def with_method(command: Callable[..., None]) -> Callable[..., None]:
    """Add --method and the options of all methods to a command; it receives them as `method`, None if none is given."""

    @wraps(command)
    def wrapped(*, method: str | None, order: "AskedOrder", **values: Any) -> None:
        likelihood, regression = _given(values, _LIKELIHOOD), _given(values, *_REGRESSIONS)
        if method is None and (likelihood or regression):
            method = _method_of(regression, order)
        made = None if method is None else _method(method, likelihood | regression, order)
        command(method=made, order=order, **values)

    return with_options(wrapped, (_METHOD, *_LIKELIHOOD_OPTIONS, *_REGRESSION_OPTIONS))


def with_likelihood(
    command: Callable[..., None], options: Sequence[Decorator] = _LIKELIHOOD_OPTIONS
) -> Callable[..., None]:
    """Add the likelihood's options to a command; it receives those that are given as `settings`."""

    @wraps(command)
    def wrapped(**values: Any) -> None:
        command(settings=_given(values, _LIKELIHOOD), **values)

    return with_options(wrapped, options)


with_comparison = partial(with_likelihood, options=_ERROR_OPTIONS)
"""Adds those of them that say what errors are: all that concerns evidence."""


def _given(values: dict[str, Any], *headings: str) -> dict[str, Any]:
    """Take the options under these headings out of a command's values, and return those that were given."""
    context = click.get_current_context()
    names = [str(each.name) for each in context.command.params if getattr(each, "group", None) in headings]
    taken = {name: values.pop(name) for name in names}
    given = {name: taken[name] for name in names if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    return given | ({"noise": numbers("--noise", given["noise"])} if "noise" in given else {})


def _method(name: str, given: dict[str, Any], order: "AskedOrder") -> "AbstractMethod":
    """Return the method of this name; options that it does not have are wrong usage."""
    from commonlaw import discovery

    classes: dict[str, Any] = {name: getattr(discovery, each) for name, each in METHODS.items()}
    takes = {name: {field.name for field in fields(each)} for name, each in classes.items()}
    able = [other for other, each in classes.items() if (order == 0) == (0 in each.orders)]
    for each in click.get_current_context().command.params:
        if each.name in given and each.name not in takes[name]:
            others = " or ".join(other for other in able if each.name in takes[other])
            instead = f", or use --method {others}" if others else ""
            raise click.UsageError(f"{each.opts[0]} does not go with --method {name}: leave it out{instead}")
    made: AbstractMethod = classes[name](**given)
    return made


def _method_of(regression: dict[str, Any], order: "AskedOrder") -> str:
    """Return the name of the method whose options are given."""
    if order == 0:
        return "discrete-time-regression"
    if "radii" in regression:
        return "weak-regression"
    return "derivative-regression" if regression else "trajectory-likelihood"


_law = partial(option, "Law")


class _Order(click.IntRange):
    """The order of a law, those of its states, or the word that leaves it to the measurements."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, str) and "=" in value:
            by_state: dict[str, Any] = {**by_name("--order", value.split(","))}
            return {state: super(_Order, self).convert(each, param, ctx) for state, each in by_state.items()}
        return value if value == "auto" else super().convert(value, param, ctx)


_LAW_OPTIONS = (
    _law(
        "--order",
        everyday=True,
        type=_Order(0, 2),
        metavar="ORDER",
        default="auto",
        help="Order of the law: 1 for x' = ..., 2 for x'' = ..., 0 for x[k+1] = ...; where equations differ by state, "
        "theta=2,i=1; auto for 1 where such a law fits within the noise, otherwise 1 or 2 for each state, by evidence; "
        "1 for streams and regressions.",
    ),
    _law(
        "--library",
        everyday=True,
        metavar="SPEC",
        default="auto",
        help="Candidate terms: poly:3, fourier:2, terms:1,v,v*abs(v), families with constants inside such as "
        "saturating, sums such as 'poly:2 + saturating', ratios of sums as in 'ratio(poly:2, poly:2)', or auto for "
        "poly:3, and for all of these where it shows lack of fit; poly:3 only for streams and regressions.",
    ),
    _law(
        "--known",
        metavar="TERM=VALUE",
        type=ReadLaw(),
        multiple=True,
        help="A known coefficient, 1=-9.8; with several states say the equation, x:1=-9.8; repeat for more. Or a base, "
        "and the law is what is left: an equation with numbers, \"x'' = -9.8\", or a law, LAW.json.",
    ),
    _law(
        "--universal",
        metavar="TERM",
        multiple=True,
        help="A term with one coefficient for all objects: 1 for gravity; with several states x:1; repeat for more.",
    ),
    _law(
        "--unmeasured",
        type=click.IntRange(0, 1),
        default=0,
        help="1 to also search for a latent state, such as a depot, a compartment, or a drive. Goes with "
        "trajectory-likelihood.",
    ),
    _law(
        "--explain",
        is_flag=True,
        help="Say what in the law is universal, what follows the objects' properties, and what is each object's own.",
    ),
    _law(
        "--no-cache",
        is_flag=True,
        help="Find the law anew, even if the same was asked of the same trials before, and keep it nowhere.",
    ),
)


@dataclass(frozen=True)
class Question:
    """What these options say."""

    order: "AskedOrder"
    library: str
    known: tuple[str, ...]
    universal: tuple[str, ...]
    unmeasured: int
    explain: bool
    no_cache: bool
    method: "AbstractMethod | None"

    def answer(self, training: "Trials | TrialStream", show: Callable[[str], None]) -> "Law":
        """Return the law of trials; `show` takes the text of each step."""
        import commonlaw as cl

        return cl.discover(
            training,
            order=self.order,
            library=self.library,
            method=self.method,
            known=_known_physics(self.known),
            universal=[_key(name) for name in self.universal],
            unmeasured=self.unmeasured,
            progress=show,
            cache=not self.no_cache,
        )

    def explained(self, law: "Law", show: Callable[[str], None], later: LaterSteps) -> "Law":
        """Return the law with what decides its coefficients if that is asked for and can be said."""
        if not self.explain:
            return law
        show("explaining coefficients")
        return later.take("the coefficients were not explained", law.explain, law)


with_question = as_one("question", Question, (*_LAW_OPTIONS, with_method))
"""Adds the options of the law and of the methods to a command, which receives them as `question`."""


def _known_physics(texts: Sequence[str]) -> "Base":
    """Return what is known: coefficients by term, equations, or the law in a file."""
    from commonlaw.law import Law

    if len(texts) == 1 and is_law_file(texts[0]):
        return Law.load(texts[0])
    if any(set("'[") & set(each.partition("=")[0]) for each in texts):
        return "; ".join(texts)
    return {_key(name): value for name, value in numbers("--known", texts).items()}


def _key(name: str) -> str | tuple[str, str]:
    """Return a term, or state and term of ``state:term``."""
    state, colon, term = name.partition(":")
    return (state, term) if colon else name
