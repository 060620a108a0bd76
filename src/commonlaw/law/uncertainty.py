"""Uncertainty of a law: errors of coefficients and measurements, relations to properties, plausible laws."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation.noise import within_trial_std
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import symmetric_root
from commonlaw.hierarchy import Relation, RelationKind
from commonlaw.law.text import one_sided_text
from commonlaw.likelihood import ERRORS, HUBER_THRESHOLD, WHITE_NOISE, ErrorModel, Heteroscedastic
from commonlaw.runtime.arguments import check_whole_number
from commonlaw.trials import Trials


def checked(
    values: ArrayLike, what: str, axes: str, shape: tuple[int, ...], low: float = -np.inf, high: float = np.inf
) -> Floats:
    """Return a read-only copy of an array of this shape, refusing values that are not between `low` and `high`."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise CommonlawError("law-array-shape", array=what, shape=array.shape, axes=axes, expected=shape)
    if not np.all(np.isfinite(array)):
        raise CommonlawError("law-array-not-finite", array=what)
    if not np.all((low <= array) & (array <= high)):
        wrong = array[(array < low) | (array > high)][0]
        raise CommonlawError("law-array-range", array=what, value=wrong, low=low, high=high)
    array.flags.writeable = False
    return array


def check_positive(name: str, value: float) -> None:
    """Refuse the noise or the size of a quantity that is no positive number."""
    if not 0 < value < np.inf:
        raise CommonlawError("law-size-not-positive", name=name, value=value)


def checked_covariance(values: ArrayLike, objects: tuple[str, ...], parameters: int) -> Floats:
    """Return a read-only copy of the covariances of all objects' coefficients, symmetric to the last digit."""
    shape = (len(objects), parameters, parameters)
    matrices = checked(values, "covariance", "objects, coefficients in the law, the same", shape)
    variances = np.diagonal(matrices, axis1=1, axis2=2)
    negative = np.any(variances < 0, axis=1)
    if negative.any():
        name = objects[int(np.argmax(negative))]
        raise CommonlawError("law-variance-negative", name=name)
    errors, turned = np.sqrt(variances), matrices.transpose(0, 2, 1)
    # More than rounding leaves of a symmetric matrix
    uneven = np.abs(matrices - turned) > 1e-6 * errors[:, :, np.newaxis] * errors[:, np.newaxis]
    if uneven.any():
        name = objects[int(np.argmax(uneven.any(axis=(1, 2))))]
        raise CommonlawError("law-covariance-asymmetric", name=name)
    symmetric = matrices / 2 + turned / 2  # The sum of the largest numbers is infinite
    symmetric.flags.writeable = False
    return symmetric


@dataclass(frozen=True, eq=False)
class IntervalInflation:
    """Factors above zero by which intervals are inflated (conformal), at increasing horizons, both of shape (m,).

    They are linear between horizons, and constant beyond them.
    """

    horizons: Floats
    factors: Floats

    def checked(self) -> "IntervalInflation":
        """Return the same as read-only arrays, refusing what is no inflation."""
        arrays = [np.array(numbers, dtype=np.float64) for numbers in (self.horizons, self.factors)]
        horizons, factors = arrays
        fits = horizons.ndim == 1 and horizons.shape == factors.shape and len(horizons) > 0
        if not (fits and np.all(np.diff(horizons) > 0) and np.all(factors > 0) and np.isfinite(arrays).all()):
            raise CommonlawError("interval-inflation")
        for array in arrays:
            array.flags.writeable = False
        return IntervalInflation(horizons, factors)

    def at(self, ahead: Floats) -> Floats:
        """Return the factors so far ahead, of the shape of the horizons that are given."""
        return np.asarray(np.interp(ahead, self.horizons, self.factors))


LawType = TypeVar("LawType")


class PlausibleLaw(NamedTuple, Generic[LawType]):
    """Plausible law with its posterior probability.

    Parameters
    ----------
    probability
        Posterior probability among all plausible laws, between 0 and 1.
    law
        A law of the same objects and states. Common terms, and parameters inside them, have the same names.

    Examples
    --------
    >>> import commonlaw as cl
    >>> law = cl.Law.from_text("T' = -k T", {"k": 0.5})
    >>> [(model.probability, model.law.structure) for model in law.models]
    [(1.0, ("T' = -k T",))]
    """

    probability: float
    law: LawType


