"""Estimates and standard errors of `cl.fit` compared with certified ones and with those of SciPy.

The sets are those of the NIST Statistical Reference Datasets for nonlinear regression
(https://www.itl.nist.gov/div898/strd, public domain) whose model solves a differential equation, in the folder `nist`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import curve_fit

import commonlaw as cl
from commonlaw.law.parameters import named_parameters

Floats = NDArray[np.float64]
FOLDER = Path(__file__).with_name("nist")
e, pi = np.exp, np.pi


@dataclass(frozen=True)
class Certified:
    """A set of NIST StRD: its closed form, certified parameters with their deviations, and that of the residuals.

    `coefficients` gives the coefficients of the equation by the certified parameters. With `through_zero` the
    certified model has y(0) = 0. Fits estimate y(0), which is a shift in time: the reference is
    least squares with that shift.
    """

    equation: str
    model: Callable[[Floats, Sequence[float]], Floats]
    coefficients: Callable[[Sequence[float]], dict[str, float]]
    parameters: tuple[float, ...]
    deviations: tuple[float, ...]
    residual_deviation: float
    data: str = ""
    latent: tuple[str, ...] = ()
    through_zero: bool = False


def three_exponentials(t, b):
    return b[0] * e(-b[1] * t) + b[2] * e(-b[3] * t) + b[4] * e(-b[5] * t)


def cascade(b):
    return {"k": b[1], "m": b[3], "n": b[5]}


LANCZOS = "y' = -k*y + u; u' = -m*u + w; w' = -n*w"
SETS = {
    "Rat42": Certified(
        "y' = r*y*(1 - y/K)",
        lambda t, b: b[0] / (1 + e(b[1] - b[2] * t)),
        lambda b: {"r": b[2], "K": b[0]},
        (72.462237576, 2.6180768402, 0.067359200066),
        (1.7340283401, 0.088295217536, 0.0034465663377),
        1.1587725499,
    ),
    "Rat43": Certified(
        "y' = r*y*(1 - (y/K)**p)",
        lambda t, b: b[0] / (1 + e(b[1] - b[2] * t)) ** (1 / b[3]),
        lambda b: {"r": b[2] / b[3], "K": b[0], "p": b[3]},
        (699.64151270, 5.2771253025, 0.75962938329, 1.2792483859),
        (16.302297817, 2.0828735829, 0.19566123451, 0.68761936385),
        28.262414662,
    ),
    "Misra1a": Certified(
        "y' = k*(B - y)",
        lambda t, b: b[0] * (1 - e(-b[1] * t)),
        lambda b: {"k": b[1], "B": b[0]},
        (238.94212918, 5.5015643181e-4),
        (2.7070075241, 7.2668688436e-6),
        0.10187876330,
        "Misra1",
        through_zero=True,
    ),
    "Misra1b": Certified(
        "y' = k*(1 - y/B)**1.5",
        lambda t, b: b[0] * (1 - (1 + b[1] * t / 2) ** -2),
        lambda b: {"k": b[0] * b[1], "B": b[0]},
        (337.99746163, 3.9039091287e-4),
        (3.1643950207, 4.2547321834e-6),
        0.079301471998,
        "Misra1",
        through_zero=True,
    ),
    "Misra1c": Certified(
        "y' = k*(1 - y/B)**3",
        lambda t, b: b[0] * (1 - (1 + 2 * b[1] * t) ** -0.5),
        lambda b: {"k": b[0] * b[1], "B": b[0]},
        (636.42725809, 2.0813627256e-4),
        (4.6638326572, 1.7728423155e-6),
        0.058428615257,
        "Misra1",
        through_zero=True,
    ),
    "BoxBOD": Certified(
        "y' = k*(B - y)",
        lambda t, b: b[0] * (1 - e(-b[1] * t)),
        lambda b: {"k": b[1], "B": b[0]},
        (213.80940889, 0.54723748542),
        (12.354515176, 0.10455993237),
        17.088072423,
        through_zero=True,
    ),
    "DanWood": Certified(
        "y' = p*y/t",
        lambda t, b: b[0] * t**b[1],
        lambda b: {"p": b[1]},
        (0.76886226176, 3.8604055871),
        (0.018281973860, 0.051726610913),
        0.032853114039,
    ),
    "Eckerle4": Certified(
        "y' = -(t - c)*y/s**2",
        lambda t, b: b[0] / b[1] * e(-0.5 * ((t - b[2]) / b[1]) ** 2),
        lambda b: {"c": b[2], "s": b[1]},
        (1.5543827178, 4.0888321754, 451.54121844),
        (0.015408051163, 0.046803020753, 0.046800518816),
        0.0067629245447,
    ),
    "Bennett5": Certified(
        "y' = -p*y/(c + t)",
        lambda t, b: b[0] * (b[1] + t) ** (-1 / b[2]),
        lambda b: {"p": 1 / b[2], "c": b[1]},
        (-2523.5058043, 46.736564644, 0.93218483193),
        (297.15175411, 1.2448871856, 0.020272299378),
        0.0018629312528,
    ),
    "MGH17": Certified(
        "y' = a - k*y + u; u' = -m*u",
        lambda t, b: b[0] + b[1] * e(-t * b[3]) + b[2] * e(-t * b[4]),
        lambda b: {"k": b[3], "m": b[4], "a": b[0] * b[3]},
        (0.37541005211, 1.9358469127, -1.4646871366, 0.012867534640, 0.022122699662),
        (0.0020723153551, 0.22031669222, 0.22175707739, 4.4861358114e-4, 8.9471996575e-4),
        0.0013970497866,
        latent=("u",),
    ),
    "Lanczos2": Certified(
        LANCZOS,
        three_exponentials,
        cascade,
        (0.096251029939, 1.0057332849, 0.86424689056, 3.0078283915, 1.5529016879, 5.0028798100),
        (6.6770575477e-4, 3.3989646176e-3, 1.7185846685e-3, 4.1707005856e-3, 2.3744381417e-3, 1.3958787284e-3),
        1.1130395851e-6,
        latent=("u", "w"),
    ),
    "Lanczos3": Certified(
        LANCZOS,
        three_exponentials,
        cascade,
        (0.086816414977, 0.95498101505, 0.84400777463, 2.9515951832, 1.5825685901, 4.9863565084),
        (0.017197908859, 0.097041624475, 0.041488663282, 0.10766312506, 0.058371576281, 0.034436403035),
        2.9923229172e-5,
        latent=("u", "w"),
    ),
    "Chwirut2": Certified(
        "y' = -b*y - y/(c + t)",
        lambda t, b: e(-b[0] * t) / (b[1] + b[2] * t),
        lambda b: {"b": b[0], "c": b[1] / b[2]},
        (0.16657666537, 5.1653291286e-3, 0.012150007096),
        (0.038303286810, 6.6621605126e-4, 1.5304234767e-3),
        3.1717133040,
    ),
    "ENSO": Certified(
        "y' = f*cos(pi/6*t) + g*sin(pi/6*t) + h*cos(w*t) + l*sin(w*t) + m*cos(v*t) + n*sin(v*t)",
        lambda t, b: (
            b[0]
            + b[1] * np.cos(pi * t / 6)
            + b[2] * np.sin(pi * t / 6)
            + b[4] * np.cos(2 * pi * t / b[3])
            + b[5] * np.sin(2 * pi * t / b[3])
            + b[7] * np.cos(2 * pi * t / b[6])
            + b[8] * np.sin(2 * pi * t / b[6])
        ),
        lambda b: {"w": 2 * pi / b[3], "v": 2 * pi / b[6]},
        (
            10.510749193, 3.0762128085, 0.53280138227, 44.311088700, -1.6231428586,
            0.52554493756, 26.887614440, 0.21232288488, 1.4966870418,
        ),
        (
            0.17488832467, 0.24310052139, 0.24354686618, 0.94408025976, 0.28078369611,
            0.48073701119, 0.41612939130, 0.51460022911, 0.25434468893,
        ),
        2.2269642403,
    ),
}  # fmt: skip


def jacobian(function: Callable[[Floats], Floats], point: Floats) -> Floats:
    """Return central differences of a function of vectors, shape (values, parameters)."""
    steps = np.diag(1e-5 * np.abs(point))
    return np.stack([(function(point + h) - function(point - h)) / (2 * h.sum()) for h in steps], axis=1)


def data(name: str) -> tuple[Floats, Floats]:
    times, states = np.loadtxt(FOLDER / f"{SETS[name].data or name}.csv", delimiter=",", skiprows=1, unpack=True)
    return times, states


def covariance(certified: Certified, times: Floats) -> Floats:
    """Return that of the errors of the parameters, s^2 (J' J)^-1."""
    slopes = jacobian(lambda b: certified.model(times, b), np.array(certified.parameters))
    return np.asarray(certified.residual_deviation**2 * np.linalg.inv(slopes.T @ slopes), dtype=np.float64)


def expected(name: str) -> dict[str, tuple[float, float]]:
    """Return coefficients of the equation and their standard errors, by the delta method."""
    certified, (times, states) = SETS[name], data(name)
    point, errors = np.array(certified.parameters), covariance(certified, times)
    if certified.through_zero:
        scale = np.append(point, 0.01 * np.ptp(times))

        def shifted(t: Floats, *q: float) -> Floats:
            *b, shift = np.array(q) * scale
            return certified.model(t + shift, b)

        start = np.append(np.ones(len(point)), 0.0)
        point, errors = curve_fit(shifted, times, states, start, xtol=1e-14, ftol=1e-14)
        point, errors = (point * scale)[:-1], (errors * np.outer(scale, scale))[:-1, :-1]
    slopes = jacobian(lambda b: np.array(list(certified.coefficients(b).values())), point)
    deviations = np.sqrt(np.diag(slopes @ errors @ slopes.T))
    coefficients = certified.coefficients(point)
    return dict(zip(coefficients, zip(coefficients.values(), deviations, strict=True), strict=True))


# Their residuals are autocorrelated or grow with y, so that `auto` chooses errors of which nothing is certified
OTHER_ERRORS = ("Eckerle4", "Bennett5", "Chwirut2")
FITS = [(name, "white") for name in ("Rat42", *OTHER_ERRORS)] + [
    (name, "auto") for name in SETS if name not in OTHER_ERRORS
]
SLOW = {("Bennett5", "white"), *((name, "auto") for name in ("ENSO", "Lanczos2", "Misra1b", "Misra1c", "Rat42"))}


@pytest.mark.parametrize("name", SETS)
def test_the_closed_form_has_the_certified_standard_errors(name):
    certified, (times, states) = SETS[name], data(name)
    residuals = states - certified.model(times, certified.parameters)
    freedom = len(times) - len(certified.parameters)
    assert np.sqrt(residuals @ residuals / freedom) == pytest.approx(certified.residual_deviation, rel=1e-4)
    assert np.sqrt(np.diag(covariance(certified, times))) == pytest.approx(certified.deviations, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "errors"), [pytest.param(*case, marks=[pytest.mark.slow] * (case in SLOW)) for case in FITS]
)
def test_a_fit_from_a_free_start_gives_the_certified_estimates_and_standard_errors(name, errors):
    certified, (times, states) = SETS[name], data(name)
    trials = cl.Trials.from_arrays([times], [states], names=["y"])
    law = cl.fit(certified.equation, trials, errors=errors, initial_values=dict.fromkeys(certified.latent))
    parameters = named_parameters(law)
    (estimates,), (deviations,) = parameters.values, parameters.errors
    fitted = dict(zip(parameters.names, zip(estimates, deviations, strict=True), strict=True))
    if certified.equation == LANCZOS:  # The three exponentials stand in any order
        fitted = dict(zip("kmn", sorted(fitted.values()), strict=True))
    for parameter, reference in expected(name).items():
        estimate, deviation = fitted[parameter]
        # Only the square of the width of a peak stands in its equation
        assert (abs(estimate) if parameter == "s" else estimate) == pytest.approx(reference[0], rel=1e-4)
        assert deviation == pytest.approx(reference[1], rel=0.02)


def logistic(t, r, capacity, start):
    return capacity / (1 + (capacity / start - 1) * np.exp(-r * t))


@pytest.mark.parametrize("samples", [5, 8, 15])
def test_a_growth_curve_gives_the_estimates_and_standard_errors_of_least_squares(samples):
    times = np.linspace(0, 12, samples)
    states = logistic(times, 0.8, 2.0, 0.1) + 0.03 * np.random.default_rng(samples).standard_normal(samples)
    estimates, errors = curve_fit(logistic, times, states, [0.8, 2.0, 0.1])
    law = cl.fit("y' = r*y*(1 - y/K)", cl.Trials.from_arrays([times], [states], names=["y"]))
    parameters = named_parameters(law)
    (found,), (deviations,) = parameters.values, parameters.errors
    order = [parameters.names.index(name) for name in ("r", "K")]
    assert found[order] == pytest.approx(estimates[:2], rel=1e-4)
    assert deviations[order] == pytest.approx(np.sqrt(np.diag(errors))[:2], rel=0.02)
