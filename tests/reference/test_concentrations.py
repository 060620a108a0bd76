"""Concentrations of three subjects each after a dose at time 0, sampled later, against independent least squares."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.law.parameters import named_parameters

pytestmark = pytest.mark.usefixtures("few_starts")

SUBJECTS = list("abc")


def bolus(p, times, dose):
    """Two compartments after an injection: C' = -(k10 + k12) C + k21 P, P' = k12 C - k21 P."""
    k10, k12, k21, volume = p
    rates, vectors = np.linalg.eig(np.array([[-k10 - k12, k21], [k12, -k21]]))
    start = np.linalg.solve(vectors, [dose / volume, 0.0])
    return np.real(np.exp(np.outer(times, rates)) @ (vectors[0] * start))


def oral(p, times, dose):
    """One compartment after absorption, (ka, V, k)."""
    ka, volume, k = p
    return dose / volume * ka / (ka - k) * (np.exp(-k * times) - np.exp(-ka * times))


CASES = {
    "two compartments, injected": (
        bolus,
        "C' = -(k10 + k12) C + k21 P; P' = k12 C - k21 P; C(0) = dose/V; P(0) = 0",
        ("k10", "k12", "k21", "V"),
        (0.9, 0.8, 0.6, 12.0),
        np.array([0.25, 0.5, 0.75, 1, 1.25, 2, 3, 4, 5, 6, 8]),
        0.02,
    ),
    "one compartment, swallowed": (
        oral,
        "depot' = -ka depot; C' = ka depot/V - k C; depot(0) = dose; C(0) = 0",
        ("ka", "V", "k"),
        (1.4, 25.0, 0.15),
        np.array([0.5, 1, 1.5, 2, 4, 6, 9, 12, 24]),
        0.1,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_estimates_are_those_of_least_squares(case):
    model, equations, names, typical, times, noise = CASES[case]
    random = np.random.default_rng(7)
    doses = dict(zip(SUBJECTS, 100 + 20 * random.random(len(SUBJECTS)), strict=True))
    truth = {name: np.array(typical) * np.exp(0.15 * random.standard_normal(len(typical))) for name in SUBJECTS}
    measured = {
        name: model(truth[name], times, doses[name]) + noise * random.standard_normal(len(times)) for name in SUBJECTS
    }
    trials = cl.Trials.from_arrays(
        [times] * len(SUBJECTS),
        [*measured.values()],
        object=SUBJECTS,
        names=["C"],
        properties={name: {"dose": dose} for name, dose in doses.items()},
    )
    law = cl.fit(equations, trials)
    parameters = named_parameters(law)
    columns = [parameters.names.index(name) for name in names]
    for name, found, errors in zip(
        SUBJECTS, *(a[:, columns] for a in (parameters.values, parameters.errors)), strict=True
    ):
        best = least_squares(
            lambda p, name=name: model(p, times, doses[name]) - measured[name],
            truth[name],
            x_scale=truth[name],
            xtol=1e-12,
        )
        assert (np.abs(found - best.x) < 0.1 * errors).all()


@pytest.mark.slow
def test_doses_in_rows_of_their_own_give_the_same_estimates():
    """Amounts before the first measurement, and a second one at hour 10; the depot has neither a column nor a start."""
    _, _, names, typical, times, noise = CASES["one compartment, swallowed"]
    random, tables, best = np.random.default_rng(8), [], []

    def twice(p, given):
        return oral(p, given, 100) + np.where(given > 10, oral(p, np.maximum(given - 10, 0.0), 50), 0.0)

    for _ in SUBJECTS:
        truth = np.array(typical) * np.exp(0.15 * random.standard_normal(3))
        measured = twice(truth, times) + noise * random.standard_normal(len(times))
        best.append(least_squares(lambda p, y=measured: twice(p, times) - y, truth, x_scale=truth, xtol=1e-12).x)
        rows = np.insert(np.column_stack([times, measured, 0 * times]), [0, 7], [[0, np.nan, 100], [10, np.nan, 50]], 0)
        tables.append(rows)
    trials = cl.Trials.from_arrays(
        [rows[:, 0] for rows in tables],
        [rows[:, 1:2] for rows in tables],
        inputs=[rows[:, 2:] for rows in tables],
        object=SUBJECTS,
        names=["C", "AMT"],
    )
    parameters = named_parameters(cl.fit("depot' = -ka depot + AMT; C' = ka depot/V - k C", trials, doses="AMT"))
    columns = [parameters.names.index(name) for name in names]
    assert (np.abs(parameters.values[:, columns] - best) < 0.1 * parameters.errors[:, columns]).all()
