"""From trials and candidate terms to regression rows, and from rows to compressed problems."""

from commonlaw.formulation.base import AbstractFormulation, law_variables, plain_rates
from commonlaw.formulation.compress import (
    MAX_GROUPS,
    CompressedTrials,
    ObjectRows,
    merged_rows,
    refuse_constant_states,
    refuse_vanishing_states,
    rows_by_object,
    some_trials,
)
from commonlaw.formulation.least_squares_problem import (
    LeastSquaresProblem,
    column_scales,
    explained,
    inverse_information,
    least_squares_of_each,
    merge,
    redrawn,
    symmetric_root,
)
from commonlaw.formulation.sampled import (
    DiscreteForm,
    GivenForm,
    StrongForm,
    TrialDerivatives,
    differentiation_bias,
    effective_share,
)
from commonlaw.formulation.weak import WeakForm, reweight

__all__ = [
    "MAX_GROUPS",
    "AbstractFormulation",
    "CompressedTrials",
    "DiscreteForm",
    "GivenForm",
    "LeastSquaresProblem",
    "ObjectRows",
    "StrongForm",
    "TrialDerivatives",
    "WeakForm",
    "column_scales",
    "differentiation_bias",
    "effective_share",
    "explained",
    "inverse_information",
    "law_variables",
    "least_squares_of_each",
    "merge",
    "merged_rows",
    "plain_rates",
    "redrawn",
    "refuse_constant_states",
    "refuse_vanishing_states",
    "reweight",
    "rows_by_object",
    "some_trials",
    "symmetric_root",
]
