"""Part 8, second half: forecasts of the unseen drop by the default method and by the paper's models."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import parse_differentiation
from commonlaw.discovery import discover
from commonlaw.forecast import Forecast
from commonlaw.law import Law
from commonlaw.trials import Trial, Trials
from studies.falling_balls.model_error import OTHER_DROP, Errors, Medians, errors_of_height, learned, medians_of
from studies.falling_balls.settings import DIFFERENTIATION, HORIZON, MODELS, OFFERED, RATE_SAMPLES, REDRAWS, SEED

LINEAR, DEFAULT, CUBIC = "2", "default", "default, cubic"
"""The paper's model with linear drag; the default method offered 1, v and v^2; the same with its own library."""

_ROUNDS = 4
"""Of a fit of one rate. Heights are a linear function of it under linear drag, and nearly so in all these laws."""

Laws = Mapping[str, Mapping[str, Law]]
"""By model and the drop that was learned from."""

Starter = Callable[[Law, Trial], float]
"""Gives the initial rate of a forecast, m/s."""


@dataclass(frozen=True, eq=False)
class Forecasts:
    """Errors at the horizon by model, and the default's forecasts with their bands by training drop.

    Parameters
    ----------
    laws
        What the models learned.
    rule, fitted, parabola
        Errors of forecasts whose initial rate is that of the paper's rule, that with which the law's own trajectory is
        nearest to the first samples, or that of a parabola through these.
    default
        The default's forecasts by the paper's rule.
    """

    laws: Laws
    rule: Errors
    fitted: Errors
    parabola: Errors
    default: Mapping[str, Forecast]

    @property
    def medians(self) -> tuple[Medians, Medians, Medians]:
        """By start: the paper's rule, fitted to the first second, of a parabola."""
        return medians_of(self.rule), medians_of(self.fitted), medians_of(self.parabola)

    @property
    def best(self) -> str:
        """The paper's model with the least median."""
        medians = self.medians[0]
        return min(MODELS, key=lambda model: medians[model]["both"])

    @property
    def gain(self) -> float:
        """How much less the default's median is than that of the paper's best model, m."""
        medians = self.medians[0]
        return medians[self.best]["both"] - medians[DEFAULT]["both"]

    @property
    def deviation(self) -> float:
        """Standard deviation of that over forecasts drawn anew, m."""
        both = np.array([every(self.rule[self.best]), every(self.rule[DEFAULT])])
        drawn = np.random.default_rng(SEED).integers(both.shape[1], size=(REDRAWS, both.shape[1]))
        return float(np.std(np.diff(np.median(both[:, drawn], axis=2), axis=0)))

    @property
    def inside(self) -> int:
        """How many measured heights at the horizon lie in the default's 95 % bands."""
        count = 0
        for forecast in self.default.values():
            parts = zip(forecast.trials, forecast.trajectories, forecast.margins(measured=True), strict=True)
            for trial, trajectory, margin in parts:
                residual = trial.states[HORIZON - 1, 0] - trajectory.states[HORIZON - 1, 0]
                count += bool(abs(residual) <= margin[HORIZON - 1, 0])
        return count

    def share(self, model: str) -> float:
        """Return how much of the median error goes when the initial rate is fitted."""
        rule, fitted, _ = self.medians
        return 1 - fitted[model]["both"] / rule[model]["both"]


def default_forecasts(drops: Trials) -> Forecasts:
    """Return the forecasts of each drop by what was learned from the other."""
    each = {drop: drops.select(trial=drop) for drop in OTHER_DROP}
    laws = {model: {drop: learned(trials, model) for drop, trials in each.items()} for model in MODELS}
    laws[DEFAULT] = {drop: _default(trials, OFFERED) for drop, trials in each.items()}
    laws[CUBIC] = {drop: _default(trials, "poly:3") for drop, trials in each.items()}
    started = {model: laws[model] for model in (LINEAR, DEFAULT)}
    return Forecasts(
        laws,
        {model: errors_of_height(by_drop, drops) for model, by_drop in laws.items()},
        {model: _started(by_drop, drops, _fitted_rate) for model, by_drop in started.items()},
        {model: _started(by_drop, drops, _parabola_rate) for model, by_drop in started.items()},
        {drop: law.predict(each[OTHER_DROP[drop]], start=1, return_std=True) for drop, law in laws[DEFAULT].items()},
    )


def _default(trials: Trials, library: str) -> Law:
    """Return the default's law, whose forecasts start with the paper's rate."""
    law = discover(trials, order=2, library=library, progress=lambda _: None)
    return replace(law, provenance=replace(law.provenance, differentiation=parse_differentiation(DIFFERENTIATION)))


def _started(laws: Mapping[str, Law], drops: Trials, starter: Starter) -> dict[str, dict[str, float]]:
    """Return the errors at the horizon of forecasts that start with another rate, m, by training drop and ball."""
    errors: dict[str, dict[str, float]] = {}
    for drop, law in laws.items():
        for trial in drops.select(trial=OTHER_DROP[drop]):
            end = _heights(law, trial, starter(law, trial), HORIZON)[-1]
            errors.setdefault(drop, {})[trial.object] = abs(float(end - trial.states[HORIZON - 1, 0]))
    return errors


def _heights(law: Law, trial: Trial, rate: float, samples: int) -> Floats:
    """Return the heights at a trial's first samples when its first height is given this rate, m."""
    start = {trial.object: (trial.states[0, 0], rate)}
    return np.asarray(law.simulate(trial.times[:samples], start)[trial.object].states[:, 0])


def _fitted_rate(law: Law, trial: Trial) -> float:
    """Return the rate with which the law's trajectory is nearest to the first samples (Gauss-Newton)."""
    rate, seen = 0.0, trial.states[:RATE_SAMPLES, 0]
    for _ in range(_ROUNDS):
        heights = _heights(law, trial, rate, RATE_SAMPLES)
        effect = _heights(law, trial, rate + 1, RATE_SAMPLES) - heights
        rate += float(effect @ (seen - heights) / (effect @ effect))
    return rate


def _parabola_rate(_: Law, trial: Trial) -> float:
    """Return the rate of the parabola through the first height that is nearest to the first samples."""
    after = trial.times[:RATE_SAMPLES] - trial.times[0]
    fallen = trial.states[:RATE_SAMPLES, 0] - trial.states[0, 0]
    return float(np.linalg.lstsq(np.stack([after, after**2], axis=1), fallen)[0][0])


def every(by_drop: Mapping[str, Mapping[str, float]]) -> list[float]:
    """Return the errors of all balls and both drops."""
    return [error for by_ball in by_drop.values() for error in by_ball.values()]
