"""Samples in which a state was not measured: read, kept, counted, refused where they cannot be used."""

import json

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.differentiation import FiniteDifference, RobustSpline
from commonlaw.formulation import DiscreteForm, StrongForm, law_variables
from commonlaw.library import Variables, parse_library
from commonlaw.plots import plot_forecast, plot_trials, render
from commonlaw.trials import Trial, Trials, TrialStream, stream
from studies.falling_balls.plots import plot_displacement, plot_strobe
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("few_starts")

ROLES = {"object": "object", "trial": "trial", "time": "t", "states": ["x", "y"]}


def spiral(samples=60, gaps=((3, 0), (4, 0), (10, 1), (59, 1)), name="a"):
    """Return a trial of ``x' = y, y' = -x``."""
    times = np.linspace(0, 6, samples)
    states = np.column_stack([np.sin(times), np.cos(times)])
    for gap in gaps:
        states[gap] = np.nan
    return Trial(name, "1", times, states)


def collection(*trials):
    return Trials(trials or (spiral(),), cl.Schema(("x", "y")))


def law(order=1, differentiation=None):
    states = ("x", "y") if order == 1 else ("x",)
    names = ("x", "y") if order == 1 else ("x", "v")
    terms = parse_library("poly:1").bind(Variables(names, (), "t"))
    coefficients = np.array([[[0, 0, 1], [0, -1, 0]]] if order == 1 else [[[0, -1, 0]]], dtype=float)
    return cl.Law(terms, cl.Schema(states), order, ("a",), coefficients, provenance=cl.law.Provenance(differentiation))


def test_an_empty_cell_of_a_state_is_a_missing_measurement_and_rows_of_nothing_else_are_left_out(tmp_path):
    lines = [f"{i},{i * i},{-i * i}" for i in range(9)]
    lines[2], lines[4], lines[5] = "2,,-4", "4,,", "5, ,NA"
    (tmp_path / "drops.csv").write_text("t,x,y\n" + "\n".join(lines) + "\n")
    trials = Trials.read(tmp_path / "drops.csv")
    assert trials[0].times.tolist() == [0, 1, 2, 3, 6, 7, 8]
    np.testing.assert_array_equal(trials[0].states[:, 0], [0, 1, np.nan, 9, 36, 49, 64])
    assert not trials[0].complete
    assert trials[0].cut(2).complete
    note = "rows without a measured state left out: drops, trial 1: 2 (row 5 (line 6), row 6 (line 7))"
    missing, roles, *others = trials.notes
    assert missing == "drops.csv: read as missing in y: 'NA' in 1 cell"
    assert roles.startswith("columns recognized as")
    assert others == [note]


def test_rows_after_the_last_measured_state_are_kept_to_be_forecast_and_not_learned_from(tmp_path):
    times = np.linspace(0, 6, 61)
    measured = pd.DataFrame({"t": times, "x": np.sin(times), "y": np.cos(times)})
    later = pd.DataFrame({"t": [6.5, 7.0], "x": np.nan, "y": np.nan})
    frame = pd.concat([measured, later], ignore_index=True)
    frame.to_csv(tmp_path / "drops.csv", index=False)
    for trials in (
        Trials.read(tmp_path / "drops.csv"),
        Trials.from_frame(frame),
        Trials.from_arrays(frame["t"], frame[["x", "y"]], names=["x", "y"]),
    ):
        assert trials[0].times.tolist() == frame["t"].tolist()
        assert not any("left out" in note for note in trials.notes)
        assert trials[0].measured().times.tolist() == times.tolist()
    text, tables = "x' = a x + b y; y' = c x + d y", [Trials.from_frame(each) for each in (frame, measured)]
    one, other = (cl.fit(text, trials, errors="white") for trials in tables)
    np.testing.assert_array_equal(one.coefficients, other.coefficients)
    refined, again = (cl.refine(one, trials) for trials in tables)
    np.testing.assert_array_equal(refined.coefficients, again.coefficients)
    short = frame.iloc[[0, 1, 2, 3, 61]].assign(y=[1.0, np.nan, 2.0, 3.0, np.nan])
    assert len(Trials.from_frame(short)[0]) == 5


def test_arrays_may_have_gaps_too():
    states = np.arange(14.0).reshape(7, 2)
    states[1], states[4, 0] = np.nan, np.nan
    trials = Trials.from_arrays([np.arange(7.0)] * 2, [states, np.arange(14.0).reshape(7, 2)])
    assert trials[0].times.tolist() == [0, 2, 3, 4, 5, 6]
    assert trials.notes == ("samples without a measured state left out: object, trial 1: 1 (sample 2)",)
    driven = Trials.from_arrays(range(7), states, inputs=np.arange(7.0))
    assert driven[0].inputs[:, 0].tolist() == [0, 1, 2, 3, 4, 5, 6]  # An input is told there


