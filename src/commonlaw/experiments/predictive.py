"""What a law, with all its errors, says of an experiment that is still to be made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.experiments.experiment import Experiment
from commonlaw.experiments.gaussian import Gaussian
from commonlaw.experiments.imitation import Point, imitating
from commonlaw.experiments.settings import Range
from commonlaw.integration import InitialValueProblem, Trajectory, simulate
from commonlaw.law import Law
from commonlaw.law.population import with_objects_of
from commonlaw.library import highest_columns, with_rates
from commonlaw.spacing import evenly_spaced
from commonlaw.trials import Trial, Trials

MOST, _LEAST, _TOGETHER = 64, 16, 192
"""Measurements of a trial that are looked at: where there are more, each stands for several, with less noise. Where
each object makes a trial, as many as the last together; and always so many times as the second."""

_ASIDE = 10
"""How many times larger than a law says at first states may become on the way of a fit."""

_TOLERANCE = 1e-5
"""Of a step of the forecasts, which noise and errors of coefficients exceed."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A law that remains plausible, as what is still unknown of its coefficients.

    Parameters
    ----------
    law
        It knows its noise and its covariance.
    objects
        Those of the law that experiments can be made with.
    roots
        Their coefficients in the support of the law are known but for ``roots @ u``, with standard normal unknowns u
        that all of them have in common: shape (objects, parameters, unknowns).
    """

    law: Law
    objects: tuple[str, ...]
    roots: Floats

    @classmethod
    def of(cls, law: Law, objects: Sequence[str]) -> "Hypothesis":
        """Return a law with the roots of its covariance, for experiments with these of its objects.

        Raises
        ------
        CommonlawError
            If the law does not know its noise or its covariance, or is one of discrete time.
        """
        if law.order == 0:
            raise CommonlawError(
                "a law of discrete time does not say what happens between samples: discover one of order 1 or 2"
            )
        known = law.uncertainty.select([law.index(name) for name in objects])
        own = known.known_covariance()
        if law.noise is None:
            raise CommonlawError(
                "this law does not know the noise of the measurements: discover it without naming a solver, "
                "or refine it"
            )
        factor = known.shared_factor
        if factor is not None:
            own = own - np.matmul(factor, factor.transpose(0, 2, 1))
        count, size = own.shape[:2]
        roots = np.zeros((count, size, count, size))
        values, vectors = np.linalg.eigh(own)
        roots[range(count), :, range(count)] = vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis]
        flat = roots.reshape(count, size, count * size)
        flat = flat if factor is None else np.concatenate([flat, factor], axis=2)
        return cls(law, tuple(objects), flat[:, :, np.any(flat, axis=(0, 1))])

    @property
    def unknowns(self) -> int:
        """How many there are."""
        return int(self.roots.shape[2])

    def within(self, experiments: Sequence[Experiment], limits: Mapping[str, Range]) -> list[Experiment]:
        """Return experiments that end where its forecasts leave the limits of states (and rates)."""
        if not limits:
            return [*experiments]
        planned = [_planned(self.law, each) for each in experiments]
        problems = [own.problem(name) for own in planned for name in own.experiment.objects]
        found = iter(simulate(problems, tolerance=_TOLERANCE))
        return [
            own.experiment.until(min(own.leaves(next(found), limits) for _ in own.experiment.objects))
            for own in planned
        ]

    def says(
        self,
        experiments: Sequence[Experiment],
        limit: float | None = None,
        imitated: Sequence[tuple[Gaussian, ...]] | None = None,
        thoroughly: bool = False,
    ) -> list[tuple[Gaussian, ...] | None]:
        """Return what it says of each experiment's trials; nothing of those in which its forecasts diverge.

        Parameters
        ----------
        experiments
            Those that could be made.
        limit
            A state larger than this diverges, see `simulate`.
        imitated
            What another law says of each: this one is linearised about where it comes nearest to it.
        thoroughly
            Whether fits to that begin from several starts.
        """
        planned = [_planned(self.law, each) for each in experiments]
        trials = [(own, name) for own in planned for name in own.experiment.objects]
        followed = self._followed(trials, [None] * len(trials), limit)
        said = [own.gaussian(name, each, self) for (own, name), each in zip(trials, followed, strict=True)]
        if imitated is not None:
            targets = [each.mean for own in imitated for each in own]
            far = _ASIDE * max((float(np.nanmax(np.abs(each.states))) for each in followed), default=1.0)
            known = [i for i, each in enumerate(said) if each]

            def linearised(indices: Sequence[int], points: Sequence[Point]) -> list[Gaussian | None]:
                some = [trials[known[i]] for i in indices]
                found = self._followed(some, points, far if limit is None else min(far, limit))
                return [own.gaussian(name, each, self) for (own, name), each in zip(some, found, strict=True)]

            around = planned[0].start_noise * thoroughly if planned else np.empty(0)
            own = [each for each in said if each]
            for i, each in zip(known, imitating(own, [targets[i] for i in known], linearised, around), strict=True):
                said[i] = each
        found = iter(said)
        whole = [[next(found) for _ in own.experiment.objects] for own in planned]
        return [tuple(each for each in own if each) if all(own) else None for own in whole]

    def _followed(
        self, trials: "Sequence[tuple[_Planned, str]]", points: Sequence[Point | None], limit: float | None
    ) -> tuple[Trajectory, ...]:
        triples = zip(trials, points, strict=True)
        problems = [own.problem(name, self, point) for (own, name), point in triples]
        return simulate(problems, tolerance=_TOLERANCE, sensitivities=True, limit=limit)


@dataclass(frozen=True, eq=False)
class _Planned:
    """An experiment, at the times that are looked at, and the law of its objects."""

    experiment: Experiment
    law: Law
    times: Floats
    is_new: bool

    def problem(self, name: str, known: Hypothesis | None = None, point: Point | None = None) -> InitialValueProblem:
        """Return the problem of one object, with the coefficients and the start at a point of what is known."""
        law, own = self.law, self.experiment
        field = replace(law.vector_field(name), free=law.support, inputs=own.inputs)
        start = own.start.copy()
        logs = list(law.terms.variables.logarithmic_columns)
        start[logs] = np.log(start[logs])
        if known is not None and point is not None:
            start[self.free_starts] += point.shifts
            if not self.is_new:
                coefficients = field.coefficients.copy()
                coefficients[law.support] += known.roots[known.objects.index(name)] @ point.unknowns
                field = replace(field, coefficients=coefficients)
        return InitialValueProblem(field, start, self.times, name)

    @property
    def free_starts(self) -> list[int]:
        """The states (and rates) whose starts the measurements alone tell."""
        told, states = ~np.isfinite(self.experiment.start_std), len(self.law.states)
        seen = np.append(~self.law.schema.unmeasured, np.ones(len(told) - states, dtype=np.bool_))
        return np.flatnonzero(told & seen).tolist()

    @property
    def start_std(self) -> Floats:
        """How far starts may be off, on the scale of the states that are followed, shape (D,)."""
        own, found = self.experiment, self.experiment.start_std.copy()
        logs = list(self.law.terms.variables.logarithmic_columns)
        found[logs] /= own.start[logs]
        return found

    @property
    def start_noise(self) -> Floats:
        """How surely single measurements tell the free starts, and two of them rates, shape (f,)."""
        law, start = self.law, self.problem(self.experiment.objects[0]).initial
        white = _white_std(law, start[np.newaxis])[0]
        rates = np.sqrt(2) * white[with_rates(law.order, len(white))] / (self.times[1] - self.times[0])
        return np.concatenate([white, rates])[self.free_starts]

    def leaves(self, found: Trajectory, limits: Mapping[str, Range]) -> float:
        """Return the last time before a trajectory leaves limits."""
        variables = self.law.terms.variables
        states = variables.natural(found.states)
        inside = np.ones(len(states), dtype=np.bool_)
        for name, own in limits.items():
            values = states[:, variables.index(name)]
            inside &= (values >= own.low) & (values <= own.high)
        outside = np.flatnonzero(~inside)
        return float(
            found.times[outside[0] - 1] if len(outside) and outside[0] else found.times[-1 if not len(outside) else 0]
        )

    def gaussian(self, name: str, found: Trajectory, known: Hypothesis) -> Gaussian | None:
        """Return what is said of the trial of one object; nothing if its forecast diverges."""
        law, own = self.law, self.experiment
        assert law.noise is not None
        if found.outcome is not None or found.sensitivities is None or not np.isfinite(found.sensitivities).all():
            return None
        width = found.states.shape[1]
        seen = np.flatnonzero(~law.schema.unmeasured)
        by_own = found.sensitivities[:, :, :-width]
        by_start = found.sensitivities[:, :, -width:]
        by_set = by_start[:, seen].reshape(-1, width)
        measured = by_own[:, seen].reshape(-1, by_own.shape[2])
        common = None
        if self.is_new:
            common = measured @ law.uncertainty.known_covariance()[law.index(name)] @ measured.T
            by_unknowns = np.zeros((len(measured), known.unknowns))
        else:
            by_unknowns = measured @ known.roots[known.objects.index(name)]
        share = len(self.times) / len(own.times)
        white, coloured = _noise(law, self.times, found.states, by_start, share)
        known_starts = np.isfinite(own.start_std)
        off = by_set[:, known_starts] * self.start_std[known_starts]
        if off.any():
            coloured = off @ off.T + (0.0 if coloured is None else coloured)
        mean, by_free = found.states[:, seen].ravel(), by_set[:, self.free_starts]
        return Gaussian(mean, by_unknowns, by_free, white, coloured, common, own.repeats)


def _planned(law: Law, experiment: Experiment) -> _Planned:
    times = experiment.times
    most = min(MOST, _TOGETHER // len(experiment.objects)) // len(law.schema.measured)
    most = max(most, min(_LEAST, MOST // len(law.schema.measured)))
    times = times[evenly_spaced(len(times), most)]
    is_new = bool(experiment.properties)
    if is_new:
        (name,), states = experiment.objects, np.zeros((1, len(law.states)))
        trial = Trial(name, "1", experiment.times[:1], states, np.zeros((1, len(law.schema.inputs))))
        trials = Trials((trial,), replace(law.schema, noise_columns={}), {name: experiment.properties})
        law, _ = with_objects_of(law, trials)
    return _Planned(experiment, law, times, is_new)


def _noise(law: Law, times: Floats, states: Floats, by_start: Floats, share: float) -> tuple[Floats, Floats | None]:
    """Return the variances of white noise of d measured states, shape (n d,), and the covariance of all other errors.

    Parameters
    ----------
    law
        Whose errors these are.
    times, states, by_start
        Of the trajectory, shapes (n,), (n, D) and (n, D, D).
    share
        Of the samples that are looked at: white noise is that of the mean of those that each stands for.
    """
    assert law.noise is not None
    errors, measured = law.uncertainty.error_model, ~law.schema.unmeasured
    white = _white_std(law, states)[:, measured]
    parts = list[Floats]()
    if errors.correlated is not None:
        kernel = np.exp(-np.abs(times[:, np.newaxis] - times) / errors.memory)
        parts.append(np.kron(kernel, np.diag(np.square(errors.correlated[measured]))))
    if errors.of_law:
        pushed = _pushes(law, times, by_start)[:, np.flatnonzero(measured)].reshape(white.size, -1)
        parts.append(pushed @ pushed.T)
    return share * white.ravel() ** 2, sum(parts[1:], parts[0]) if parts else None


def _white_std(law: Law, states: Floats) -> Floats:
    own = states[:, : len(law.states)]
    return np.asarray(law.uncertainty.error_model.white_std(own, np.asarray(law.noise)) + np.zeros_like(own))


def _pushes(law: Law, times: Floats, by_start: Floats) -> Floats:
    """Return what standard normal numbers, which drive the errors of a law, add to its states, shape (n, D, k)."""
    errors, steps = law.uncertainty.error_model, np.diff(times)
    count, width = by_start.shape[:2]
    with np.errstate(all="ignore"):
        carried = np.einsum("nab,mbc->namc", by_start, np.linalg.pinv(by_start))  # From the time m to the time n
    carried = (carried[:, :, :-1] + carried[:, :, 1:]) / 2  # From within the step m
    carried *= (np.arange(count)[:, np.newaxis] > np.arange(count - 1))[:, np.newaxis, :, np.newaxis]
    parts = []
    if errors.walk is not None:
        parts.append(carried * errors.walk * np.sqrt(steps)[:, np.newaxis])
    if errors.force is not None:
        middles = times[1:] - steps / 2
        apart = np.sqrt(3) * np.abs(middles[:, np.newaxis] - middles) / errors.force_time
        kernel = (1 + apart) * np.exp(-apart) + 1e-10 * np.eye(len(steps))
        pushed = highest_columns(law.order, len(law.states))
        forced = carried[..., pushed] * errors.force * steps[:, np.newaxis]
        parts.append(np.einsum("namc,mk->nakc", forced, np.linalg.cholesky(kernel)))
    return np.concatenate([each.reshape(count, width, -1) for each in parts], axis=2)
