"""Candidate functions: terms, and the families that list them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.library.evaluation import Plan

if TYPE_CHECKING:
    import sympy


@dataclass(frozen=True)
class Variables:
    """The names that terms may use, in the order of the columns of the array that terms are evaluated on.

    Parameters
    ----------
    states
        The state variables; for a law of second order followed by their rates.
    inputs
        Measured inputs.
    time
        The name of time, the last column.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    time: str = "t"

    @property
    def names(self) -> tuple[str, ...]:
        """All names: states, inputs, time."""
        return (*self.states, *self.inputs, self.time)

    def index(self, name: str) -> int:
        """Return the column of a variable.

        Raises
        ------
        CommonlawError
            If there is no variable of that name.
        """
        if name not in self.names:
            raise unknown("variable", name, self.names)
        return self.names.index(name)

    def columns(self, names: Sequence[str] | None = None) -> tuple[int, ...]:
        """Return the columns of the named variables; without names those of all states and inputs, but not time.

        Raises
        ------
        CommonlawError
            If there is no variable of some name.
        """
        if names is None:
            return tuple(range(len(self.states) + len(self.inputs)))
        return tuple(self.index(name) for name in names)


class AbstractTerm(ABC):
    """A function of the variables: it evaluates, differentiates, prints, and has a SymPy form.

    Terms know variables by their column; names come in as arguments. Terms are values: equal terms compare equal.
    """

    @abstractmethod
    def evaluate(self, values: Floats) -> Floats:
        """Return the term's values, shape (n,), at the rows of `values`, shape (n, number of variables).

        Where the term is not defined, it is infinite or not a number; no warning is given.
        """

    @abstractmethod
    def gradient(self, values: Floats) -> Floats:
        """Return the exact partial derivatives by every variable, shape (n, number of variables)."""

    @abstractmethod
    def parts(self) -> tuple[np.ufunc, "AbstractTerm", "AbstractTerm"] | None:
        """Return `numpy.multiply` or `numpy.divide` and the two simpler terms that it makes into this one.

        A term that is not a product or quotient of others has no parts.
        """

    @abstractmethod
    def columns(self) -> frozenset[int]:
        """Return the columns of the variables that the term depends on."""

    @abstractmethod
    def text(self, names: Sequence[str]) -> str:
        """Return the term as the field writes it: ``x^2 v``, ``sin(2 x)``."""

    @abstractmethod
    def expression(self, names: Sequence[str]) -> str:
        """Return the term as an expression that `parse_term` reads back: ``x**2*v``."""

    @abstractmethod
    def latex(self, names: Sequence[str]) -> str:
        """Return the term as LaTeX, without dollar signs."""

    @abstractmethod
    def sympy(self, symbols: Sequence["sympy.Symbol"]) -> "sympy.Expr":
        """Return the term as a SymPy expression in the given symbols, one for each variable.

        The symbols should be real: only then is the derivative of ``abs(x)`` the sign of x.
        """


