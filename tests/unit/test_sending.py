"""Whatever is public survives a process border and a copy: every type, and every kind of result."""

import copy
import inspect
import pickle
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache, cached_property
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import note
from commonlaw.differentiation import Rates, TotalVariationDerivative
from commonlaw.estimation import likelihood_profile
from commonlaw.formulation import CompressedTrials, GivenForm, StrongForm, rows_by_object
from commonlaw.inference import candidate_laws
from commonlaw.library import Ratio, Variables, parse_library
from commonlaw.library.libraries import CappedLibrary, ReducedLibrary, SelectedLibrary
from commonlaw.plots import ForecastPanels, IntervalPanels, ResidualPanels
from commonlaw.runtime.progress import Stage
from commonlaw.solvers import STLSQ, Candidate, ConstrainedSolver

pytestmark = pytest.mark.xdist_group("sending")  # One worker has all results

TIMES = np.linspace(0.0, 6.0, 30)
DECAY = 2 * np.exp(-0.5 * TIMES)
MASSES = {"a": 1.0, "b": 2.0, "c": 3.0}


def public_modules() -> list[ModuleType]:
    return [cl, *(getattr(cl, name) for name in dir(cl) if isinstance(getattr(cl, name), ModuleType))]


def public_values() -> list[object]:
    """Return all that users can name: types, functions, tables and values."""
    return [getattr(module, name) for module in public_modules() for name in dir(module) if name[0] != "_"]


def public_types() -> set[type]:
    """Return the types of commonlaw that users can name and that instances can have."""
    return {
        value
        for value in public_values()
        if isinstance(value, type) and value.__module__.startswith("commonlaw.") and not inspect.isabstract(value)
    }


def attributes(value: object) -> Iterator[object]:
    """Yield what a value of commonlaw consists of, with all that it keeps once it was asked for."""
    for name in dir(type(value)):
        if isinstance(inspect.getattr_static(type(value), name), cached_property):
            try:
                getattr(value, name)
            except cl.CommonlawError:  # Not every law has every property
                continue
    yield from getattr(value, "__dict__", {}).values()


def parts(result: object) -> list[object]:
    """Return the values of commonlaw within a result, of each type the first two."""
    waiting, kept, counts = [result], [], Counter[type]()
    while waiting:
        value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [*value.keys(), *value.values()]
        elif isinstance(value, list | tuple | set | frozenset):
            waiting += value
        if type(value).__module__.startswith("commonlaw.") and counts[type(value)] < 2:
            counts[type(value)] += 1
            kept.append(value)
            waiting += attributes(value)
    return kept


def measured(*columns: object, **arguments: object) -> cl.Trials:
    """Return a trial with noise for each column."""
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(TIMES))
    return cl.Trials.from_arrays([TIMES] * len(columns), [column + noise for column in columns], **arguments)


@cache
def of_objects() -> cl.Trials:
    trials = measured(*(2 * np.exp(-0.5 / mass * TIMES) for mass in MASSES.values()), object=[*MASSES], names=["x"])
    return trials.with_properties({name: {"mass": mass} for name, mass in MASSES.items()})


@cache
def decay(name: str = "x") -> cl.Trials:
    return measured(DECAY, names=[name])


@cache
def law() -> cl.Law:
    return cl.fit("x' = -k x", of_objects()).explain()


@cache
def observed() -> cl.Law:
    return cl.fit("x' = -k x; signal = c x; x(0) = 1", decay("signal"))


def switched_on() -> cl.Trials:
    response = np.where(TIMES > 2, 1 - np.exp(2 - TIMES), 0)
    return measured(response, inputs=[1.0 * (TIMES > 1)], names=["x", "u"])


FORM = StrongForm(cl.differentiation.FiniteDifference())
TERMS = parse_library("poly:2").bind(Variables(("x",)))
LIBRARIES = (
    "poly:2 + fourier:1", "poly:1 * saturating", "ratio(poly:1, poly:1)", "rational:2:1+x**2", "constant", "auto",
    "terms:x**2", "poly:1 + terms:x/(K+x)",
)  # fmt: skip


@cache
def result(kind: str) -> Any:
    return RESULTS[kind]()