@dataclass(frozen=True)
class OneSidedLimit:
    """The only limit of an object's parameter, with 95 % confidence: it is larger (`is_lower`) or smaller than this.

    >>> OneSidedLimit("cup", "k", 3.21, is_lower=True).text
    '> 3.21 (95 %)'
    """

    object: str
    parameter: str
    value: float
    is_lower: bool

    @property
    def text(self) -> str:
        """What stands in place of an estimate with its standard error."""
        return one_sided_text(*self.interval)

    @property
    def latex(self) -> str:
        """The same as LaTeX."""
        return self.text.replace(" (", r"\ (").replace(" %", r"\,\%")

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of the interval, of which one is infinite."""
        return (self.value, np.inf) if self.is_lower else (-np.inf, self.value)

    @property
    def beyond(self) -> float:
        """A value far beyond it, where the likelihood is flat: a thousand times as large, or as small."""
        return self.value * (1e3 if (self.value > 0) == self.is_lower else 1e-3)


@dataclass(frozen=True)
class AtBound:
    """An object's parameter at its lower (`is_low`) or upper bound, and its estimate without this bound.

    The error of that is None where measurements do not determine it.
    """

    object: str
    parameter: str
    bound: float
    is_low: bool
    value: float
    error: float | None

    def limit(self, level: float, degrees_of_freedom: float) -> float:
        """Return the end of the interval of a level on the other side of the bound, NaN if it is not determined.

        The interval is of Student's t distribution about the estimate without the bound, as far as it is within.

        >>> round(AtBound("cup", "b", 0.0, True, -1.0, 1.0).limit(0.95, np.inf), 3)
        1.412
        """
        from scipy.special import stdtr, stdtrit

        side = 1 if self.is_low else -1
        if self.error is None:
            return np.nan
        inside = stdtr(degrees_of_freedom, side * (self.value - self.bound) / self.error)
        reach = -self.error * stdtrit(degrees_of_freedom, (1 - level) * float(inside))
        return float(self.value + side * reach) if np.isfinite(reach) else np.nan

    def interval(self, level: float, degrees_of_freedom: float) -> tuple[float, float]:
        """Return the ends of the interval of a level, of which one is the bound."""
        limit = self.limit(level, degrees_of_freedom)
        return (self.bound, limit) if self.is_low else (limit, self.bound)


@dataclass(frozen=True, eq=False)
class ObjectEstimates:
    """Parameters of each object, shape (objects, parameters), and their covariances."""

    coefficients: Floats
    covariance: Floats

    def checked(self, objects: tuple[str, ...], size: int) -> "ObjectEstimates":
        """Return the same as read-only arrays, for a law of these objects with so many parameters."""
        values = checked(self.coefficients, "array of estimates", "objects, parameters", (len(objects), size))
        return ObjectEstimates(values, checked_covariance(self.covariance, objects, size))


@dataclass(frozen=True, eq=False)
class Explanation:
    """The relations of a law's coefficients to its objects, see `Law.explain`.

    Parameters
    ----------
    relations
        One for each parameter, in the order of ``numpy.argwhere(law.support)``; None for known coefficients.
    covariance
        Of the factors of all relations together, shape (factors, factors).
    """

    relations: tuple[Relation | None, ...]
    covariance: Floats

    @property
    def properties(self) -> tuple[str, ...]:
        """Names of the properties that coefficients follow."""
        return tuple(dict.fromkeys(name for relation in self.relations if relation for name in relation.properties))


@dataclass(frozen=True, eq=False)
class Misfit:
    """What the trials that a law was fitted to have beyond it: sizes, besides the levels of the error model.

    Parameters
    ----------
    signal
        Standard deviation of each measured quantity within trials, shape (m,), zero of one that was never measured.
    duration
        Median duration of the trials.
    outliers, measurements
        How many outliers there are among how many measurements.
    deviation
        Of process noise: root mean square deviation of the estimated paths from the nearest solutions of the law, at
        the measurements of each measured quantity, shape (m,); None without process noise.
    """

    signal: Floats
    duration: float
    outliers: int
    measurements: int
    deviation: Floats | None = None

    @classmethod
    def of(cls, trials: Trials, outliers: int, measurements: int, deviation: Floats | None = None) -> "Misfit":
        """Return the misfit of a law that was fitted to trials."""
        duration = float(np.median([trial.times[-1] - trial.times[0] for trial in trials]))
        return cls(within_trial_std(trials), duration, outliers, measurements, deviation)


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of a law: covariance, noise and plausible alternatives; unknown parts are None.

    Parameters are the coefficients in the support of the law, in the order of ``numpy.argwhere(law.support)``.

    Parameters
    ----------
    covariance
        Of each object's parameters, shape (objects, parameters, parameters); zero for fixed or absent parameters.
    shared_factor
        Dependence between objects after partial pooling, shape (objects, parameters, columns): the covariance of the
        parameters of objects i and j is ``F_i F_j^T``. None if objects are independent.
    noise
        Standard deviation of the noise of each measured quantity, shape (m,), relative where it is log-scaled, for
        measurements without one of their own.
    noise_of
        The same by measured quantity and object, of quantities that objects have been measured differently.
    inclusion_probabilities
        Posterior probability of each term, shape (equations, terms).
    error_model
        Errors besides white noise, of the measurements and of the law itself; levels are by measured quantity.
    huber_threshold
        Residual, in standard deviations of noise, beyond which measurements are outliers: without weight in the fit,
        and counted linearly in estimates of initial values; infinite for least squares.
    unpooled
        Estimates from each object's own trials, if the coefficients are pooled or from `Law.explain`.
    pooled
        Partially pooled estimates for forecasts; None if forecasts use the coefficients of the law.
    degrees_of_freedom
        Of the noise estimate of each measured quantity, shape (m,), for Student's t distribution; of all where one has
        none of its own. None if the noise was given, for the normal distribution.
    interval_inflation
        Inflation of forecast intervals, calibrated on held-out data (conformal).
    explanation
        Relations of the coefficients to properties, from `Law.explain`.
    limits
        Of parameters that have a limit on one side only, such as rates too fast to be measured: forecasts hold these at
        their estimates, of which errors have no meaning.
    at_bounds
        Parameters at their bounds, where their errors are zero, with what limits them on the other side.
    other_laws
        Plausible laws besides this one, with posterior probabilities, see `Law.models`.
    misfit
        Sizes of what the trials have beyond the law and white noise; None if it was not fitted to any.
    """

    covariance: Floats | None = None
    shared_factor: Floats | None = None
    noise: Floats | None = None
    noise_of: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    inclusion_probabilities: Floats | None = None
    error_model: ErrorModel = WHITE_NOISE
    huber_threshold: float = HUBER_THRESHOLD
    unpooled: ObjectEstimates | None = None
    pooled: ObjectEstimates | None = None
    degrees_of_freedom: Floats | None = None
    interval_inflation: IntervalInflation | None = None
    explanation: Explanation | None = None
    limits: tuple[OneSidedLimit, ...] = ()
    at_bounds: tuple[AtBound, ...] = ()
    other_laws: tuple[PlausibleLaw[Any], ...] = ()
    misfit: Misfit | None = None

    def checked(self, objects: tuple[str, ...], support: Bools, measured: Sequence[str]) -> "Uncertainty":
        """Return the same as read-only arrays, for a law of these objects and this support, shape (equations, terms).

        Raises `CommonlawError` if an array does not fit the law, or is no covariance, noise or probability.
        """
        size, quantities, factor = int(support.sum()), (len(measured),), np.asarray(self.shared_factor)
        shared = (len(objects), size, factor.shape[2] if factor.ndim == 3 else size)
        arrays = (
            ("shared_factor", "shared factor of errors", "objects, coefficients in the law, columns", shared),
            ("noise", "noise", "measured quantities", quantities, 0),
            ("inclusion_probabilities", "array of inclusion probabilities", "equations, terms", support.shape, 0, 1),
            ("degrees_of_freedom", "degrees of freedom", "measured quantities", quantities, np.finfo(float).tiny),
        )
        known: dict[str, Any] = {
            name: checked(getattr(self, name), *how) for name, *how in arrays if getattr(self, name) is not None
        }
        if not self.huber_threshold > 0:
            raise CommonlawError("huber-threshold", value=self.huber_threshold)
        limits = tuple(limit for limit in self.limits if limit.object in objects)
        checked([limit.value for limit in limits], "array of limits", "parameters", (len(limits),))
        if self.covariance is not None:
            known["covariance"] = checked_covariance(self.covariance, objects, size)
        for name, levels in self.noise_of.items():
            check_choice("measured quantity", name, measured)
            for level in levels.values():
                check_positive(name, level)
        return replace(
            self,
            **known,
            error_model=_checked_errors(self.error_model, len(measured)),
            unpooled=self.unpooled and self.unpooled.checked(objects, size),
            pooled=self.pooled and self.pooled.checked(objects, size),
            interval_inflation=self.interval_inflation and self.interval_inflation.checked(),
            explanation=self.explanation and _checked_explanation(self.explanation, size),
            limits=limits,
            at_bounds=tuple(estimate for estimate in self.at_bounds if estimate.object in objects),
            misfit=self.misfit and _checked_misfit(self.misfit, len(measured)),
        )

    @property
    def has_std(self) -> bool:
        """Whether `Law.predict` can return standard deviations: covariance and noise are known."""
        return self.covariance is not None and self.noise is not None

    @property
    def limited_objects(self) -> set[str]:
        """Names of the objects that have only a limit of a parameter."""
        return {limit.object for limit in self.limits}

    def map_other_laws(self, change: Callable[[Any], Any]) -> tuple[PlausibleLaw[Any], ...]:
        """Return the plausible laws, the same change made to each."""
        return tuple(PlausibleLaw(law.probability, change(law.law)) for law in self.other_laws)

    def known_covariance(self) -> Floats:
        """Return the covariance, shape (objects, parameters, parameters).

        Raises `CommonlawError` if it is not known.
        """
        if self.covariance is None:
            raise CommonlawError("uncertainty-unknown")
        return self.covariance

    def own_estimates(self, coefficients: Floats) -> ObjectEstimates:
        """Return each object's own estimates, where the law has these parameters, shape (objects, parameters).

        Raises `CommonlawError` if they, or their covariance, are not known.
        """
        if self.unpooled is not None:
            return self.unpooled
        if self.shared_factor is not None:
            raise CommonlawError("own-coefficients-unknown")
        return ObjectEstimates(coefficients, self.known_covariance())

    def draws(self, coefficients: Floats, count: int, seed: int) -> Floats:
        """Return so many draws of all objects' parameters about their means, shape (count, objects, parameters).

        They are normal, or of Student's t distribution with the fewest degrees of freedom of a state's noise.
        """
        check_whole_number("seed", seed, 0, optional=True)
        random, covariance = np.random.default_rng(seed), self.known_covariance()
        result = np.tile(coefficients, (count, 1, 1))
        if self.shared_factor is not None:
            factor = self.shared_factor
            covariance = covariance - np.matmul(factor, factor.transpose(0, 2, 1))
            result += np.einsum("dk,opk->dop", random.standard_normal((count, factor.shape[2])), factor)
        result += np.einsum("dok,opk->dop", random.standard_normal(result.shape), symmetric_root(covariance))
        if self.degrees_of_freedom is not None:
            degrees = float(self.degrees_of_freedom.min())
            relative = random.chisquare(degrees, count) / degrees
            result = coefficients + (result - coefficients) / np.sqrt(relative)[:, np.newaxis, np.newaxis]
        return result

    def select(self, indices: Sequence[int]) -> "Uncertainty":
        """Return that of some objects, given by their indices."""
        return self._changed(lambda values: values[list(indices)], lambda matrices: matrices[list(indices)])

    def average(self) -> "Uncertainty":
        """Return that of the mean over objects, which are independent but for the shared factor."""
        covariance = self.covariance
        if covariance is not None:
            total = covariance.sum(axis=0)
            if (factor := self.shared_factor) is not None:
                separate = total - np.matmul(factor, factor.transpose(0, 2, 1)).sum(axis=0)
                total = separate + factor.sum(axis=0) @ factor.sum(axis=0).T
            covariance = total[np.newaxis] / len(covariance) ** 2
        return replace(self, covariance=covariance, shared_factor=None, unpooled=None, pooled=None, explanation=None)

    def restrict(self, parameters: Bools) -> "Uncertainty":
        """Return that of some parameters, shape (parameters,), when the others have left the law."""
        restricted = self._changed(
            lambda values: values[:, parameters], lambda matrices: matrices[:, parameters][:, :, parameters]
        )
        # Names of parameters are those of terms
        return restricted if parameters.all() else replace(restricted, explanation=None, limits=(), at_bounds=())

    def with_known(self, estimated: Bools) -> "Uncertainty":
        """Return that of more parameters, shape (parameters,), of which those that are not estimated are known."""
        placed = np.eye(len(estimated))[:, estimated]
        return self._changed(
            lambda values: np.einsum("np,op...->on...", placed, values),
            lambda matrices: np.asarray(placed @ matrices @ placed.T),
        )

    def _changed(self, rows: Callable[[Floats], Floats], matrices: Callable[[Floats], Floats]) -> "Uncertainty":
        """Return that whose parameters, and the matrices between them, are changed alike, where they are known."""
        covariance = None if self.covariance is None else matrices(self.covariance)
        factor = None if self.shared_factor is None else rows(self.shared_factor)
        unpooled, pooled = (
            estimates and ObjectEstimates(rows(estimates.coefficients), matrices(estimates.covariance))
            for estimates in (self.unpooled, self.pooled)
        )
        return replace(self, covariance=covariance, shared_factor=factor, unpooled=unpooled, pooled=pooled)


