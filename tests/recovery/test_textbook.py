"""The law of textbooks nearest to a law, with known truth."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw.discovery import trajectory_likelihood
from commonlaw.discovery.textbook import outcomes_of_textbook, with_textbook_laws
from commonlaw.inference.result.assembly import reported
from commonlaw.inference.search.error_models import fit_each_kind
from tests.refusals import refused

COOLING = "T' = -k (T - a) - s T^4"


def cups(count, noise=0.2, seed=0, unit="degC", samples=25):
    """Return cups that cool by conduction and radiation, simulated by SciPy."""
    rng, times, rows = np.random.default_rng(seed), np.linspace(0, 20, samples), []
    for i in range(count):
        radiation = 2e-7 * (1 + 0.1 * i)

        def rate(_, temperature, s=radiation):
            return -0.05 * (temperature - 20) - s * temperature**4

        solved = solve_ivp(rate, (0, 20), [90.0 - 4 * i], t_eval=times, rtol=1e-9).y[0]
        rows += [(f"cup {i}", t, y) for t, y in zip(times, solved + noise * rng.standard_normal(samples), strict=True)]
    frame = pd.DataFrame(rows, columns=["object", "t", "T"])
    return cl.Trials.from_frame(frame, object="object", time="t", states=["T"], units={"T": unit} if unit else {})


@pytest.fixture(scope="module")
def cooled():
    trials = cups(3)
    law = cl.fit(COOLING, trials)
    return law, trials, law.textbook(trials)


def test_the_nearest_law_of_cups_that_radiate_is_that_of_newton(cooled):
    law, trials, nearest = cooled
    assert [model.name for model in nearest.models] == ["newton-cooling"]
    assert not nearest.is_chosen
    assert not nearest.as_good
    assert nearest.error_ratio > 1.5
    compared = cl.compare([law, cl.fit("T' = -k (T - a)", trials)], trials).set_index("law")["2 log B"]
    assert nearest.evidence == pytest.approx(compared["law 2"] - compared["law 1"], rel=0.02)


def test_evidence_against_it_grows_with_the_data(cooled):
    nearest = cooled[2]
    more = cups(6)
    assert cl.fit(COOLING, more).textbook(more).evidence > 1.5 * nearest.evidence


def test_what_it_leaves_is_the_slow_difference_of_the_curves(cooled):
    law, trials, nearest = cooled
    curves = [fitted.predict(trials, start="all").trajectories for fitted in (law, nearest.law)]
    apart = np.concatenate([one.states - other.states for one, other in zip(*curves, strict=True)])
    (left,) = nearest.unexplained
    assert left.slow
    assert left.unit == "degC"
    assert left.size == pytest.approx(np.sqrt(np.mean(apart**2)), rel=0.2)
    assert sum(left.shares) == pytest.approx(1)


def test_a_law_with_its_terms_and_signs_is_the_named_model():
    trials = cl.datasets.lotka_volterra().select(object="Pair 1", trial=1).until(5.0)
    law = cl.fit("x' = a x + b x y; y' = c y + d x y", trials)
    nearest = law.textbook(trials)
    assert [model.name for model in nearest.models] == ["lotka-volterra"]
    assert nearest.law is law
    assert nearest.evidence == 0
    assert nearest.error_ratio == 1
    assert outcomes_of_textbook(law, trials) == ()
    # The second state may be the prey
    swapped = cl.fit("y' = a y + b x y; x' = c x + d x y", renamed(trials, {"x": "y", "y": "x"}))
    (model,) = swapped.textbook(renamed(trials, {"x": "y", "y": "x"})).models
    assert model.without_bounds[0].startswith("y' = a y")


def renamed(trials, names):
    frame = trials.to_frame().rename(columns=names)
    return cl.Trials.from_frame(frame, object="object", trial="trial", time="t", states=[*names])


def test_an_epidemic_whose_rates_agree_is_sir():
    times = np.linspace(0, 25, 40)

    def rates(_, state):
        new = 1.0 * state[0] * state[1]
        return [-new, new - 0.3 * state[1]]

    solved = solve_ivp(rates, (0, 25), [0.99, 0.01], t_eval=times, rtol=1e-9).y.T
    noisy = solved + 0.002 * np.random.default_rng(0).standard_normal(solved.shape)
    trials = cl.Trials.from_arrays(times, noisy, names=["healthy", "ill"])
    law = cl.fit("healthy' = -a healthy ill; ill' = b healthy ill - c ill", trials)
    nearest = law.textbook(trials)
    assert [model.name for model in nearest.models] == ["sir"]
    assert nearest.models[0].without_bounds[0] == "healthy' = -b healthy ill"
    assert -10 < nearest.evidence < 0  # One parameter less
    assert not nearest.is_chosen
    assert nearest.has_same_terms
    assert "its relations between coefficients are more probable" in str(nearest)
    assert outcomes_of_textbook(law, trials) == ()  # Of the same terms


def test_a_law_of_textbooks_with_fewer_terms_is_marked_as_good():
    times = np.linspace(0, 12, 40)
    states = 2 / (1 + 19 * np.exp(-0.8 * times)) + 0.02 * np.random.default_rng(0).standard_normal(40)
    trials = cl.Trials.from_arrays(times, states[:, np.newaxis], names=["n"])
    law = cl.fit("n' = a n + b n^2 + c n^3", trials)
    nearest = law.textbook(trials)
    assert nearest.models[0].name == "logistic"
    assert nearest.as_good
    assert {parameter: nearest.law.params.set_index("parameter")["estimate"][parameter] for parameter in "rK"} == {
        "r": pytest.approx(0.8, rel=0.1),
        "K": pytest.approx(2.0, rel=0.05),
    }
    assert [outcome.code for outcome in outcomes_of_textbook(law, trials)] == ["textbook-law-as-good"]


def test_discover_marks_growth_that_may_be_logistic(tmp_path):
    times, rows, rng = np.linspace(0, 4, 9), [], np.random.default_rng(0)
    for i, (r, capacity, first) in enumerate([(0.5, 10, 2.0), (0.55, 9, 2.2), (0.45, 11, 1.8)]):
        sizes = capacity / (1 + (capacity / first - 1) * np.exp(-r * times)) + 0.25 * rng.standard_normal(9)
        rows += [(f"colony {i}", t, n) for t, n in zip(times, sizes, strict=True)]
    frame = pd.DataFrame(rows, columns=["object", "t", "n"])
    trials = cl.Trials.from_frame(frame, object="object", time="t", states=["n"])
    law = cl.discover(trials, order=1, library="poly:3", cache=False)
    law.save(tmp_path / "law.json")
    for known in (law, cl.Law.load(tmp_path / "law.json")):
        assert "textbook-law-as-good" in [outcome.code for outcome in known.diagnostics]
        assert known.textbook(trials).models[0].name == "logistic"
        assert known.textbook(trials).as_good


def test_units_and_names_of_columns_decide_which_models_are_meant():
    trials = cups(2, unit="")
    law = cl.fit("T' = a T^3", trials)
    assert law.textbook(trials).models[0].name == "newton-cooling"
    frame = trials.to_frame().rename(columns={"T": "temperature"})
    columns = {"object": "object", "trial": "trial", "time": "t", "states": ["temperature"]}
    unnamed, celsius = (cl.Trials.from_frame(frame, **columns, units=units) for units in ({}, {"temperature": "degC"}))
    cubic = "temperature' = a temperature^3"
    assert cl.fit(cubic, unnamed).textbook(unnamed).models[0].name == "logistic"
    # Which has an origin, as degrees Celsius have not
    assert cl.fit(cubic, celsius).textbook(celsius).models[0].name == "newton-cooling"


def test_a_law_with_parameters_inside_of_terms_is_a_named_model():
    times = np.linspace(0, 6, 30)
    solved = solve_ivp(lambda _, s: -s / (0.7 + s), (0, 6), [3.0], t_eval=times, rtol=1e-9).y.T
    noisy = solved + 0.01 * np.random.default_rng(0).standard_normal(solved.shape)
    trials = cl.Trials.from_arrays(times, noisy, names=["substrate"])
    law = cl.fit("substrate' = a substrate/(K + substrate)", trials)
    nearest = law.textbook(trials)
    assert [model.name for model in nearest.models] == ["michaelis-menten"]
    assert nearest.is_chosen
    assert "substrate" in nearest.models[0].variables


def test_laws_without_a_named_model_are_refused():
    times = np.linspace(0, 3, 20)
    states = np.exp(-np.outer(times, [0.5, 0.7, 0.9, 1.1])) + 0.01 * np.random.default_rng(0).standard_normal((20, 4))
    trials = cl.Trials.from_arrays(times, states, names=["p", "q", "r", "s"])
    law = cl.fit("p' = -a p; q' = -b q; r' = -c r; s' = -d s", trials)
    with refused("named-model-none"):
        law.textbook(trials)
    with refused("named-model-beyond"):
        cl.fit("; ".join(f"{name}[k+1] = {name}1 {name}" for name in "pqrs"), trials).textbook(trials)


def test_the_figure_has_a_panel_for_each_law_and_state(cooled):
    figure = cl.plots.plot_textbook(cooled[2])
    assert [panel.get_title(loc="left") for panel in figure.axes[:2]] == ["chosen law", "Newton's law of cooling"]
    residuals = [np.concatenate([line.get_ydata() for line in panel.lines[1:]]) for panel in figure.axes[:2]]
    assert residuals[1].std() > residuals[0].std()


@pytest.mark.parametrize(("wrong", "better"), [(["v", "v^2"], True), (["x", "v", "x^3"], False)])
def test_a_named_model_that_is_more_probable_comes_first_in_a_pool(wrong, better):
    times, random, pools = np.linspace(0, 12, 60), np.random.default_rng(4), []
    states = [start * np.exp(-0.1 * times) * np.cos(2 * times) for start in (1.0, 0.7)]
    if not better:  # A spring that hardens
        rates = [lambda _, y: [y[1], -4 * y[0] - 0.2 * y[1] - 2 * y[0] ** 3]]
        states = [solve_ivp(rates[0], (0, 12), [start, 0], t_eval=times, rtol=1e-9).y[0] for start in (1.0, 0.7)]
    states = [values + 0.02 * random.standard_normal(60) for values in states]

    def recorded(pool):
        pools.append(pool)
        return reported(pool)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory_likelihood, "reported", recorded)
        cl.discover(cl.Trials.from_arrays([times] * 2, states, names=["x"]), order=2, library="poly:3", cache=False)
    (pool,) = pools
    problem = pool.best.problem
    names = [*problem.terms.names]
    (chosen,) = fit_each_kind(problem, np.isin([names], wrong), ("white",))
    best = with_textbook_laws(replace(pool, fits=(chosen,))).best
    assert [name for name, inside in zip(names, best.supports[0], strict=True) if inside] == (
        ["x", "v"] if better else wrong
    )


def test_a_column_with_the_usual_name_of_a_rate_is_a_state_of_named_models():
    times, random = np.linspace(0, 6, 60), np.random.default_rng(4)
    volts = [
        np.exp(-0.2 * times) * start * np.cos(2 * times) + 0.01 * random.standard_normal(60) for start in (1.0, 0.6)
    ]
    trials = cl.Trials.from_arrays([times] * 2, volts, object=["a", "a"], names=["v"])
    law = cl.discover(trials, order=2, library="poly:2")
    named = law.textbook(trials)
    assert named.is_chosen
    assert "damped-oscillator" in [model.name for model in named.models]
    assert named.models[0].equations.startswith("v'' = -k `v` - c v'")