RESULTS: dict[str, Callable[[], Any]] = {
    "tables of names": lambda: [value for value in public_values() if isinstance(value, Mapping)],
    "terms": lambda: cl.fit("x' = -k x", decay()),
    "fractions of properties": lambda: cl.fit("x' = -k/mass x", of_objects()),
    "ratios": lambda: cl.Law.from_text("x' = -V x/(K + x)", {"V": 1, "K": 0.5}),
    "fitted ratios": lambda: cl.fit("x' = -V x/(K + x)", decay()),
    "relations": law,
    "observation equations": observed,
    "latent states": lambda: cl.fit("x' = -k x + z; z' = -0.3 z; z(0) = 0.5; x(0) = 2", decay()),
    "events": lambda: cl.fit("x' = -k x; t > 2: x = x + 1; x(0) = 2", decay()),
    "delays": lambda: cl.fit("x' = (g u(t - d) - x)/1.1; d < 1.2; x(0) = 0", switched_on()),
    "switches": lambda: cl.fit("x' = where(x > 1, -k x, -s x); x(0) = 2", decay()),
    "discrete time": lambda: cl.fit("x[k+1] = r x", decay()),
    "named models": lambda: cl.fit("exponential-decay", decay()),
    "averages": lambda: cl.law.average_law(law()),
    "regression": lambda: cl.discover(of_objects(), order=1, library="poly:2", method=cl.DerivativeRegression()),
    "estimators": lambda: cl.LawDiscovery(order=1, library="poly:1", method=cl.DerivativeRegression()).fit(decay()),
    "trials": of_objects,
    "streams": lambda: cl.TrialStream(of_objects().schema, of_objects),
    "forecasts": lambda: law().predict(of_objects(), return_std=True),
    "forecasts of observations": lambda: observed().predict(decay("signal")),
    "simulations": lambda: law().simulate(TIMES, [2.0]),
    "assessments": lambda: law().assess(of_objects()),
    "discrepancies": lambda: law().discrepancy(of_objects(), "x"),
    "residuals": lambda: law().residuals(of_objects()),
    "experiments": lambda: cl.design(observed(), {"duration": "2..8", "samples": 20}, about="coefficients"),
    "bounds": lambda: cl.bounds(cl.fit("x' = -k x", decay()), decay(), ["x^2"]),
    "comparisons": lambda: law().comparison,
    "candidates": lambda: candidate_laws(law(), of_objects(), 2),
    "profiles": lambda: likelihood_profile(observed(), decay("signal"), "c"),
    "simplifications": lambda: law().simplify(),
    "errors": lambda: cl.CommonlawError("trial-index", "a.csv", trials=2, error=cl.CommonlawError("app-ending")),
    "notes": lambda: note("trials-differ", objects="2 (Ann, Ben)"),
    "stages": lambda: Stage("fitting", 0.5),
    "libraries": lambda: [*map(parse_library, LIBRARIES)],
    "chosen terms": lambda: [kind(parse_library("poly:2"), ("x",)) for kind in (SelectedLibrary, ReducedLibrary)],
    "capped libraries": lambda: CappedLibrary(parse_library("poly:2"), (("x", 1),)),
    "offers": lambda: [*parse_library("auto").offers(Variables(("x", "y")))],
    "rows": lambda: rows_by_object(decay(), FORM, TERMS),
    "compressed trials": lambda: CompressedTrials.of(rows_by_object(decay(), FORM, TERMS), decay().schema),
    "forms": lambda: [FORM, GivenForm({("object", "1"): (TIMES, DECAY[:, np.newaxis])})],
    "solvers": lambda: [
        ConstrainedSolver(STLSQ(0.1), equal=(0,)),
        Candidate(np.ones((1, 1), bool), np.ones((1, 1)), 0.1),
    ],
    "panels": lambda: [IntervalPanels(law()), ForecastPanels(result("forecasts")), ResidualPanels(result("residuals"))],
    "ratios of libraries": lambda: Ratio(TERMS.terms, TERMS.terms, 0, ("K",)),
    "moments": lambda: cl.Event("x"),
    "differentiators": lambda: [TotalVariationDerivative(1.0), Rates(DECAY, (DECAY,))],
}
"""What users get, by its kind."""


def equal(value: object, copied: object) -> bool:
    """Return whether a copy is of the same type and shows the same, in all its digits."""
    with np.printoptions(floatmode="unique"):
        return type(value) is type(copied) and (value is copied or repr(value) == repr(copied))


COPIES: tuple[Callable[[object], object], ...] = (
    lambda value: pickle.loads(pickle.dumps(value)),
    copy.deepcopy,
    copy.copy,
)


@pytest.mark.parametrize("kind", RESULTS)
def test_every_result_and_all_that_it_is_made_of_survives_a_copy(kind: str) -> None:
    for value in [result(kind), *parts(result(kind))]:
        assert all(equal(value, copied(value)) for copied in COPIES), type(value)


def test_every_public_type_is_among_the_results() -> None:
    covered = {type(value) for kind in RESULTS for value in parts(result(kind))}
    for kind in public_types() - covered:
        value = kind()  # A type without defaults needs a result above
        assert all(equal(value, copied(value)) for copied in COPIES), kind


def test_the_share_of_a_stage_is_a_plain_number() -> None:
    assert type(Stage("fitting", np.float64(0.5)).done) is float
