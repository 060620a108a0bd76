"""What each plausible law would measure in an experiment, and where it comes nearest to another law."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from commonlaw.array_types import Floats, evenly_spaced
from commonlaw.errors import CommonlawError
from commonlaw.experiments.experiment import Experiment, Range
from commonlaw.experiments.gaussian import Gaussian
from commonlaw.forecast.scheme import AbstractScheme, Followed, PlannedTrial
from commonlaw.forecast.schemes import scheme_of
from commonlaw.formulation import symmetric_root
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.parameters import followed_coefficients
from commonlaw.law.population import with_objects_of
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import property_names

Linearise = Callable[[Sequence[int], Sequence[Floats]], Sequence[Gaussian | None]]
"""From trials, by their numbers, and points to a law's predictions about these; None where it diverges.

A point has the p unknowns of the law, and what is added to the f free initial values (and parameters) of the trial.
"""


_MAX_STEPS = 15
"""Steps of a fit, with those that lead to nothing better."""
_MIN_SHORTENING, _MIN_SHARE = 0.1, 0.01
"""By how much a step is shortened at once, and the share of a step at which a fit ends: the law is far from linear."""


@dataclass(frozen=True, eq=False)
class _Fit:
    """A law in a trial, fitted to its measurements, shape (n,), as far as it has come: to a point, shape (p + f,)."""

    measured: Floats
    point: Floats
    predicted: Gaussian

    @cached_property
    def _residuals(self) -> Floats:
        return self.predicted.white((self.measured - self.predicted.mean)[:, np.newaxis])[:, 0]

    @property
    def unknowns(self) -> Floats:
        """Those of the law, shape (p,)."""
        return self.point[: self.predicted.by_unknowns.shape[1]]

    @cached_property
    def deviance(self) -> float:
        """Minus twice the log-density of the measurements and of the unknowns, but for a constant."""
        return float(np.sum(self._residuals**2) + np.sum(self.unknowns**2))

    @cached_property
    def gauss_newton(self) -> tuple[Floats, float]:
        """The step of least squares (Gauss and Newton), shape (p + f,), and the deviance if all were linear."""
        slopes = self.predicted.white(np.column_stack([self.predicted.by_unknowns, self.predicted.by_start]))
        columns = np.vstack([slopes, np.eye(len(self.unknowns), len(self.point))])
        wanted = np.concatenate([self._residuals, -self.unknowns])
        step = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        return np.asarray(step), float(np.sum((wanted - columns @ step) ** 2))

    def shortening(self, share: float, deviance: float) -> float:
        """Return by what to multiply a share s of the step that leads to a deviance D(s) that is not less.

        The minimum of the parabola with the slope ``D'(0) = -2 d``, d being the predicted decrease, and the value D(s)
        is at ``d s^2/(D(s) - D(0) + 2 d s)`` (Dennis and Schnabel 1983, algorithm A6.3.1).
        """
        decrease = share * (self.deviance - self.gauss_newton[1])
        return max(_MIN_SHORTENING, decrease / (deviance - self.deviance + 2 * decrease))

    @property
    def converged(self) -> bool:
        """Whether the predicted decrease is at most one: laws are distinguished by several times that."""
        return self.deviance < self.gauss_newton[1] + 1.0


def refitted(
    predicted: Sequence[Gaussian], points: Sequence[Floats], measured: Sequence[Floats], linearise: Linearise
) -> list[Gaussian]:
    """Return what a law predicts of trials, linearized about the best fits to their measurements, each of shape (n,).

    Fits begin at `points`, where the law predicts `predicted`.
    """
    fits = [_Fit(*triple) for triple in zip(measured, points, predicted, strict=True)]
    shares = {i: 1.0 for i, fit in enumerate(fits) if not fit.converged}
    for _ in range(_MAX_STEPS):
        moved = [fits[i].point + share * fits[i].gauss_newton[0] for i, share in shares.items()]
        for i, point, prediction in zip([*shares], moved, linearise([*shares], moved), strict=True):
            fit = None if prediction is None else _Fit(measured[i], point, prediction)
            if fit is None or not fit.deviance < fits[i].deviance:
                shares[i] *= _MIN_SHORTENING if fit is None else fits[i].shortening(shares[i], fit.deviance)
            else:
                fits[i], shares[i] = fit, min(1.0, 2 * shares[i])
            if fits[i].converged or shares[i] < _MIN_SHARE:
                del shares[i]
    # Linear about the best fit
    return [replace(fit.predicted, mean=fit.predicted.mean - fit.predicted.by_unknowns @ fit.unknowns) for fit in fits]


MAX_MEASUREMENTS, _MIN_MEASUREMENTS, _MAX_MEASUREMENTS_OF_ALL = 64, 16, 192
"""Measurements of a trial that are looked at: where there are more, each stands for several, with less noise. Where
each object makes a trial, as many as the last together; and always so many times as the second."""


Simulated = tuple[Floats, tuple[Gaussian, ...]]
"""The unknowns of a draw of an experiment, and predictions of its trials about these."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A plausible law with the uncertainty of its coefficients.

    Those of `objects` in the support of the law are known but for ``roots @ u``, with standard normal unknowns u that
    all of them share: shape (objects, parameters, unknowns).
    """

    law: Law
    objects: tuple[str, ...]
    roots: Floats

    @classmethod
    def of(cls, law: Law, objects: Sequence[str]) -> "Hypothesis":
        """Return a law with the roots of its covariance, for experiments with these of its objects.

        Raises `CommonlawError` if the law has no noise or covariance, is one of discrete time, or has only a limit of a
        parameter of one of these objects.
        """
        if law.order == 0:
            raise CommonlawError("discrete-between-samples")
        if limits := [limit for limit in law.uncertainty.limits if limit.object in objects]:
            names, owners = {limit.parameter for limit in limits}, {limit.object for limit in limits}
            raise CommonlawError("design-with-limits", names=sorted(names), objects=sorted(owners))
        known = law.uncertainty.select([object_index(law, name) for name in objects])
        covariance = known.known_covariance()
        if law.uncertainty.noise is None:
            raise CommonlawError("noise-unknown")
        factor = known.shared_factor
        if factor is not None:
            covariance = covariance - np.matmul(factor, factor.transpose(0, 2, 1))
        count, size = covariance.shape[:2]
        roots = np.zeros((count, size, count, size))
        roots[range(count), :, range(count)] = symmetric_root(covariance)
        flat = roots.reshape(count, size, count * size)
        flat = flat if factor is None else np.concatenate([flat, factor], axis=2)
        return cls(law, tuple(objects), flat[:, :, np.any(flat, axis=(0, 1))])

    @property
    def unknowns(self) -> int:
        """How many there are."""
        return int(self.roots.shape[2])

    @cached_property
    def scheme(self) -> Callable[[frozenset[str]], AbstractScheme]:
        """The scheme of the law, by the states (and rates) whose start is set."""
        law, properties = self.law, property_names(self.law.properties)
        return cache(lambda chosen: scheme_of(law, properties, chosen=chosen))

    def within(self, experiments: Sequence[Experiment], limits: Mapping[str, Range]) -> list[Experiment]:
        """Return experiments that end where its forecasts leave the limits of states (and rates)."""
        if not limits:
            return [*experiments]
        planned = [_planned(self, experiment) for experiment in experiments]
        followed = iter(self._followed([(plan, name, None) for plan in planned for name in plan.experiment.objects]))
        return [
            plan.experiment.until(min(plan.leaves(next(followed), limits) for _ in plan.experiment.objects))
            for plan in planned
        ]

    def predictions(
        self, experiments: Sequence[Experiment], limit: float | None = None
    ) -> list[tuple[Gaussian, ...] | None]:
        """Return predictions of each experiment's trials; None where a state exceeds the limit, see `simulate`."""
        planned = [_planned(self, experiment) for experiment in experiments]
        trials = [(plan, name, None) for plan in planned for name in plan.experiment.objects]
        predicted = iter(self._predictions(trials, limit))
        whole = [[next(predicted) for _ in plan.experiment.objects] for plan in planned]
        return [tuple(filter(None, by_object)) if all(by_object) else None for by_object in whole]

    def simulated(self, experiment: Experiment, unknowns: Floats, limit: float | None) -> list[Simulated]:
        """Return predictions of an experiment at unknowns of draws, shape (draws, unknowns).

        Unknowns with which the law diverges are halved until it does not.
        """
        plan, predictions = _planned(self, experiment), dict[int, tuple[Gaussian, ...]]()
        unknowns = unknowns.copy()
        for _ in range(20):
            missing = [i for i in range(len(unknowns)) if i not in predictions]
            trials = [(plan, name, plan.point(unknowns[i])) for i in missing for name in experiment.objects]
            predicted = iter(self._predictions(trials, limit))
            for i in missing:
                listed = [next(predicted) for _ in experiment.objects]
                if all(listed):
                    predictions[i] = tuple(gaussian for gaussian in listed if gaussian)
                else:
                    unknowns[i] /= 2
        return [(unknown, predictions[i]) for i, unknown in enumerate(unknowns)]

    def refitted(
        self,
        experiment: Experiment,
        initial: Sequence[Simulated],
        measured: Sequence[Sequence[Floats]],
        limit: float | None,
    ) -> list[tuple[Gaussian, ...]]:
        """Return predictions about the best fits to measurements of each draw in each trial, shape (n,).

        The law must not diverge in the experiment; fits begin at `initial`, for `limit` see `predictions`.
        """
        plan, count = _planned(self, experiment), len(experiment.objects)
        names = [*experiment.objects] * len(measured)
        points = [plan.point(unknown) for unknown, _ in initial for _ in range(count)]
        predicted = [gaussian for _, listed in initial for gaussian in listed]
        # On the way of a fit states may become ten times larger than at first
        highest = 10 * max((float(np.abs(gaussian.mean).max()) for gaussian in predicted), default=1.0)
        highest = highest if limit is None else min(highest, limit)

        def linearised(indices: Sequence[int], moved: Sequence[Floats]) -> list[Gaussian | None]:
            pairs = zip(indices, moved, strict=True)
            return self._predictions([(plan, names[i], point) for i, point in pairs], highest)

        fitted = refitted(predicted, points, [values for listed in measured for values in listed], linearised)
        return [tuple(fitted[i : i + count]) for i in range(0, len(fitted), count)]

    def _predictions(
        self, trials: "Sequence[tuple[_Planned, str, Floats | None]]", limit: float | None
    ) -> list[Gaussian | None]:
        """Return predictions of trials of objects about points; None where the law diverges."""
        followed = self._followed(trials, True, limit)
        return [plan.gaussian(name, trajectory) for (plan, name, _), trajectory in zip(trials, followed, strict=True)]

    def _followed(
        self, trials: "Sequence[tuple[_Planned, str, Floats | None]]", slopes: bool = False, limit: float | None = None
    ) -> "list[Followed]":
        if not trials:
            return []
        planned = [plan.trial(name, point) for plan, name, point in trials]
        return trials[0][0].scheme.followed(planned, slopes, limit)  # The same states are set in all


