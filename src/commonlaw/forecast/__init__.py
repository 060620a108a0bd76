"""Laws forecast trials: where each trial starts, its trajectory, and how far off it may be."""

from commonlaw.forecast.forecast import Forecast
from commonlaw.forecast.prediction import fitted, forecast_from, predict
from commonlaw.forecast.simulation import simulate_law

__all__ = ["Forecast", "fitted", "forecast_from", "predict", "simulate_law"]
