"""Noisy trials of systems that SciPy integrates."""

import numpy as np
from scipy.integrate import solve_ivp

import commonlaw as cl


def solved(rates, start, times, *numbers):
    """Return the states of ``rates(t, y, *numbers)`` at times, shape (n, D)."""
    return solve_ivp(rates, times[[0, -1]], start, "DOP853", times, args=numbers, rtol=1e-10, atol=1e-12).y.T


def simulated(rates, objects, starts, times, noise, names=("s",), *, seed=0, absolute=False):
    """Return trials of objects, each with numbers of its own, from each start, of the first states, which have names.

    The standard deviation of the noise is a share of how far a state moves in the trial, or `absolute`.
    """
    random, made = np.random.default_rng(seed), []
    for owner, numbers in objects.items():
        for k, start in enumerate(starts):
            states = solved(rates, start, times, *numbers)[:, : len(names)]
            scale = noise if absolute else noise * states.std(axis=0)
            made.append(cl.Trial(owner, str(k), times, states + scale * random.standard_normal(states.shape)))
    return cl.Trials(tuple(made), cl.Schema(tuple(names)))


def drawn(solution, typical, count, *, scatter=0.15, noise=0.01, seed=0):
    """Return numbers of objects that scatter about typical ones, shape (count, numbers), noise, and noisy solutions.

    The noise is a share of how far all solutions move.
    """
    random = np.random.default_rng(seed)
    values = np.array(typical) * np.exp(scatter * random.standard_normal((count, len(typical))))
    exact = [solution(numbers) for numbers in values]
    std = noise * float(np.std(exact))
    return values, std, [each + std * random.standard_normal(len(each)) for each in exact]
