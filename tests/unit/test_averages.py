"""What a law says together with what else it could be."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm, t

import commonlaw as cl
from commonlaw.law import Law, PlausibleLaw, Uncertainty, average_law, from_json, pool_objects, select_objects, to_json
from commonlaw.law.law import with_other_laws
from commonlaw.law.quantiles import mixture_interval, two_sided
from commonlaw.law.tables import coefficient_rows, coefficients_by_object, interval_frame
from commonlaw.plots.law import DotPlot
from commonlaw.summary import parameter_table
from tests.refusals import refused

TIMES = np.linspace(0.0, 2.0, 9)
NOISE = 0.01


def law_of(decay, constant, variance=0.0001, objects=("cup", "mug")):
    """Return x' = constant + decay x, without the constant if that is zero."""
    law = Law.from_text("x' = -1.0 x + 1.0")
    terms = law.terms
    values = np.zeros((len(objects), 1, len(terms)))
    values[:, 0, terms.index("x")] = decay
    values[:, 0, terms.index("1")] = constant
    size = 1 + (constant != 0)
    covariance = np.tile(variance * np.eye(size), (len(objects), 1, 1))
    return Law(terms, law.schema, 1, objects, values, Uncertainty(covariance, noise=np.array([NOISE])))


@pytest.fixture
def law():
    """A law that could have a constant too, with a probability of 0.3."""
    return with_other_laws(law_of(-1.0, 0.0), (PlausibleLaw(0.3, law_of(-1.4, 0.5)),))


@pytest.fixture
def trials():
    states = [np.exp(-TIMES)[:, np.newaxis]] * 2
    return cl.Trials.from_arrays([TIMES] * 2, states, object=["cup", "mug"], names=["x"])


def test_ends_of_a_mixture_are_its_quantiles():
    weights, centers, scales = np.array([0.5, 0.2, 0.3]), np.array([0.0, 3.0, -1.0]), np.array([1.0, 0.1, 2.0])
    degrees = np.array([np.inf, 4.0, 9.0])

    def below(value):
        parts = norm.cdf(value), t.cdf((value - 3) / 0.1, 4), t.cdf((value + 1) / 2, 9)
        return float(weights @ np.array(parts))

    low, high = mixture_interval(weights, centers, scales, degrees, 0.9)
    assert low == pytest.approx(brentq(lambda value: below(value) - 0.05, -50, 50), rel=1e-9)
    assert high == pytest.approx(brentq(lambda value: below(value) - 0.95, -50, 50), rel=1e-9)


@pytest.mark.parametrize(("absent", "includes_zero"), [(0.01, False), (0.02, False), (0.03, True), (0.6, True)])
def test_an_interval_includes_zero_where_the_term_may_well_not_be_there(absent, includes_zero):
    weights = np.array([1 - absent, absent])
    low, high = mixture_interval(weights, np.array([2.0, 0.0]), np.array([0.1, 0.0]), np.inf, 0.95)
    assert (low <= 0) == includes_zero
    if not includes_zero:
        # What the certain value leaves of 2.5 % is the tail of the other
        assert low == pytest.approx(2 + 0.1 * norm.ppf((0.025 - absent) / (1 - absent)))
    assert high == pytest.approx(2 + 0.1 * norm.ppf(1 - 0.025 / (1 - absent)) if absent < 0.97 else 0)


def test_few_degrees_of_freedom_make_intervals_wider_by_students_quantile():
    plain = law_of(-1.0, 0.0)
    few = replace(plain, uncertainty=replace(plain.uncertainty, degrees_of_freedom=np.array([5.0])))
    row = few.conf_int(0.95).iloc[0]
    assert row["high"] - row["estimate"] == pytest.approx(t.ppf(0.975, 5) * row["standard error"])
    assert plain.conf_int()["high"][0] == pytest.approx(-1.0 + norm.ppf(0.975) * 0.01)
    assert two_sided(0.95, np.array([5.0, np.inf])).tolist() == pytest.approx([t.ppf(0.975, 5), norm.ppf(0.975)])