@dataclass(frozen=True, eq=False)
class _Planned:
    """An experiment, at the times that are looked at, and the law of its objects.

    `start` is what a trial has of its own, see `AbstractScheme.beginning`, shape (q,), with how far it may be off,
    infinite where it is estimated.
    """

    known: Hypothesis
    experiment: Experiment
    law: Law
    times: Floats
    scheme: AbstractScheme
    start: Floats
    start_std: Floats

    def _coefficients(self, name: str, coefficients: Floats, point: Floats | None) -> Floats:
        if point is None or self.experiment.properties:
            return coefficients
        result, unknowns = coefficients.copy(), point[: self.known.unknowns]
        result[self.law.support] += self.known.roots[self.known.objects.index(name)] @ unknowns
        return result

    def _shifted(self, point: Floats | None) -> Floats:
        result = self.start.copy()
        if point is not None:
            result[self.free] += point[self.known.unknowns :]
        return result

    def trial(self, name: str, point: Floats | None) -> PlannedTrial:
        """Return the trial of an object at a point."""
        coefficients = self._coefficients(name, followed_coefficients(self.law, name), point)
        properties = self.experiment.properties or self.law.properties.get(name, {})
        inputs = self.experiment.inputs
        return PlannedTrial(name, self.times, coefficients, self._shifted(point), properties, inputs)

    def point(self, unknowns: Floats) -> Floats:
        """Return unknowns with the start that is set."""
        return np.append(unknowns, np.zeros(len(self.free)))

    @cached_property
    def free(self) -> list[int]:
        """What of the start the measurements alone determine."""
        return np.flatnonzero(~np.isfinite(self.start_std)).tolist()

    def leaves(self, found: Followed, limits: Mapping[str, Range]) -> float:
        """Return the last time before a trajectory leaves limits."""
        variables = self.law.terms.variables
        states = variables.natural(found.states)
        inside = np.ones(len(states), dtype=np.bool_)
        for name, limit in limits.items():
            values = states[:, variables.index(name)]
            inside &= (values >= limit.low) & (values <= limit.high)
        outside = np.flatnonzero(~inside)
        return float(found.times[max(outside[0] - 1, 0) if len(outside) else -1])

    def gaussian(self, name: str, found: Followed) -> Gaussian | None:
        """Return the prediction of the trial of one object; None if its forecast diverges, or its errors do."""
        law, experiment, known, common = self.law, self.experiment, self.known, None
        measured = self.scheme.measured(name, found)
        if measured is None:
            return None
        values, coloured = measured.values.ravel(), measured.coloured
        by_coefficients, by_set = (by.reshape(len(values), -1) for by in (measured.by_coefficients, measured.by_start))
        if experiment.properties:
            covariance = law.uncertainty.known_covariance()[object_index(law, name)]
            common = by_coefficients @ covariance @ by_coefficients.T
            by_unknowns = np.zeros((len(values), known.unknowns))
        else:
            by_unknowns = by_coefficients @ known.roots[known.objects.index(name)]
        is_known = np.isfinite(self.start_std)
        off = by_set[:, is_known] * self.start_std[is_known]
        if off.any():
            coloured = off @ off.T + (0.0 if coloured is None else coloured)
        white = len(self.times) / len(experiment.times) * measured.white  # Each sample stands for the mean of several
        predicted = Gaussian(values, by_unknowns, by_set[:, self.free], white, coloured, common, experiment.repeats)
        return predicted if predicted.is_finite else None


def _planned(known: Hypothesis, experiment: Experiment) -> _Planned:
    times, law, measured = experiment.times, known.law, len(known.law.observation.measured.measured)
    most = min(MAX_MEASUREMENTS, _MAX_MEASUREMENTS_OF_ALL // len(experiment.objects)) // measured
    most = max(most, min(_MIN_MEASUREMENTS, MAX_MEASUREMENTS // measured))
    times = times[evenly_spaced(len(times), most)]
    if experiment.properties:
        (name,), states = experiment.objects, np.zeros((1, len(law.schema.states)))
        trial = Trial(name, "1", experiment.times[:1], states, np.zeros((1, len(law.schema.inputs))))
        trials = Trials((trial,), replace(law.schema, noise_columns={}), {name: experiment.properties})
        law, _ = with_objects_of(law, trials)
    scheme = known.scheme(frozenset(experiment.settings) & frozenset(law.terms.variables.states))
    return _Planned(known, experiment, law, times, scheme, *scheme.beginning(experiment.start, experiment.start_std))
