"""What laws with observation equations leave unexplained, against laws of measured states and simulated data."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import f

import commonlaw as cl
from commonlaw.plots import plot_discrepancy, plot_residuals, render
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("few_starts")

NOISE = 0.02
TIMES = np.linspace(0.0, 6.0, 40)


def decay(_, x, k, missing):
    return -k * x + missing * x**2


def growth(_, x, size):
    return 0.5 - 0.4 * x - 0.1 * x**2 * size


def decays(seed, missing=0.0, name="y", observed=lambda x: x, noise=None, starts=(1.0, 2.0)):
    """Return trials of ``x' = -k x + missing x^2`` of two objects."""
    random, made = np.random.default_rng(seed), []
    for owner, k in {"A": 0.6, "B": 0.9}.items():
        for i, start in enumerate(starts):
            x = solve_ivp(decay, (0, 6), [start], t_eval=TIMES, args=(k, missing), rtol=1e-9).y[0]
            white = random.standard_normal(len(TIMES))
            y = observed(x) + NOISE * white if noise is None else noise(observed(x), white)
            made.append(cl.Trial(owner, str(i), TIMES, y))
    return cl.Trials(tuple(made), cl.Schema((name,)))


@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_the_function_is_that_of_a_law_whose_states_are_measured(missing):
    """The states are fitted by collocation there, and by shooting here."""
    plain = cl.fit("x' = -k x", decays(1, missing, "x"), noise={"x": NOISE}, errors="white")
    one = plain.discrepancy(decays(1, missing, "x"), "x", noise={"x": NOISE})
    seen = cl.fit("x' = -k x; y = x", decays(1, missing), noise={"y": NOISE}, errors="white")
    other = seen.discrepancy(decays(1, missing), "x", noise={"y": NOISE})
    grid = np.linspace(0.1, 2.0, 6)
    assert (np.abs(other(grid) - one(grid)) < 0.25 * one.std(grid)).all()
    assert other.std(grid) == pytest.approx(one.std(grid), rel=0.2)
    assert one.claimed == other.claimed == bool(missing)
    if not missing:  # Else random forces explain some of it where states are measured
        assert other.evidence == pytest.approx(one.evidence, abs=0.05)
    for column in ("estimate", "standard error"):
        assert other.law.params[column].to_numpy() == pytest.approx(one.law.params[column].to_numpy(), rel=0.2)


def affine(x):
    return 3 * x + 0.5


AFFINE = "x' = -k x; y = s x + b; x(0) = 2"


@pytest.fixture(scope="module")
def lacking():
    """Return decays, a law that lacks a term of theirs, and its discrepancy."""
    trials = decays(0, 0.1, observed=affine, starts=(2.0,))
    law = cl.fit(AFFINE, trials, shared=["s", "b"])
    return trials, law, law.discrepancy(trials)


def test_a_missing_term_is_found_where_there_is_one_and_only_there(lacking, tmp_path):
    trials, law, found = lacking
    assert found.claimed
    assert found.evidence > 6
    assert (found.equation, found.basis.coordinate) == ("x'", "x")
    assert found.shares["shared discrepancy"] > 0.3
    assert any("x^2" in each.terms for each in found.descriptions)
    assert "d(x')/d(k)" in found.holds_nothing_of
    assert {"trend with y", "trend with x"} <= {each.pattern for each in law.residuals(trials).significant}
    assert render(plot_discrepancy(found), "svg").startswith(b"<?xml")
    assert [panel.get_xlabel() for panel in plot_residuals(law.residuals(trials)).axes][1:3] == ["y", "x"]
    found.law.save(tmp_path / "better.json")
    forecasts = [each.predict(trials, discrepancy=True) for each in (found.law, cl.Law.load(tmp_path / "better.json"))]
    np.testing.assert_array_equal(forecasts[0].trajectories[0].states, forecasts[1].trajectories[0].states)
    whole = decays(0, observed=affine, starts=(2.0,))
    law = cl.fit(AFFINE, whole, shared=["s", "b"], noise={"y": NOISE})
    assert not law.discrepancy(whole, noise={"y": NOISE}).claimed


def test_a_missing_force_is_a_function_of_the_velocity():
    """Of an oscillator that is seen by the square of its deflection, drag ``-c v abs(v)`` is missing."""
    times, random, made = np.linspace(0, 10, 80), np.random.default_rng(0), []
    for i, start in enumerate((1.0, 1.5)):
        x = solve_ivp(
            lambda _, z: (z[1], -2 * z[0] - 0.15 * z[1] * abs(z[1])), (0, 10), [start, 0], t_eval=times, rtol=1e-9
        ).y[0]
        made.append(cl.Trial("A", str(i), times, x**2 + 0.01 * random.standard_normal(80)))
    trials = cl.Trials(tuple(made), cl.Schema(("y",)))
    law = cl.fit("x'' = -k x; y = x^2; x'(0) = 0; x(0) = a", trials, shared={"a": "trial"}, guesses={"k": 2, "a": 1})
    found = law.discrepancy(trials, "v")
    assert found.claimed
    grid = np.linspace(-1.2, 1.2, 7)
    assert found(grid) == pytest.approx(-0.15 * grid * abs(grid), abs=0.04)


