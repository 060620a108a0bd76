"""The evidence for laws where trials start alike: the starts that a law asks for are drawn from one distribution.

A search takes any start for as likely. A law that is wrong may then follow trials from starts that scatter more than
those that they had, at no price. Here starts are normal about one mean, as wide as they scatter by the law; both are
the likeliest ones (parametric empirical Bayes, as of coefficients over objects). Where trials start far apart, or
starts were measured well, that says of all laws the same.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.score.evidence import minus_twice_log_evidence
from commonlaw.inference.score.supports import random_effect_factors
from commonlaw.likelihood import Estimate, NotPositiveError, whitened_with_initial_states


@dataclass(frozen=True, eq=False)
class InitialConditionPrior:
    """What the starts of trials say of laws, compared with a law of reference, in minus twice the log-evidence.

    Nothing of few trials, of very many samples, of errors that have a memory, and of latent states; nor
    where starts are known much better than they scatter.
    """

    reference: Fit
    _known: "dict[tuple[Estimate, ...], _InitialConditions | None]" = field(default_factory=dict)

    def price(self, fit: Fit) -> float:
        """Return how much less plausible a law is by its starts."""
        reference = self._of_reference
        law = None if reference is None else self._of(fit)
        return 0.0 if reference is None or law is None else law.own_price - reference.own_price

    def near(self, fit: Fit) -> Callable[[Bools], float]:
        """Return what says how much less plausible other supports are than those of a fit, linearised about it.

        Their starts scatter as those of the fit.
        """
        law = None if self._of_reference is None else self._of(fit)
        if law is None:
            return lambda _: 0.0
        return lambda supports: law.price(supports) - law.own_price

    @cached_property
    def _of_reference(self) -> "_InitialConditions | None":
        """What is said of the law of reference, by enough trials of one segment each, without other processes."""
        problem = self.reference.problem
        trials, models = problem.trials, problem.models
        segments = sum(int(mesh.first.sum()) for model in models for mesh in model.meshes)
        latent = any(model.latent.width for model in models)
        few = sum(problem.measured) <= settings.MAX_SCREENED_SAMPLES
        if not (settings.MIN_OBJECTS <= len(trials) == segments and few) or latent or trials.schema.starts:
            return None
        law = self._of(self.reference)
        return None if law is None or law.are_exact else law

    def _of(self, fit: Fit) -> "_InitialConditions | None":
        """Return what is said of a law; nothing if that cannot be computed."""
        if fit.estimates not in self._known:
            try:
                law = _InitialConditions.of(fit)
                self._known[fit.estimates] = law if np.isfinite(law.own_price) else None
            except (NotPositiveError, np.linalg.LinAlgError):
                self._known[fit.estimates] = None
        return self._known[fit.estimates]


@dataclass(frozen=True, eq=False)
class _InitialConditions:
    """What the likelihood, linearised about a law, says of starts and coefficients.

    Starts of all trials, shape (trials, states), are less their mean. The triangles of each trial, shape (trials, size,
    size), have as columns changes of its start, all terms that may enter the equations, and the target; so many trials
    of each object follow each other.
    """

    fit: Fit
    starts: Floats
    triangles: Floats
    counts: tuple[int, ...]
    log_determinant: float

    @classmethod
    def of(cls, fit: Fit) -> "_InitialConditions":
        """Return what is said about the estimates of a fit."""
        problem = fit.problem
        triangles, starts, counts, total = list[Floats](), list[Floats](), list[int](), 0.0
        for model, estimate in zip(problem.models, fit.estimates, strict=True):
            rows, log_determinant = whitened_with_initial_states(
                model, estimate, fit.fitted_model_error, problem.allowed
            )
            for row in rows:
                reduced = np.linalg.qr(row, mode="r")
                triangles.append(np.pad(reduced, ((0, row.shape[1] - len(reduced)), (0, 0))))
            starts += [states[mesh.first] for mesh, states, _ in model.parts(estimate)]
            counts.append(len(rows))
            total += log_determinant
        found, triangles_ = np.concatenate(starts), np.array(triangles)
        found = found - found.mean(axis=0)
        triangles_[:, :, -1] += np.matmul(triangles_[:, :, : found.shape[1]], found[:, :, np.newaxis])[:, :, 0]
        return cls(fit, found, triangles_, tuple(counts), total)

    @property
    def are_exact(self) -> bool:
        """Whether starts, if the law were known, are known much better than they scatter."""
        states = self.starts.shape[1]
        inverse = np.linalg.inv(self.triangles[:, :states, :states])
        errors = np.mean(np.sum(inverse**2, axis=2), axis=0)
        return bool(np.all(errors < settings.MIN_NOISE * self._typical))

    @property
    def _typical(self) -> Floats:
        """The mean squares of starts, shape (states,)."""
        return np.asarray(np.maximum(np.mean(self.starts**2, axis=0), np.finfo(float).tiny))

    def price(self, supports: Bools) -> float:
        """Return minus twice the log-evidence of supports, less that where any starts are as likely."""
        (factors,), (log_determinant,) = self._likeliest
        free = self.fit.evidence.value(supports) - sum(
            self.fit.evidence.structure_prior.of(support) for support in supports
        )
        return float(log_determinant) + self._evidence(factors, supports) - free

    @cached_property
    def own_price(self) -> float:
        """The same of the law itself."""
        return self.price(self.fit.supports)

    @cached_property
    def _likeliest(self) -> tuple[Floats, Floats]:
        """What `_of_objects` returns for the variances that are the likeliest with the law itself."""
        supports, states = self.fit.supports, self.starts.shape[1]
        kept = np.concatenate([np.arange(states), states + np.flatnonzero(supports[self.fit.problem.allowed]), [-1]])
        supported = replace(self, triangles=np.asarray(np.linalg.qr(self.triangles[:, :, kept], mode="r")))
        variances, grid = self._typical, 10.0 ** np.arange(-4, 2)  # What is between matters little
        for _ in range(settings.ALTERNATIONS):
            for j in range(states):
                tried = np.tile(variances, (len(grid), 1))
                tried[:, j] = grid * self._typical[j]
                factors, log_determinants = supported._of_objects(tried)
                values = log_determinants + [self._evidence(factor, supports, supports) for factor in factors]
                variances = tried[np.argmin(values)]
        return self._of_objects(variances[np.newaxis])

    def _evidence(self, factors: Floats, supports: Bools, columns: Bools | None = None) -> float:
        """Return minus twice the log-evidence of supports on factors that have columns of these terms, or of all."""
        columns = self.fit.problem.allowed if columns is None else columns
        states, ratios = self.starts.shape[1], None
        if self.fit.evidence.log_parametrized is not None:
            log_values = self.fit.evidence.log_parametrized[:, columns.ravel()]
            ratios = np.column_stack([log_values, np.zeros((len(log_values), states))])
        indices = np.append(np.flatnonzero(supports[columns]), columns.sum() + np.arange(states))
        measured = self.fit.evidence.noise_scale.without(-self.starts.size)
        return minus_twice_log_evidence(random_effect_factors(factors, ratios), indices, measured, common=states)

    def _of_objects(self, variances: Floats) -> tuple[Floats, Floats]:
        """Return triangles of objects, shape (models, objects, size, size), and log-determinants, shape (models,).

        Columns are coefficients, the mean of all starts, and the target. Starts of trials are integrated out.
        """
        (trials, size, _), (models, states) = self.triangles.shape, variances.shape
        joint = np.zeros((models, trials, size + states, states + size))
        joint[:, :, :size, :states] = joint[:, :, :size, size - 1 : -1] = self.triangles[:, :, :states]
        joint[:, :, :size, states : size - 1] = self.triangles[:, :, states:-1]
        joint[:, :, :size, -1] = self.triangles[:, :, -1]
        joint[:, :, size:, :states] = np.eye(states) / np.sqrt(variances)[:, np.newaxis, np.newaxis]
        reduced = np.asarray(np.linalg.qr(joint, mode="r"))
        diagonals = np.diagonal(reduced[:, :, :states, :states], axis1=2, axis2=3)
        with np.errstate(divide="ignore"):
            log_determinants = 2 * np.log(np.abs(diagonals)).sum(axis=(1, 2)) + trials * np.log(variances).sum(axis=1)
        of_each = np.split(reduced[:, :, states:, states:], np.cumsum(self.counts)[:-1], axis=1)
        stacked = np.zeros((models, len(self.counts), max(self.counts) * size, size))
        for o, factor in enumerate(of_each):
            stacked[:, o, : self.counts[o] * size] = factor.reshape(models, -1, size)
        return np.asarray(np.linalg.qr(stacked, mode="r")), self.log_determinant + log_determinants
