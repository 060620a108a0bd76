"""States above zero that laws follow by their logarithms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import t

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.inference.search.setup import on_log_scale
from commonlaw.inference.verbs.comparison import outcomes_of_scale
from commonlaw.integration import InitialValueProblem, VectorField, simulate
from commonlaw.law.parameters import named_parameters, standard_errors
from commonlaw.library import Terms, Variables, parse_library
from commonlaw.likelihood.levels import over_decades
from commonlaw.plots import plot_forecast
from commonlaw.trials.transformations import with_logarithms
from tests.refusals import refused

TIMES = np.linspace(0, 12, 40)


def weights(start, times):
    return 1 / (0.01 + (1 / start - 0.01) * np.exp(-0.6 * times))


def growing(starts=(2.0, 3.0, 1.0, 4.0, 6.0), share=0.08, seed=0, names=("w",)):
    """Plants that grow to 100, w' = 0.6 w - 0.006 w^2, with errors that are shares of the weight."""
    generator = np.random.default_rng(seed)
    measured = [weights(start, TIMES) * np.exp(share * generator.standard_normal(len(TIMES))) for start in starts]
    return cl.Trials.from_arrays([TIMES] * len(starts), measured, object=["plant"] * len(starts), names=list(names))


@pytest.fixture(scope="module")
def law():
    return cl.discover(growing(), method=cl.TrajectoryLikelihood(log_states=["w"]), order=1, library="poly:3")


@pytest.mark.parametrize("logarithmic", [("x",), ("y",), ("y", "x")])
def test_the_field_is_that_of_the_logarithms_with_its_derivatives(logarithmic):
    variables = Variables(("x", "y"), ("u",))
    terms = parse_library("poly:2 + terms:sin(x),x*t").bind(variables)
    generator = np.random.default_rng(0)
    plain = VectorField(terms, generator.standard_normal((2, len(terms))))
    followed = replace(plain, terms=Terms(replace(variables, logarithmic=logarithmic), terms.terms))
    natural = generator.uniform(0.5, 2, (6, 4))
    columns, values = list(variables.columns(logarithmic)), natural.copy()
    values[:, columns] = np.log(natural[:, columns])
    expected = plain.derivatives(natural)
    expected[:, columns] /= natural[:, columns]
    derivatives, by_states, by_parameters = followed.linearize(values)
    np.testing.assert_allclose(followed.derivatives(values), expected, rtol=1e-12)
    np.testing.assert_allclose(derivatives, expected, rtol=1e-12)
    for k in range(2):
        step = 1e-6 * np.eye(4)[k]
        numeric = (followed.derivatives(values + step) - followed.derivatives(values - step)) / 2e-6
        np.testing.assert_allclose(by_states[:, :, k], numeric, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(by_parameters @ plain.parameters, derivatives, rtol=1e-12)


def test_every_back_end_follows_logarithms():
    variables = Variables(("x", "y"), logarithmic=("x",))
    terms = parse_library("terms:x,y,x*y").bind(variables)
    field = VectorField(terms, np.array([[1.0, 0, -0.9], [0, -1.2, 0.6]]))
    problem = InitialValueProblem(field, np.array([np.log(1.2), 0.9]), TIMES)
    fast, slow = (simulate([problem], method=each, sensitivities=True)[0] for each in ("heyoka", "scipy"))
    np.testing.assert_allclose(fast.states, slow.states, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(fast.sensitivities, slow.sensitivities, rtol=1e-4, atol=1e-4)
    plain = replace(problem, field=replace(field, terms=Terms(Variables(("x", "y")), terms.terms)))
    natural = simulate([replace(plain, initial=np.array([1.2, 0.9]))])[0].states
    np.testing.assert_allclose(np.exp(fast.states[:, 0]), natural[:, 0], rtol=1e-6)


def test_exponential_growth_is_a_straight_line_through_the_logarithms():
    generator = np.random.default_rng(3)
    states = [start * np.exp(0.2 * TIMES + 0.1 * generator.standard_normal(len(TIMES))) for start in (2.0, 5.0)]
    trials = cl.Trials.from_arrays([TIMES] * 2, states, object=["yeast"] * 2, names=["w"])
    law = cl.fit("w' = a w", trials, log_states=["w"], noise={"w": 0.1}, huber_threshold=np.inf)
    columns = np.column_stack([np.tile(TIMES, 2), np.repeat(np.eye(2), len(TIMES), axis=0)])
    slope = np.linalg.lstsq(columns, np.log(np.concatenate(states)), rcond=None)[0][0]
    assert law.coefficients[0, 0, 0] == pytest.approx(slope, rel=1e-6)
    assert standard_errors(law)[0, 0, 0] == pytest.approx(
        0.1 * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0]), rel=1e-3
    )


