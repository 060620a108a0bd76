"""From trials and candidate terms to regression rows, and from rows to compressed systems."""

from commonlaw.formulation.base import AbstractFormulation
from commonlaw.formulation.compress import MOST_GROUPS, Compressed, compress, refuse_constant_states
from commonlaw.formulation.discrete import DiscreteForm
from commonlaw.formulation.independence import effective_rows, independent_share
from commonlaw.formulation.least_squares_problem import LeastSquaresProblem, leave_one_out, merge
from commonlaw.formulation.resolution import resolution
from commonlaw.formulation.reweighting import reweighted
from commonlaw.formulation.strong import StrongForm
from commonlaw.formulation.variables import law_variables
from commonlaw.formulation.weak import WeakForm

__all__ = [
    "MOST_GROUPS",
    "AbstractFormulation",
    "Compressed",
    "DiscreteForm",
    "LeastSquaresProblem",
    "StrongForm",
    "WeakForm",
    "compress",
    "effective_rows",
    "independent_share",
    "law_variables",
    "leave_one_out",
    "merge",
    "refuse_constant_states",
    "resolution",
    "reweighted",
]
