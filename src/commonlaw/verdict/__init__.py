"""What a law is good for: how well it forecasts what was held out, in sentences with the numbers behind them."""

from commonlaw.verdict.assessment import Findings, find, judge
from commonlaw.verdict.law_verdict import LawVerdict

__all__ = ["Findings", "LawVerdict", "find", "judge"]
