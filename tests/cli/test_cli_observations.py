"""Observation equations, shared parameters and initial values in commands."""

import json

import numpy as np
import pytest

import commonlaw as cl
from tests.unit.decays import OTHER, SIGNAL, T, by_trial, trials_of

pytestmark = pytest.mark.usefixtures("few_starts")

SATURATING = "x' = -k x; signal = c x (1 + x) + b; x(0) = 1"
LINEAR = "x' = -k x; signal = c x + b; x(0) = 1"


def test_laws_with_observation_equations_are_fitted_compared_refined_and_forecast(done, tmp_path):
    frame = trials_of({"A": (T, SIGNAL), "B": (T, OTHER)}, ["signal"]).to_frame()
    frame.assign(other=1.0).to_csv(tmp_path / "cells.csv", index=False)
    assert "signal = c x (1 + x) + b" in done("fit", "cells.csv", SATURATING, "--shared", "c", "--save", "law.json")
    rows = json.loads(done("compare", "cells.csv", "law.json", LINEAR, "signal' = a - k signal", "--json"))["laws"]
    assert rows[0]["law"] == "law.json"
    assert rows[1]["2 log B"] > 10
    done("refine", "cells.csv", "law.json", "--save", "again.json")
    one, other = (cl.Law.load(f"{name}.json") for name in ("law", "again"))
    assert one.provenance.log_likelihood == pytest.approx(other.provenance.log_likelihood, abs=1e-6)
    assert one.restrictions.shared == other.restrictions.shared == {"c": "all"}
    done("predict", "cells.csv", "law.json", "--save", "forecast.csv")
    assert "signal forecast" in (tmp_path / "forecast.csv").read_text()
    assert "A, " in done("design", "cells.csv", "law.json", "--vary", "object=A", "--vary", "duration=3", "--for", "k")


def test_parameters_are_shared_by_column(done, tmp_path):
    trials = by_trial(25, (0.4, 0.8, 0.4), T=(20.0, 30.0, 20.0)).until(3.0)
    trials.to_frame().to_csv(tmp_path / "cells.csv", index=False)
    shared = ("--trial", "trial", "--shared", "a", "--shared", "k=T")
    done("fit", "cells.csv", "x' = -k x; y = x + b; x(0) = a", *shared, "--save", "law.json")
    law = cl.Law.load("law.json")
    assert law.restrictions.shared == {"a": "all", "k": "T"}
    assert len(law.trial_estimates) == 6


def test_a_measured_state_has_a_given_initial_value(done, tmp_path):
    y = 5 * (1 - np.exp(-0.7 * T)) + 0.01 * np.random.default_rng(1).standard_normal(len(T))
    trials_of({"A": (T, y)}).to_frame().to_csv(tmp_path / "tank.csv", index=False)
    assert "y(0) = 0.0" in done("fit", "tank.csv", "y' = k (B - y)", "--initial-value", "y=0")


def test_marks_below_a_limit_are_read_as_a_schema_tells(done, run, tmp_path):
    y = 5 * np.exp(-0.5 * T) + 0.05 * np.random.default_rng(10).standard_normal(len(T))
    cells = ["BLQ" if value < 0.5 else str(value) for value in y.round(6)]
    (tmp_path / "marks.csv").write_text("\n".join(["t,y", *map(",".join, zip(map(str, T), cells, strict=True))]))
    _, _, err = run("fit", "marks.csv", "y' = -k y")
    assert "--below BLQ=0.5 of commonlaw data check" in err
    done("data", "check", "marks.csv", "--below", "BLQ=0.5", "--save", "schema.toml")
    done("fit", "marks.csv", "y' = -k y; y(0) = a", "--schema", "schema.toml", "--save", "law.json")
    trial = trials_of({"object": (T, np.where(y < 0.5, np.nan, y.round(6)))}).trials[0]
    below = cl.Trial(trial.object, trial.name, trial.times, trial.states, below=np.where(y < 0.5, 0.5, np.nan))
    law = cl.fit("y' = -k y; y(0) = a", cl.Trials((below,), cl.Schema(("y",))))
    np.testing.assert_allclose(cl.Law.load("law.json").params["estimate"], law.params["estimate"], rtol=1e-6)
