"""Laws: equations with shared terms and each object's own coefficients."""

from commonlaw.law.alternative import Alternative
from commonlaw.law.forecast import Forecast
from commonlaw.law.history import History, Step
from commonlaw.law.law import Law
from commonlaw.law.provenance import Provenance
from commonlaw.law.uncertainty import Uncertainty

__all__ = ["Alternative", "Forecast", "History", "Law", "Provenance", "Step", "Uncertainty"]
