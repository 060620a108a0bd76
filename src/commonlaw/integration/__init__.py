"""Numerical integration of vector fields: initial value problems, events, trajectories, sensitivities, divergence."""

from commonlaw.integration.problem import Event, InitialValueProblem, Occurrences, OutputOptions, Trajectory
from commonlaw.integration.simulation import METHODS, integrate, simulate, simulate_each
from commonlaw.integration.vector_field import (
    BETWEEN,
    Inputs,
    LinearizedField,
    VectorField,
    jumps,
    runge_kutta_step,
)

__all__ = [
    "BETWEEN",
    "METHODS",
    "Event",
    "InitialValueProblem",
    "Inputs",
    "LinearizedField",
    "Occurrences",
    "OutputOptions",
    "Trajectory",
    "VectorField",
    "integrate",
    "jumps",
    "runge_kutta_step",
    "simulate",
    "simulate_each",
]