def test_the_law_is_in_units_of_the_state_and_its_intervals_hold_the_truth(law):
    assert law.structure == ("w' = a w + b w^2",)
    assert law.uncertainty.noise == pytest.approx([0.08], rel=0.15)
    assert not law.uncertainty.error_model
    assert "% of it, on a logarithmic scale" in law.history[0].choice
    own = law.support[0]
    missed = (law.coefficients[0, 0, own] - [0.6, -0.006]) / standard_errors(law)[0, 0, own]
    assert np.all(np.abs(missed) < 3.5)


def test_forecasts_and_their_bands_are_above_zero(law):
    trials = growing(share=0.6, seed=5)
    poor = replace(law, uncertainty=replace(law.uncertainty, noise=np.array([0.6])))
    forecast = poor.predict(trials, return_std=True, start=3, averaged=False)  # An average need not be symmetric
    for trial, (low, high), trajectory in zip(
        trials, forecast.bands(measured=True), forecast.trajectories, strict=True
    ):
        assert (low > 0).all()
        np.testing.assert_allclose(low * high, trajectory.states**2, rtol=1e-9)
        assert np.mean((low <= trial.states) & (trial.states <= high)) > 0.85
    np.testing.assert_array_equal(forecast.trials[0].states, trials[0].states)
    table = forecast.to_frame()
    np.testing.assert_allclose(table["w measured low"], forecast.interval(measured=True)["low"])
    np.testing.assert_allclose(forecast.margins()[0], np.subtract(*forecast.bands()[0][::-1]) / 2)
    plain = replace(law, uncertainty=replace(law.uncertainty, interval_inflation=None))
    small = plain.predict(growing(share=0.01), return_std=True, start=10, averaged=False)
    reach = t.ppf(0.975, law.uncertainty.degrees_of_freedom[0])
    np.testing.assert_allclose(small.std[0], small.margins()[0] / reach, rtol=0.01)


def test_forecasts_beyond_the_measurements_keep_what_was_measured(law):
    trials = growing()
    for settings in ({"times": [13.0, 14.0]}, {"from_time": 6.0, "times": [12.5]}):
        forecast = law.predict(trials, return_std=True, **settings)
        measured = np.isfinite(forecast.trials[0].states[:, 0])
        assert np.isin(forecast.trials[0].states[measured], trials[0].states).all()
        assert np.isfinite(forecast.trajectories[0].states).all()
        truth = weights(2.0, forecast.trials[0].times)
        np.testing.assert_allclose(forecast.trajectories[0].states[:, 0], truth, rtol=0.1)
    smooth = law.predict(trials, return_std=True).smooth()
    assert len(smooth.trials[0]) > 200
    assert (smooth.bands()[0][0] > 0).all()
    plot_forecast(law.predict(trials, return_std=True), objects=["plant"])
    assert law.assess(trials).coverage > 0.85


def test_errors_that_are_known_for_each_measurement_are_shares():
    trials = growing()
    noisy = cl.Trials.from_arrays(
        [trial.times for trial in trials],
        [trial.states for trial in trials],
        object=["plant"] * 5,
        noise=[0.08 * trial.states for trial in trials],
        names=["w"],
    )
    given, by_column = (
        cl.fit("w' = a w + b w^2", trials, log_states=["w"], noise={"w": 0.08}),
        cl.fit("w' = a w + b w^2", noisy, log_states=["w"]),
    )
    np.testing.assert_allclose(by_column.coefficients, given.coefficients, rtol=1e-9)
    np.testing.assert_allclose(by_column.uncertainty.noise, [0.08])


def test_laws_keep_their_scale(law, tmp_path):
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert again.schema.logarithmic == ("w",)
    trials = growing()
    before, after = (each.predict(trials).trajectories[0].states for each in (law, again))
    np.testing.assert_array_equal(before, after)
    assert cl.refine(again, trials).uncertainty.noise == pytest.approx(law.uncertainty.noise)
    assert cl.refine(again, trials, log_states=[]).schema.logarithmic == ()
    np.testing.assert_allclose(law.simulate([0.0, 12.0], [2.0])["plant"].states[:, 0], [2.0, 96.4], rtol=0.05)
    both = cl.compare({"logistic": law, "exponential": cl.fit("w' = a w", trials[:2], log_states=["w"])}, trials[:2])
    assert both["law"].tolist() == ["logistic", "exponential"]