def test_rows_of_a_dose_alone_between_measured_ones_are_kept_in_tables_and_arrays(tmp_path):
    times, doses = np.array([0.0, 1.0, 1.5, 2.0, 3.0, 4.0]), np.array([0.0, 0.0, 5.0, 0.0, 0.0, 2.0])
    frame = pd.DataFrame({"t": times, "x": [1.0, 0.4, np.nan, 2.0, 0.7, np.nan], "dose": doses})
    frame.to_csv(tmp_path / "doses.csv", index=False)
    for trials in (
        Trials.read(tmp_path / "doses.csv", states=["x"], inputs=["dose"]),
        Trials.from_frame(frame, states=["x"], inputs=["dose"]),
        Trials.from_arrays(times, frame["x"], inputs=doses, names=["x", "dose"]),
    ):
        assert trials[0].inputs[:, 0].tolist() == doses.tolist()
        assert not any("left out" in note for note in trials.notes)
    short = Trials.from_frame(frame.iloc[:5], states=["x"], inputs=["dose"])[0]
    assert len(short) == 5  # Of which four have all the values that there are: no gap
    late = Trials.from_frame(frame.assign(x=[np.nan, 0.4, np.nan, 2.0, 0.7, np.nan]), states=["x"], inputs=["dose"])
    assert late[0].times.tolist() == times[1:].tolist()


def test_a_dose_in_a_row_of_its_own_is_added_to_a_state_that_nobody_measured():
    ka, k, given = 1.0, 0.3, 2.3
    times = np.arange(0.5, 10.1, 0.5)

    def absorbed(t):
        return np.where(t > 0, ka / (ka - k) * (np.exp(-k * t) - np.exp(-ka * t)), 0.0)

    states = 10 * absorbed(times) + 5 * absorbed(times - given)
    rows = np.append(times, given)
    order = np.argsort(rows)
    frame = pd.DataFrame({"t": rows, "conc": np.append(states, np.nan), "dose": np.append(np.zeros_like(times), 5.0)})
    trials = Trials.from_frame(frame.iloc[order], states=["conc"], inputs=["dose"])
    text = "depot' = -1 depot + dose; conc' = a depot - k conc"
    law = cl.fit(text, trials, initial_values={"depot": 10.0}, initial_time=0.0, doses="dose")
    own = {name: law.coefficients[0, 0, law.terms.names.index(name)] for name in ("depot", "conc")}
    assert own == pytest.approx({"depot": ka, "conc": -k}, rel=1e-3)


def test_a_state_with_gaps_needs_five_measured_values_in_each_trial(tmp_path):
    frame = pd.DataFrame({"t": range(8), "x": 1.5, "y": [0, 1, 2, 3, *[None] * 4]})
    with refused("state-with-gaps", "object, trial 1", state="y", measured="4", samples=8, least=5):
        cl.discover(Trials.from_frame(frame, states=["x", "y"]))
    law = cl.Law.from_text("x' = a x; y' = b", {"a": 1.0, "b": 1.0})
    with refused("state-with-gaps", state="y", measured="4", samples=8, where="object, trial 1"):
        cl.refine(law, Trials.from_arrays(frame["t"], frame[["x", "y"]], names=["x", "y"]))
    frame.assign(object="a", trial=1).to_parquet(tmp_path / "a.parquet")
    with refused("state-with-gaps", state="y", measured="4", samples=8, where="a, trial 1"):
        list(TrialStream.from_parquet(tmp_path / "a.parquet", **ROLES))
    with refused("nothing-measured", trial="object, trial 1"):
        Trials.from_frame(frame.assign(x=np.nan, y=np.nan), states=["x", "y"])


def test_a_state_may_be_missing_throughout_a_trial_if_another_has_it(tmp_path):
    x = np.arange(8.0) ** 2
    frame = pd.concat([pd.DataFrame({"object": name, "t": range(8), "x": x, "y": x + 1}) for name in "ab"])
    half = frame.assign(y=frame["y"].where(frame["object"] == "a"))
    half.to_csv(tmp_path / "half.csv", index=False)
    for trials in (
        Trials.from_frame(half),
        Trials.read(tmp_path / "half.csv"),
        Trials.from_arrays([range(8)] * 2, [frame[["x", "y"]][:8], half[["x", "y"]][8:]], object=["a", "b"]),
    ):
        assert [np.isnan(trial.states).sum(axis=0).tolist() for trial in trials] == [[0, 0], [0, 8]]
        assert not any("left out" in note for note in trials.notes)
    with refused("state-with-gaps", state="y", measured=0, samples=8, where="a, trial 1"):
        Trials.from_frame(frame.assign(y=np.nan), states=["x", "y"])


