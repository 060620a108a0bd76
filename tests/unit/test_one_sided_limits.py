"""Parameters that have a limit on one side only: against profiles in closed form, and wherever they are printed."""

import json
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import openpyxl
import pytest
from scipy.optimize import brentq

import commonlaw as cl
from commonlaw.app.result import _editable, _table
from commonlaw.estimation.one_sided import one_sided
from commonlaw.estimation.search import Bounds
from commonlaw.experiments.design import suggestions
from commonlaw.law import average_law, from_json, select_objects, to_json, to_latex
from commonlaw.law.pooling import by_properties, contrasts
from commonlaw.law.tables import coefficient_rows, interval_frame, quantities_by_object, spread_tables, to_frame
from commonlaw.law.uncertainty import OneSidedLimit
from commonlaw.plots import plot_relations
from commonlaw.plots.law import DotPlot
from commonlaw.summary import parameter_table
from tests.refusals import refused
from tests.unit.decays import estimates

pytestmark = pytest.mark.usefixtures("few_starts")

NOISE, STEP = 0.05, 2.0
TIMES = STEP * np.arange(12)
RANDOM = np.random.default_rng(4)


def _cooling(rate, times=TIMES):
    return 20 + 60 * np.exp(-rate * times) + NOISE * RANDOM.standard_normal(len(times))


FAST = _cooling(5.0)


def _trials(temperatures=FAST, times=TIMES):
    return cl.Trials.from_arrays(times, temperatures, names=["T"])


def _limit(temperatures, quantile=2.7055):
    """Return where the profile of k is, above its least value, by the squared quantile of one side of 95 %."""

    def least(rate):
        columns = np.stack([1 - np.exp(-rate * TIMES), np.exp(-rate * TIMES)], axis=1)
        return np.linalg.lstsq(columns, temperatures, rcond=None)[1][0] / NOISE**2

    best = min(map(least, np.geomspace(0.5, 50, 500)))
    return brentq(lambda rate: least(rate) - best - quantile, 0.5, 6.0)


@pytest.fixture(scope="module")
def law():
    return cl.fit("T' = -k (T - c); T(0) = a", _trials(), noise={"T": NOISE})


def test_the_limit_is_where_the_profile_in_closed_form_has_it(law):
    (limit,) = law.uncertainty.limits
    assert (limit.parameter, limit.is_lower) == ("k", True)
    assert limit.value == pytest.approx(_limit(FAST), rel=0.03)
    assert [diagnostic.code for diagnostic in law.diagnostics] == ["one-sided-limit"]
    # Others are those of the samples after the first one, in which nothing is left of the beginning
    assert estimates(law)["c"] == pytest.approx((FAST[1:].mean(), NOISE / np.sqrt(len(FAST) - 1)), rel=1e-4)
    assert estimates(law)["a"] == pytest.approx((FAST[0], NOISE), rel=1e-4)


def test_the_limit_of_a_shared_parameter_is_searched_once(monkeypatch):
    search = Mock(wraps=one_sided)
    monkeypatch.setattr("commonlaw.estimation.profile.one_sided", search)
    heights = 20 * np.exp(-0.02 * TIMES) + np.random.default_rng(1).standard_normal((3, len(TIMES)))
    trials = cl.Trials.from_arrays([TIMES] * 3, [*heights], object=["a", "b", "c"], names=["x"])
    law = cl.fit("x' = -k x", trials, shared="k", noise={"x": 20.0})
    assert law.params["standard error"].iloc[0] > law.params["estimate"].iloc[0]
    assert search.call_count == 1


@pytest.mark.parametrize("rate", [1.2, 2.0, 30.0])
def test_plain_fits_have_limits_only_of_what_has_no_other_one(rate):
    temperatures = _cooling(rate)
    law = cl.fit("T' = -k (T - c)", _trials(temperatures), noise={"T": NOISE})
    remains = 60 * np.exp(-rate * STEP) / NOISE
    assert [limit.parameter for limit in law.uncertainty.limits] == ([] if remains > 10 else ["k"])
    for limit in law.uncertainty.limits:
        assert limit.value == pytest.approx(_limit(temperatures), rel=0.05)
        assert limit.value < rate


