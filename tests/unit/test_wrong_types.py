"""Arguments of wrong types are refused by name: a walk over the signatures of everything public."""

import inspect
import itertools
from functools import cache, partial
from typing import Any, NamedTuple, get_args

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl

TIMES = np.linspace(0, 2, 12)
TRIALS = cl.Trials.from_arrays(TIMES, np.exp(-TIMES), names=["x"])
FRAME = pd.DataFrame({"t": TIMES, "x": np.exp(-TIMES)})

NEVER_RIGHT = object()
WRONG = (NEVER_RIGHT, None, 5, "zz", [], float("nan"), True, -1, 10**9, b"x", [None], {}, FRAME)
EXPENSIVE = ("Law.report", "Law.assess", "Law.discrepancy", "Law.simplify", "LawDiscovery.fit", "design", "discover")
"""What works on values that fit; without the slow tests they get the value that never does."""

METHODS_OF = ("Forecast", "Law", "LawDiscovery", "Schema", "TrialStream", "Trials")
MODULES = ("datasets", "differentiation", "law", "library", "plots", "solvers")
VERBS_OF = ("datasets.", "law.", "plots.", "library.parse_library", "solvers.parse", "differentiation.parse")
"""Functions of modules that users call; the others work on arrays and terms."""
MADE = (
    "BestSubset", "DerivativeRegression", "DiscreteTimeRegression", "Event", "FitOptions", "FourierLibrary", "Lasso",
    "MedianFilter", "PolynomialLibrary", "Quantile", "SR3", "STLSQ", "SavitzkyGolay", "Schema", "SmoothingSpline",
    "StepwiseSelection", "TrajectoryLikelihood", "Trials", "WeakRegression",
)  # fmt: skip
"""Classes that users make."""


class WorkBeganError(Exception):
    """Raised by the first report of progress."""


def begin(*_):
    raise WorkBeganError


@cache
def law():
    return cl.fit("x' = -k x", TRIALS)


def stream(folder):
    TRIALS.to_parquet(folder / "t.parquet")
    return cl.TrialStream.from_parquet(folder / "t.parquet")


RIGHT = {
    "trials": lambda _: TRIALS,
    "law": lambda _: law(),
    "laws": lambda _: [law()],
    "equations": lambda _: "x' = -k x",
    "times": lambda _: TIMES,
    "initial": lambda _: [1.0],
    "states": lambda _: np.exp(-TIMES),
    "frame": lambda _: FRAME,
    "stream": stream,
    "other": stream,
    "time": lambda _: 1.0,
    "name": lambda _: "object",
    "object": lambda _: "object",
    "measured": lambda _: TRIALS,
    "forecast": lambda _: law().predict(TRIALS),
    "residuals": lambda _: law().residuals(TRIALS),
    "expression": lambda _: "x",
    "text": lambda _: "lorenz",
    "content": lambda _: cl.law.to_json(law()),
    "objects": lambda _: ["object"],
    "parameter": lambda _: "k",
    "path": lambda folder: folder / "law.json",
    "progress": lambda _: begin,
}
"""Values of arguments that fit, by name; `RIGHT_OF` has those of a function where they differ."""

RIGHT_OF = {
    "Law.from_text": {"values": lambda _: {"k": 1.0}},
    "Law.rhs": {"values": lambda _: [[1.0]]},
    "Schema": {"states": lambda _: ("x",)},
    "Trials.read": {"path": lambda folder: folder / "t.csv"},
    "Trials.to_csv": {"path": lambda folder: folder / "out.csv"},
    "Trials.to_parquet": {"path": lambda folder: folder / "out.parquet"},
    "Trials.with_properties": {"values": lambda _: {"object": {"m": 1.0}}},
    "Trials.with_trials": {"trials": lambda _: TRIALS.trials},
    "TrialStream.from_parquet": {"path": lambda folder: folder / "t.parquet"},
    "design": {"vary": lambda _: {"x": (0.5, 2.0)}, "points": lambda _: 16},
    "law.contrasts": {"by": lambda _: "m"},
    "library.parse_library": {"given": lambda _: "poly:1"},
    "plots.plot_design": {"design": lambda _: cl.design(law(), {"x": (0.5, 2.0)}, trials=TRIALS, points=16)},
    "plots.plot_discrepancy": {"found": lambda _: law().discrepancy(TRIALS)},
    "plots.plot_textbook": {"textbook": lambda _: law().textbook(TRIALS)},
    "datasets.load": {"name": lambda _: "lorenz"},
    "plots.save_figure": {"figure": lambda _: cl.plots.plot_trials(TRIALS), "path": lambda folder: folder / "x.svg"},
    "plots.render": {"figure": lambda _: cl.plots.plot_trials(TRIALS), "path": lambda folder: folder / "x.svg"},
}

