"""Parameters and noise of all objects, of groups and of trials, held against one fit of all samples by SciPy."""

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize
from scipy.stats import norm, t as student

import commonlaw as cl
from commonlaw.estimation import likelihood_profile
from commonlaw.law import average_law
from commonlaw.law.parameters import named_parameters
from tests.refusals import refused
from tests.simulations import simulated
from tests.unit.decays import T, by_trial, estimates, least, own_and_shared, trials_of

pytestmark = pytest.mark.usefixtures("few_starts")


def test_what_groups_no_trials_is_refused_with_what_does():
    trials = trials_of(own_and_shared()).with_properties({name: {"kind": "s"} for name in "ABC"})
    with refused("group-unknown", by="day", known=("all", "object", "trial", "kind")):
        cl.fit("x' = -k x; y = x + b", trials, shared={"k": "day"})


def test_parameters_are_shared_by_all_objects_or_by_those_of_a_property():
    samples = own_and_shared()
    trials = trials_of(samples)
    law = cl.fit("x' = -k x; y = x + b; x(0) = a", trials, shared=["a", "b"])
    whole = np.concatenate([y for _, y in samples.values()])

    def residuals(p):
        return np.concatenate([p[3] * np.exp(-k * T) + p[4] for k in p[:3]]) - whole

    found = least(residuals, [0.5, 0.5, 0.5, 1, 1])
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


def by_trial_expected(trials, groups):
    """Return least squares of rates by group, a common factor, and an offset by object, with standard errors."""

    def residuals(p):
        own = (p[group] * -T for group in groups)
        curves = [p[-3] * np.exp(each) + p[-2 + (t.object == "B")] for each, t in zip(own, trials, strict=True)]
        return np.concatenate(curves) - np.concatenate([trial.states[:, 0] for trial in trials])

    first = [*np.full(len(set(groups)), 0.7), 1.5, 0.7, 0.7]
    found = least(residuals, first)
    free = len(found.fun) - len(found.x)
    return found.x, np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / free


def test_parameters_may_differ_between_trials_of_an_object(tmp_path):
    trials = by_trial(21)
    law = cl.fit("x' = -k x; y = x + b; x(0) = a", trials, shared={"k": "trial", "a": "all"})
    x, covariance = by_trial_expected(trials, range(6))
    found = {(each.object, each.trial): (each.value, each.error) for each in law.trial_estimates}
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
    found = [each.value for each in law.trial_estimates]
    assert found == pytest.approx([x[0], x[1], x[0], x[0], x[1], x[0]], rel=1e-5)
    assert estimates(law, "A")["k"][0] == pytest.approx((2 * x[0] + x[1]) / 3, rel=1e-5)
    drifting = [cl.Trial(t.object, t.name, t.times, t.states, t.times[:, None]) for t in trials]
    with refused("group-varies-in-trial", column="T"):
        cl.fit("x' = -k x; y = x + b", cl.Trials(tuple(drifting), trials.schema), shared={"k": "T"})


@pytest.mark.parametrize("apart", [1e-6, pytest.param(1e-10, marks=pytest.mark.slow), 1e-11])
def test_shared_parameters_that_are_nearly_collinear_are_fitted_unless_their_errors_exceed_any_value(apart):
    text, trials = f"x' = -k x; y = c x + d (x + {apart} t) + b; x(0) = 2", trials_of(own_and_shared())
    if apart < 1e-6:
        with refused("parameters-not-identified", names=["c", "d"]):
            cl.fit(text, trials, shared=["b", "c", "d"])
        return
    own = estimates(cl.fit(text, trials, shared=["b", "c", "d"]), "A")
    assert own["c"][0] + own["d"][0] == pytest.approx(1.0, abs=0.2)
    assert own["c"][1] > 0.1 / apart * 1e-3


def test_the_profile_of_a_shared_parameter_is_that_of_all_objects():
    samples = own_and_shared()
    trials = trials_of(samples)
    law = cl.fit("x' = -k x; y = x + b; x(0) = a; a > 0", trials, shared=["a", "b"], noise={"y": 0.05})
    profile = likelihood_profile(law, trials, "b", "A")
    whole = np.concatenate([y for _, y in samples.values()])

    def squares(b):
        def residuals(p):
            return (np.concatenate([p[3] * np.exp(-k * T) + b for k in p[:3]]) - whole) / 0.05

        return 2 * least(residuals, [0.5, 0.5, 0.5, 2]).cost

    expected = np.array([squares(b) for b in profile.values])
    assert profile.deviance == pytest.approx(expected - expected.min(), abs=1e-3)
    assert profile.error == pytest.approx(estimates(law, "A")["b"][1], rel=1e-3)
    own = cl.fit("x' = -k x; y = x + b; x(0) = a", by_trial(24), shared={"k": "trial", "a": "all"})
    with refused("profile-by-trial"):
        likelihood_profile(own, by_trial(24), "k", "A")