def test_a_limit_stands_in_place_of_estimate_error_and_interval(law):
    (limit,) = law.uncertainty.limits
    text = f"> {limit.value:.3g} (95 %)"
    assert f"k {text}" in str(law)
    assert "±" not in law.equations()[0].partition("(T")[0]
    assert law.equations()[0].startswith("T' = -k (T - (")
    assert f"k &{limit.latex}" in to_latex(law)
    assert text in law.summary()
    cells = parameter_table(law).set_index("parameter").loc["k"]
    assert np.isnan(cells["standard error"])
    assert (cells["95 % low"], cells["95 % high"]) == (limit.value, np.inf)
    assert text in str(_table(parameter_table(law))["rows"])
    assert text in quantities_by_object(law).iloc[0, 1]
    dots = {dot.name: dot for dot in DotPlot(law).coefficients}
    assert (np.isnan(dots["k"].learned[0]), dots["k"].limits[0]) == (True, limit.value)
    assert np.isnan(dots["c"].limits[0])
    assert np.isnan(to_frame(law, errors=True).iloc[0, 1])
    assert text in spread_tables(law, 1)[1].iloc[0].tolist()
    # An estimate to begin with elsewhere is no measurement
    assert np.isfinite(_editable(law)["errors"]["k"])


def test_tables_for_programs_have_the_limit_and_no_estimate(law):
    (limit,) = law.uncertainty.limits
    for frame, estimate in ((coefficient_rows(law), "value"), (interval_frame(law), "coefficient")):
        row = frame.set_index("parameter").loc["k"]
        assert np.isnan([row[estimate], row["standard error"]]).all()
        assert (row["low"], row["high"]) == (limit.value, np.inf)
    at_levels = [law.conf_int(level).set_index("parameter").loc["k", "low"] for level in (0.8, 0.95, 0.99)]
    assert at_levels[:2] == [limit.value] * 2
    assert np.isnan(at_levels[2])


def test_quantities_of_a_limited_parameter_have_one_end(law):
    (limit,) = law.uncertainty.limits
    rows = law.quantities().set_index("symbol")
    assert rows.loc["τ", "high"] == pytest.approx(1 / limit.value)
    assert rows.loc["k", "low"] == pytest.approx(limit.value)
    assert np.isinf(rows.loc["τ", "low"])
    assert rows.loc["T*", "standard error"] == pytest.approx(NOISE / np.sqrt(len(FAST) - 1), rel=1e-3)


def test_errors_and_intervals_of_others_are_given_the_limited_parameters():
    law = cl.Law.from_text("x' = -k (x - a)", {"k": {"mug": 10.0}, "a": {"mug": 2.0}})
    gradients = {"x": [-1.0, 0.0], "1": [2.0, 10.0]}  # Of the coefficients -k and k a by k and a
    slopes = np.array([gradients[law.terms.names[column]] for column in np.argwhere(law.support)[:, 1]])
    covariance = slopes @ np.array([[81.0, 0.05], [0.05, 0.0004]]) @ slopes.T
    limits = (OneSidedLimit("mug", "k", 6.0, is_lower=True),)
    law = replace(law, uncertainty=cl.law.Uncertainty(covariance[np.newaxis], limits=limits))
    error = np.sqrt(0.0004 - 0.05**2 / 81)
    row = interval_frame(law).set_index("parameter").loc["a"]
    assert row["standard error"] == pytest.approx(error, rel=1e-6)
    assert (row["low"], row["high"]) == pytest.approx((2 - 1.96 * error, 2 + 1.96 * error), rel=1e-4)
    rest = law.quantities().set_index("symbol").loc["x*"]
    assert rest["quantity"] == "equilibrium, stable"
    assert (rest["standard error"], rest["low"]) == pytest.approx((error, 2 - 1.96 * error), rel=1e-4)


