"""From trials to a law by the likelihood of their trajectories: supports, coefficients, and how sure they are."""

from commonlaw.inference.objects import known_noise
from commonlaw.inference.pipeline import OUTLIERS, PATH, find_law
from commonlaw.inference.refinement import refine

__all__ = ["OUTLIERS", "PATH", "find_law", "known_noise", "refine"]
