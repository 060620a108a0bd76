"""Laws in discrete time are found from the next samples."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.discovery.hints import outcomes_of_generations
from commonlaw.law import to_latex
from tests.refusals import refused


def mapped(growth, start, samples):
    """Return states of x[k + 1] = growth x[k] (1 - x[k])."""
    states = [start]
    while len(states) < samples:
        states.append(growth * states[-1] * (1 - states[-1]))
    return np.array(states)


@pytest.fixture
def populations():
    trials = [
        cl.Trial(name, run, np.arange(41.0), mapped(growth, start, 41))
        for name, growth in (("fast", 3.9), ("slow", 2.6), ("even", 3.3))
        for run, start in (("1", 0.2), ("2", 0.55))
    ]
    return cl.Trials(tuple(trials), cl.Schema(("x",), time="k"))


def test_a_law_in_discrete_time(populations, tmp_path):
    law = cl.discover(
        populations, order=0, library="poly:3", method=cl.DiscreteTimeRegression(solver="group-stlsq:0.5")
    )
    assert law.structure == ("x[k+1] = a x + b x^2",)
    assert law.equations("fast") == ("x[k+1] = 3.9 x - 3.9 x^2",)
    assert to_latex(law, "slow") == "\\begin{aligned}\nx_{k+1} &= 2.6\\, x - 2.6\\, x^{2}\n\\end{aligned}"
    law.save(tmp_path / "law.json")
    assert cl.Law.load(tmp_path / "law.json").equations("even") == law.equations("even")


def test_a_law_in_discrete_time_refuses_uneven_steps(populations):
    trial = populations[0]
    times = trial.times.copy()
    times[20:] += 0.5
    uneven = populations.with_trials([cl.Trial(trial.object, trial.name, times, trial.states)])
    with refused("discrete-uneven", sample="20", next_sample="21", step=1.5, median=1.0, where="fast, trial 1"):
        cl.discover(uneven, order=0, method=cl.DiscreteTimeRegression(solver="stlsq:0.5"), library="poly:3")


def test_a_law_in_discrete_time_refuses_trials_of_one_sample():
    trials = cl.Trials.from_arrays([np.zeros(1)] * 2, [np.ones(1), 2 * np.ones(1)], object="a", names=["x"])
    with refused("discrete-one-sample", where="a"):
        cl.discover(trials, order=0, library="poly:2", method=cl.DiscreteTimeRegression(solver="forward:2"))


def test_the_next_sample_of_a_chaotic_map_is_forecast_though_the_tenth_is_not():
    noisy = mapped(3.9, 0.3, 300) + 0.005 * np.random.default_rng(0).standard_normal(300)
    trials = cl.Trials.from_arrays([np.arange(300.0)], [noisy], names=["x"])
    verdict = cl.fit("x[k+1] = a x (1 - x)", trials).assess(trials)
    assert 1 <= verdict.horizon < 30
    assert "even the nearest" not in str(verdict)


GENERATIONS = np.arange(60.0)


def generations(growth, noise, times=GENERATIONS):
    """Return the sizes of two populations, measured with noise."""
    generator = np.random.default_rng(2)
    measured = [mapped(growth, start, 60) + noise * generator.standard_normal(60) for start in (0.3, 0.4)]
    trials = cl.Trials.from_arrays([times] * 2, measured, object=["a", "b"], names=["x"])
    return cl.Trials(trials.trials, cl.Schema(("x",), time="generation"))


def hints(trials, **settings):
    law = cl.discover(trials, cache=False, **settings)
    return [diagnostic for diagnostic in law.diagnostics if diagnostic.code == "discrete-time-plausible"]


def test_a_law_in_continuous_time_that_leaves_what_the_generation_before_explains_hints_at_discrete_time():
    (hint,) = hints(generations(3.9, 0.01))
    assert hint.where == "x'"
    assert hint.kind == "discrete time"
    assert "`order=0`" in hint.remedy


@pytest.mark.parametrize(
    ("trials", "settings"),
    [
        (generations(3.9, 0.01), {"order": 1}),
        (generations(3.9, 0.01), {"order": 0}),
        (generations(3.9, 0.01, times=0.5 * GENERATIONS), {}),
        (generations(3.9, 0.01, times=np.where(GENERATIONS < 30, GENERATIONS, GENERATIONS + 1)), {}),
        (generations(1.1, 0.002), {}),
        (generations(1.0, 0.05), {}),
    ],
    ids=["order 1", "order 0", "half numbers", "a generation is missing", "resolved growth", "noise alone"],
)
def test_nothing_else_hints_at_discrete_time(trials, settings):
    assert not hints(trials, **settings)


def test_a_law_in_continuous_time_that_explains_its_samples_hints_at_no_other():
    """An oscillation of 2.6 samples a cycle, which samples do not resolve."""
    law, other = (cl.Law.from_text(text, {"a": 5.8}) for text in ("x'' = -a x", "x' = -a x"))
    states = law.simulate(GENERATIONS, [1.0, 0.0])["object"].states[:, :1]
    trials = cl.Trials((cl.Trial("object", "1", GENERATIONS, states),), cl.Schema(("x",)))
    assert outcomes_of_generations(law, trials) == ()
    (hint,) = outcomes_of_generations(other, trials)
    assert (hint.code, hint.where) == ("discrete-time-plausible", "x'")