def test_a_state_that_a_law_drives_below_zero_diverges():
    shrinking = on_log_scale(cl.Law.from_text("w' = -1"), ["w"])
    trials = cl.Trials.from_arrays(np.arange(6.0), 3.0 - 0.5 * np.arange(6.0) ** 0.5, names=["w"])
    (outcome,) = shrinking.predict(trials).outcomes
    assert "diverged" in str(outcome)


@pytest.mark.slow
def test_several_states_may_have_scales_of_their_own():
    trials = cl.datasets.lotka_volterra(noise=0.01)[:2]
    library = "terms:1,x,y,x*y"
    plain = cl.discover(trials, library=library, order=1)
    mixed = cl.discover(trials, library=library, method=cl.TrajectoryLikelihood(log_states=["y"]), order=1)
    assert mixed.structure == plain.structure
    inside = plain.coefficients != 0
    np.testing.assert_allclose(mixed.coefficients[inside], plain.coefficients[inside], rtol=0.05)


@pytest.mark.parametrize("start", ["", "; w(0) = w0"])
def test_laws_are_compared_on_the_logarithmic_scale_of_one_of_them(start):
    trials = growing(starts=(2.0, 3.0))
    linear = cl.fit("w' = a w - b w^2", trials, errors="proportional")
    logarithmic = cl.fit(f"w' = a w - b w^2{start}", trials, log_states=["w"], errors="white")
    laws = {"linear": linear, "logarithmic": logarithmic}
    (outcome,) = outcomes_of_scale(laws, trials)
    assert outcome.code == "scale-of-comparison"
    evidence = cl.compare(laws, trials).set_index("law")["2 log B"]
    both = laws | {"linear": on_log_scale(linear, ["w"])}
    assert outcomes_of_scale(both, trials) == ()
    expected = cl.compare(both, trials).set_index("law")["2 log B"]
    np.testing.assert_allclose(evidence[[*laws]], expected[[*laws]], atol=1e-3)
    if not start:
        np.testing.assert_allclose(evidence, 0, atol=1e-6)
    oscillating = cl.Law.from_text("w'' = -k w", {"k": 1.0})
    with refused("log-states-differ", states=("w",), laws=["second"]):
        cl.compare(laws | {"second": oscillating}, trials)


def test_laws_compared_on_a_scale_that_loses_values_are_noted():
    decades = cl.Trials.from_arrays(TIMES, 1e-9 * np.exp(2 * TIMES), names=["w"])
    laws = {"growth": cl.Law.from_text("w' = k w", {"k": 2.0}), "constant": cl.Law.from_text("w' = c", {"c": 1.0})}
    assert [outcome.code for outcome in outcomes_of_scale(laws, decades)] == ["small-values-without-weight"]
    assert outcomes_of_scale(laws, decades, errors="white") == ()
    assert outcomes_of_scale(laws, growing()) == ()
    second = {"second": cl.Law.from_text("w'' = k w", {"k": 4.0})}
    assert outcomes_of_scale(second, decades) == ()  # Of which there is none on a logarithmic scale


def test_what_does_not_go_with_it_is_refused(law):
    trials = growing()
    states = trials[0].states.copy()
    states[3], states[7] = 0.0, -1.0
    zero = trials.with_trials([replace(trials[0], states=states)])
    likelihood = cl.TrajectoryLikelihood
    cases = [
        (
            lambda: cl.discover(zero, method=likelihood(log_states=["w"]), order=1, library="poly:3"),
            Diagnostic(
                "log-state-not-positive", {"state": "w", "value": 0.0, "sample": 4, "count": 2}, "plant, trial 1"
            ),
        ),
        (lambda: law.predict(zero), "log-state-not-positive"),
        (
            lambda: cl.discover(trials, method=likelihood(log_states=["x"]), order=1, library="poly:3"),
            Diagnostic("unknown-name", {"kind": "state", "name": "x"}),
        ),
        (
            lambda: cl.discover(trials, order=2, method=likelihood(log_states=["w"]), library="poly:3"),
            "log-states-order",
        ),
        (
            lambda: cl.discover(
                trials, method=likelihood(log_states=["w"], errors="proportional"), order=1, library="poly:3"
            ),
            "log-states-with-errors",
        ),
    ]
    for case, message in cases:
        with refused(message):
            case()
    with refused("log-state-twice"):
        replace(law.schema, logarithmic=("w", "w"))
    inside = with_logarithms(trials, ["w"])
    assert with_logarithms(inside, ["w"]) is inside


DECADES = np.arange(11.0)


