"""Integrating laws: trajectories, divergence as an outcome, and forecasts beside measurements."""

from commonlaw.forecast.forecast import Forecast
from commonlaw.forecast.simulation import Trajectory, integrate
from commonlaw.forecast.vector_field import VectorField

__all__ = ["Forecast", "Trajectory", "VectorField", "integrate"]