def test_workbooks_have_the_limit_next_to_the_number(law, tmp_path):
    law.save(tmp_path / "law.xlsx")
    sheet = openpyxl.load_workbook(tmp_path / "law.xlsx")["Parameters"]
    cells = {str(cell.value) for cell in sheet[5]}
    assert f"k {law.uncertainty.limits[0].text}" in cells


def test_limits_are_saved_and_laws_without_them_still_read(law):
    assert from_json(to_json(law)) == law
    assert from_json(to_json(law)).uncertainty.limits == law.uncertainty.limits
    document = json.loads(to_json(law))
    del document["uncertainty"]["limits"]
    assert from_json(json.dumps(document)).uncertainty.limits == ()


def test_limits_go_with_their_objects():
    law = cl.Law.from_text("x' = -k x", {"k": {"cup": 0.5, "mug": 9.0}})
    limits = (OneSidedLimit("mug", "k", 3.0, is_lower=True),)
    covariance = np.array([[[0.01]], [[400.0]]])
    law = cl.law.Law(
        law.terms,
        law.schema,
        law.order,
        law.objects,
        law.coefficients,
        cl.law.Uncertainty(covariance, limits=limits),
        provenance=law.provenance,
    )
    assert select_objects(law, ["mug"]).uncertainty.limits == limits
    assert select_objects(law, ["cup"]).uncertainty.limits == ()
    (mean,) = average_law(law).uncertainty.limits
    assert mean.value == pytest.approx((0.5 - 1.96 * 0.1 + 3.0) / 2, rel=1e-3)
    lines = str(law).splitlines()
    assert [line for line in lines if line.startswith("mug")] == ["mug   > 3 (95 %)"]


@pytest.fixture
def rates():
    """The law x' = -k x, k = 1/mass, of four objects and one whose k = 40 +- 39 has only a limit; its masses."""
    objects, masses = ("a", "b", "c", "d", "fast"), np.array([1.0, 2.0, 4.0, 8.0, 3.0])
    law = cl.Law.from_text("x' = -k x", {"k": dict(zip(objects, [*(1 / masses[:4]), 40.0], strict=True))})
    covariance = np.array([*(0.001 / masses[:4]), 39.0]).reshape(-1, 1, 1) ** 2
    limits = (OneSidedLimit("fast", "k", 9.0, is_lower=True),)
    uncertainty = cl.law.Uncertainty(covariance, noise=[0.01], limits=limits)
    properties = {name: {"mass": mass} for name, mass in zip(objects, masses.tolist(), strict=True)}
    return replace(law, uncertainty=uncertainty, properties=properties)


def test_objects_with_only_a_limit_are_in_no_contrast(rates):
    groups = {name: {"kind": "old" if name in "ab" else "new"} for name in rates.objects}
    law = replace(rates, properties=groups)
    with refused("contrast-with-limits", parameter="k", objects=["fast"]):
        contrasts(law, "kind")
    frame = contrasts(select_objects(law, ["a", "b", "c", "d"]), "kind", "new")
    assert frame["difference"].tolist() == pytest.approx([0.75 - 0.1875], rel=1e-3)


def test_experiments_are_designed_for_objects_without_limits(rates):
    vary = {"x": 1.0, "duration": 2.0, "rate": 5}
    with refused("design-with-limits", names=["k"], objects=["fast"]):
        cl.design(rates, vary | {"object": "each"}, about="k of a")
    assert cl.design(rates, vary | {"object": ["a", "b"]}, about="k of a").experiments
    trials = cl.Trials.from_arrays([0.0, 1.0, 2.0], [1.0, 0.4, 0.1], object="a", names=["x"])
    assert suggestions(rates, trials) == {}
    assert suggestions(select_objects(rates, ["a"]), trials)


