"""The weak form: smooth test functions of compact support, rows tested against them, their covariance, reweighting."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import AbstractDifferentiator, FiniteDifference, Rates, SmoothingSpline, noise_level
from commonlaw.errors import CommonlawError
from commonlaw.formulation.base import AbstractFormulation, check_order
from commonlaw.formulation.least_squares_problem import LeastSquaresProblem, merge
from commonlaw.library import Term, Terms, monomial
from commonlaw.trials import Trial, Trials

if TYPE_CHECKING:
    from scipy.sparse import csr_array


MIN_RADIUS = 14
"""In samples. The trapezoidal rule errs by the transform of a test function's derivative at the sampling rate, which is
below 1e-9 from here on."""

_POWER = 16
_WIDTH = sqrt(2 * _POWER + 3)
"""Radii in a test function's standard deviation."""


@dataclass(frozen=True, eq=False)
class CompactTestFunctions:
    """Functions ``(1 - s^2)^16`` with ``s = (t - centre) / radius``, zero outside ``|s| < 1``, in order of centres.

    They are nearly normal curves (standard deviation radius / 5.9) with fifteen continuous derivatives, so that sums
    over a regular grid are integrals to many digits (Messenger and Bortz 2021, "Weak SINDy for partial differential
    equations", section 3). Centres and radii are in units of time, shape (k,).
    """

    centres: Floats
    radii: Floats

    @classmethod
    def over(cls, times: Floats, radius: float, narrowest: float) -> "CompactTestFunctions":
        """Return test functions of a radius, in mean steps, all over a trial but for gaps.

        Toward the ends radii shrink to the narrowest; the trial has at least ``2 * min(radius, narrowest) + 1``
        samples. Centres are a standard deviation of the test function apart, and at least a step: then sums of test
        functions span all slower functions (at the band's edge transforms are a hundredth of the largest), and closer
        ones add nothing.
        """
        last = len(times) - 1
        margin = min(radius, narrowest)
        grid = np.linspace(margin, last - margin, 8 * len(times))
        radii = np.minimum(radius, np.minimum(grid, last - grid))
        density = np.minimum(_WIDTH / radii, 1)
        passed = np.append(0, np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(grid)))
        centres = np.interp((np.arange(int(passed[-1]) + 1) + passed[-1] % 1 / 2), passed, grid)
        radii = np.minimum(radius, np.minimum(centres, last - centres))
        step = (times[-1] - times[0]) / last
        functions, steps = cls(times[0] + step * centres, step * radii), np.diff(times)
        # No step that a test function takes is longer than half of its radius
        first = np.maximum(np.searchsorted(times, functions.centres - functions.radii, side="right") - 1, 0)
        after = np.minimum(np.searchsorted(times, functions.centres + functions.radii), len(steps))
        widest = np.array([steps[i:j].max() for i, j in zip(first, after, strict=True)])
        return functions._take(widest <= functions.radii / 2)

    def joined(self, other: "CompactTestFunctions") -> "CompactTestFunctions":
        """Return the test functions of both."""
        centres, radii = np.append(self.centres, other.centres), np.append(self.radii, other.radii)
        order = np.argsort(centres, kind="stable")
        return CompactTestFunctions(centres[order], radii[order])

    def weights(self, times: Floats, highest: int) -> "list[csr_array]":
        """Return weights, shape (k, n), that integrate samples against test functions and their derivatives up to 2.

        On a regular grid they are the trapezoidal rule, whose error falls faster than any power of the step if the test
        function is not too narrow. Otherwise a polynomial of degree 9 through the 10 samples nearest to each step, on
        irregular grids fitted to the nearest 16, is integrated with the test function by Gauss quadrature: at 100
        samples an oscillation to 1e-8, without the amplified noise of interpolation at random times.
        """
        from scipy.sparse import vstack

        step = (times[-1] - times[0]) / (len(times) - 1)
        uneven = 1e-6 * step  # What the times of a regular grid may be off
        even = bool(np.abs(np.diff(times) - step).max() <= uneven)
        wide = (self.radii > MIN_RADIUS * step - uneven) & even
        steps = np.full(len(times), step)
        summed = [self._take(wide)._values(times, steps, order) for order in range(highest + 1)]
        if wide.all():
            return summed
        nodes, gauss = np.polynomial.legendre.leggauss(8)
        halves = np.diff(times)[:, np.newaxis] / 2
        points = times[:-1, np.newaxis] + halves * (1 + nodes)
        narrow, factors = self._take(~wide), (halves * gauss).ravel()
        fit = _interpolation(times, points, 10 if even else 16, narrow._touched(times))
        fitted = [narrow._values(points.ravel(), factors, order) @ fit for order in range(highest + 1)]
        indices = np.argsort(np.append(np.flatnonzero(wide), np.flatnonzero(~wide)))
        return [vstack(pair, format="csr")[indices] for pair in zip(summed, fitted, strict=True)]

    def _touched(self, times: Floats) -> Bools:
        """Return which steps from one time to the next the functions are not zero in, shape (n - 1,)."""
        first = np.maximum(np.searchsorted(times, self.centres - self.radii, side="right") - 1, 0)
        after = np.minimum(np.searchsorted(times, self.centres + self.radii), len(times) - 1)
        changes = np.bincount(first, minlength=len(times)) - np.bincount(after, minlength=len(times))
        return np.asarray(np.cumsum(changes)[:-1] > 0)

    def _take(self, chosen: Bools) -> "CompactTestFunctions":
        return CompactTestFunctions(self.centres[chosen], self.radii[chosen])

    def _values(self, points: Floats, factors: Floats, derivative: int) -> "csr_array":
        """Return a derivative of the functions at increasing points, times a factor for each, shape (k, points)."""
        from scipy.sparse import csr_array

        first = np.searchsorted(points, self.centres - self.radii, side="right")
        counts = np.searchsorted(points, self.centres + self.radii) - first
        starts = np.append(0, np.cumsum(counts))
        function = np.repeat(np.arange(len(counts)), counts)
        index = np.arange(starts[-1]) + np.repeat(first - starts[:-1], counts)
        s = (points[index] - self.centres[function]) / self.radii[function]
        values = _derivative(s, derivative) / self.radii[function] ** derivative * factors[index]
        return csr_array((values, index, starts), shape=(len(counts), len(points)))


