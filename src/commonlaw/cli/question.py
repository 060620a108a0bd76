"""The options that say which law is sought and how: settings of fits, methods, terms and what is known."""

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from commonlaw.cli.options import (
    Decorator,
    ReadFile,
    ReadLaw,
    as_one,
    by_name,
    is_of_kind,
    numbers,
    option,
    pairs,
    taking,
)
from commonlaw.cli.output import Artifacts, say
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.runtime.fit_options import FitOptions, read_settings, setting_rows, settings_of, shown_value
from commonlaw.runtime.time_limit import DEFAULT_TIME_LIMIT, stopped_by_interrupts

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

_SEARCH = "Settings of a fit, --set NAME=VALUE"


def _settings_help(function: str, options: type) -> dict[str, list[tuple[str, str]]]:
    """Return the settings of a function by headings, each with its documentation and default."""
    if function != "discover":
        return {_SEARCH: _rows(options, function)}
    rows_by_title = {f"{_SEARCH}, --method trajectory-likelihood": _rows(options, function)}
    for name, method in _methods().items():
        taken = {row for rows in rows_by_title.values() for row, _ in rows}
        if name != "trajectory-likelihood":
            rows = [row for row in _rows(method, function) if row[0] not in taken]
            rows_by_title[f"Settings of --method {name}"] = rows
    return {title: rows for title, rows in rows_by_title.items() if rows}


def _rows(options: type, function: str) -> list[tuple[str, str]]:
    rows = setting_rows(options, function)
    return [(name, f"{text}{f'  [default: {default}]' if default else ''}") for name, default, text in rows]


def _methods() -> dict[str, Any]:
    from commonlaw import discovery

    return {name: getattr(discovery, class_name) for name, class_name in METHODS.items()}


def setting_options(function: str, options: type = FitOptions) -> list[Decorator]:
    """Return the options of a command for the settings that a function takes: everyday ones, and one for any."""
    made = partial(option, group="Method", everyday=True)
    result = list[Decorator]()
    for name, (field, about) in settings_of(options, function).items():
        if about.everyday:
            default = shown_value(about.default_of(function, field.default))
            help = f"{about.text}{f'  [default: {default}]' if default else ''}"
            result.append(made(f"--{name.replace('_', '-')} {about.metavar}", help, name, multiple=True))
    text = "A setting of the fit by its name, such as errors=white, of those that --help-all lists"
    rows = partial(_settings_help, function, options)
    return [*result, made("--set NAME=VALUE...", text, "settings", settings=rows)]


def given_settings(values: dict[str, Any], function: str) -> dict[str, list[str]]:
    """Take the texts of settings out of a command's values, by name."""
    result = dict[str, list[str]]()
    for name, (_, about) in settings_of(FitOptions, function).items():
        if about.everyday and (texts := values.pop(name)):
            result[name] = list(texts)
    for name, text in pairs("--set", values.pop("settings")):
        result.setdefault(name, []).append(text)
    return result


def with_settings(function: str) -> Decorator:
    """Return the decorator that adds the settings of a fit; a command receives those that are given as `settings`."""

    def convert(values: dict[str, Any]) -> dict[str, Any]:
        texts = given_settings(values, function)
        for name in texts:
            check_choice("setting", name, settings_of(FitOptions, function))
        return {"settings": _read(FitOptions, texts, function), **values}

    return taking(setting_options(function), convert)


def _read(options: type, texts: dict[str, list[str]], function: str = "discover") -> dict[str, Any]:
    try:
        return read_settings(options, texts, function)
    except CommonlawError as error:
        raise click.UsageError(error.sentence()) from None


_METHOD = option(
    "--method",
    "How the law is found: by the likelihood of whole trajectories, with standard errors; by regression on estimated "
    "derivatives; in the weak form; in discrete time.  [default: trajectory-likelihood, for hundreds of objects with "
    "long trials derivative-regression, for --order 0 discrete-time-regression; or the one whose settings are given]",
    group="Method",
    type=click.Choice(list(METHODS)),
)


