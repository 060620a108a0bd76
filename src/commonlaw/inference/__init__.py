"""From trials to a law by the likelihood of their trajectories: supports, coefficients, and how sure they are."""

from commonlaw.inference.data.noise import known_noise
from commonlaw.inference.data.subsampling import can_be_carried
from commonlaw.inference.fit.annealing import fit_supports
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.latent_states import drives, with_drive_said, with_latent_state
from commonlaw.inference.propose.nonlinear_parameters import outcomes_of_parameters, with_parameters_found
from commonlaw.inference.propose.parametric import (
    may_be_series,
    may_be_simpler,
    with_parametric_terms,
    with_parametric_terms_under_errors,
)
from commonlaw.inference.propose.screening import missed_terms, promising_terms
from commonlaw.inference.result.approximation import explains_whole_trials, most_explaining
from commonlaw.inference.result.assembly import assemble
from commonlaw.inference.result.history import levels_in_words
from commonlaw.inference.score.score import Score
from commonlaw.inference.search.error_models import choose_errors
from commonlaw.inference.search.law_search import PATH, begin_search, explained_on_finer_mesh, resolved, search_supports
from commonlaw.inference.search.pool import Pool, score_of_order
from commonlaw.inference.search.setup import as_followed, error_kinds, with_interpolation
from commonlaw.inference.settings import MAX_SAMPLES
from commonlaw.inference.verbs.absent_terms import Bounds, bounds
from commonlaw.inference.verbs.chunks import fitted_by_parts, typical
from commonlaw.inference.verbs.comparison import compare, compare_by_parts, written_alike
from commonlaw.inference.verbs.other_terms import CandidateLaw, candidate_law, candidate_laws, candidates_in_turn
from commonlaw.inference.verbs.refinement import adapt, refine
from commonlaw.likelihood import HUBER_THRESHOLD

__all__ = [
    "HUBER_THRESHOLD",
    "MAX_SAMPLES",
    "PATH",
    "Bounds",
    "CandidateLaw",
    "Fit",
    "Pool",
    "Score",
    "adapt",
    "as_followed",
    "assemble",
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
    "fit_supports",
    "fitted_by_parts",
    "known_noise",
    "levels_in_words",
    "may_be_series",
    "may_be_simpler",
    "missed_terms",
    "most_explaining",
    "outcomes_of_parameters",
    "prepare",
    "promising_terms",
    "refine",
    "resolved",
    "score_of_order",
    "search_supports",
    "typical",
    "with_drive_said",
    "with_interpolation",
    "with_latent_state",
    "with_parameters_found",
    "with_parametric_terms",
    "with_parametric_terms_under_errors",
    "written_alike",
]
