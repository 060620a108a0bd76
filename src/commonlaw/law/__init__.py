"""Laws: equations with shared terms and each object's own coefficients."""

from commonlaw.law.law import Law
from commonlaw.law.provenance import Alternative, History, Provenance, Step
from commonlaw.law.uncertainty import PlausibleLaw, Uncertainty

__all__ = [
    "Alternative",
    "History",
    "Law",
    "PlausibleLaw",
    "Provenance",
    "Step",
    "Uncertainty",
]
