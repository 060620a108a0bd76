"""Normal prior of initial conditions over trials, as a correction of the evidence.

The search has a flat prior of initial states. A wrong law may then fit trials from initial states that vary more than
the true ones, without a penalty. Here initial states are normal, z_0 ~ N(mu, diag(sigma^2)), with mu and sigma of
largest marginal likelihood (parametric empirical Bayes). With initial states far apart, or measured well, the
correction is the same for all laws.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.score.evidence import minus_twice_log_evidence
from commonlaw.inference.score.supports import random_effect_factors
from commonlaw.likelihood import Estimate, NotPositiveError, whitened_with_initial_states
from commonlaw.runtime.forking import cached_property


@dataclass(frozen=True, eq=False)
class InitialConditionPrior:
    """Corrections of minus twice the log-evidence for initial conditions, relative to a reference law.

    They are zero for few trials, many samples, autocorrelated errors and latent states, and where initial states are
    known much better than they vary.
    """

    reference: Fit
    _known: "dict[tuple[Estimate, ...], _InitialConditions | None]" = field(default_factory=dict)

    def correction(self, fit: Fit) -> float:
        reference = self._reference
        law = None if reference is None else self._conditions(fit)
        return 0.0 if reference is None or law is None else law.fitted_correction - reference.fitted_correction

    def near(self, fit: Fit) -> Callable[[Bools], float]:
        """Return the function from other supports to their correction less that of a fit, linearized about it.

        The variances of initial states are those of the fit.
        """
        law = None if self._reference is None else self._conditions(fit)
        if law is None:
            return lambda _: 0.0
        return lambda supports: law.correction(supports) - law.fitted_correction

    @cached_property
    def _reference(self) -> "_InitialConditions | None":
        """The initial conditions of the reference law; None if no correction applies."""
        problem = self.reference.problem
        trials, models = problem.trials, problem.models
        segments = sum(int(mesh.first.sum()) for model in models for mesh in model.meshes)
        latent = any(model.latent.width for model in models)
        few = sum(problem.measured) <= settings.MAX_SCREENED_SAMPLES
        if not (settings.MIN_OBJECTS <= len(trials) == segments and few) or latent or trials.schema.initial_values:
            return None
        law = self._conditions(self.reference)
        if law is None:
            return None
        # Errors of initial states, given the law, far below their variation over trials
        states = law.starts.shape[1]
        errors = np.mean(np.sum(np.linalg.inv(law.triangles[:, :states, :states]) ** 2, axis=2), axis=0)
        return None if np.all(errors < settings.MIN_NOISE * law.variances) else law

    def _conditions(self, fit: Fit) -> "_InitialConditions | None":
        """Return the initial conditions of a fit; None if the likelihood is not computable."""
        if fit.estimates not in self._known:
            try:
                law = _InitialConditions.of(fit)
                self._known[fit.estimates] = law if np.isfinite(law.fitted_correction) else None
            except (NotPositiveError, np.linalg.LinAlgError):
                self._known[fit.estimates] = None
        return self._known[fit.estimates]


@dataclass(frozen=True, eq=False)
class _InitialConditions:
    """The likelihood of initial conditions and coefficients, linearized about a fit.

    Initial states of all trials, less their mean, have shape (trials, states). Triangular factors of each trial, shape
    (trials, size, size), have as columns the initial state, the allowed terms of all equations, and the target;
    `counts` are the trials of each object.
    """

    fit: Fit
    starts: Floats
    triangles: Floats
    counts: tuple[int, ...]
    log_determinant: float

    @classmethod
    def of(cls, fit: Fit) -> "_InitialConditions":
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
        deviations, stacked = np.concatenate(starts), np.array(triangles)
        deviations = deviations - deviations.mean(axis=0)
        changes = np.matmul(stacked[:, :, : deviations.shape[1]], deviations[:, :, np.newaxis])
        stacked[:, :, -1] += changes[:, :, 0]
        return cls(fit, deviations, stacked, tuple(counts), total)

    @property
    def variances(self) -> Floats:
        """The variances of initial states over trials, shape (states,)."""
        return np.asarray(np.maximum(np.mean(self.starts**2, axis=0), np.finfo(float).tiny))

    def correction(self, supports: Bools) -> float:
        """Return minus twice the log-evidence of supports, less that with a flat prior of initial states."""
        (factors,), (log_determinant,) = self._at_likeliest_variances
        free = self.fit.evidence.value(supports) - sum(
            self.fit.evidence.structure_prior.of(support) for support in supports
        )
        return float(log_determinant) + self._evidence(factors, supports) - free

    @cached_property
    def fitted_correction(self) -> float:
        """The same for the supports of the fit."""
        return self.correction(self.fit.supports)

    @cached_property
    def _at_likeliest_variances(self) -> tuple[Floats, Floats]:
        """Factors of `_of_objects` at the variances of largest evidence for the fit, by coordinate search."""
        supports, states = self.fit.supports, self.starts.shape[1]
        kept = np.concatenate([np.arange(states), states + np.flatnonzero(supports[self.fit.problem.allowed]), [-1]])
        supported = replace(self, triangles=np.asarray(np.linalg.qr(self.triangles[:, :, kept], mode="r")))
        variances, grid = self.variances, 10.0 ** np.arange(-4, 2)
        for _ in range(settings.ALTERNATIONS):
            for j in range(states):
                tried = np.tile(variances, (len(grid), 1))
                tried[:, j] = grid * self.variances[j]
                factors, log_determinants = supported._of_objects(tried)
                values = log_determinants + [self._evidence(factor, supports, supports) for factor in factors]
                variances = tried[np.argmin(values)]
        return self._of_objects(variances[np.newaxis])

    def _evidence(self, factors: Floats, supports: Bools, columns: Bools | None = None) -> float:
        """Return minus twice the log-evidence of supports from factors with columns of these terms, by default all."""
        columns = self.fit.problem.allowed if columns is None else columns
        states, ratios = self.starts.shape[1], None
        if self.fit.evidence.log_parametrized is not None:
            log_values = self.fit.evidence.log_parametrized[:, columns.ravel()]
            ratios = np.column_stack([log_values, np.zeros((len(log_values), states))])
        indices = np.append(np.flatnonzero(supports[columns]), columns.sum() + np.arange(states))
        scale = self.fit.evidence.noise_scale.without(-self.starts.size)
        return minus_twice_log_evidence(random_effect_factors(factors, ratios), indices, scale, common=states)

    def _of_objects(self, variances: Floats) -> tuple[Floats, Floats]:
        """Return triangles of objects, shape (models, objects, size, size), and log-determinants, shape (models,).

        Columns are coefficients, the mean initial state, and the target. Initial states are integrated out.
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
        by_object = np.split(reduced[:, :, states:, states:], np.cumsum(self.counts)[:-1], axis=1)
        stacked = np.zeros((models, len(self.counts), max(self.counts) * size, size))
        for o, factor in enumerate(by_object):
            stacked[:, o, : self.counts[o] * size] = factor.reshape(models, -1, size)
        return np.asarray(np.linalg.qr(stacked, mode="r")), self.log_determinant + log_determinants
