"""Laws with observation equations, held against least squares of solutions in closed form."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.stats import norm

import commonlaw as cl
from commonlaw.estimation import likelihood_profile
from commonlaw.estimation.search import Bounds, minimum
from commonlaw.inference import bounds
from commonlaw.law import from_json, to_json, to_latex
from tests.refusals import refused
from tests.unit.decays import (
    OTHER,
    SIGNAL,
    T,
    assert_least_squares,
    errors_of,
    estimates,
    least,
    own_and_shared,
    trials_of,
)

pytestmark = pytest.mark.usefixtures("few_starts")

TRIALS = trials_of({"A": (T, SIGNAL)}, ["signal"])


def test_a_measured_signal_is_a_function_of_the_state():
    law = cl.fit("x' = -k x", TRIALS, observe={"signal": "c x (1 + x) + b"}, initial_values={"x": 1})

    def residuals(p):
        x = np.exp(-p[0] * T)
        return p[1] * x * (1 + x) + p[2] - SIGNAL

    assert_least_squares(law, {"k": 0.5, "c": 1.0, "b": 0.0}, residuals)
    assert "signal = c x (1 + x) + b" in str(law)


def test_a_law_with_an_observation_is_saved_predicts_and_is_assessed(tmp_path):
    trials = trials_of({"A": (T, SIGNAL), "B": (T, OTHER)}, ["signal"])
    law = cl.fit("x' = -k x", trials, observe={"signal": "c x (1 + x) + b"})
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert again.observation == law.observation
    frames = [each.predict(trials, return_std=True).to_frame() for each in (law, again)]
    assert frames[0].equals(frames[1])
    inside = frames[0]["signal"].between(frames[0]["signal measured low"], frames[0]["signal measured high"])
    assert 0.85 < inside.mean() <= 1
    assert law.assess(trials).usable is not False
    assert "white noise" in str(law.residuals(trials))
    later = law.predict(trials, from_time=3.0).to_frame()
    assert np.abs(later["signal error"]).max() < 0.1


def test_known_noise_and_repeated_measurements_have_their_likelihood():
    times = np.repeat([0.0, 1.0, 2.0, 4.0], 3)
    y = 2 * np.exp(-0.5 * times) + 0.1 * np.random.default_rng(14).standard_normal(12)
    law = cl.fit("x' = -k x; x(0) = a", trials_of({"A": (times, y)}, ["x"]), noise={"x": 0.1})
    k, a = (estimates(law)[each][0] for each in "ka")
    expected = norm.logpdf(y, a * np.exp(-k * times), 0.1).sum()
    assert law.provenance.log_likelihood == pytest.approx(expected, rel=1e-9)


def decay(rate):
    return 2 * np.exp(-rate * T) + 0.1


REFINED = {
    "x' = -k x; y = c x + b; x(0) = 1; b > 0.2": (
        {"shared": ["c"], "priors": {"k": (0.5, 0.1)}, "noise": {"y": "lab"}, "log_states": ["y"]},
        decay,
    ),
    "x' = -k x; y = c x + b": ({"initial_values": {"x": (1.0, 0.05)}, "shared": {"b": "trial", "c": "all"}}, decay),
    "x' = k u(t - d) - x; y = x + b; x(0) = 0": (
        {"input_interpolation": "linear"},
        lambda rate: 0.12 / rate * np.maximum(T - 2.5, 0),
    ),
    "x'' = -k x + a step(t - s); y = x + b; x(0) = 1": (
        {"guesses": {"s": 2.8}},
        lambda _: np.cos(0.7 * T) + 0.2 * (1 - np.cos(0.7 * np.maximum(T - 3, 0))),
    ),
}

SLOW = [text for text in REFINED if "step" in text or "b > 0.2" in text]


@pytest.mark.parametrize("text", [pytest.param(text, marks=[pytest.mark.slow] * (text in SLOW)) for text in REFINED])
def test_a_law_is_refined_as_it_was_fitted(text, tmp_path):
    settings, curve = REFINED[text]
    source, inputs = np.random.default_rng(31), ("u",) * ("u(t" in text)
    u = np.interp(T, [0, 1, 2, 9], [0, 0, 2, 2])[:, np.newaxis][:, : len(inputs)]
    made = [
        cl.Trial(owner, name, T, curve(rate) + 0.02 * source.standard_normal(len(T)), u)
        for owner, rate in {"A": 0.4, "B": 0.8}.items()
        for name in "12"[: 2 - len(inputs)]
    ]
    properties = {"A": {"lab": "one"}, "B": {"lab": "two"}}
    trials = cl.Trials(tuple(made), cl.Schema(("y",), inputs), properties)
    law = cl.fit(text, trials, **settings)
    law.save(tmp_path / "law.json")
    again = cl.refine(cl.Law.load(tmp_path / "law.json"), trials)
    assert again.provenance.log_likelihood == pytest.approx(law.provenance.log_likelihood, rel=1e-8, abs=1e-6)
    assert again.params["estimate"].to_numpy() == pytest.approx(law.params["estimate"].to_numpy(), rel=1e-4)
    assert again.params["standard error"].to_numpy() == pytest.approx(
        law.params["standard error"].to_numpy(), rel=1e-2, nan_ok=True
    )
    assert again.restrictions == law.restrictions
    assert np.isfinite(again.predict(trials).to_frame()["y forecast"]).all()
    # Of other trials, as a fit of them alone
    fewer = trials.select(object="B")
    assert cl.refine(law, fewer).provenance.log_likelihood == pytest.approx(
        cl.fit(text, fewer, **settings).provenance.log_likelihood, abs=1e-4
    )


def bayes_factor(samples, curves, firsts, counts):
    """Return minus twice the log-likelihood at its maximum with log n for each unknown, by least squares of all."""
    found = []
    for curve, first, count in zip(curves, firsts, counts, strict=True):
        fit = least_squares(lambda p, c=curve: np.concatenate(c(p)) - np.concatenate(samples), first, x_scale="jac")
        n = len(fit.fun)
        found.append(n * np.log(2 * np.pi * 2 * fit.cost / n) + n + sum(np.log(count)) + np.log(n))
    return np.array(found) - min(found)


def test_laws_are_compared_through_their_observation_equations():
    samples = own_and_shared()
    trials, y = trials_of(samples), [each for _, each in samples.values()]
    own, whole = len(T), 3 * len(T)
    texts = {
        "shared": "x' = -k x; y = x + b; x(0) = a",
        "apart": "x' = -k x; y = x + b",
        "plain": "y' = -k y",
        "slow": "x' = -k x^2; y = c x; x(0) = 2",
    }
    laws = {"shared": cl.fit(texts["shared"], trials, shared=["a", "b"])}
    laws |= {name: cl.fit(texts[name], trials) for name in ("apart", "plain", "slow")}
    frame = cl.compare(laws, trials).set_index("law")
    curves = [
        lambda p: [p[3] * np.exp(-k * T) + p[4] for k in p[:3]],
        lambda p: [a * np.exp(-k * T) + b for k, a, b in p.reshape(3, 3)],
        lambda p: [a * np.exp(-k * T) for k, a in p.reshape(3, 2)],
        lambda p: [c * 2 / (1 + 2 * k * T) for k, c in p.reshape(3, 2)],
    ]
    firsts = [[0.5, 0.5, 0.5, 2, 1], [0.5, 2, 1] * 3, [0.3, 2.5] * 3, [0.3, 1.2] * 3]
    counts = [[own] * 3 + [whole] * 2, [own] * 9, [own] * 6, [own] * 6]
    expected = bayes_factor(y, curves, firsts, counts)
    # Of which the information criterion is an approximation, as rates scatter over objects
    assert frame.loc[list(laws), "2 log B"].to_numpy() == pytest.approx(expected, abs=9)
    assert frame.loc[list(laws), "coefficients"].tolist() == [3, 2, 1, 2]
    assert frame.index[2:].tolist() == ["slow", "plain"]
    assert frame["probability"].sum() == pytest.approx(1)
    with refused("laws-of-other-states"):
        cl.compare([laws["plain"], cl.Law.from_text("x' = -k x", {"k": 1}), laws["slow"]], trials)
    with refused("process-noise-with-observation"):
        cl.compare(laws, trials, errors="random-walk")


def test_laws_without_noise_are_not_updated(law):
    with refused("weights-unknown"):
        replace(law, uncertainty=replace(law.uncertainty, noise=None)).update(TRIALS)


def test_new_trials_update_the_parameters_of_an_object():
    source, made = np.random.default_rng(41), []
    for owner, k in {"A": 0.5, "B": 0.9}.items():
        for i, start in enumerate((1.0, 1.5, 0.7)):
            y = 2 * start * np.exp(-k * T) + 0.3 + 0.02 * source.standard_normal(len(T))
            made.append(cl.Trial(owner, str(i), T, y))
    trials = cl.Trials(tuple(made), cl.Schema(("y",)))
    text, noise = "x' = -k x; y = 2 x + b", {"y": 0.02}
    law = cl.fit(text, trials.select(trial=["0", "1"]), noise=noise)
    updated, whole = (
        law.update(trials.select(object="A", trial="2")),
        cl.fit(text, trials.select(object="A"), noise=noise),
    )
    assert updated.objects == ("A",)
    assert updated.params["estimate"].to_numpy() == pytest.approx(whole.params["estimate"].to_numpy(), rel=1e-3)
    errors = updated.params["standard error"].to_numpy()
    assert errors == pytest.approx(whole.params["standard error"].to_numpy(), rel=0.02)
    assert (errors < 0.9 * law.params["standard error"].to_numpy()[: len(errors)]).all()
    (initial,) = updated.trial_estimates
    assert (initial.trial, initial.name) == ("2", "x(0)")
    assert initial.value == pytest.approx(whole.trial_estimates[2].value, rel=1e-3)


def test_absent_terms_are_limited_through_an_observation_equation():
    samples = {name: (t, 2 * y) for name, (t, y) in own_and_shared().items()}
    trials = trials_of(samples)
    law = cl.fit("x' = -k x; y = 2 x + b; x(0) = 2", trials, shared=["b"], noise={"y": 0.1})
    found = bounds(law, trials, ["x^2"])
    whole = np.concatenate([y for _, y in samples.values()])

    def residuals(p):
        # x' = -k x + q x^2 with x(0) = 2
        curves = [k * 2 / (2 * q + (k - 2 * q) * np.exp(k * T)) for k, q in p[:6].reshape(3, 2)]
        return (np.concatenate([2 * x + p[6] for x in curves]) - whole) / 0.1

    fit = least(residuals, [0.4, 0.01, 0.8, 0.01, 1.2, 0.01, 2])
    errors = errors_of(fit)
    for bound, value, error in zip(found.bounds, fit.x[1:6:2], errors[1:6:2], strict=True):
        assert (bound.coefficient, bound.error) == pytest.approx((value, error), rel=1e-3)
        half = norm.ppf(0.975) * error
        assert (bound.low, bound.high) == pytest.approx((value - half, value + half), rel=1e-2)
        assert bound.effect == pytest.approx(4 * bound.at_most, rel=1e-6)


@pytest.fixture(scope="module")
def law():
    """Return a law of a signal, with a prior of its scale."""
    return cl.fit("x' = -k x; signal = c x; x(0) = x0 + 1", TRIALS, priors={"c": (4, 1)})


@pytest.mark.parametrize(
    "change",
    [
        {"uncertainty": {"noise": [-1.0]}},
        {"uncertainty": {"noise": [0.0]}},
        {"uncertainty": {"noise_of": {"other": {"A": 1.0}}}},
        {"uncertainty": {"noise_of": {"signal": {"A": 0.0}}}},
        {"provenance": {"domain": {"sizes": {"x": 0.0}}}},
        {"observation": {"equations": {"other": "x"}}},
        {"scheme": "collocation"},
        {"scheme": "guesses"},
    ],
)
def test_files_with_observations_that_cannot_be_are_refused(change, law):
    document = json.loads(to_json(law))
    for part, changed in change.items():
        document[part] = changed if isinstance(changed, str) else document[part] | changed
    with pytest.raises(cl.CommonlawError):
        from_json(json.dumps(document))


@pytest.mark.slow
def test_oscillations_over_many_cycles_are_fitted_from_their_first_ones_on():
    generator, times, truth = np.random.default_rng(3), np.linspace(0, 24, 90), (0.75, 0.84, 0.95, 0.9)

    def rates(_, state, a, c, f, d):
        return a * state[0] - c * state[0] * state[1], f * state[0] * state[1] - d * state[1]

    x, z = solve_ivp(rates, (0, 24), (0.6, 1.3), t_eval=times, args=truth, rtol=1e-9).y
    measured = np.column_stack([x, 1.7 * (x + z) + 0.4]) + 0.005 * generator.standard_normal((90, 2))
    trials = cl.Trials.from_arrays(times, measured, names=["x", "y"])
    law = cl.fit("x' = a x - c x z; z' = f x z - d z; y = 1.7 x + 1.7 z + 0.4", trials)
    assert [estimates(law, "object")[name][0] for name in "acfd"] == pytest.approx(truth, abs=0.02)
    assert not law.diagnostics


def test_residuals_above_the_noise_between_samples_are_noted():
    signal = 1.0 + 0.3 * np.sin(2 * T) + 0.01 * np.random.default_rng(0).standard_normal(len(T))
    (outcome,) = cl.fit("x' = -k x; signal = x; x(0) = 1", trials_of({"A": (T, signal)}, ["signal"])).diagnostics
    assert outcome.code == "residuals-exceed-noise"


def test_the_rate_of_a_signal_that_is_zero_has_a_lower_limit_only():
    law = cl.fit("x' = -k x; signal = x; x(0) = 1", trials_of({"A": (T, 0 * T)}, ["signal"]))
    assert "one-sided-limit" in {outcome.code for outcome in law.diagnostics}


@pytest.mark.parametrize(
    ("code", "equations", "settings"),
    [
        ("measured-without-equation", "x' = -k x", {"initial_values": {"x": 1}, "priors": {"k": (1, 1)}}),
        ("parameters-not-identified", "x' = -k x; y = a b x; x(0) = 1", {}),
        ("observation-without-state", "x' = -k x; y = a + b z", {}),
        ("bound-contradiction", "x' = -k x; y = a x; k > 3; k < 2; x(0) = 1", {}),
        ("initial-value-of-variables", "x' = -k x; y = a x; x(0) = y0 + t", {}),
        ("initial-value-twice", 'y\' = -k y; y(0) = 1; y(0) = 2 @ "1"', {}),
        ("initial-value-not-finite", 'y\' = -k y; y(0) = y0 @ "1"', {}),
        ("unknown-name", 'y\' = -k y; y(0) = 1 @ "another"', {}),
        ("unknown-name", "y' = -k y", {"initial_values": {"y": {"another": 1.0}}}),
        ("condition-syntax", "y' = -k y if y > 1", {}),
        ("switch-arguments", "y' = -k max(y)", {}),
        ("steady-states-differ", "x' = -k x; y' = x - y; x(0) = steady(u = 1); y(0) = steady", {}),
        ("prior-not-positive", "x' = -k x; y = a x", {"priors": {"a": (1, 0)}}),
        ("process-noise-with-observation", "x' = -k x; y = a x", {"errors": "random-walk"}),
        ("not-with-observation", "x' = -k x; y = a x", {"partial_pooling": True}),
        ("log-states-with-errors", "x' = -k x; y = a x", {"errors": "proportional", "log_states": ["y"]}),
        ("prior-not-positive", "y' = -k y", {"initial_values": {"y": (1.0, 0.0)}}),
        ("initial-value-not-finite", "y' = -k y", {"initial_values": {"y": np.inf}}),
        ("unknown-name", "x' = -k x; y = a x", {"shared": "q"}),
        ("unknown-name", "x' = -k x; z = a x; y = x", {}),
        ("observation-of-discrete-time", "x[k+1] = r x; y = a x", {}),
        ("noise-not-positive", "x' = -k x; y = a x", {"noise": {"y": -1.0}}),
        ("noise-overwhelming", "x' = -k x; y = a x", {"noise": {"y": 1e300}}),
        ("noise-overwhelming", "x' = -k x; y = a x", {"noise": {"y": 1e10}, "log_states": ["y"]}),
        ("guess-out-of-bounds", "x' = -k x; y = a x", {"guesses": {"k": 0.0}}),
        ("equation-without-column", "y' = -k y + w; w' = -c w", {"priors": {"k": (1, 0.1)}}),
        ("initial-time-late", "x' = -k x; y = a x", {"initial_time": 99.0}),
        ("noise-not-a-property", "x' = -k x; y = a x", {"noise": {"y": "lab"}}),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_words(code, equations, settings):
    with refused(code):
        cl.fit(equations, trials_of({"A": (T, np.exp(-T) + 0.01)}), **settings)


def test_what_laws_with_observations_cannot_do_is_refused(law):
    stream, stated = cl.TrialStream(TRIALS.schema, lambda: TRIALS), cl.Law.from_text("signal[k+1] = r signal", {"r": 1})
    measured = law.observation.measured
    for code, call in {
        "not-refined-file-by-file": lambda: cl.refine(law, stream),
        "not-with-observation": lambda: cl.refine(law, TRIALS, input_interpolation="auto"),
        "discrete-not-refined": lambda: cl.compare([stated, law], TRIALS),
        "profile-without-equations": lambda: likelihood_profile(stated, TRIALS, "r"),
        "limits-unsupported": lambda: bounds(stated, TRIALS),
        "limits-without-terms": lambda: bounds(law, TRIALS),
    }.items():
        with refused(code):
            call()
    with refused("not-refined-file-by-file"):
        cl.compare([law], stream)
    schemas = [replace(measured, units={"signal": unit}) for unit in "Vm"]
    laws = [replace(law, observation=replace(law.observation, measured=schema)) for schema in schemas]
    with refused("laws-in-other-units"):
        cl.compare(laws, TRIALS)


@pytest.mark.usefixtures("undrawn")
def test_reports_and_figures_show_what_was_measured(law):
    assert r"\mathrm{signal} &= c x" in to_latex(law)
    assert r"x(0) &= x_{0} + 1" in to_latex(law)
    assert law.params.set_index("parameter")["equation"].to_dict() == {"k": "x'", "c": "signal", "x0": "x(0)"}
    assert "forecasts from the first" in law.report(TRIALS).html.lower()
    assert "signal" in cl.plots.plot_law(law, TRIALS).get_suptitle()


@dataclass
class _Line:
    """The residual of one unknown from a value."""

    value: float

    def residuals(self, unknowns):
        return unknowns - self.value

    def jacobian(self, unknowns):
        return np.ones((1, len(unknowns)))


@pytest.mark.parametrize("value", [3.0, 2e200])
def test_searches_among_numbers_whose_squares_are_infinite_end(value):
    unknowns, _ = minimum(_Line(value), np.array([1e200]), np.array([True]), tolerance=1e-8, steps=20)
    bounds = Bounds(np.array([-np.inf]), np.array([np.inf]))
    bounded, _ = minimum(_Line(value), np.array([1e200]), np.array([True]), bounds, tolerance=1e-8, steps=20)
    assert np.isfinite([*unknowns, *bounded]).all()


def test_measurements_without_any_residual_are_fitted_without_a_warning():
    times = np.linspace(0, 1, 9)
    law = cl.fit("x' = a; x(0) = b", cl.Trials.from_arrays(times, 1 + 2 * times, names=["x"]))
    assert law.params["estimate"].tolist() == pytest.approx([2.0, 1.0])


def test_the_logarithm_of_a_concentration_that_is_zero_before_a_dose_gives_no_warning(recwarn):
    times = np.array([0.0, 1.0, 2.0, 4.0, 7.0, 10.0])
    measured = np.log(100 / 8 * np.exp(-0.2 * times)) + 0.01 * np.cos(5 * times)
    dose = {"ID": 1, "TIME": times, "AMT": 100.0 * (times == 0), "LNDV": np.where(times > 0, measured, np.nan)}
    frame = pd.DataFrame(dose | {"EVID": 1 * (times == 0)})
    law = cl.fit("C' = -k C + AMT/V; LNDV = log(C)", cl.Trials.from_frame(frame))
    estimated = dict(zip(law.params["parameter"], law.params["estimate"], strict=True))
    assert estimated == pytest.approx({"k": 0.2, "V": 8.0}, rel=0.02)
    forecast = law.predict(cl.Trials.from_frame(frame), return_std=True)
    assert not forecast.outcomes
    assert forecast.score() > 0.99
    assert np.isfinite(forecast.to_frame()["LNDV forecast"]).all()
    assert not [note for note in forecast.trials.notes if "inf" in note]
    assert not [warning for warning in recwarn if issubclass(warning.category, RuntimeWarning)]
