"""Fits with observation equations, known initial values, shared parameters, bounds, priors, censored values.

Each is held against least squares or maximum likelihood by SciPy on the solution in closed form or by `solve_ivp`.
"""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares, lsq_linear, minimize
from scipy.stats import norm

import commonlaw as cl
from commonlaw.cli.main import commonlaw
from commonlaw.estimation import likelihood_profile
from commonlaw.estimation.search import Bounds, _polished
from commonlaw.inference import bounds
from commonlaw.law import average_law, from_json, to_json, to_latex
from commonlaw.law.parameters import named_parameters
from commonlaw.law.text import with_error
from tests.refusals import refused


def trials_of(samples, names=("y",), **schema):
    """Return trials of objects by name, each of times and values."""
    made = [cl.Trial(name, "1", t, np.asarray(y)) for name, (t, y) in samples.items()]
    return cl.Trials(tuple(made), cl.Schema(tuple(names), **schema))


def estimates(law, name=None):
    frame = law.params
    frame = frame if name is None else frame[frame["object"] == name]
    return {row["parameter"]: (row["estimate"], row["standard error"]) for _, row in frame.iterrows()}


def assert_least_squares(law, expected, residuals, **tolerances):
    """Compare a law with least squares of residuals of parameters in the order of a dictionary of guesses."""
    found = least_squares(residuals, list(expected.values()), method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    free = len(found.fun) - len(found.x)
    errors = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * 2 * found.cost / free)
    known = estimates(law)
    for name, value, error in zip(expected, found.x, errors, strict=True):
        if name in known:
            assert known[name][0] == pytest.approx(value, rel=1e-5)
            assert known[name][1] == pytest.approx(error, rel=tolerances.get("errors", 1e-2))


T = np.linspace(0, 6, 31)
RANDOM = np.random.default_rng(1)
CLEAN = 2.0 * np.exp(-0.6 * T) * (1 + np.exp(-0.6 * T)) + 0.3
SIGNAL, OTHER = (CLEAN + 0.01 * RANDOM.standard_normal(len(T)) for _ in range(2))


def test_a_measured_signal_is_a_function_of_the_state():
    trials = trials_of({"A": (T, SIGNAL)}, ["signal"])
    law = cl.fit("x' = -k x", trials, observe={"signal": "c x (1 + x) + b"}, initial_values={"x": 1})

    def residuals(p):
        x = np.exp(-p[0] * T)
        return p[1] * x * (1 + x) + p[2] - SIGNAL

    assert_least_squares(law, {"k": 0.5, "c": 1.0, "b": 0.0}, residuals)
    assert "signal = c x (1 + x) + b" in str(law)


def test_known_initial_values_of_a_measured_state():
    times = np.linspace(0.5, 6, 12)
    y = 5 * (1 - np.exp(-0.7 * times)) + 0.05 * np.random.default_rng(2).standard_normal(12)
    law = cl.fit("y' = k (B - y)", trials_of({"A": (times, y)}), initial_values={"y": 0}, initial_time=0)
    assert_least_squares(law, {"k": 1.0, "B": 4.0}, lambda p: p[1] * (1 - np.exp(-p[0] * times)) - y)


def test_initial_values_may_be_parameters_that_trials_share():
    samples, source = [], np.random.default_rng(3)
    for i in range(3):
        samples.append(cl.Trial("A", str(i), T, 2 * np.exp(-0.5 * T) + 0.05 * source.standard_normal(len(T))))
    trials = cl.Trials(tuple(samples), cl.Schema(("x",)))
    law = cl.fit("x' = -k x", trials, initial_values={"x": "x0"})
    whole = np.concatenate([sample.states[:, 0] for sample in samples])
    assert_least_squares(law, {"k": 1.0, "x0": 1.0}, lambda p: np.tile(p[1] * np.exp(-p[0] * T), 3) - whole)


