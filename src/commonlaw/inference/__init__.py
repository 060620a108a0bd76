"""From trials to a law by the likelihood of their trajectories: supports, coefficients, and how sure they are."""

from commonlaw.inference.pipeline import OUTLIERS, PATH, find_law

__all__ = ["OUTLIERS", "PATH", "find_law"]
