"""The observation model: white noise with the Huber loss, and latent Gauss-Markov processes."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.likelihood.mesh import Mesh
from commonlaw.runtime.fit_options import FitOptions


@dataclass(frozen=True, eq=False)
class LatentSteps:
    """The standardized increments of latent processes along one mesh.

    For the values before and after a step, shape (w,), ``start @ before + end @ after`` is standard normal; both have
    shape (n - 1, w, w), zero between segments; a drift has none, as it follows from its values at first points. There,
    values are independent with precisions `anchors`, shape (n, w), zero elsewhere. Along the mesh they have standard
    deviations of up to `std`, shape (w,). Columns of forces begin at `force`.
    """

    start: Floats
    end: Floats
    anchors: Floats
    std: Floats
    force: int | None


@dataclass(frozen=True, eq=False)
class LatentProcesses:
    """Latent processes: autocorrelated measurement errors, random forces, and rates of the forces, or a drift.

    An autocorrelated measurement error (Ornstein-Uhlenbeck) has the standard deviation `correlated`, shape (d,), and
    the time constant `memory`; if that is infinite it is a Wiener process, zero at first points, and `correlated` its
    standard deviation after a unit of time. A force on the highest derivatives (Matern process of smoothness 3/2) has
    the standard deviation `force`, shape (d,), and the length scale `force_time`. A drift, without other processes,
    is the error ``b0 + b1 t`` for the time t since the first point of each segment, and its slope b1, with standard
    deviations `offset` of b0 and `slope` of b1, whose mean is `trend`, shape (d,) each.
    """

    correlated: Floats | None = None
    memory: float = np.inf
    force: Floats | None = None
    force_time: float = np.inf
    offset: Floats | None = None
    slope: Floats | None = None
    trend: Floats | None = None

    @property
    def width(self) -> int:
        """Number of processes."""
        return self.chained if self.drift is None else len(self.drift)

    @property
    def chained(self) -> int:
        """Number of processes with increments in each step, which are eliminated point by point with the states."""
        errors, forces = (0 if level is None else len(level) for level in (self.correlated, self.force))
        return errors + 2 * forces

    @property
    def drift(self) -> Floats | None:
        """The standard deviations of the drift of each state at first points, then of its slopes, shape (2 d,)."""
        return None if self.offset is None or self.slope is None else np.concatenate([self.offset, self.slope])

    @property
    def are_measured(self) -> bool:
        """Whether the first processes are errors of the measured states."""
        return self.correlated is not None or self.drift is not None

    @property
    def std(self) -> Floats:
        """The standard deviations of all processes, shape (w,), of Wiener processes after a unit of time."""
        if self.drift is not None:
            return self.drift
        levels = [] if self.correlated is None else [self.correlated]
        if self.force is not None:
            levels += [self.force, np.sqrt(3) / self.force_time * self.force]
        return np.concatenate([np.zeros(0), *levels])

    @property
    def mean(self) -> Floats:
        """The means of all processes at first points, shape (w,), zero but for the slopes of a drift."""
        result = np.zeros(self.width)
        if self.trend is not None:
            result[-len(self.trend) :] = self.trend
        return result

    @property
    def walks(self) -> bool:
        """Whether autocorrelated errors are Wiener processes."""
        return self.correlated is not None and self.memory == np.inf

    def error_std(self, time: float) -> Floats:
        """Return the standard deviation of autocorrelated errors, shape (d,), of a Wiener process after a time."""
        errors = np.zeros(1) if self.correlated is None else self.correlated
        return errors * np.sqrt(time) if self.walks else errors

    def along(self, mesh: Mesh) -> LatentSteps:
        """Return the processes along a mesh."""
        if self.drift is not None:
            none = np.empty((len(mesh) - 1, 0, 0))
            return LatentSteps(none, none, mesh.first[:, np.newaxis] / self.drift**2, self.drift, None)
        starts, ends, std = [], [], self.std
        at_first = std.copy()
        if self.correlated is not None:
            kept, variances = transition(mesh.steps, self.memory)
            added = self.correlated * np.sqrt(variances)[:, np.newaxis]
            starts.append(_diagonal(-kept[:, np.newaxis], added, mesh))
            ends.append(_diagonal(np.ones((1, 1)), added, mesh))
            count = len(self.correlated)
            std[:count] = self.error_std(len(mesh) * mesh.typical_step)
            if self.walks:
                at_first[:count] = _ZERO * self.error_std(mesh.typical_step)
        if self.force is not None:
            start, end = _matern(self.force, self.force_time, mesh)
            starts.append(start)
            ends.append(end)
        first = mesh.first[:, np.newaxis]
        force = None if self.force is None else len(std) - 2 * len(self.force)
        return LatentSteps(_joined(starts), _joined(ends), first / at_first**2, std, force)


NO_PROCESSES = LatentProcesses()
"""White noise alone."""

_ZERO = 1e-6
"""Standard deviation of a Wiener process at first points, where it is zero, in units of that after a step."""


def transition(steps: Floats, memory: float) -> tuple[Floats, Floats]:
    """Return what autocorrelated errors of level one keep in steps in time, and the variance that these add."""
    kept = steps / memory
    return np.exp(-kept), steps if np.isinf(memory) else -np.expm1(-2 * kept)


def _diagonal(values: Floats, added: Floats, mesh: Mesh) -> Floats:
    """Return diagonal matrices of values over standard deviations, shape (n - 1, d, d), zero between segments."""
    matrices = np.zeros((*added.shape, added.shape[1]))
    scaled = np.divide(values, added, out=np.zeros_like(added), where=mesh.contiguous[:, np.newaxis])
    matrices[:, range(added.shape[1]), range(added.shape[1])] = scaled
    return matrices


def _matern(std: Floats, time: float, mesh: Mesh) -> tuple[Floats, Floats]:
    """Return the standardized increments of Matern-3/2 forces and their rates, each of shape (n - 1, 2 d, 2 d).

    A step of a = sqrt(3) h / time has the innovation covariance P - F P F', with transition F and stationary covariance
    P (Hartikainen and Sarkka 2010), from incomplete gamma functions, which keep their digits for short steps.
    """
    from scipy.special import gammainc

    rate = np.sqrt(3) / time
    a = np.where(mesh.contiguous, rate * mesh.steps, 1.0)
    decay, short = np.exp(-a), gammainc(3, 2 * a)
    variance, across, of_rates = short, 2 * (a * decay) ** 2, short + 4 * a * decay**2
    # Inverse Cholesky factor of the covariance, for unit variance and unit time
    first = 1 / np.sqrt(variance)
    last = 1 / np.sqrt(of_rates - across**2 / variance)
    inverse = np.array([[first, np.zeros_like(a)], [-across / variance * last, last]]).transpose(2, 0, 1)
    transition = decay[:, np.newaxis, np.newaxis] * np.array([[1 + a, a], [-a, 1 - a]]).transpose(2, 0, 1)
    steps = []
    for matrices in (-inverse @ transition, inverse):
        wide = np.zeros((len(a), 2, len(std), 2, len(std)))
        for j, sigma in enumerate(std):
            wide[:, :, j, :, j] = (
                matrices / np.array([sigma, rate * sigma]) * mesh.contiguous[:, np.newaxis, np.newaxis]
            )
        steps.append(wide.reshape(len(a), 2 * len(std), 2 * len(std)))
    return steps[0], steps[1]


def _joined(blocks: list[Floats]) -> Floats:
    """Return block-diagonal matrices, shape (n - 1, w, w)."""
    width = sum(block.shape[1] for block in blocks)
    joint, at = np.zeros((len(blocks[0]), width, width)), 0
    for block in blocks:
        stop = at + block.shape[1]
        joint[:, at:stop, at:stop] = block
        at = stop
    return joint


VERY_STRONG = 10.0
"""2 log B above which evidence, as for outliers, is very strong (Kass and Raftery 1995)."""
HUBER_THRESHOLD = FitOptions.huber_threshold
"""Standardized residual beyond which a measurement is an outlier: one in 16 000 of normal noise."""


@dataclass(frozen=True, eq=False)
class ObservationModel:
    """White noise of each measured state, by its standard deviations, shape (d,), above zero.

    Larger deviations than the Huber threshold, in standard deviations, count linearly instead of squared (Huber 1964);
    if it `rejects` them, they count as one at the threshold, and have no weight (Hampel et al. 1986, section 2.6). The
    threshold is infinite for least squares. Raises `CommonlawError` if it is not above zero.
    """

    noise: Floats
    huber_threshold: float = np.inf
    rejects: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.huber_threshold, int | float | np.number) or not self.huber_threshold > 0:
            raise CommonlawError("huber-threshold", value=self.huber_threshold)

    def deviance(self, residuals: Floats, scale: Floats | float = 1.0) -> float:
        """Return minus twice the log-likelihood of residuals, NaN if missing, of standard deviations noise times scale.

        With the Huber threshold c it is the sum of ``u^2`` for standardized residuals up to c, else ``2 c |u| - c^2``,
        or ``c^2`` if these are rejected.
        """
        sizes = np.abs(residuals / (self.noise * scale))
        sizes = sizes[~np.isnan(sizes)]
        if self.rejects:
            return float(np.sum(np.minimum(sizes, self.huber_threshold) ** 2))
        bound = self.huber_threshold
        far = sizes > bound
        return float(np.sum(sizes[~far] ** 2) + np.sum(2 * bound * sizes[far] - bound**2 if far.any() else 0.0))

    def weights(self, residuals: Floats, scale: Floats | float = 1.0) -> Floats:
        """Return the weight of each measurement, shape (n, d), zero if missing.

        It is ``min(1, c / |u|) / std^2``, or zero beyond c if that is rejected.
        """
        noise = self.noise * scale
        sizes = np.abs(residuals / noise)
        with np.errstate(divide="ignore", invalid="ignore"):
            least = 0.0 if self.rejects else self.huber_threshold / sizes
            weights = np.where(sizes > self.huber_threshold, least, 1.0)
        return np.where(np.isnan(sizes), 0.0, weights) / noise**2
