"""The part of the study on the default method, beside numbers recomputed with NumPy and SciPy alone."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import odeint, solve_ivp
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

import commonlaw as cl
from commonlaw.law.law import object_index
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.model_error import model_error
from studies.falling_balls.settings import BALL_GROUPS, DRAG_FORMS

# With all that takes numbers from the study, so that it runs once
pytestmark = pytest.mark.xdist_group("study")


@pytest.fixture(scope="module")
def report(finished_study) -> Path:
    return finished_study[0] / "report"


@pytest.fixture(scope="module")
def results(report):
    return json.loads((report / "results.json").read_text())["default_method"]


@pytest.fixture(scope="module")
def law(drops) -> cl.Law:
    """What the default method learns from drop 1."""
    return cl.discover(drops.select(trial="1"), order=2, library="terms:1,v,v^2")


@pytest.fixture(scope="module")
def whiffle(drops) -> cl.Law:
    """What it learns from both drops of the whiffle balls."""
    return cl.discover(drops.select(object=BALL_GROUPS["whiffle balls"]), order=2, library="terms:1,v,v^2")


def first_speed(trial):
    """The paper's rule: smoothed heights, and a difference of four points at the end."""
    x, t = savgol_filter(trial.states[:, 0], 35, 3), trial.times
    return np.array([-11 / 6, 3, -3 / 2, 1 / 3]) @ x[:4] / (t[1] - t[0])


def heights(law, trial, speed):
    """Integrate ``x'' = a + b v + c v^2`` from the trial's first height."""
    a, b, c = law.coefficients[object_index(law, trial.object)][0]
    start, span = [trial.states[0, 0], speed], trial.times[[0, 41]]

    def rates(_, y):
        return [y[1], a + b * y[1] + c * y[1] ** 2]

    return solve_ivp(rates, span, start, t_eval=trial.times[:42], rtol=1e-10, atol=1e-10).y[0]


def test_every_ball_is_in_the_group_of_all_and_in_one_of_the_pairs_or_among_the_whiffle_balls(drops):
    everybody, whiffle, closed, *pairs = BALL_GROUPS.values()
    assert sorted(everybody) == sorted(drops.objects) == sorted([*whiffle, *closed])
    assert sorted(closed) == sorted(sum(pairs, ()))


def test_forecasts_are_those_of_the_law_from_the_first_height_and_the_rate_by_the_papers_rule(drops, law, results):
    errors = results["forecasts"]["errors"]["paper_rule"]["default"]
    assert [len(by_ball) for by_ball in errors.values()] == [10, 10]
    for ball in ("Baseball", "Whiffle Ball 2"):
        (trial,) = drops.select(object=ball, trial="2")
        # The median of all laws that are plausible
        ends = sorted((heights(model.law, trial, first_speed(trial))[-1], model.probability) for model in law.models)
        reached = np.cumsum([share for _, share in ends])
        end = ends[int(np.searchsorted(reached, reached[-1] / 2))][0]
        assert errors["1"][ball] == pytest.approx(abs(end - trial.states[41, 0]), abs=1e-5)


def test_the_fitted_rate_is_that_of_least_squares_on_the_first_second(drops, law, results):
    """Heights under linear drag are a linear function of the initial rate."""
    errors = results["forecasts"]["errors"]["fitted_to_first_second"]["default"]["1"]
    (trial,) = drops.select(object="Golf Ball", trial="2")
    resting, moving = heights(law, trial, 0.0), heights(law, trial, 1.0)
    effect, missing = moving - resting, trial.states[:42, 0] - resting
    rate = np.linalg.lstsq(effect[:15, np.newaxis], missing[:15])[0][0]
    assert errors["Golf Ball"] == pytest.approx(abs(missing[-1] - rate * effect[-1]), abs=1e-5)


def test_the_papers_models_have_the_errors_of_the_part_on_prediction(drops, results):
    part = model_error(Inquiry(drops, "", 100)).results
    found = results["forecasts"]["errors"]["paper_rule"]
    assert {model: found[model] for model in "1234"} == part["prediction_error"]
    fitted = results["forecasts"]["medians"]["fitted_to_first_second"]["2"]["both"]
    assert fitted == pytest.approx(part["prediction_error_fitted_rate_median"], abs=1e-5)


def test_the_median_errors_to_a_centimetre(results):
    medians = results["forecasts"]["medians"]
    assert {name: round(each["both"], 2) for name, each in medians["paper_rule"].items()} == {
        "1": 3.30, "2": 1.24, "3": 1.25, "4": 1.72, "default": 1.37, "default, cubic": 1.37,
    }  # fmt: skip
    assert {name: round(each["both"], 2) for name, each in medians["fitted_to_first_second"].items()} == {
        "2": 0.72, "default": 0.85,
    }  # fmt: skip
    assert abs(results["forecasts"]["gain_on_best_model"]) < results["forecasts"]["deviation_of_gain"]


