"""Noise that differs between trials: by each trial's own residuals, with one prior of the scatter."""

import numpy as np
import pytest
from scipy import optimize

import commonlaw as cl
from commonlaw.formulation import law_variables
from commonlaw.inference.fit.lack_of_fit import with_heteroscedastic_noise
from commonlaw.inference.fit.problem import prepare
from commonlaw.law.parameters import named_parameters
from commonlaw.library import PolynomialLibrary
from commonlaw.likelihood import groupings
from tests.refusals import refused
from tests.streams import ROLES, write_files

TIMES = np.linspace(0, 5, 40)
RATES, STARTS = {"a": 0.3, "b": 0.5, "c": 0.8}, (10.0, 6.0)
NOISE = {("a", "0"): 0.02, ("a", "1"): 0.4, ("b", "0"): 0.1, ("b", "1"): 0.02, ("c", "0"): 0.3, ("c", "1"): 0.05}
EQUATION = "x' = -k x"
SCHEMES = ("collocation", "shooting")


def decays(noise=NOISE, seed=0):
    random, trials = np.random.default_rng(seed), list[cl.Trial]()
    for (name, trial), level in noise.items():
        curve = STARTS[int(trial)] * np.exp(-RATES[name] * TIMES)
        states = curve + level * random.standard_normal(len(TIMES))
        trials.append(cl.Trial(name, trial, TIMES, states[:, np.newaxis]))
    return cl.Trials(tuple(trials), cl.Schema(("x",)))


def levels(law, trials):
    errors = law.uncertainty.error_model
    return [float(errors.noise_of_trial(trial, law.uncertainty.noise)[0]) for trial in trials]


def by_scipy(trials):
    """Return the noise of each trial, and the rate of each object with its standard error.

    Least squares weighted by the noise of trials alternate with the noise of largest posterior probability, of which
    each trial uses up half of the degrees of freedom of its object's three parameters.
    """
    noise = dict.fromkeys(NOISE, 0.1)
    for _ in range(30):
        rates, sums = dict[str, tuple[float, float]](), list[float]()
        for name in trials.objects:
            group = trials.of_object(name)
            x = np.concatenate([trial.states[:, 0] for trial in group])
            std = np.repeat([noise[trial.object, trial.name] for trial in group], len(TIMES))

            def curves(_, k, *starts, group=group):
                return np.concatenate([h * np.exp(-k * trial.times) for h, trial in zip(starts, group, strict=True)])

            first = (0.5, *STARTS)
            point, covariance = optimize.curve_fit(curves, 0.0, x, first, std, True, xtol=1e-13, ftol=1e-13)
            rates[name] = float(point[0]), float(np.sqrt(covariance[0, 0]))
            sums += [float(np.sum(part**2)) for part in np.split(x - curves(0.0, *point), 2)]
        squares, freedom = np.array(sums), len(TIMES) - 1.5

        def deviance(logs, squares=squares, freedom=freedom):
            about = np.sum((logs - np.mean(logs)) ** 2)
            return np.sum(2 * freedom * logs + squares * np.exp(-2 * logs)) + len(logs) * np.log1p(about)

        logs = optimize.minimize(deviance, np.log(squares / freedom) / 2, options={"gtol": 1e-10}).x
        noise = dict(zip(NOISE, np.exp(logs), strict=True))
    return [*noise.values()], np.array([*rates.values()])


@pytest.mark.parametrize("scheme", SCHEMES)
def test_noise_and_estimates_are_those_of_weighted_least_squares(scheme):
    trials = decays()
    noise, rates = by_scipy(trials)
    for kind in ("auto", "by-trial"):
        law = cl.fit(EQUATION, trials, errors=kind, scheme=scheme)
        assert law.uncertainty.error_model.kind == "by-trial"
        assert levels(law, trials) == pytest.approx(noise, rel=0.02)  # Degrees of freedom are shared by trials
        parameters = named_parameters(law)
        assert parameters.values[:, 0] == pytest.approx(rates[:, 0], abs=0.05 * rates[:, 1].min())
        assert parameters.errors[:, 0] == pytest.approx(rates[:, 1], rel=0.02)


def test_both_schemes_have_one_score():
    trials = decays()
    laws = {scheme: cl.fit(EQUATION, trials, errors="by-trial", scheme=scheme) for scheme in SCHEMES}
    frame = cl.compare(laws, trials)
    assert {*frame["errors"]} == {"noise by trial"}
    assert frame["2 log B"].to_numpy() == pytest.approx(0.0, abs=0.05)


