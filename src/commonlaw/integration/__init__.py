"""Integrating vector fields: initial value problems, back ends, events, trajectories, and divergence as an outcome."""

from commonlaw.integration.event import Event, Occurrences
from commonlaw.integration.initial_value_problem import InitialValueProblem, OutputOptions
from commonlaw.integration.inputs import BETWEEN, Inputs
from commonlaw.integration.simulation import integrate, simulate, simulate_each
from commonlaw.integration.trajectory import Trajectory
from commonlaw.integration.vector_field import LinearizedField, VectorField

__all__ = [
    "BETWEEN",
    "Event",
    "InitialValueProblem",
    "Inputs",
    "LinearizedField",
    "Occurrences",
    "OutputOptions",
    "Trajectory",
    "VectorField",
    "integrate",
    "simulate",
    "simulate_each",
]
