"""Measurements as exact as an integrator: no term stands for the steps of a mesh."""

import numpy as np
from scipy.integrate import solve_ivp

import commonlaw as cl


def test_the_discretization_error_of_a_coarse_mesh_is_no_reason_for_richer_terms():
    times, measured, told = np.linspace(0, 2, 140), [], []
    for k, (s, r, b) in enumerate([(10.0, 28.0, 2.7), (9.6, 26.5, 2.5), (10.4, 28.8, 2.8)]):
        start = [(-5.0, -2.0, 20.0), (3.0, 6.0, 25.0), (7.0, -1.0, 18.0)][k]
        found = solve_ivp(
            lambda _, y, s=s, r=r, b=b: [s * (y[1] - y[0]), y[0] * (r - y[2]) - y[1], y[0] * y[1] - b * y[2]],
            (0, 2),
            start,
            t_eval=times,
            method="LSODA",
            rtol=1e-9,
            atol=1e-11,
        )
        measured.append(found.y.T)
    trials = cl.Trials.from_arrays([times] * 3, measured, object=["a", "b", "c"], names=["x", "y", "z"])
    law = cl.discover(trials, order=1, cache=False, progress=told.append)
    assert law.structure == ("x' = a x + b y", "y' = c x + d y + f x z", "z' = g z + h x y")
    assert not any("proposing" in each for each in told)
