"""Residuals, of trials in memory and of streams, and what a law leaves unexplained."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import commonlaw as cl
from commonlaw import Law, Trials
from commonlaw.datasets.sphere_drag import drag_force, reynolds_number
from commonlaw.discrepancy.function import Discrepancy
from commonlaw.discrepancy.residual_tests import StateSums, correlations, patterns, patterns_of
from commonlaw.discrepancy.smooth_basis import Samples, SmoothBasis, factors, meaning
from commonlaw.discrepancy.trajectories import SharedRows, posterior
from commonlaw.law import from_json, select_objects, to_json
from commonlaw.law.parameters import standard_errors
from commonlaw.law.uncertainty import ObjectEstimates
from commonlaw.plots import plot_residuals
from tests.refusals import message, refused


def decays(disturb, samples: int = 60) -> Trials:
    """Return ten decays with noise of 0.01, to which disturbances of shape (samples,) by time and state are added."""
    times, rng = np.linspace(0.0, 3.0, samples), np.random.default_rng(3)
    states = [start * np.exp(-times) for start in np.linspace(1.0, 2.0, 10)]
    noisy = [state + disturb(times, state, rng) for state in states]
    return Trials.from_arrays([times] * 10, noisy, trial=list(range(10)))


DECAY = Law.from_text("x' = -k x", {"k": 1.0})
WHITE = replace(DECAY, uncertainty=replace(DECAY.uncertainty, noise=[0.01]))


def white(times, _states, rng):
    return rng.normal(0.0, 0.01, len(times))


def found(disturb) -> dict[str, str]:
    """Return what the patterns that are there mean, by pattern."""
    return {each.pattern: each.meaning for each in WHITE.residuals(decays(disturb)).significant}


def test_white_noise_has_no_pattern():
    assert found(white) == {}
    residuals = WHITE.residuals(decays(white))
    assert "no pattern is significant" in str(residuals)
    assert repr(residuals) == "<Residuals of 10 trials: 0 of 6 patterns are significant>"


@pytest.mark.parametrize(
    ("disturb", "pattern", "meaning"),
    [
        (lambda t, x, r: 2 * white(t, x, r), "RMS over noise", "lack of fit, or the noise is underestimated"),
        (lambda t, x, r: white(t, x, r) + 0.03 * np.sin(t), "trend with t", "an unmodelled change with time"),
        (lambda t, x, r: white(t, x, r) + 0.03 * (x - 0.5) ** 2, "trend with x", "a term in x, or in a collinear"),
        (lambda t, x, r: white(t, x, r) * 2 * x, "heteroscedasticity", "errors='proportional'"),
        (lambda t, _, r: np.convolve(r.normal(0, 0.006, len(t) + 3), np.ones(4), "valid"), "autocorrelation",
         "autocorrelated: "),
        (lambda t, _, r: np.diff(r.normal(0, 0.007, len(t) + 1)), "autocorrelation",
         "negatively autocorrelated"),
        (lambda t, _, r: 0.006 * r.standard_t(3, len(t)), "normality (excess kurtosis)", "tails are heavy"),
        (lambda t, _, r: 0.01 * (r.exponential(size=len(t)) - 1), "normality (excess kurtosis)", "lean to one side"),
    ],
)  # fmt: skip
def test_each_pattern_is_found_and_has_its_meaning(disturb, pattern, meaning):
    assert meaning in found(disturb).get(pattern, "")


def test_residuals_of_states_that_err_together_are_correlated():
    truth = Law.from_text(["x' = -k x", "y' = -c y"], {"k": 1.0, "c": 1.0})
    law = replace(truth, uncertainty=replace(truth.uncertainty, noise=[0.01, 0.01]))
    times, rng = np.linspace(0.0, 3.0, 100), np.random.default_rng(1)
    decay = np.exp(-times)[:, np.newaxis] * [1.0, 2.0]
    both = rng.normal(0.0, 0.009, (100, 1)) + rng.normal(0.0, 0.004, (100, 2))
    trials = Trials.from_arrays(times, decay + both, names=["x", "y"])
    found = law.residuals(trials)
    (pattern,) = [each for each in found.patterns if each.pattern == "correlation with residuals of x"]
    assert pattern.significant
    own = np.concatenate(found.standardized)
    assert pattern.statistic == pytest.approx(stats.pearsonr(*own.T).statistic)
    assert len(plot_residuals(found).axes) > 2


def test_correlations_are_within_trials_and_leave_gaps_out():
    first, second = np.array([1.0, -1.0, np.nan, 1.0, 2.0]), np.array([3.0, -3.0])
    mean, variance = np.nanmean(np.append(first, second)), np.nanvar(np.append(first, second))
    pairs = [(1, -1), (1, 2), (3, -3)]
    value, count = correlations([first, second], 1)
    assert count[0] == 3
    assert value[0] == pytest.approx(np.mean([(a - mean) * (b - mean) for a, b in pairs]) / variance)


@pytest.mark.parametrize(("samples", "trials"), [(8, 12), (12, 10), (49, 10)])
def test_white_noise_has_no_memory_after_a_fit_to_short_trials(samples, trials):
    curves = np.linalg.qr(np.vander(np.linspace(-1, 1, samples), 4))[0]
    found = []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(size=(trials, samples))
        left = list((noise - noise @ curves @ curves.T)[:, :, np.newaxis])
        columns = {"t": np.tile(np.arange(float(samples)), trials), "x": noise.ravel()}
        tested = patterns(["x"], left, columns, "t", [4 * trials])
        found.append(next(each.p_value for each in tested if each.pattern == "autocorrelation"))
    assert np.mean(np.array(found) < 0.01) <= 0.05
    assert np.mean(np.array(found) < 0.5) > 0.2


def test_coefficients_that_all_objects_share_are_spent_once():
    trials = decays(white)
    names = [f"object {i}" for i in range(10)]
    apart = trials.with_trials([replace(trial, object=name) for trial, name in zip(trials, names, strict=True)])
    law = Law.from_text("x' = -k x", {"k": dict.fromkeys(names, 1.0)})
    own = np.full((10, 1, 1), 1e-4)
    for covariance, spent in ((own, 20), (own / 10, 11)):
        unpooled = ObjectEstimates(law.coefficients[:, 0], own)
        uncertain = replace(law.uncertainty, noise=[0.01], covariance=covariance, unpooled=unpooled)
        found = replace(law, uncertainty=uncertain).residuals(apart)
        squares = np.concatenate(found.standardized) ** 2
        (level,) = [pattern.statistic for pattern in found.patterns if pattern.pattern == "RMS over noise"]
        assert level == pytest.approx(np.sqrt(squares.sum() / (len(squares) - spent)))


def test_few_samples_are_not_tested_and_discrete_time_is_refused():
    short = decays(white, 60).select(trial=0).until(0.5)
    assert str(WHITE.residuals(short)) == "There are too few residuals to test."
    steps = cl.Law.from_text("x[k+1] = 0.9 x")
    with refused("discrete-without-trajectories"):
        steps.residuals(short)


def test_a_law_that_does_not_know_its_noise_takes_it_from_the_samples():
    table = DECAY.residuals(decays(white)).to_frame()
    assert table["x residual/noise"].std() == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(("spent", "is_seen"), [(0.0, True), (0.05, False)])
def test_sizes_may_grow_by_what_the_fit_took_of_the_noise(spent, is_seen):
    generator, n = np.random.default_rng(0), 20_000
    x = generator.uniform(1, 2, n)
    residuals = (1 + 0.1 * x) * generator.standard_normal(n)
    found = patterns(["x"], [residuals[:, np.newaxis]], {"t": np.arange(n, dtype=np.float64), "x": x}, "t", [spent * n])
    (growth,) = (each for each in found if each.pattern == "heteroscedasticity")
    assert 0.01 < growth.statistic < 0.05
    assert growth.significant == is_seen


def disturbed(count: int, samples: int = 60) -> cl.Trials:
    """Return decays of two states that turn into each other, of objects with rates of their own, with odd noise."""
    rng, times = np.random.default_rng(1), np.linspace(0.0, 3.0, samples)
    trials, starts = [], rng.uniform(1, 2, (2 * count, 2))
    for i, (a, b) in enumerate(starts):
        k = 1 + 0.2 * (i // 2)
        clean = np.column_stack([a * np.exp(-k * times), (a + b) - a * np.exp(-k * times)])
        noise = rng.normal(size=clean.shape) * [[0.01, 0.02]] * (1 + clean)
        noise[:, 1] += noise[:, 0] + 0.004 * np.sin(times)
        noise[rng.uniform(size=clean.shape) < 0.1] = np.nan
        noise[[0, -1]] = 0.0
        trials.append(cl.Trial(f"jar {i // 2}", str(i % 2), times + rng.normal(), clean + noise))
    return cl.Trials(tuple(trials), cl.Schema(("a", "b")))


@pytest.fixture(scope="module")
def jars():
    return disturbed(6)


@pytest.fixture(scope="module")
def stream(jars, tmp_path_factory):
    """Return jars of which each has its trials in two files."""
    folder = tmp_path_factory.mktemp("jars")
    for trial in ("0", "1"):
        jars.select(trial=trial).to_parquet(folder / f"{trial}.parquet")
    return cl.TrialStream.from_parquet(folder)


@pytest.fixture(scope="module")
def law(jars):
    rates = {name: 1 + 0.2 * i for i, name in enumerate(jars.objects)}
    law = Law.from_text("a' = -k a; b' = k a", {"k": rates})
    return replace(law, uncertainty=replace(law.uncertainty, noise=[0.01, 0.02]))


def test_patterns_are_those_of_all_trials_in_memory(law, stream, jars):
    found, whole = cl.check_stream(law, stream), law.residuals(jars)
    pd.testing.assert_frame_equal(found.tests(), whole.tests(), rtol=1e-8, atol=1e-14)
    assert str(found) == str(whole)
    assert {each.pattern for each in found.significant} >= {"correlation with residuals of a", "heteroscedasticity"}


def test_each_object_has_what_its_own_residuals_say(law, stream, jars):
    found = cl.check_stream(law, stream).objects.set_index(["object", "state"])
    assert len(found) == 12
    for name in ("jar 0", "jar 5"):
        own = select_objects(law, [name]).residuals(jars.select(object=name)).tests().set_index(["state", "pattern"])
        for state in ("a", "b"):
            row = found.loc[name, state]
            assert row["RMS over noise"] == pytest.approx(own.loc[(state, "RMS over noise"), "statistic"], rel=1e-6)
            assert row["p-value"] == pytest.approx(own.loc[(state, "RMS over noise"), "p-value"], rel=1e-4)
    np.testing.assert_allclose(found["adjusted"], stats.false_discovery_control(found["p-value"], method="by"))


def test_noise_that_a_law_does_not_know_is_that_of_all_files(tmp_path):
    drops = cl.datasets.linear_drag(drag=(-0.2, -0.4, -0.6), noise=0.05)
    for name in drops.objects:
        drops.select(object=name).to_parquet(tmp_path / f"{name}.parquet")
    law = cl.Law.from_text("x'' = -9.8 - c v", {"c": dict(zip(drops.objects, (0.2, 0.4, 0.6), strict=True))})
    found, whole = cl.check_stream(law, cl.TrialStream.from_parquet(tmp_path)), law.residuals(drops)
    pd.testing.assert_frame_equal(found.tests(), whole.tests(), rtol=1e-8, atol=1e-14)


@pytest.mark.parametrize("kept", [10**6, 100])
def test_statistics_are_those_of_scipy(kept, monkeypatch):
    monkeypatch.setattr("commonlaw.discrepancy.residual_tests.MAX_KEPT", kept)
    rng = np.random.default_rng(0)
    t, x = np.tile(np.arange(50.0), 20), rng.normal(5.0, 3.0, 1000)
    own = rng.normal(0.1, 0.3 * np.abs(x)) + 0.01 * (x - 5) ** 2 + 0.01 * t
    left = np.column_stack([rng.normal(size=1000) + 0.2 * own, own])
    against = {"t": t, "x": x, "u": np.repeat([1.0, 3.0], 500)}
    parts = [slice(0, 300), slice(300, 1000)]
    sums = [
        sum_of(
            StateSums.of(j, np.split(left[part], len(left[part]) // 50), {k: v[part] for k, v in against.items()}, "x")
            for part in parts
        )
        for j in (0, 1)
    ]
    found = {each.pattern: each for each in patterns_of(["y", "x"], sums, "t", [0, 0]) if each.state == "x"}
    for name, values in against.items():
        degree = min(3, len(np.unique(values)) - 1)
        fit = np.polynomial.Polynomial.fit(values, own, degree)(values)
        left_over, total = np.sum((own - fit) ** 2), np.sum((own - own.mean()) ** 2)
        free = 1000 - degree - 1
        test = stats.f.sf((total - left_over) / degree / (left_over / free), degree, free)
        assert found[f"trend with {name}"].statistic == pytest.approx(1 - left_over / total, rel=1e-9)
        assert found[f"trend with {name}"].p_value == pytest.approx(test, rel=1e-6, abs=0)
    pearson = stats.pearsonr(own, left[:, 0])
    assert found["correlation with residuals of y"].statistic == pytest.approx(pearson.statistic, rel=1e-9)
    assert found["correlation with residuals of y"].p_value == pytest.approx(pearson.pvalue, rel=1e-6, abs=0)
    spearman, exact = stats.spearmanr(np.abs(own), np.abs(x)), kept > 1000
    assert found["heteroscedasticity"].statistic == pytest.approx(spearman.statistic, abs=1e-12 if exact else 1e-3)
    normal = found["normality (excess kurtosis)"]
    assert normal.statistic == pytest.approx(stats.kurtosis(own), rel=1e-9)
    test = stats.shapiro(own) if exact else stats.jarque_bera(own)
    assert normal.p_value == pytest.approx(test.pvalue, rel=1e-6, abs=0)
    if exact:
        assert found["heteroscedasticity"].p_value == pytest.approx(spearman.pvalue, rel=1e-6, abs=0)


def test_the_autocorrelation_of_one_trial_is_tested_as_by_ljung_and_box():
    from statsmodels.tsa.stattools import acf, q_stat

    own = np.convolve(np.random.default_rng(5).normal(size=201), [1.0, 0.15], "valid")
    found = patterns(["x"], [own[:, np.newaxis]], {"t": np.arange(200.0), "x": own}, "t", [0])
    (tested,) = (each for each in found if each.pattern == "autocorrelation")
    lagged = acf(own, adjusted=True, nlags=1)[1:]
    assert tested.statistic == pytest.approx(lagged[0])
    assert tested.p_value == pytest.approx(q_stat(lagged, 200)[1][0])
    assert 0.001 < tested.p_value < 0.5


def sum_of(parts):
    first, *others = parts
    for each in others:
        first += each
    return first


def test_what_is_no_stream_or_has_no_trajectories_is_refused(law, stream, jars):
    with refused("residuals-not-a-stream", type="Trials"):
        cl.check_stream(law, jars)
    with refused("discrete-without-trajectories"):
        cl.check_stream(cl.Law.from_text("a[k+1] = 0.9 a; b[k+1] = b", {}), stream)


BASIS = SmoothBasis("v", "1", 0.0, 5.0)


@pytest.fixture(scope="module")
def drops() -> Trials:
    """Drops of one ball with linear drag."""
    return cl.datasets.linear_drag(noise=0.05, seed=1).select(object="Ball 2")


@pytest.fixture(scope="module")
def without_drag(drops: Trials) -> Discrepancy[Law]:
    """Return what a law without drag leaves."""
    return cl.fit("x'' = -g", drops).discrepancy(drops, of="v")


def test_the_drag_that_a_law_lacks_is_found_and_gravity_keeps_its_meaning(without_drag: Discrepancy[Law]) -> None:
    speeds = np.linspace(-18.0, -1.0, 8)
    assert without_drag.claimed
    assert np.all(abs(without_drag(speeds) - -0.3 * speeds) < 2.5 * without_drag.std(speeds))
    gravity, error = without_drag.law.coefficients[0, 0, 0], standard_errors(without_drag.law)[0, 0, 0]
    assert abs(gravity - -9.8) < 2 * error < 1.0
    assert (without_drag.zero_at, without_drag.holds_nothing_of) == (0.0, ())
    assert without_drag.shares["noise"] < 0.1 < without_drag.shares["shared discrepancy"]
    assert sum(without_drag.shares.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_values_that_are_not_finite_are_refused(without_drag: Discrepancy[Law], value: float) -> None:
    for function in (without_drag, without_drag.std):
        with refused("discrepancy-outside", coordinate=without_drag.basis.coordinate):
            function([1.0, value])


def test_a_line_describes_the_drag_that_a_law_lacks(without_drag: Discrepancy[Law]) -> None:
    described = {description.terms: description for description in without_drag.descriptions}
    line = described[("v",)]
    assert line.evidence > 0
    assert abs(line.coefficients[0] - -0.3) < 3 * line.errors[0]


def test_forecasts_with_the_discrepancy_are_better_and_less_sure_where_nothing_was_visited(
    drops: Trials, without_drag: Discrepancy[Law]
) -> None:
    law = from_json(to_json(without_drag.law))
    assert law.provenance.calls[1:] == ("law.discrepancy(trials, of='v').law",)
    with_it, alone = (
        law.predict(drops, start=15, discrepancy=how).errors()["rms error"].max() for how in (True, False)
    )
    assert with_it < 0.1 < alone
    with refused("discrepancy-outdated"):
        replace(law, coefficients=2 * law.coefficients).predict(drops, discrepancy=True)
    assert without_drag.std(-40.0) > 5 * without_drag.std(-10.0)


def test_where_the_law_is_true_no_discrepancy_is_claimed(drops: Trials) -> None:
    found = cl.fit("x'' = -g - c v", drops).discrepancy(drops)
    assert not found.claimed
    assert {each.coordinate for each in found.compared} == {"x", "v", "t"}
    assert "No strong evidence for a discrepancy" in str(found)
    assert repr(found).startswith("<Discrepancy of x'', a function of ")


def test_a_function_of_properties_is_shared_by_objects_that_differ_in_them() -> None:
    drops = cl.datasets.reynolds_drag(trials=1).select(object=["Ball 1", "Ball 5"])
    law = cl.fit("x'' = -9.8 + c v", drops)
    found = law.discrepancy(drops, of="abs(v)*2*radius/1.503e-5", times="v*abs(v)*radius^2/mass")
    own = dict(zip(found.law.objects, found.law.coefficients[:, 0, 1], strict=True))
    for name, values in drops.properties.items():
        speed = np.array([12.0, 18.0])
        radius, mass = float(values["radius"]), float(values["mass"])
        reynolds = reynolds_number(speed, 2 * radius)
        drag = own[name] * speed + found(reynolds) * speed**2 * radius**2 / mass
        assert -drag * mass == pytest.approx(drag_force(speed, 2 * radius), rel=0.05)
    forecast = found.law.predict(drops, start=10, discrepancy=True, return_std=True)
    assert forecast.score() > 0.9999
    alone = select_objects(found.law, ["Ball 5"]).predict(drops.select(object="Ball 5"), start=10, discrepancy=True)
    np.testing.assert_allclose(alone.trajectories[0].states, forecast.trajectories[-1].states, rtol=1e-6)


def test_evidence_and_posterior_are_those_of_the_dense_gaussian_model() -> None:
    rng = np.random.default_rng(0)
    design = rng.normal(size=(30, 3))
    target = design @ [1.0, -2.0, 0.5] + rng.normal(size=30)
    rows = SharedRows.of([np.asarray(np.linalg.qr(np.column_stack([design, target]), mode="r"))], 0, 30, 0.0)
    found = posterior(rows, [np.eye(3)], 2.0, np.inf)
    logs, means = [], []
    for amplitude in 2.0 * np.geomspace(1e-3, 10.0, 17):
        covariance = np.eye(30) + amplitude**2 * design @ design.T
        logs.append(-np.linalg.slogdet(covariance)[1] / 2 - target @ np.linalg.solve(covariance, target) / 2)
        means.append(amplitude**2 * design.T @ np.linalg.solve(covariance, target))
    weights = np.exp(np.array(logs) - max(logs))
    assert found.value == pytest.approx(-2 * (max(logs) + np.log(weights.mean())))
    assert found.weights == pytest.approx(weights / weights.sum() @ np.array(means))


def test_functions_are_zero_where_they_are_to_be_and_hold_nothing_of_other_terms() -> None:
    speeds = np.linspace(0.0, 5.0, 40)
    samples = [Samples(speeds, np.ones(40), np.column_stack([np.ones(40), speeds]))]
    kept = meaning(BASIS, samples, 0.0)
    assert (kept.zero_at, kept.held) == (0.0, (1,))
    factor = factors(BASIS, kept.constraints)[0]
    draws = factor @ np.random.default_rng(0).normal(size=(factor.shape[1], 5))
    functions = BASIS.values(speeds) @ draws
    assert abs(functions[0]).max() < 1e-6 * abs(functions).max()
    assert abs(speeds @ functions).max() < 1e-6 * abs(functions).max() * 40
    assert meaning(BASIS, samples, None).held == (0, 1)


def test_terms_that_no_function_of_the_coordinate_can_say_are_left_alone() -> None:
    speeds = np.linspace(0.0, 5.0, 40)
    samples = [Samples(speeds, np.ones(40), np.random.default_rng(0).normal(size=(40, 1)))]
    assert len(meaning(BASIS, samples, 0.0).constraints) == 0


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"of": "mass*v"}, message("unknown-name", kind="variable", name="mass")),
        ({"of": "0*v"}, "several"),
        ({"of": "log(v)"}, "several"),
        ({"of": "v", "equation": "y"}, message("unknown-name", kind="equation", name="y")),
        ({"of": "v", "times": "2*v"}, message("term-with-factor", factor="2")),
    ],
)
def test_what_cannot_be_a_discrepancy_is_refused(
    drops: Trials, without_drag: Discrepancy[Law], options: dict[str, str], expected: str
) -> None:
    with refused(expected):
        without_drag.law.discrepancy(drops, **options)


def test_residuals_are_drawn_against_rates_with_their_units():
    law = Law.from_text("x'' = -g - c v", {"g": 9.8, "c": 0.1}, units={"x": "m", "t": "s"})
    law = replace(law, uncertainty=replace(law.uncertainty, noise=[0.01]))
    times = np.linspace(0.0, 2.0, 30)
    path = law.simulate(times, [10.0, 0.0])["object"].states[:, :1]
    noisy = path + np.random.default_rng(0).normal(0.0, 0.01, path.shape)
    figure = plot_residuals(law.residuals(Trials.from_arrays(times, noisy, names=["x"], units={"x": "m", "t": "s"})))
    assert [axes.get_xlabel() for axes in figure.axes][:3] == ["t (s)", "x (m)", "v (m/s)"]