def test_objects_with_only_a_limit_are_no_evidence_of_relations_and_keep_their_parameters(rates):
    law = rates.explain()
    (relation,) = law.uncertainty.explanation.relations
    assert (str(relation.kind), relation.properties, float(relation.exponents[0])) == ("power law", ("mass",), -1)
    assert relation.factors == pytest.approx((-1.0,), rel=0.01)
    assert law.coefficients[4] == rates.coefficients[4]
    assert law.coefficients[:4].ravel() == pytest.approx([-1.0, -0.5, -0.25, -0.125], rel=0.01)
    assert "not-explained" in {outcome.code for outcome in law.diagnostics}
    assert "fast: x' = -k x, k > 9 (95 %)" in str(law).splitlines()
    assert len(plot_relations(law).axes[0].containers) == 4
    assert any("(without fast)" in line for line in by_properties(rates))
    known = select_objects(rates, ["a", "fast"])
    with refused("explain-with-limits", objects=["fast"], names=["k"]):
        known.explain()


def test_objects_with_only_a_limit_are_not_pooled(rates):
    pooled = cl.law.pool_objects(rates)
    assert pooled.coefficients[4] == rates.coefficients[4]
    assert (pooled.coefficients[:4] != rates.coefficients[:4]).all()
    assert "not-pooled" in {outcome.code for outcome in pooled.diagnostics}


@pytest.mark.parametrize("equation", ["T' = -k (T - c)", "T' = -k (T - c); T(0) = a"])
def test_bands_reach_forecasts_at_the_limit_and_far_beyond_it(equation):
    law = cl.fit(equation, _trials(), noise={"T": NOISE})
    (limit,) = law.uncertainty.limits
    forecast = law.predict(_trials(), times=[0.5], return_std=True)
    row = forecast.to_frame().query("t == 0.5").iloc[0]
    c, start = estimates(law)["c"][0], forecast.to_frame()["T forecast"].iloc[0]
    at_limit = c + (start - c) * np.exp(-0.5 * limit.value)
    farthest = max(at_limit - row["T forecast"], row["T forecast"] - c)
    assert row["T high"] - row["T forecast"] == pytest.approx(farthest, rel=0.15)
    later = forecast.to_frame().query("t > 3")
    assert (later["T high"] - later["T forecast"]).to_numpy() == pytest.approx(2.2 * NOISE / np.sqrt(11), rel=0.15)


def test_draws_and_covariances_are_given_the_limited_parameters(law):
    draws, covariance = law.sample(2000), law.cov_params()
    estimate = law.params.set_index("parameter").loc["k", "estimate"]
    assert draws["k"].to_numpy() == pytest.approx(estimate)
    assert draws["c"].std() == pytest.approx(estimates(law)["c"][1], rel=0.05)
    assert (covariance.loc["k"] == 0).all()
    assert covariance.loc["c", "c"] == pytest.approx(estimates(law)["c"][1] ** 2)


def test_simpler_forms_do_not_replace_what_has_only_a_limit():
    law = cl.Law.from_text("x' = -k x + b", {"k": {"mug": 12.0}, "b": {"mug": 2.01}})
    limits = (OneSidedLimit("mug", "k", 5.0, is_lower=True),)
    variances = {"x": 49.0, "1": 1e-4}
    covariance = np.diag([variances[law.terms.names[k]] for k in np.argwhere(law.support)[:, 1]])
    law = replace(law, uncertainty=cl.law.Uncertainty(covariance[np.newaxis], limits=limits))
    simple = law.simplify()
    assert [replacement.parameter for replacement in simple.replaced] == ["b"]
    assert str(simple).splitlines()[-1].split("  ")[-1].strip() == "> 5 (95 %)"


