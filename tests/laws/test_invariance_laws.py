"""The law does not depend on units, on where a variable is counted from, or on when a clock was started."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

import commonlaw as cl
from benchmarks.variational import solve


@dataclass(frozen=True)
class System:
    """A law, the coefficients of each object, where its trials begin, and its support when the states are shifted."""

    variables: tuple[str, ...]
    equations: tuple[tuple[str, ...], ...]
    coefficients: tuple[tuple[float, ...], ...]
    starts: tuple[tuple[float, ...], ...]
    times: np.ndarray
    shifted: tuple[set[str], ...]
    library: str = "poly:2"


SYSTEMS = {
    "pendulum": System(
        ("x", "v"),
        (("v", "sin(x)"),),
        ((-0.1, -1.5), (-0.2, -2.0)),
        ((1.5, 0.0), (2.2, 0.3)),
        np.linspace(0, 12, 45),
        ({"v", "sin(x)"},),  # By whole turns
        "poly:2 + fourier:1",
    ),
    "drops": System(
        ("x", "v"),
        (("1", "v"),),
        ((-9.8, -0.2), (-9.8, -0.5), (-9.8, -0.35)),
        ((46.0, 0.0), (48.0, 0.3)),
        np.linspace(0, 3.2, 25),
        ({"1", "v"},),
    ),
    "populations": System(
        ("x", "y"),
        (("x", "x y"), ("y", "x y")),
        ((1.0, -0.9, -1.2, 0.6), (0.8, -1.1, -1.0, 0.8), (1.1, -0.8, -0.9, 0.7)),
        ((1.2, 0.9), (0.8, 1.5)),
        np.linspace(0, 12, 50),
        ({"1", "x", "y", "x y"}, {"1", "x", "y", "x y"}),
    ),
    "oscillator": System(
        ("x", "v"),
        (("x", "v"),),
        ((-2.0, -0.2), (-3.0, -0.1)),
        ((1.0, 0.0), (2.0, -1.0)),
        np.linspace(0, 12, 40),
        ({"1", "x", "v"},),
    ),
    "decay": System(("x",), (("x",),), ((-0.5,), (-0.9,)), ((1.0,), (2.0,)), np.linspace(0, 4, 25), ({"1", "x"},)),
}


@cache
def measured(name):
    """Noisy states of each trial, and its object."""
    system, generator, found = SYSTEMS[name], np.random.default_rng(1), []
    for i, coefficient in enumerate(system.coefficients):
        for start in system.starts:
            run = solve(system.variables, system.equations, np.array(coefficient), np.array(start), system.times)
            states = run.states[:, : len(system.equations)]
            noise = 0.01 * states.std(axis=0) * generator.standard_normal(states.shape)
            found.append((states + noise, f"object {i + 1}"))
    return found


def law_of(name, scale=1.0, shift=0.0, start=0.0):
    system = SYSTEMS[name]
    states, objects = zip(*measured(name), strict=True)
    equations = len(system.equations)
    trials = cl.Trials.from_arrays(
        [system.times + start] * len(states),
        [scale * state + shift for state in states],
        object=objects,
        names=system.variables[:equations],
    )
    return cl.discover(trials, order=len(system.variables) // equations, library=system.library)


def supports(law):
    return tuple({law.terms.names[k] for k in np.flatnonzero(row)} for row in law.support)


@pytest.mark.parametrize(
    "name",
    [
        "drops",
        "pendulum",
        "decay",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("populations", "oscillator")),
    ],
)
def test_the_origin_of_the_states_changes_the_law_by_its_shift_only(name):
    shift = -1e4
    if name == "pendulum":
        shift = 2 * np.pi * round(shift / (2 * np.pi))
    assert supports(law_of(name, shift=shift)) == SYSTEMS[name].shifted


@pytest.mark.parametrize(("name", "scale"), [("drops", 1e-9), pytest.param("oscillator", 1e6, marks=pytest.mark.slow)])
def test_the_origin_of_time_changes_nothing_and_the_unit_of_the_states_coefficients_by_its_powers_only(name, scale):
    law, late, other = law_of(name), law_of(name, start=1.7e9), law_of(name, scale=scale)
    assert supports(law) == tuple(set(equation) for equation in SYSTEMS[name].equations)
    assert supports(late) == supports(other) == supports(law)
    np.testing.assert_allclose(late.coefficients, law.coefficients, rtol=1e-3)
    ratios = other.coefficients[:, law.support] / law.coefficients[:, law.support]
    powers = [1 - sum(term.exponents.values()) for _, k in np.argwhere(law.support) for term in [law.terms.terms[k]]]
    np.testing.assert_allclose(ratios, np.tile(scale ** np.array(powers, float), (len(ratios), 1)), rtol=1e-4)


METHODS = {
    "derivative regression": cl.DerivativeRegression(),
    "weak regression": cl.WeakRegression(),
    "best subset by BIC": cl.DerivativeRegression(solver="best-subset", rule="bic"),
    "scaled thresholds by BIC": cl.DerivativeRegression(solver="group-stlsq:normalize=True", rule="bic"),
}


def law_by(method, start=0.0, unit=1.0, scale=1.0, turned=False, prefix="", copies=1):
    """The law of populations by a method: rates per unit of time, products of two states."""
    system = SYSTEMS["populations"]
    parts = [(scale * states, prefix + name) for states, name in measured("populations")] * copies
    states, objects = zip(*(parts[::-1] if turned else parts), strict=True)
    trials = cl.Trials.from_arrays(
        [unit * system.times + start] * len(states), states, object=objects, names=system.variables
    )
    return cl.discover(trials, library="poly:2", method=METHODS.get(method), order=1)


@pytest.mark.parametrize("method", METHODS)
def test_regression_does_not_depend_on_how_trials_are_written_down(method):
    """On origin and unit of time, unit and sign of the states, the order of trials, names and copies."""
    scale, unit = -1e3, 60.0
    law = law_by(method)
    other = law_by(method, start=1000.0, unit=unit, scale=scale, turned=True, prefix="z", copies=2)
    assert supports(other) == supports(law)
    order = [other.objects.index("z" + name) for name in law.objects]
    powers = np.array([1 - sum(law.terms.terms[k].exponents.values()) for _, k in np.argwhere(law.support)])
    expected = law.coefficients[:, law.support] * scale ** powers.astype(float) / unit
    np.testing.assert_allclose(other.coefficients[order][:, law.support], expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("change", [{"start": 1000.0}, {"unit": 60.0}, {"scale": -2.54}])
def test_the_law_of_too_small_a_library_does_not_depend_on_units_and_origins(change):
    law, other = of_too_few_terms(), of_too_few_terms(**change)
    assert supports(other) == supports(law)
    rates = np.array([law.terms.names[k].count("v") for _, k in np.argwhere(law.support)])
    expected = law.coefficients[:, law.support] * change.get("unit", 1.0) ** (rates - 2.0)
    np.testing.assert_allclose(other.coefficients[:, law.support], expected, rtol=1e-6)
    noise = abs(change.get("scale", 1.0)) * law.uncertainty.noise
    np.testing.assert_allclose(other.uncertainty.noise, noise, rtol=1e-6)


@cache
def of_too_few_terms(start=0.0, unit=1.0, scale=1.0):
    """Van der Pol's oscillator, whose friction changes with the state, by a spring and a constant friction."""
    times, generator = np.linspace(0, 10, 70), np.random.default_rng(5)
    truth = np.array([-1.0, 1.0, -1.0])
    run = solve(("x", "v"), (("x", "v", "x^2 v"),), truth, np.array([1.0, 0.0]), times)
    states = run.states[:, :1] + 0.01 * generator.standard_normal((70, 1))
    return cl.discover(cl.Trials.from_arrays(unit * times + start, scale * states), order=2, library="poly:1")
