"""Standard deviations of single measurements: read with them, heeded by the likelihood, carried by forecasts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.law.parameters import standard_errors
from commonlaw.likelihood import meshes
from tests.refusals import refused

TIMES = np.linspace(0, 10, 60)
LEVELS = np.where(np.arange(60) % 3 == 0, 0.02, 0.3)
STARTS = (5.0, -1.5)


def cooling(times, start, rest, rate):
    return rest / rate + (start - rest / rate) * np.exp(-rate * times)


def cups(noise=LEVELS, seed=0):
    """Two cups that cool to 2 at a rate of 0.3; each sample has the noise that it says."""
    draws = np.random.default_rng(seed).standard_normal((2, len(TIMES)))
    states = [cooling(TIMES, 2 + start, 0.6, 0.3) + noise * draw for start, draw in zip(STARTS, draws, strict=True)]
    return cl.Trials.from_arrays([TIMES] * 2, states, object=["cup"] * 2, noise=[noise + 0 * TIMES] * 2, names=["T"])


def cells(noise="0.1", state="5"):
    return f"t,T,s [K]\n0,9,0.1\n1,{state},{noise}\n2,3,0.1\n3,2,0.2\n4,1.5,0.1\n5,1.2,0.1\n6,1,0.2\n"


def test_a_constant_column_is_the_noise_of_the_state():
    trials = cups(0.1)
    by_column, given = (
        cl.discover(trials, order=1, library="poly:3"),
        cl.discover(
            trials.without_noise(), method=cl.TrajectoryLikelihood(noise={"T": 0.1}), order=1, library="poly:3"
        ),
    )
    np.testing.assert_array_equal(by_column.coefficients, given.coefficients)
    np.testing.assert_array_equal(by_column.uncertainty.covariance, given.uncertainty.covariance)
    assert by_column.comparison.equals(given.comparison)
    assert by_column.uncertainty.noise.tolist() == given.uncertainty.noise.tolist() == [0.1]
    starts = [{"start": 1}, {"start": 20}, {"from_time": 4.0}]
    for start in starts:
        both = [
            law.predict(own, return_std=True, **start).interval(measured=True)
            for law, own in ((by_column, trials), (given, trials.without_noise()))
        ]
        assert both[0].equals(both[1])


def test_coefficients_and_errors_are_those_of_weighted_least_squares_on_the_solution():
    trials = cups()
    both = np.repeat([0, 1], len(TIMES))

    def solution(times, first, second, rest, rate):
        return np.where(both, cooling(times, second, rest, rate), cooling(times, first, rest, rate))

    measured = np.concatenate([trial.states[:, 0] for trial in trials])
    found, covariance = curve_fit(
        solution, np.tile(TIMES, 2), measured, (7, 0.5, 0.6, 0.3), np.tile(LEVELS, 2), absolute_sigma=True
    )
    law = cl.fit("T' = rest - rate T", trials, huber_threshold=np.inf)
    np.testing.assert_allclose(law.coefficients[0, 0] * [1, -1], found[2:], rtol=1e-4)
    np.testing.assert_allclose(standard_errors(law)[0, 0], np.sqrt(np.diag(covariance))[2:], rtol=2e-3)
    assert law.uncertainty.noise == [0.3]
    reasons = {step.stage: step.reason for step in law.history}
    assert reasons["noise"] == "as given for each measurement, T by T noise; their median"


def test_noise_that_grows_is_found_beside_what_was_given():
    generator, paths = np.random.default_rng(1), [cooling(TIMES, start, 0.6, 0.3) for start in (40.0, 25.0, 60.0)]
    states = [x + np.hypot(LEVELS, 0.1 * x) * generator.standard_normal(len(x)) for x in paths]
    trials = cl.Trials.from_arrays([TIMES] * 3, states, object=["cup"] * 3, noise=[LEVELS] * 3)
    law = cl.fit("x' = a - b x", trials, errors="proportional")
    assert law.uncertainty.error_model.heteroscedastic["proportional"] == pytest.approx([0.1], rel=0.25)
    assert law.uncertainty.noise == [0.3]


def test_bands_of_measurements_have_the_noise_of_their_samples_or_a_typical_one():
    trials = cups()
    law = cl.fit("T' = a + b T", trials)
    forecast = law.predict(trials, times=[11.0, 12.0], return_std=True, start=60)
    states, measured = forecast.margins()[0], forecast.margins(measured=True)[0]
    levels = np.append(LEVELS, [0.3, 0.3])
    np.testing.assert_allclose(np.sqrt(measured**2 - states**2)[:, 0] / 1.959964, levels, rtol=1e-6)
    between = law.predict(trials, times=[(TIMES[3] + TIMES[4]) / 2], return_std=True).trials[0]
    assert between.noise[4, 0] == pytest.approx(0.16)


def test_a_start_is_fitted_to_samples_as_far_as_they_are_exact():
    trials = cups()
    law = cl.fit("T' = a + b T", trials)
    exact = replace(law, uncertainty=replace(law.uncertainty, covariance=0 * law.uncertainty.covariance))
    std = exact.predict(trials, start=30, return_std=True).std[0][0, 0]
    decay = np.exp(law.coefficients[0, 0, 1] * TIMES[:30])
    assert std == pytest.approx(1 / np.sqrt(np.sum((decay / LEVELS[:30]) ** 2)), rel=1e-3)


def test_deviations_come_back_from_files_and_stay_with_their_samples(tmp_path):
    trials = cups()
    trials = trials.with_trials([trials[0], trials[1].cut(20)])
    trials.to_csv(tmp_path / "cups.csv")
    trials.to_parquet(tmp_path / "cups.parquet")
    roles = {"noise_columns": {"T": "T noise"}}
    for read in (
        cl.Trials.read(tmp_path / "cups.csv", **roles),
        cl.Trials.read(tmp_path / "cups.parquet"),
        cl.Trials.from_frame(trials.to_frame(), **roles),
        cl.TrialStream.from_parquet(tmp_path / "cups.parquet"),
    ):
        assert read.schema == trials.schema
        for one, trial in zip(read, trials, strict=True):
            np.testing.assert_array_equal(one.noise, trial.noise)
    late = trials.until(5.0)[0]
    np.testing.assert_array_equal(late.noise[:, 0], LEVELS[: len(late)])
    bare = trials.without_noise()
    assert np.isnan(bare[0].noise).all()
    assert bare.schema.noise_columns == {}


def test_points_between_samples_have_no_deviation():
    (mesh,) = meshes(cups()[:2], points=2)
    np.testing.assert_array_equal(mesh.noise[: 2 * 60 - 1 : 2, 0], LEVELS)
    assert np.isnan(mesh.noise[1 : 2 * 60 - 1 : 2]).all()


@pytest.mark.parametrize(
    ("content", "roles", "message"),
    [
        (cells("0"), {}, Diagnostic("cell-deviation", {"value": "0"})),
        (cells("-1"), {}, Diagnostic("cell-deviation", {"value": "-1"})),
        (cells(""), {}, Diagnostic("cell-deviation", {"value": "missing"})),
        (cells("inf"), {}, Diagnostic("cell-value", {"value": "is infinite"})),
        (cells("few"), {}, Diagnostic("cell-not-a-number", {"cell": "few"})),
        (
            cells(),
            {"noise_columns": {"x": "s"}},
            Diagnostic("unknown-name", {"kind": "state", "name": "x"}, "cups.csv"),
        ),
        (
            cells(),
            {"noise_columns": {"T": "sd"}},
            Diagnostic("unknown-name", {"kind": "column", "name": "sd"}, "cups.csv"),
        ),
        (cells(), {"noise_columns": "s"}, Diagnostic("argument-type", {"name": "noise_columns", "kind": "str"})),
        (cells(), {"states": ["T", "s"]}, Diagnostic("role-twice", {"column": "s"})),
        (
            cells(),
            {"units": {"T": "mK"}},
            Diagnostic("noise-column-unit", {"column": "s", "unit": "K", "state": "T", "state_unit": "mK"}),
        ),
    ],
)
def test_columns_that_do_not_fit_are_refused(tmp_path, content, roles, message):
    (tmp_path / "cups.csv").write_text(content)
    with refused(message):
        cl.Trials.read(tmp_path / "cups.csv", **({"noise_columns": {"T": "s"}} | roles))


def test_a_sample_that_was_not_measured_needs_no_deviation(tmp_path):
    for noise in ("", "0.5"):
        rows = [f"{row},{'1' if i else 'x'}" for i, row in enumerate(cells(noise, state="").splitlines())]
        (tmp_path / "cups.csv").write_text("\n".join(rows))
        trial = cl.Trials.read(tmp_path / "cups.csv", noise_columns={"T": "s"}, states=["T", "x"])[0]
        assert np.isnan(trial.states[1, 0])
        np.testing.assert_array_equal(trial.noise[1], [float(noise or "nan"), np.nan])


def test_what_does_not_go_together_is_refused():
    trials, bare = cups(), cups().without_noise()
    cases = [
        (
            lambda: replace(trials[0], noise=0 * trials[0].noise),
            Diagnostic("deviation-not-positive", {"state": "1", "value": 0.0, "sample": "1"}, "cup, trial 1"),
        ),
        (lambda: replace(trials[0], noise=[0.1]), "deviations-shape"),
        (
            lambda: bare.with_trials(trials.trials),
            Diagnostic("deviations-without-column", {"trial": "cup, trial 1", "state": "T"}),
        ),
        (
            lambda: trials.with_trials(bare.trials),
            Diagnostic("deviations-missing", {"trial": "cup, trial 1", "state": "T", "column": "T noise"}),
        ),
        (
            lambda: cl.Schema(("x",), noise_columns={"y": "s"}),
            Diagnostic("unknown-name", {"kind": "state", "name": "y"}),
        ),
        (lambda: cl.Schema(("x",), noise_columns={"x": "x"}), Diagnostic("column-name-twice", {"name": "x"})),
        (
            lambda: cl.discover(trials, method=cl.TrajectoryLikelihood(noise={"T": 1.0}), order=1, library="poly:3"),
            Diagnostic("noise-given-twice", {"name": "T"}),
        ),
        (
            lambda: cl.discover(trials, method=cl.DerivativeRegression(), order=1, library="poly:3"),
            Diagnostic("noise-columns-unsupported", {"method": "DerivativeRegression"}),
        ),
        (
            lambda: cl.discover(trials, order=0),  # No other method takes this order
            Diagnostic("noise-columns-unsupported", {"method": "DiscreteTimeRegression"}),
        ),
    ]
    for case, message in cases:
        with refused(message):
            case()
