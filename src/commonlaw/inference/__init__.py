"""From trials to a law by the likelihood of their trajectories: supports, coefficients, and how sure they are."""

from commonlaw.inference.adaptation import adapt
from commonlaw.inference.candidates import CandidateLaw, candidate_law, candidate_laws, candidates_in_turn
from commonlaw.inference.comparison import compare, compare_by_parts, written_alike
from commonlaw.inference.constants import outcomes_of_constants, with_constants_found
from commonlaw.inference.covariance import CovarianceKind
from commonlaw.inference.drives import drives, with_drive_said
from commonlaw.inference.error_search import ErrorKind
from commonlaw.inference.explanation import explains_whole_trials, most_explaining
from commonlaw.inference.finishing import finish
from commonlaw.inference.first_noise import known_noise
from commonlaw.inference.fit_setup import as_followed
from commonlaw.inference.input_interpolation import with_interpolation
from commonlaw.inference.law_search import (
    CHOSEN,
    PATH,
    LawSearch,
    begin_search,
    choose_errors,
    explained_on_finer_mesh,
    resolved,
    search_supports,
)
from commonlaw.inference.long_trials import MOST_SAMPLES, can_be_carried
from commonlaw.inference.orders import may_be_of_first_order, may_be_of_lower_order, score_of_order
from commonlaw.inference.parametric_search import (
    may_be_series,
    may_be_simpler,
    with_parametric_terms,
    with_parametric_terms_under_errors,
)
from commonlaw.inference.parts import LawOfPart, law_of_all, typical
from commonlaw.inference.provenance import levels_in_words
from commonlaw.inference.refinement import refine
from commonlaw.inference.scales import error_kinds
from commonlaw.inference.score import Score
from commonlaw.inference.screening import missed_terms, promising_terms
from commonlaw.inference.search import fit_supports
from commonlaw.inference.search_problem import prepare
from commonlaw.inference.unmeasured_search import with_unmeasured_state
from commonlaw.inference.unseen import bounds
from commonlaw.inference.unseen_bounds import Bounds
from commonlaw.likelihood import HUBER_THRESHOLD

__all__ = [
    "CHOSEN",
    "HUBER_THRESHOLD",
    "MOST_SAMPLES",
    "PATH",
    "Bounds",
    "CandidateLaw",
    "CovarianceKind",
    "ErrorKind",
    "LawOfPart",
    "LawSearch",
    "Score",
    "adapt",
    "as_followed",
    "begin_search",
    "bounds",
    "can_be_carried",
    "candidate_law",
    "candidate_laws",
    "candidates_in_turn",
    "choose_errors",
    "compare",
    "compare_by_parts",
    "drives",
    "error_kinds",
    "explained_on_finer_mesh",
    "explains_whole_trials",
    "finish",
    "fit_supports",
    "known_noise",
    "law_of_all",
    "levels_in_words",
    "may_be_of_first_order",
    "may_be_of_lower_order",
    "may_be_series",
    "may_be_simpler",
    "missed_terms",
    "most_explaining",
    "outcomes_of_constants",
    "prepare",
    "promising_terms",
    "refine",
    "resolved",
    "score_of_order",
    "search_supports",
    "typical",
    "with_constants_found",
    "with_drive_said",
    "with_interpolation",
    "with_parametric_terms",
    "with_parametric_terms_under_errors",
    "with_unmeasured_state",
    "written_alike",
]