def test_what_is_chosen_is_what_discover_chooses_and_its_list_says(whiffle, results):
    found = results["choices"]["whiffle balls"]
    listed = whiffle.comparison.set_index("terms")
    (chosen,) = listed.index[listed["chosen"]]
    assert DRAG_FORMS[found["chosen"]] == tuple(chosen.split(", "))
    for form, terms in DRAG_FORMS.items():
        row = listed.loc[", ".join(terms)]
        assert found["laws"][form]["two_log_bayes_factor"] == pytest.approx(row["score"], abs=1e-6)
        assert found["laws"][form]["probability"] == pytest.approx(row["weight"], rel=1e-6)


def test_white_noise_explains_the_heights_of_no_group(results):
    assert all(found["errors"] != "none" for found in results["choices"].values())


def test_choice_and_evidence_of_each_group(results):
    found = {
        group: (each["chosen"], min(each["laws"], key=lambda form: each["laws"][form]["two_log_bayes_factor"]))
        for group, each in results["choices"].items()
    }
    assert found == {
        "ten balls together": ("linear drag", "linear drag"),
        "whiffle balls": ("linear drag", "linear drag"),
        "closed balls": ("linear drag", "linear drag"),
        "basketballs": ("quadratic drag", "quadratic drag"),
        "golf ball and baseball": ("constant acceleration", "constant acceleration"),
        "tennis ball and volleyball": ("linear drag", "linear drag"),
    }


def whitened(trial, law):
    """Return the inverse factor of the covariance of heights that a law's noise and smooth force move.

    The force is integrated twice, by the trapezoidal rule; what drag does to a push is left out.
    """
    t, errors = trial.times, law.uncertainty.error_model
    fine = np.linspace(t[0], t[-1], 8 * len(t))
    apart = np.sqrt(3) * np.abs(fine - fine[:, np.newaxis]) / errors.force_time
    pushed = np.maximum(t[:, np.newaxis] - fine, 0) * np.gradient(fine)
    moved = errors.force**2 * pushed @ ((1 + apart) * np.exp(-apart)) @ pushed.T
    return np.linalg.inv(np.linalg.cholesky(law.uncertainty.noise**2 * np.eye(len(t)) + moved))


def misfit(trials, law, power):
    """Return the least sum of squares of ``x'' = a + b v^power`` over a ball's drops, with free starts."""
    factors = [whitened(trial, law) for trial in trials]

    def gaps(p):
        parts = []
        for trial, factor, start in zip(trials, factors, p[2:].reshape(-1, 2), strict=True):
            flow = odeint(lambda y, _: [y[1], p[0] + p[1] * y[1] ** power], start, trial.times)
            parts.append(factor @ (flow[:, 0] - trial.states[:, 0]))
        return np.concatenate(parts)

    starts = [(trial.states[0, 0], 0.0) for trial in trials]
    return 2 * least_squares(gaps, [-9, 0, *np.ravel(starts)], x_scale="jac", diff_step=1e-4).cost


def test_linear_drag_suits_the_whiffle_balls_better_than_quadratic_as_a_likelihood_written_out_says(
    drops, whiffle, results
):
    """Both have as many terms, so that misfits decide; how alike the balls are and outliers enter the evidence too."""
    balls = [drops.of_object(ball) for ball in BALL_GROUPS["whiffle balls"]]
    gain = sum(misfit(trials, whiffle, 2) - misfit(trials, whiffle, 1) for trials in balls)
    lost = {form: each["two_log_bayes_factor"] for form, each in results["choices"]["whiffle balls"]["laws"].items()}
    assert gain > 5
    assert 0.5 < (lost["quadratic drag"] - lost["linear drag"]) / gain < 2


def test_the_verdicts_and_tables_say_the_numbers(report, results):
    page = (report / "report.html").read_text()
    assert "linear drag for the ten balls together, the whiffle balls, the closed balls" in page
    assert "for 6 of 6 groups" in page
    assert "1.365 m, against 1.243 m" in page
    assert "a tie" in page
    choices = pd.read_csv(report / "tables" / "default-choices.csv")
    assert choices["linear"].tolist() == pytest.approx(
        [each["laws"]["linear drag"]["two_log_bayes_factor"] for each in results["choices"].values()]
    )
    assert len(pd.read_csv(report / "tables" / "default-evidence.csv")) == 23
