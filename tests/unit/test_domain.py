"""Where a law may be used: what it was learned from, and how far ahead its forecasts are good."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw import Law, Trials
from commonlaw.law import from_json, to_json
from commonlaw.law.provenance import Domain
from commonlaw.verdict import find


@pytest.fixture(scope="module")
def drops() -> Trials:
    """Drops of two balls with masses."""
    drops = cl.datasets.linear_drag(noise=0.05, drag=(-0.3, -0.5), trials=1)
    return Trials(drops.trials, drops.schema, {"Ball 1": {"mass": 1.0}, "Ball 2": {"mass": 2.0}})


@pytest.fixture(scope="module")
def law(drops: Trials) -> Law:
    """The law of these drops."""
    return cl.fit("x'' = -g - c v", drops)


def test_a_law_knows_the_ranges_of_what_it_was_learned_from_and_keeps_them(law: Law, drops: Trials) -> None:
    again = from_json(to_json(law))
    table = again.provenance.domain.to_frame(again.schema.units).set_index("variable")
    heights = np.concatenate([each.states for each in drops])
    assert table.loc["x", ["low", "high"]].tolist() == [heights.min(), heights.max()]
    assert table.loc["v", "low"] == pytest.approx(-19.7, abs=1.0)
    assert table.loc["mass"].tolist() == [1.0, 2.0, ""]
    assert table.loc["x", "unit"] == "m"


def test_forecasts_that_leave_what_was_visited_say_so(law: Law, drops: Trials) -> None:
    assert law.predict(drops).trials.notes == drops.notes
    beyond = law.predict(drops, times=[10.0]).trials.notes[-1]
    assert "forecasts extrapolate beyond the training data" in beyond
    assert "x reaches -" in beyond
    assert "in Ball 1, trial 1 and 1 more (training range " in beyond
    heavier = Trials(drops.trials, drops.schema, {"Ball 1": {"mass": 9.0}})
    assert "mass reaches 9 in Ball 1, trial 1 (training range 1 to 2)" in law.predict(heavier).trials.notes[-1]


def test_forecasts_beyond_the_horizon_say_so(law: Law, drops: Trials) -> None:
    found = find(law, drops, drops.until(2.0))
    judged, verdict = found.law, found.verdict
    assert verdict is not None
    assert judged.provenance.domain.horizon == verdict.horizon
    notes = judged.predict(drops, times=[8.0]).trials.notes
    assert f"forecasts go 4.8 s ahead; reliable forecast horizon: {verdict.horizon:.3g} s" in notes
    assert "ahead" not in str(judged.predict(drops, times=[4.0]).trials.notes)


def test_rates_and_states_on_a_logarithmic_scale_are_told_as_measured() -> None:
    times = np.linspace(0.0, 2.0, 30)
    trials = Trials.from_arrays(times, 3 * np.exp(-times) * np.exp(0.01 * np.sin(50 * times)), names=["x"])
    law = cl.fit("x' = -k x", trials, positive=["x"])
    heights = trials[0].states
    assert law.provenance.domain.to_frame(law.schema.units).iloc[0, 1:3].tolist() == pytest.approx(
        [heights.min(), heights.max()]
    )


def test_rates_of_long_trials_are_told_by_segments_of_them() -> None:
    times = 0.02 * np.arange(20_000)
    states = np.sin(times) + 1e-3 * np.random.default_rng(0).standard_normal(20_000)
    visited = Domain.of(Trials.from_arrays(times, states), [("x", "v")]).visited
    assert visited["x"] == (states.min(), states.max())
    assert visited["v"] == pytest.approx((-1.0, 1.0), abs=0.02)
