"""From trials to a law by the likelihood of trajectories: supports, coefficients, and their uncertainty."""

from commonlaw.inference.verbs.absent_terms import Bounds, bounds
from commonlaw.inference.verbs.comparison import compare
from commonlaw.inference.verbs.other_terms import CandidateLaw, candidate_law, candidate_laws, iterate_candidates
from commonlaw.inference.verbs.refinement import adapt, refine

__all__ = [
    "Bounds",
    "CandidateLaw",
    "adapt",
    "bounds",
    "candidate_law",
    "candidate_laws",
    "compare",
    "iterate_candidates",
    "refine",
]
