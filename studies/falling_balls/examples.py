"""What is learned from trajectories without noise, beside what is true."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.datasets import PRINTED_VISCOSITY, linear_drag, nonlinear_oscillator, reynolds_drag
from commonlaw.differentiation import CenteredDifference
from commonlaw.discovery import DerivativeRegression, discover
from commonlaw.formulation import StrongForm
from commonlaw.law import Law
from commonlaw.solvers import STLSQ
from commonlaw.trials import Schema, Trial, Trials
from studies.falling_balls.plots import Curve
from studies.falling_balls.settings import (
    EXAMPLE_BALL,
    EXAMPLE_FALL,
    EXAMPLE_SAMPLES,
    EXAMPLE_THRESHOLDS,
    OSCILLATOR,
    OSCILLATOR_LIBRARY,
    OSCILLATOR_SAMPLES,
)

_SPACING = 0.12
"""Of marks on the path of a learned law, in units of its extent."""


@dataclass(frozen=True, eq=False)
class Example:
    """A law that was learned from a part of a known trajectory.

    Parameters
    ----------
    law
        What was learned.
    learned_from
        Number of samples.
    times
        Of the whole trajectory, shape (n,).
    true, predicted
        States of the system, and of the law from the same start, each of shape (n, states).
    """

    law: Law
    learned_from: int
    times: Floats
    true: Floats
    predicted: Floats

    @property
    def errors(self) -> Floats:
        """Distance of the prediction from the truth over the size of the true trajectory, shape (n,)."""
        size = np.linalg.norm(self.true, axis=1).max()
        return np.asarray(np.linalg.norm(self.predicted - self.true, axis=1) / size)

    def _spaced(self) -> Indices:
        """Return which samples of the prediction get a mark, evenly spaced along it."""
        size = np.linalg.norm(self.true, axis=1).max()
        path = np.column_stack([self.times / self.times[-1], self.predicted / size])
        lengths = np.append(0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
        return np.unique(np.searchsorted(lengths, np.arange(0, lengths[-1], _SPACING)))

    def curves(self, x: str, y: str) -> list[Curve]:
        """Return the true trajectory in its two parts, and the prediction: one variable against another."""
        names = ("t", *self.law.schema.states)
        true, predicted = (
            dict(zip(names, (self.times, *states.T), strict=True)) for states in (self.true, self.predicted)
        )
        seen, unseen = slice(self.learned_from), slice(self.learned_from - 1, None)
        shown = self._spaced()
        return [
            Curve("true, learned from", true[x][seen], true[y][seen]),
            Curve("true, not seen", true[x][unseen], true[y][unseen]),
            Curve("learned law", predicted[x][shown], predicted[y][shown], line="", points=True),
        ]


def learned_oscillator() -> Example:
    learned_from, samples = OSCILLATOR_SAMPLES
    (whole,) = nonlinear_oscillator(samples=samples)
    law = discover(
        nonlinear_oscillator(samples=learned_from),
        order=1,
        library=OSCILLATOR_LIBRARY,
        method=DerivativeRegression(**OSCILLATOR),
    )
    return _example(law, learned_from, whole.times, whole.states)


def learned_fall(name: str, viscosity: float = PRINTED_VISCOSITY) -> Example:
    """Learn the law of the speeds of a ball, which are taken from its heights."""
    learned_from, samples = EXAMPLE_SAMPLES
    heights, truth = _ball(name, learned_from, viscosity)
    form = StrongForm(CenteredDifference())
    speeds = [Trial(height.object, height.name, height.times, form.rates(height).derivatives[0]) for height in heights]
    trials = Trials(tuple(speeds), Schema(("v",), units={"v": "m/s", "t": "s"}))
    law = discover(
        trials,
        order=1,
        library="poly:2",
        method=DerivativeRegression(differentiation="centered", solver=STLSQ(EXAMPLE_THRESHOLDS[name], shared=False)),
    )
    times = np.arange(samples) * heights[0].times[1]
    (path,) = truth.simulate(times, (EXAMPLE_FALL["height"], 0.0)).values()
    return _example(law, learned_from, times, path.states[:, 1:])


def _ball(name: str, samples: int, viscosity: float) -> tuple[Trials, Law]:
    """Return the heights of the ball of an example, and the law behind them."""
    if name.startswith("Reynolds-drag"):
        ball = {**EXAMPLE_BALL, "viscosity": viscosity}
        return reynolds_drag(**EXAMPLE_FALL, **ball, samples=samples), reynolds_drag.truth(**ball)
    drag = {"drag-free": 0.0, "linear-drag": -0.5}[name.split()[0]]
    return linear_drag(**EXAMPLE_FALL, drag=drag, samples=samples), linear_drag.truth(drag=drag)


def _example(law: Law, learned_from: int, times: Floats, true: Floats) -> Example:
    (path,) = law.simulate(times, true[0]).values()
    return Example(law, learned_from, times, true, path.states)
