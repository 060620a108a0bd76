"""From trials and candidate terms to regression rows, and from rows to compressed systems."""

from commonlaw.formulation.base import AbstractFormulation
from commonlaw.formulation.compress import Compressed, compress
from commonlaw.formulation.discrete import DiscreteForm
from commonlaw.formulation.strong import StrongForm
from commonlaw.formulation.system import System, leave_one_out, merge

__all__ = [
    "AbstractFormulation",
    "Compressed",
    "DiscreteForm",
    "StrongForm",
    "System",
    "compress",
    "leave_one_out",
    "merge",
]
