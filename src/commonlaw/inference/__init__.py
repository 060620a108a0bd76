"""From trials to a law by the likelihood of trajectories: supports, coefficients, and their uncertainty."""

from commonlaw.inference.data.noise import known_noise
from commonlaw.inference.data.subsampling import can_be_subsampled
from commonlaw.inference.fit.annealing import fit_supports
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.latent_states import drives, with_forcing_step, with_latent_state
from commonlaw.inference.propose.nonlinear_parameters import outcomes_of_parameters, with_initial_parameters
from commonlaw.inference.propose.parametric import (
    is_truncated_series,
    may_be_simpler,
    with_parametric_terms,
    with_parametric_terms_under_errors,
)
from commonlaw.inference.propose.screening import screen_terms, terms_by_score_test
from commonlaw.inference.result.approximation import (
    choose_deterministic,
    fits_whole_trials,
    index_of_best_fit_to_whole_trials,
)
from commonlaw.inference.result.assembly import assemble
from commonlaw.inference.result.held_out_forecasts import best_forecaster
from commonlaw.inference.result.history import levels_in_words
from commonlaw.inference.score.score import Score
from commonlaw.inference.search.error_models import choose_errors
from commonlaw.inference.search.law_search import (
    PATH,
    choose_interpolation,
    resolved,
    search_on_finer_mesh,
    search_supports,
    with_leading_support,
)
from commonlaw.inference.search.pool import Pool, score_of_order
from commonlaw.inference.search.setup import error_kinds, transform_trials, with_interpolation
from commonlaw.inference.settings import MAX_SAMPLES
from commonlaw.inference.verbs.absent_terms import Bounds, bounds
from commonlaw.inference.verbs.chunks import fitted_by_parts, typical
from commonlaw.inference.verbs.comparison import compare, compare_by_parts, written_alike
from commonlaw.inference.verbs.other_terms import CandidateLaw, candidate_law, candidate_laws, iterate_candidates
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
    "assemble",
    "best_forecaster",
    "bounds",
    "can_be_subsampled",
    "candidate_law",
    "candidate_laws",
    "choose_deterministic",
    "choose_errors",
    "choose_interpolation",
    "compare",
    "compare_by_parts",
    "drives",
    "error_kinds",
    "fit_supports",
    "fits_whole_trials",
    "fitted_by_parts",
    "index_of_best_fit_to_whole_trials",
    "is_truncated_series",
    "iterate_candidates",
    "known_noise",
    "levels_in_words",
    "may_be_simpler",
    "outcomes_of_parameters",
    "prepare",
    "refine",
    "resolved",
    "score_of_order",
    "screen_terms",
    "search_on_finer_mesh",
    "search_supports",
    "terms_by_score_test",
    "transform_trials",
    "typical",
    "with_forcing_step",
    "with_initial_parameters",
    "with_interpolation",
    "with_latent_state",
    "with_leading_support",
    "with_parametric_terms",
    "with_parametric_terms_under_errors",
    "written_alike",
]
