"""What a law leaves unexplained, as a function of a coordinate that all objects share."""

from commonlaw.discrepancy.find import discrepancy

__all__ = ["discrepancy"]
