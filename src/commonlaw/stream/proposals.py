"""The law of a stream of many objects: proposed by groups of them, chosen by its evidence over all."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TypedDict

from commonlaw.array_types import Bools, evenly_spaced
from commonlaw.forecast.population import with_pooled_forecasts
from commonlaw.inference import (
    compare_by_parts,
    fitted_by_parts,
    refine,
    typical,
    written_alike,
)
from commonlaw.law import Law, Step
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.runtime.fit_options import CovarianceKind, ErrorKind
from commonlaw.runtime.progress import ProgressCallback, part, silent, unannounced
from commonlaw.text import counted
from commonlaw.trials import Trials, TrialStream

_GROUPS, _OBJECTS = 4, 10
"""Groups of objects that propose laws, each from a part of its own, and objects of each."""

_PROPOSED, _JUDGED = 0.2, 0.4
"""Shares of the time after which laws are proposed, and judged. They are only shown."""


class Fitting(TypedDict):
    """How parts are fitted: keyword arguments of `refine`, the first three of `compare`, too."""

    noise: Mapping[str, float] | None
    errors: ErrorKind
    huber_threshold: float
    covariance: CovarianceKind
    seed: int


def law_of_parts(
    trials: TrialStream,
    find: Callable[[Trials], Law],
    fitting: Fitting,
    universal: Callable[[Law], Bools],
    pooling: bool,
    progress: ProgressCallback,
) -> Law:
    """Return the law of all objects in the parts of a stream, each object in one part.

    Only laws, evidences and coefficients leave the parts.

    Raises `CommonlawError` if an object is in two parts, or what a part raises.

    Parameters
    ----------
    trials
        What was measured.
    find
        Finds the law of some objects.
    fitting
        How its coefficients are fitted in each part.
    universal
        Which coefficients of a law all objects have in common, shape (equations, terms).
    pooling
        Whether forecasts draw the other coefficients to their means over objects.
    progress
        Takes the text of each step.
    """
    parts = trials.parts or (trials,)
    some = [parts[i] for i in evenly_spaced(len(parts), _GROUPS)]
    tell = part(progress, 0.0, _PROPOSED)
    laws = done_in_parts(partial(_proposed, find), some, "seeking laws of groups of objects", tell)
    proposed = {tuple(law.structure): law for law in reversed(laws)}
    what = f"{counted(len(proposed), 'law')} of {counted(len(some), 'group')} of at most {_OBJECTS} objects"
    steps = [Step("proposals", what, "terms proposed by a search among few objects")]
    best = next(iter(proposed.values()))
    if len(proposed) > 1:
        best, step = _judged(parts, proposed, fitting, part(progress, _PROPOSED, _JUDGED))
        steps.append(step)
    law = fitted_by_parts([partial(_fitted, best, fitting)] * len(parts), parts, part(progress, _JUDGED, 1.0))
    provenance = replace(
        best.provenance, domain=law.provenance.domain, outcomes=(), alternatives=(), history=(*best.history, *steps)
    )
    law = replace(law, provenance=provenance)
    return with_pooled_forecasts(law, universal(law), pooling)


def _proposed(find: Callable[[Trials], Law], part: TrialStream) -> Law:
    """Return the law of the first objects of a part, with no other terms than its own."""
    trials = part.read()
    with unannounced():
        law = find(trials.with_trials([each for name in trials.objects[:_OBJECTS] for each in trials.of_object(name)]))
    return replace(written_alike(law, law.schema), provenance=law.provenance)


def _judged(
    parts: Sequence[TrialStream], proposed: Mapping[tuple[str, ...], Law], fitting: Fitting, progress: ProgressCallback
) -> tuple[Law, Step]:
    """Return the law of largest evidence over all parts, and what is said of that."""
    names = {"; ".join(structure): law for structure, law in proposed.items()}
    settings = {name: fitting[name] for name in ("noise", "errors", "huber_threshold")}
    frame = compare_by_parts(names, parts, settings, progress)
    (first, second), evidence = frame["law"][:2], frame["2 log B"][1]
    reason = f"2 log B = {evidence:.4g} for it over {second}, summed over {counted(len(parts), 'part')}"
    return names[first], Step("support", first, reason)


def _fitted(law: Law, fitting: Fitting, trials: Trials) -> Law:
    """Return a law fitted to the objects of a part, each of which begins as the typical one."""
    return refine(typical(law, trials.objects), trials, **fitting, partial_pooling=False, progress=silent)
