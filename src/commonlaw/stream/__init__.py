"""Streams of trials that are larger than memory: forecasts and residuals, part by part, by workers or here."""

from commonlaw.stream.forecasts import ManyFindings, find_by_stream, forecast_stream
from commonlaw.stream.residuals import StreamResiduals, check_stream

__all__ = ["ManyFindings", "StreamResiduals", "check_stream", "find_by_stream", "forecast_stream"]