@dataclass(frozen=True)
class Terms:
    """Terms over named variables, evaluated together.

    Parameters
    ----------
    variables
        What the terms are functions of.
    terms
        The candidate functions, in order.
    """

    variables: Variables
    terms: tuple[AbstractTerm, ...]

    def __len__(self) -> int:
        return len(self.terms)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The terms as the field writes them: ``("1", "x", "x^2 v")``."""
        return tuple(term.text(self.variables.names) for term in self.terms)

    @cached_property
    def _plan(self) -> Plan:
        return Plan.of(self.terms)

    def index(self, name: str) -> int:
        """Return the place of the term of that name.

        Spaces do not count, and a product or power may be written with stars: ``x^2 v`` is also ``x**2*v``.

        Raises
        ------
        CommonlawError
            If there is no such term.
        """
        if name in self.names:
            return self.names.index(name)
        folded = [_folded(each) for each in self.names]
        if _folded(name) not in folded:
            raise unknown("term", name, self.names)
        return folded.index(_folded(name))

    def take(self, indices: Sequence[int]) -> "Terms":
        """Return the terms at these places."""
        return Terms(self.variables, tuple(self.terms[i] for i in indices))

    def evaluate(self, values: Floats, out: Floats | None = None) -> Floats:
        """Return the matrix of terms, shape (n, number of terms), in Fortran order, at the rows of `values`.

        A value does not depend on which other terms there are, to the last bit. If `out` is given, it is filled.
        """
        return self._plan.evaluate(values, out)

    def jacobian(self, values: Floats) -> Floats:
        """Return the exact derivatives of every term by every variable, shape (n, terms, variables)."""
        return self._plan.jacobian(values)

    def check_finite(self, matrix: Floats, values: Floats, where: str = "", before: int = 0) -> None:
        """Refuse a matrix of terms that holds a value that is not finite.

        Parameters
        ----------
        matrix
            What `evaluate` returned, shape (n, number of terms).
        values
            The variables that it was evaluated at, shape (n, number of variables).
        where
            What the rows are samples of, for the message: ``"Golf Ball, trial 1"``.
        before
            How many samples come before the first row.

        Raises
        ------
        CommonlawError
            If a value is not finite; the message names the term, the sample and the variables there.
        """
        # The sum is finite when every entry is, and costs no temporary matrix.
        with np.errstate(all="ignore"):
            if np.isfinite(matrix.sum()) or np.isfinite(matrix).all():
                return
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        state = "not a number" if np.isnan(matrix[row, column]) else "infinite"
        used = sorted(self.terms[column].columns())
        point = ", ".join(f"{self.variables.names[i]} = {values[row, i]:g}" for i in used)
        raise CommonlawError(
            f"{where}{': ' if where else ''}term {self.names[column]} is {state} at sample {before + row + 1}, "
            f"where {point}: leave the term out, or shift or scale the variable"
        )


class AbstractLibrary(ABC):
    """A family of candidate terms, not yet bound to variables.

    Libraries form an algebra: ``a + b`` has the terms of both, ``a * b`` every product of a term of one with a term
    of the other, and ``a.select("1", "v")`` and ``a.without("x^3")`` keep or drop terms by name.
    """

    @abstractmethod
    def bind(self, variables: Variables) -> Terms:
        """Return the family's terms over these variables.

        Raises
        ------
        CommonlawError
            If the family names a variable or a term that is not there.
        """

    def __add__(self, other: "AbstractLibrary") -> "AbstractLibrary":
        from commonlaw.library.algebra import SumLibrary

        return SumLibrary(self, other) if isinstance(other, AbstractLibrary) else NotImplemented

    def __mul__(self, other: "AbstractLibrary") -> "AbstractLibrary":
        from commonlaw.library.algebra import ProductLibrary

        return ProductLibrary(self, other) if isinstance(other, AbstractLibrary) else NotImplemented

    def select(self, *names: str) -> "AbstractLibrary":
        """Return the library of these terms only, in the order given; spaces in the names do not count."""
        from commonlaw.library.algebra import SelectedLibrary

        return SelectedLibrary(self, names)

    def without(self, *names: str) -> "AbstractLibrary":
        """Return the library without these terms; spaces in the names do not count."""
        from commonlaw.library.algebra import ReducedLibrary

        return ReducedLibrary(self, names)


def checked_names(names: Sequence[str] | str | None) -> tuple[str, ...] | None:
    """Return names as a tuple, hashable; a text is names between commas.

    Raises
    ------
    CommonlawError
        If there is none, or one is there twice.
    """
    if names is None:
        return None
    listed = tuple(each.strip() for each in names.split(",")) if isinstance(names, str) else tuple(names)
    if not listed or len(set(listed)) < len(listed):
        raise CommonlawError(
            f"name each variable of a library once, and at least one; got {', '.join(listed) or 'none'}"
        )
    return listed


def _folded(name: str) -> str:
    return name.replace("**", "^").replace("*", "").replace(" ", "")