def _checked_errors(errors: ErrorModel, states: int) -> ErrorModel:
    """Return errors as read-only arrays, for so many measured states."""
    arrays: dict[str, Any] = {}
    kinds = [kind for kind, model in ERRORS.items() if isinstance(model, Heteroscedastic)]
    for kind in errors.heteroscedastic:
        check_choice("kind of heteroscedastic errors", kind, kinds)
    arrays["heteroscedastic"] = {
        kind: checked(levels, f"level of errors ({kind})", "states", (states,), low=0)
        for kind, levels in errors.heteroscedastic.items()
    }
    for name in ("correlated", "force", "walk", "sensor_walk", "offset", "slope"):
        values = getattr(errors, name)
        if values is not None:
            size = len(values) if name == "walk" else states  # Rates walk too
            arrays[name] = checked(values, f"level of errors ({name})", "states", (size,), low=0)
    if errors.trend is not None:
        arrays["trend"] = checked(errors.trend, "level of errors (trend)", "states", (states,))
    for name in ("by_object", "by_trial"):
        arrays[name] = {
            group: checked(factors, f"noise of {group}", "states", (states,), low=np.finfo(float).tiny)
            for group, factors in getattr(errors, name).items()
        }
    for name in ("memory", "force_time"):
        if not getattr(errors, name) > 0:
            raise CommonlawError("law-error-not-positive", name=name, value=getattr(errors, name))
    return replace(errors, **arrays)


