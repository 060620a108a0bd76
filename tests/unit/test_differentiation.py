"""Differentiators against closed forms, NumPy and SciPy; what they refuse, their texts, and long trials in pieces."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_smoothing_spline
from scipy.ndimage import median_filter
from scipy.optimize import lsq_linear
from scipy.signal import savgol_filter, wiener

from commonlaw.diagnostics import Diagnostic
from commonlaw.differentiation import (
    METHODS,
    CenteredDifference,
    FiniteDifference,
    ForwardDifference,
    MedianFilter,
    SavitzkyGolay,
    SmoothedDifference,
    SmoothingSpline,
    SpectralDerivative,
    TotalVariationDerivative,
    WienerFilter,
    default_differentiation,
    format_differentiation,
    parse_differentiation,
    penalized,
)
from commonlaw.formulation import LeastSquaresProblem, StrongForm, law_variables, merge
from commonlaw.library import PolynomialLibrary
from commonlaw.trials import Schema, Trial
from tests.refusals import refused


def _rates(method, times, state, order=1):
    """Return states and derivatives of one state, each of shape (n,)."""
    rates = method.differentiate(times, np.asarray(state)[:, np.newaxis], order)
    return rates.states[:, 0], *(derivative[:, 0] for derivative in rates.derivatives)


def _drop(noise=0.0, count=49):
    """Return times, heights, velocities and accelerations of a fall with linear drag: h(0) = 40, a = -9.8 - 0.5 v."""
    times = np.arange(count) / 15
    velocity = -19.6 * (1 - np.exp(-0.5 * times))
    height = 40 - 19.6 * times + 39.2 * (1 - np.exp(-0.5 * times))
    return times, height + noise * np.random.default_rng(0).standard_normal(count), velocity, -9.8 - 0.5 * velocity


def _uneven(count=30, seed=1):
    return np.cumsum(np.random.default_rng(seed).uniform(0.05, 0.2, count))


def _error(found, true):
    return np.linalg.norm(found - true) / np.linalg.norm(true)


def test_centered_difference_takes_each_end_by_its_own_step():
    times, x = np.array([0.0, 0.1, 0.3, 0.4, 0.6, 1.0]), np.array([1.0, 3.0, -2.0, 5.0, 8.0, 4.0])
    _, rate = _rates(CenteredDifference(), times, x)
    assert rate[0] == pytest.approx((-11 / 6 * 1 + 3 * 3 - 3 / 2 * -2 + 1 / 3 * 5) / 0.1)
    assert rate[-1] == pytest.approx((11 / 6 * 4 - 3 * 8 + 3 / 2 * 5 - 1 / 3 * -2) / 0.4)


def test_forward_difference_looks_ahead_and_at_the_last_sample_back():
    times, x = np.array([0.0, 1.0, 3.0, 4.0, 5.0]), np.array([2.0, 4.0, 0.0, 1.0, 7.0])
    _, rate, second = _rates(ForwardDifference(), times, x, 2)
    np.testing.assert_allclose(rate, [2, -2, 1, 6, 1.5 * 7 - 2 * 1 + 0.5 * 0])
    np.testing.assert_allclose(second, [-4, 1.5, 5, 2.5, 1.5 * 8.5 - 2 * 6 + 0.5 * 1])


def test_finite_difference_of_accuracy_two_is_numpys_gradient_on_any_grid():
    times = _uneven()
    _, rate = _rates(FiniteDifference(), times, np.exp(times))
    np.testing.assert_allclose(rate, np.gradient(np.exp(times), times, edge_order=2), rtol=1e-12)


@pytest.mark.parametrize("accuracy", [2, 4, 6])
def test_finite_difference_differentiates_polynomials_exactly_on_any_grid(accuracy):
    times = _uneven(14)
    polynomial = np.polynomial.Polynomial(np.random.default_rng(0).standard_normal(accuracy + 1))
    _, *derivatives = _rates(FiniteDifference(accuracy), times, polynomial(times), 4)
    for k, derivative in enumerate(derivatives[:2], start=1):
        np.testing.assert_allclose(derivative, polynomial.deriv(k)(times), rtol=1e-7, atol=1e-7)
    third = derivatives[2][2:-2]
    np.testing.assert_allclose(third, polynomial.deriv(3)(times)[2:-2], rtol=1e-5, atol=1e-5)


def test_savitzky_golay_is_scipys_along_time():
    states = np.random.default_rng(0).standard_normal((50, 2))
    found = SavitzkyGolay(11, 2).smooth(np.arange(50.0), states)
    for column in range(2):
        np.testing.assert_allclose(found[:, column], savgol_filter(states[:, column], 11, 2))


def test_median_removes_an_outlier_and_leaves_a_monotone_state():
    times = _uneven()
    spoiled = times.copy()
    spoiled[10] = 1000
    found = MedianFilter(5).smooth(times, np.column_stack([times, spoiled]))
    np.testing.assert_array_equal(found[:, 0], times)
    assert found[10, 1] == times[11]
    np.testing.assert_array_equal(found[2:-2, 1], median_filter(spoiled, 5)[2:-2])


def test_wiener_is_scipys_formula_inside():
    times, x, _, _ = _drop(noise=0.5)
    padded = np.pad(x, 2, mode="reflect", reflect_type="odd")
    noise = np.mean([np.var(padded[i : i + 5]) for i in range(len(x))])
    found = WienerFilter(5).smooth(times, x[:, np.newaxis])[:, 0]
    np.testing.assert_allclose(found[2:-2], wiener(x, 5, noise=noise)[2:-2], rtol=1e-9)


def test_wiener_does_not_drag_the_ends_toward_zero():
    times = np.arange(20.0)
    line = 100 + times
    assert abs(wiener(line, 5)[0] - 100) > 1
    np.testing.assert_allclose(WienerFilter(5).smooth(times, line[:, np.newaxis])[:, 0], line)


def test_smoothed_difference_smooths_the_rate_again_only_before_it_is_differentiated():
    times, x, _, _ = _drop(noise=0.1)
    times = times + 0.002 * np.sin(np.arange(49))

    def difference(x):
        first, last = times[1] - times[0], times[-1] - times[-2]
        left = (-11 / 6 * x[0] + 3 * x[1] - 3 / 2 * x[2] + x[3] / 3) / first
        right = (11 / 6 * x[-1] - 3 * x[-2] + 3 / 2 * x[-3] - x[-4] / 3) / last
        return np.concatenate([[left], (x[2:] - x[:-2]) / (times[2:] - times[:-2]), [right]])

    smooth = savgol_filter(x, 35, 3)
    velocity = difference(smooth)
    acceleration = difference(savgol_filter(velocity, 35, 3))
    found = _rates(SmoothedDifference(), times, x, 2)
    for each, expected in zip(found, (smooth, velocity, acceleration), strict=True):
        np.testing.assert_allclose(each, expected, rtol=1e-9)


@pytest.mark.parametrize("strength", [1e-5, 1e-2, 10.0])
def test_smoothing_spline_is_scipys_on_uneven_times(strength):
    times = _uneven(60)
    x = np.sin(times) + 0.1 * np.random.default_rng(0).standard_normal(60)
    spline = make_smoothing_spline(times, x, lam=strength)
    found = _rates(SmoothingSpline(strength), times, x, 2)
    for k, each in enumerate(found):
        expected = spline.derivative(k)(times) if k else spline(times)
        np.testing.assert_allclose(each, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_smoothing_spline_chooses_the_strength_of_least_cross_validation_score():
    times, x, _, _ = _drop(noise=0.1)

    def score(strength):
        influence = np.column_stack([make_smoothing_spline(times, e, lam=strength)(times) for e in np.eye(49)])
        return np.mean((x - influence @ x) ** 2) / (1 - np.trace(influence) / 49) ** 2

    smoothed, *_ = _rates(SmoothingSpline(), times, x)
    best = min(np.geomspace(1e-4, 1e2, 61), key=score)
    np.testing.assert_allclose(smoothed, make_smoothing_spline(times, x, lam=best)(times), atol=2e-3)


@pytest.mark.parametrize("waves", [2000, 200, 20, 0.3])
def test_smoothing_splines_of_long_trials_err_no_more_for_being_chosen_by_stretches(waves):
    """The strength of least score over all samples is the reference; slow states have it."""
    times = np.linspace(0, 1, 12_000)
    x = np.sin(2 * np.pi * waves / 2 * times) * (1 + times / 2)
    measured = x + 0.05 * np.random.default_rng(2).standard_normal(len(times))
    steps = np.full(len(times) - 1, 1.0)
    whole, _ = penalized._of_least_score([(steps, measured)])
    chosen = penalized.cross_validated(steps, measured)
    few, all_of_them = (np.std(penalized.smoothing_spline(steps, measured, each)[0] - x) for each in (chosen, whole))
    assert few < 1.15 * all_of_them


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_smoothing_spline_finds_the_rate_whatever_the_unit_of_time(unit):
    times, x, velocity, _ = _drop(noise=0.1)
    _, rate = _rates(SmoothingSpline(), times / unit, x)
    assert _error(rate / unit, velocity) < 0.04


@pytest.mark.parametrize("count", [32, 33])
def test_spectral_derivatives_of_a_periodic_state_are_exact(count):
    times = 5 + 2 * np.arange(count) / count
    phase = np.pi * times
    state = 3 + np.sin(2 * phase) - np.cos(5 * phase)
    _, rate, second = _rates(SpectralDerivative(), times, state, 2)
    np.testing.assert_allclose(rate, np.pi * (2 * np.cos(2 * phase) + 5 * np.sin(5 * phase)), atol=1e-10)
    np.testing.assert_allclose(second, np.pi**2 * (-4 * np.sin(2 * phase) + 25 * np.cos(5 * phase)), atol=1e-8)


def test_spectral_cutoff_drops_what_is_faster():
    times = np.arange(64) / 64
    slow, fast = np.sin(2 * np.pi * 3 * times), np.sin(2 * np.pi * 20 * times)
    smoothed, rate = _rates(SpectralDerivative(cutoff=10), times, slow + fast)
    np.testing.assert_allclose(smoothed, slow, atol=1e-12)
    np.testing.assert_allclose(rate, 6 * np.pi * np.cos(2 * np.pi * 3 * times), atol=1e-10)


def test_total_variation_reaches_the_optimum_of_its_convex_problem():
    times = _uneven(60)
    x = np.abs(times - 4) + 0.05 * np.random.default_rng(0).standard_normal(60)
    strength = 1e-3
    span, scaled = times[-1] - times[0], (x - x.mean()) / x.std()
    slope = np.diff(np.eye(60), axis=0) / (np.diff(times) / span)[:, np.newaxis]
    bends = np.diff(slope, axis=0)
    weight = strength * 60
    dual = lsq_linear(bends.T, scaled, bounds=(-weight, weight), tol=1e-12)

    def objective(z):
        return np.mean((z - scaled) ** 2) / 2 + strength * np.abs(bends @ z).sum()

    smoothed, rate = _rates(TotalVariationDerivative(strength), times, x)
    best = objective(scaled - bends.T @ dual.x)
    assert objective((smoothed - x.mean()) / x.std()) == pytest.approx(best, rel=1e-3)
    np.testing.assert_allclose(rate, np.gradient(smoothed, times))


def test_total_variation_finds_a_kink_that_smoothing_rounds_off():
    times = np.linspace(0, 1, 200)
    x = np.abs(times - 0.5) + 0.005 * np.random.default_rng(0).standard_normal(200)
    near = (np.abs(times - 0.5) > 0.01) & (np.abs(times - 0.5) < 0.06)
    _, sharp = _rates(TotalVariationDerivative(1e-4), times, x)
    _, round_ = _rates(SmoothedDifference(SavitzkyGolay(35, 3)), times, x)
    true = np.sign(times - 0.5)
    assert _error(sharp[near], true[near]) < 0.1 < _error(round_[near], true[near])


def test_total_variation_second_derivative_integrates_to_the_rate():
    times, x, velocity, _ = _drop(noise=0.02)
    _, rate, second = _rates(TotalVariationDerivative(1e-5), times, x, 2)
    np.testing.assert_allclose(cumulative_trapezoid(second, times), rate[1:] - rate[0], atol=1.5)
    assert _error(rate, velocity) < 0.05


@pytest.mark.parametrize("order", [1, 2])
def test_methods_leave_a_constant_state_at_rest(order):
    times = np.arange(40.0)
    for method in (
        SmoothingSpline(),
        TotalVariationDerivative(1e-3),
        SmoothedDifference(WienerFilter(5)),
        SpectralDerivative(),
        FiniteDifference(),
    ):
        np.testing.assert_allclose(_rates(method, times, np.full(40, 0.1), order)[1:], 0, atol=1e-10)


def test_the_default_smooths_only_laws_of_second_order():
    assert default_differentiation(1) == FiniteDifference(2)
    assert default_differentiation(2) == SmoothedDifference(SavitzkyGolay(35, 3), CenteredDifference())
    assert default_differentiation(2, 35) == default_differentiation(2)
    assert default_differentiation(2, 34) == SmoothingSpline()


@pytest.mark.parametrize(
    ("method", "needed"),
    [
        (CenteredDifference(), 4),
        (ForwardDifference(), 3),
        (FiniteDifference(4), 6),
        (SmoothingSpline(), 5),
        (SpectralDerivative(), 3),
        (TotalVariationDerivative(1e-3), 3),
        (SmoothedDifference(MedianFilter(5)), 5),
        (SmoothedDifference(WienerFilter(5)), 5),
        (SmoothedDifference(SavitzkyGolay(45, 3)), 45),
    ],
)
def test_a_trial_that_is_too_short_is_refused_and_one_sample_more_is_taken(method, needed):
    times = np.arange(float(needed))
    states = np.sin(times)[:, np.newaxis]
    assert np.all(np.isfinite(method.differentiate(times, states, 2).derivatives))
    message = {"window-too-long": "window"} if isinstance(method, SmoothedDifference) else {"too-few-samples": "needed"}
    ((code, limit),) = message.items()
    with refused(code, count=needed - 1, **{limit: needed}):
        method.differentiate(times[:-1], states[:-1], 2)


def test_the_largest_window_that_fits_is_named():
    with refused("window-too-long", count=42, window=45, remedy="choose a window of at most 41"):
        SavitzkyGolay(45, 3).smooth(np.arange(42.0), np.zeros((42, 1)))
    with refused("window-too-long", count=2, window=5, remedy="drop the trial"):
        MedianFilter(5).smooth(np.arange(2.0), np.zeros((2, 1)))


def test_sampling_that_is_not_uniform_is_refused_with_its_sample():
    times = np.arange(60.0) / 15
    times[40:] += 0.1
    states = np.zeros((60, 1))
    with refused("uneven-sampling", sample=40, next_sample=41, step=0.16666666666666652, median=0.06666666666666665):
        SmoothedDifference().differentiate(times, states, 1)
    with refused("uneven-sampling", method="the spectral derivative"):
        SpectralDerivative().differentiate(times, states, 1)


def test_a_third_derivative_of_a_cubic_spline_is_refused():
    with refused("spline-order", order=3):
        SmoothingSpline().differentiate(np.arange(9.0), np.zeros((9, 1)), 3)


@pytest.mark.parametrize(
    ("method", "values", "code", "message"),
    [
        (SavitzkyGolay, (34, 3), "window-even", {"window": 34, "odd": 35}),
        (SavitzkyGolay, (5, 5), "polynomial-fills-window", {"limit": 4}),
        (SavitzkyGolay, (5, -1), "whole-number", {"name": "polynomial", "value": -1}),
        (SavitzkyGolay, (5.0, 3), "whole-number", {"name": "window", "value": 5.0, "bounds": "of at least 3"}),
        (MedianFilter, (1,), "whole-number", {"name": "window", "value": 1, "bounds": "of at least 3"}),
        (WienerFilter, ("5",), "whole-number", {"name": "window", "value": "5"}),
        (FiniteDifference, (3,), "accuracy-odd", {"accuracy": 3}),
        (FiniteDifference, (True,), "whole-number", {"name": "accuracy", "value": True}),
        (SmoothingSpline, (0,), "finite-number-bounded", {"name": "strength", "value": 0, "bound": "above"}),
        (SpectralDerivative, (-1.0,), "finite-number-bounded", {"name": "cutoff", "value": -1.0}),
        (TotalVariationDerivative, (np.nan,), "finite-number-bounded", {"name": "strength"}),
        (TotalVariationDerivative, ("much",), "finite-number-bounded", {"name": "strength", "value": "much"}),
    ],
)
def test_settings_that_do_not_fit_are_refused_at_once(method, values, code, message):
    with refused(code, **message):
        method(*values)


TEXTS = {
    "centered": CenteredDifference(),
    "forward": ForwardDifference(),
    "finite:4": FiniteDifference(4),
    "savgol:35:3": SmoothedDifference(SavitzkyGolay(35, 3)),
    "savgol:15:2:forward": SmoothedDifference(SavitzkyGolay(15, 2), ForwardDifference()),
    "median:7:finite:4": SmoothedDifference(MedianFilter(7), FiniteDifference(4)),
    "median:5:savgol:15:3": SmoothedDifference(MedianFilter(5), SmoothedDifference(SavitzkyGolay(15, 3))),
    "wiener:9": SmoothedDifference(WienerFilter(9)),
    "spline:None": SmoothingSpline(),
    "spline:0.01": SmoothingSpline(0.01),
    "spectral:None": SpectralDerivative(),
    "spectral:2.5": SpectralDerivative(2.5),
    "tv:1e-05": TotalVariationDerivative(1e-5),
}
SHORT_TEXTS = {
    "finite": FiniteDifference(2),
    "savgol": SmoothedDifference(),
    "savgol:polynomial=2": SmoothedDifference(SavitzkyGolay(35, 2)),
    "savgol:15:forward": SmoothedDifference(SavitzkyGolay(15, 3), ForwardDifference()),
    "savgol:35:3:centered": SmoothedDifference(),
    "spline": SmoothingSpline(),
    "spectral": SpectralDerivative(),
}


@pytest.mark.parametrize(("text", "method"), TEXTS.items())
def test_text_and_method_stand_for_each_other(text, method):
    assert parse_differentiation(text) == method
    assert format_differentiation(method) == text


@pytest.mark.parametrize(("text", "method"), SHORT_TEXTS.items())
def test_a_text_may_leave_out_defaults_or_write_them(text, method):
    assert parse_differentiation(text) == method


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("savgl:35", Diagnostic("unknown-name", {"kind": "differentiation", "name": "savgl"})),
        ("savgol:34", Diagnostic("window-even", {"window": 34}, "differentiation 'savgol:34'")),
        ("savgol:35:forwrd", Diagnostic("whole-number", {"name": "polynomial", "value": "forwrd"})),
        ("tv", Diagnostic("spec-syntax", {"text": "tv", "usage": "'tv:STRENGTH'"})),
        ("finite:2:3", Diagnostic("spec-syntax", {"usage": "'finite:[ACCURACY=2]'"})),
        ("centered:forward", Diagnostic("differentiation-chain", {"head": "centered", "rest": "forward"})),
    ],
)
def test_a_text_that_does_not_fit_is_refused_with_the_way_out(text, message):
    with refused(message):
        parse_differentiation(text)


SCHEMA = Schema(("x", "y"))


def long_trial(samples=20_000):
    times = np.arange(samples) * 0.01
    noise = 1e-3 * np.random.default_rng(0).standard_normal((samples, 2))
    return Trial("swing", "1", times, np.column_stack([np.sin(times), np.cos(0.7 * times)]) + noise)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("text", ["centered", "forward", "finite:4", "savgol:35:3", "median:5", "wiener:5", "spline"])
def test_a_long_trial_is_differentiated_in_pieces_that_fit_together(text, order):
    assert text.split(":")[0] in METHODS
    form, trial = StrongForm(parse_differentiation(text), order, trim=3), long_trial()
    values, targets = form.samples(trial)
    whole = form.rates(trial)
    np.testing.assert_allclose(values[:, :2], whole.states[3:-3], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(targets, whole.derivatives[order - 1][3:-3], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("parts", [1, 3, 7])
def test_the_parts_of_a_trial_are_the_systems_of_its_rows(parts):
    form, trial = StrongForm(CenteredDifference(), trim=5), long_trial(9000)
    terms = PolynomialLibrary(2).bind(law_variables(SCHEMA, form.order))
    problems, rows = form.problems(trial, terms, parts), form.rows(trial, terms)
    assert len(problems) == parts
    assert sum(problem.rows for problem in problems) == 8990
    everything, whole = np.ones(6, dtype=bool), LeastSquaresProblem.of(*rows)
    np.testing.assert_allclose(
        merge(problems).least_squares(everything, 1), whole.least_squares(everything, 1), rtol=1e-9
    )
    first = LeastSquaresProblem.of(*(row[: problems[0].rows] for row in rows))
    np.testing.assert_allclose(problems[0].least_squares(everything, 0), first.least_squares(everything, 0), rtol=1e-9)


def test_names_of_rates_avoid_the_names_of_other_variables():
    assert law_variables(Schema(("x",)), 2).states == ("x", "v")
    assert law_variables(Schema(("x",), inputs=("v",)), 2).states == ("x", "x_rate")
    assert law_variables(Schema(("x", "y")), 2).states == ("x", "y", "v_x", "v_y")
