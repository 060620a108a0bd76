"""The experiments that are worth most: each given those before it, then each given all others."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, reduce
from itertools import chain
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.experiments.aims import Aim
from commonlaw.experiments.experiment import Experiment, Range, Settings, numbers_of
from commonlaw.experiments.gaussian import Draws, Evidence, Gaussian
from commonlaw.experiments.predictive import MAX_MEASUREMENTS, Hypothesis
from commonlaw.law import Law
from commonlaw.runtime.forking import cached_property

POINTS = 256
"""Experiments that are looked at all over the ranges."""


class Effort(NamedTuple):
    """How many measurements all hypotheses together make, with all of them refitted to each.

    To look at an experiment that seems best, 0 without refits; to choose by; and for what is said of the chosen. After
    `patience` experiments in a row that are no better than the best, no more are looked at.
    """

    look: int = 16
    choose: int = 64
    report: int = 192
    patience: int = 6


USUAL_EFFORT = Effort()


_DRAWS = 64
"""Draws by which linearized information is averaged."""

SETTLED = 0.95
"""The chance that counts as settled: that of an interval."""

MAX_REPEATS = 100

MIN_RELATIVE_GAIN = 0.01
"""A share that is no gain: a hundredth is what laws are left out for."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An experiment, and what each hypothesis predicts of its trials: first by hypothesis, then by trial.

    Its information follows by linearization, or, where so many draws are simulated, by refitting all laws.
    """

    experiment: Experiment
    point: Floats
    predicted: tuple[tuple[Gaussian, ...], ...]
    simulated: int = 0

    @property
    def linearized(self) -> "Candidate":
        """The same experiment, whose information follows by linearization."""
        return replace(self, simulated=0)

    @cached_property
    def repeated(self) -> "Callable[[int], Candidate]":
        """The same experiment made so many times, by this number."""

        def repeated(times: int) -> Candidate:
            predicted = tuple(
                tuple(replace(gaussian, repeats=times * gaussian.repeats) for gaussian in by_object)
                for by_object in self.predicted
            )
            return replace(self, experiment=self.experiment.repeated(times), predicted=predicted)

        return cache(lambda times: self if times == 1 else repeated(times))


Chosen = Sequence[Candidate | None]
"""Experiments in order; nothing in the place of one that is sought."""


@dataclass(frozen=True, eq=False)
class Search:
    """All that experiments are chosen by.

    For `settings`, `limits` of states and rates, where trials end, `unit_costs` and `start_std` see `design`. The seed
    is that of the draws and of the places that are examined, `points` all over the ranges, besides their corners; these
    are taken `over` from a search with another aim, if one is given.
    """

    law: Law
    hypotheses: tuple[Hypothesis, ...]
    aim: Aim
    settings: Settings
    limits: Mapping[str, Range]
    unit_costs: Mapping[str, float]
    start_std: Mapping[str, float]
    seed: int
    points: int = POINTS
    effort: Effort = USUAL_EFFORT
    over: "Search | None" = None

    def chosen(self, count: int, budget: float, progress: Callable[[str], None]) -> list[Candidate]:
        """Return up to so many experiments within a budget, fewer where the law is settled before.

        Each is chosen given those before it, then exchanged for a better one that costs no more (Fedorov 1972). Raises
        `CommonlawError` if none is within the budget, or hypotheses diverge in all.
        """
        picked: list[Candidate] = []
        for step in range(count):
            progress(f"looking for experiment {step + 1}")
            best = self._best([*picked, None], budget - sum(candidate.experiment.cost for candidate in picked))
            if best is None:
                break
            picked.append(best)
            if self.aim.of_law and self.chance(picked) >= SETTLED:
                break
        if not picked:
            cheapest = min((candidate.experiment.cost for candidate in self._spread), default=np.nan)
            if not self._spread:
                raise CommonlawError("design-diverges")
            raise CommonlawError("design-too-expensive", budget=budget, cheapest=cheapest)
        if len(picked) == 1:
            return picked
        progress("exchanging experiments")
        exchanged = picked
        for i in [*range(len(picked))] * 2:
            candidate = exchanged[i]
            best = self._best([*exchanged[:i], None, *exchanged[i + 1 :]], candidate.experiment.cost, candidate)
            exchanged = [*exchanged[:i], best or candidate, *exchanged[i + 1 :]]
        return max(picked, exchanged, key=lambda chosen: self.aim.bits(self.evidence(chosen)))

    @cached_property
    def _spread(self) -> list[Candidate]:
        if self.over is not None:
            return self.over._spread
        return self.candidates(self.settings.spread(self.points, self.seed))

    def _best(self, chosen: Chosen, budget: float, first: Candidate | None = None) -> Candidate | None:
        """Return the experiment of most information for its cost, given others and within a budget.

        In place of a first one its cost counts only as a limit.
        """
        place = chosen.index(None)
        simulated = [*dict.fromkeys(self.effort[:2])] if self.aim.of_law and self.effort.look else []
        evidences = {draws: self._evidences(chosen, draws) for draws in (*simulated, _DRAWS)}
        others = {draws: [_sum(parts)] if parts else [] for draws, parts in evidences.items()}

        def worth(candidate: Candidate) -> float:
            draws = candidate.simulated or _DRAWS
            base, evidence = others[draws], self._evidence_of(candidate, draws, place)
            bits = self.aim.bits(_sum([*base, evidence])) - (self.aim.bits(base[0]) if base else 0.0)
            return bits if first else bits / (candidate.experiment.cost or 1.0)

        enough = 1 + MIN_RELATIVE_GAIN if self.aim.of_law else 1.0
        best, most = first, worth(first) if first else -np.inf
        listed = [*self._spread]
        # Then an eighth as many in each of the narrowing surroundings of the best
        for round_, width in enumerate((0.2, 0.05, None)):
            values = [worth(candidate) if candidate.experiment.cost <= budget else -np.inf for candidate in listed]
            failed = 0
            # No more are simulated after some in a row that tell no more than the best so far
            while failed < self.effort.patience and max(values, default=-np.inf) > (
                most * enough if most > 0 else most
            ):
                i = values.index(max(values))
                for draws in simulated:
                    if values[i] > most and listed[i].simulated < draws:
                        listed[i] = replace(listed[i], simulated=draws)
                        values[i] = worth(listed[i])
                failed += 1
                if values[i] > most:
                    best, most, failed = listed[i], values[i], 0
                values[i] = -np.inf
            if best is None or width is None or not len(best.point):
                break
            listed = self.candidates(self.settings.near(best.point, width, self.points // 8, self.seed + round_))
        return best

    def candidates(self, points: Floats) -> list[Candidate]:
        """Return the experiments at points of the settings, but those in which a hypothesis diverges."""
        experiments = [
            Experiment.of(self.law, self.settings.objects, self.settings.at(point), self.unit_costs, self.start_std)
            for point in points
        ]
        experiments = self.hypotheses[0].within(experiments, self.limits)
        kept, predicted = list(range(len(experiments))), [list[tuple[Gaussian, ...]]() for _ in experiments]
        for hypothesis in self.hypotheses:
            predictions = hypothesis.predictions([experiments[i] for i in kept], self._farthest)
            for i, prediction in zip(kept, predictions, strict=True):
                predicted[i] += [] if prediction is None else [prediction]
            kept = [i for i, prediction in zip(kept, predictions, strict=True) if prediction is not None]
        return [Candidate(experiments[i], points[i], tuple(predicted[i])) for i in kept]

    @cached_property
    def _farthest(self) -> float | None:
        """How large a state may become, if it is known where they have been: a thousand times larger.

        What a law predicts beyond, linearised about its coefficients, means nothing, and rivals on their way to
        infinity take steps without end.
        """
        names, visited = self.law.terms.variables.states, self.law.provenance.domain.visited
        been = [value for name in names for value in visited.get(name, ())]
        been += self.law.provenance.domain.sizes.values()
        starts = [value for name in names for value in numbers_of(self.settings.options.get(name, ()))]
        return 1000 * float(np.abs([*been, *starts]).max()) if been else None

    def chance(self, chosen: Chosen, draws: int | None = None) -> float:
        """Return how probable it is that the right law is the most probable after these experiments."""
        return self.evidence(chosen, draws).chance(self.aim.prior)

    def evidence(self, chosen: Chosen, draws: int | None = None) -> Evidence:
        """Return what experiments, one or more, say together."""
        return _sum(self._evidences(chosen, self.effort.report if draws is None else draws))

    def _evidences(self, chosen: Chosen, draws: int) -> list[Evidence]:
        return [self._evidence_of(candidate, draws, i) for i, candidate in enumerate(chosen) if candidate is not None]

    def _evidence_of(self, each: Candidate, count: int, place: int) -> Evidence:
        """Return the evidence of an experiment, with so many draws, in its place among others."""
        if each.simulated:
            return self._simulated(each.experiment, count, place)
        draws = self._draws(count, place)
        pairs = zip(zip(*each.predicted, strict=True), draws, strict=False)
        return _sum(Evidence.of(trial, draw) for trial, draw in pairs)

    @cached_property
    def _simulated(self) -> Callable[[Experiment, int, int], Evidence]:
        """The evidence of an experiment, with laws fitted to measurements that each of them makes."""
        return lru_cache(32)(self._simulate)

    def _simulate(self, experiment: Experiment, count: int, place: int) -> Evidence:
        draws, laws, limit = self._draws(count, place), self.hypotheses, self._farthest
        made = [law.simulated(experiment, unknown, limit) for law, unknown in zip(laws, draws[0].unknowns, strict=True)]
        measured = [
            [predicted.drawn(draw.noise[i]) for predicted, draw in zip(trials, draws, strict=False)]
            for simulated in made
            for i, (_, trials) in enumerate(simulated)
        ]
        fitted = []
        for k, law in enumerate(laws):
            at_once = law.simulated(experiment, np.zeros((1, law.unknowns)), limit)
            initial = [simulated if i == k else at_once * len(simulated) for i, simulated in enumerate(made)]
            fitted.append(law.refitted(experiment, [*chain.from_iterable(initial)], measured, limit))
        trials = range(len(experiment.objects))
        return _sum(
            Evidence.about(
                np.array([numbers[i] for numbers in measured]),
                [[gaussians[i] for gaussians in refits] for refits in fitted],
            )
            for i in trials
        )

    @cached_property
    def _draws(self) -> Callable[[int, int], list[Draws]]:
        """Draws, so many, for every trial of an experiment in a place: the same of all that are compared for it."""
        return lru_cache(32)(self._draw)

    def _draw(self, count: int, place: int) -> list[Draws]:
        """Return draws for every trial of an experiment, of which each object makes one at most.

        One draw does for one law, as its information is the same in all.
        """
        sizes = [hypothesis.unknowns for hypothesis in self.hypotheses]
        trials, per_law = range(len(self.settings.objects)), -(-count // len(sizes)) if len(sizes) > 1 else 1
        return [Draws.of(sizes, MAX_MEASUREMENTS, per_law, (self.seed, count), place * len(trials) + i) for i in trials]

    def repeats(self, chosen: Sequence[Candidate]) -> int | None:
        """Return how often all must be made for a chance that counts as settled; None if `MAX_REPEATS` do not do."""

        def settled(times: int) -> bool:
            draws = self.effort.choose if times > 1 else self.effort.report
            return self.chance([candidate.repeated(times) for candidate in chosen], draws) >= SETTLED

        def settled_if_linear(times: int) -> bool:
            return self.chance([candidate.repeated(times).linearized for candidate in chosen], _DRAWS) >= SETTLED

        if settled(1):
            return 1
        if not settled(MAX_REPEATS):
            return None
        # Exponential search from the number by linearization: few numbers are simulated
        low, high, step = 1, MAX_REPEATS, 1
        times = bisect_left(range(high), True, lo=2, key=settled_if_linear)
        while low < times < high:
            if settled(times):
                high, times = times, times - step
            else:
                low, times = times, times + step
            step *= 2
        return bisect_left(range(high), True, lo=low + 1, key=settled)

    def limit(self, chosen: Chosen) -> float:
        """Return the largest chance that is seen if experiments are made `MAX_REPEATS` times: these, or another."""
        often = [candidate.repeated(MAX_REPEATS) for candidate in self._spread]
        further = max(often, key=lambda candidate: self.chance([candidate], _DRAWS))
        these = [candidate and candidate.repeated(MAX_REPEATS) for candidate in chosen]
        draws = self.effort.choose
        further = replace(further, simulated=draws if self.effort.look else 0)
        return max(self.chance(experiments, draws) for experiments in (these, [further]))


def _sum(parts: Iterable[Evidence]) -> Evidence:
    return reduce(Evidence.__add__, parts)
