"""Selection: which of the equations that a solver found is the law, and why."""

from commonlaw.selection.choice import RULES, Choice, Scored, choose
from commonlaw.selection.criteria import CRITERIA, Evidence, aic, aicc, bic, ebic
from commonlaw.selection.cross_validation import HeldOut, RateError, held_out
from commonlaw.selection.folds import Fold, Parts, make_folds
from commonlaw.selection.forecasts import ForecastError
from commonlaw.selection.joint import MOST_TERMS, SAMPLES_FOR_A_TERM, Joint
from commonlaw.selection.selecting import BLOCKS, Accuracy, select
from commonlaw.selection.stability import Stability, stability
from commonlaw.selection.verdict import chosen_law, fitted_law, ill_conditions

__all__ = [
    "BLOCKS",
    "CRITERIA",
    "MOST_TERMS",
    "RULES",
    "SAMPLES_FOR_A_TERM",
    "Accuracy",
    "Choice",
    "Evidence",
    "Fold",
    "ForecastError",
    "HeldOut",
    "Joint",
    "Parts",
    "RateError",
    "Scored",
    "Stability",
    "aic",
    "aicc",
    "bic",
    "choose",
    "chosen_law",
    "ebic",
    "fitted_law",
    "held_out",
    "ill_conditions",
    "make_folds",
    "select",
    "stability",
]
