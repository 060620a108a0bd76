"""Priors: of supports, what it costs to say which terms an equation has; of levels of errors, whatever the law."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import lgamma

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.data.noise import noise_told
from commonlaw.inference.score.evidence import Measured
from commonlaw.inference.settings import GENERIC_POINTS, MIN_NOISE, RESOLVED_NOISE, ROUNDING
from commonlaw.library import Order, Terms
from commonlaw.likelihood import ErrorModel, Mesh
from commonlaw.trials import Trials
from commonlaw.trials.repeats import pure_error
from commonlaw.trials.trial import with_typical


@dataclass(frozen=True, eq=False)
class Measurements:
    """All trials, and the meshes of all objects, one behind the other.

    Parameters
    ----------
    trials
        What was measured.
    meshes
        Of all objects.
    states
        The states (and rates) at which noise in proportion is taken, of each mesh, shape (n, D).
    noise_estimate
        The noise of each state before any law, shape (d,).
    order
        Of the laws.
    count
        How many numbers were measured.
    noise_is_fixed
        Whether what a law leaves does not change the noise.
    prior
        Measurements of each state that the first estimate of its noise is worth.
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
        """Return the white noise of all measurements, shape (points, d), if that of the states has shape (d,).

        States that never change tell nothing of it, and keep that estimated first; those that are exactly zero, such as
        a species that is absent, have none.
        """
        std = errors.white_std(self._usual_states, with_typical(self._given, noise))
        still = np.where(self._absent, MIN_NOISE * self.noise_estimate, self.noise_estimate)
        return np.where(self._still, with_typical(self._given, still), std) * self._averaging

    def counted(self, noise: Floats, errors: ErrorModel, std: Floats) -> Measured:
        """Return how many numbers were measured, and how surely they tell the scale of noise that has these levels.

        The noise estimated first counts as `prior` measurements of each state (an inverse gamma distribution of the
        variance). Of exact measurements laws may leave less than what they are fitted under, and then those count for
        more that leave less, down to a share of it; but digits tell no less than their steps.
        """
        if self.noise_is_fixed:
            return Measured(self.count)
        inflation = self._inflation(noise, errors, std)
        prior, least = self.prior * float(np.sum(1 / inflation)), self._floors[1] / noise
        squares, repeated = self.pure_error
        freedom = self._freedom + float(repeated.sum()) + self.prior * len(inflation)
        prior += float(np.sum(squares / noise**2))
        return Measured(self.count, freedom, prior, least=float(np.max(least) ** 2))

    def least_variance(self, noise: Floats) -> float:
        """Return what the variance of the noise that laws are fitted under is at least, in units of what it is."""
        return float(np.max(self._floors[0] / noise) ** 2)

    def price(self, noise: Floats, errors: ErrorModel, std: Floats) -> float:
        """Return what levels cost: each but those of the noise as any number (BIC), the noise by its prior."""
        price = errors.hyperparameters * float(np.log(self.count))
        if not self.noise_is_fixed:
            price += self.prior * float(np.sum(np.log(self._inflation(noise, errors, std))))
        return price

    def _inflation(self, noise: Floats, errors: ErrorModel, std: Floats) -> Floats:
        """Return the variance of the noise over that estimated first, of each state that was measured.

        It is what differences of neighbouring samples see: of errors with a memory, the share at the highest frequency.
        """
        relative = np.where(self._absent, 1.0, std / (with_typical(self._given, noise) * self._averaging))
        variance = noise**2 * np.mean(relative**2, axis=0)
        if errors.correlated is not None:
            variance = variance + errors.correlated**2 * np.tanh(self._step / (2 * errors.memory))
        return np.asarray(variance / self.noise_estimate**2)[~self.trials.schema.unmeasured]

    @cached_property
    def measured(self) -> Floats:
        """States as measured at all points, shape (points, d); NaN where they were not."""
        return np.concatenate([each.measured for each in self.meshes])

    @cached_property
    def _usual_states(self) -> Floats:
        return np.concatenate(self.states)[:, : len(self.noise_estimate)]

    @cached_property
    def _given(self) -> Floats:
        return np.concatenate([np.broadcast_to(each.noise, each.measured.shape) for each in self.meshes])

    @cached_property
    def _averaging(self) -> Floats:
        return np.concatenate([np.broadcast_to(each.averaging, each.measured.shape) for each in self.meshes])

    @cached_property
    def _still(self) -> Bools:
        return np.concatenate([each.still for each in self.meshes])

    @cached_property
    def _absent(self) -> Bools:
        return np.concatenate([each.absent for each in self.meshes])

    @cached_property
    def pure_error(self) -> tuple[Floats, Floats]:
        """The squares of repeated measurements of each state and their degrees of freedom, each of shape (d,)."""
        return pure_error([trial.repeats for trial in self.trials], len(self.noise_estimate))

    @cached_property
    def _freedom(self) -> int:
        return sum(each.degrees_of_freedom(self.order) for each in self.meshes)

    @cached_property
    def _floors(self) -> tuple[Floats, Floats]:
        return noise_told(self.trials, RESOLVED_NOISE)

    @cached_property
    def _step(self) -> float:
        return float(np.median(np.concatenate([np.diff(trial.times) for trial in self.trials])))


@dataclass(frozen=True, eq=False)
class StructurePrior:
    """The prices of supports of one equation.

    Parameters
    ----------
    terms
        Of each term for what it is written with, shape (terms,).
    shifted
        For each state whose zero nothing measured, which terms each term takes to keep its form where the state is
        counted from elsewhere, shape (terms, terms).
    zero
        Of a law that says where such a zero is: it is right by chance, and a number that is fitted would cost as much.
    besides
        Terms that were to choose from and are not among these.
    """

    terms: Floats
    shifted: Sequence[Bools] = ()
    zero: float = 0.0
    besides: int = 0

    def of(self, support: Bools) -> float:
        """Return the price of a support, shape (terms,).

        Terms are in it with a probability that is not known, of which one of a library is expected: it has the beta
        distribution of the parameters 1 and the number of terms (Castillo, Schmidt-Hieber and van der Vaart 2015).
        """
        count, size = len(support) + self.besides, int(support.sum())
        likely = _betaln(1 + size, 2 * count - size) - _betaln(1, count)
        zeros = sum(bool((each[support] & ~support).any()) for each in self.shifted)
        return -2 * likely + float(self.terms[support].sum()) + zeros * self.zero


def complexity_prices(terms: Terms) -> Floats:
    """Return what terms cost, shape (terms,): each factor one bit, by which a text tells whether a term goes on."""
    return np.asarray(2 * np.log(2) * terms.complexities)


def shifted(terms: Terms, column: int) -> Bools:
    """Return which other terms each term takes where a variable is counted from elsewhere, shape (terms, terms).

    They are those of its derivative by the variable; all, where that is no sum of terms.
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
