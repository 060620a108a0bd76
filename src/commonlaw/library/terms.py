"""Terms over named variables, evaluated together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.library.program import Program
from commonlaw.library.term import Term, parse_term
from commonlaw.library.variables import Variables


class Fraction(str):
    """The name of a term with a coefficient, ``s/(K + s)``, with numerator, denominator, and how they are joined."""

    __slots__ = ("above", "below", "form")

    above: str
    below: str
    form: str

    def __new__(cls, whole: str, above: str, below: str, form: str) -> Self:
        result = super().__new__(cls, whole)
        result.above, result.below, result.form = above, below, form
        return result

    def over(self, above: str) -> str:
        """Return the fraction of another numerator, ``(a s + b s^2)/(K + s)``."""
        return self.form.format(above, self.below)

    def behind(self, number: str, times: str) -> str:
        """Return it behind a coefficient: ``a s/(K + s)``, ``a/(K + s)``."""
        if self.startswith("1/"):
            return f"{number}{self[1:]}"
        return f"{number}{times}{self}"


@dataclass(frozen=True)
class Terms:
    """Terms over named variables, evaluated together."""

    variables: Variables
    terms: tuple[Term, ...]

    def __len__(self) -> int:
        return len(self.terms)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The terms as the field writes them: ``("1", "x", "x^2 v")``."""
        return tuple(term.text(self.variables.names) for term in self.terms)

    @cached_property
    def factors(self) -> tuple[str, ...]:
        """The same as factors of a product, sums in parentheses."""
        return self.factors_over(self.variables.names)

    def factors_over(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return them over other names of the variables, or numbers in place of parameters."""
        return self._factors(lambda term: term.text(names), "({})", "({})/({})")

    def latex_factors(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return them as LaTeX."""
        return self._factors(lambda term: term.latex(names), r"\left({}\right)", r"\frac{{{}}}{{{}}}")

    def _factors(self, write: Callable[[Term], str], brackets: str, form: str) -> tuple[str, ...]:
        measured, result = len(self.variables.measured), list[str]()
        for term in self.terms:
            text, above, below = write(term), term.numerator, term.denominator
            if max(below.columns(), default=0) < measured:
                result.append(brackets.format(text) if term.is_sum else text)
            else:  # Divided by something with parameters
                over = f"({write(above)})" if above.is_sum else write(above)
                result.append(Fraction(text, over, write(below), form))
        return tuple(result)

    @cached_property
    def complexities(self) -> Floats:
        """The complexity of each term, shape (terms,); shared divisors with parameters count once."""
        first, seen, result = len(self.variables.measured), set[Term](), list[float]()
        for term in self.terms:
            below = {divisor for divisor in term.divisors if any(column >= first for column in divisor.columns())}
            result.append(term.complexity() - sum(each.complexity() for each in below & seen))
            seen |= below
        return np.array(result)

    @cached_property
    def program(self) -> Program:
        """The terms as a program of single operations."""
        products = [term.powers if term.parameter is None else None for term in self.terms]
        return Program.of(products, len(self.variables.names), self.variables.functions)

    @cached_property
    def parameters(self) -> tuple[int, ...]:
        """The index of each parameter's own term, see `Term`; raises `CommonlawError` if these are not the last."""
        own = tuple(Term(parameter=self.variables.index(name)) for name in self.variables.parameters)
        first = len(self.terms) - len(own)
        if self.terms[max(first, 0) :] != own:
            names = ", ".join(self.variables.parameters)
            raise CommonlawError("parameter-names", names=names)
        return tuple(range(first, len(self.terms)))

    def parameter_name(self, index: int) -> str | None:
        """Return the name of the constant that a term, by its index, is the place of, if it is one."""
        return self.variables.parameters[self.parameters.index(index)] if index in self.parameters else None

    @cached_property
    def is_factor(self) -> Bools:
        """Which terms are multiplied by their coefficients, shape (terms,): all but those of parameters."""
        result = np.ones(len(self.terms), dtype=np.bool_)
        result[list(self.parameters)] = False
        return result

    @cached_property
    def have_parameters(self) -> tuple[bool, ...]:
        """Which terms have parameters inside."""
        first = len(self.variables.measured)
        return tuple(any(column >= first for column in term.columns()) for term in self.terms)

    def at(self, values: Floats, coefficients: Floats) -> Floats:
        """Return values of measured variables, shape (n, variables), followed by parameters from the coefficients."""
        if not self.parameters:
            return values
        own = coefficients[:, list(self.parameters)].sum(axis=0)
        return np.column_stack([values, np.broadcast_to(own, (len(values), len(own)))])

    def index(self, name: str) -> int:
        """Return the index of the term of that name, without spaces or with stars: ``x^2 v`` is also ``x**2*v``.

        Raises `CommonlawError` if there is no such term.
        """
        if name in self.names:
            return self.names.index(name)
        folded = [_folded(each) for each in self.names]
        if _folded(name) not in folded:
            raise unknown("term", name, self.names)
        return folded.index(_folded(name))

    def take(self, indices: Sequence[int]) -> "Terms":
        """Return the terms at these indices."""
        return Terms(self.variables, tuple(self.terms[i] for i in indices))

    def evaluate(self, values: Floats, out: Floats | None = None) -> Floats:
        """Return the matrix of terms, shape (n, terms), in Fortran order, at rows of `values`; `out` is filled if
        given.

        A value does not depend on which other terms there are, to the last bit.
        """
        return self.program.evaluate(values, out)

    def jacobian(self, values: Floats) -> Floats:
        """Return the exact derivatives of every term by every variable, shape (n, terms, variables)."""
        return self.program.jacobian(values)

    def check_finite(self, matrix: Floats, values: Floats, where: str = "", before: int = 0) -> None:
        """Refuse a matrix of terms, shape (n, terms), at values of the variables, that is not finite.

        The `CommonlawError` names the term, the values, the sample, counted from those `before`, and `where`: a trial.
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
            "term-not-finite", where, term=self.names[column], value=state, sample=before + row + 1, point=point
        )


def parse_terms(texts: Sequence[str], variables: Variables) -> Terms:
    """Return the terms that expressions stand for, see `parse_term`; the last are those of parameters."""
    first = len(texts) - len(variables.parameters)
    own = (Term(parameter=variables.index(name)) for name in variables.parameters)
    return Terms(variables, (*(parse_term(text, variables) for text in texts[:first]), *own))


def _folded(name: str) -> str:
    return name.replace("**", "^").replace("*", "").replace(" ", "")