def corner_radius(times: Floats, states: Floats, noise: Floats) -> float:
    """Return the radius in samples of test functions that pass what is slower than the corner of the states' spectrum.

    Beyond the corner there is only noise (Messenger and Bortz 2021, section 4.2). It is at the number K of sine modes
    of least error by Mallows' Cp, their residual plus ``2 K noise^2``, of the state less the line through its ends; of
    several states, shape (n, d), the fastest counts. The radius puts the corner at two standard deviations of the test
    function's transform ``exp(-(omega radius / 5.9)^2 / 2)``. It is at least `MIN_RADIUS`, below which sums are no
    integrals, and otherwise at most a quarter of the trial.
    """
    from scipy.fft import dst

    last = len(times) - 1
    grid = np.linspace(times[0], times[-1], len(times))
    modes = 1
    for state, deviation in zip(states.T, noise, strict=True):
        even = np.interp(grid, times, state)
        bent = (even - np.linspace(even[0], even[-1], len(even)))[1:-1]
        gained = np.cumsum(dst(bent, type=1, norm="ortho") ** 2 - 2 * deviation**2)
        modes = max(modes, int(np.argmax(gained)) + 1)
    return float(np.clip(2 * _WIDTH * last / (np.pi * modes), MIN_RADIUS, max(MIN_RADIUS, last / 4)))


def _derivative(s: Floats, derivative: int) -> Floats:
    inside, p = 1 - s**2, _POWER
    if derivative == 0:
        return np.asarray(inside**p)
    if derivative == 1:
        return np.asarray(-2 * p * s * inside ** (p - 1))
    return np.asarray(2 * p * inside ** (p - 2) * ((2 * p - 1) * s**2 - 1))


