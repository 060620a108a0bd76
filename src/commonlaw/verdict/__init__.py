"""What a law is good for: how well it forecasts what was held out, in sentences with the numbers behind them."""

from commonlaw.law.verdict import LawVerdict
from commonlaw.verdict.findings import Findings, find
from commonlaw.verdict.judge import judge

__all__ = ["Findings", "LawVerdict", "find", "judge"]