OF_CLASS = {
    "Forecast": lambda _: law().predict(TRIALS),
    "Law": lambda _: law(),
    "LawDiscovery": lambda _: cl.LawDiscovery(),
    "Schema": lambda _: TRIALS.schema,
    "TrialStream": stream,
    "Trials": lambda _: TRIALS,
}
"""Of each class with methods, an instance."""


ALIASES = {
    "LawDiscovery.fit": "x_dot",
    "datasets.truth_of": "data set",
    "datasets.load": "data set",
    "library.parse_library": "library",
}
"""Names that messages have for an argument of a function."""


def public():
    """Yield the name of every function and method that users call, and of every class that they make."""
    for module in ("", *MODULES):
        owner = getattr(cl, module) if module else cl
        for name in owner.__all__:
            value, label = getattr(owner, name), f"{module}.{name}" if module else name
            if label == "plots.plot_library":  # Of a formulation, for developers
                continue
            is_verb = inspect.isfunction(value) and (not module or label.startswith(VERBS_OF))
            if is_verb or name in MADE:
                yield label
    for name in METHODS_OF:
        for method, value in vars(getattr(cl, name)).items():
            if (
                not method.startswith("_")
                and method != "get_params"
                and (inspect.isfunction(value) or isinstance(value, classmethod))
            ):
                yield f"{name}.{method}"


class Argument(NamedTuple):
    """An argument that a function takes: what it may be, whether by its place only, and whether it must be given."""

    name: str
    annotation: Any
    by_place: bool = False
    is_needed: bool = False


def arguments_of(function):
    """Yield the arguments of a function, those of a mapping of keywords by their keys."""
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is parameter.VAR_KEYWORD:
            for mapping in get_args(parameter.annotation):
                yield from itertools.starmap(Argument, mapping.__annotations__.items())
            continue
        if parameter.name == "_":
            continue
        by_place = parameter.kind in (parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY)
        is_needed = parameter.default is parameter.empty and parameter.kind is not parameter.VAR_POSITIONAL
        yield Argument(parameter.name, parameter.annotation, by_place, is_needed or parameter.name == "progress")


def outcome(call):
    """Return how a call ended: done, or the error of commonlaw; any other is a fault."""
    try:
        call()
    except WorkBeganError:
        return "work began"
    except cl.CommonlawError as error:
        return error
    except TypeError as error:
        if "missing" in str(error):
            return "missing"
        raise
    return "done"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("types")
    FRAME.to_csv(path / "t.csv", index=False)
    TRIALS.to_parquet(path / "t.parquet")
    law().save(path / "law.json")
    return path


def check(label, folder, wrong):
    owner, _, name = label.rpartition(".")
    function = getattr(OF_CLASS[owner](folder) if owner in OF_CLASS else getattr(cl, owner) if owner else cl, name)
    right = RIGHT | RIGHT_OF.get(label, {})
    arguments = [*arguments_of(function)]
    needed = {argument.name: right[argument.name](folder) for argument in arguments if argument.is_needed}
    for argument in arguments:
        for value in wrong:
            named = needed | {argument.name: value}
            placed = (named.pop(argument.name),) if argument.by_place else ()
            ended = outcome(partial(function, *placed, **named))
            # What is in quotes is for type checkers alone
            if value is NEVER_RIGHT and not (
                argument.annotation in (Any, object) or isinstance(argument.annotation, str)
            ):
                assert isinstance(ended, cl.CommonlawError), argument
            if isinstance(ended, cl.CommonlawError) and ended.code == "argument-type":
                assert str(ended.parameters["name"]).endswith(ALIASES.get(label, argument.name))  # "item 1 of ..."


@pytest.fixture(autouse=True)
def within(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COMMONLAW_CACHE", "off")


@pytest.mark.parametrize("label", [*public()])
def test_what_is_of_the_wrong_type_is_refused_in_words(label, folder):
    check(label, folder, WRONG[:1] if label in EXPENSIVE else WRONG)


@pytest.mark.slow
@pytest.mark.parametrize("label", EXPENSIVE)
def test_whatever_verbs_that_take_long_are_given_they_end_in_words(label, folder):
    check(label, folder, WRONG)
