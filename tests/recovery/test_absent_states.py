"""A state that is exactly zero throughout a trial, such as a species that is absent, is no measurement with noise."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.inference.fit.problem import prepare
from commonlaw.law.parameters import named_parameters
from commonlaw.library import Variables, parse_library
from tests.simulations import solved

COMPETITION = ("a' = r a - s a^2 - m a b", "b' = q b - p b^2 - n a b")
TRUE = {"r": 0.9, "s": 0.009, "m": 0.008, "q": 0.7, "p": 0.006, "n": 0.003}
NOISE = 4.0


@pytest.fixture(scope="module")
def cultures() -> cl.Trials:
    """Two species alone and together."""
    generator, times = np.random.default_rng(3), np.arange(0.0, 20.0)

    def rates(_, z):
        r, s, m, q, p, n = TRUE.values()
        return [r * z[0] - s * z[0] ** 2 - m * z[0] * z[1], q * z[1] - p * z[1] ** 2 - n * z[0] * z[1]]

    states = list[np.ndarray]()
    for start in ([5.0, 0.0], [0.0, 5.0], [5.0, 5.0]):
        clean = solved(rates, start, times)
        noise = NOISE * generator.standard_normal(clean.shape) * (np.array(start) > 0)
        states.append(clean + noise)
    return cl.Trials.from_arrays([times] * 3, states, object=["tube"] * 3, trial=["a", "b", "both"], names=["a", "b"])


def test_a_state_is_absent_where_every_measurement_of_it_is_zero(cultures):
    assert [culture.absent.tolist() for culture in cultures] == [[False, True], [True, False], [False, False]]
    first = cultures[0]
    assert not first.cut(1).absent.any()  # One zero may be noise


def test_zeros_of_absent_species_do_not_count_as_measurements(cultures):
    terms = parse_library("poly:2").bind(Variables(("a", "b")))
    problem = prepare(cultures, terms, np.full((1, 2, len(terms)), np.nan))
    assert problem.measured == (80,)
    absent = np.concatenate([np.tile(culture.absent, (len(culture), 1)) for culture in cultures])
    assert (problem.white_std[absent] < 1e-3 * problem.white_std[~absent].min()).all()


def test_a_species_that_is_absent_stays_so_in_the_fit_and_in_forecasts(cultures):
    law = cl.fit(COMPETITION, cultures, errors="white")
    parameters = named_parameters(law)
    values, errors = (each[0] for each in (parameters.values, parameters.errors))
    true = np.array([TRUE[name] for name in parameters.names])
    assert np.all(np.abs(values - true) < 4 * errors)
    assert law.uncertainty.noise == pytest.approx([NOISE, NOISE], rel=0.3)
    # Given four samples, the absent species does not invade
    forecast = law.predict(cultures, start=4)
    assert np.abs(forecast.trajectories[0].states[:, 1]).max() < 1e-3
    assert np.abs(forecast.trajectories[1].states[:, 0]).max() < 1e-3


def test_trials_that_others_say_nothing_of_do_not_widen_bands(cultures):
    law = cl.discover(cultures, order=1, library="poly:2", method=cl.TrajectoryLikelihood(errors="white"))
    assert {"a b"} <= {name for name, used in zip(law.terms.names, law.support.any(axis=0), strict=True) if used}
    inflation = law.uncertainty.interval_inflation
    assert inflation is None or inflation.factors.max() < 5
