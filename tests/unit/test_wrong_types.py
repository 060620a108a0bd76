"""Arguments of wrong types are refused by their names, with what is expected."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import Law
from commonlaw.trials import Schema

TIMES = np.linspace(0, 2, 12)
TRIALS = cl.Trials.from_arrays(TIMES, np.exp(-TIMES), names=["x"])
LAW = replace(Law.from_text("x' = -k x", {"k": 1.0}))
FRAME = pd.DataFrame({"a": [1, 2]})
WRONG = [5, 3.5, None, {}, b"x", object(), FRAME, np.zeros((2, 2)), True, [None], lambda: 1]
NOT_TRIALS = [*WRONG, "10", [TRIALS]]
NOT_NUMBERS = ["10", b"x", object(), {"a": 1}, ["a"], lambda: 1]
NOT_A_MAPPING = [5, "10", [1], object(), (1, 2), FRAME, np.zeros(2)]


def named(call, name, *codes):
    """Assert that a call is refused for an argument of this name, or by one of some codes."""
    with pytest.raises(cl.CommonlawError) as refused:
        call()
    error = refused.value
    assert error.code in codes or (error.code, error.parameters["name"]) == ("argument-type", name)


def each(values):
    return pytest.mark.parametrize("value", values, ids=range(len(values)))


@each(NOT_TRIALS)
@pytest.mark.parametrize("verb", ["predict", "assess", "residuals", "score", "discrepancy", "report"])
def test_what_is_no_trials_is_refused_by_every_verb_of_a_law(verb, value):
    named(lambda: getattr(LAW, verb)(value), "trials")


@each([5, "10", FRAME, {"a": 1}, [5], [FRAME], object()])
def test_a_table_is_no_trials(value):
    named(partial(cl.Trials, value), "trials")
    named(lambda: cl.Trials(value, Schema(("x",))), "trials")


@each(WRONG)
def test_what_is_no_schema_is_refused(value):
    named(lambda: cl.Trials(TRIALS.trials, value), "schema")


@each([*WRONG, []])
def test_what_is_no_path_is_refused(value):
    named(lambda: Law.load(value), "path")
    named(lambda: LAW.save(value), "path")
    named(lambda: cl.Trials.read(value), "path")


@each(WRONG)
def test_what_is_no_equation_is_refused(value):
    named(lambda: cl.fit(value, TRIALS), "equations", "no-equation")
    named(lambda: Law.from_text(value, {}), "equations", "no-equation")


@each(NOT_NUMBERS)
def test_what_are_no_numbers_are_refused(value):
    named(lambda: LAW.predict(TRIALS, times=value), "times")
    named(lambda: LAW.simulate(value, [1.0]), "times")
    named(lambda: LAW.simulate(TIMES, value), "initial", "unknown-name")
    named(lambda: LAW.predict(TRIALS, from_time=value), "from_time")


@each(NOT_A_MAPPING)
@pytest.mark.parametrize("name", ["initial_values", "guesses", "observe", "priors"])
def test_what_is_no_mapping_is_refused(name, value):
    named(lambda: cl.fit("x' = -k x", TRIALS, **{name: value}), name)


@each([5, 3.5, object(), lambda: 1])
@pytest.mark.parametrize("name", ["doses", "shared", "functions"])
def test_what_is_no_list_is_refused(name, value):
    named(lambda: cl.fit("x' = -k x", TRIALS, **{name: value}), name)


@each([FRAME, np.zeros((2, 2)), object()])
@pytest.mark.parametrize("name", ["errors", "covariance", "input_interpolation"])
def test_what_is_no_choice_is_refused(name, value):
    with pytest.raises(cl.CommonlawError):
        cl.fit("x' = -k x", TRIALS, **{name: value})


@each([[], {}, b"x", (1, 2), np.zeros(2), object()])
def test_what_is_no_time_is_refused(value):
    named(lambda: cl.fit("x' = -k x; x(0) = 1", TRIALS, initial_time=value), "initial_time", "initial-time-unknown")
