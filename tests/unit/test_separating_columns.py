"""Columns of numbers that label objects and trials."""

import numpy as np
import pandas as pd

from commonlaw.trials import Trials


def test_masses_and_counted_releases_are_objects_and_trials():
    times = np.linspace(0, 1, 11)
    rows = [
        (mass, release, time, release * np.cos(time / mass))
        for mass in (0.2, 0.5, 1.0)
        for release in (1, 2)
        for time in times
    ]
    trials = Trials.from_frame(pd.DataFrame(rows, columns=["mass (kg)", "release", "time (s)", "x (cm)"]))
    assert (trials.objects, [trial.name for trial in trials]) == (("0.2", "0.5", "1"), ["1", "2"] * 3)
    assert trials.schema.states == ("x",)