def colonies(start=10.0, rate=2.0, limit=np.inf, share=0.2, seed=0):
    """Counts that grow by a constant rate, x' = r x (1 - x/K), over many decades, with errors in proportion."""
    grown = np.exp(rate * DECADES)
    counts = start * grown / (1 + start * (grown - 1) / limit)
    errors = np.exp(share * np.random.default_rng(seed).standard_normal(len(DECADES)))
    return cl.Trials.from_arrays([DECADES], [counts * errors], names=["x"])


def line_of_logarithms(trials):
    """Return slope, standard error and residuals' standard deviation of least squares of logarithms."""
    (slope, _), covariance = np.polyfit(DECADES, np.log(trials[0].states[:, 0]), 1, cov=True)
    return slope, np.sqrt(covariance[0, 0])


@pytest.mark.parametrize("equations", ["x' = r x", "x' = r x; x(0) = x0"])
@pytest.mark.parametrize("rate", [2.0, -2.0])
def test_values_over_many_decades_are_fitted_by_their_logarithms(equations, rate):
    trials = colonies(10.0 if rate > 0 else 1e9, rate)
    law = cl.fit(equations, trials)
    estimates = named_parameters(law)
    slope, error = line_of_logarithms(trials)
    r = estimates.names.index("r")
    assert estimates.values[0, r] == pytest.approx(slope, rel=1e-4)
    assert estimates.errors[0, r] == pytest.approx(error, rel=0.02)
    assert "log-scale-chosen" in [outcome.code for outcome in law.diagnostics]
    linear = named_parameters(cl.fit(equations, trials, errors="white"))
    assert abs(linear.values[0, r] - slope) > error


def test_logistic_growth_over_decades_is_that_of_least_squares_of_logarithms():
    trials = colonies(rate=2.0, limit=3e7, share=0.08)
    estimates = named_parameters(cl.fit("x' = r x (1 - x/K)", trials))

    def residuals(unknowns):
        (rate, limit, start), logarithms = unknowns, np.log(trials[0].states[:, 0])
        return logarithms - limit + np.log1p(np.expm1(limit - start) * np.exp(-rate * DECADES))

    best = least_squares(residuals, [2.0, np.log(3e7), np.log(10.0)], x_scale="jac")
    variances = np.diag(np.linalg.inv(best.jac.T @ best.jac)) * 2 * best.cost / (len(DECADES) - 3)
    expected = np.array([best.x[0], np.exp(best.x[1])])
    np.testing.assert_allclose(estimates.values[0], expected, rtol=1e-3)
    np.testing.assert_allclose(estimates.errors[0], np.sqrt(variances[:2]) * [1, expected[1]], rtol=0.05)


def test_discovery_follows_logarithms_over_decades():
    trials = colonies(1e9, -2.0)
    law = cl.discover(trials, cache=False)
    assert law.structure == ("x' = a x",)
    assert named_parameters(law).values[0, 0] == pytest.approx(line_of_logarithms(trials)[0], rel=1e-3)
    assert law.observation.measured.logarithmic == ("x",)


def test_a_linear_scale_is_kept_where_its_likelihood_is_larger():
    """A step response that begins with tiny values in place of zeros, with white noise."""
    times = np.linspace(0, 5, 21)
    values = 2 - 2 * np.exp(-times) + 0.05 * np.random.default_rng(1).standard_normal(len(times))
    values[0] = 1e-6
    trials = cl.Trials.from_arrays([np.append(-0.25, times)], [np.append(1e-6, values)], names=["x"])
    assert over_decades(trials) == ("x",)
    law = cl.fit("x' = a - b x", trials)
    assert law.observation.measured.logarithmic == ()
    assert not {"log-scale-chosen", "small-values-without-weight"} & {outcome.code for outcome in law.diagnostics}


@pytest.mark.parametrize("equations", ["x' = r x", "x' = r x; x(0) = x0"])
def test_proportional_errors_over_decades_are_refused_with_the_way_out(equations):
    trials = colonies()
    refused("proportional-over-decades", lambda: cl.fit(equations, trials, errors="proportional"))
    white = cl.fit(equations, trials, errors="white")
    refused("proportional-over-decades", lambda: cl.refine(white, trials, errors="proportional"))
    refused("proportional-over-decades", lambda: cl.compare({"a": white}, trials, errors="proportional"))
    method = cl.TrajectoryLikelihood(errors="proportional")
    refused("proportional-over-decades", lambda: cl.discover(trials, method=method, cache=False))
    for chosen, is_noted in ((None, True), ((), False)):
        again = cl.refine(white, trials, log_states=chosen)
        assert ("small-values-without-weight" in [outcome.code for outcome in again.diagnostics]) is is_noted
