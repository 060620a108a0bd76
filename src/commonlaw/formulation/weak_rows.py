"""The rows of a trial in weak form, and their covariance."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.formulation.compact_test_functions import CompactTestFunctions
from commonlaw.library import Term, Terms, monomial
from commonlaw.trials import Trial

if TYPE_CHECKING:
    from scipy.sparse import csr_array


_RIDGE = 1e-10
"""Share of the mean variance of rows that is added to each variance. Combinations of rows with less noise than that are
ruled by errors of rounding and of integration instead."""


@dataclass(frozen=True, eq=False)
class WeakRows:
    """The rows of one trial, k of them, and how they depend on the noise of its n samples.

    They are the terms tested against the test functions, shape (k, terms), and the highest derivatives tested against
    them by parts, shape (k, states). The noise is the standard deviation on each state, and `of_targets` the weights of
    the samples in the targets, shape (k, n). How terms depend on the samples is told by `slopes`, for the test function
    itself, and for its derivative where terms are integrated by parts: by weights of shape (k, n) and what they weigh,
    derivatives of the terms by the states at the samples, of shape (n, terms, states).
    """

    library: Floats
    targets: Floats
    noise: Floats
    of_targets: "csr_array"
    slopes: tuple[tuple["csr_array", Floats], ...]

    @classmethod
    def of(
        cls, test_functions: CompactTestFunctions, trial: Trial, terms: Terms, values: Floats, noise: Floats, order: int
    ) -> "WeakRows":
        """Return the rows of a trial in a law of order 1 or 2.

        Terms are evaluated at values of the states, for order 2 of their rates, and of inputs and time, shape
        (n, variables); the trial's states make the targets.
        """
        size = trial.states.shape[1]
        weights = test_functions.weights(trial.times, order)
        target = (-1) ** order * weights[order]
        primitives = {i: antiderivative(term, size) for i, term in enumerate(terms.terms) if order == 2}
        by_parts = {i: each for i, each in primitives.items() if each is not None}
        library = weights[0] @ terms.evaluate(values)
        slopes = terms.jacobian(values)
        # Where a slope is not finite, as that of a root at 0, the noise of one sample is taken for nothing
        slopes = np.where(np.isfinite(slopes), slopes, 0.0)
        parted = np.zeros((len(values), len(terms), size))
        for i, (factor, term) in by_parts.items():
            library[:, i] = weights[1] @ (-factor * term.evaluate(values))
            parted[:, i] = -factor * term.gradient(values)[:, :size]
        slopes[:, [*by_parts]] = 0
        pairs = [(weights[0], slopes[:, :, :size])]
        if order == 2:
            # Noise on a rate is the derivative of that on its state; by parts it goes to the test function and to the
            # slope
            of_rates = slopes[:, :, size : 2 * size]
            bent = np.gradient(of_rates, trial.times, axis=0)
            pairs = [(weights[0], slopes[:, :, :size] - bent), (weights[1], parted - of_rates)]
        return cls(library, target @ trial.states, noise, target, tuple(pairs))

    def covariance(self, coefficients: Floats, equation: int) -> "csr_array":
        """Return the covariance of the residuals of one equation at its coefficients, linear in the noise: (k, k).

        The residual of a row is ``b - A c``. Noise e on the samples changes it by ``L e``, where L has the weights of
        the samples in the target, and less these the weights in the terms times the slope of the equation's right-hand
        side at the samples (Bortz, Messenger and Dukic 2023, "Direct estimation of parameters in ODE models using
        WENDy", section 2.3).
        """
        from scipy.sparse import csr_array

        total = csr_array((len(self.library),) * 2)
        for i, deviation in enumerate(self.noise):
            response = self.of_targets if i == equation else csr_array(self.of_targets.shape)
            for weights, slopes in self.slopes:
                response = response - weights.multiply(slopes[:, :, i] @ coefficients).tocsr()
            total = total + deviation**2 * (response @ response.T)
        return total

    def whitened(self, coefficients: Floats, equations: Sequence[int]) -> tuple[Floats, Floats]:
        """Return library and target rows whose noise is white in these equations, of unit variance if it is one.

        Rows of several equations have different covariances but one library, so one matrix must serve them all: the
        mean of the covariances, each relative to the variance of the noise on its state. The coefficients, of all
        equations, have shape (equations, terms).
        """
        from scipy.linalg import cholesky_banded, lapack

        scales = self.noise[list(equations)] ** 2 / np.exp(np.mean(np.log(self.noise[list(equations)] ** 2)))
        parts = [self.covariance(coefficients[j], j) / scale for j, scale in zip(equations, scales, strict=True)]
        bands = _bands(sum(parts[1:], start=parts[0]) / len(parts))
        bands[0] *= 1 + _RIDGE
        rows = np.concatenate([self.library, self.targets], axis=1)
        white, _ = lapack.dtbtrs(cholesky_banded(bands, lower=True), rows, uplo="L")
        return white[:, : self.library.shape[1]], white[:, self.library.shape[1] :]


def antiderivative(term: Term, states: int) -> tuple[float, Term] | None:
    """Return factor and monomial of which a term is the derivative by time, if it is one like ``x^m v``.

    Of the variables of the term so many are states, and as many after them their rates.
    """
    exponents = term.exponents or {}
    rates = [i for i in range(states) if exponents.get(states + i) == 1]
    if len(rates) != 1 or not exponents.keys() <= {rates[0], states + rates[0]}:
        return None
    power = exponents.get(rates[0], 0) + 1
    return 1 / power, monomial({rates[0]: power})


def _bands(matrix: "csr_array") -> Floats:
    """Return the lower diagonals of a symmetric matrix, shape (bands, k), as LAPACK wants them."""
    entries = matrix.tocoo()
    below = entries.row - entries.col
    bands = np.zeros((below.max() + 1, matrix.shape[0]))
    lower = below >= 0
    bands[below[lower], entries.col[lower]] = entries.data[lower]
    return bands