def _interpolation(times: Floats, points: Floats, size: int, wanted: Bools) -> "csr_array":
    """Return the matrix, ((n - 1) m, n), from samples to values at points of each wanted step, (n - 1, m).

    Polynomials of degree 9 are fitted to so many samples, the nearest. Other steps have zeros.
    """
    from scipy.sparse import csr_array

    size = min(size, len(times))
    first = np.clip(np.flatnonzero(wanted) - size // 2 + 1, 0, len(times) - size)
    indices = first[:, np.newaxis] + np.arange(size)
    near = times[indices]
    middle, half = (near[:, [-1]] + near[:, [0]]) / 2, (near[:, [-1]] - near[:, [0]]) / 2
    powers = np.arange(min(9, size - 1) + 1)
    samples, inside = (((t - middle) / half)[:, :, np.newaxis] ** powers for t in (near, points[wanted]))
    weights = inside @ np.linalg.pinv(samples)
    columns = np.broadcast_to(indices[:, np.newaxis, :], weights.shape)
    starts = np.append(0, np.cumsum(np.repeat(np.where(wanted, size, 0), points.shape[1])))
    return csr_array((weights.ravel(), columns.ravel(), starts), shape=(points.size, len(times)))


@dataclass(frozen=True, eq=False)
class WeakRows:
    """The k rows of one trial, and how they depend on the noise of its n samples.

    Terms tested against the test functions have shape (k, terms), highest derivatives by parts (k, states). `noise` is
    that on each state, `of_targets` the weights of samples in the targets, shape (k, n). `slopes` has, for the test
    function and for its derivative where terms are integrated by parts, weights of shape (k, n) and derivatives of the
    terms by the states, shape (n, terms, states).
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
        """Return the rows of a trial in a law of order 1 or 2, from values of all variables, shape (n, variables)."""
        size = trial.states.shape[1]
        weights = test_functions.weights(trial.times, order)
        target = (-1) ** order * weights[order]
        primitives = {i: antiderivative(term, size) for i, term in enumerate(terms.terms) if order == 2}
        by_parts = {i: primitive for i, primitive in primitives.items() if primitive is not None}
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

        The residual of a row is ``b - A c``. Noise e on the samples changes it by ``L e``, with the weights of the
        samples in the target, less those in the terms times the slope of the right-hand side (Bortz, Messenger and
        Dukic 2023, "Direct estimation of parameters in ODE models using WENDy", section 2.3).
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
        """Return library and target rows with white noise in these equations, of unit variance if it is one.

        Several equations share one library, so rows are whitened by the mean of their covariances, each relative to the
        variance of the noise on its state. Coefficients have shape (equations, terms).
        """
        from scipy.linalg import cholesky_banded, lapack

        scales = self.noise[list(equations)] ** 2 / np.exp(np.mean(np.log(self.noise[list(equations)] ** 2)))
        parts = [self.covariance(coefficients[j], j) / scale for j, scale in zip(equations, scales, strict=True)]
        # The lower diagonals of a symmetric matrix, shape (bands, k), as LAPACK wants them
        matrix = sum(parts[1:], start=parts[0]) / len(parts)
        entries = matrix.tocoo()
        below = entries.row - entries.col
        bands = np.zeros((below.max() + 1, matrix.shape[0]))
        lower = below >= 0
        bands[below[lower], entries.col[lower]] = entries.data[lower]
        bands[0] *= 1 + 1e-10  # Errors of rounding and integration rule combinations of rows with less noise
        rows = np.concatenate([self.library, self.targets], axis=1)
        white, _ = lapack.dtbtrs(cholesky_banded(bands, lower=True), rows, uplo="L")
        return white[:, : self.library.shape[1]], white[:, self.library.shape[1] :]


def antiderivative(term: Term, states: int) -> tuple[float, Term] | None:
    """Return factor and monomial whose derivative by time is a term ``x^m v``; rates come behind so many states."""
    exponents = term.exponents or {}
    rates = [i for i in range(states) if exponents.get(states + i) == 1]
    if len(rates) != 1 or not exponents.keys() <= {rates[0], states + rates[0]}:
        return None
    power = exponents.get(rates[0], 0) + 1
    return 1 / power, monomial({rates[0]: power})


@dataclass(frozen=True, eq=False)
class WeakForm(AbstractFormulation):
    """Rows of ``x' = f(x)`` or ``x'' = f(x, x')``, each tested against a smooth test function phi of compact support.

    By parts, ``-int phi' x dt = sum_k c_k int phi theta_k dt``, and ``int phi'' x dt`` for second order: no derivative
    is estimated, and noise is averaged (Messenger and Bortz 2021, "Weak SINDy"). In laws of second order terms ``x^m
    v`` are integrated by parts exactly: ``int phi x^m v dt = -int phi' x^(m+1) / (m+1) dt``; others take rates of
    smoothed states.

    The noise of rows is correlated and heteroscedastic. For given coefficients its covariance is known to first order,
    and whitened rows make generalized least squares (Bortz, Messenger and Dukic 2023); `reweight` finds the
    coefficients. Then narrow test functions do no harm and one radius is enough, that of `corner_radius`, which shrinks
    toward the ends of a trial to 14 samples without noise and else to 3. From some 5 % of noise on, noise in the
    library rows matters, and rows of equal weight can be as good where terms are known.

    Raises `CommonlawError` if an argument does not fit.

    Parameters
    ----------
    order
        Order of the law: 1 or 2.
    radii
        Radii of test functions in samples, all of which are used; None chooses one for each trial.
    noise
        Standard deviations of the noise on each state; None estimates them from each trial.
    differentiation
        Smooths states before terms are evaluated, and gives rates in laws of second order; it should follow what is
        slower than the test functions. None: a cross-validated `SmoothingSpline`, or without noise `FiniteDifference`
        of accuracy 8.
    coefficients
        By object, shape (equations, terms), for the covariance. None leaves rows unweighted.
    equation
        Whose covariance whitens the rows; None takes the mean of all.
    tested_before
        Rows of trials before they are whitened, which `reweight` has computed.
    """

    order: int = 1
    radii: tuple[float, ...] | None = None
    noise: tuple[float, ...] | None = None
    differentiation: AbstractDifferentiator | None = None
    coefficients: Mapping[str, Floats] | None = None
    equation: int | None = None
    tested_before: Mapping[tuple[Trial, Terms], WeakRows] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        check_order(self.order)
        if self.radii is not None and not (self.radii and all(np.isfinite(r) and r >= 2 for r in self.radii)):
            raise CommonlawError("weak-radii", radii=self.radii)
        if self.noise is not None and not all(np.isfinite(number) and number >= 0 for number in self.noise):
            raise CommonlawError("weak-noise", noise=self.noise)

    def rows(self, trial: Trial, terms: Terms) -> tuple[Floats, Floats]:
        tested = self.tested(trial, terms)
        if self.coefficients is None:
            return tested.library, tested.targets
        known = range(trial.states.shape[1])
        if self.equation is not None and self.equation not in known:
            raise CommonlawError("weak-equation", where=trial.label, equation=self.equation, equations=len(known))
        return tested.whitened(self._known(trial, tested), (known if self.equation is None else (self.equation,)))

    def problems(self, trial: Trial, terms: Terms, segments: int = 1) -> list[LeastSquaresProblem]:
        library, targets = self.rows(trial, terms)
        if len(library) < segments:
            raise CommonlawError(
                "weak-too-few-rows", where=trial.label, samples=len(trial), rows=len(library), segments=segments
            )
        cut = zip(np.array_split(library, segments), np.array_split(targets, segments), strict=True)
        return [LeastSquaresProblem.of(*rows) for rows in cut]

    def tested(self, trial: Trial, terms: Terms) -> WeakRows:
        """Return the rows of a trial before they are whitened, with what makes their covariance, see `rows`."""
        if (trial, terms) in self.tested_before:
            return self.tested_before[trial, terms]
        clock, trial = trial.times, replace(trial, times=since_start(trial.times))
        times, ranges = trial.times, np.ptp(trial.states, axis=0)
        if self.noise is not None and len(self.noise) != len(ranges):
            raise CommonlawError("weak-noise-size", where=trial.label, given=len(self.noise), states=len(ranges))
        least = 2 * MIN_RADIUS + 1
        if len(trial) < least:
            raise CommonlawError("weak-too-few-samples", where=trial.label, samples=len(trial), least=least)
        noise = noise_level(times, trial.states) if self.noise is None else np.array(self.noise)
        noise = np.asarray(np.maximum(noise, 1e-9 * ranges))  # About the errors of integration
        radii = (corner_radius(times, trial.states, noise),) if self.radii is None else self.radii
        # Noise is then worse than the errors of integration of such narrow ones, by which the ends of a trial are used
        narrowest = 3 if np.all(noise > 1e-4 * ranges) else MIN_RADIUS
        by_radius = [CompactTestFunctions.over(times, radius, narrowest) for radius in radii]
        test_functions = reduce(CompactTestFunctions.joined, by_radius)
        if not len(test_functions.centres):
            shown = ", ".join(f"{radius:g}" for radius in radii)
            raise CommonlawError("weak-gaps", where=trial.label, samples=len(trial), radii=shown)
        # States that terms are evaluated on, and for order 2 their rates, each of shape (n, states)
        rates = list[Rates]()
        for i, is_exact in enumerate(noise <= 1e-7 * ranges):
            method = self.differentiation or (FiniteDifference(8) if is_exact else SmoothingSpline())
            try:
                rates.append(method.differentiate(times, trial.states[:, [i]], 1))
            except CommonlawError as error:
                raise error.at(trial.label) from None
        columns = [rate.states for rate in rates]
        columns += [rate.derivatives[0] for rate in rates] * (self.order - 1)
        values = np.concatenate([*columns, trial.inputs, clock[:, np.newaxis]], axis=1)
        terms.check_finite(terms.evaluate(values), values, trial.label)
        return WeakRows.of(test_functions, trial, terms, values, noise, self.order)

    def _known(self, trial: Trial, tested: WeakRows) -> Floats:
        """Return the coefficients of a trial's object, shape (equations, terms)."""
        known = None if self.coefficients is None else self.coefficients.get(trial.object)
        wanted = tested.targets.shape[1], tested.library.shape[1]
        if known is None or known.shape != wanted:
            what = "none" if known is None else f"coefficients of shape {known.shape}"
            raise CommonlawError("weak-whitening", where=trial.label, shape=wanted, given=what, object=trial.object)
        return known


