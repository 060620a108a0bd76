"""From trials to a law by the likelihood of their trajectories: supports, coefficients, and how sure they are."""

from commonlaw.inference.covariance import COVARIANCE_KINDS, CovarianceKind, check_covariance_kind
from commonlaw.inference.law_search import PATH, Search, finish, search_supports, with_supports
from commonlaw.inference.refinement import refine
from commonlaw.inference.search import SearchState, fit_supports
from commonlaw.inference.search_problem import SearchProblem, known_noise, prepare
from commonlaw.likelihood import HUBER_THRESHOLD

__all__ = [
    "COVARIANCE_KINDS",
    "HUBER_THRESHOLD",
    "PATH",
    "CovarianceKind",
    "Search",
    "SearchProblem",
    "SearchState",
    "check_covariance_kind",
    "finish",
    "fit_supports",
    "known_noise",
    "prepare",
    "refine",
    "search_supports",
    "with_supports",
]
