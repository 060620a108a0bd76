"""What a law leaves unexplained: residuals and their patterns, and functions that all objects share."""

from commonlaw.discrepancy.find import discrepancy
from commonlaw.discrepancy.residuals import residuals

__all__ = ["discrepancy", "residuals"]
