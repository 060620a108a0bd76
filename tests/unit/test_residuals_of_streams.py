"""Residuals of the trials of streams: by sums over files, and of each object."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import commonlaw as cl
from commonlaw.discrepancy.residual_tests import StateSums, patterns_of
from tests.refusals import refused


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
    folder = tmp_path_factory.mktemp("jars")
    for i in range(3):
        jars.select(object=list(jars.objects[2 * i : 2 * i + 2])).to_parquet(folder / f"{i}.parquet")
    return cl.TrialStream.from_parquet(folder)


@pytest.fixture(scope="module")
def law(jars):
    return cl.fit("a' = -k a; b' = k a", jars, noise={"a": 0.01, "b": 0.02}, errors="white")


def test_patterns_are_those_of_all_trials_in_memory(law, stream, jars):
    found, whole = cl.check_stream(law, stream), law.residuals(jars)
    pd.testing.assert_frame_equal(found.tests(), whole.tests(), rtol=1e-8, atol=1e-14)
    assert str(found) == str(whole)
    assert {each.pattern for each in found.significant} >= {"correlation with residuals of a", "heteroscedasticity"}


def test_patterns_of_more_than_are_kept_are_the_same_in_parts(jars, law, monkeypatch, stream):
    monkeypatch.setattr("commonlaw.discrepancy.residual_tests.MAX_KEPT", 200)
    found, whole = cl.check_stream(law, stream), law.residuals(jars)
    pd.testing.assert_frame_equal(found.tests(), whole.tests(), rtol=1e-8, atol=1e-14)


def test_each_object_has_what_its_own_residuals_say(law, stream, jars):
    found = cl.check_stream(law, stream).objects.set_index(["object", "state"])
    assert len(found) == 12
    for name in ("jar 0", "jar 5"):
        own = law.select([name]).residuals(jars.select(object=name)).tests().set_index(["state", "pattern"])
        for state in ("a", "b"):
            row = found.loc[name, state]
            assert row["RMS over noise"] == pytest.approx(own.loc[(state, "RMS over noise"), "statistic"], rel=1e-6)
            assert row["p-value"] == pytest.approx(own.loc[(state, "RMS over noise"), "p-value"], rel=1e-4)
    np.testing.assert_allclose(found["adjusted"], stats.false_discovery_control(found["p-value"], method="by"))


def test_an_object_with_trials_in_two_files_is_one(tmp_path, jars, law):
    for trial in ("0", "1"):
        jars.select(trial=trial).to_parquet(tmp_path / f"{trial}.parquet")
    found = cl.check_stream(law, cl.TrialStream.from_parquet(tmp_path))
    pd.testing.assert_frame_equal(found.tests(), law.residuals(jars).tests(), rtol=1e-8, atol=1e-14)
    assert len(found.objects) == 12


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
        assert found[f"trend with {name}"].p_value == pytest.approx(test, rel=1e-6)
    pearson = stats.pearsonr(own, left[:, 0])
    assert found["correlation with residuals of y"].statistic == pytest.approx(pearson.statistic, rel=1e-9)
    assert found["correlation with residuals of y"].p_value == pytest.approx(pearson.pvalue, rel=1e-6)
    spearman, exact = stats.spearmanr(np.abs(own), np.abs(x)), kept > 1000
    assert found["heteroscedasticity"].statistic == pytest.approx(spearman.statistic, abs=1e-12 if exact else 1e-3)
    normal = found["normality (excess kurtosis)"]
    assert normal.statistic == pytest.approx(stats.kurtosis(own), rel=1e-9)
    test = stats.shapiro(own) if exact else stats.jarque_bera(own)
    assert normal.p_value == pytest.approx(test.pvalue, rel=1e-6)
    if exact:
        assert found["heteroscedasticity"].p_value == pytest.approx(spearman.pvalue, rel=1e-6)


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
