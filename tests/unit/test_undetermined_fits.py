"""Fits that the measurements do not determine, or whose terms have no value, are refused or not assessed."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.integration import integrate
from commonlaw.integration.shooting import shoot
from commonlaw.summary import parameters_caption
from commonlaw.trials import Schema
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("few_starts")

TEN = np.arange(10.0)
START = "z(0) of object, trial 1"
DECAY = np.exp(-0.3 * TEN) + 0.01 * np.cos(7 * TEN)


def _trials(times, states, **names):
    return cl.Trials.from_arrays(times, states, names=["x"], **names)


def _sum_of_cosines(count):
    return "x' = " + " + ".join(f"a{i} cos({0.3 * i:g} t)" if i else "a0" for i in range(count))


@pytest.mark.parametrize("settings", [{}, {"noise": {"x": 0.01}}])
def test_more_unknowns_than_measurements_are_refused(settings):
    with refused("more-unknowns-than-measurements", coefficients=12, initial=1, measurements=10):
        cl.fit(_sum_of_cosines(12), _trials(TEN, DECAY), **settings)


def test_initial_values_count_as_unknowns():
    with refused("more-unknowns-than-measurements", coefficients=2, initial=2, measurements=3):
        cl.fit("x'' = -g - c v", _trials(TEN[:3], DECAY[:3]), noise={"x": 0.01})


def test_a_refit_and_a_comparison_refuse_them_too():
    law = cl.fit("x' = a + b x", _trials(TEN, DECAY), noise={"x": 0.01})
    few = _trials(TEN[:2], DECAY[:2])
    with refused("more-unknowns-than-measurements", measurements=2):
        cl.refine(law, few, noise={"x": 0.01})
    with refused("more-unknowns-than-measurements", measurements=2):
        cl.compare({"line": law, "decay": cl.Law.from_text("x' = -0.3 x")}, few, noise={"x": 0.01})


def test_parameters_that_objects_share_count_once():
    times, states = [TEN[:2]] * 4, [start * np.exp(-0.3 * TEN[:2]) for start in (1.0, 2.0, 3.0, 4.0)]
    trials = cl.Trials.from_arrays(times, states, object=list("ABCD"), names=["x"])
    law = cl.fit("x' = -k x + b", trials, shared=["k", "b"], noise={"x": 0.01})
    assert law.params.query("parameter == 'k'")["estimate"].to_numpy() == pytest.approx(0.3, abs=0.01)


def test_a_law_with_as_many_unknowns_as_measurements_is_not_assessed_on_these():
    trials, new = _trials(TEN, DECAY), _trials(TEN, 1.1 * DECAY)
    saturated = cl.fit(_sum_of_cosines(9), trials, noise={"x": 0.01}).assess(trials)
    assert (saturated.unknowns, saturated.training_measurements, saturated.usable) == (10, 10, None)
    law = cl.fit("x' = -k x", trials)
    assert (law.assess(trials).unknowns, law.assess(trials).usable) == (2, True)
    assert law.assess(new, trials.select(object=trials.objects)).usable is not None


@pytest.mark.parametrize(
    ("equation", "base", "exponent"), [("x' = -a x^p", "x", "p"), ("x' = -a (2 x)^(p - 1)", "2*x", "(p - 1)")]
)
def test_a_power_of_a_negative_number_with_an_estimated_exponent_is_refused(equation, base, exponent):
    times = np.linspace(0.0, 6.0, 31)
    with refused("power-of-negative", exponent=exponent) as caught:
        cl.fit(equation, _trials(times, np.exp(-0.5 * times) - 0.1))
    parameters = caught.value.diagnostic.parameters
    assert parameters["base"].replace(" ", "*") == base
    assert parameters["value"] < 0


TIMES = np.linspace(0.0, 20.0, 41)


def _level(start, rate):
    """Return the solution of ``x' = -k sqrt(max(x, 0))``, which is zero from ``2 sqrt(x0)/k`` on."""
    return np.maximum(np.sqrt(start) - rate * TIMES / 2, 0.0) ** 2


@pytest.mark.parametrize("text", ["sqrt(max(x, 0))", "max(x, 0)^0.5", "sqrt(2 max(x, 0))/sqrt(2)"])
def test_a_tank_that_empties_stays_empty(text):
    law = cl.Law.from_text(f"x' = -0.41 {text}")
    (found,) = law.simulate(TIMES, [4.0], sensitivities=True).values()
    assert found.outcome is None
    np.testing.assert_allclose(found.states[:, 0], _level(4.0, 0.41), atol=1e-7)
    assert np.abs(found.sensitivities[-1]).max() < 1e-3


def test_derivatives_of_an_emptying_tank_end_at_zero():
    from commonlaw.estimation.model import ModelText, read_model

    model = read_model(ModelText.of("x' = -k sqrt(max(x, 0))"), Schema(("x",)), ())
    start, rate = 4.0, 0.41
    found = shoot(model.switched, np.array([rate]), np.array([start]), TIMES, np.array([start]))
    root = np.sqrt(_level(start, rate))
    np.testing.assert_allclose(found.states[:, 0], root**2, atol=1e-7)
    np.testing.assert_allclose(found.derivatives[:, 0, 0], -root * TIMES, atol=0.01)
    np.testing.assert_allclose(found.derivatives[:, 0, 1], root / np.sqrt(start), atol=1e-3)