@pytest.mark.parametrize("rows", [1, 4, 7, 100])
def test_streams_keep_gaps_and_leave_empty_rows_out_wherever_batches_end(tmp_path, monkeypatch, rows):
    gaps = ((1, 0), (5, 1), (8, 0))
    frame = pd.concat([collection(spiral(12, gaps, name)).to_frame() for name in "ab"], ignore_index=True)
    frame.loc[[0, 6, 11, 12], ["x", "y"]] = np.nan
    frame.to_parquet(tmp_path / "a.parquet")
    monkeypatch.setattr(stream, "_ROWS", rows)
    whole = Trials.from_frame(frame.dropna(subset=["x", "y"], how="all"), **ROLES)
    for one, other in zip(TrialStream.from_parquet(tmp_path / "a.parquet", **ROLES), whole, strict=True):
        assert one.label == other.label
        np.testing.assert_array_equal(one.times, other.times)
        np.testing.assert_array_equal(one.states, other.states)


def test_the_check_counts_missing_values_by_trial_and_state_and_looks_for_jumps_between_measured_ones():
    jumping = spiral(name="b")
    states = np.array(jumping.states)
    states[30:, 0] += 50
    states[29, 0] = np.nan
    trials = collection(spiral(), Trial("b", "1", jumping.times, states))
    report = trials.check()
    assert [trial.missing for trial in report.trials] == [{"x": 2, "y": 2}, {"x": 3, "y": 2}]
    assert report.to_frame()["x (missing)"].tolist() == [2, 3]
    assert "missing" not in " ".join(collection(spiral(gaps=())).check().to_frame().columns)
    assert "a, trial 1: x is missing in 2 of 60 samples" in report.findings
    assert [finding for finding in report.findings if "jumps" in finding] == [
        f"b, trial 1: x jumps by {states[30, 0] - states[28, 0]:.3g} from sample 29 to sample 31"
    ]
    assert report.trials[0].last["y"] == trials[0].states[58, 1]
    assert json.dumps(report.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    "form",
    [StrongForm(FiniteDifference(2)), StrongForm(RobustSpline(), library_states="measured"), DiscreteForm()],
    ids=["strong", "measured", "discrete"],
)
@pytest.mark.parametrize("ask", ["rows", "problems"])
def test_a_formulation_that_needs_every_value_says_which_is_missing(form, ask):
    terms = parse_library("poly:1").bind(law_variables(collection().schema, 1))
    with refused("state-missing", state="x", sample="4", missing=4, where="a, trial 1"):
        getattr(form, ask)(spiral(), terms)


def test_the_robust_spline_fills_the_gaps_of_the_strong_form():
    form = StrongForm(RobustSpline(), trim=5)
    terms = parse_library("poly:1").bind(law_variables(collection().schema, 1))
    library, targets = form.rows(spiral(), terms)
    np.testing.assert_allclose(np.linalg.lstsq(library, targets)[0], [[0, 0], [0, -1], [1, 0]], atol=1e-3)


def test_a_forecast_starts_at_a_complete_sample_and_counts_what_was_measured():
    forecast = law().predict(collection())
    errors = forecast.errors()
    assert errors[["rms error", "largest error", "last error"]].to_numpy().max() < 1e-6
    assert forecast.score() == pytest.approx(1)
    with refused("initial-value-missing", state="y", where="a, trial 1"):
        law().predict(collection(spiral(gaps=((0, 1),))))


def test_first_rates_of_a_trial_with_gaps_come_from_the_robust_spline_if_the_law_has_another_method():
    times = np.linspace(0, 2, 81)
    states = np.column_stack([np.sin(times), np.cos(times)])
    states[[2, 7], 0] = np.nan
    trials = Trials((Trial("a", "1", times, states),), cl.Schema(("x", "y")))
    terms = parse_library("poly:1").bind(Variables(("x", "y", "v_x", "v_y"), (), "t"))
    pendulums = np.array([[[0, -1, 0, 0, 0], [0, 0, -1, 0, 0]]], dtype=float)
    found = cl.Law(
        terms, trials.schema, 2, ("a",), pendulums, provenance=cl.law.Provenance(FiniteDifference(2))
    ).predict(trials)
    first = RobustSpline().differentiate(times, states, 1).derivatives[0][0]
    np.testing.assert_array_equal(found.trajectories[0].states[0], [0, 1, *first])
    assert np.isfinite(found.score())


def test_plots_leave_gaps_out_without_a_warning():
    trials = collection()
    for figure in (
        plot_trials(trials),
        plot_displacement(collection(spiral(gaps=((0, 0), (7, 1))))),
        plot_strobe(trials, every=2),
        plot_forecast(law().predict(trials)),
    ):
        assert render(figure, "svg")
