"""Initial values that are given for one trial, or for each one by a column."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.estimation.model import ModelText
from commonlaw.law.parameters import named_parameters
from tests.refusals import refused

T = np.linspace(0, 6, 7)
EQUATIONS = "A' = -a A; B' = a A - b B"


def chain(start_a, start_b, a=0.7, b=0.3):
    decay_a, decay_b = np.exp(-a * T), np.exp(-b * T)
    return start_a * decay_a, start_b * decay_b + start_a * a * (decay_a - decay_b) / (b - a)


@pytest.fixture(scope="module")
def table():
    parts = []
    for name, start in {"A; 1st": (5.0, 0.5), "B = alone": (0.0, 4.0)}.items():
        a, b = chain(*start)
        generator = np.random.default_rng(len(parts))
        a, b = (column + 0.01 * generator.standard_normal(len(T)) for column in (a, b))
        unmeasured = name == "B = alone"
        parts.append(pd.DataFrame({"dish": name, "t": T, "A": np.nan if unmeasured else a, "B": b, "A_0": start[0]}))
    return pd.concat(parts)


@pytest.fixture(scope="module")
def trials(table):
    return cl.Trials.from_frame(table.drop(columns="A_0"), object="", trial="dish", time="t")


@pytest.fixture(scope="module")
def law(trials):
    return cl.fit(f'{EQUATIONS}; A(0) = 0 @ "B = alone"', trials)


def rates(law):
    named = named_parameters(law)
    return [float(named.values[0, named.names.index(name)]) for name in "ab"]


def test_the_start_of_a_trial_is_as_written_and_others_are_estimated(law, trials):
    assert rates(law) == pytest.approx([0.7, 0.3], abs=0.01)
    starts = law.trial_estimates.to_frame()[["trial", "parameter"]].to_numpy().tolist()
    assert starts == [["A; 1st", "A(0)"], ["A; 1st", "B(0)"], ["B = alone", "B(0)"]]
    assert np.all(law.predict(trials).latent[1][:, 0] == 0)
    assert 'A(0) = 0 @ "B = alone"' in str(law).splitlines()


def test_a_start_of_a_trial_is_saved_and_kept_by_refits(law, trials, tmp_path):
    law.save(tmp_path / "law.json")
    opened = cl.Law.load(tmp_path / "law.json")
    assert str(opened) == str(law)
    assert np.all(opened.predict(trials).latent[1][:, 0] == 0)
    assert rates(cl.refine(opened, trials)) == pytest.approx(rates(law), rel=1e-4)
    first = cl.refine(opened, trials.with_trials(trials.trials[:1]))
    assert rates(first) == pytest.approx([0.7, 0.3], abs=0.02)


def test_trials_of_one_start_have_one_line_that_equations_may_have(trials):
    given = {"A": {"A; 1st": 5.0, "B = alone": 5.0}, "B": {"A; 1st": 0.5, "B = alone": 4.0}}
    written = ['A(0) = 5 @ "A; 1st", "B = alone"', 'B(0) = 0.5 @ "A; 1st"', 'B(0) = 4 @ "B = alone"']
    assert ModelText.of([EQUATIONS, *written]).initial == given
    law = cl.fit("; ".join([EQUATIONS, *written]), trials)
    assert [line for line in str(law).splitlines() if "@" in line] == written
    assert [step.choice for step in law.history if step.stage == "start"] == written
    with refused("initial-value-twice"):
        ModelText.of([EQUATIONS, 'A(0) = 5 @ "1", "1"'])


def test_numbers_by_the_label_of_a_trial_are_starts(law, trials):
    again = cl.fit(EQUATIONS, trials, initial_values={"A": {trials.trials[1].label: 0.0}}, initial_time=0.0)
    assert rates(again) == pytest.approx(rates(law), rel=1e-6)


def test_objects_that_are_called_like_trials_have_the_starts(table):
    first = table[table.dish == "A; 1st"]
    parts = [first.assign(object=str(i), trial="1", A=i * first.A, B=i * first.B) for i in (1, 2)]
    trials = cl.Trials.from_frame(pd.concat(parts)[["object", "trial", "t", "A", "B"]])
    law = cl.fit(EQUATIONS, trials, initial_values={"A": {"1": 5.0, "2": None}})
    starts = law.trial_estimates.to_frame()
    assert starts[starts.parameter == "A(0)"][["object", "trial"]].to_numpy().tolist() == [["2", "1"]]


def test_a_column_that_is_constant_in_each_trial_is_a_start(table):
    trials = cl.Trials.from_frame(table, object="", trial="dish", time="t", inputs=["A_0"])
    by_column = cl.fit(f"{EQUATIONS}; A(0) = A_0", trials)
    assert rates(by_column) == pytest.approx([0.7, 0.3], abs=0.01)
    assert np.all(by_column.predict(trials).latent[1][:, 0] == 0)
    varying = cl.Trials.from_frame(table.assign(A_0=table.t), object="", trial="dish", time="t", inputs=["A_0"])
    with pytest.raises(cl.CommonlawError) as refusal:
        cl.fit(f"{EQUATIONS}; A(0) = A_0", varying)
    assert refusal.value.code == "initial-value-of-variables"
