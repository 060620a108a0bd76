"""Laws of more objects than one fit holds: proposed by groups of objects, judged by all, fitted part by part."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.cluster import done_in_parts
from commonlaw.effort import unannounced
from commonlaw.errors import CommonlawError
from commonlaw.inference import CovarianceKind, ErrorKind, compare, refine, written_alike
from commonlaw.law import Law, Provenance, Step, Uncertainty
from commonlaw.law.domain import Domain
from commonlaw.progress import ProgressCallback, part
from commonlaw.spacing import evenly_spaced
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.trial import ObjectProperties
from commonlaw.wording import counted

_GROUPS, _OBJECTS = 4, 10
"""Groups of objects that propose laws, each from a part of its own, and objects of each."""

_PROPOSED, _JUDGED = 0.2, 0.4
"""Shares of the time after which laws are proposed, and judged. They are only shown."""


@dataclass(frozen=True)
class Fitting:
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
        Whether the other coefficients are drawn to their means over objects.
    progress
        Takes the text of each step.

    Raises
    ------
    CommonlawError
        If an object is in two parts, or what a part raises.
    """
    parts = trials.parts or (trials,)
    some = [parts[i] for i in evenly_spaced(len(parts), _GROUPS)]
    tell = part(progress, 0.0, _PROPOSED)
    laws = done_in_parts(partial(_proposed, find), some, "seeking laws of groups of objects", tell)
    proposed = {law.structure(): law for law in reversed(laws)}
    what = f"{counted(len(proposed), 'law')} of {counted(len(some), 'group')} of at most {_OBJECTS} objects"
    steps = [Step("proposals", what, "a search among few objects shows the terms that all have")]
    best = next(iter(proposed.values()))
    if len(proposed) > 1:
        best, step = _judged(parts, proposed, fitting, part(progress, _PROPOSED, _JUDGED))
        steps.append(step)
    fitted = done_in_parts(partial(_fitted, best, fitting), parts, "fitting objects", part(progress, _JUDGED, 1.0))
    law = _joined(fitted, best)
    law = replace(law, provenance=replace(law.provenance, history=(*best.history, *steps)))
    return law.partial_pooling(universal(law), pooling)


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
    judge = partial(_evidences, names, fitting)
    total = dict.fromkeys(names, 0.0)
    for own in done_in_parts(judge, parts, f"weighing {len(names)} laws", progress):
        for name, value in own.items():
            total[name] += value
    (first, least), (second, other), *_ = sorted(total.items(), key=lambda each: each[1])
    reason = f"2 log B = {other - least:.4g} for it over {second}, summed over {counted(len(parts), 'part')}"
    return names[first], Step("support", first, reason)


def _evidences(laws: Mapping[str, Law], fitting: Fitting, part: TrialStream) -> dict[str, float]:
    """Return minus twice the log-evidence of each law in a part, up to a constant that they share."""
    trials = part.read()
    given = {name: _typical(law, trials.objects) for name, law in laws.items()}
    with unannounced():
        frame = compare(
            given, trials, noise=fitting.noise, errors=fitting.errors, huber_threshold=fitting.huber_threshold
        )
    return dict(zip(frame["law"], frame["2 log B"], strict=True))


@dataclass(frozen=True, eq=False)
class _Part:
    """What a part comes to: of each object coefficients and their covariance, of all noise, samples and domain."""

    objects: tuple[str, ...]
    coefficients: Floats
    covariance: Floats
    noise: Floats
    samples: int
    domain: Domain
    properties: ObjectProperties


def _fitted(law: Law, fitting: Fitting, part: TrialStream) -> _Part:
    """Return what a law's coefficients are for the objects of a part."""
    trials = part.read()
    with unannounced():
        found = refine(
            _typical(law, trials.objects),
            trials,
            noise=fitting.noise,
            errors=fitting.errors,
            huber_threshold=fitting.huber_threshold,
            covariance=fitting.covariance,
            seed=fitting.seed,
            partial_pooling=False,
            progress=lambda _: None,
        )
    known, noise = found.uncertainty.known_covariance(), found.uncertainty.noise
    levels = np.full(len(found.states), np.nan) if noise is None else noise
    samples = sum(map(len, trials))
    return _Part(found.objects, found.coefficients, known, levels, samples, found.provenance.domain, trials.properties)


def _typical(law: Law, objects: tuple[str, ...]) -> Law:
    """Return the law in which each of these objects is the typical one; what is known of all stays known."""
    mean, count = law.average(), len(objects)
    covariance = mean.uncertainty.known_covariance()
    return replace(
        mean,
        objects=objects,
        coefficients=np.repeat(mean.coefficients, count, axis=0),
        uncertainty=Uncertainty(np.repeat(covariance, count, axis=0)),
        provenance=Provenance(),
    )


def _joined(parts: Sequence[_Part], law: Law) -> Law:
    """Return the law of the objects of all parts."""
    objects = tuple(name for each in parts for name in each.objects)
    twice = [name for name, count in Counter(objects).items() if count > 1]
    if twice:
        raise CommonlawError(
            f"{twice[0]} has trials in two files: put all trials of an object into one file, or take "
            "method=DerivativeRegression(), which needs no such order"
        )
    weights = np.array([each.samples for each in parts], dtype=np.float64)
    noise = np.sqrt(weights @ np.array([each.noise**2 for each in parts]) / weights.sum())
    ranges = [each.domain.visited for each in parts]
    visited = {
        name: (min(each[name][0] for each in ranges), max(each[name][1] for each in ranges)) for name in ranges[0]
    }
    return replace(
        law,
        objects=objects,
        coefficients=np.concatenate([each.coefficients for each in parts]),
        uncertainty=Uncertainty(np.concatenate([each.covariance for each in parts]), noise=noise),
        provenance=replace(law.provenance, domain=Domain(visited), outcomes=(), alternatives=()),
        properties={name: own for each in parts for name, own in each.properties.items()},
    )
