"""Fits of a stream part by part, each object in one part, and the law of all objects."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain
from typing import Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.law import Law, Misfit, Provenance, Uncertainty, average_law
from commonlaw.law.objects import of_all_objects
from commonlaw.law.provenance import Domain
from commonlaw.likelihood import ErrorModel
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.progress import ProgressCallback, unannounced
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.stream import objects_of_parts


def typical(law: Law, objects: tuple[str, ...]) -> Law:
    """Return the law with the average coefficients of a law for each of these objects; known ones stay known."""
    mean, count = average_law(law), len(objects)
    covariance = mean.uncertainty.known_covariance()
    return replace(
        mean,
        objects=objects,
        coefficients=np.repeat(mean.coefficients, count, axis=0),
        uncertainty=Uncertainty(np.repeat(covariance, count, axis=0)),
        provenance=Provenance(),
    )


def objects_apart(parts: Sequence[TrialStream], progress: ProgressCallback) -> list[tuple[str, ...]]:
    """Return the names of the objects of each part.

    Raises `CommonlawError` if an object is in two parts.
    """
    names = objects_of_parts(parts, progress)
    twice = [name for name, count in Counter(chain.from_iterable(names)).items() if count > 1]
    if twice:
        raise CommonlawError("object-in-two-files", object=twice[0])
    return names


def fitted_by_parts(
    fits: Sequence[Callable[[Trials], Law]],
    parts: Sequence[TrialStream],
    progress: ProgressCallback,
    errors: ErrorKind | Literal["auto"] = "auto",
) -> Law:
    """Return the law of the objects of all parts; each part has a function that fits its trials, and can be pickled.

    Objects are those of `objects_apart`. Noise and other errors are root mean squares over parts, weighted by their
    samples; under ``errors="by-object"`` or ``"by-trial"``, or if it differs in one of them, each object keeps the
    noise of its part.
    """
    fitted = done_in_parts(_fitted, list(zip(fits, parts, strict=True)), "fitting objects", progress)
    laws = [law for law, _ in fitted]
    objects = tuple(name for law in laws for name in law.objects)
    coefficients, covariance = of_all_objects(laws)
    weights, known = np.array([samples for _, samples in fitted], dtype=np.float64), [law.uncertainty for law in laws]
    degrees = [uncertainty.degrees_of_freedom for uncertainty in known if uncertainty.degrees_of_freedom is not None]
    ranges = [law.provenance.domain.visited for law in laws]
    visited = {
        name: (min(interval[name][0] for interval in ranges), max(interval[name][1] for interval in ranges))
        for name in ranges[0]
    }
    unknown = np.full(len(laws[0].schema.states), np.nan)
    levels = [unknown if uncertainty.noise is None else uncertainty.noise for uncertainty in known]
    noise, error_model = _root_mean_square(weights, levels), _errors(weights, [part.error_model for part in known])
    is_grouped = errors in ("by-object", "by-trial") or any(part.error_model.by_object for part in known)
    if noise is not None and is_grouped:
        by_object, by_trial = dict[str, Floats](), dict[str, Floats]()
        for law, part, level in zip(laws, known, levels, strict=True):
            relative, of_part = np.nan_to_num(level / noise, nan=1.0), part.error_model
            by_object |= {name: of_part.noise_of(name, relative) for name in law.objects}
            by_trial |= {label: relative * factors for label, factors in of_part.by_trial.items()}
        error_model = replace(error_model, by_object=by_object, by_trial=by_trial)
    return replace(
        laws[0],
        objects=objects,
        coefficients=coefficients,
        uncertainty=Uncertainty(
            covariance,
            noise=noise,
            error_model=error_model,
            huber_threshold=known[0].huber_threshold,
            degrees_of_freedom=np.sum(degrees, axis=0) if len(degrees) == len(laws) else None,
            misfit=_misfit(weights, [uncertainty.misfit for uncertainty in known]),
        ),
        provenance=replace(laws[0].provenance, domain=Domain(visited), outcomes=(), alternatives=()),
        properties={name: attribute for law in laws for name, attribute in law.properties.items()},
    )


def _fitted(piece: tuple[Callable[[Trials], Law], TrialStream]) -> tuple[Law, int]:
    """Return a law fitted to a part, without its large members, and the number of samples."""
    fit, trials = piece[0], piece[1].read()
    with unannounced():
        law = fit(trials)
    known = law.uncertainty
    uncertainty = Uncertainty(
        known.known_covariance(),
        noise=known.noise,
        error_model=known.error_model,
        huber_threshold=known.huber_threshold,
        degrees_of_freedom=known.degrees_of_freedom,
        misfit=known.misfit,
    )
    return replace(law, uncertainty=uncertainty, properties=trials.properties), sum(map(len, trials))


def _misfit(weights: Floats, parts: Sequence[Misfit | None]) -> Misfit | None:
    """Return the misfit of all parts; None if one has none, as laws in discrete time."""
    listed = [part for part in parts if part is not None]
    signal = _root_mean_square(weights, [part.signal for part in listed]) if len(listed) == len(parts) else None
    if signal is None:
        return None
    return Misfit(
        signal,
        float(np.average([part.duration for part in listed], weights=weights)),
        sum(part.outliers for part in listed),
        sum(part.measurements for part in listed),
        _root_mean_square(weights, [part.deviation for part in listed]),
    )


def _errors(weights: Floats, parts: Sequence[ErrorModel]) -> ErrorModel:
    """Return the error model of all parts; correlation times are means over the parts that have them.

    Slopes of drifts are about zero: their means are those of one part.
    """
    kinds = dict.fromkeys(kind for part in parts for kind in part.heteroscedastic)
    grown = {kind: _root_mean_square(weights, [part.heteroscedastic.get(kind) for part in parts]) for kind in kinds}
    slopes = [None if part.slope is None else part.root_mean_square_slope for part in parts]
    correlated, force, walk, sensor_walk, offset = (
        _root_mean_square(weights, [getattr(part, kind) for part in parts])
        for kind in ("correlated", "force", "walk", "sensor_walk", "offset")
    )
    return ErrorModel(
        {kind: level for kind, level in grown.items() if level is not None},
        correlated=correlated,
        force=force,
        walk=walk,
        sensor_walk=sensor_walk,
        offset=offset,
        slope=_root_mean_square(weights, slopes),
        memory=_mean(weights, [part.memory for part in parts]),
        force_time=_mean(weights, [part.force_time for part in parts]),
    )


def _root_mean_square(weights: Floats, values: Sequence[Floats | None]) -> Floats | None:
    """Return the weighted root mean square; None counts as zero, and is returned if all are None."""
    size = next((np.zeros_like(value) for value in values if value is not None), None)
    if size is None:
        return None
    squares = np.array([size if value is None else value**2 for value in values])
    return np.asarray(np.sqrt(weights @ squares / weights.sum()))


def _mean(weights: Floats, times: Sequence[float]) -> float:
    finite = np.isfinite(times)
    return float(np.average(np.array(times)[finite], weights=weights[finite])) if finite.any() else np.inf