def _checked_misfit(misfit: Misfit, states: int) -> Misfit:
    """Return sizes of a misfit as read-only arrays, for so many measured states."""
    signal = checked(misfit.signal, "signal", "states", (states,), low=0)
    deviation = misfit.deviation
    if deviation is not None:
        deviation = checked(deviation, "deviation of paths", "states", (states,), low=0)
    return replace(misfit, signal=signal, deviation=deviation)


def _checked_explanation(explanation: Explanation, size: int) -> Explanation:
    """Return relations with a read-only covariance, for a law with so many parameters."""
    relations = explanation.relations
    if len(relations) != size:
        raise CommonlawError("relations-count", given=len(relations), expected=size)
    for relation in filter(None, relations):
        follows = len(relation.properties)
        powers = follows if relation.kind is RelationKind.POWER_LAW else 0
        factors = 1 + follows if relation.kind is RelationKind.AFFINE else 1
        alone = relation.kind in (RelationKind.UNIVERSAL, RelationKind.OWN) and follows
        counts = len(relation.factors), len(relation.errors), len(relation.exponents)
        zero = bool(powers) and 0.0 in (*relation.factors, relation.typical)
        least = min(relation.scatter, relation.scatter_error, *relation.errors, 0.0)
        if alone or counts != (factors, factors, powers) or not least >= 0 or zero:
            raise CommonlawError("relation-damaged", kind=relation.kind)
    count = sum(len(relation.factors) for relation in relations if relation)
    return Explanation(
        relations, checked(explanation.covariance, "covariance of factors", "factors, the same", (count, count))
    )
