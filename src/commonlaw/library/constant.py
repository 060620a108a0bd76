"""The constant term alone."""

from dataclasses import dataclass

from commonlaw.library.algebra import AbstractLibrary
from commonlaw.library.monomial import Monomial
from commonlaw.library.terms import Terms
from commonlaw.library.variables import Variables


@dataclass(frozen=True)
class ConstantLibrary(AbstractLibrary):
    """The constant term 1.

    Examples
    --------
    >>> ConstantLibrary().bind(Variables(("x",))).names
    ('1',)
    """

    def bind(self, variables: Variables) -> Terms:
        """Return the one term."""
        return Terms(variables, (Monomial((0,) * len(variables.names)),))
