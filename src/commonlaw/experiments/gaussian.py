"""Predictions of hypotheses for measurements that are still to be made, and how well these discriminate them.

Each hypothesis is linearised about its coefficients: measurements are normal, y = mean + J u + S s + noise, with u the
standard normal unknowns of its coefficients and s a start that the experiment itself has to tell. So a hypothesis is
fitted again, within its errors, before it is compared (Box and Hill 1967), and its start freely.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.runtime.forking import cached_property


@dataclass(frozen=True, eq=False)
class Gaussian:
    """What a hypothesis predicts of one trial: a normal distribution of its n measurements.

    Parameters
    ----------
    mean
        Shape (n,).
    by_unknowns, by_start
        Derivatives by the standard normal unknowns of the coefficients, shape (n, p), and by free initial values, (n,
        D).
    noise
        Variances of the white noise, shape (n,).
    coloured, common
        Covariances, shape (n, n), of other errors that are new in each repeat, and that repeats have in common.
    repeats
        How often the trial is made.
    """

    mean: Floats
    by_unknowns: Floats
    by_start: Floats
    noise: Floats
    coloured: Floats | None = None
    common: Floats | None = None
    repeats: float = 1.0

    @cached_property
    def root(self) -> Floats:
        """The lower factor of the covariance of the mean of all repeats, at given unknowns, shape (n, n)."""
        if self.coloured is None and self.common is None:
            return np.diag(np.sqrt(self.noise / self.repeats))
        anew = np.diag(self.noise) + (0.0 if self.coloured is None else self.coloured)
        return np.asarray(np.linalg.cholesky(anew / self.repeats + (0.0 if self.common is None else self.common)))

    @property
    def is_finite(self) -> bool:
        """Whether the covariance of its errors can be factorised: its numbers are not too far apart."""
        try:
            return bool(np.isfinite(self.root).all())
        except np.linalg.LinAlgError:  # Not positive definite after rounding
            return False

    @property
    def variances(self) -> Floats:
        """Of single measurements from the start that is set, shape (n,)."""
        shared = sum(np.diag(part) for part in (self.coloured, self.common) if part is not None)
        return np.asarray(np.sum(self.by_unknowns**2, axis=1) + self.noise + shared)

    def drawn(self, noise: Floats) -> Floats:
        """Return measurements with what standard normal numbers, as many or more, make of their errors, shape (n,)."""
        return np.asarray(self.mean + self.root @ noise[: len(self.mean)])

    def white(self, values: Floats) -> Floats:
        """Return values in the units of the errors of the mean of all repeats, which do not hang together, (n, k)."""
        if self.coloured is None and self.common is None:
            return np.asarray(values / np.sqrt(self.noise / self.repeats)[:, np.newaxis])
        return np.asarray(np.linalg.solve(self.root, values))

    @cached_property
    def whitened(self) -> "Whitened":
        """What of the measurements does not depend on the start."""
        turn = self.white(np.eye(len(self.mean)))
        basis, sizes, _ = np.linalg.svd(turn @ self.by_start, full_matrices=True)
        # Of smaller directions of the start the measurements say nothing
        identified = sizes > 1e-10 * sizes.max(initial=0.0)
        contrasts = basis[:, int(identified.sum()) :].T @ turn
        constant = float(2 * np.log(sizes[identified]).sum() - 2 * np.log(np.diag(turn)).sum())
        return Whitened(contrasts, contrasts @ self.by_unknowns, constant)


class Whitened(NamedTuple):
    """Contrasts of measurements that do not depend on the start.

    Their noise is standard normal, shape (q, n); with derivatives by the unknowns, shape (q, p), and minus twice the
    logarithm of the density's factor, but for what all hypotheses share.
    """

    contrasts: Floats
    slopes: Floats
    constant: float


@dataclass(frozen=True, eq=False)
class Draws:
    """Common random numbers of all experiments: unknowns of hypotheses, shape (draws, p), and noise."""

    unknowns: tuple[Floats, ...]
    noise: Floats

    @classmethod
    def of(cls, sizes: Sequence[int], measurements: int, count: int, seed: Sequence[int], own: int) -> Self:
        """Return draws; `own` are those of one experiment among several, the unknowns being the same in all."""
        random = np.random.default_rng(seed)
        unknowns = tuple(random.standard_normal((count, size)) for size in sizes)
        return cls(unknowns, np.random.default_rng([*seed, own]).standard_normal((count, measurements)))


@dataclass(frozen=True, eq=False)
class Evidence:
    """Likelihoods of draws, made by each of K hypotheses, under all of them; those of several trials add up.

    `deviance` is minus twice the log-density at the hypotheses' own coefficients, shape (K that made them, K, draws),
    `gradients` those of its negative half by the unknowns, (K, draws, p), and `information` that on the unknowns,
    (K, draws, p, p), or (1, 1, p, p) if it is the same in all draws.
    """

    deviance: Floats
    gradients: tuple[Floats, ...]
    information: tuple[Floats, ...]

    @classmethod
    def of(cls, hypotheses: Sequence[Gaussian], draws: Draws) -> Self:
        """Return that of one trial, of which each hypothesis predicts the same in all draws."""
        noise = draws.noise[:, : len(hypotheses[0].mean)]
        made = [
            hypothesis.mean + unknowns @ hypothesis.by_unknowns.T + noise @ hypothesis.root.T
            for hypothesis, unknowns in zip(hypotheses, draws.unknowns, strict=True)
        ]
        return cls.about(np.concatenate(made), [[hypothesis] for hypothesis in hypotheses])

    @classmethod
    def about(cls, measured: Floats, hypotheses: Sequence[Sequence[Gaussian]]) -> Self:
        """Return that of one trial, with what each hypothesis predicts of all draws, or of each of them.

        Measurements, shape (K draws, n), are in the order of the hypotheses that made them.
        """
        shape = (len(hypotheses), len(measured) // len(hypotheses))
        deviance, gradients, information = [], [], []
        for hypothesis in hypotheses:
            values, gradient, known = list[Floats](), list[Floats](), list[Floats]()
            for predicted, rows in zip(hypothesis, np.split(measured, len(hypothesis)), strict=True):
                whitened = predicted.whitened
                off = (rows - predicted.mean) @ whitened.contrasts.T
                values.append(np.sum(off**2, axis=1) + whitened.constant)
                gradient.append(off @ whitened.slopes)
                known.append(whitened.slopes.T @ whitened.slopes)
            deviance.append(np.concatenate(values).reshape(shape))
            gradients.append(np.concatenate(gradient).reshape(*shape, -1))
            information.append(np.reshape(known, (*(shape if len(known) > 1 else (1, 1)), *known[0].shape)))
        return cls(np.stack(deviance, axis=1), tuple(gradients), tuple(information))

    def __add__(self, other: "Evidence") -> "Evidence":
        return Evidence(
            self.deviance + other.deviance,
            tuple(gradient + two for gradient, two in zip(self.gradients, other.gradients, strict=True)),
            tuple(one + two for one, two in zip(self.information, other.information, strict=True)),
        )

    @cached_property
    def _whole(self) -> tuple[Floats, ...]:
        """The precision of each hypothesis' unknowns afterwards, shaped like the information."""
        return tuple(np.eye(information.shape[-1]) + information for information in self.information)

    @cached_property
    def estimates(self) -> tuple[Floats, ...]:
        """Of each hypothesis its unknowns as they are fitted to the draws, shape (K, draws, p)."""
        pairs = zip(self._whole, self.gradients, strict=True)
        return tuple(np.asarray(np.linalg.solve(whole, pull[..., np.newaxis])[..., 0]) for whole, pull in pairs)

    @cached_property
    def covariances(self) -> tuple[Floats, ...]:
        """Of each hypothesis that of its unknowns afterwards, shaped like the information."""
        return tuple(np.asarray(np.linalg.inv(precision)) for precision in self._whole)

    def gain(self) -> Floats:
        """Return what unknowns are known better by (the logarithm of D), in nats, shape (K or 1, K, draws or 1)."""
        return np.stack([np.linalg.slogdet(precision)[1] / 2 for precision in self._whole], axis=1)

    @cached_property
    def log_densities(self) -> Floats:
        """Of the draws under each hypothesis, its coefficients integrated out, shape (K that made them, draws, K)."""
        gained = np.stack([np.sum(a * b, axis=2) for a, b in zip(self.gradients, self.estimates, strict=True)], axis=1)
        logs = -(self.deviance - gained) / 2 - self.gain()
        return np.asarray(logs.swapaxes(1, 2))

    def probabilities(self, prior: Floats) -> Floats:
        """Return how probable draws make each hypothesis, shape (K that made them, draws, K)."""
        logs = np.log(prior) + self.log_densities
        shares = np.exp(logs - logs.max(axis=2, keepdims=True))
        return np.asarray(shares / shares.sum(axis=2, keepdims=True))

    def information_about_law(self, prior: Floats) -> float:
        """Return how much is learned of which hypothesis is right, in nats (Jensen and Shannon's divergence)."""
        logs = np.log(np.maximum(self.probabilities(prior), np.finfo(float).tiny))
        true_logs = np.mean(np.diagonal(logs, axis1=0, axis2=2), axis=0)
        return float(prior @ (true_logs - np.log(prior)))

    def chance(self, prior: Floats) -> float:
        """Return how probable the most probable hypothesis then is: how probable it is that this is the right one."""
        return float(prior @ self.probabilities(prior).max(axis=2).mean(axis=1))
