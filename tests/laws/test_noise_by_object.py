"""Noise that differs between objects: by each object's own residuals, with one prior of the scatter."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, optimize
from scipy.special import gammaln

import commonlaw as cl
from commonlaw.estimation.profile import likelihood_profile
from commonlaw.formulation import law_variables
from commonlaw.inference.fit.lack_of_fit import with_heteroscedastic_noise
from commonlaw.inference.fit.problem import prepare
from commonlaw.law.parameters import named_parameters
from commonlaw.library import PolynomialLibrary
from commonlaw.likelihood import ErrorModel, NoiseByGroup, cost_of_scatter
from tests.refusals import refused
from tests.streams import ROLES, write_files

TIMES = np.linspace(0, 5, 40)
RATES, NOISE = {"a": 0.3, "b": 0.5, "c": 0.8}, {"a": 0.02, "b": 0.1, "c": 0.5}
EQUATION = "x' = -k x"
SCHEMES = ("collocation", "shooting")


def decays(noise=NOISE, seed=0, scale=1.0, rates=RATES):
    """Return two trials of each of three objects with noise of its own; the sizes of the last are scaled."""
    random, trials = np.random.default_rng(seed), list[cl.Trial]()
    for name, rate in rates.items():
        for trial, start in enumerate((10.0, 6.0)):
            states = start * np.exp(-rate * TIMES) + noise[name] * random.standard_normal(len(TIMES))
            states = states * (scale if name == "c" else 1.0)
            trials.append(cl.Trial(name, str(trial), TIMES, states[:, np.newaxis]))
    return cl.Trials(tuple(trials), cl.Schema(("x",)))


def levels(law):
    return [float(law.uncertainty.error_model.noise_of(name, law.uncertainty.noise)[0]) for name in law.objects]


def by_scipy(trials):
    """Return the noise of each object, with its rate and the standard error of that.

    They are by least squares of each object, and by the largest product of restricted likelihoods and a prior.
    """
    squares, rates, errors = list[float](), list[float](), list[float]()
    for name in trials.objects:
        group = trials.of_object(name)
        x = np.concatenate([trial.states[:, 0] for trial in group])

        def curves(_, k, *starts, group=group):
            return np.concatenate([h * np.exp(-k * trial.times) for h, trial in zip(starts, group, strict=True)])

        point, covariance = optimize.curve_fit(curves, 0.0, x, (0.5, 9.0, 6.0), xtol=1e-13, ftol=1e-13)
        squares.append(float(np.sum((x - curves(0.0, *point)) ** 2)))
        rates.append(float(point[0]))
        errors.append(float(np.sqrt(covariance[0, 0] / squares[-1] * (len(x) - 3))))
    sums, freedom = np.array(squares), 2 * len(TIMES) - 3

    def deviance(logs):
        about = np.sum((logs - np.mean(logs)) ** 2)
        return np.sum(2 * freedom * logs + sums * np.exp(-2 * logs)) + len(logs) * np.log1p(about)

    logs = optimize.minimize(deviance, np.log(sums / freedom) / 2, options={"gtol": 1e-9}).x
    return np.exp(logs), np.array(rates), np.array(errors) * np.exp(logs)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_noise_and_estimates_are_those_of_weighted_least_squares(scheme):
    trials = decays()
    noise, rates, errors = by_scipy(trials)
    for kind in ("auto", "by-object"):
        law = cl.fit(EQUATION, trials, errors=kind, scheme=scheme)
        assert law.uncertainty.error_model.kind == "by-object"
        assert levels(law) == pytest.approx(noise, rel=1e-4)
        assert law.uncertainty.noise == pytest.approx(np.sqrt(np.mean(noise**2)), rel=1e-4)
        parameters = named_parameters(law)
        assert parameters.values[:, 0] == pytest.approx(rates, rel=1e-5)
        assert parameters.errors[:, 0] == pytest.approx(errors, rel=1e-3)


def test_both_schemes_have_one_score_and_likelihood_of_shared_parameters():
    trials = decays(rates=dict.fromkeys(RATES, 0.5))
    laws = [cl.fit(EQUATION, trials, errors="by-object", scheme=scheme, shared=["k"]) for scheme in SCHEMES]
    one, other = map(named_parameters, laws)
    assert one.values == pytest.approx(other.values, rel=1e-5)
    assert one.errors == pytest.approx(other.errors, rel=1e-3)
    assert levels(laws[0]) == pytest.approx(levels(laws[1]), rel=1e-3)
    apart = [cl.fit(EQUATION, trials, errors="by-object", scheme=scheme) for scheme in SCHEMES]
    frame = cl.compare({"one": apart[0], "other": apart[1]}, trials)
    assert {*frame["errors"]} == {"noise by object"}
    assert frame["2 log B"].to_numpy() == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_noise_that_does_not_differ_is_white(scheme):
    trials = decays(dict.fromkeys(RATES, 0.1))
    white, law = (cl.fit(EQUATION, trials, errors=kind, scheme=scheme) for kind in ("auto", "by-object"))
    assert law.uncertainty.error_model.kind == "white"
    assert law.uncertainty.noise == pytest.approx(white.uncertainty.noise, rel=1e-6)
    assert named_parameters(law).values == pytest.approx(named_parameters(white).values, rel=1e-6)


def test_noise_that_does_not_differ_is_seldom_taken_for_noise_by_object():
    kinds = [
        cl.fit(EQUATION, decays(dict.fromkeys(RATES, 0.1), seed)).uncertainty.error_model.kind for seed in range(20)
    ]
    assert kinds == ["white"] * 20


def test_the_cost_of_scatter_is_the_logarithm_of_an_integral():
    """Of the likelihood over the prior of logarithms of the noise of two objects, given their precise mean."""
    counts, squares = np.array([400.0, 600.0]), np.array([400.0, 600.0]) * np.array([1.0, 4.0])
    logs = np.log(squares / counts) / 2
    mean = float(counts @ logs / counts.sum())

    def deviance(of_both):
        return float(np.sum(2 * counts * of_both + squares * np.exp(-2 * of_both)))

    def density(contrast):
        # Where the weighted mean is held, in the coordinate of unit length
        both = mean + contrast * np.sqrt(2) * np.array([counts[1], -counts[0]]) / counts.sum()
        prior = np.exp(gammaln(1.0) - gammaln(0.5)) / np.sqrt(np.pi) / (1 + contrast**2)
        return np.exp(-(deviance(both) - deviance(logs)) / 2) * prior

    integral = integrate.quad(density, -3, 3, points=[(logs[0] - logs[1]) / np.sqrt(2)], limit=200)[0]
    assert cost_of_scatter(logs, counts) == pytest.approx(-2 * np.log(integral), abs=0.02)


def test_objects_without_degrees_of_freedom_have_the_noise_of_all():
    squares, freedom = np.array([[4.0], [400.0], [0.0]]), np.array([[40.0], [40.0], [0.0]])
    residuals = NoiseByGroup(squares, freedom, np.array([[44.0], [44.0], [4.0]]), np.zeros((3, 1)))
    assert residuals.evidence[0] > 50
    noise, factors = residuals.levels(residuals.evidence > 0)
    assert factors[2, 0] == 1.0
    assert (noise * factors[:2, 0]).tolist() == pytest.approx(np.sqrt([0.1, 10.0]), rel=0.02)
    assert noise[0] == pytest.approx(np.sqrt(np.mean((noise * factors[:2, 0]) ** 2)))


def test_a_quiet_object_is_at_least_as_noisy_as_its_values_are_rounded():
    residuals = NoiseByGroup(
        np.array([[0.0], [9.0]]), np.full((2, 1), 9.0), np.full((2, 1), 9.0), np.array([[0.1], [0.0]])
    )
    noise, factors = residuals.levels(np.array([True]))
    assert float(noise[0] * factors[0, 0]) == pytest.approx(0.1)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_verb_takes_the_noise_of_each_object(scheme):
    trials = decays()
    law = cl.fit(EQUATION, trials, errors="by-object", scheme=scheme)
    assert cl.law.from_json(cl.law.to_json(law)) == law
    assert "noise by object" in [step.stage for step in law.history]
    noise = dict(zip(law.objects, levels(law), strict=True))
    forecast = law.predict(trials, start="all", return_std=True)
    for trial, std, (low, high) in zip(trials, forecast.measurement_std(), forecast.bands(measured=True), strict=True):
        assert std == pytest.approx(noise[trial.object], rel=1e-6)
        assert np.median(high - low) / (2 * noise[trial.object]) == pytest.approx(2.0, rel=0.1)
    again = cl.refine(law, trials, errors="by-object")
    assert levels(again) == pytest.approx([*noise.values()], rel=1e-3)
    assert [outcome.code for outcome in cl.refine(law, trials, errors="white").diagnostics] == [
        "residuals-under-white-noise"
    ]
    residuals = law.residuals(trials).standardized
    assert all(np.std(part) == pytest.approx(1.0, abs=0.25) for part in residuals)
    updated = law.update(trials)
    assert named_parameters(updated).errors == pytest.approx(named_parameters(law).errors / np.sqrt(2), rel=0.02)
    assert levels(updated) == pytest.approx([*noise.values()])
    profile = likelihood_profile(law, trials, "k", "a")
    assert profile.error == pytest.approx(named_parameters(law).errors[0, 0], rel=1e-2)
    assert "noise by object" in law.report(trials).html
    assert cl.law.select_objects(law, ["c"]).predict(trials.select(object="c"), return_std=True).measurement_std()[
        0
    ] == pytest.approx(noise["c"])


def test_a_new_object_has_the_noise_of_all():
    law = cl.fit(EQUATION, decays(), errors="by-object", scheme="shooting")
    trials = decays().select(object="a")
    new = trials.with_trials([replace(trial, object="d") for trial in trials])
    std = law.predict(new, start="all", return_std=True).measurement_std()
    assert np.concatenate(std) == pytest.approx(law.uncertainty.noise[0])


def test_process_noise_is_in_proportion_to_the_noise():
    errors = ErrorModel(walk=np.array([1.0, 2.0, 3.0]), by_object={"a": np.array([10.0, 0.1])})
    assert errors.walk_of("a", np.array([1])).tolist() == pytest.approx([10.0, 0.2, 0.3])
    assert errors.walk_of("b", np.array([1])).tolist() == [1.0, 2.0, 3.0]


def test_files_of_one_object_each_have_noise_of_their_own(tmp_path):
    trials = decays()
    stream = cl.TrialStream.from_parquet(write_files(trials, tmp_path, 3), **ROLES)
    law = cl.fit(EQUATION, stream, errors="by-object", n_jobs=1)
    assert levels(law) == pytest.approx([*NOISE.values()], rel=0.3)
    assert not cl.fit(EQUATION, stream, n_jobs=1).uncertainty.error_model.by_object


def test_noise_that_is_given_is_not_estimated_by_object():
    for scheme in SCHEMES:
        with refused("noise-by-group-given"):
            cl.fit(EQUATION, decays(), noise={"x": 0.1}, errors="by-object", scheme=scheme)
    trials = decays()
    known = cl.Trials(
        tuple(replace(trial, noise=np.full((40, 1), 0.1)) for trial in trials),
        cl.Schema(("x",), noise_columns={"x": "sx"}),
    )
    for scheme in SCHEMES:
        with refused("noise-by-group-given"):
            cl.fit(EQUATION, known, errors="by-object", scheme=scheme)


def test_differences_show_the_noise_of_each_object_before_any_law():
    trials = decays(scale=1000.0)
    terms = PolynomialLibrary(1).bind(law_variables(trials.schema, 1))
    problem = prepare(trials, terms, np.full((3, 1, len(terms)), np.nan))
    done = with_heteroscedastic_noise(problem, ("white", "proportional", "by-object"))
    noise = [float(done.errors.noise_of(name, done.noise)[0]) for name in trials.objects]
    assert noise == pytest.approx([0.02, 0.1, 500.0], rel=0.3)
    for model, level in zip(done.models, noise, strict=True):
        assert model.unit[0] / problem.noise[0] == pytest.approx(level / done.noise[0])
        assert np.concatenate([np.ravel(done.std_of(mesh)) for mesh in model.meshes]) == pytest.approx(level)
    white = done.under_white_noise
    assert np.array([model.unit for model in white.models]) == pytest.approx(problem.models[0].unit[0])
    assert done.of_objects([0, 2]).scatters.all()


def test_quiet_objects_decide_on_terms_with_noisy_ones():
    """The square is seen in the first object alone, whose noise is a hundredth of that of the others."""
    random, trials = np.random.default_rng(1), list[cl.Trial]()
    for name, noise in (("a", 0.01), ("b", 1.0), ("c", 1.0)):
        for trial, start in enumerate((0.5, 2.0)):
            x = 10 / (1 + (10 / start - 1) * np.exp(-TIMES)) + noise * random.standard_normal(len(TIMES))
            trials.append(cl.Trial(name, str(trial), TIMES, x[:, np.newaxis]))
    law = cl.discover(cl.Trials(tuple(trials), cl.Schema(("x",))), order=1, library="poly:3")
    assert law.structure == ("x' = a x + b x^2",)
    assert levels(law) == pytest.approx([0.01, 1.0, 1.0], rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
def test_intervals_hold_the_truth(scheme):
    held = list[bool]()
    for seed in range(100):
        parameters = named_parameters(cl.fit(EQUATION, decays(seed=seed), scheme=scheme))
        low, high = parameters.intervals()
        held += [bool(low[o, 0] <= rate <= high[o, 0]) for o, rate in enumerate(RATES.values())]
    assert 0.925 <= np.mean(held) <= 0.98
