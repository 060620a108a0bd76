"""What a law is good for: how well it forecasts what was held out, in sentences with the numbers behind them."""

from commonlaw.law.verdict import LawVerdict
from commonlaw.verdict.checked import checked_forecast, is_of_training
from commonlaw.verdict.judge import judge
from commonlaw.verdict.stretches import samples_before

__all__ = ["LawVerdict", "checked_forecast", "is_of_training", "judge", "samples_before"]
