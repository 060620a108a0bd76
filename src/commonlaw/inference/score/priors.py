"""Priors of supports (beta-binomial, with a description length of terms) and of the levels of measurement errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import lgamma

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.data.noise import noise_floors
from commonlaw.inference.score.evidence import NoiseScale
from commonlaw.inference.settings import GENERIC_POINTS, MIN_NOISE, RESOLVED_NOISE, ROUNDING
from commonlaw.library import Order, Terms
from commonlaw.likelihood import ErrorModel, Mesh
from commonlaw.trials import Trials
from commonlaw.trials.repeats import pure_error
from commonlaw.trials.trial import with_typical


@dataclass(frozen=True, eq=False)
class Measurements:
    """The measurements of all objects, and the prior of their error levels.

    Parameters
    ----------
    meshes
        Of all objects in turn.
    states
        The states (and rates) at which heteroscedastic noise is evaluated, of each mesh, shape (n, D).
    noise_estimate
        Prior noise standard deviations of the states, shape (d,).
    order
        Order of the laws.
    count
        Measured numbers.
    noise_is_fixed
        Whether the noise is not estimated from residuals.
    prior
        Prior observations nu0 of each noise variance.
    """

    trials: Trials
    meshes: Sequence[Mesh]
    states: Sequence[Floats]
    noise_estimate: Floats
    order: Order
    count: int
    noise_is_fixed: bool
    prior: float

    def white_std(self, noise: Floats, errors: ErrorModel) -> Floats:
        """Return the white-noise standard deviation of each measurement, shape (points, d), given that of states, (d,).

        Constant states keep their prior noise; that of absent ones (exactly zero) is negligible.
        """
        states = np.concatenate(self.states)[:, : len(self.noise_estimate)]
        std = errors.white_std(states, with_typical(self._given, noise))
        still = np.where(self._absent, MIN_NOISE * self.noise_estimate, self.noise_estimate)
        return np.where(self._still, with_typical(self._given, still), std) * self._averaging

    def noise_scale(self, noise: Floats, errors: ErrorModel, std: Floats) -> NoiseScale:
        """Return the inverse-gamma posterior of the noise variance at these levels, in units of these.

        The prior estimate counts as `prior` observations of each state, and replicates add their pure error. The
        variance is at least that of rounding, and `RESOLVED_NOISE` squared times that of the noise floor.
        """
        if self.noise_is_fixed:
            return NoiseScale(self.count)
        inflation = self._inflation(noise, errors, std)
        prior, least = self.prior * float(np.sum(1 / inflation)), self._floors[1] / noise
        squares, repeated = self.pure_error
        freedom = self._freedom + float(repeated.sum()) + self.prior * len(inflation)
        prior += float(np.sum(squares / noise**2))
        return NoiseScale(self.count, freedom, prior, least=float(np.max(least) ** 2))

    def least_variance(self, noise: Floats) -> float:
        """Return the lower bound of the noise variance that laws are fitted under, in units of its present value."""
        return float(np.max(self._floors[0] / noise) ** 2)

    def level_penalty(self, noise: Floats, errors: ErrorModel, std: Floats) -> float:
        """Return minus twice the log prior of error levels: log n each (BIC), inverse gamma for the noise variance."""
        penalty = errors.hyperparameters * float(np.log(self.count))
        if not self.noise_is_fixed:
            penalty += self.prior * float(np.sum(np.log(self._inflation(noise, errors, std))))
        return penalty

    def _inflation(self, noise: Floats, errors: ErrorModel, std: Floats) -> Floats:
        """Return the noise variance over its prior estimate, of each measured state.

        Both are variances of neighbouring differences: of autocorrelated errors of standard deviation sigma and
        correlation time tau at sampling step h, this is ``sigma^2 tanh(h / (2 tau))``.
        """
        relative = np.where(self._absent, 1.0, std / (with_typical(self._given, noise) * self._averaging))
        variance = noise**2 * np.mean(relative**2, axis=0)
        if errors.correlated is not None:
            variance = variance + errors.correlated**2 * np.tanh(self._step / (2 * errors.memory))
        return np.asarray(variance / self.noise_estimate**2)[~self.trials.schema.is_latent]

    @cached_property
    def measured(self) -> Floats:
        """Measured states at all points, shape (points, d), NaN where missing."""
        return np.concatenate([mesh.measured for mesh in self.meshes])

    @cached_property
    def _given(self) -> Floats:
        return np.concatenate([np.broadcast_to(mesh.noise, mesh.measured.shape) for mesh in self.meshes])

    @cached_property
    def _averaging(self) -> Floats:
        return np.concatenate([np.broadcast_to(mesh.averaging, mesh.measured.shape) for mesh in self.meshes])

    @cached_property
    def _still(self) -> Bools:
        return np.concatenate([mesh.still for mesh in self.meshes])

    @cached_property
    def _absent(self) -> Bools:
        return np.concatenate([mesh.absent for mesh in self.meshes])

    @cached_property
    def pure_error(self) -> tuple[Floats, Floats]:
        """The pure-error sum of squares of replicates of each state, and its degrees of freedom, each of shape (d,)."""
        return pure_error([trial.repeats for trial in self.trials], len(self.noise_estimate))

    @cached_property
    def _freedom(self) -> int:
        return sum(mesh.degrees_of_freedom(self.order) for mesh in self.meshes)

    @cached_property
    def _floors(self) -> tuple[Floats, Floats]:
        return noise_floors(self.trials, RESOLVED_NOISE)

    @cached_property
    def _step(self) -> float:
        return float(np.median(np.concatenate([np.diff(trial.times) for trial in self.trials])))


@dataclass(frozen=True, eq=False)
class StructurePrior:
    """The prior of the support of one equation.

    A support S of s out of N terms has minus twice the log prior

        -2 log [B(1 + s, 2 N - s) / B(1, N)] + sum of w_k over S + c z(S).

    The first part is beta-binomial: each term is included with a probability that has the beta distribution of
    parameters 1 and N, so that one term is expected (Castillo, Schmidt-Hieber and van der Vaart 2015). w_k is the
    description length of term k, and z(S) counts the states with an arbitrary origin of which S fixes the origin.

    Parameters
    ----------
    terms
        The penalties w_k, shape (terms,).
    shifted
        For each state with an arbitrary origin, which terms each term needs to be invariant to a shift of the origin,
        shape (terms, terms).
    zero
        The penalty c of a fixed origin, that of one fitted number.
    excluded_terms
        Candidate terms that were screened out before, part of N.
    """

    terms: Floats
    shifted: Sequence[Bools] = ()
    zero: float = 0.0
    excluded_terms: int = 0

    def of(self, support: Bools) -> float:
        """Return minus twice the log prior of a support, shape (terms,)."""
        count, size = len(support) + self.excluded_terms, int(support.sum())
        log_prior = _betaln(1 + size, 2 * count - size) - _betaln(1, count)
        fixed_origins = sum(bool((needed[support] & ~support).any()) for needed in self.shifted)
        return -2 * log_prior + float(self.terms[support].sum()) + fixed_origins * self.zero


def complexity_penalties(terms: Terms) -> Floats:
    """Return the description length of terms, shape (terms,): one bit, 2 log 2, for each factor."""
    return np.asarray(2 * np.log(2) * terms.complexities)


def shifted(terms: Terms, column: int) -> Bools:
    """Return which other terms each term needs to be invariant to a shift of a variable, shape (terms, terms).

    They are the terms of its derivative by the variable; all, if that is not in the span of the terms.
    """
    points = np.random.default_rng(0).uniform(0.5, 2.0, (4 * len(terms) + GENERIC_POINTS, len(terms.variables.names)))
    with np.errstate(all="ignore"):
        values, slopes = terms.evaluate(points), terms.jacobian(points)[:, :, column]
    if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
        return np.zeros((len(terms), len(terms)), dtype=bool)
    mixtures = np.linalg.lstsq(values, slopes, rcond=1e-12)[0].T
    wrong = np.abs(values @ mixtures.T - slopes).max(axis=0) > ROUNDING * np.maximum(1.0, np.abs(slopes).max(axis=0))
    return np.where(wrong[:, np.newaxis], True, np.abs(mixtures) > ROUNDING)


def _betaln(a: float, b: float) -> float:
    """Return the logarithm of the beta function."""
    return lgamma(a) + lgamma(b) - lgamma(a + b)
