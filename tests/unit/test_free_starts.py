"""Latent states with unknown initial values."""

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.cli.main import commonlaw
from commonlaw.diagnostics import Diagnostic
from commonlaw.inference.fit.structural_identifiability import has_symmetry
from commonlaw.law import from_json, to_json
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import read_equations
from commonlaw.trials import Schema
from tests.refusals import refused

WHITE = {"errors": "white", "huber_threshold": np.inf, "partial_pooling": False}
EPIDEMIC = "S' = -b S I; I' = b S I - g I"
PENDULUM = "theta' = omega; omega' = -g sin(theta) - c omega"


def epidemic(_, state, b, g):
    return [b * state[0] * state[1] - g * state[0], -b * state[0] * state[1]]


def pendulum(_, state, g, c):
    return [state[1], -g * np.sin(state[0]) - c * state[1]]


CASES = {
    "epidemic": (EPIDEMIC, epidemic, "I", "S", ("b", "g"), (5e-4, 0.15), (10.0, 990.0), np.linspace(0, 40, 21)),
    "pendulum": (PENDULUM, pendulum, "theta", "omega", ("g", "c"), (4.0, 0.1), (1.2, -0.7), np.linspace(0, 10, 40)),
}


def solution(case, values, start):
    _, rates, *_, times = CASES[case]
    span = (times[0], times[-1])
    return solve_ivp(rates, span, start, t_eval=times, args=tuple(values), rtol=1e-10, atol=1e-8).y[0]


def drawn(case, count=2):
    *_, name, _, _, truth, start, times = CASES[case]
    generator = np.random.default_rng(2)
    values = np.array(truth) * np.exp(0.1 * generator.standard_normal((count, len(truth))))
    starts = np.array(start) * np.exp(0.1 * generator.standard_normal((count, 2)))
    measured = [solution(case, *own) for own in zip(values, starts, strict=True)]
    noise = 0.01 * float(np.std(measured))
    measured = [own + noise * generator.standard_normal(len(own)) for own in measured]
    trials = cl.Trials.from_arrays([times] * count, measured, object=list("abc")[:count], names=[name])
    return values, starts, noise, measured, trials


@pytest.mark.parametrize("case", ["epidemic", pytest.param("pendulum", marks=pytest.mark.slow)])
def test_coefficients_starts_and_errors_are_those_of_independent_least_squares(case):
    equations, _, name, hidden, names, *_ = CASES[case]
    truth, starts, noise, measured, trials = drawn(case)
    law = cl.fit(equations, trials, initial_values={hidden: None}, noise={name: noise}, **WHITE)
    parameters = named_parameters(law)
    columns = [parameters.names.index(name) for name in names]
    values, errors = (each[:, columns] for each in (parameters.values, parameters.errors))
    forecast = law.predict(trials, start=len(CASES[case][-1]))
    for k, data in enumerate(measured):
        begin = np.concatenate([truth[k], starts[k]])
        found = least_squares(
            lambda own, data=data: (solution(case, own[:2], own[2:]) - data) / noise,
            begin,
            x_scale=np.abs(begin),
            jac="3-point",
            xtol=1e-12,
        )
        bound = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
        assert (abs(values[k] - found.x[:2]) < 0.3 * errors[k]).all()
        np.testing.assert_allclose(errors[k], bound[:2], rtol=0.12)
        assert abs(forecast.trajectories[k].states[0, 1] - found.x[3]) < 0.5 * bound[3]


@pytest.mark.slow
def test_such_a_law_is_saved_and_forecasts_trials_that_start_elsewhere():
    *_, trials = drawn("pendulum")
    law = cl.fit(PENDULUM, trials, initial_values={"omega": "free"})
    again = from_json(to_json(law))
    assert str(again) == str(law)
    assert again.schema.initial_values == {"omega": None}
    assert ("start", "omega") in [(each.stage, each.choice) for each in law.history]
    times = CASES["pendulum"][-1]
    other = cl.Trials.from_arrays(times, solution("pendulum", (4.0, 0.1), (0.3, 1.5)), object="a", names=["theta"])
    start = again.predict(other, start=12).trajectories[0].states[0]
    assert start == pytest.approx([0.3, 1.5], abs=0.05)


def test_the_command_line_takes_free_starts_and_asks_for_those_of_states_without_a_column(tmp_path):
    drawn("pendulum", count=1)[-1].to_frame().to_csv(tmp_path / "swings.csv", index=False)
    command = ["fit", str(tmp_path / "swings.csv"), PENDULUM]
    done = CliRunner().invoke(commonlaw, [*command, "--initial-value", "omega=free"])
    assert done.exit_code == 0, done.output
    assert "omega' = -g sin(theta) - c omega" in done.output
    asked = "if omega is a latent state, give its initial value: commonlaw fit --initial-value omega=VALUE"
    assert asked in CliRunner().invoke(commonlaw, command).stderr


@pytest.mark.parametrize(
    ("equations", "found"),
    [
        ("x' = -k x + c u; u' = -r u", (True, False, True)),
        ("x' = -k x + u; u' = -r u", (False, False, False)),
        ("x' = a x + u; u' = b + r u", (False, False, False)),
        ("x' = a + u; u' = -u", (False, False, False)),
        ("x' = a + u; u' = b - u", (False, True, True)),
        ("x' = -(k + q) x + r u; u' = q x - r u", (False, False, True)),
        ("x' = b u x - g x; u' = -b u x", (False, False, False)),
        ("x' = b u x - g x; u' = -c u x", (True, False, True)),
    ],
)
def test_what_a_state_may_be_exchanged_for(equations, found):
    given = read_equations(equations, Schema(("x", "u")))
    hidden = np.array([False, True])
    sizes = np.full(3, np.nan)
    kinds = ("scaling", "translation", "mixing")
    assert tuple(bool(has_symmetry(kind, given.terms, given.known, hidden, sizes)[1]) for kind in kinds) == found


@pytest.mark.parametrize(
    ("equations", "message"),
    [
        ("S' = -b S I; I' = c S I - g I", Diagnostic("latent-scale", {"name": "S", "quantity": "scale"})),
        ("S' = b - S; I' = a + S", Diagnostic("latent-scale", {"quantity": "zero"})),
        ("S' = b I - r S; I' = r S - (b + k) I", "latent-initial-value"),
    ],
)
def test_what_no_trial_could_tell_is_refused_by_name(equations, message):
    *_, trials = drawn("epidemic", count=1)
    with refused(message):
        cl.fit(equations, trials, initial_values={"S": None})


def test_coefficients_that_the_trials_do_not_tell_are_named():
    times = np.linspace(0, 0.5, 12)
    measured = solve_ivp(epidemic, (0, 0.5), [10.0, 990.0], t_eval=times, args=(5e-4, 0.15)).y[0]
    measured = measured + 0.05 * np.random.default_rng(0).standard_normal(len(times))
    trials = cl.Trials.from_arrays(times, measured, object="town", names=["I"])
    law = cl.fit(EPIDEMIC, trials, initial_values={"S": None}, errors="white")
    (outcome, *_) = [diagnostic for diagnostic in law.diagnostics if diagnostic.kind == "not identifiable"]
    assert outcome.code == "parameters-with-latent-states"
