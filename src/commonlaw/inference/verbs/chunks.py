"""Laws that are fitted part by part, each object in one part: what parts come to, and the law of all objects."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.law import Law, Provenance, Uncertainty, average_law
from commonlaw.law.provenance import Domain
from commonlaw.likelihood import ErrorModel
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.runtime.progress import ProgressCallback, unannounced
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.trial import ObjectProperties


@dataclass(frozen=True, eq=False)
class LawOfPart:
    """What a part comes to: of each object coefficients and their covariance, of all errors, samples and domain.

    `form` is the law of its first object.
    """

    form: Law
    objects: tuple[str, ...]
    coefficients: Floats
    covariance: Floats
    noise: Floats
    error_model: ErrorModel
    degrees_of_freedom: Floats | None
    samples: int
    domain: Domain
    properties: ObjectProperties

    @classmethod
    def of(cls, law: Law, trials: Trials) -> "LawOfPart":
        """Return what a law says that was fitted to the trials of a part."""
        known = law.uncertainty
        return cls(
            law.select(law.objects[:1]),
            law.objects,
            law.coefficients,
            known.known_covariance(),
            np.full(len(law.schema.states), np.nan) if known.noise is None else known.noise,
            known.error_model,
            known.degrees_of_freedom,
            sum(map(len, trials)),
            law.provenance.domain,
            trials.properties,
        )


def typical(law: Law, objects: tuple[str, ...]) -> Law:
    """Return the law in which each of these objects is the typical one; what is known of all stays known."""
    mean, count = average_law(law), len(objects)
    covariance = mean.uncertainty.known_covariance()
    return replace(
        mean,
        objects=objects,
        coefficients=np.repeat(mean.coefficients, count, axis=0),
        uncertainty=Uncertainty(np.repeat(covariance, count, axis=0)),
        provenance=Provenance(),
    )


def law_of_all(parts: Sequence[LawOfPart]) -> Law:
    """Return the law of the objects of all parts, which have the same terms.

    Noise and other errors are root mean squares over parts, weighted by their samples.

    Raises
    ------
    CommonlawError
        If an object is in two parts.
    """
    objects = tuple(name for each in parts for name in each.objects)
    twice = [name for name, count in Counter(objects).items() if count > 1]
    if twice:
        raise CommonlawError("object-in-two-files", object=twice[0])
    weights = np.array([each.samples for each in parts], dtype=np.float64)
    degrees = [each.degrees_of_freedom for each in parts if each.degrees_of_freedom is not None]
    ranges = [each.domain.visited for each in parts]
    visited = {
        name: (min(each[name][0] for each in ranges), max(each[name][1] for each in ranges)) for name in ranges[0]
    }
    law = parts[0].form
    return replace(
        law,
        objects=objects,
        coefficients=np.concatenate([each.coefficients for each in parts]),
        uncertainty=Uncertainty(
            np.concatenate([each.covariance for each in parts]),
            noise=_root_mean_square(weights, [each.noise for each in parts]),
            error_model=_errors(weights, [each.error_model for each in parts]),
            degrees_of_freedom=np.sum(degrees, axis=0) if len(degrees) == len(parts) else None,
        ),
        provenance=replace(law.provenance, domain=Domain(visited), outcomes=(), alternatives=()),
        properties={name: own for each in parts for name, own in each.properties.items()},
    )


def fitted_by_parts(
    fits: Sequence[Callable[[Trials], Law]], parts: Sequence[TrialStream], progress: ProgressCallback
) -> Law:
    """Return the law of the objects of all parts; each part has a function that fits its trials, and can be pickled."""
    return law_of_all(done_in_parts(_fitted, list(zip(fits, parts, strict=True)), "fitting objects", progress))


def _fitted(piece: tuple[Callable[[Trials], Law], TrialStream]) -> LawOfPart:
    trials = piece[1].read()
    with unannounced():
        return LawOfPart.of(piece[0](trials), trials)


def _errors(weights: Floats, parts: Sequence[ErrorModel]) -> ErrorModel:
    """Return the errors of all parts; times are means over those that have such errors."""
    kinds = dict.fromkeys(kind for each in parts for kind in each.heteroscedastic)
    grown = {kind: _root_mean_square(weights, [each.heteroscedastic.get(kind) for each in parts]) for kind in kinds}
    levels = {
        kind: _root_mean_square(weights, [getattr(each, kind) for each in parts])
        for kind in ("correlated", "force", "walk")
    }
    return ErrorModel(
        {kind: level for kind, level in grown.items() if level is not None},
        **levels,
        memory=_mean(weights, [each.memory for each in parts]),
        force_time=_mean(weights, [each.force_time for each in parts]),
    )


def _root_mean_square(weights: Floats, values: Sequence[Floats | None]) -> Floats | None:
    """Return the root mean square of some values, None being zero; None if all are."""
    size = next((np.zeros_like(each) for each in values if each is not None), None)
    if size is None:
        return None
    squares = np.array([size if each is None else each**2 for each in values])
    return np.asarray(np.sqrt(weights @ squares / weights.sum()))


def _mean(weights: Floats, times: Sequence[float]) -> float:
    finite = np.isfinite(times)
    return float(np.average(np.array(times)[finite], weights=weights[finite])) if finite.any() else np.inf
