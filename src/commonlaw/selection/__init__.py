"""Selection: which of the equations that a solver found is the law, and why."""

from commonlaw.selection.cross_validation import (
    CrossValidationScore,
    Fold,
    ForecastError,
    ProblemGroups,
    ResidualError,
    Stability,
    make_folds,
    stability,
)
from commonlaw.selection.rules import (
    CRITERIA,
    RULES,
    FitStatistics,
    ScoredCandidate,
    Selection,
    aic,
    aicc,
    bic,
    choose,
    ebic,
    log_choices,
)
from commonlaw.selection.selecting import SEGMENTS, Accuracy, chosen_law, fitted_law, ill_conditions, select

__all__ = [
    "CRITERIA",
    "RULES",
    "SEGMENTS",
    "Accuracy",
    "CrossValidationScore",
    "FitStatistics",
    "Fold",
    "ForecastError",
    "ProblemGroups",
    "ResidualError",
    "ScoredCandidate",
    "Selection",
    "Stability",
    "aic",
    "aicc",
    "bic",
    "choose",
    "chosen_law",
    "ebic",
    "fitted_law",
    "ill_conditions",
    "log_choices",
    "make_folds",
    "select",
    "stability",
]