def test_new_data_determine_what_had_only_a_limit(law):
    times = np.linspace(0.0, 1.0, 15)
    updated = law.update(_trials(_cooling(5.0, times), times).select(object="object"))
    assert updated.uncertainty.limits == ()
    assert estimates(updated)["k"][0] == pytest.approx(5.0, abs=4 * estimates(updated)["k"][1])
    assert 0 < estimates(updated)["k"][1] < 0.1


def test_laws_of_a_search_have_limits_too():
    law = cl.discover(_trials(), order=1, library="poly:1", method=cl.TrajectoryLikelihood(noise={"T": NOISE}))
    assert law.uncertainty.limits
    for limit in law.uncertainty.limits:
        assert f"{limit.parameter} {limit.text}" in str(law)
        assert f"{limit.parameter} &" in to_latex(law)
    times = np.linspace(0.0, 1.0, 15)
    updated = law.update(_trials(_cooling(5.0, times), times).select(object="object"))
    assert updated.uncertainty.limits == ()
    assert "one-sided-limit" not in [outcome.code for outcome in updated.diagnostics]
    assert 0 < estimates(updated)["b"][1] < 0.1
    assert cl.law.from_json(cl.law.to_json(updated)) == updated


@pytest.mark.parametrize("equation", ["T' = (c - T)/tau", "T' = -(T - c)/tau"])
def test_a_time_constant_of_a_fast_decay_has_an_upper_limit(equation):
    law = cl.fit(equation, _trials(), noise={"T": NOISE})
    (limit,) = law.uncertainty.limits
    assert (limit.parameter, limit.is_lower) == ("tau", False)
    assert limit.value == pytest.approx(1 / _limit(FAST), rel=0.05)
    assert f"tau < {limit.value:.3g} (95 %)" in str(law)


def test_a_limit_is_within_the_bounds_of_its_parameter():
    law = cl.fit("T' = -(T - c)/tau; 0 < tau < 0.1", _trials(), noise={"T": NOISE})
    (limit,) = law.uncertainty.limits
    assert (limit.value, limit.is_lower) == (0.1, False)
    row = law.params.set_index("parameter").loc["tau"]
    assert (row["low"], row["high"]) == (0.0, 0.1)


@pytest.mark.parametrize("size", [1e-300, 1e292])
def test_numbers_whose_multiples_overflow_have_no_limit(size):
    problem = Mock(max_steps=1)
    problem.apart.return_value = [(np.arange(1), problem)]
    everywhere = Bounds(np.array([-np.inf]), np.array([np.inf]))
    assert one_sided(problem, np.array([size]), np.ones(1), everywhere, 0, np.inf, 5.0) is None


def test_small_coefficients_of_either_sign_have_both_limits():
    law = cl.fit("T' = -k (T - 20)", _trials(_cooling(1e-5)), noise={"T": NOISE})
    assert law.uncertainty.limits == ()


@pytest.mark.slow
def test_a_lag_too_short_to_be_solved_has_an_upper_limit():
    times = 0.5 * np.arange(20)
    step, random = np.where(times >= 5.0, 2.0, 0.0), np.random.default_rng(0)
    outputs = np.where(times >= 5.5, 6.0, 0.0) + 0.05 * random.standard_normal(len(times))
    # The first sample after the step at its steady state: the largest likelihood is that of no lag
    outputs[11] = 6.06
    trials = cl.Trials.from_arrays(times, outputs, inputs=step, names=["w", "u"])
    law = cl.fit("w' = (G u - w)/tau", trials, noise={"w": 0.05})
    (limit,) = law.uncertainty.limits
    rest = outputs[11:].mean()
    share = (np.sqrt((6.06 - rest) ** 2 + 2.7055 * 0.05**2) - (6.06 - rest)) / rest
    assert (limit.parameter, limit.is_lower) == ("tau", False)
    assert limit.value == pytest.approx(-0.5 / np.log(share), rel=0.1)
