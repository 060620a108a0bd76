"""From trials and candidate terms to regression rows, and from rows to compressed systems."""

from commonlaw.formulation.strong import StrongForm
from commonlaw.formulation.system import System, leave_one_out, merge

__all__ = ["StrongForm", "System", "leave_one_out", "merge"]