def test_an_initial_value_with_a_standard_deviation_is_a_prior():
    y = 2 * np.exp(-0.5 * T) + 0.1 * np.random.default_rng(4).standard_normal(len(T))
    law = cl.fit("x' = -k x", trials_of({"A": (T, y)}, ["x"]), initial_values={"x": (2.2, 0.01)}, noise={"x": 0.1})

    def residuals(p):
        return np.append((p[1] * np.exp(-p[0] * T) - y) / 0.1, (p[1] - 2.2) / 0.01)

    found = least_squares(residuals, [1.0, 1.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    errors = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    assert estimates(law)["k"] == pytest.approx((found.x[0], errors[0]), rel=1e-4)
    (initial,) = law.observation.estimated
    assert (initial.value, initial.error) == pytest.approx((found.x[1], errors[1]), rel=1e-4)
    assert "x(0) = 2.2 ± 0.01" in str(law)
    assert f"{initial.value:.4f}" in law.summary()


def test_initial_values_by_object_are_those_of_each_trial_where_they_are_free():
    source = np.random.default_rng(11)
    samples = {("A", "1"): 2.0, ("B", "1"): 3.0, ("B", "2"): 5.0}
    made = [
        cl.Trial(*key, T, start * np.exp(-0.5 * T) + 0.02 * source.standard_normal(len(T)))
        for key, start in samples.items()
    ]
    trials = cl.Trials(tuple(made), cl.Schema(("x",)))
    law = cl.fit("x' = -k x", trials, initial_values={"x": {"A": 2, "B": None}}, shared="k")
    found = {(each.object, each.trial): each.value for each in law.observation.estimated}
    assert {each.name for each in law.observation.estimated} == {"x(0)"}
    assert found == pytest.approx({("B", "1"): 3.0, ("B", "2"): 5.0}, rel=0.02)
    assert law.params["parameter"].unique().tolist() == ["k"]
    assert law.predict(trials).to_frame()["x forecast"].iloc[0] == 2.0
    with refused("initial-value-not-finite", object="B"):
        cl.fit("x' = -k x", trials, initial_values={"x": {"A": 2}})


def own_and_shared():
    source = np.random.default_rng(5)
    return {
        name: (T, 2 * np.exp(-k * T) + 1.0 + 0.05 * source.standard_normal(len(T)))
        for name, k in {"A": 0.4, "B": 0.8, "C": 1.2}.items()
    }


def test_parameters_are_shared_by_all_objects_or_by_those_of_a_property():
    samples = own_and_shared()
    trials = trials_of(samples)
    law = cl.fit("x' = -k x; y = x + b; x(0) = a", trials, shared=["a", "b"])
    whole = np.concatenate([y for _, y in samples.values()])

    def residuals(p):
        return np.concatenate([p[3] * np.exp(-k * T) + p[4] for k in p[:3]]) - whole

    found = least_squares(residuals, [0.5, 0.5, 0.5, 1, 1], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    for i, name in enumerate(samples):
        own = estimates(law, name)
        assert [own[each][0] for each in "kab"] == pytest.approx([found.x[i], *found.x[3:]], rel=1e-6)
    # The mean over objects of what they share is no better known than it is
    errors = average_law(law).params.set_index("parameter")["standard error"]
    assert errors["b"] == pytest.approx(estimates(law, "A")["b"][1], rel=1e-6)

    grouped = cl.Trials(trials.trials, trials.schema, {"A": {"kind": "s"}, "B": {"kind": "t"}, "C": {"kind": "t"}})
    law = cl.fit("x' = -k x; y = x + b; x(0) = a", grouped, shared={"a": "kind"})
    own = [estimates(law, name)["a"][0] for name in "ABC"]
    assert own[1] == own[2] != own[0]


def by_trial(seed, rates=(0.4, 0.8, 1.2), **columns):
    """Return trials of two objects with these rates in each, a common factor of 2, and inputs by trial."""
    source, trials = np.random.default_rng(seed), []
    for owner, offset in {"A": 1.0, "B": 0.5}.items():
        for i, k in enumerate(rates):
            y = 2 * np.exp(-k * T) + offset + 0.05 * source.standard_normal(len(T))
            inputs = (
                np.tile([column[i] for column in columns.values()], (len(T), 1)) if columns else np.empty((len(T), 0))
            )
            trials.append(cl.Trial(owner, str(i), T, y[:, None], inputs))
    return cl.Trials(tuple(trials), cl.Schema(("y",), tuple(columns)))


def by_trial_expected(trials, groups):
    """Return least squares of rates by group, a common factor, and an offset by object, with standard errors."""

    def residuals(p):
        own = (p[group] * -T for group in groups)
        curves = [p[-3] * np.exp(each) + p[-2 + (t.object == "B")] for each, t in zip(own, trials, strict=True)]
        return np.concatenate(curves) - np.concatenate([trial.states[:, 0] for trial in trials])

    first = [*np.full(len(set(groups)), 0.7), 1.5, 0.7, 0.7]
    found = least_squares(residuals, first, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    free = len(found.fun) - len(found.x)
    return found.x, np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / free


def test_parameters_may_differ_between_trials_of_an_object(tmp_path):
    trials = by_trial(21)
    law = cl.fit("x' = -k x; y = x + b; x(0) = a", trials, shared={"k": "trial", "a": "all"})
    x, covariance = by_trial_expected(trials, range(6))
    found = {(each.object, each.trial): (each.value, each.error) for each in law.observation.estimated}
    expected = {(t.object, t.name): (x[i], np.sqrt(covariance[i, i])) for i, t in enumerate(trials)}
    assert found == {key: pytest.approx(each, rel=1e-4) for key, each in expected.items()}
    # An object has the mean of its trials
    error = np.sqrt(covariance[:3, :3].sum()) / 3
    assert estimates(law, "A")["k"] == pytest.approx((x[:3].mean(), error), rel=1e-4)
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert again.observation == law.observation
    # Each trial determines its rate anew, where the others are those of the law
    curves = again.predict(trials)
    for i, (trial, trajectory) in enumerate(zip(trials, curves.trajectories, strict=True)):
        expected = x[6] * np.exp(-x[i] * T) + x[7 + (trial.object == "B")]
        assert trajectory.states[:, 0] == pytest.approx(expected, abs=2e-3)


def test_bands_of_trials_with_parameters_of_their_own_are_those_of_the_joint_fit():
    trials = by_trial(22)
    law = cl.fit("x' = -k x; y = x + b; x(0) = a", trials, shared={"k": "trial", "a": "all"}, noise={"y": 0.05})
    later = law.predict(trials, from_time=2.0, return_std=True)
    early, p = T < 2, {name: estimates(law, "A")[name][0] for name in "ab"}
    for trial, std in zip(trials.of_object("A"), later.std[:3], strict=True):
        rows = early & np.isfinite(T)

        def curve(k, a, b, t=T):
            return a * np.exp(-k * t) + b

        k = least_squares(lambda q, y=trial.states[:, 0]: (curve(q[0], **p) - y)[early], [0.7]).x[0]
        by_k, by_a = -p["a"] * T * np.exp(-k * T), np.exp(-k * T)
        information = by_k[rows] @ by_k[rows] / 0.05**2
        gain = np.array([-(by_k[rows] @ by[rows]) / 0.05**2 / information for by in (by_a, np.ones_like(T))])
        named = named_parameters(law)
        at = [named.names.index(name) for name in "ab"]
        known = named.covariance[0][np.ix_(at, at)]
        slopes = np.column_stack([by_a, np.ones_like(T)]) + by_k[:, None] * gain
        expected = np.sqrt(np.einsum("ni,ij,nj->n", slopes, known, slopes) + by_k**2 / information)
        assert std[:, 0] == pytest.approx(expected, rel=1e-3)


def test_trials_with_one_value_of_an_input_may_share_a_parameter():
    trials = by_trial(23, (0.4, 0.8, 0.4), T=(20.0, 30.0, 20.0))
    law = cl.fit("x' = -k x; y = x + b; x(0) = a", trials, shared={"k": "T", "a": "all"})
    x, _ = by_trial_expected(trials, [0, 1, 0, 0, 1, 0])
    found = [each.value for each in law.observation.estimated]
    assert found == pytest.approx([x[0], x[1], x[0], x[0], x[1], x[0]], rel=1e-5)
    assert estimates(law, "A")["k"][0] == pytest.approx((2 * x[0] + x[1]) / 3, rel=1e-5)
    drifting = [cl.Trial(t.object, t.name, t.times, t.states, t.times[:, None]) for t in trials]
    with refused("group-varies-in-trial", column="T"):
        cl.fit("x' = -k x; y = x + b", cl.Trials(tuple(drifting), trials.schema), shared={"k": "T"})


def test_a_parameter_at_its_bound_is_reported_with_a_one_sided_interval():
    y = 2 * np.exp(-0.5 * T) + 0.05 * np.random.default_rng(6).standard_normal(len(T))
    law = cl.fit("x' = -k x + q; q > 0.2; x(0) = a", trials_of({"A": (T, y)}, ["x"]))
    assert estimates(law)["q"][0] == 0.2
    (note,) = [diagnostic for diagnostic in law.diagnostics if diagnostic.code == "estimate-at-bound"]
    assert "0.2" in note.text

    def residuals(p):
        return 0.2 / p[0] + (p[1] - 0.2 / p[0]) * np.exp(-p[0] * T) - y

    found = least_squares(residuals, [0.5, 2.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert [estimates(law)[each][0] for each in "ka"] == pytest.approx(found.x, rel=1e-6)


@pytest.mark.parametrize("ends", [(0.2, 0.21), (-np.inf, -0.5), (-5e-4, 5e-4), (-3.0, -2.0)])
def test_a_parameter_keeps_to_narrow_bounds(ends):
    y = np.exp(-T) + 0.05 * np.random.default_rng(6).standard_normal(len(T))
    found = least_squares(lambda p: np.exp(-p[0] * T) - y, [1.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    error = np.sqrt(2 * found.cost / (len(T) - 1) / (found.jac.T @ found.jac)[0, 0])
    low, high = found.x[0] + np.array(ends)
    bound = f"k < {high}" if np.isinf(low) else f"{low} < k < {high}"
    law = cl.fit(f"x' = -k x; x(0) = 1; {bound}", trials_of({"A": (T, y)}, ["x"]))
    notes = [diagnostic.text for diagnostic in law.diagnostics if diagnostic.code == "estimate-at-bound"]
    if low < found.x[0] < high:
        assert estimates(law)["k"] == (pytest.approx(found.x[0], rel=1e-7), pytest.approx(error, rel=1e-4))
        assert not notes
    else:
        assert estimates(law)["k"] == (low if low > found.x[0] else high, 0)
        assert with_error(found.x[0], error) in notes[0]


@pytest.mark.parametrize("seed", [245, 838, 2275])
def test_parameters_that_logarithms_drive_to_zero_come_back(seed):
    source = np.random.default_rng(seed)
    size = 3 if seed % 2 else 4
    matrix, target = source.normal(size=(size + 1, size)).round(1), (3 * source.normal(size=size + 1)).round(1)
    start, near = source.uniform(0, 3, size), source.random(size) < 0.5
    start = np.where(near, np.where(source.random(size) < 0.5, 1e-4, 3 - 1e-4), start)

    class Linear:
        def residuals(self, unknowns, noise, slopes=True):
            return matrix @ unknowns - target, matrix

    found = _polished(Linear(), start, np.ones(1), Bounds(np.zeros(size), np.full(size, 3.0)))
    assert found == pytest.approx(lsq_linear(matrix, target, (0, 3), tol=1e-14, method="bvls").x, abs=1e-6)


def test_a_law_with_a_parameter_at_a_bound_of_zero_is_printed():
    y = np.exp(-T) + 0.01 * np.random.default_rng(6).standard_normal(len(T))
    law = cl.fit("x' = -k x - q x^2; x(0) = 1; q >= 0; k < 3", trials_of({"A": (T, y * np.exp(-0.1 * T**2))}, ["x"]))
    assert estimates(law)["q"][0] == 0
    assert "q = 0" in str(law)


@pytest.mark.slow
def test_bounds_in_which_no_solution_is_finite_are_refused():
    with refused("no-finite-start"):
        cl.fit("s' = -V s/(K + s); s(0) = 5; -5 < K < -4.9", trials_of({"A": (T, 5 * np.exp(-T))}, ["s"]))


@pytest.mark.parametrize("apart", [1e-6, 1e-9, 1e-10, 1e-11])
def test_shared_parameters_that_are_nearly_collinear_are_fitted(apart):
    samples = own_and_shared()
    text = f"x' = -k x; y = c x + d (x + {apart} t) + b; x(0) = 2"
    law = cl.fit(text, trials_of(samples), shared=["b", "c", "d"])
    own = estimates(law, "A")
    assert own["c"][0] + own["d"][0] == pytest.approx(1.0, abs=0.2)
    assert own["c"][1] > 0.1 / apart * 1e-3


@pytest.mark.parametrize(
    "text",
    [
        "a' = -k a u + m b; b' = k a u - m b; a(0) = steady; b(0) = steady",  # Any of one sum
        "a' = -k a u; a(0) = steady",  # Any value
        "a' = r + k u; a(0) = steady",  # None
    ],
)
def test_steady_states_that_are_none_or_many_are_refused(text):
    inputs = np.where(T > 1, 1.0, 0.0)[:, None]
    trial = cl.Trial("A", "1", T, np.exp(-0.5 * np.maximum(T - 1, 0))[:, None], inputs)
    trials = cl.Trials((trial,), cl.Schema(("a",), ("u",)))
    with refused("no-steady-state"):
        cl.fit(text, trials)


def test_priors_of_parameters_steer():
    y = 2 * np.exp(-0.5 * T) + 0.1 * np.random.default_rng(7).standard_normal(len(T))
    trials = trials_of({"A": (T, y)}, ["x"])
    law = cl.fit("x' = -k x", trials, initial_values={"x": "a"}, priors={"k": (0.7, 0.005)}, noise={"x": 0.1})

    def residuals(p):
        return np.append((p[1] * np.exp(-p[0] * T) - y) / 0.1, (p[0] - 0.7) / 0.005)

    found = least_squares(residuals, [1.0, 1.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert [estimates(law)[each][0] for each in "ka"] == pytest.approx(found.x, rel=1e-5)


def test_values_below_a_limit_count_by_the_likelihood_of_the_tail():
    source = np.random.default_rng(8)
    times = np.linspace(0, 8, 25)
    whole = 3 * np.exp(-0.5 * times) + 0.15 * source.standard_normal(25)
    below = np.where(whole < 0.4, 0.4, np.nan)[:, None]
    values = np.where(whole < 0.4, np.nan, whole)[:, None]
    trials = cl.Trials((cl.Trial("A", "1", times, values, below=below),), cl.Schema(("x",)))
    law = cl.fit("x' = -k x", trials, initial_values={"x": "a"})

    def deviance(p):
        curve, std = p[1] * np.exp(-p[0] * times), np.exp(p[2])
        seen = np.isfinite(values[:, 0])
        return -norm.logpdf(values[seen, 0], curve[seen], std).sum() - norm.logcdf((0.4 - curve[~seen]) / std).sum()

    found = minimize(
        deviance, [0.5, 3, -2], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12, "maxiter": 5000}
    )
    assert [estimates(law)[each][0] for each in "ka"] == pytest.approx(found.x[:2], rel=1e-4)
    assert -law.observation.log_likelihood == pytest.approx(found.fun, abs=1e-5)

    # The curvature of all of the likelihood, at the noise that is reported
    def curved(p):
        return deviance([*p[:2], p[2]])

    point, steps = np.array([*found.x[:2], np.log(law.observation.noise["x"])]), np.diag([1e-4, 1e-4, 1e-4])
    hessian = np.array(
        [
            [
                (curved(point + a + b) - curved(point + a - b) - curved(point - a + b) + curved(point - a - b)) / 4e-8
                for b in steps
            ]
            for a in steps
        ]
    )
    errors = np.sqrt(np.diag(np.linalg.inv(hessian)))[:2]
    assert [estimates(law)[each][1] for each in "ka"] == pytest.approx(errors, rel=0.05)


@pytest.mark.parametrize("between", ["held", "linear"])
def test_a_dead_time_of_an_input_is_estimated(between):
    times = np.arange(0.0, 600.0, 10.0)
    u = 20.0 * (times >= 50) - 10.0 * (times >= 300)
    knots = times if between == "held" else None

    def curve(gain, tau, delay, first):
        def inputs(t):
            t = t - delay
            if knots is None:
                return np.interp(t, times, u)
            return u[max(int(np.searchsorted(times, t, side="right")) - 1, 0)]

        def rate(t, x):
            return (gain * inputs(t) - x) / tau

        return solve_ivp(rate, (0, 600), [first], "LSODA", times, rtol=1e-9, atol=1e-9, max_step=2).y[0]

    y = curve(0.62, 80.0, 18.0, 0.5) + 0.05 * np.random.default_rng(9).standard_normal(len(times))
    trial = cl.Trial("A", "1", times, y, u)
    trials = cl.Trials((trial,), cl.Schema(("x",), ("u",)))
    law = cl.fit("x' = (g u(t - d) - x)/s", trials, input_interpolation=between)
    known = estimates(law)
    for name, truth in {"g": 0.62, "s": 80.0, "d": 18.0}.items():
        value, error = known[name]
        assert abs(value - truth) < 4 * error < 0.05 * truth
    notes = [diagnostic.code for diagnostic in cl.fit("x' = (g u(t - d) - x)/s", trials).diagnostics]
    assert notes == ["delay-by-interpolation"]


def test_objects_of_one_property_share_their_noise(tmp_path):
    t, random = np.linspace(0, 6, 25), np.random.default_rng(11)
    labs = {"A": ("fine", 0.01), "B": ("coarse", 0.1), "C": ("coarse", 0.1)}
    samples = {name: (t, 2 * np.exp(-0.6 * t) + s * random.standard_normal(len(t))) for name, (_, s) in labs.items()}
    trials = trials_of(samples).with_properties({name: {"lab": lab} for name, (lab, _) in labs.items()})
    law = cl.fit("y' = -k y; y(0) = a", trials, shared=["k", "a"], noise={"y": "lab"})

    def negative(p):
        k, a, *logs = p
        total = 0.0
        for name, (lab, _) in labs.items():
            z = (samples[name][1] - a * np.exp(-k * t)) / np.exp(logs[lab == "coarse"])
            total += 0.5 * z @ z + len(t) * logs[lab == "coarse"]
        return total

    best = minimize(negative, [0.5, 1.8, -4, -2], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12})
    best = minimize(negative, best.x, method="BFGS", options={"gtol": 1e-7})
    assert estimates(law, "A")["k"][0] == pytest.approx(best.x[0], rel=1e-5)
    noise = law.observation.noise_of["y"]
    assert noise["B"] == noise["C"]
    assert [noise["A"], noise["B"]] == pytest.approx(np.exp(best.x[2:]), rel=0.03)  # Unbiased
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert again.observation.noise_of == law.observation.noise_of
    forecast = again.predict(trials, return_std=True)
    assert [np.median(trial.noise) for trial in forecast.trials] == pytest.approx([noise[name] for name in labs])


def decays_of_labs(seed):
    """Return log-normal decays of two laboratories with noise of 5 % and 20 %."""
    random, made, labs = np.random.default_rng(seed), [], {"A": ("fine", 0.05), "B": ("coarse", 0.2)}
    for name, (_, share) in labs.items():
        for i in range(2):
            y = 8 * np.exp(-0.6 * T + share * random.standard_normal(len(T)))
            made.append(cl.Trial(name, str(i), T, y))
    return cl.Trials(tuple(made), cl.Schema(("y",)), {name: {"lab": lab} for name, (lab, _) in labs.items()})


def test_bands_of_log_scaled_quantities_have_the_relative_noise_of_their_laboratory():
    """At known parameters they are ``y exp(±1.96 s)``; of the fits they hold 95 % of new measurements of each."""
    inside = {"A": [], "B": []}
    for seed in range(10):
        trials, new = decays_of_labs(seed), decays_of_labs(seed + 100)
        law = cl.fit("y' = -k y; y(0) = a", trials, shared=["k", "a"], noise={"y": "lab"}, log_states=["y"])
        forecast = law.predict(new, return_std=True)
        for trial, (low, high) in zip(forecast.trials, forecast.bands(measured=True), strict=True):
            inside[trial.object] += ((low < trial.states) & (trial.states < high)).ravel().tolist()
    assert [np.mean(own) for own in inside.values()] == pytest.approx([0.95, 0.95], abs=0.04)
    curves = forecast.smooth(50)
    for trial, curve, (low, high), std in zip(
        curves.trials, curves.trajectories, curves.bands(measured=True), curves.std, strict=True
    ):
        share = np.hypot(law.observation.noise_of["y"][trial.object], std / curve.states)
        assert np.log(high / low) == pytest.approx(2 * norm.ppf(0.975) * share, rel=1e-6)
    standardized = np.concatenate(law.residuals(new).standardized)
    assert np.std(standardized) == pytest.approx(1.0, abs=0.15)


def test_updates_weigh_each_laboratory_by_its_relative_noise():
    """The logarithm of y is a straight line, so that the posterior is that of linear regression."""
    law = cl.fit("y' = -k y; y(0) = a", decays_of_labs(1), noise={"y": "lab"}, log_states=["y"])
    new = decays_of_labs(2)
    updated = law.update(new)
    for name in "AB":
        own, noise = estimates(law, name), law.observation.noise_of["y"][name]
        prior = law.cov_params(name).loc[["k", "a"], ["k", "a"]].to_numpy()
        rows, target = [np.linalg.inv(np.linalg.cholesky(prior))], []
        target.append(rows[0] @ [own["k"][0], own["a"][0]])

        def residuals(p, name=name, rows=rows, target=target, noise=noise):
            measured = np.concatenate([trial.states[:, 0] for trial in new.of_object(name)])
            return np.append((np.log(p[1]) - np.tile(p[0] * T, 2) - np.log(measured)) / noise, rows[0] @ p - target[0])

        best = least_squares(residuals, [0.6, 8.0], x_scale="jac", xtol=1e-14, ftol=1e-14)
        found = estimates(updated, name)
        assert [found["k"][0], found["a"][0]] == pytest.approx(best.x, rel=1e-6)
    low, high = likelihood_profile(law, decays_of_labs(1), "k", "B").interval
    assert high - low == pytest.approx(2 * 1.96 * estimates(law, "B")["k"][1], rel=0.05)


def test_the_time_of_a_switch_is_estimated():
    t, random = np.linspace(0, 20, 60), np.random.default_rng(1)

    def solution(k, a, begins):
        return 2 * np.exp(-k * t) + a / k * (1 - np.exp(-k * np.maximum(t - begins, 0)))

    measured = solution(0.5, 1.0, 6.3) + 0.02 * random.standard_normal(len(t))
    law = cl.fit("x' = -k x + a (t > t0); x(0) = 2", trials_of({"A": (t, measured)}, ["x"]))
    assert_least_squares(law, {"k": 0.45, "a": 0.9, "t0": 6.2}, lambda p: solution(*p) - measured)
    assert law.structure == ("x' = -k x + a step(t - t0)",)


def test_rates_may_switch_with_the_state():
    t, random = np.linspace(0, 8, 60), np.random.default_rng(3)

    def solution(k, slow, limit):
        turns = np.log(2 / limit) / k
        return np.where(t < turns, 2 * np.exp(-k * t), limit * np.exp(-slow * (t - turns)))

    measured = solution(0.9, 0.1, 0.7) + 0.01 * random.standard_normal(len(t))
    law = cl.fit("x' = where(x > c, -k x, -s x); x(0) = 2", trials_of({"A": (t, measured)}, ["x"]))
    assert_least_squares(law, {"k": 0.8, "s": 0.12, "c": 0.75}, lambda p: solution(*p) - measured)


def test_trials_may_begin_in_the_steady_state_under_other_inputs():
    t, random = np.linspace(0, 10, 40), np.random.default_rng(5)
    level = {"1": 1.0, "2": 3.0}
    noise = {name: 0.01 * random.standard_normal(len(t)) for name in level}

    def solution(k, a, u):
        return (a + u) / k - u / k * np.exp(-k * t)

    made = tuple(
        cl.Trial("A", name, t, (solution(0.5, 1.5, u) + noise[name])[:, None], np.full((len(t), 1), u))
        for name, u in level.items()
    )
    law = cl.fit("x' = a + u - k x; x(0) = steady(u = 0)", cl.Trials(made, cl.Schema(("x",), ("u",))))

    def residuals(p):
        k, a = p
        return np.concatenate([solution(k, a, u) - solution(0.5, 1.5, u) - noise[name] for name, u in level.items()])

    assert_least_squares(law, {"k": 0.45, "a": 1.4}, residuals)
    assert "x(0) = steady(u = 0)" in str(law)


def test_states_may_be_measured_once_and_in_some_conditions_only():
    def samples(times, a, b):
        return np.column_stack([a * np.exp(-0.3 * times), b + a * (1 - np.exp(-0.3 * times))])

    times = np.array([0.0, 1.0, 2.0, 4.0, 8.0])
    one = samples(times, 3.0, 0.0)
    one[1:, 0] = np.nan
    other = samples(times, 1.0, 2.0)
    other[:, 1] = np.nan
    trials = cl.Trials((cl.Trial("A", "1", times, one), cl.Trial("B", "1", times, other)), cl.Schema(("x", "y")))
    starts = {"y": {"A": 0, "B": 2}, "x": None}
    law = cl.fit("x' = -k x; y' = k x", trials, shared="k", initial_values=starts, noise={"x": 0.1, "y": 0.1})
    assert [estimates(law, name)["k"][0] for name in "AB"] == pytest.approx([0.3, 0.3], rel=1e-6)


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


def heated(noise, seed):
    """Return a trial of x' = (0.6 u - x)/80 with held inputs, exactly but for the noise."""
    times, x = np.arange(0.0, 600.0, 10.0), [0.0]
    u = 20.0 * (times >= 50) - 10.0 * (times >= 300)
    for each in u[:-1]:
        x.append(0.6 * each + (x[-1] - 0.6 * each) * np.exp(-10 / 80))
    y = np.array(x) + noise * np.random.default_rng(seed).standard_normal(len(times))
    return cl.Trials((cl.Trial("A", "1", times, y, u),), cl.Schema(("x",), ("u",)))


@pytest.mark.parametrize("noise", [{"x": 0.05}, None])
def test_later_inputs_drive_forecasts(noise):
    trials = heated(0.05, 13)
    y = trials[0].states[:, 0]
    law = cl.fit("x' = (g u - x)/s", trials, priors={"g": (0.6, 0.3)}, input_interpolation="held", noise=noise)
    later = law.predict(trials, from_time=250.0, return_std=True)
    assert np.abs(later.to_frame()["x error"]).max() < 0.2
    low, high = later.bands(measured=True)[0]
    assert 0.85 < np.mean((low[26:, 0] < y[26:]) & (y[26:] < high[26:, 0])) <= 1
    straight = law.predict(trials, from_time=250.0, input_interpolation="linear").to_frame()
    assert np.abs(straight["x error"]).max() > 2 * np.abs(later.to_frame()["x error"]).max()


def test_the_interpolation_of_inputs_is_the_one_that_fits():
    law = cl.fit("x' = (g u - x)/s", heated(0.01, 15), priors={"g": (0.6, 0.3)})
    assert law.observation.measured.input_interpolation == "held"
    assert next(each for each in law.history if each.stage == "inputs").choice == "held"


def test_known_noise_and_repeated_measurements_have_their_likelihood():
    times = np.repeat([0.0, 1.0, 2.0, 4.0], 3)
    y = 2 * np.exp(-0.5 * times) + 0.1 * np.random.default_rng(14).standard_normal(12)
    law = cl.fit("x' = -k x; x(0) = a", trials_of({"A": (times, y)}, ["x"]), noise={"x": 0.1})
    k, a = (estimates(law)[each][0] for each in "ka")
    expected = norm.logpdf(y, a * np.exp(-k * times), 0.1).sum()
    assert law.observation.log_likelihood == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "settings"),
    [
        ("x' = -k x; y = c x + b; x(0) = 1; b > 0.2", {"shared": ["c"], "priors": {"k": (0.5, 0.1)}}),
        ("x' = -k x; y = c x + b", {"initial_values": {"x": (1.0, 0.05)}, "shared": {"b": "trial", "c": "all"}}),
        ("x' = -k x; y = c x; x(0) = x0", {"priors": {"c": (2.0, 0.1)}, "noise": {"y": "lab"}, "log_states": ["y"]}),
        ("x' = k u(t - d) - x; y = x + b; x(0) = 0", {"input_interpolation": "linear"}),
        ("x'' = -k x + a step(t - s); y = x + b; x(0) = 1", {}),
    ],
)
def test_a_law_is_refined_as_it_was_fitted(text, settings, tmp_path):
    source, made = np.random.default_rng(31), []
    for i, (owner, k) in enumerate({"A": 0.4, "B": 0.8}.items()):
        u = np.interp(T, [0, 1, 2, 9], [0, 0, 2, 2])
        for name in "12":
            y = 2 * np.exp(-k * T) + 0.1 + 0.02 * source.standard_normal(len(T))
            if "'' " in text:
                y = (
                    np.cos(0.7 * T)
                    + 0.2 * (1 - np.cos(0.7 * np.maximum(T - 3, 0)))
                    + 0.02 * source.standard_normal(len(T))
                )
            if "u(t" in text:
                y = 0.3 * np.maximum(T - 2.5, 0) / (1 + i) + 0.02 * source.standard_normal(len(T))
            made.append(cl.Trial(owner, name, T, y[:, None], u[:, None] if "u(t" in text else np.empty((len(T), 0))))
    trials = cl.Trials(tuple(made), cl.Schema(("y",), ("u",) if "u(t" in text else ()))
    trials = trials.with_properties({"A": {"lab": "one"}, "B": {"lab": "two"}})
    law = cl.fit(text, trials, **settings)
    law.save(tmp_path / "law.json")
    again = cl.refine(cl.Law.load(tmp_path / "law.json"), trials)
    assert again.observation.log_likelihood == pytest.approx(law.observation.log_likelihood, rel=1e-8, abs=1e-6)
    assert again.params["estimate"].to_numpy() == pytest.approx(law.params["estimate"].to_numpy(), rel=1e-4)
    assert again.params["standard error"].to_numpy() == pytest.approx(law.params["standard error"].to_numpy(), rel=1e-2)
    assert again.observation.restrictions == law.observation.restrictions
    assert np.isfinite(again.predict(trials).to_frame()["y forecast"]).all()
    # Of other trials, as a fit of them alone
    fewer = trials.select(object="B")
    assert cl.refine(law, fewer).observation.log_likelihood == pytest.approx(
        cl.fit(text, fewer, **settings).observation.log_likelihood, abs=1e-4
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
    assert frame.loc[list(laws), "2 log B"].to_numpy() == pytest.approx(expected, abs=1e-4)
    assert frame.loc[list(laws), "coefficients"].tolist() == [3, 2, 1, 2]
    assert frame.index[0] == "shared"
    assert frame["probability"].sum() == pytest.approx(1)
    with refused("laws-of-other-states"):
        cl.compare([laws["plain"], cl.Law.from_text("x' = -k x", {"k": 1}), laws["slow"]], trials)
    with refused("not-with-observation"):
        cl.compare(laws, trials, errors="random-walk")


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
    (initial,) = updated.observation.estimated
    assert (initial.trial, initial.name) == ("2", "x(0)")
    assert initial.value == pytest.approx(whole.observation.estimated[2].value, rel=1e-3)


def test_the_profile_of_a_shared_parameter_is_that_of_all_objects():
    samples = own_and_shared()
    trials = trials_of(samples)
    law = cl.fit("x' = -k x; y = x + b; x(0) = a; a > 0", trials, shared=["a", "b"], noise={"y": 0.05})
    profile = likelihood_profile(law, trials, "b", "A")
    whole = np.concatenate([y for _, y in samples.values()])

    def squares(b):
        def residuals(p):
            return (np.concatenate([p[3] * np.exp(-k * T) + b for k in p[:3]]) - whole) / 0.05

        return 2 * least_squares(residuals, [0.5, 0.5, 0.5, 2], xtol=1e-15, ftol=1e-15, gtol=1e-15).cost

    expected = np.array([squares(b) for b in profile.values])
    assert profile.deviance == pytest.approx(expected - expected.min(), abs=1e-3)
    assert profile.error == pytest.approx(estimates(law, "A")["b"][1], rel=1e-3)
    own = cl.fit("x' = -k x; y = x + b; x(0) = a", by_trial(24), shared={"k": "trial", "a": "all"})
    with refused("profile-by-trial"):
        likelihood_profile(own, by_trial(24), "k", "A")


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

    fit = least_squares(residuals, [0.4, 0.01, 0.8, 0.01, 1.2, 0.01, 2], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    errors = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    for bound, value, error in zip(found.bounds, fit.x[1:6:2], errors[1:6:2], strict=True):
        assert (bound.coefficient, bound.error) == pytest.approx((value, error), rel=1e-3)
        half = norm.ppf(0.975) * error
        assert (bound.low, bound.high) == pytest.approx((value - half, value + half), rel=1e-2)
        assert bound.effect == pytest.approx(4 * bound.at_most, rel=1e-6)


def test_evidence_with_priors_is_the_integral_of_the_likelihood():
    y = 2 * np.exp(-0.5 * T) + 0.03 * np.random.default_rng(33).standard_normal(len(T))
    trials = trials_of({"A": (T, y)})
    priors = [{"k": (0.6, 0.1), "c": (2.1, 0.2)}, {"k": (0.45, 0.02), "c": (2.0, 0.01)}]
    laws = [cl.fit("x' = -k x; y = c x; x(0) = 1", trials, priors=prior, noise={"y": 0.03}) for prior in priors]
    k, c = np.meshgrid(np.linspace(0.4, 0.6, 401), np.linspace(1.8, 2.2, 401))
    z = (c[..., None] * np.exp(-k[..., None] * T) - y) / 0.03

    def log_evidence(given):
        exponent = norm.logpdf(k, *given["k"]) + norm.logpdf(c, *given["c"]) - 0.5 * (z**2).sum(axis=-1)
        return exponent.max() + np.log(np.exp(exponent - exponent.max()).sum())

    expected = 2 * (log_evidence(priors[0]) - log_evidence(priors[1]))
    frame = cl.compare({"one": laws[0], "two": laws[1]}, trials, noise={"y": 0.03}).set_index("law")
    assert frame["2 log B"]["two"] - frame["2 log B"]["one"] == pytest.approx(expected, abs=0.01)


def test_the_command_line_compares_and_refines_laws_with_observation_equations(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trials_of({"A": (T, SIGNAL), "B": (T, OTHER)}, ["signal"]).to_frame().to_csv("cells.csv", index=False)
    shape = "x' = -k x; signal = c x (1 + x) + b; x(0) = 1"
    words = (
        ("fit", "cells.csv", shape, "--shared", "c", "--save", "law.json"),
        (
            "compare",
            "cells.csv",
            "law.json",
            "x' = -k x; signal = c x + b; x(0) = 1",
            "signal' = a - k signal",
            "--json",
        ),
        ("refine", "cells.csv", "law.json", "--save", "again.json"),
        ("fit", "cells.csv", "x' = -k x; signal = c x + b; x(0) = 1", "--against", "law.json"),
    )
    for word in words:
        done = CliRunner().invoke(commonlaw, word)
        assert done.exit_code == 0, done.output
        if word[0] == "compare":
            rows = json.loads(done.stdout)["laws"]
            assert rows[0]["law"] == "law.json"
            assert rows[1]["2 log B"] > 10
    one, other = (cl.Law.load(f"{name}.json").observation for name in ("law", "again"))
    assert one.log_likelihood == pytest.approx(other.log_likelihood, abs=1e-6)
    assert one.restrictions.shared == other.restrictions.shared == {"c": "all"}


def test_a_law_with_known_initial_values_may_be_known_physics():
    """Of ``y' = 1 - k y - 0.5 y^2`` the first is known by a law that was fitted from y(0) = 0."""
    first = trials_of({"A": (T, (1 - np.exp(-0.5 * T)) / 0.5)})
    known = cl.fit("y' = 1 - k y", first, initial_values={"y": 0})
    y = solve_ivp(lambda _, y: 1 - 0.5 * y - 0.5 * y**2, (0, 6), [0.0], t_eval=T, rtol=1e-9).y[0]
    trials = trials_of({"A": (T, y + 1e-3 * np.random.default_rng(0).standard_normal(len(T)))})
    law = cl.discover(trials, order=1, library="poly:2", known=known, cache=False)
    assert law.structure == ("y' = 1 - 0.5 y + a y^2",)
    assert estimates(law)["a"][0] == pytest.approx(-0.5, abs=4 * estimates(law)["a"][1])


def test_files_of_version_4_have_initial_values_by_state_and_no_restrictions():
    law = cl.fit(
        "x' = -k x; signal = c x + b; b > 0",
        trials_of({"A": (T, SIGNAL)}, ["signal"]),
        initial_values={"x": "a"},
        priors={"a": (1, 0.1)},
    )
    free = cl.fit("x' = -k x", trials_of({"A": (T, SIGNAL)}, ["x"]), priors={"k": (0.5, 0.2)})
    for each in (law, free):
        document = json.loads(to_json(each))
        del document["observation"]["restrictions"]
        estimated = document["observation"]["estimated"]
        document |= {"version": 4}
        for own in estimated:
            own["state"] = own.pop("name").removesuffix("(0)")
        old = from_json(json.dumps(document))
        assert old.observation.restrictions is None
        assert old.observation.estimated == each.observation.estimated
        assert np.array_equal(old.coefficients, each.coefficients)
        with refused("restrictions-not-recorded"):
            cl.refine(old, trials_of({"A": (T, SIGNAL)}, each.observation.measured.states))
    assert law.observation.restrictions.priors == {"a": (1, 0.1)}
    assert law.observation.restrictions.bounds == ("b > 0",)


@pytest.mark.parametrize(
    "change",
    [{"noise": {"signal": -1.0}}, {"noise": {"other": 1.0}}, {"sizes": {"x": 0.0}}, {"equations": {"other": "x"}}],
)
def test_files_with_observations_that_cannot_be_are_refused(change):
    law = cl.fit("x' = -k x; signal = c x; x(0) = 1", trials_of({"A": (T, SIGNAL)}, ["signal"]))
    document = json.loads(to_json(law))
    document["observation"] |= change
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


def test_the_rate_of_a_signal_that_is_zero_is_not_identifiable():
    law = cl.fit("x' = -k x; signal = x; x(0) = 1", trials_of({"A": (T, 0 * T)}, ["signal"]))
    assert "parameters-without-limits" in {outcome.code for outcome in law.diagnostics}


@pytest.mark.parametrize(
    ("code", "equations", "settings"),
    [
        ("measured-without-equation", "x' = -k x", {"initial_values": {"x": 1}, "priors": {"k": (1, 1)}}),
        ("parameters-not-identified", "x' = -k x; y = a b x; x(0) = 1", {}),
        ("observation-without-state", "x' = -k x; y = a + b z", {}),
        ("bound-empty", "x' = -k x; y = a x; k > 3; k < 2; x(0) = 1", {}),
        ("initial-value-of-variables", "x' = -k x; y = a x; x(0) = y0 + t", {}),
        ("condition-syntax", "y' = -k y if y > 1", {}),
        ("switch-arguments", "y' = -k max(y)", {}),
        ("steady-states-differ", "x' = -k x; y' = x - y; x(0) = steady(u = 1); y(0) = steady", {}),
        ("prior-not-positive", "x' = -k x; y = a x", {"priors": {"a": (1, 0)}}),
        ("not-with-observation", "x' = -k x; y = a x", {"errors": "random-walk"}),
        ("not-with-observation", "x' = -k x; y = a x", {"partial_pooling": True}),
        ("prior-not-positive", "y' = -k y", {"initial_values": {"y": (1.0, 0.0)}}),
        ("initial-value-not-finite", "y' = -k y", {"initial_values": {"y": np.inf}}),
        ("unknown-name", "x' = -k x; y = a x", {"shared": "q"}),
        ("unknown-name", "x' = -k x; z = a x; y = x", {}),
        ("observation-of-discrete-time", "x[k+1] = r x; y = a x", {}),
        ("noise-not-positive", "x' = -k x; y = a x", {"noise": {"y": -1.0}}),
        ("unknown-name", "x' = -k x; y = a x", {"noise": {"y": "lab"}}),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_words(code, equations, settings):
    with refused(code):
        cl.fit(equations, trials_of({"A": (T, np.exp(-T) + 0.01)}), **settings)


def test_cells_below_a_limit_are_read_and_count_in_fits(tmp_path, monkeypatch):
    source = np.random.default_rng(10)
    times = np.linspace(0, 8, 17)
    rows = ["patient,t,conc"]
    values = {}
    for name, k in {"a": 0.4, "b": 0.6}.items():
        y = 5 * np.exp(-k * times) + 0.1 * source.standard_normal(17)
        values[name] = y
        rows += [f"{name},{t},{'<0.5' if v < 0.5 else round(v, 6)}" for t, v in zip(times, y, strict=True)]
    (tmp_path / "levels.csv").write_text("\n".join(rows))
    trials = cl.Trials.read(tmp_path / "levels.csv")
    assert any("below a limit of quantification in conc" in note for note in trials.notes)
    law = cl.fit("conc' = -k conc", trials, initial_values={"conc": "c0"}, shared="c0")

    def deviance(p):
        total = 0.0
        for y, k in zip(values.values(), p[:2], strict=True):
            curve, std, under = p[2] * np.exp(-k * times), np.exp(p[3]), y < 0.5
            total -= norm.logpdf(y[~under].round(6), curve[~under], std).sum()
            total -= norm.logcdf((0.5 - curve[under]) / std).sum()
        return total

    found = minimize(
        deviance, [0.5, 0.5, 5, -2], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-11, "maxiter": 9999}
    )
    own = [estimates(law, "a")["k"][0], estimates(law, "b")["k"][0], estimates(law, "a")["c0"][0]]
    assert own == pytest.approx(found.x[:3], rel=1e-3)
    blq = (tmp_path / "levels.csv").read_text().replace("<0.5", "BLQ")
    (tmp_path / "marks.csv").write_text(blq)
    with refused("cell-censored"):
        cl.Trials.read(tmp_path / "marks.csv")
    marked = cl.Trials.read(tmp_path / "marks.csv", below={"BLQ": 0.5})
    assert np.array_equal(marked[0].below, trials[0].below, equal_nan=True)
    monkeypatch.chdir(tmp_path)
    refusal = CliRunner().invoke(commonlaw, ["fit", "marks.csv", "conc' = -k conc"])
    assert "below = {'BLQ' = 0.5} in the --schema file" in refusal.output
    for words in (
        ["data", "check", "marks.csv", "--below", "BLQ=0.5", "--save", "schema.toml"],
        ["fit", "marks.csv", "conc' = -k conc; conc(0) = c0", "--shared", "c0", "--schema", "schema.toml", "--json"],
    ):
        done = CliRunner().invoke(commonlaw, words)
        assert done.exit_code == 0, done.output
    assert str(estimates(law, "a")["k"][0])[:8] in done.output


def test_reports_and_figures_show_what_was_measured():
    law = cl.fit(
        "x' = -k x; signal = c x; x(0) = x0 + 1", trials_of({"A": (T, SIGNAL)}, ["signal"]), priors={"c": (4, 1)}
    )
    assert r"\mathrm{signal} &= c x" in to_latex(law)
    assert r"x(0) &= x_{0} + 1" in to_latex(law)
    assert law.params.set_index("parameter")["equation"].to_dict() == {"k": "x'", "c": "signal", "x0": "x(0)"}
    trials = trials_of({"A": (T, SIGNAL)}, ["signal"])
    assert "forecasts from the first" in law.report(trials).html.lower()
    assert "signal" in cl.plots.plot_law(law, trials).get_suptitle()


def test_the_command_line_takes_observation_equations(tmp_path):
    trials = trials_of({"A": (T, SIGNAL), "B": (T, OTHER)}, ["signal"])
    trials.to_frame().assign(other=1.0).to_csv(tmp_path / "cells.csv", index=False)
    table, law = str(tmp_path / "cells.csv"), str(tmp_path / "law.json")
    done = CliRunner().invoke(commonlaw, ["fit", table, "x' = -k x; signal = c x (1 + x) + b; x(0) = 1", "--save", law])
    assert done.exit_code == 0, done.output
    assert "signal = c x (1 + x) + b" in done.output
    done = CliRunner().invoke(commonlaw, ["predict", table, law, "--save", str(tmp_path / "forecast.csv")])
    assert done.exit_code == 0, done.output
    assert "signal forecast" in (tmp_path / "forecast.csv").read_text()


def test_the_command_line_shares_parameters_by_column(tmp_path):
    trials = by_trial(25, (0.4, 0.8, 0.4), T=(20.0, 30.0, 20.0))
    trials.to_frame().to_csv(tmp_path / "cells.csv", index=False)
    text, table, saved = "x' = -k x; y = x + b; x(0) = a", str(tmp_path / "cells.csv"), str(tmp_path / "law.json")
    words = ["fit", table, text, "--trial", "trial", "--shared", "a", "--shared", "k=T", "--save", saved]
    done = CliRunner().invoke(commonlaw, words)
    assert done.exit_code == 0, done.output
    law = cl.Law.load(saved)
    assert law.observation.restrictions.shared == {"a": "all", "k": "T"}
    assert len(law.observation.estimated) == 6


def test_the_command_line_takes_the_initial_value_of_a_measured_state(tmp_path):
    y = 5 * (1 - np.exp(-0.7 * T)) + 0.01 * RANDOM.standard_normal(len(T))
    trials_of({"A": (T, y)}).to_frame().to_csv(tmp_path / "tank.csv", index=False)
    given = ["fit", str(tmp_path / "tank.csv"), "y' = k (B - y)", "--initial-value", "y=0"]
    done = CliRunner().invoke(commonlaw, given)
    assert done.exit_code == 0, done.output
    assert "y(0) = 0.0" in done.output
