"""Forecasts that leave what the law was learned from."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.forecast.forecast import Forecast
from commonlaw.law import Law
from commonlaw.trials import Trial


def with_remarks(law: Law, forecast: Forecast) -> Forecast:
    """Return a forecast whose trials say where it leaves what the law was learned from, see `Law.domain`."""
    domain, left, ahead = law.provenance.domain, dict[str, dict[str, float]](), 0.0
    for trial, trajectory in zip(forecast.trials, forecast.trajectories, strict=True):
        for name, values in _values(law, forecast, trial, trajectory.states):
            farthest = domain.left_by(name, values)
            if farthest is not None:
                left.setdefault(name, {})[trial.label] = farthest
        known = trial.times[np.isfinite(trial.states).any(axis=1)][-1]
        since = known if forecast.from_time is None else min(known, forecast.from_time)
        ahead = max(ahead, float(trial.times[-1] - since))
    unit = forecast.trials.schema.units.get(forecast.trials.schema.time, "")
    remarks = tuple(domain.remarks(left, unit, ahead))
    if not remarks:
        return forecast
    return replace(forecast, trials=replace(forecast.trials, notes=(*forecast.trials.notes, *remarks)))


def _values(law: Law, forecast: Forecast, trial: Trial, states: Floats) -> Iterator[tuple[str, Floats]]:
    """Yield the values that a forecast has of every variable and property."""
    names = (*law.states, *law.rates)
    yield from zip(names, states.T, strict=True)
    yield from zip(forecast.trials.schema.inputs, trial.inputs.T, strict=True)
    for name, value in forecast.trials.properties.get(trial.object, {}).items():
        if isinstance(value, float):
            yield name, np.array([value])
