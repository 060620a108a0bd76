"""What a law is good for: how well it forecasts what was held out, in sentences with the numbers behind them."""

from commonlaw.law.verdict import LawVerdict
from commonlaw.verdict.checked import checked_forecast, checked_start, is_of_training
from commonlaw.verdict.judge import judge

__all__ = ["LawVerdict", "checked_forecast", "checked_start", "is_of_training", "judge"]
