"""The experiments that were chosen, and what is to be expected of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats, evenly_spaced
from commonlaw.experiments.aims import Aim
from commonlaw.experiments.experiment import Experiment
from commonlaw.experiments.predictive import Hypothesis
from commonlaw.experiments.search import MAX_REPEATS, MIN_RELATIVE_GAIN, SETTLED
from commonlaw.law import Law, PlausibleLaw
from commonlaw.law.text import with_error
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.text import counted

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Forecasts:
    """Each plausible law's forecast of the first trial of an experiment, from the initial conditions that are set.

    Times have shape (n,); means and standard deviations, by the errors of coefficients and measurements, (laws, n,
    states). States named in `logarithmic` are here by their logarithms.
    """

    times: Floats
    states: tuple[str, ...]
    means: Floats
    std: Floats
    logarithmic: tuple[str, ...] = ()

    @classmethod
    def of(cls, experiment: Experiment, hypotheses: Sequence[Hypothesis]) -> "Forecasts":
        """Return those of an experiment in which no law diverges."""
        law, predicted = hypotheses[0].law, [hypothesis.predictions([experiment])[0] for hypothesis in hypotheses]
        first = [by_object[0] for by_object in predicted if by_object is not None]
        states, times = law.observation.measured.measured, experiment.times
        shape = (len(first), -1, len(states))
        times = times[evenly_spaced(len(times), len(first[0].mean) // len(states))]
        total = [prediction.variances for prediction in first]
        means = np.array([prediction.mean for prediction in first]).reshape(shape)
        return cls(times, states, means, np.sqrt(total).reshape(shape), law.observation.measured.logarithmic)


@dataclass(frozen=True, eq=False)
class Gain:
    """A coefficient, its unit, and its standard error now and, as is expected, after all experiments."""

    name: str
    unit: str
    now: float
    then: float


@dataclass(frozen=True, eq=False)
class Planned:
    """One of the experiments, given those before it.

    Parameters
    ----------
    experiment, text
        What is to be set, as a value and in words.
    chance
        Probability that, after these experiments, the most probable law is the right one.
    bits
        Expected information of all of them about the aim.
    std
        Expected standard deviation of the quantity that was asked for, if one was.
    forecasts
        Of its first trial.
    """

    experiment: Experiment
    text: str
    chance: float
    bits: float
    std: float | None
    forecasts: Forecasts


@dataclass(frozen=True, eq=False)
class Design(ShownInNotebooks):
    """The most informative experiments, from `commonlaw.design`; prints as text.

    Parameters
    ----------
    laws
        Plausible laws with their probabilities.
    experiments
        The experiments, each chosen given those before it.
    repeats
        Number of repetitions after which the true law is identified with probability 0.95; None if 100 do not suffice,
        or the law is not the aim.
    limit
        Largest probability of identifying the law with 100 repetitions of one experiment, if `repeats` is None.
    aim
        Law, coefficients or quantity that the design is about.
    gains
        Standard errors of the coefficients of the most probable law, now and after, the largest gain first.

    Examples
    --------
    >>> import commonlaw as cl
    >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05, trials=1))
    >>> drop = {"object": "Ball 1", "x": 40, "v": 0, "duration": 2, "rate": 15}
    >>> cl.design(law, drop, about="g of Ball 1").cost
    1.0
    """

    laws: tuple[PlausibleLaw[Law], ...]
    experiments: tuple[Planned, ...]
    repeats: int | None
    limit: float | None
    aim: Aim
    gains: tuple[Gain, ...] = ()

    @property
    def chance_now(self) -> float:
        """Probability that the most probable law is the true one, now."""
        return float(self.aim.prior.max())

    @property
    def chance(self) -> float:
        """Expected probability of the true law after all experiments."""
        return self.experiments[-1].chance

    @property
    def cost(self) -> float:
        """Cost of all experiments."""
        return sum(experiment.experiment.cost for experiment in self.experiments)

    @property
    def tells_apart(self) -> bool:
        """Whether some experiment in the ranges, however often it is made, makes the right law surer."""
        return self.repeats is not None or (self.limit or 0.0) > self.chance_now + MIN_RELATIVE_GAIN

    @property
    def sentences(self) -> tuple[str, ...]:
        """The expected results, in sentences."""
        sentences = []
        if self.aim.of_law or self.chance_now < SETTLED:
            sentences += self._of_laws()
        if (quantity := self.aim.quantity) is not None:
            now, then = quantity.std(self.aim.prior), self.experiments[-1].std or 0.0
            shown = with_error(float(self.aim.prior @ quantity.values), now)
            sentences.append(f"{quantity.name} is {shown} now; its standard error is then {then:.2g}.")
        elif not self.aim.of_law:
            gains = [gain for gain in self.gains if gain.then < (1 - MIN_RELATIVE_GAIN) * gain.now][:3]
            parts = [f"{gain.name} from {gain.now:.2g} to {gain.then:.2g} {gain.unit}".rstrip() for gain in gains]
            sentences += [f"Expected standard errors: {', '.join(parts)}."] if parts else []
            sentences.append(f"Information gain on all coefficients: {self.experiments[-1].bits:.1f} bits.")
        return tuple(sentences)

    def _of_laws(self) -> list[str]:
        if self.aim.of_law and not self.tells_apart:
            return [
                "No experiment in these ranges discriminates between these laws within their errors. "
                f"{MAX_REPEATS} repeats of the best raise the posterior probability to {_floor(self.limit)}, from "
                f"{_floor(self.chance_now)} now."
            ]
        chance = (
            f"The chance that the most probable law is the right one is {_floor(self.chance_now)} now, and "
            f"{_floor(self.chance)} after {_these(len(self.experiments))}."
        )
        if not self.aim.of_law or self.repeats == 1:
            often = ""
        elif self.repeats is None:
            often = (
                f"Even {MAX_REPEATS} repeats do not make it {SETTLED}; the best single experiment in these ranges, "
                f"made so often, comes to {_floor(self.limit)}."
            )
        else:
            often = f"For {SETTLED}, make {_these(len(self.experiments))} {self.repeats} times."
        return [part for part in (chance, often, self._parting()) if part]

    def _parting(self) -> str:
        """Return where the two most probable laws part."""
        one, two = np.argsort(-self.aim.prior, kind="stable")[:2].tolist()
        forecasts, first = self.experiments[0].forecasts, self.laws[0].law
        apart = np.abs(forecasts.means[one] - forecasts.means[two]) / np.hypot(forecasts.std[one], forecasts.std[two])
        time, state = map(int, np.unravel_index(int(apart.argmax()), apart.shape))
        units, name = first.schema.units, forecasts.states[state]
        values = [with_error(*_natural(forecasts, index, time, state)) for index in (one, two)]
        at = f"{first.schema.time} = {forecasts.times[time]:.3g} {units.get(first.schema.time, '')}".rstrip()
        return (
            f"In the first, the two most probable part most at {at}, where a measured {name} is {values[0]} or "
            f"{values[1]} {units.get(name, '')}".rstrip()
            + "."
        )

    def __str__(self) -> str:
        lines = []
        if len(self.laws) > 1:
            lines += ["Laws that remain plausible:"]
            lines += [f"  {law.probability:.2f}  {'; '.join(law.law.structure)}" for law in self.laws]
            lines += [""]
        few = len(self.experiments) == 1
        lines += ["Most informative next experiment:" if few else "Most informative next experiments:"]
        costs = [f": cost {experiment.experiment.cost:.4g}" for experiment in self.experiments]
        costs = [""] * len(costs) if {*costs} == {": cost 1"} else costs  # Without unit costs all cost the same
        texts = [f"{experiment.text}{cost}" for experiment, cost in zip(self.experiments, costs, strict=True)]
        lines += [f"  {i}. {text}" for i, text in enumerate(texts, 1)]
        return "\n".join([*lines, "", *self.sentences])

    def to_frame(self) -> "pd.DataFrame":
        """Return a table with a row for each experiment: settings, cost and expected results."""
        import pandas as pd

        rows = []
        for experiment in self.experiments:
            times = experiment.experiment.times
            lasts = {"duration": float(times[-1] - times[0]), "samples": len(times)}  # Until it leaves its limits
            settings = {name: setting for name, setting in experiment.experiment.settings.items() if name != "times"}
            row = {**settings, **lasts, "cost": experiment.experiment.cost, "bits": experiment.bits}
            row |= {"chance": experiment.chance} if len(self.laws) > 1 else {}
            rows.append(row | ({} if experiment.std is None else {"standard error": experiment.std}))
        return pd.DataFrame(rows)


def _floor(chance: float | None) -> str:
    """Return a chance as it is at least, so that 0.95 is given where it is reached."""
    return f"{np.floor(100 * (chance or 0.0) + 1e-9) / 100:.2f}"


def _these(count: int) -> str:
    return "this experiment" if count == 1 else f"these {counted(count, 'experiment')}"


def _natural(own: Forecasts, law: int, time: int, state: int) -> tuple[float, float]:
    mean, std = float(own.means[law, time, state]), float(own.std[law, time, state])
    return (float(np.exp(mean)), float(np.exp(mean) * std)) if own.states[state] in own.logarithmic else (mean, std)