def test_a_profile_without_known_noise_takes_that_of_the_residuals():
    y = 2 * np.exp(-0.5 * T) + 0.05 * np.random.default_rng(0).standard_normal(len(T))
    profile = likelihood_profile(cl.Law.from_text("y' = -k y", {"k": {"A": 0.4}}), trials_of({"A": (T, y)}, ["y"]), "k")
    curves = np.exp(-np.outer(profile.values, T))
    squares = y @ y - (curves @ y) ** 2 / np.sum(curves**2, axis=1)
    least_squares = minimize(lambda k: y @ y - (np.exp(-k * T) @ y) ** 2 / np.sum(np.exp(-2 * k * T)), [0.5]).fun
    assert profile.deviance == pytest.approx((squares / least_squares - 1) * (len(T) - 2), abs=1e-3)


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
    noise = law.uncertainty.noise_of["y"]
    assert noise["B"] == noise["C"]
    decay = np.exp(-best.x[0] * t)
    slopes = np.column_stack([-best.x[1] * t * decay, decay])
    squares = {name: np.sum((y - best.x[1] * decay) ** 2) for name, (_, y) in samples.items()}
    fine, coarse = squares["A"], squares["B"] + squares["C"]

    def restricted(logs):
        weights = np.exp(-2 * logs[0]) + 2 * np.exp(-2 * logs[1])
        likelihood = fine * np.exp(-2 * logs[0]) + coarse * np.exp(-2 * logs[1]) + 2 * len(t) * (logs[0] + 2 * logs[1])
        return likelihood + np.linalg.slogdet(weights * slopes.T @ slopes)[1]

    levels = np.exp(minimize(restricted, best.x[2:], options={"gtol": 1e-8}).x)
    assert [noise["A"], noise["B"]] == pytest.approx(levels, rel=1e-5)
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert again.uncertainty.noise_of == law.uncertainty.noise_of
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


@pytest.mark.slow
def test_noise_by_the_name_of_no_property_is_refused():
    with refused("noise-not-a-property", name="y", given="day"):
        cl.fit("y' = -k y; y(0) = a", decays_of_labs(1), noise={"y": "day"})


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
        share = np.hypot(law.uncertainty.noise_of["y"][trial.object], std / curve.states)
        reach = student.ppf(0.975, law.uncertainty.degrees_of_freedom[0])
        assert np.log(high / low) == pytest.approx(2 * reach * share, rel=1e-6)
    standardized = np.concatenate(law.residuals(new).standardized)
    assert np.std(standardized) == pytest.approx(1.0, abs=0.15)


def test_updates_weigh_each_laboratory_by_its_relative_noise():
    """The logarithm of y is a straight line, so that the posterior is that of linear regression."""
    law = cl.fit("y' = -k y; y(0) = a", decays_of_labs(1), noise={"y": "lab"}, log_states=["y"])
    new = decays_of_labs(2)
    updated, log_likelihood = law.update(new), 0.0
    for name in "AB":
        own, noise = estimates(law, name), law.uncertainty.noise_of["y"][name]
        prior = law.cov_params(name).loc[["k", "a"], ["k", "a"]].to_numpy()
        rows, target = [np.linalg.inv(np.linalg.cholesky(prior))], []
        target.append(rows[0] @ [own["k"][0], own["a"][0]])

        def residuals(p, name=name, rows=rows, target=target, noise=noise):
            measured = np.concatenate([trial.states[:, 0] for trial in new.of_object(name)])
            return np.append((np.log(p[1]) - np.tile(p[0] * T, 2) - np.log(measured)) / noise, rows[0] @ p - target[0])

        best = least_squares(residuals, [0.6, 8.0], x_scale="jac", xtol=1e-14, ftol=1e-14)
        found = estimates(updated, name)
        assert [found["k"][0], found["a"][0]] == pytest.approx(best.x, rel=1e-6)
        log_likelihood += float(np.sum(norm.logpdf(best.fun[:-2]) - np.log(noise)))
    assert updated.provenance.log_likelihood == pytest.approx(log_likelihood, rel=1e-6)
    low, high = likelihood_profile(law, decays_of_labs(1), "k", "B").interval
    assert high - low == pytest.approx(2 * 1.96 * estimates(law, "B")["k"][1], rel=0.05)


def test_shooting_begins_where_collocation_ended():
    def rates(_, x, k):
        return [x[0] * (1 - 0.1 * x[1]), x[1] * (0.075 * x[0] - k)]

    trials = simulated(rates, {"a": (1.5,), "b": (1.5,)}, [(10, 5)], np.linspace(0, 12, 40), 0.02, ("x", "y"))
    steps = list[str]()
    equations = "x' = a x - b x y; y' = d x y - c y"
    law = cl.fit(equations, trials, shared=dict.fromkeys("abcd", "all"), progress=steps.append)
    assert not any("start 2" in step for step in steps)
    values, errors = law.params["estimate"][:4], law.params["standard error"][:4]
    assert np.abs(values - [1, 0.1, 0.075, 1.5]).max() < 4 * errors.max()


def test_a_parameter_in_a_quotient_is_shared():
    numbers = {"A": (0.8, 100.0), "B": (0.5, 100.0)}
    trials = simulated(lambda _, x, r, k: [r * x[0] * (1 - x[0] / k)], numbers, [(5,)], np.linspace(0, 12, 25), 0.02)
    law = cl.fit("s' = r s (1 - s/K)", trials, shared="K")
    values = law.params.pivot(index="object", columns="parameter", values="estimate")
    assert values["K"]["A"] == pytest.approx(values["K"]["B"], rel=1e-12)
    assert values["K"]["A"] == pytest.approx(100, rel=0.02)
    assert values["r"].tolist() == pytest.approx([0.8, 0.5], rel=0.05)
