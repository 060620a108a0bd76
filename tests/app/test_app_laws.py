"""Laws of every kind are fitted and found by the app: none stops it, and each comes back with its parameters."""

import io
import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from tests.in_browser import Page
from tests.served import Served

_FUNCTIONS = {"exp": np.exp, "log": np.log, "sqrt": np.sqrt, "abs": np.abs, "sin": np.sin}


@dataclass(frozen=True)
class Crossing:
    """A crossing of zero in a direction, at which `solve_ivp` stops."""

    value: Callable[[float, np.ndarray], float]
    direction: int
    terminal: bool = True

    def __call__(self, t: float, y: np.ndarray) -> float:
        return self.value(t, y)


@dataclass(frozen=True)
class Case:
    """A law as it is written, its parameters, and what it is measured in.

    Parameters
    ----------
    text
        Equations, given initial values, events of states or times, and observation equations, as Python and the app
        read them.
    numbers
        Parameters by name.
    starts
        Initial values that the text does not give, by state.
    end
        Time of the last sample.
    masses
        A property of the objects, one object for each.
    library
        What the app is to find the law with, in place of its equations.
    """

    text: str
    numbers: dict[str, float]
    starts: dict[str, float] = field(default_factory=dict)
    end: float = 8.0
    masses: tuple[float, ...] = (1.0,)
    library: str = ""

    def _parts(self, pattern: str) -> list[tuple[str, ...]]:
        return [match.groups() for part in self.text.split("; ") if (match := re.fullmatch(pattern, part))]

    def table(self, count: int = 50) -> pd.DataFrame:
        """Return samples with noise of half a percent of the range."""
        tables = [self._measured(mass, count) for mass in self.masses]
        frame = pd.concat(tables, keys=[f"o{i}" for i in range(len(tables))], names=["object"]).reset_index(0)
        return frame if len(self.masses) > 1 else frame.drop(columns=["object", "mass"])

    def _measured(self, mass: float, count: int) -> pd.DataFrame:
        rates = self._parts(r"(\w+)('+) = (.*)")
        states = [name for name, *_ in rates]
        second = [name for name, primes, _ in rates if primes == "''"]
        names = [*states, *("v" for _ in second)]
        rights = [*("v" if primes == "''" else right for _, primes, right in rates)]
        rights += [right for _, primes, right in rates if primes == "''"]
        given = {"v" if rate else name: value for name, rate, value in self._parts(r"(\w+)('?)\(0\) = (.*)")}
        events = self._parts(r"(\w+) ([<>]) ([\d.]+): (\w+) = (.*)")
        observed = self._parts(r"(\w+) = (.*)")

        def value(text: str, t: object, y: object) -> object:
            return eval(text, _FUNCTIONS, {**self.numbers, "mass": mass, "t": t, **dict(zip(names, y, strict=True))})

        crossings = [
            Crossing(
                partial(lambda name, limit, t, y: value(name, t, y) - float(limit), name, limit), 2 * (sign == ">") - 1
            )
            for name, sign, limit, *_ in events
        ]
        times, start = np.linspace(0.0, self.end, count), 0.0
        y = np.array([value(given.get(name, str(self.starts.get(name))), 0.0, [0.0] * len(names)) for name in names])
        columns = np.full((len(names), count), np.nan)
        while True:
            ahead = times >= start
            solution = solve_ivp(
                lambda t, y: [value(right, t, y) for right in rights], (start, self.end), y, "LSODA", times[ahead],
                events=crossings or None, rtol=1e-8, atol=1e-10,
            )  # fmt: skip
            columns[:, np.flatnonzero(ahead)[: len(solution.t)]] = solution.y
            if solution.status != 1:
                break
            index = next(i for i, found in enumerate(solution.t_events) if len(found))
            start, y = float(solution.t_events[index][0]) + 1e-9, solution.y_events[index][0].copy()
            y[names.index(events[index][3])] = value(events[index][4], start, y)
        measured = {name: value(right, times, columns) for name, right in observed}
        if not measured:
            pairs = zip(states, columns, strict=False)
            measured = {name: column for name, column in pairs if name != "z"}  # Which is latent
        noise = np.random.default_rng(0)
        noisy = {name: x + 5e-3 * np.ptp(x) * noise.standard_normal(count) for name, x in measured.items()}
        return pd.DataFrame({"t": times, **noisy, "mass": mass})


