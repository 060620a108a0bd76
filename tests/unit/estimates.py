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


def relaxation(measured, times, rate, covariance):
    """Of solutions of ``x' = a - rate x`` by generalized least squares, with a start of each row of measurements.

    Minus twice the restricted log-likelihood, and the estimate of a with its standard error.
    """
    trials, decay = len(measured), np.exp(-rate * times)
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    columns = np.zeros((trials, len(times), trials + 1))
    columns[range(trials), :, range(trials)] = decay
    columns[:, :, -1] = (1 - decay) / rate
    rows, target = (root @ columns).reshape(-1, trials + 1), (measured @ root.T).ravel()
    information = rows.T @ rows
    estimate = np.linalg.solve(information, rows.T @ target)
    squares = float(np.sum((target - rows @ estimate) ** 2))
    determinants = np.linalg.slogdet(information)[1] - 2 * trials * np.linalg.slogdet(root)[1]
    return squares + determinants, estimate[-1], np.sqrt(np.linalg.inv(information)[-1, -1])
