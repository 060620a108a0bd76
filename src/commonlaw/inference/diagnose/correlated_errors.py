"""Errors of which a share decays with a memory, and the rest is white."""

from functools import lru_cache

import numpy as np

from commonlaw.array_types import Floats


@lru_cache(maxsize=8)
def correlation_factor(times: bytes, share: float, memory: float) -> Floats:
    """Return the lower triangular factor of the errors' correlation at some times, shape (n, n)."""
    correlated = _decaying(times, memory)
    return np.asarray(np.linalg.cholesky((1 - share) * np.eye(len(correlated)) + share * correlated))


def log_determinant(times: Floats, share: float, memory: float) -> float:
    """Return the logarithm of the determinant of the errors' correlation."""
    return 2 * float(np.sum(np.log(np.diag(correlation_factor(times.tobytes(), share, memory)))))


@lru_cache(maxsize=8)
def _decaying(times: bytes, memory: float) -> Floats:
    samples = np.frombuffer(times)
    return np.asarray(np.exp(-np.abs(samples[:, np.newaxis] - samples) / memory))