MASSES = (1.0, 2.0, 4.0)
CASES = {
    # Fractions
    "property": Case("x' = -k/mass*x", {"k": 0.5}, {"x": 2.0}, masses=MASSES),
    "spring": Case("x'' = -k/mass*x", {"k": 2.0}, {"x": 1.0, "v": 0.0}, masses=MASSES),
    "damped spring": Case("x'' = -k/mass*x - c/mass*v", {"k": 2.0, "c": 0.4}, {"x": 1.0, "v": 0.0}, masses=MASSES),
    "root of a property": Case("x' = -k/sqrt(mass)*x", {"k": 0.5}, {"x": 2.0}, masses=MASSES),
    "logistic": Case("x' = r*x*(1 - x/K)", {"r": 1.0, "K": 5.0}, {"x": 0.2}),
    "saturation": Case("x' = -V*x/(K + x)", {"V": 1.0, "K": 0.8}, {"x": 3.0}),
    "saturation with a source": Case("x' = a - V*x/(K + x)", {"a": 0.3, "V": 1.0, "K": 0.8}, {"x": 3.0}),
    "saturation by mass": Case("x' = -V/mass*x/(K + x)", {"V": 1.0, "K": 0.8}, {"x": 3.0}, masses=MASSES),
    "hill": Case("x' = V*x**2/(K + x**2) - d*x", {"V": 2.0, "K": 3.0, "d": 0.25}, {"x": 1.5}),
    "lag": Case("x' = (g - x)/s", {"g": 2.0, "s": 1.6}, {"x": 0.0}),
    "inverse": Case("x' = a/x", {"a": 1.0}, {"x": 1.0}),
    # Ratios of two states, and ratios that are found
    "batch": Case("b' = m*s*b/(K + s); s' = -n*s*b/(K + s)", {"m": 0.9, "K": 0.6, "n": 2.0}, {"b": 0.1, "s": 2.0}),
    "chain": Case("x' = -V*x/(K + x); y' = V*x/(K + x) - w*y", {"V": 1.0, "K": 0.8, "w": 0.4}, {"x": 3.0, "y": 0.0}),
    "predator": Case(
        "x' = r*x - r*x**2/K - a*x*y/(H + x); y' = c*x*y/(H + x) - d*y",
        {"r": 1.0, "K": 4.0, "a": 1.2, "H": 1.0, "c": 0.8, "d": 0.3},
        {"x": 1.0, "y": 0.8},
        end=25.0,
    ),
    "frequency": Case("s' = -b*s*i/(s + i); i' = b*s*i/(s + i) - g*i", {"b": 1.2, "g": 0.4}, {"s": 0.95, "i": 0.05}),
    "found saturation": Case("x' = -V*x/(K + x)", {"V": 1.0, "K": 0.8}, {"x": 3.0}, library="ratio(poly:1, poly:1)"),
    "found source": Case(
        "x' = a - V*x/(K + x)", {"a": 0.3, "V": 1.0, "K": 0.8}, {"x": 3.0}, library="ratio(poly:1, poly:1)"
    ),
    "found by mass": Case("x' = -k/mass*x", {"k": 0.5}, {"x": 2.0}, masses=MASSES, library="poly:1"),
    "found term": Case("x' = -V*x/(K + x)", {"V": 1.0, "K": 0.8}, {"x": 3.0}, library="poly:1 + terms:x/(K+x)"),
    "found inverse": Case("x' = a/x", {"a": 1.0}, {"x": 1.0}, library="terms:1/x,x"),
    "found family": Case("x' = -V*x/(K + x)", {"V": 1.0, "K": 0.8}, {"x": 3.0}, library="poly:1 + saturating"),
    # Latent states, which are called z
    "driven": Case("x' = z - k*x; z' = -b*z; x(0) = 0; z(0) = 2", {"k": 0.3, "b": 0.9}),
    "absorption": Case("x' = a*z - k*x; z' = -a*z; x(0) = 0; z(0) = 3", {"a": 1.5, "k": 0.3}),
    "absorption with saturation": Case(
        "x' = a*z - V*x/(K + x); z' = -a*z; x(0) = 0; z(0) = 3", {"a": 1.5, "V": 0.6, "K": 0.5}
    ),
    "exchange": Case(
        "x' = -k*x - a*x + b*z; z' = a*x - b*z; x(0) = 4; z(0) = 0", {"k": 0.3, "a": 0.8, "b": 0.4}, end=15.0
    ),
    "exchange by mass": Case(
        "x' = -k/mass*x + b*z; z' = a*x - b*z; x(0) = 4; z(0) = 0", {"k": 0.9, "a": 0.5, "b": 0.4}, masses=MASSES
    ),
    "oscillation": Case("x' = z; z' = -k*x - c*z; x(0) = 1; z(0) = 0", {"k": 2.0, "c": 0.3}),
    "inhibitor": Case("x' = a - k*x*z; z' = -b*z; x(0) = 0.5; z(0) = 1", {"a": 0.5, "k": 0.9, "b": 0.2}),
    # Events
    "doubling": Case("x' = r*x; x > 4: x = x/2; x(0) = 1", {"r": 0.5}),
    "refill": Case("x' = -k*x; x < 1: x = x + 2; x(0) = 3", {"k": 0.5}),
    "moment": Case("x' = -k*x; t > 3: x = x + 1; x(0) = 2", {"k": 0.5}),
    "moment with saturation": Case("x' = -V*x/(K + x); t > 3: x = x + 2; x(0) = 3", {"V": 1.0, "K": 0.8}),
    "dilution": Case("x' = r*x*(1 - x/K); t > 4: x = x/4; x(0) = 0.5", {"r": 1.0, "K": 5.0}),
    "by mass": Case("x' = -k/mass*x; t > 4: x = x + 1; x(0) = 2", {"k": 0.5}, masses=MASSES),
    # Observation equations
    "signal": Case("x' = -k*x; signal = c*x; x(0) = 1", {"k": 0.5, "c": 3.0}),
    "background": Case("x' = -k*x; signal = c*x + d; x(0) = 1", {"k": 0.5, "c": 3.0, "d": 0.4}),
    "saturated signal": Case("x' = r*x; signal = m*x/(h + x); x(0) = 0.1", {"r": 0.8, "m": 2.0, "h": 1.5}),
    "sum": Case("x' = -a*x; y' = a*x - b*y; total = x + y; x(0) = 2; y(0) = 0", {"a": 1.2, "b": 0.3}),
    "concentration": Case("x' = -k*x; level = x/W; x(0) = 10", {"k": 0.5, "W": 4.0}),
    "by weight": Case("x' = -k*x; level = x/(W*mass); x(0) = 10", {"k": 0.5, "W": 4.0}, masses=MASSES),
}
QUICK = ("property", "saturation", "batch", "found by mass", "driven", "refill", "concentration")