def test_an_object_has_the_root_mean_square_of_its_trials():
    trials = decays()
    law = cl.fit(EQUATION, trials)
    of_trials = np.array(levels(law, trials)).reshape(3, 2)
    noise = [float(law.uncertainty.error_model.noise_of(name, law.uncertainty.noise)[0]) for name in law.objects]
    assert noise == pytest.approx(np.sqrt(np.mean(of_trials**2, axis=1)))
    assert law.uncertainty.noise == pytest.approx(np.sqrt(np.mean(of_trials**2)))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_verb_takes_the_noise_of_each_trial(scheme):
    trials = decays()
    law = cl.fit(EQUATION, trials, scheme=scheme)
    assert cl.law.from_json(cl.law.to_json(law)) == law
    assert "noise by trial" in [step.stage for step in law.history]
    noise = levels(law, trials)
    assert levels(cl.refine(law, trials), trials) == pytest.approx(noise, rel=1e-3)
    codes = [outcome.code for outcome in cl.refine(law, trials, errors="white").diagnostics]
    assert codes == ["residuals-under-white-noise"]
    assert all(np.std(part) == pytest.approx(1.0, abs=0.3) for part in law.residuals(trials).standardized)
    for std, level in zip(law.predict(trials, start="all", return_std=True).measurement_std(), noise, strict=True):
        assert std == pytest.approx(level, rel=1e-6)
    assert "noise by trial: a, trial 0" in law.report(trials).html
    assert "noise that differs between trials, from 0.016 (a, trial 0) to 0.43 (a, trial 1) in x" in str(law)
    # Trials that come later have the noise of their object
    assert np.all(named_parameters(law.update(trials)).errors < named_parameters(law).errors)


def test_noise_of_objects_is_no_noise_of_trials():
    noise = {(name, trial): level for name, level in (("a", 0.02), ("b", 0.1), ("c", 0.5)) for trial in "01"}
    for scheme in SCHEMES:
        law = cl.fit(EQUATION, decays(noise), scheme=scheme)
        assert law.uncertainty.error_model.kind == "by-object"
    assert cl.fit(EQUATION, decays(dict.fromkeys(NOISE, 0.1))).uncertainty.error_model.kind == "white"


def test_trials_of_one_object_have_noise_of_their_own():
    trials = decays().select(object="a")
    assert groupings(trials) == ("by-trial",)
    assert groupings(decays()) == ("by-object", "by-trial")
    assert groupings(decays().select(trial="0")) == ("by-object",)
    for scheme in SCHEMES:
        assert levels(cl.fit(EQUATION, trials, scheme=scheme), trials) == pytest.approx([0.02, 0.4], rel=0.25)


def test_differences_show_the_noise_of_each_trial_before_any_law():
    trials = decays()
    terms = PolynomialLibrary(1).bind(law_variables(trials.schema, 1))
    problem = prepare(trials, terms, np.full((3, 1, len(terms)), np.nan))
    done = with_heteroscedastic_noise(problem, ("white", "proportional", "by-object", "by-trial"))
    assert done.errors.kind == "by-trial"
    noise = [float(done.errors.noise_of_trial(trial, done.noise)[0]) for trial in done.in_order]
    assert noise == pytest.approx([*NOISE.values()], rel=0.35)
    for model, of_point in zip(done.models, done.trial_of_points, strict=True):
        std = np.concatenate([np.ravel(done.std_of(mesh)) for mesh in model.meshes])
        assert std == pytest.approx(np.array(noise)[of_point])


def test_a_stretch_of_a_long_trial_has_the_noise_of_its_trial():
    times = np.linspace(0, 5, 2500)
    random = np.random.default_rng(3)
    trials = [
        cl.Trial("a", str(i), times, (start * np.exp(-times) + level * random.standard_normal(2500))[:, np.newaxis])
        for i, (start, level) in enumerate(((10.0, 0.01), (6.0, 0.3)))
    ]
    whole = cl.Trials(tuple(trials), cl.Schema(("x",)))
    law = cl.fit(EQUATION, whole, scheme="collocation")
    assert levels(law, whole) == pytest.approx([0.01, 0.3], rel=0.05)


def test_files_have_the_noise_of_their_trials(tmp_path):
    trials = decays()
    stream = cl.TrialStream.from_parquet(write_files(trials, tmp_path, 3), **ROLES)
    law = cl.fit(EQUATION, stream, errors="by-trial", n_jobs=1)
    assert levels(law, trials) == pytest.approx([*NOISE.values()], rel=0.3)


def test_noise_that_is_given_is_not_estimated_by_trial():
    for scheme in SCHEMES:
        with refused("noise-by-group-given"):
            cl.fit(EQUATION, decays(), noise={"x": 0.1}, errors="by-trial", scheme=scheme)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
def test_intervals_hold_the_truth(scheme):
    held = list[bool]()
    for seed in range(100):
        parameters = named_parameters(cl.fit(EQUATION, decays(seed=seed), scheme=scheme))
        low, high = parameters.intervals()
        held += [bool(low[o, 0] <= rate <= high[o, 0]) for o, rate in enumerate(RATES.values())]
    assert 0.925 <= np.mean(held) <= 0.98
