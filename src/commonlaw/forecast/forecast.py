"""Forecasts of trials beside what was measured."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from commonlaw.forecast.trajectory import Trajectory
from commonlaw.outcomes import Outcome
from commonlaw.trials import Trials

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Forecast:
    """Each trial forecast from its own initial state.

    Parameters
    ----------
    trials
        What was measured.
    trajectories
        One for each trial, at its sample times.
    """

    trials: Trials
    trajectories: tuple[Trajectory, ...]

    def __repr__(self) -> str:
        lost = f", {len(self.outcomes)} diverged" if self.outcomes else ""
        return f"<Forecast of {len(self.trials)} trials{lost}>"

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """What a user should know about these forecasts: the divergences."""
        return tuple(each.outcome for each in self.trajectories if each.outcome is not None)

    def to_frame(self) -> "pd.DataFrame":
        """Return a long table: object, trial, time, and each state as measured, as forecast, and their difference."""
        import pandas as pd

        schema, parts = self.trials.schema, []
        for trial, forecast in zip(self.trials, self._states(), strict=True):
            part = {schema.object: trial.object, schema.trial: trial.name, schema.time: trial.times}
            for j, name in enumerate(schema.states):
                part[name] = trial.states[:, j]
                part[f"{name} forecast"] = forecast[:, j]
                part[f"{name} error"] = forecast[:, j] - trial.states[:, j]
            parts.append(pd.DataFrame(part))
        return pd.concat(parts, ignore_index=True)

    def errors(self) -> "pd.DataFrame":
        """Return a table of errors, one row for each trial and state.

        Columns: the root of the mean squared error, the largest and the last absolute error, all in the state's unit,
        and when the forecast diverged (NaN if it did not; its errors are then infinite).
        """
        import pandas as pd

        schema, rows = self.trials.schema, []
        for trial, forecast, trajectory in zip(self.trials, self._states(), self.trajectories, strict=True):
            gap = np.abs(forecast - trial.states)
            gap[np.isnan(gap)] = np.inf
            lost = np.flatnonzero(np.isnan(forecast).any(axis=1))
            for j, name in enumerate(schema.states):
                rows.append(
                    {
                        schema.object: trial.object,
                        schema.trial: trial.name,
                        "state": name,
                        "rms error": np.sqrt(np.mean(gap[:, j] ** 2)),
                        "largest error": gap[:, j].max(),
                        "last error": gap[-1, j],
                        "diverged after": np.nan if trajectory.outcome is None else trial.times[lost[0] - 1],
                    }
                )
        return pd.DataFrame(rows)

    def score(self) -> float:
        """Return the mean over states of R^2, the share of the states' variation within trials that is forecast.

        1 is perfect, 0 is as good as each trial's mean, and a forecast that diverged makes it minus infinity.
        """
        states = self._states()
        if any(np.isnan(forecast).any() for forecast in states):
            return -np.inf
        missed = _sum_of_squares([f - trial.states for f, trial in zip(states, self.trials, strict=True)])
        varied = _sum_of_squares([trial.states - trial.states.mean(axis=0) for trial in self.trials])
        return float(np.mean(1 - missed / varied))

    def _states(self) -> list[Floats]:
        width = len(self.trials.schema.states)
        return [trajectory.states[:, :width] for trajectory in self.trajectories]


def _sum_of_squares(parts: Sequence[Floats]) -> Floats:
    return np.asarray(sum(np.sum(part**2, axis=0) for part in parts))