def estimates(shown: dict) -> dict[str, float]:
    """Return the values of the first object, by parameter, that the page is sent of the law."""
    return {name: values[0] for name, values in shown["candidates"][0]["equations"]["values"].items()}


def check(case: Case, shown: dict) -> None:
    assert shown["candidates"][0]["text"]
    if not case.library:
        known = {name: value for name, value in estimates(shown).items() if name in case.numbers}  # Without properties
        assert known == pytest.approx({name: case.numbers[name] for name in known}, rel=0.2)
        assert known


def asked(case: Case, table: str) -> dict[str, object]:
    properties = {"properties": ["mass"]} if len(case.masses) > 1 else {}
    what = (
        {"library": case.library, "order": 1}
        if case.library
        else {"equations": {"text": case.text.replace("; ", "\n")}}
    )
    return {"table": table, "columns": properties, "settings": {"errors": ["white"]}, **what}


@pytest.mark.parametrize("name", QUICK)
def test_a_law_comes_back_from_its_process(app: Served, name: str) -> None:
    case, content = CASES[name], io.StringIO()
    case.table().to_csv(content, index=False)
    _, body, _ = app.say("POST", f"{app.room}tables?name=a.csv", content.getvalue().encode())
    status, answer = app.ask("searches", "POST", asked(case, json.loads(body)["table"]))
    assert status == 200, answer
    until, path = time.monotonic() + 120, f"searches/{answer['search']}"
    while (state := app.ask(path)[1])["running"] and time.monotonic() < until:
        time.sleep(0.1)
    assert (state["running"], state["failure"]) == (False, "")
    check(case, app.ask(f"{path}/found")[1]["found"])


@pytest.mark.slow
def test_forty_laws_are_fitted_and_found_on_the_page(page: Page, app: Served, tmp_path) -> None:
    assert len(CASES) == 40
    wrong = dict[str, str]()
    for name, case in CASES.items():
        try:
            show(page, app, case, tmp_path / f"{name.replace(' ', '-')}.csv")
        except AssertionError as error:
            wrong[name] = str(error)[:300]
    assert not wrong


def show(page: Page, app: Served, case: Case, path: Path) -> None:
    """Fit or find a law on the page, until it is shown."""
    case.table().to_csv(path, index=False)
    page.open(app, path, path.name)
    page.choose("setting_errors", "white")
    if case.library:
        page.choose("order", "1")
        page.choose("own_library", case.library)  # Which is folded away
        page.click("start")
    else:
        page.execute_script("document.getElementById('write').open = true")
        page.type("equations", case.text.replace("; ", "\n"))
        page.wait("$('parameters').children.length || $('equations_problem').textContent")
        assert page.text("equations_problem") == ""
        page.click("fit")
    page.wait("$('failed').textContent || (!$('result').hidden && $('going').hidden)", 180)
    assert page.text("failed") == ""
    search = page.execute_script("return new URLSearchParams(location.hash.slice(1)).get('search')")
    assert app.ask(f"searches/{search}/found")[1]["found"]["candidates"][0]["text"]
