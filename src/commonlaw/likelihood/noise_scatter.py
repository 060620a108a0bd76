"""Noise that differs between objects, or trials: levels of largest posterior probability, evidence for their scatter.

Of m groups o with n_o measurements of a quantity, residual sums of squares R_o with nu_o degrees of freedom, and
logarithms u_o of the noise, minus twice the restricted log-likelihood (Patterson and Thompson 1971) is

    sum_o 2 nu_o u_o + R_o exp(-2 u_o).

About a mean of flat prior the u_o are normal. Of their variance, one prior observation is that of a natural unit; it is
integrated out: with ``Q = sum_o (u_o - mean u)^2``, minus twice the log prior is that of Student's t distribution of
one degree of freedom,

    m log(1 + Q) - 2 log Gamma(m / 2) + m log pi,

and by Laplace's method, with the information ``i_o = 2 n_o + k``, ``k = m / (1 + Q)``, the integral over the u_o costs

    sum_o log i_o - log(mean i) - (m - 1) log 2 pi

more. Without scatter there are no levels, and no costs: that is white noise.
"""

from collections.abc import Iterator
from math import lgamma
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.likelihood.outliers import median_noise

_MAX_ROUNDS = 100
_SAME_LOGARITHM = 1e-10
"""Change of logarithms of levels at which their iteration ends, after so many rounds at most."""


class NoiseByGroup(NamedTuple):
    """Residual sums of squares by group, their degrees of freedom, numbers of measurements, and least noise.

    Groups are objects or trials; each has the shape (groups, d).
    """

    squares: Floats
    freedom: Floats
    counts: Floats
    floors: Floats

    def merged(self, groups: Indices) -> "NoiseByGroup":
        """Return that of groups of these, given by number; their noise is at least the mean square of the least."""
        sums = np.zeros((4, int(groups.max()) + 1, self.squares.shape[1]))
        for total, values in zip(sums, (self.squares, self.freedom, self.counts, self.floors**2), strict=True):
            np.add.at(total, groups, values)
        squares, freedom, counts, floors = sums
        return NoiseByGroup(squares, freedom, counts, np.sqrt(floors / np.bincount(groups)[:, np.newaxis]))

    @property
    def evidence(self) -> Floats:
        """2 log B for the scatter of each quantity, its likelihood ratio being corrected as by Bartlett (1937)."""
        result = np.zeros(self.squares.shape[1])
        for j, (logs, squares, freedom, counts) in self._scattering():
            total = float(freedom.sum())
            ratio = total * np.log(squares.sum() / total) + total
            ratio -= float(np.sum(2 * freedom * logs + squares * np.exp(-2 * logs)))
            correction = 1 + (float(np.sum(1 / freedom)) - 1 / total) / (3 * (len(logs) - 1))
            result[j] = ratio / correction - cost_of_scatter(logs, counts)
        return result

    def levels(self, scatters: Bools) -> tuple[Floats, Floats]:
        """Return the noise of all objects, shape (d,), and the factors of each group, shape (groups, d).

        The noise of all is the root mean square over measurements. Factors are one of quantities that do not scatter,
        and of groups with less than one degree of freedom, or at rest.
        """
        noise = np.sqrt(self.squares.sum(axis=0) / np.maximum(self.freedom.sum(axis=0), 1.0))
        factors = np.ones(self.squares.shape)
        for j, (logs, _, _, counts) in self._scattering():
            if scatters[j]:
                noise[j] = np.sqrt(np.average(np.exp(2 * logs), weights=counts))
                factors[self._usable[:, j], j] = np.exp(logs) / noise[j]
        return noise, factors

    def degrees_of_freedom(self, scatters: Bools) -> Floats:
        """Return those of the noise of all objects, or where it scatters the fewest of one, shape (d,).

        The scatter is worth ``k / 2`` degrees of freedom of each.
        """
        result = np.asarray(self.freedom.sum(axis=0))
        for j, (logs, _, freedom, _) in self._scattering():
            if scatters[j]:
                result[j] = freedom.min() + scatter_weight(logs) / 2
        return result

    @property
    def _usable(self) -> Bools:
        moves = (self.floors > 0) | (self.squares > np.finfo(float).eps * self.squares.max(axis=0))
        return np.asarray((self.freedom >= 1) & moves)

    def _scattering(self) -> Iterator[tuple[int, tuple[Floats, Floats, Floats, Floats]]]:
        """Yield the quantities of two groups or more: likeliest logarithms, and the members of these groups."""
        for j, usable in enumerate(self._usable.T):
            if usable.sum() > 1 and self.squares[usable, j].any():
                yield j, (self._likeliest(j, usable), *(values[usable, j] for values in self[:3]))

    def _likeliest(self, j: int, usable: Bools) -> Floats:
        """Return the logarithms of levels of largest posterior probability of a quantity, shape (usable groups,).

        Each is the root of ``nu + k (u - mean u) = R exp(-2 u)`` with k and the mean of the last ones, by a Newton step
        in each round.
        """
        squares, freedom, _, floors = (values[usable, j] for values in self)
        tiny = np.finfo(float).tiny
        lowest = np.log(np.maximum(floors, tiny))
        logs = np.maximum(np.log(np.maximum(squares / freedom, tiny)) / 2, lowest)
        for _ in range(_MAX_ROUNDS):
            before, weight, precise = logs, scatter_weight(logs), squares * np.exp(-2 * logs)
            slopes = freedom + weight * (logs - logs.mean()) - precise
            logs = np.maximum(logs - slopes / (weight + 2 * precise), lowest)
            if np.abs(logs - before).max() < _SAME_LOGARITHM:
                break
        return np.asarray(logs)


def omitted_by_group(sizes: Floats, threshold: float) -> Bools:
    """Return which standardized residuals of a group, shape (n, d), are outliers by its own noise, too.

    They exceed the threshold under the present noise, and under that of their median size.
    """
    return np.asarray(np.abs(sizes) > threshold * np.maximum(median_noise(sizes), 1.0))


def scatter_weight(logs: Floats) -> float:
    """Return the weight ``k = m / (1 + Q)`` that the scatter of m logarithms of levels gives to their mean."""
    return len(logs) / (1 + float(np.sum((logs - logs.mean()) ** 2)))


def cost_of_scatter(logs: Floats, counts: Floats) -> float:
    """Return minus twice the logarithm of the prior of levels and of the volume of their likelihood."""
    count, weight = len(logs), scatter_weight(logs)
    prior = count * np.log(count / weight) - 2 * lgamma(count / 2) + count * np.log(np.pi)
    information = 2 * counts + weight
    volume = np.sum(np.log(information)) - np.log(information.mean()) - (count - 1) * np.log(2 * np.pi)
    return float(prior + volume)
