"""Streams of trials that are larger than memory: laws, forecasts and residuals, part by part, by workers or here."""

from commonlaw.stream.forecasts import ManyFindings, find_by_stream, forecast_stream
from commonlaw.stream.proposals import Fitting, law_of_parts
from commonlaw.stream.residuals import StreamResiduals, check_stream

__all__ = [
    "Fitting",
    "ManyFindings",
    "StreamResiduals",
    "check_stream",
    "find_by_stream",
    "forecast_stream",
    "law_of_parts",
]
