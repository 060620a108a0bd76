"""Terms that are given one by one."""

from dataclasses import dataclass

from commonlaw.errors import CommonlawError
from commonlaw.library.algebra import AbstractLibrary
from commonlaw.library.parse import parse_term
from commonlaw.library.terms import Terms
from commonlaw.library.variables import Variables


@dataclass(frozen=True, init=False)
class ExpressionLibrary(AbstractLibrary):
    """The terms that are written, in that order.

    Parameters
    ----------
    *expressions
        What `parse_term` reads: ``"v*abs(v)"``, ``"sin(x)"``.

    Raises
    ------
    CommonlawError
        If there is none.

    Examples
    --------
    >>> ExpressionLibrary("1", "v*abs(v)").bind(Variables(("x", "v"))).names
    ('1', 'v*abs(v)')
    """

    expressions: tuple[str, ...]

    def __init__(self, *expressions: str) -> None:
        if not expressions:
            raise CommonlawError("an expression library without expressions has no terms: give at least one")
        object.__setattr__(self, "expressions", expressions)

    def bind(self, variables: Variables) -> Terms:
        """Return the terms; one that is written twice is there once.

        Raises
        ------
        CommonlawError
            If an expression cannot be read.
        """
        return Terms(variables, tuple(dict.fromkeys(parse_term(each, variables) for each in self.expressions)))
