"""The experiments that are worth most: each given those before it, then each beside all others."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.experiments.aims import Aim
from commonlaw.experiments.experiment import Experiment
from commonlaw.experiments.gaussian import Draws, Evidence, Gaussian
from commonlaw.experiments.predictive import MOST, Hypothesis
from commonlaw.experiments.settings import Range, Settings, numbers_of
from commonlaw.law import Law

POINTS, _SHARE, _WIDTHS = 256, 8, (0.2, 0.05)
"""Experiments that are looked at all over the ranges; and one in so many of them in each of the narrowing surroundings
of the best, of these widths."""

_DRAWS, _MANY_DRAWS = 200, 2000
"""Of measurements by all hypotheses together: to choose by, and of what is said of the chosen."""

SURE = 0.95
"""The chance that counts as settled: that of an interval."""

MOST_REPEATS = 100

LITTLE = 0.01
"""A share that is no gain: a hundredth is what laws are left out for."""

_CHECKS = 2
"""How often an experiment that seems best is checked: by fits of laws from its start, and from several."""

_EXCHANGES = 2
"""How often each of several experiments may be exchanged for another."""

_FAR = 1000
"""A forecast that goes so many times farther than states have been, or start from, diverges: what a law says there,
linearised about its coefficients, means nothing, and rivals on their way to infinity take steps without end."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An experiment, and what each hypothesis says of its trials: first by hypothesis, then by trial.

    It is checked so often whether laws, fitted to what the first of them says, imitate it.
    """

    experiment: Experiment
    point: Floats
    said: tuple[tuple[Gaussian, ...], ...]
    checked: int = 0

    def repeated(self, times: int) -> "Candidate":
        """Return the same experiment made so many times."""
        said = tuple(tuple(_repeated(each, times) for each in own) for own in self.said)
        return Candidate(self.experiment, self.point, said)


def _repeated(each: Gaussian, times: int) -> Gaussian:
    return replace(each, repeats=times * each.repeats)


@dataclass(frozen=True, eq=False)
class Search:
    """All that experiments are chosen by.

    Parameters
    ----------
    law
        Whose settings these are.
    hypotheses
        That remain plausible.
    aim
        What is to be learned.
    settings
        What can be set.
    limits
        Of states (and rates), where trials end.
    prices, start_std
        See `Experiment.of`.
    seed
        Of the draws and of the places that are looked at.
    points
        How many experiments are looked at all over the ranges, beside their corners.
    """

    law: Law
    hypotheses: tuple[Hypothesis, ...]
    aim: Aim
    settings: Settings
    limits: Mapping[str, Range]
    prices: Mapping[str, float]
    start_std: Mapping[str, float]
    seed: int
    points: int = POINTS

    def chosen(self, count: int, budget: float, progress: Callable[[str], None]) -> list[Candidate]:
        """Return up to so many experiments within a budget, fewer where the law is settled before.

        One after the other, each given those before it; then each is exchanged for what is worth more beside all
        others, if it costs no more (Fedorov 1972).

        Raises
        ------
        CommonlawError
            If no experiment is within the budget, or hypotheses diverge in all.
        """
        found: list[Candidate] = []
        for step in range(count):
            progress(f"looking for experiment {step + 1}")
            left = budget - sum(each.experiment.cost for each in found)
            best = self._best(found, left)
            if best is None:
                break
            found.append(best)
            if self.aim.of_law and self.chance(found) >= SURE:
                break
        if not found:
            cheapest = min((each.experiment.cost for each in self._spread), default=np.nan)
            if not self._spread:
                raise CommonlawError(
                    "forecasts diverge in all these experiments: give narrower ranges, nearer to what the law was "
                    "learned from"
                )
            raise CommonlawError(
                f"no experiment costs {budget:g} or less, the cheapest {cheapest:.3g}: give a larger budget, or other "
                "ranges"
            )
        return self._exchanged(found, progress) if len(found) > 1 else found

    def _exchanged(self, found: list[Candidate], progress: Callable[[str], None]) -> list[Candidate]:
        """Return experiments that tell together what these do, or more."""
        progress("exchanging experiments")
        before = found
        for i in [i for _ in range(_EXCHANGES) for i in range(len(found))]:
            others, own = found[:i] + found[i + 1 :], found[i]
            found = [*found[:i], self._best(others, own.experiment.cost, own) or own, *found[i + 1 :]]
        return max(before, found, key=self._bits)

    def _bits(self, chosen: Sequence[Candidate]) -> float:
        evidence = self.evidence(chosen)
        return self.aim.bits(evidence) if evidence else 0.0

    @cached_property
    def _spread(self) -> list[Candidate]:
        return self.candidates(self.settings.spread(self.points, self.seed))

    def _best(self, before: Sequence[Candidate], budget: float, first: Candidate | None = None) -> Candidate | None:
        """Return the experiment within a budget that is worth most after those before it.

        That is for what it costs; or in place of a first one, whatever it costs up to that.
        """
        base, draws = self.evidence(before, _DRAWS), self._draws(_DRAWS, len(before))
        now = self.aim.bits(base) if base else 0.0

        def worth(each: Candidate) -> float:
            own = self._evidence_of(each, draws)
            bits = self.aim.bits(base + own if base else own) - now
            return bits if first else bits / (each.experiment.cost or 1.0)

        checks, enough = (_CHECKS, 1 + LITTLE) if self.aim.of_law else (0, 1.0)
        best, most = first, worth(first) if first else -np.inf
        listed = self._spread
        for round_, width in enumerate((*_WIDTHS, None)):
            values = [worth(each) if each.experiment.cost <= budget else -np.inf for each in listed]
            while values and max(values) > (most * enough if most > 0 else most):
                i = values.index(max(values))
                while listed[i].checked < checks and values[i] > most:
                    listed[i] = self._checked(listed[i])
                    values[i] = worth(listed[i])
                if values[i] > most:
                    best, most = listed[i], values[i]
                values[i] = -np.inf
            if best is None or width is None or not len(best.point):
                break
            listed = self.candidates(self.settings.near(best.point, width, self.points // _SHARE, self.seed + round_))
        return best

    def _checked(self, each: Candidate) -> Candidate:
        """Return an experiment with laws fitted to what the first says of it, the next time thoroughly."""
        said, checks = [each.said[0]], each.checked + 1
        for own, before in zip(self.hypotheses[1:], each.said[1:], strict=True):
            (found,) = own.says([each.experiment], self._farthest, [each.said[0]], thoroughly=checks == _CHECKS)
            said.append(found or before)
        return Candidate(each.experiment, each.point, tuple(said), checks)

    def candidates(self, points: Floats) -> list[Candidate]:
        """Return the experiments at points of the settings, but those in which a hypothesis diverges."""
        experiments = [
            Experiment.of(self.law, self.settings.objects, self.settings.at(point), self.prices, self.start_std)
            for point in points
        ]
        experiments = self.hypotheses[0].within(experiments, self.limits)
        left, said = list(range(len(experiments))), [list[tuple[Gaussian, ...]]() for _ in experiments]
        for each in self.hypotheses:
            found = each.says([experiments[i] for i in left], self._farthest)
            for i, own in zip(left, found, strict=True):
                said[i] += [] if own is None else [own]
            left = [i for i, own in zip(left, found, strict=True) if own is not None]
        return [Candidate(experiments[i], points[i], tuple(said[i])) for i in left]

    @cached_property
    def _farthest(self) -> float | None:
        """How large a state may become, if it is known where they have been."""
        names, visited = self.law.terms.variables.states, self.law.provenance.domain.visited
        been = [value for name in names for value in visited.get(name, ())]
        starts = [value for name in names for value in numbers_of(self.settings.options.get(name, ()))]
        return _FAR * float(np.abs([*been, *starts]).max()) if been else None

    def chance(self, chosen: Sequence[Candidate], draws: int = _MANY_DRAWS) -> float:
        """Return how probable it is that the right law is the most probable after these experiments."""
        found = self.evidence(chosen, draws)
        return float(self.aim.prior.max()) if found is None else found.chance(self.aim.prior)

    def evidence(self, chosen: Sequence[Candidate], draws: int = _MANY_DRAWS) -> Evidence | None:
        """Return what experiments say together; nothing if there is none."""
        found = None
        for i, each in enumerate(chosen):
            own = self._evidence_of(each, self._draws(draws, i))
            found = found + own if found else own
        return found

    def _evidence_of(self, each: Candidate, draws: Sequence[Draws]) -> Evidence:
        trials = list(zip(*each.said, strict=True))
        found = Evidence.of(trials[0], draws[0])
        for i, trial in enumerate(trials[1:], start=1):
            found += Evidence.of(trial, draws[i])
        return found

    def _draws(self, count: int, step: int) -> list[Draws]:
        """Return draws for every trial of an experiment, of which each object makes one at most."""
        sizes = [each.unknowns for each in self.hypotheses]
        own, each = range(len(self.settings.objects)), -(-count // len(sizes))
        return [Draws.of(sizes, MOST, each, (self.seed, count), step * len(own) + i) for i in own]

    def repeats(self, chosen: Sequence[Candidate]) -> int | None:
        """Return how often all must be made for a chance that counts as settled; None if `MOST_REPEATS` do not do."""

        def settled(times: int) -> bool:
            return self.chance([each.repeated(times) for each in chosen]) >= SURE

        if settled(1):
            return 1
        low, high = 1, 2
        while not settled(high):
            if high == MOST_REPEATS:
                return None
            low, high = high, min(2 * high, MOST_REPEATS)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if settled(middle) else (middle, high)
        return high

    def limit(self) -> float:
        """Return the largest chance that one experiment gives, made `MOST_REPEATS` times."""
        return max(self.chance([each.repeated(MOST_REPEATS)], _DRAWS) for each in self._spread)
