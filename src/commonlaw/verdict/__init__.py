"""What a law is good for: how well it forecasts what was held out, in sentences with the numbers behind them."""

from commonlaw.verdict.findings import Findings, find
from commonlaw.verdict.judge import judge
from commonlaw.verdict.law_verdict import LawVerdict
from commonlaw.verdict.many_objects import ManyFindings, find_by_stream

__all__ = ["Findings", "LawVerdict", "ManyFindings", "find", "find_by_stream", "judge"]
