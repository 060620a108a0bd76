"""What a law is good for, in numbers and in words."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw import datasets

pytestmark = pytest.mark.usefixtures("few_starts")


@pytest.fixture(scope="module")
def drops():
    return datasets.linear_drag(noise=0.05)


@pytest.fixture(scope="module")
def line():
    """A state that grows by 1 in each unit of time until t = 30, and by 3 from then on."""
    times = np.arange(41.0)
    return cl.Trials.from_arrays(times, times + 2 * np.maximum(times - 30, 0), units={"t": "s", "x": "m"})


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def test_a_true_law_forecasts_held_out_trials_and_its_bands_hold(drops):
    learned = drops.select(trial=1)
    verdict = cl.fit("x'' = -g - c v", learned, errors="white").assess(drops, learned)
    assert verdict.usable
    assert (verdict.segments, verdict.in_sample) == (5, False)
    assert verdict.horizon == verdict.longest > 1.5
    assert verdict.error < 0.02 * verdict.persistence
    assert verdict.coverage > 0.85
    assert verdict.sentences[0].startswith(f"This law can be used for forecasts up to {verdict.horizon:.3g} s ahead")
    assert "held-out trials" in str(verdict)
    assert not verdict.poorly_known


def test_what_was_learned_from_is_judged_where_nothing_was_held_out_and_that_is_said(drops):
    law = cl.fit("x'' = -g - c v", drops, errors="white")
    for verdict in (law.assess(drops), law.assess(drops, drops)):
        assert verdict.usable
        assert verdict.in_sample
        assert verdict.measurements == sum(len(drop) - int(np.ceil(0.2 * len(drop))) for drop in drops)
        assert str(verdict).startswith("Forecasts its training data well")
        assert "Not tested on new data" in str(verdict)


def test_errors_are_those_of_forecasts_from_early_samples_and_from_the_end_of_what_was_learned(line):
    verdict = cl.Law.from_text("x' = 1").assess(line, line.until(25.0))
    times, later = np.arange(26.0, 41.0), line[0].states[26:, 0]
    begins = (0.0, 8.0, 25.0)  # The first sample, the last of the first fifth, and the last that was learned from
    leads = np.concatenate([times - begin for begin in begins])
    errors = np.concatenate([times - later for _ in begins])
    last = np.concatenate([begin - later for begin in begins])
    spread = np.std(line[0].states)
    order = np.argsort(leads, kind="stable")
    parts = np.array_split(order, 10)
    good = [rms(errors[part]) <= spread / 2 for part in parts]
    end = leads[parts[good.index(False) - 1][-1]]
    assert (verdict.horizon, verdict.longest, verdict.measurements) == (end, 40.0, 15)
    assert verdict.error == pytest.approx(rms(errors) / spread, rel=1e-4)
    assert verdict.persistence == pytest.approx(rms(last) / spread)
    (state,) = verdict.state_errors
    assert state.persistence == pytest.approx(rms(last))
    assert state.spread == pytest.approx(spread)
    assert (state.low, state.high) == (0.0, 60.0)


def test_later_samples_by_themselves_are_forecast_from_their_first_ones(line):
    later = line.with_trials([trial.rows(slice(26, None)) for trial in line])
    law = cl.Law.from_text("x' = 1")
    verdict = law.assess(later, line.until(25.0))
    assert (verdict.segments, verdict.judged_on) == (2, "held-out later samples")
    assert verdict.measurements == 14
    assert verdict.error == pytest.approx(law.assess(later).error)


def test_forecasts_no_better_than_the_last_value_are_not_to_be_used(line):
    verdict = cl.Law.from_text("x' = 1e-12").assess(line, line.until(25.0))
    assert verdict.error == pytest.approx(verdict.persistence)
    assert verdict.usable is False
    assert "not below that of a constant forecast" in verdict.sentences[0]


@pytest.mark.slow
def test_random_walks_and_noise_cannot_be_forecast():
    draws = np.random.default_rng(0).normal(size=(2, 4, 60))
    for states, end in ((np.cumsum(draws[0], axis=1), 40.0), (draws[1], 60.0)):
        trials = cl.Trials.from_arrays([np.arange(60.0)] * 4, list(states))
        verdict = cl.fit("x' = a + b x", trials.until(end)).assess(trials, trials.until(end))
        assert verdict.usable is False
        assert verdict.sentences[0].startswith("Do not use this law for forecasts: ")


def test_a_law_that_runs_away_is_not_to_be_used(line):
    verdict = cl.Law.from_text("x' = x^2").assess(line)
    assert (verdict.diverged, verdict.usable) == (1, False)
    assert verdict.sentences[0] == "Do not use this law for forecasts: its forecasts diverge in 1 of 2 forecasts."


def test_forecasts_that_are_worse_than_the_mean_are_not_to_be_used_however_good_the_nearest_are():
    times = np.linspace(0, 40, 401)
    swinging = cl.Trials.from_arrays(times, np.sin(times))
    law = cl.Law.from_text("x'' = -k x", {"k": 1.2})
    verdict = law.assess(swinging, swinging.until(10.0))
    assert verdict.horizon > 1
    assert verdict.r_squared < 0
    assert verdict.usable is False
    assert f"R^2 over all tested forecasts is {verdict.r_squared:.3g}" in verdict.sentences[0]


def test_bands_that_fail_are_told(drops):
    law = cl.fit("x'' = -g - c v", drops, errors="white")
    certain = replace(law.uncertainty, noise=law.uncertainty.noise / 50, covariance=law.uncertainty.covariance / 2500)
    verdict = replace(law, uncertainty=certain).assess(drops)
    assert verdict.coverage < 0.5
    assert verdict.usable  # Forecasts are as good as they were
    assert "the bands are too narrow" in str(verdict)


def test_outliers_of_held_out_trials_do_not_count():
    times, random = np.linspace(0, 6, 60), np.random.default_rng(2)
    curves = [20 + (start - 20) * np.exp(-0.5 * times) + 0.2 * random.standard_normal(60) for start in (80, 26)]
    spoiled = curves[1].copy()
    spoiled[[15, 28, 35, 44]] += (40, -40, 40, 40)  # Of a trial that spans six degrees
    clean, bad = (
        cl.Trials.from_arrays([times] * 2, [curves[0], second], object="o", trial=["1", "2"], names=["T"])
        for second in (curves[1], spoiled)
    )
    learned = clean.select(trial="1")
    law = cl.fit("T' = a - k T", learned)
    without, verdict = law.assess(clean, learned), law.assess(bad, learned)
    assert (without.outliers, verdict.outliers) == (0, 4)
    assert verdict.measurements == without.measurements
    assert verdict.usable
    assert verdict.horizon == without.horizon == verdict.longest
    assert (verdict.error, verdict.persistence) == pytest.approx((without.error, without.persistence), rel=0.1)
    assert verdict.coverage == pytest.approx(without.coverage, abs=0.05)
    # By least squares each measurement counts
    every = cl.fit("T' = a - k T", learned, errors="white").assess(bad, learned)
    assert every.outliers == 0
    assert every.error > 2 * verdict.error


def test_many_outliers_of_a_law_that_knows_of_them_do_not_count_wherever_they_are():
    times, random = np.linspace(0, 8, 80), np.random.default_rng(5)
    clean = [20 + (start - 20) * np.exp(-0.5 * times) + 0.1 * random.standard_normal(80) for start in (80, 60, 45)]
    far = random.random((3, 80)) < 0.12
    far[:, [0, 40, 41, 77, 79]] = True, True, True, False, True
    curves = [curve + 12 * random.standard_normal(80) * rows for curve, rows in zip(clean, far, strict=True)]
    trials = cl.Trials.from_arrays([times] * 3, curves, object="o", trial=["1", "2", "3"], names=["T"])
    law = cl.fit("T' = a - k T", trials)
    verdict = law.assess(trials)
    assert abs(verdict.outliers - far.sum()) < 0.35 * far.sum()  # Some are small
    assert verdict.horizon == verdict.longest
    assert verdict.error < 0.02
    # What a law misses is no outlier
    missed = cl.fit("T' = -k T", trials).assess(trials)
    assert missed.outliers <= verdict.outliers + 2
    assert missed.error > 5 * verdict.error


def test_rough_forecasts_are_better_than_none():
    times = np.linspace(0, 10, 41)
    trials = cl.Trials.from_arrays(times, 3 * times + 8 * (times > 0))  # A jump after the first sample
    verdict = cl.Law.from_text("x' = 3").assess(trials)
    assert verdict.horizon == 0
    assert 0 < verdict.r_squared < 1
    assert verdict.error < verdict.persistence
    assert verdict.usable
    assert "even at the shortest horizon" in verdict.caution
    assert "with caution" in verdict.sentences[0]


def test_a_chaotic_law_can_be_used_as_far_as_its_bands_are_narrow():
    def lorenz(_, z):
        x, y, w = z
        return [10 * (y - x), x * (28 - w) - y, x * y - 8 / 3 * w]

    times, random = np.arange(0, 12, 0.02), np.random.default_rng(0)
    paths = [
        solve_ivp(lorenz, (0, 12), start, t_eval=times, rtol=1e-9).y.T + 0.2 * random.standard_normal((600, 3))
        for start in ([-8, 7, 27], [5, -3, 20])
    ]
    names = ["x", "y", "w"]
    trials = cl.Trials.from_arrays([times] * 2, paths, object="o", trial=["1", "2"], names=names)
    learned = trials.select(trial="1")
    law = cl.fit("x' = a (y - x); y' = r x - x w - y; w' = x y - b w", learned)
    verdict = law.assess(trials, learned)
    assert verdict.r_squared < 0.1
    assert verdict.error > 0.9 * verdict.persistence
    assert 0 < verdict.horizon < 0.5 * verdict.longest
    assert verdict.error_within < 0.5 * verdict.persistence_within
    assert (verdict.usable, verdict.outliers) == (True, 0)
    assert "no better than the mean" in verdict.caution
    # Bands that do not hold are no excuse
    assert replace(verdict, coverage=0.6).usable is False


def test_several_states_are_named_with_their_units():
    trials = datasets.lotka_volterra(noise=0.1, trials=1, samples=60)
    early = trials.until(3.0)
    verdict = cl.fit("x' = a x - b x y; y' = -c y + d x y", early).assess(trials, early)
    assert verdict.usable
    x, y = verdict.state_errors
    assert verdict.persistence / verdict.error > 10
    measured = np.concatenate([trial.states for trial in trials])
    assert (x.low, y.high) == (measured[:, 0].min(), measured[:, 1].max())
    assert "of a constant forecast: " in str(verdict)
    assert "held-out later samples" in str(verdict)


def test_an_unknown_object_is_forecast_with_the_mean_of_the_others(drops):
    learned = drops.select(object=drops.objects[1:])
    verdict = cl.fit("x'' = -g - c v", learned, errors="white").assess(drops, learned)
    assert verdict.unknown_objects == drops.objects[:1]
    assert verdict.segments == len(drops.of_object(drops.objects[0]))
    assert verdict.coverage > 0.85  # The scatter of the others' coefficients is in the bands
    assert "use the mean coefficients of the other objects" in str(verdict)


def test_what_is_too_short_is_not_judged():
    trials = cl.Trials.from_arrays([[0.0, 1.0], [0.0]], [[1.0, 2.0], [1.0]])
    verdict = cl.Law.from_text("x'' = 1").assess(trials)
    assert verdict.usable is None
    assert verdict.sentences == (
        "Forecast accuracy could not be assessed: the forecast trials hold no measurement.",
        "Not assessed: object, trial 1: too short, with 2 samples; object, trial 2: too short, with 1 sample.",
    )


def test_little_and_still_data_are_no_test(line):
    law = cl.Law.from_text("x' = 1")
    few = law.assess(line.until(12.0), line.until(8.0))
    assert (few.usable, few.lacking) == (None, "there are too few measurements to compare with (4)")
    rest = cl.Trials.from_arrays(np.arange(40.0), np.append([0.0, 1.0, 2.0], np.full(37, 3.0)))
    verdict = cl.Law.from_text("x'' = 1e-12 x").assess(rest)
    assert (verdict.usable, verdict.persistence) == (None, 0.0)
    assert "the states hardly change" in verdict.sentences[0]


def growth(trials, noise, capacity=100.0, samples=31, seed=0):
    """Logistic growth that has long ended when the trials do."""
    draws, times, curves = np.random.default_rng(seed), np.linspace(0.0, 30.0, samples), []
    for start in np.linspace(2.0, 6.0, trials):
        clean = capacity / (1 + (capacity / start - 1) * np.exp(-0.5 * times))
        curves.append(clean * (1 + noise * draws.standard_normal(samples)))
    return cl.Trials.from_arrays([times] * trials, curves, names=["w"], units={"t": "d", "w": "g"})


LOGISTIC = "w' = a w + b w^2"


def test_trials_that_were_left_out_are_forecast_from_their_first_samples_over_all_that_follows():
    curves = growth(3, 0.02)
    learned = curves.select(trial=["1", "2"])
    law = cl.fit(LOGISTIC, learned)
    verdict, (new,) = law.assess(curves, learned), curves.select(trial="3")
    assert verdict.measurements == len(new) - 1
    errors, last = [], []
    for first in (1, 7):  # The first sample, and the first fifth
        forecast = law.predict(curves.select(trial="3"), from_time=new.times[first], tolerance=1e-6)
        errors.append(forecast.to_frame()["w error"])
        last.append(new.states[first - 1, 0] - new.states[first:, 0])
    (state,) = verdict.state_errors
    assert state.law == pytest.approx(rms(np.concatenate(errors)), rel=1e-4)
    assert state.persistence == pytest.approx(rms(np.concatenate(last)))
    assert f"RMS forecast error: {state.law:.3g} g in w (" in str(verdict)
    assert f"of a constant forecast: {state.persistence:.3g} g (" in str(verdict)


def test_a_law_that_explains_no_more_than_trials_differ_is_not_to_be_used():
    """Forecasts that are good in half of the trials and bad in the others explain nothing for sure."""
    times = np.arange(41.0)
    trials = cl.Trials.from_arrays([times] * 2, [times, np.where(times < 12, times, 24 - times)])
    verdict = cl.Law.from_text("x' = 1").assess(trials)
    assert verdict.horizon > 0
    assert verdict.usable is False
    assert f"± {verdict.r_squared_error:.2g}" in verdict.sentences[0]


def test_a_state_that_was_not_measured_in_a_trial_leaves_its_spread_to_the_others():
    times = np.arange(30.0)
    both = np.column_stack([times, 2 * times])
    single = np.column_stack([times, np.full(30, np.nan)])
    trials = cl.Trials.from_arrays([times] * 2, [both, single], names=["x", "y"])
    x, y = cl.Law.from_text("x' = 1; y' = 2").assess(trials).state_errors
    assert (x.spread, y.spread) == pytest.approx((np.std(times), 2 * np.std(times)))


def test_an_exact_forecast_is_told_without_a_ratio():
    trials = cl.Trials.from_arrays(np.arange(20.0), np.arange(20.0))
    verdict = cl.Law.from_text("x[k+1] = x + 1").assess(trials)
    assert (verdict.error, verdict.usable) == (0, True)
    assert "RMS forecast error: 0 in x (0 % of its range, 0 to 19)" in str(verdict)


def test_coefficients_with_large_errors_are_poorly_known():
    law = cl.Law.from_text("x' = a - b x", {"a": {"one": 1.0, "two": 1.0}, "b": 0.1})
    covariance = np.array([np.diag([0.01, 0.01]), np.diag([0.36, 0.01])])
    law = replace(law, uncertainty=replace(law.uncertainty, covariance=covariance, noise=np.array([0.1])))
    trials = cl.Trials.from_arrays([np.arange(20.0)] * 2, [np.arange(20.0) ** 0.5] * 2, object=["one", "two"])
    verdict = law.assess(trials)
    assert verdict.poorly_known == ("a (x', before 1, of two)", "b (x', before x)")


def test_laws_in_discrete_time_and_without_errors_are_judged():
    states = [0.3]
    for _ in range(40):
        states.append(1.5 * states[-1] * (1 - states[-1]) + 0.05 * np.sin(len(states)))
    trials = cl.Trials.from_arrays(np.arange(41.0), states)
    verdict = cl.fit("x[k+1] = r x (1 - x)", trials).assess(trials)
    assert verdict.measurements == 40
    assert verdict.coverage is None
    assert "No bands" in str(verdict)


def test_growth_from_below_the_noise_is_judged_from_starts_that_average_it():
    """The first reading is below zero: a forecast from it alone runs away, which says nothing of the law."""
    times, source = np.linspace(0, 20, 81), np.random.default_rng(0)
    wells = [1.1 / (1 + 3000 * np.exp(-rate * times)) + 0.003 * source.standard_normal(81) for rate in (0.7, 0.8)]
    for well in wells:
        well[0] = -0.004
    trials = cl.Trials.from_arrays([times] * 2, wells, object=["a", "b"], names=["OD"])
    law = cl.fit("OD' = r OD (1 - OD/K)", trials, errors="white")
    assert law.predict(trials).outcomes
    verdict = law.assess(trials)
    assert (verdict.usable, verdict.diverged) == (True, 0)
    assert not np.isinf(verdict.horizon)