def test_an_emptying_tank_is_fitted():
    noise = 0.005 * np.random.default_rng(1).standard_normal(len(TIMES))
    law = cl.fit("x' = -k sqrt(max(x, 0))", _trials(TIMES, _level(4.0, 0.4) + noise))
    (row,) = law.params.itertuples()
    assert row.estimate == pytest.approx(0.4, abs=3 * row[6])
    assert row[6] < 0.002


@pytest.mark.parametrize(("settings", "is_assumed"), [({}, True), ({"noise": {"x": 0.01}}, False)])
def test_a_noise_that_was_assumed_is_noted(settings, is_assumed):
    trials = _trials(TEN[:2], DECAY[:2])
    law = cl.discover(trials, order=1, library="terms:x", method=cl.TrajectoryLikelihood(**settings))
    assert any(note.code == "noise-assumed" for note in law.diagnostics) == is_assumed
    assert (parameters_caption(law) != parameters_caption(cl.fit("x' = -k x", _trials(TEN, DECAY)))) == is_assumed
    # 5 % of the standard deviation
    assert not is_assumed or law.uncertainty.noise[0] == pytest.approx(0.05 * np.std(DECAY[:2]), rel=0.01)
    assert not any(
        note.code == "noise-assumed" for note in cl.fit("x' = -k x", _trials(TEN[:3], DECAY[:3])).diagnostics
    )


def test_a_solution_that_reaches_a_pole_ends_there_after_few_evaluations():
    calls = []

    def field(time, state):
        calls.append(time)
        return -1 / state

    found = integrate(field, [1.0], np.linspace(0.0, 2.0, 50))
    assert found.ended == pytest.approx(0.5, abs=1e-6)
    assert len(calls) < 6000


def test_of_a_rate_too_fast_to_be_measured_only_a_limit_is_given():
    times, step = np.linspace(0.0, 10.0, 21), 0.5
    noise = 0.01 * np.random.default_rng(0).standard_normal(21)
    trials = _trials(times, 20 + 80 * np.exp(-1000 * times) + noise)
    law = cl.fit("x' = -k (x - c)", trials)
    assert "one-sided-limit" in {note.code for note in law.diagnostics}
    (limit,) = law.uncertainty.limits
    assert limit.parameter == "k"
    # What is left of 80 after a step, between half of the noise and four times that
    assert np.log(80 / 0.04) / step < limit.value < np.log(80 / 0.005) / step


def test_a_coefficient_that_may_be_zero_has_two_limits():
    times = np.linspace(0.0, 10.0, 21)
    noise = 0.01 * np.random.default_rng(0).standard_normal(21)
    trials = _trials(times, 20 + 80 * np.exp(-0.5 * times) + noise)
    law = cl.fit("x' = -k (x - c) + b x^2", trials)
    b = law.params.set_index("parameter").loc["b"]
    assert abs(b["estimate"]) < 2 * b["standard error"]
    assert law.uncertainty.limits == ()
    assert "one-sided-limit" not in {note.code for note in law.diagnostics}


HILL = "x' = -V x^n/(K^n + x^n)"


def _hill(start, end, seed):
    times = np.linspace(0, end, 15)
    (path,) = cl.Law.from_text(HILL, {"V": 2, "K": 1.5, "n": 3}).simulate(times, [start]).values()
    noise = 0.01 * np.ptp(path.states) * np.random.default_rng(seed).standard_normal(15)
    return _trials(times, path.states[:, 0] + noise)


def test_a_rate_that_is_never_saturated_is_refused_as_confounded():
    """It is V (x/K)^n there: of V = 2 and K = 1.5 it had V > 534, and K = 23.1 +- 2.3 given that."""
    with refused("parameters-not-identified", names=["V", "K"]):
        cl.fit(HILL, _hill(0.5, 8, 1), errors="white")


def test_powers_of_parameters_that_are_not_determined_are_refused_as_such():
    """A negative K has finite powers at whole exponents alone: they were refused as nowhere finite, or were 1e92."""
    with refused("parameters-not-identified"):
        cl.fit(f"{HILL} + c", _hill(8, 2, 2), errors="white")


def test_factors_that_errors_of_integration_alone_separate_are_refused():
    times = np.linspace(0, 3, 16)
    values = 2 * np.exp(-0.96 * times) + 0.1 + 0.02 * np.cos(7 * np.arange(16.0))
    with refused("parameters-not-identified", names=["k", "p"]):
        cl.fit("x' = -k x; y = c x^p; x(0) = 1", cl.Trials.from_arrays(times, values, names=["y"]))


@pytest.mark.parametrize(
    ("equations", "names"),
    [
        ("z' = -k (z - a); x = z + c; -5 < c < 5", ["a", "c", START]),
        ("z' = -k (z - a); x = z + c; c > 0", ["a", "c", START]),
        ("z' = -k z; x = s z; 0 < s < 2", ["s", START]),
        ("z' = -k z; x = s z; s > 0.5", ["s", START]),
    ],
)
def test_confounded_parameters_are_refused_together_also_at_bounds(equations, names):
    with refused("parameters-not-identified", names=names):
        cl.fit(equations, _trials(TEN, DECAY))


def test_a_power_of_zero_whose_exponent_vanishes_has_no_derivative_by_it():
    times = np.arange(6.0)
    made = [
        cl.Trial("o", str(i), times, 5 * np.exp(-times)[:, None], (times > 3)[:, None].astype(float)) for i in (0, 1)
    ]
    trials = cl.Trials(tuple(made), cl.Schema(("x",), ("u",)))
    with refused("parameters-not-identified", names=["b"]):
        cl.fit("x'' = -b x + abs(u)^b; x(0) = a", trials)
