"""What can be set about a fit of trajectories: each setting once, with all that is shown of it anywhere.

A new setting is a field here and an argument of each function that takes it. Options of commands, the form of the app,
generated programs, the key of the cache and the tables of the documentation follow.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields
from inspect import cleandoc
from numbers import Real
from textwrap import wrap
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin

from commonlaw.errors import CommonlawError, check_choice
from commonlaw.runtime.arguments import check_types, check_whole_number
from commonlaw.runtime.parallel import check_n_jobs

if TYPE_CHECKING:
    from commonlaw.solvers import AbstractSolver

ErrorKind = Literal[
    "white",
    "proportional",
    "by-object",
    "by-trial",
    "autocorrelated",
    "sensor-walk",
    "drift",
    "random-walk",
    "gp-forcing",
]
CovarianceKind = Literal["likelihood", "bootstrap"]

T = TypeVar("T")

FUNCTIONS = ("discover", "fit", "refine", "compare")
"""What takes settings; `discover` by its method, `TrajectoryLikelihood`."""

_SAME = object()
"""Stands for the default of the field."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What is shown of a setting, and what it may be.

    Parameters
    ----------
    label
        Names it in a form.
    text
        Documents it; a form shows the first sentence.
    metavar
        Stands for a value in the help of a command.
    choices
        The values that it can have, each with its meaning; any by default.
    check
        Refuses other values that do not fit, by its name and a value.
    functions
        What takes it, of `FUNCTIONS`.
    of_given_law
        The default of functions that are given a law or its equations, where it is another one.
    everyday
        Whether commands have an option of its own for it.
    """

    label: str
    text: str
    metavar: str = "VALUE"
    choices: Mapping[str, str] = field(default_factory=dict)
    check: Callable[[str, Any], None] = lambda *_: None
    functions: Sequence[str] = ("discover", "fit", "refine")
    of_given_law: object = _SAME
    everyday: bool = False

    def default_of(self, function: str, default: object) -> object:
        """Return the default of a function, where `default` is that of the field."""
        return default if function == "discover" or self.of_given_law is _SAME else self.of_given_law


def setting(*, default: Any, compare: bool = True, **about: Any) -> Any:
    """Return a field of a dataclass of settings, see `Setting`."""
    return field(default=default, compare=compare, metadata={Setting: Setting(**about)})


def settings_of(options: type, function: str = "discover") -> dict[str, tuple[Field[Any], Setting]]:
    """Return the settings that a function takes, by name and in order, of a dataclass of settings."""
    settings = {
        attribute.name: (attribute, attribute.metadata[Setting])
        for attribute in fields(options)
        if Setting in attribute.metadata
    }
    return {name: pair for name, pair in settings.items() if function in pair[1].functions}


def read_settings(options: type, texts: Mapping[str, Sequence[str]], function: str = "discover") -> dict[str, Any]:
    """Return the values that texts say, by name of a setting: several texts for what holds several values.

    Raises `CommonlawError` if there is no such setting, or a text is no value of its type.

    Examples
    --------
    >>> read_settings(FitOptions, {"noise": ["x=0.1", "y=0.2"], "partial_pooling": ["false"], "seed": ["3"]})
    {'noise': {'x': 0.1, 'y': 0.2}, 'partial_pooling': False, 'seed': 3}
    """
    known, result = settings_of(options), dict[str, Any]()
    for name, given in texts.items():
        check_choice("setting", name, known)
        result[name] = _value(name, known[name][0].type, given, function == "fit")
    return result


def _value(name: str, annotation: Any, texts: Sequence[str], properties: bool) -> Any:
    """Return the value of a type that texts say; levels by name may be names of `properties`."""
    union = get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    kinds = [get_origin(kind) or kind for kind in union if kind is not NoneType]
    if Sequence in kinds:
        return tuple(texts)
    if tuple in kinds:
        return tuple(_number(name, text) for text in texts)
    if Mapping in kinds:
        named = dict[str, float | str]()
        for key, _, value in (text.partition("=") for text in texts):
            if key.strip() in named:
                raise CommonlawError("setting-twice", name=f"{name} of {key.strip()}")
            is_name = properties and value.strip().isidentifier()
            named[key.strip()] = value.strip() if is_name else _number(name, value)
        return named
    if len(texts) > 1:
        raise CommonlawError("setting-twice", name=name)
    (text,) = texts
    if bool in kinds:
        check_choice(name, text, ("true", "false"))
        return text == "true"
    if int in kinds or float in kinds:
        number = _number(name, text)
        return int(number) if int in kinds and number.is_integer() else number
    return text


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise CommonlawError("setting-not-a-number", name=name, value=text) from None


def documented(cls: type[T]) -> type[T]:
    """Write the settings of a dataclass into its docstring."""
    lines = list[str]()
    for name, (attribute, about) in settings_of(cls).items():
        choices = "".join(f" ``{value!r}``: {meaning}." for value, meaning in about.choices.items())
        default = f" Default: {attribute.default!r}." if attribute.default not in (None, ()) else ""
        lines += [name, *(f"    {line}" for line in wrap(f"{about.text}{choices}{default}", 112))]
    if cls.__doc__:
        cls.__doc__ = cleandoc(cls.__doc__).replace("{parameters}", "\n".join(lines))
    return cls


def setting_rows(options: type, function: str = "discover") -> Iterator[tuple[str, str, str]]:
    """Yield name, default and documentation of each setting that a function takes, as tables show them."""
    for name, (attribute, about) in settings_of(options, function).items():
        default = shown_value(about.default_of(function, attribute.default))
        choices = "; ".join(f"{value}: {meaning}" for value, meaning in about.choices.items())
        yield name, default, f"{about.text} {choices}".strip()


def shown_value(value: object) -> str:
    """Return a value as `read_settings` reads it; nothing where there is none."""
    if value is None or value == ():
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


MIN_HUBER_THRESHOLD = 3.0
"""Below, many measurements without fault are outliers, and noise and standard errors, without these, are too small."""


def _check_huber_threshold(_: str, value: object) -> None:
    if not isinstance(value, Real) or not float(value) >= MIN_HUBER_THRESHOLD:
        raise CommonlawError("huber-threshold", value=value)


def _check_noise(_: str, value: object) -> None:
    if not isinstance(value, Mapping):
        raise CommonlawError("noise-not-by-state", value=value)


@documented
@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """What can be set about a fit of trajectories: the fields of `TrajectoryLikelihood`.

    `fit` and `refine` take those as arguments that do not concern a search, `compare` those of the errors.

    Raises `CommonlawError` if a text names nothing, or a value does not fit.

    Parameters
    ----------
    {parameters}
    """

    log_states: Sequence[str] = setting(
        default=(),
        label="Log-scaled states",
        metavar="STATE",
        of_given_law=None,
        text="States above zero that are modelled on a logarithmic scale, in laws of first order: their noise is a "
        "share of the state (0.05 is 5 %), and forecasts and bands stay above zero. The law itself is in the units "
        "of the states. `refine` keeps those of the law by default.",
    )
    input_interpolation: str = setting(
        default="auto",
        label="Input interpolation",
        of_given_law=None,
        choices={
            "auto": "steps where inputs stay at levels, otherwise jumps where there are any, a spline where inputs are "
            "smooth, or lines, unless the evidence for another is strong",
            "held": "the earlier value, as a controller does",
            "linear": "on lines",
            "cubic": "on a cubic spline",
            "jumps": "on cubic splines between jumps, each at an unknown time between two samples",
        },
        text="Interpolation of inputs between samples. See `Law.predict`; `refine` keeps that of the law by default.",
    )
    noise: Mapping[str, float] | None = setting(
        default=None,
        label="Measurement noise",
        metavar="STATE=VALUE",
        check=_check_noise,
        functions=FUNCTIONS,
        everyday=True,
        text="Known standard deviation of each state's measurement noise, in the state's unit. It is estimated by "
        "default, but for states whose measurements have standard deviations of their own (`noise_columns`).",
    )
    errors: ErrorKind | Literal["auto"] = setting(
        default="auto",
        label="Errors",
        functions=FUNCTIONS,
        choices={
            "auto": "white noise, unless 2 log B > 10 for another kind",
            "white": "white noise only; in `fit`, `refine` and `compare` by least squares",
            "proportional": "heteroscedastic noise, which grows with the state",
            "by-object": "noise that differs between objects",
            "by-trial": "noise that differs between trials",
            "autocorrelated": "autocorrelated measurement errors",
            "sensor-walk": "a random walk of the sensor in each trial",
            "drift": "a drift of the sensor, an offset and a slope in time of each trial",
            "random-walk": "process noise, a random walk of the law",
            "gp-forcing": "process noise, a smooth force on the law (a Gaussian process)",
        },
        text="Kind of the errors that are estimated with the law.",
    )
    huber_threshold: float = setting(
        default=4.0,
        label="Outlier threshold [SD of noise]",
        metavar="NUMBER",
        functions=FUNCTIONS,
        check=_check_huber_threshold,
        text="Residual, in standard deviations of noise, beyond which a measurement is an outlier, at least 3; "
        "inf for none. Outliers count linearly instead of squared in a search (Huber 1964) and among autocorrelated "
        "errors, and have no weight in the final fit.",
    )
    covariance: CovarianceKind = setting(
        default="likelihood",
        label="Standard errors",
        choices={
            "likelihood": "from the curvature of the likelihood",
            "bootstrap": "from refits to resampled blocks of the trials, for noise that is not normal",
        },
        text="How the coefficients' covariance is found.",
    )
    partial_pooling: bool = setting(
        default=True,
        label="Partial pooling",
        of_given_law=False,
        text="Whether forecasts shrink coefficients to their mean over objects as far as these are alike. The law "
        "itself has those of each object's own trials, see `commonlaw.law.pool_objects`.",
    )
    solver: "AbstractSolver | str | None" = setting(
        default=None,
        label="Solver",
        metavar="SPEC",
        functions=("discover",),
        text="Whose path lists the candidates of each equation, best-subset by default; without a value of its "
        "hyperparameter, as the evidence chooses.",
    )
    max_samples: int = setting(
        default=50_000,
        label="Sample limit",
        metavar="NUMBER",
        functions=("discover",),
        check=lambda name, value: check_whole_number(name, value, 100, 10**9),
        text="Largest number of samples that are fitted. More are thinned as far as these still distinguish noise "
        "from motion, and if that is not enough, fitted in segments spread over the trials of each object; the law "
        "says so, and the noise is estimated from all.",
    )
    strange_objects: Literal["exclude", "keep"] = setting(
        default="exclude",
        label="Strange objects",
        functions=("discover",),
        choices={
            "exclude": "objects that contradict the law of the others are named and left out",
            "keep": "one law of all objects",
        },
        text="What becomes of objects that do not follow the law of the others, less than a third of four or more.",
    )
    latent_states: int = setting(
        default=0,
        label="Latent states",
        metavar="0|1",
        functions=("discover",),
        check=lambda name, value: check_whole_number(name, value, 0, 1),
        text="Number of latent states that are searched for, 0 or 1. A depot or a drive that decays, a pool that "
        "is used up, one that keeps what it gets, a compartment; in laws with an equation of second order a drive. "
        "The law without it is one of the hypotheses.",
    )
    seed: int = setting(
        default=0,
        label="Seed",
        metavar="NUMBER",
        check=lambda name, value: check_whole_number(name, value, 0),
        text="Seed of the bootstrap.",
    )
    n_jobs: int = setting(
        default=-1,
        compare=False,
        label="Threads",
        metavar="NUMBER",
        functions=FUNCTIONS,
        check=lambda _, value: check_n_jobs(value),
        text="Threads that share the work; -1 for one each core, or as many as the environment variable "
        "OMP_NUM_THREADS says. Results are the same for any number.",
    )

    def __post_init__(self) -> None:
        check_settings("discover", vars(self))
        check_types(FitOptions, vars(self))


def check_settings(function: str, values: Mapping[str, Any]) -> None:
    """Refuse values of the settings of a function that do not fit, among its arguments by name.

    Raises `CommonlawError` if a value is none of the choices, or outside of its bounds.
    """
    for name, (attribute, about) in settings_of(FitOptions, function).items():
        if values[name] is about.default_of(function, attribute.default):
            continue
        if about.choices:
            check_choice(name, values[name], about.choices)
        about.check(name, values[name])
    if values["errors"] in ("by-object", "by-trial") and values["noise"] is not None:
        raise CommonlawError("noise-by-group-given", errors=values["errors"])


def changed_settings(function: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of the arguments of a function, by name, that are not the default of their setting."""
    known = settings_of(FitOptions, function)
    defaults = {name: about.default_of(function, attribute.default) for name, (attribute, about) in known.items()}
    return {name: value for name, value in values.items() if value != defaults.get(name)}