def _chosen_method(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a command with the `method` of its settings, None if none is given.

    Where each of several files is worked on by itself, so many at a time as ``n_jobs`` says, there are `processes`.
    """
    texts, method, order = given_settings(values, "discover"), values["method"], values["order"]
    jobs = _read(FitOptions, {"n_jobs": texts.pop("n_jobs")} if values["each"] and "n_jobs" in texts else {})
    values["processes"] = FitOptions(**jobs).n_jobs if jobs.get("n_jobs", -1) != -1 else None
    methods = _methods()
    takes = {name: settings_of(options) for name, options in methods.items()}
    if method is None and texts:  # That whose settings are given
        needs_regression = any(name == "solver" or name not in takes["trajectory-likelihood"] for name in texts)
        method = "derivative-regression" if needs_regression else "trajectory-likelihood"
        method = "weak-regression" if "radii" in texts else method
        method = "discrete-time-regression" if order == 0 else method
    for name in texts:
        others = [candidate for candidate in methods if name in takes[candidate]]
        if others and method not in others:
            able = " or ".join(candidate for candidate in others if (order == 0) == (0 in methods[candidate].orders))
            instead = f", or use --method {able}" if able else ""
            raise click.UsageError(f"the setting {name} does not go with --method {method}: leave it out{instead}")
    return values | {"method": None if method is None else methods[method](**_read(methods[method], texts))}


with_method = taking((_METHOD, *setting_options("discover")), _chosen_method)
"""Adds --method and the settings of all methods to a command; it receives `method`, and with --each `processes`."""


_law = partial(option, group="Law")


class _Order(click.IntRange):
    """The order of a law, those of its states, or the word that leaves it to the measurements."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, str) and "=" in value:
            by_state: dict[str, Any] = {**by_name("--order", value.split(","))}
            return {state: super(_Order, self).convert(order, param, ctx) for state, order in by_state.items()}
        return value if value == "auto" else super().convert(value, param, ctx)


def _time_limit(text: str) -> float:
    """Return seconds, such as 90 or 90s, or no limit."""
    if text.lower() == "none":
        return math.inf
    try:
        seconds = float(text.removesuffix("s"))
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds < math.inf:
        raise click.BadParameter(f"{text!r} is no time: give seconds such as 60s, or none")
    return seconds


def _say_stopping() -> None:
    say("commonlaw: stopping with the best law so far; Ctrl-C again ends the command at once", err=True)


_LAW_OPTIONS = (
    _law(
        "--order ORDER",
        "Order of the law: 1 for x' = ..., 2 for x'' = ..., 0 for x[k+1] = ...; where equations differ by "
        "state, theta=2,i=1; auto for 1 where such a law fits within the noise, otherwise 1 or 2 for each "
        "state, by evidence; 1 for streams and regressions.",
        everyday=True,
        type=_Order(0, 2),
        default="auto",
    ),
    _law(
        "--library SPEC",
        "Candidate terms: poly:3, fourier:2, terms:1,v,v*abs(v), which may hold properties of the objects, "
        "families with parameters inside such as saturating, sums such as 'poly:2 + saturating', ratios of "
        "sums as in 'ratio(poly:2, poly:2)', or auto for poly:3, and for all of these where it shows lack of "
        "fit; poly:3 only for streams and regressions.",
        everyday=True,
        default="auto",
    ),
    _law(
        "--known TERM=VALUE...",
        "A known coefficient, 1=-9.8; with several states say the equation, x:1=-9.8; repeat for more. Or a "
        "base, and the law is what is left: an equation with numbers, \"x'' = -9.8\", or a law, LAW.json",
        type=ReadLaw(),
    ),
    _law("--shared TERM...", "A term with one coefficient for all objects: 1 for gravity; with several states x:1"),
    _law("--observe EQUATION...", 'What a column measures in place of a state, "y = s (x + z) + b"'),
    _law("--latent NAME...", "A state without a column, one for each --observe: z"),
    _law(
        "--explain",
        "Say what in the law is shared, what follows the objects' properties, and what is each object's own.",
        is_flag=True,
    ),
    option(
        "--time-limit SECONDS",
        "Time after which a search by trajectory-likelihood ends with the best law so far, and says what it has not "
        "tried; so does the first Ctrl-C. none for no limit: the law then does not depend on the machine.  "
        f"[default: {DEFAULT_TIME_LIMIT:g}s; none for streams and other methods]",
        group="Method",
        everyday=True,
        type=_time_limit,
    ),
    option(
        "--resume LAW.json",
        "Go on with the search that was stopped with this law, in the same table, with its options of law and method",
        group="Method",
        type=ReadFile(),
    ),
)


@dataclass(frozen=True)
class Question:
    """What these options say."""

    order: "AskedOrder"
    library: str
    known: tuple[str, ...]
    shared: tuple[str, ...]
    observe: tuple[str, ...]
    latent: tuple[str, ...]
    explain: bool
    time_limit: float | None
    resume: str | None
    method: "AbstractMethod | None"

    def answer(self, training: "Trials | TrialStream", show: Callable[[str], None]) -> "Law":
        """Return the law of trials; `show` takes the text of each step.

        A search that can be limited ends with the best law so far at the first Ctrl-C.
        """
        import commonlaw as cl

        of_likelihood = self.method is None or isinstance(self.method, cl.TrajectoryLikelihood)
        can_be_limited = of_likelihood and isinstance(training, cl.Trials) and not (self.observe or self.latent)
        seconds = DEFAULT_TIME_LIMIT if self.time_limit is None and can_be_limited else self.time_limit
        with stopped_by_interrupts(_say_stopping) if can_be_limited else nullcontext():
            return cl.discover(
                training,
                order=self.order,
                library=self.library,
                method=self.method,
                known=_known_physics(self.known),
                shared=[_key(name) for name in self.shared],
                observe=dict(pairs("--observe", self.observe)),
                latent_states=self.latent,
                progress=show,
                time_limit=None if seconds == math.inf else seconds,
                resume=None if self.resume is None else cl.Law.load(self.resume),
            )

    def explained(self, law: "Law", show: Callable[[str], None], later: Artifacts) -> "Law":
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

    if len(texts) == 1 and is_of_kind(texts[0], "law"):
        return Law.load(texts[0])
    if any(set("'[") & set(text.partition("=")[0]) for text in texts):
        return "; ".join(texts)
    return {_key(name): value for name, value in numbers("--known", texts).items()}


def _key(name: str) -> str | tuple[str, str]:
    """Return a term, or state and term of ``state:term``."""
    state, colon, term = name.partition(":")
    return (state, term) if colon else name
