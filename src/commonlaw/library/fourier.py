"""Sines and cosines of the variables."""

from collections.abc import Sequence
from dataclasses import dataclass

from commonlaw.library.algebra import AbstractLibrary
from commonlaw.library.terms import Terms
from commonlaw.library.trigonometric import Trigonometric
from commonlaw.library.variables import Variables, checked_names
from commonlaw.validation import check_whole_number


@dataclass(frozen=True)
class FourierLibrary(AbstractLibrary):
    """Sines and cosines of whole multiples of each variable, lower multiples first.

    Parameters
    ----------
    frequencies
        The highest multiple.
    variables
        Names of the variables; without them all states (and rates) and inputs, but not time.

    Raises
    ------
    CommonlawError
        If there are not 1 to 1000 frequencies, or a variable is named twice.

    Examples
    --------
    >>> FourierLibrary(2).bind(Variables(("x",))).names
    ('sin(x)', 'cos(x)', 'sin(2 x)', 'cos(2 x)')
    """

    frequencies: int = 1
    variables: Sequence[str] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "variables", checked_names(self.variables))
        check_whole_number("the number of frequencies of a Fourier library", self.frequencies, 1, 1000)

    def bind(self, variables: Variables) -> Terms:
        """Return the sines and cosines.

        Raises
        ------
        CommonlawError
            If a variable is not there.
        """
        terms = [
            term
            for frequency in range(1, self.frequencies + 1)
            for column in variables.columns(self.variables)
            for term in (Trigonometric("sin", frequency, column), Trigonometric("cos", frequency, column))
        ]
        return Terms(variables, tuple(terms))