def test_functions_may_be_of_properties_that_stand_in_no_equation():
    """The growth of two cultures has a term in ``x size``."""
    random, made, sizes = np.random.default_rng(2), [], {"A": 0.4, "B": 1.6}
    for owner, size in sizes.items():
        x = solve_ivp(growth, (0, 6), [0.1], t_eval=TIMES, args=(size,), rtol=1e-9).y[0]
        made.append(cl.Trial(owner, "1", TIMES, 2 * x + NOISE * random.standard_normal(len(TIMES))))
    trials = cl.Trials(tuple(made), cl.Schema(("y",)), {owner: {"size": size} for owner, size in sizes.items()})
    law = cl.fit("x' = a - k x; y = 2 x", trials, shared=["a", "k"])
    by_size, alone = (law.discrepancy(trials, of) for of in ("x^2*size", "x"))
    assert by_size.evidence > 10
    assert by_size.evidence > alone.evidence
    better = by_size.law.predict(trials, start="all", discrepancy=True)
    assert better.metric("rmse") < 1.25 * NOISE < 0.5 * law.predict(trials, start="all").metric("rmse")


def test_residuals_are_those_of_the_measured_quantities_by_their_logarithms():
    trials = decays(4, observed=affine, noise=lambda y, white: y * np.exp(0.03 * white), starts=(2.0,))
    law = cl.fit(AFFINE, trials, shared=["s", "b"], log_states=["y"])
    found, params = law.residuals(trials), law.params.set_index(["object", "parameter"])["estimate"]
    for trial, residuals in zip(trials, found.standardized, strict=True):
        k, s, b = (params[trial.object, name] for name in "ksb")
        expected = np.log(trial.states[:, 0] / (s * 2 * np.exp(-k * TIMES) + b)) / law.uncertainty.noise[0]
        assert residuals[:, 0] == pytest.approx(expected, abs=1e-5)
    assert not found.significant
    assert not law.discrepancy(trials).claimed


@pytest.mark.parametrize(
    ("noise", "pattern"),
    [
        (lambda y, white: y + NOISE * np.convolve(white, [1, 0.9, 0.8, 0.7, 0.6])[: len(y)], "autocorrelation"),
        (lambda y, white: y * (1 + 0.05 * white), "heteroscedasticity"),
    ],
)
def test_patterns_of_residuals_are_found_through_observations(noise, pattern):
    trials = decays(5, observed=lambda x: 3 * x + 0.2, noise=noise)
    law = cl.fit("x' = -k x; y = 3 x + b", trials, shared=["b"], errors="white")
    assert pattern in {each.pattern for each in law.residuals(trials).significant}


def test_trials_that_differ_are_noted_by_the_f_test_of_straight_lines():
    """Each trial is a line ``y = 2 x(0) + 2 a t``, whose slopes are compared by least squares."""
    decisions = []
    for seed in range(6, 12):
        random, times = np.random.default_rng(seed), np.linspace(0, 2, 15)
        y = [2 * (1 + i + 0.5 * a * times) + 0.1 * random.standard_normal(15) for i, a in enumerate((1.0, 1.0, 1.1))]
        trials = cl.Trials(tuple(cl.Trial("A", str(i), times, each) for i, each in enumerate(y)), cl.Schema(("y",)))
        centred, shifted = times - times.mean(), [each - each.mean() for each in y]
        common = np.mean(shifted, axis=0) @ centred / (centred @ centred)
        together = sum(np.sum((each - common * centred) ** 2) for each in shifted)
        apart = sum(each @ each - (each @ centred) ** 2 / (centred @ centred) for each in shifted)
        p_value = f.sf((together - apart) / 2 / (apart / (45 - 6)), 2, 45 - 6)
        noted = {each.kind for each in cl.fit("x' = a; y = 2 x", trials).diagnostics}
        assert ("trials differ" in noted) == (p_value < 0.01)
        decisions.append(p_value < 0.01)
    assert 0 < sum(decisions) < 6
    varying = cl.fit("x' = a; y = 2 x", trials, shared={"a": "trial"})
    assert "trials differ" not in {each.kind for each in varying.diagnostics}


def test_forecasts_add_the_function_with_its_error(lacking):
    """Against SciPy's solution with the function, and the delta method with its differences."""
    _, law, found = lacking
    new = decays(7, 0.1, observed=affine, starts=(2.0,)).select(object="B")
    forecast = found.law.predict(new, discrepancy=True, return_std=True)
    params = found.law.params.set_index(["object", "parameter"])["estimate"]["B"]
    first = np.array([*params[["k", "s", "b"]], *found.weights])

    def solution(p):
        def rate(_, x):
            return -p[0] * x + found.basis.values(x) @ p[3:]

        return p[1] * solve_ivp(rate, (0, 6), [2.0], t_eval=TIMES, rtol=1e-10, atol=1e-12).y[0] + p[2]

    assert forecast.trajectories[0].states[:, 0] == pytest.approx(solution(first), abs=1e-6)
    assert forecast.metric("rmse") < 1.2 * NOISE < law.predict(new).metric("rmse")
    step = 1e-4
    slopes = np.array(
        [(solution(first + step * e) - solution(first - step * e)) / 2 / step for e in np.eye(len(first))]
    )
    covariance = found.law.provenance.with_discrepancy.cov_params("B").to_numpy()
    expected = np.sqrt(np.einsum("pn,pq,qn->n", slopes, covariance, slopes))
    assert forecast.std[0][:, 0] == pytest.approx(expected, rel=1e-3)
    with refused("discrepancy-missing"):
        law.predict(new, discrepancy=True)
    with refused("discrepancy-outdated"):
        replace(found.law, coefficients=1.1 * found.law.coefficients).predict(new, discrepancy=True)
