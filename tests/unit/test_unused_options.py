"""Options of forecasts and simulations: each is used, or refused by name."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.estimation.beginning import begin
from commonlaw.estimation.fitting import fit_model
from commonlaw.estimation.model import ModelText
from commonlaw.law import Law, Uncertainty
from tests.refusals import refused

TIMES = np.linspace(0.0, 4.0, 9)


def _trials(states, **names):
    return cl.Trials.from_arrays(TIMES, states, names=["x"], **names)


@pytest.fixture(scope="module")
def decay():
    """A law with an observation equation, and its trials."""
    trials = cl.Trials.from_arrays(TIMES, 2 * np.exp(-0.5 * TIMES) + 0.01 * np.cos(9 * TIMES), names=["y"])
    return cl.fit("x' = -k x; x(0) = 1; y = c x", trials), trials


@pytest.fixture(scope="module")
def reset():
    """A law with an event, which halves the state at 1.5, and its trials."""
    signal = np.where(TIMES <= 1.5, 1.0, 0.5) * np.exp(-0.5 * TIMES) + 0.002 * np.cos(9 * TIMES)
    return cl.fit("x' = -k x; t > 1.5: x = x/2; x(0) = 1", _trials(signal))


@pytest.fixture(scope="module")
def schemes():
    """Return measurements and laws of them without and with an observation equation, the latter by a vague prior."""
    states = 2 * np.exp(-0.5 * TIMES) + 0.05 * np.cos(9 * TIMES)
    trials = _trials(states).with_trials([*_trials(states), *_trials(1.1 * states, trial=["late"])])
    return trials, [cl.fit("x' = -k x", trials), cl.fit("x' = -k x", trials, priors={"k": (0.5, 100.0)})]


KINDS = {
    "first order": (Law.from_text("x' = -0.5 x"), _trials(np.exp(-0.5 * TIMES))),
    "second order": (Law.from_text("x'' = -x"), _trials(np.cos(TIMES))),
    "discrete time": (Law.from_text("x[k+1] = 0.8 x"), _trials(0.8 ** np.arange(9.0))),
}


@pytest.fixture(params=[*KINDS, "observation"])
def case(request, decay):
    return decay if request.param == "observation" else KINDS[request.param]


@pytest.mark.parametrize("option", [{"method": "nonsense"}, {"input_interpolation": "nonsense"}])
def test_forecasts_of_every_law_refuse_a_choice_that_is_not_offered(case, option):
    with refused("unknown-name"):
        case[0].predict(case[1], **option)


@pytest.mark.parametrize("tolerance", [-1, 0.0, 1.0, np.nan, "small"])
def test_every_law_refuses_a_tolerance_out_of_range(case, tolerance):
    with refused("tolerance-range"):
        case[0].predict(case[1], tolerance=tolerance)
    with refused("tolerance-range"):
        case[0].simulate(TIMES, np.ones(len(case[0].terms.variables.states)), tolerance=tolerance)


@pytest.mark.parametrize("seed", [-1, 0.5, "1"])
def test_forecasts_of_every_law_refuse_a_seed_that_is_no_whole_number(case, seed):
    with refused("whole-number", name="seed"):
        case[0].predict(case[1], seed=seed)


@pytest.mark.parametrize(
    ("kind", "option"),
    [
        ("observation", {"method": "scipy"}),
        ("observation", {"seed": 0}),
        ("observation", {"input_interpolation": "held"}),
        ("discrete time", {"method": "scipy"}),
        ("discrete time", {"seed": 3}),
        ("discrete time", {"input_interpolation": "held"}),
        ("first order", {"seed": 3}),
        ("second order", {"input_interpolation": "linear"}),
    ],
)
def test_an_option_without_effect_is_refused_by_name(decay, kind, option):
    law, trials = decay if kind == "observation" else KINDS[kind]
    ((name, value),) = option.items()
    with refused("option-without-effect", option=f"{name}={value!r}"):
        law.predict(trials, **option)


def test_simulations_refuse_options_without_effect(reset):
    for law in (reset, KINDS["discrete time"][0]):
        with refused("option-without-effect", option="method='scipy'"):
            law.simulate(TIMES, [1.0], method="scipy")
        with refused("unknown-name"):
            law.simulate(TIMES, [1.0], method="nonsense")
        with refused("option-without-effect", option="inputs=..."):
            law.simulate(TIMES, [1.0], inputs=2.0)


def test_the_tolerance_is_that_of_forecasts_with_observation_equations(decay):
    law, trials = decay
    exact, coarse = (law.predict(trials, tolerance=tolerance).trajectories[0].states for tolerance in (1e-11, 1e-2))
    difference = np.abs(exact - coarse).max()
    assert 1e-8 < difference < 0.05


def test_a_seed_changes_the_error_of_estimated_rates():
    law, trials = KINDS["second order"]
    uncertainty = Uncertainty(np.full((1, 1, 1), 1e-4), noise=np.array([0.01]))
    noisy = Law(law.terms, law.schema, law.order, law.objects, law.coefficients, uncertainty)
    stds = [noisy.predict(trials, start=1, return_std=True, seed=seed).std[0][-1, 0] for seed in (0, 1, 0)]
    assert stds[0] == stds[2]
    assert stds[0] == pytest.approx(noisy.predict(trials, start=1, return_std=True).std[0][-1, 0], rel=1e-12)


def test_an_average_over_one_law_is_the_law(decay):
    law, trials = decay
    states = [law.predict(trials, averaged=averaged).trajectories[0].states for averaged in (True, False)]
    np.testing.assert_array_equal(*states)


@pytest.mark.parametrize(
    ("options", "title"),
    [
        ({}, "forecast from the first sample"),
        ({"start": 4}, "forecast from the first 4 samples"),
        ({"start": "all"}, "fit"),
        ({"from_time": 2.0}, "forecast from t = 2"),
        ({"times": [4.5, 6.0]}, "forecast from the first sample"),
    ],
)
def test_forecasts_of_all_laws_begin_alike(schemes, options, title):
    trials, laws = schemes
    one, other = (law.predict(trials, return_std=True, **options) for law in laws)
    assert (one.title, other.title) == (title, title)
    for i in range(len(trials)):
        assert one.trajectories[i].states == pytest.approx(other.trajectories[i].states, abs=1e-5)
        assert one.std[i] == pytest.approx(other.std[i], rel=1e-4)


def test_standard_deviations_are_of_measured_quantities(schemes, decay):
    rates = np.full((1, 1, 1), 1e-4)
    law, trials = KINDS["second order"]
    noisy = Law(law.terms, law.schema, 2, law.objects, law.coefficients, Uncertainty(rates, noise=np.array([0.01])))
    for law, data in ((noisy, trials), (schemes[1][1], schemes[0]), decay):
        forecast = law.predict(data, return_std=True)
        assert [std.shape for std in forecast.std] == [trial.states.shape for trial in data]


def test_forecasts_of_all_laws_leave_out_trials_without_samples_around_a_time(schemes):
    trials, laws = schemes
    early = trials.with_trials([trials.trials[0], trials.trials[1].rows(slice(0, 4))])
    for law in laws:
        forecast = law.predict(early, from_time=3.0)
        assert [trial.name for trial in forecast.trials] == [trials.trials[0].name]
        assert len(forecast.trials.notes) == len(early.notes) + 1
        with refused("forecast-no-trial"):
            law.predict(early, from_time=9.0)
        with refused("argument-type", name="from_time"):
            law.predict(early, from_time="2")
        with refused("forecast-from-time"):
            law.predict(early, from_time=np.nan)
        with refused("forecast-times"):
            law.predict(early, times=[np.inf])
        with refused("uncertainty-unknown"):
            replace(law, uncertainty=Uncertainty()).predict(early, return_std=True)


def test_a_latent_start_takes_as_many_samples_as_it_needs():
    times = np.linspace(0, 6, 13)
    z, y = np.exp(-0.3 * times), 0.3 * (np.exp(-0.3 * times) - np.exp(-times)) / 0.7
    trials = cl.Trials.from_arrays(times, y + 0.0 * z, names=["y"])
    law = fit_model(
        begin(ModelText.of("z' = -a z; y' = a z - y"), trials, {"z": None}, priors={"a": (0.3, 0.001)}),
        0,
        lambda _: None,
        draws=1,
    ).law(())
    assert law.predict(trials).title == "forecast from the first 5 samples"
    later = trials.with_trials([replace(trials.trials[0], states=np.where(times < 4, y, np.nan)[:, np.newaxis])])
    assert law.predict(later).title == "fit"


@pytest.mark.parametrize("option", [{"start": 3}, {"from_time": 1.0}])
def test_a_law_that_gives_all_initial_values_takes_no_samples_for_them(decay, schemes, option):
    law, trials = decay
    with refused("option-without-effect", kind="a law that gives all initial values"):
        law.predict(trials, **option)
    assert law.predict(trials, start="all").is_fit
    measured, laws = schemes
    assert laws[1].predict(measured, **option).title != laws[1].predict(measured).title
    assert law.assess(trials).usable is not None


@pytest.mark.parametrize("from_time", [None, 1.2])
def test_forecasts_note_trials_with_fewer_samples_than_were_asked_for(schemes, from_time):
    measured, laws = schemes
    for law in laws:
        (note,) = law.predict(measured, start=40, from_time=from_time).trials.notes
        assert ("2 trials" in note, "`start=40`" in note) == (True, True)
        assert f"{9 if from_time is None else 3} samples" in note
        assert not law.predict(measured, start=3, from_time=from_time).trials.notes