def test_averaged_intervals_have_columns_by_name_after_those_given_the_terms(law):
    row, saved, averaged = law.params.iloc[0], interval_frame(law).iloc[0], law.conf_int(averaged=True).iloc[0]
    names = [f"{end} averaged over plausible laws" for end in ("low", "high")]
    assert (saved["low"], saved["high"]) == (row["low"], row["high"])
    assert tuple(saved[names]) == (averaged["low"], averaged["high"])
    weights = np.array([0.7, 0.3])
    assert weights @ norm.cdf((averaged["low"] - np.array([-1.0, -1.4])) / 0.01) == pytest.approx(0.025)
    assert weights @ norm.cdf((averaged["high"] - np.array([-1.0, -1.4])) / 0.01) == pytest.approx(0.975)
    assert names[0] not in interval_frame(law_of(-1.0, 0.0))


@pytest.fixture
def doubtful():
    """A law that, with a probability of 0.3, lacks its constant; Student's t with 7 degrees of freedom."""

    def few(law):
        return replace(law, uncertainty=replace(law.uncertainty, degrees_of_freedom=np.array([7.0])))

    cup = ("cup",)
    without = few(law_of(-1.4, 0.0, objects=cup))
    return with_other_laws(few(law_of(-1.0, 0.5, objects=cup)), (PlausibleLaw(0.3, without),))


def _numbers(cell):
    """Return the numbers of ``1.2 ± 0.3`` and, on the next line, ``0.6 to 1.8``."""
    return [float(number) for number in re.findall(r"-?\d+\.\d+", str(cell))]


def test_every_table_has_the_interval_that_belongs_to_the_standard_error(doubtful):
    assert doubtful.conf_int(averaged=True)["low"].max() == 0.0
    document = {"coefficient": "estimate"}
    frames = [doubtful.params, doubtful.conf_int(), interval_frame(doubtful).rename(columns=document)]
    frames.append(coefficient_rows(doubtful).rename(columns={"value": "estimate"}))
    frames.append(parameter_table(doubtful).rename(columns=lambda name: name.removeprefix("95 % ")))
    rows = [row for frame in frames for row in frame[["estimate", "standard error", "low", "high"]].values.tolist()]
    cells = coefficients_by_object(doubtful).iloc[0, 1:]
    rows += [_numbers(cell) for cell in cells]
    printed = doubtful.summary().split("\n\n")[-1].splitlines()
    rows += [_numbers(line)[:4] for line in printed[1:3]]
    dots = DotPlot(doubtful).coefficients
    rows += [[dot.learned[0], dot.errors[0], dot.low[0], dot.high[0]] for dot in dots]
    assert len(rows) == 2 * 8
    for estimate, error, low, high in rows:
        assert low < estimate < high
        assert (high - low) / 2 == pytest.approx(t.ppf(0.975, 7) * error, rel=0.05)


def test_draws_come_from_every_law_by_its_probability(law):
    draws = law.sample(4000)["a"].xs("cup", level="object")
    assert np.mean(draws < -1.2) == pytest.approx(0.3, abs=0.03)
    assert draws[draws < -1.2].mean() == pytest.approx(-1.4, abs=0.002)
    assert law.sample(500, averaged=False)["a"].max() < -0.9
    assert law.sample(500, averaged=False)["a"].min() > -1.1


def test_forecasts_are_the_median_of_the_laws_and_the_quantiles_of_the_mixture(law, trials):
    own, other = (model.law.predict(trials, return_std=True, averaged=False) for model in law.models)
    found = law.predict(trials, return_std=True)
    first, second = (each.trajectories[1].states for each in (own, other))
    np.testing.assert_array_equal(found.trajectories[1].states, first)
    draws = np.random.default_rng(0).standard_normal((200_000, len(TIMES)))
    chosen = np.random.default_rng(1).uniform(size=(len(draws), 1)) < 0.3
    stds = [np.hypot(each.std[1][:, 0], NOISE) for each in (own, other)]
    sample = np.where(chosen, second[:, 0] + stds[1] * draws, first[:, 0] + stds[0] * draws)
    low, high = found.bands(0.9, measured=True)[1]
    np.testing.assert_allclose(low[:, 0], np.quantile(sample, 0.05, axis=0), atol=2e-3)
    np.testing.assert_allclose(high[:, 0], np.quantile(sample, 0.95, axis=0), atol=2e-3)
    off = np.sqrt(np.mean((sample - first[:, 0]) ** 2, axis=0))
    np.testing.assert_allclose(np.hypot(found.std[1][:, 0], NOISE), off, rtol=0.02)


