"""Integrating laws: trajectories, events, divergence as an outcome, forecasts beside measurements, and their bands."""

from commonlaw.forecast.base import Run
from commonlaw.forecast.event import Event, Occurrences
from commonlaw.forecast.forecast import Forecast
from commonlaw.forecast.simulation import integrate, simulate
from commonlaw.forecast.spread import normal_quantile, spread_of
from commonlaw.forecast.trajectory import Trajectory
from commonlaw.forecast.vector_field import VectorField

__all__ = [
    "Event",
    "Forecast",
    "Occurrences",
    "Run",
    "Trajectory",
    "VectorField",
    "integrate",
    "normal_quantile",
    "simulate",
    "spread_of",
]
