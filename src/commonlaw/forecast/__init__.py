"""Integrating laws: trajectories, events, divergence as an outcome, and forecasts beside measurements."""

from commonlaw.forecast.base import Run
from commonlaw.forecast.event import Event, Occurrences
from commonlaw.forecast.forecast import Forecast
from commonlaw.forecast.simulation import integrate, simulate
from commonlaw.forecast.trajectory import Trajectory
from commonlaw.forecast.vector_field import VectorField

__all__ = ["Event", "Forecast", "Occurrences", "Run", "Trajectory", "VectorField", "integrate", "simulate"]
