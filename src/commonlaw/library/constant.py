"""The constant term alone."""

from dataclasses import dataclass

from commonlaw.library.base import AbstractLibrary, Terms, Variables
from commonlaw.library.monomial import Monomial


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
