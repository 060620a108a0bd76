"""Coefficients of several objects, and estimates of them."""

import numpy as np


def measured(objects, spread, parameters=3, seed=0):
    """Each object's true coefficients, estimates of them, and the covariances of their errors."""
    generator = np.random.default_rng(seed)
    designs = generator.standard_normal((objects, 8, parameters))
    covariances = np.linalg.inv(np.matmul(designs.transpose(0, 2, 1), designs))
    truth = np.array([5.0, 0.0, -3.0])[:parameters] + spread * generator.standard_normal((objects, parameters))
    errors = np.matmul(np.linalg.cholesky(covariances), generator.standard_normal((objects, parameters, 1)))[..., 0]
    return truth, truth + errors, covariances
