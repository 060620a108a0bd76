"""Laws: equations with shared terms and each object's own coefficients."""

from commonlaw.law.forecast import Forecast
from commonlaw.law.law import Law
from commonlaw.law.provenance import Alternative, History, Provenance, Step
from commonlaw.law.same_constants import with_constants_of
from commonlaw.law.uncertainty import PlausibleLaw, Uncertainty

__all__ = [
    "Alternative",
    "Forecast",
    "History",
    "Law",
    "PlausibleLaw",
    "Provenance",
    "Step",
    "Uncertainty",
    "with_constants_of",
]
