"""The spelling of a law changes neither what it is nor what its fit finds."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw.law import to_json
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import read_equations

SPELLINGS = [
    (
        (("Ti", "Te"), ("Ta", "Th")),
        "Ti' = p (Te - Ti) + q (Th - Ti); Te' = r (Ti - Te) + s (Ta - Te)",
        [
            "Ti' = p Te - p Ti + q Th - q Ti; Te' = r Ti - r Te + s Ta - s Te",
            "Te' = s (Ta - Te) - r (Te - Ti); Ti' = q Th + p Te - (p + q) Ti",
            "dTi/dt = (Te - Ti)*p - q*(Ti - Th); dTe/dt = r*Ti - (r + s)*Te + s*Ta",
        ],
    ),
    (
        (("G", "X"), ("u",)),
        "G' = -(p + X) G + 92 p; X' = -q X + s u",
        ["G' = -p G - X G + 92 p; X' = s u - q X", "G' = p (92 - G) - G X; X' = -(q X - s u)"],
    ),
    (
        (("c", "b"), ()),
        "c' = -(k + m) c + n b; b' = m c - n b",
        ["c' = n b - k c - m c; b' = -(n b - m c)", "b' = m c - b n; c' = -c (k + m) + b n"],
    ),
    ((("x",), ()), "x' = r x (1 - x)", ["x' = r x - r x^2", "x' = r (x - x x)", "x' = -r x (x - 1)"]),
    ((("x",), ("u",)), "x' = a (exp(u/U) - 1) - b x", ["x' = a exp(u/U) - b x - a", "x' = -(b x + a) + exp(u/U) a"]),
    (
        (("x",), ()),
        "x' = -V x/(K + x)/2",
        ["x' = -V x/(2 (K + x))", "x' = V x/(-2 (x + K))", "x' = -V/(2 ((K + x)/x))"],
    ),
    ((("x",), ()), "x' = V x/(K + x) + V", ["x' = V (x/(K + x) + 1)", "x' = V + x V/(x + K)"]),
    ((("x",), ()), "x'' = -k x + A cos(w t + p) + A", ["x'' = A (1 + cos(p + t w)) - x k"]),
    (
        (("S", "I"), ()),
        "S' = -b S I; I' = b S I - g I",
        ["S' = -I b S; I' = (b S - g) I", "I' = I (S b - g); S' = -b I S"],
    ),
]


@pytest.mark.parametrize(("states", "first", "others"), SPELLINGS, ids=[each[1] for each in SPELLINGS])
def test_every_spelling_has_the_same_right_hand_sides_and_as_many_constants(states, first, others):
    schema, source = cl.Schema(*states), np.random.default_rng(0)
    parameters = [coefficient.name for coefficient in read_equations(first, schema).coefficients]
    values = dict(zip(parameters, source.uniform(0.5, 2, len(parameters)), strict=True))
    laws = [cl.Law.from_text(text, values, inputs=states[1]) for text in (first, *others)]
    names = laws[0].terms.variables.measured
    points = source.uniform(0.5, 2, (20, len(names)))
    rates = [
        dict(zip(law.schema.states, law.rhs("object", _ordered(law, names, points)).T, strict=True)) for law in laws
    ]
    for law, rate in zip(laws, rates, strict=True):
        assert {*law.terms.variables.parameters} == {*laws[0].terms.variables.parameters}
        assert law.support.sum() == laws[0].support.sum()
        for name in laws[0].schema.states:
            np.testing.assert_allclose(rate[name], rates[0][name], rtol=1e-12)


def _ordered(law, names, points):
    """The columns of the variables as a law has them."""
    return points[:, [names.index(each) for each in law.terms.variables.measured]]


def room(seed=0):
    """Temperature of a room whose wall, of which nothing is known, loses heat outside."""
    times = np.arange(0, 60.0)
    outside, heater = 5 + 4 * np.sin(times / 4), 20 + 5 * np.sin(times / 2.3) ** 2

    def rates(t, T):
        return [
            0.3 * (T[1] - T[0]) + 0.02 * (np.interp(t, times, heater) - T[0]),
            0.05 * (T[0] - T[1]) + 0.02 * (np.interp(t, times, outside) - T[1]),
        ]

    found = solve_ivp(rates, (0, 59), [18, 12], t_eval=times, rtol=1e-9, atol=1e-9, max_step=0.5).y[0]
    inside = found + 0.03 * np.random.default_rng(seed).normal(size=60)
    frame = pd.DataFrame({"t": times, "Ti": inside, "Ta": outside, "Th": heater})
    return cl.Trials.from_frame(frame, time="t", states=["Ti"], inputs=["Ta", "Th"])


def test_a_fit_with_a_latent_state_finds_the_same_whatever_the_spelling():
    trials, found = room(), []
    for text in SPELLINGS[0][1], SPELLINGS[0][2][1]:
        law = cl.fit(text, trials, initial_values={"Te": None}, errors="white")
        values, errors = named_parameters(law).values, named_parameters(law).errors
        found.append(dict(zip(named_parameters(law).names, values[0], strict=True)))
        truth = {"p": 0.3, "q": 0.02, "r": 0.05, "s": 0.02}
        for name, error in zip(named_parameters(law).names, errors[0], strict=True):
            assert abs(found[-1][name] - truth[name]) < 4 * error
            assert found[-1][name] == pytest.approx(found[0][name], abs=0.05 * error)


def test_a_law_that_was_saved_with_a_constant_of_several_terms_stays_readable(tmp_path):
    law = cl.Law.from_text("x' = s/(K + x) - x", {"s": 1.0, "K": 2.0})
    saved = json.loads(to_json(law))
    saved["terms"], saved["constants"] = ["K*x", "K*x**2", "K"], ["K"]
    saved["coefficients"] = {"object": [[-1.0, 1.0, 2.0]]}
    saved["provenance"]["equations"] = ["x' = K x^2 - K x"]
    (tmp_path / "law.json").write_text(json.dumps(saved))
    old = cl.Law.load(tmp_path / "law.json")
    np.testing.assert_allclose(old.rhs("object", np.array([[3.0, 0.0]])), [[2 * 9 - 2 * 3]])