def test_where_no_law_is_more_probable_than_all_others_the_middle_one_forecasts(trials):
    others = (PlausibleLaw(0.35, law_of(-1.4, 0.0)), PlausibleLaw(0.25, law_of(-1.2, 0.0)))
    found = with_other_laws(law_of(-1.0, 0.0), others).predict(trials)
    middle = law_of(-1.2, 0.0).predict(trials)
    np.testing.assert_allclose(found.trajectories[0].states, middle.trajectories[0].states)


def test_forecasts_can_be_those_of_the_law_alone(law, trials):
    alone = with_other_laws(law, ()).predict(trials, return_std=True)
    found = law.predict(trials, return_std=True, averaged=False)
    for one, other in zip(found.bands(measured=True), alone.bands(measured=True), strict=True):
        np.testing.assert_array_equal(one, other)


def test_curves_of_an_average_go_through_its_forecasts(law, trials):
    found = law.predict(trials, return_std=True)
    smooth = found.smooth(40)
    at = np.searchsorted(smooth.trials[0].times, TIMES)
    np.testing.assert_allclose(smooth.trajectories[0].states[at], found.trajectories[0].states, rtol=1e-6)
    np.testing.assert_allclose(smooth.bands()[0][0][at], found.bands()[0][0], rtol=1e-6)


def test_what_diverges_where_the_law_does_not_is_left_out_of_its_forecasts(trials):
    wild = law_of(40.0, 0.0)
    long = trials.with_trials([replace(trial, times=100 * trial.times) for trial in trials])
    law = with_other_laws(law_of(-1.0, 0.0), (PlausibleLaw(0.2, wild),))
    found, own = law.predict(long, return_std=True), law.predict(long, return_std=True, averaged=False)
    np.testing.assert_array_equal(found.trajectories[0].states, own.trajectories[0].states)
    np.testing.assert_allclose(found.bands()[0], own.bands()[0])


def test_where_the_law_diverges_what_else_it_could_be_forecasts_and_a_note_says_so(trials):
    long = trials.with_trials([replace(trial, times=100 * trial.times) for trial in trials])
    tame = law_of(-1.0, 0.0)
    found = with_other_laws(law_of(40.0, 0.0), (PlausibleLaw(0.2, tame),)).predict(long, return_std=True)
    own = tame.predict(long, return_std=True)
    np.testing.assert_array_equal(found.trajectories[0].states, own.trajectories[0].states)
    np.testing.assert_allclose(found.bands()[1], own.bands()[1])
    assert found.outcomes == ()
    assert "the law diverges in cup, trial 1, mug, trial 1" in found.trials.notes[-1]
    assert "of total posterior probability 0.2" in found.trials.notes[-1]
    alone = with_other_laws(law_of(40.0, 0.0), (PlausibleLaw(0.2, law_of(50.0, 0.0)),)).predict(long)
    assert len(alone.outcomes) == 2


def test_what_else_it_could_be_goes_with_a_law_through_every_change(law):
    for changed in (select_objects(law, ["mug"]), average_law(law), pool_objects(law), from_json(to_json(law))):
        (other,) = changed.uncertainty.other_laws
        assert other.probability == 0.3
        assert other.law.objects == changed.objects
        np.testing.assert_allclose(other.law.coefficients[0], law.uncertainty.other_laws[0].law.coefficients[0])
    assert to_json(from_json(to_json(law))) == to_json(law)


def test_laws_of_other_objects_or_without_a_probability_are_refused(law):
    other = law.uncertainty.other_laws[0].law
    with refused("averaged-law-differs"):
        with_other_laws(law, (PlausibleLaw(0.3, select_objects(other, ["mug"])),))
    with refused("averaged-law-probability", probability=0.0):
        with_other_laws(law, (PlausibleLaw(0.0, other),))
    with refused("averaged-laws-probability"):
        with_other_laws(law, (PlausibleLaw(0.6, other), PlausibleLaw(0.4, other)))


def test_forecasts_say_what_else_the_law_could_be_where_that_matters(law, trials):
    (note,) = law.predict(trials, return_std=True).trials.notes
    assert "x' = a x + b is also plausible (posterior probability 0.3)" in note
    alike = with_other_laws(law, (PlausibleLaw(0.3, law_of(-1.0, 1e-6)),))
    assert alike.predict(trials, return_std=True).trials.notes == ()
    assert law.predict(trials, return_std=True, averaged=False).trials.notes == ()