def since_start(times: Floats) -> Floats:
    """Return times since the first, shape (n,), on a regular grid if they are off it by rounding alone.

    Seconds since 1970 are rounded to a quarter of a microsecond.
    """
    passed = times - times[0]
    grid = np.linspace(0, passed[-1], len(times))
    rounding = 2 * np.spacing(np.abs(times).max())
    return grid if np.all(np.abs(passed - grid) <= rounding) else passed


def reweight(trials: Trials, terms: Terms, form: WeakForm) -> tuple[WeakForm, dict[str, Floats]]:
    """Return the form with coefficients that fit the rows that they whiten, and the coefficients of each object.

    Iteratively reweighted least squares: each sweep is generalized least squares with the covariance at the
    coefficients before it, for each equation its own; the first is ordinary least squares. Raises `CommonlawError` if a
    trial cannot be used.
    """
    states = len(trials.schema.states)
    tested = {(trial, terms): form.tested(trial, terms) for trial in trials}
    result = {
        name: _coefficients([tested[trial, terms] for trial in trials.of_object(name)], states)
        for name in trials.objects
    }
    return replace(form, coefficients=result, tested_before=tested), result


def _coefficients(tested: Sequence[WeakRows], equations: int) -> Floats:
    """Return the coefficients of one object, shape (equations, terms)."""
    plain = merge(LeastSquaresProblem.of(rows.library, rows.targets) for rows in tested)
    used = np.ones(plain.terms, dtype=np.bool_)
    result = np.array([plain.least_squares(used, j) for j in range(equations)])
    for j in range(equations):
        for _ in range(30):
            problem = merge(LeastSquaresProblem.of(*rows.whitened(result, (j,))) for rows in tested)
            before, result[j] = result[j].copy(), problem.least_squares(used, j)
            change, size = (np.linalg.norm(problem.norms * row) for row in (result[j] - before, result[j]))
            if change <= 1e-6 * size:  # Further steps change no digit that noise leaves
                break
    return result
