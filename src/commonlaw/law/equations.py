"""Equations that objects share: what they hold, what they give, and how they are written."""

from abc import ABC
from collections.abc import Callable, Iterator
from functools import cached_property, reduce
from operator import mul
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.extras import optional_import
from commonlaw.law import text
from commonlaw.law.dimensions import quotient_unit, units_of_coefficients
from commonlaw.law.explanation import LATEX, PLAIN, Explanation
from commonlaw.law.from_text import (
    Coefficient,
    GivenEquations,
    Part,
    Product,
    latex_summands,
    read_equations,
)
from commonlaw.law.numbers import latex_with_error, with_error
from commonlaw.law.provenance import Provenance
from commonlaw.law.related import RelatedCoefficients
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library import Order, Terms, with_rates
from commonlaw.library.equation import split_equations
from commonlaw.library.notation import latex_name
from commonlaw.notebooks import ShownInNotebooks
from commonlaw.trials import Schema

if TYPE_CHECKING:
    import pandas as pd
    import pint
    import sympy

    from commonlaw.law.script import Source


class AbstractEquations(ShownInNotebooks, ABC):
    """What a law says: everything that follows from its terms and coefficients and how accurate these are."""

    terms: Terms
    schema: Schema
    order: Order
    objects: tuple[str, ...]
    coefficients: Floats
    uncertainty: Uncertainty
    provenance: Provenance

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the measured states."""
        return self.schema.states

    @cached_property
    def support(self) -> Bools:
        """Which terms are in which equation for at least one object, shape (equations, terms)."""
        return np.asarray(np.any(self.coefficients != 0, axis=0))

    @property
    def rates(self) -> tuple[str, ...]:
        """Names of the rates of the states of second order."""
        return self.terms.variables.states[len(self.states) :]

    @property
    def state_rates(self) -> tuple[tuple[str, str], ...]:
        """The names of the states of second order, each with that of its rate."""
        second = (self.states[j] for j in with_rates(self.order, len(self.states)))
        return tuple(zip(second, self.rates, strict=True))

    @property
    def left_hand_sides(self) -> tuple[str, ...]:
        """What each equation gives, as text: ``x'``, ``x''``, or ``x[k+1]`` in a discrete-time law."""
        return text.left_hand_sides(self.states, self.order)

    @cached_property
    def shared(self) -> bool:
        """Whether every object has the same terms."""
        return bool(np.all((self.coefficients != 0) == self.support))

    def index(self, name: object) -> int:
        """Return the index of an object among those of the law.

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        index = self._indices.get(str(name))
        if index is None:
            raise unknown("object of this law", name, self.objects)
        return index

    @cached_property
    def _indices(self) -> dict[str, int]:
        """The index of each object."""
        return {name: index for index, name in enumerate(self.objects)}

    def coefficients_of(self, name: object) -> Floats:
        """Return the coefficients of one object, shape (equations, terms).

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        return np.asarray(self.coefficients[self.index(name)])

    def evaluate(self, name: str, values: ArrayLike) -> Floats:
        """Return the highest derivatives of one object, shape (n, equations).

        Parameters
        ----------
        name
            The object.
        values
            The law's variables (states, rates, inputs, time), shape (n, variables). Time may be left out where no term
            depends on it.

        Raises
        ------
        CommonlawError
            If there is no such object, or the values are not those of the variables.
        """
        own, variables = self.coefficients_of(name), self.terms.variables
        points, names = np.asarray(values, dtype=np.float64), variables.measured
        time = variables.index(variables.time)
        if points.ndim == 2 and points.shape[1] == len(names) - 1 and not self._depends_on(time):
            points = np.insert(points, time, 0.0, axis=1)
        if points.ndim != 2 or points.shape[1] != len(names):
            raise CommonlawError("variables-shape", shape=points.shape, names=names)
        return np.asarray(self.terms.evaluate(self.terms.at(points, own)) @ own.T)

    def _depends_on(self, column: int) -> bool:
        """Return whether a term of the law has a variable in it."""
        return any(column in self.terms.terms[k].columns() for k in np.flatnonzero(self.support.any(axis=0)))

    # How accurate they are

    @cached_property
    def standard_errors(self) -> Floats:
        """Standard errors of the coefficients, shape (objects, equations, terms).

        Zero for coefficients that are known, NaN for terms that are not in the law, and everywhere if the covariance is
        not known.
        """
        errors = np.full(self.coefficients.shape, np.nan)
        if self.uncertainty.covariance is not None:
            errors[:, self.support] = np.sqrt(np.diagonal(self.uncertainty.covariance, axis1=1, axis2=2))
        errors.flags.writeable = False
        return errors

    # How they are written

    def equations(self, name: str | None = None, digits: int = 4, errors: bool | None = None) -> tuple[str, ...]:
        """Return the equations of one object as text: ``x'' = -9.34 + 0.0466 v``.

        With errors: ``x'' = -9.34 ± 0.12 + (0.047 ± 0.010) v``, standard errors to two digits. A law that was given as
        equations is written as these, with numbers in place of its letters: ``N' = 0.8 N (1 - N/1.4)``.

        Parameters
        ----------
        name
            The object; may be left out when there is only one. Of a law that `Law.explain` gave, nothing gives the
            equations that hold for all objects: ``x'' = -9.8 + 0.25 diameter^2/mass v^2``.
        digits
            Significant digits of the coefficients that have no error.
        errors
            Whether to show standard errors; None shows them when they are known.

        Raises
        ------
        CommonlawError
            If the object is not named and there are several, or errors are asked for that are not known.
        """
        if name is None and self._is_explained:
            lefts = (*self.left_hand_sides, *self.terms.variables.constants)
            related = self._related.rows(PLAIN, lefts, self.terms.factors, digits, errors is not False)
            return tuple(f"{left} = {text.summed(addends, PLAIN.times)}" for left, addends in related)
        known = self._shown_errors(name := self._only(name), errors)
        if self.provenance.equations:
            numbers = {letter: text.numbered(*pair, digits) for letter, pair in self._letters_of(name, known).items()}
            return tuple(each.with_numbers(numbers) for each in split_equations(self.provenance.equations))
        constants = [with_error(*pair, digits, bracket=True) for pair in self._constants(name, known)]
        written = (f"({each})" if each.startswith("-") else each for each in constants)
        names = self.terms.factors_over((*self.terms.variables.measured, *written))
        rows = zip(self.left_hand_sides, self._factors(name), known, strict=True)
        return tuple(text.equation(*row, names, digits, self.terms.have_constants) for row in rows)

    def to_latex(self, name: str | None = None, digits: int = 4, errors: bool | None = None) -> str:
        """Return `equations` as LaTeX, an ``aligned`` block without dollar signs; constants have lines of their own.

        So have the letters of a law that was given as equations, which is written as these: r and K of
        ``N' = r N (1 - N/K)``.

        Raises
        ------
        CommonlawError
            If the object is not named and there are several, or errors are asked for that are not known.
        """
        left = text.latex_left_hand_sides(self.states, self.order)
        terms = self.terms.latex_factors(self.terms.variables.names)
        constants = [latex_name(each) for each in self.terms.variables.constants]
        if name is None and self._is_explained:
            return text.aligned(self._related.rows(LATEX, (*left, *constants), terms, digits, errors is not False))
        known = self._shown_errors(name := self._only(name), errors)
        if self.provenance.equations:
            letters = {latex_name(letter): pair for letter, pair in self._letters_of(name, known).items()}
            return text.latex_of_given(left, self.latex_structure(), letters, digits)
        values = zip(constants, self._constants(name, known), strict=True)
        return text.latex(left, self._factors(name), known, terms, digits, values, self.terms.have_constants)

    def to_sympy(self, name: str | None = None) -> "dict[sympy.Expr, sympy.Expr]":
        """Return the equations of one object: left-hand side, such as ``Symbol("x''")``, to right-hand side.

        Raises
        ------
        CommonlawError
            If the object is not named and there are several, or SymPy is not installed.
        """
        sympy = optional_import("sympy", "the SymPy form of a law", "symbolic")
        symbols = [sympy.Symbol(each, real=True) for each in self.terms.variables.names]
        name = self._only(name)
        pairs = zip(self.terms.variables.constants, self._constants(name, np.zeros(self.support.shape)), strict=True)
        values = {sympy.Symbol(each, real=True): sympy.Float(float(value)) for each, (value, _) in pairs}
        forms = [term.sympy(symbols).subs(values) for term in self.terms.terms]
        sums = [
            sympy.Add(*(sympy.Float(float(c)) * form for c, form in zip(row, forms, strict=True) if c))
            for row in self._factors(name)
        ]
        return {sympy.Symbol(left, real=True): each for left, each in zip(self.left_hand_sides, sums, strict=True)}

    def to_script(self, path: "str | Source" = "trials.csv") -> str:
        """Return a Python program that finds this law again in the table of its trials.

        A law's file may come from a stranger: the program holds calls of commonlaw with plain values only, and a line
        for each recorded step that is something else.

        Parameters
        ----------
        path
            Of the table. What was selected from it before the law was found, the law does not know; a `Source` says it.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> for line in cl.fit("x'' = -g - c v", drops).to_script("drops.csv").splitlines()[2:4]:
        ...     print(line)
        trials = cl.Trials.read('drops.csv', time='t', states=['x'], units={'t': 's', 'x': 'm'})
        law = cl.fit("x'' = -g - c v", trials)
        """
        from commonlaw.law.script import Source, script

        equations = self.structure() if self.shared else ()
        source = path if isinstance(path, Source) else Source(path)
        return script(self.provenance.calls, equations, self.schema, source)

    def to_frame(self, errors: bool = False) -> "pd.DataFrame":
        """Return the coefficients: one row for each object, one column for each term that is in the law.

        With several equations the columns have two levels, the equation and the term. A law that was given as equations
        has a column for each of their letters.

        Parameters
        ----------
        errors
            Whether each column is followed by one of standard errors, ``"v ±"`` after ``"v"``.

        Raises
        ------
        CommonlawError
            If errors are asked for that are not known.
        """
        from commonlaw.law.tables import coefficient_frame, letter_frame

        if errors:
            self.uncertainty.known_covariance()
        if self.provenance.equations:
            return letter_frame(self.objects, self.letters, *self.letter_values(), errors)
        names = self.objects, self.left_hand_sides, self.terms.names
        return coefficient_frame(*names, self.support, self.coefficients, self.standard_errors if errors else None)

    def coefficient_units(self) -> "dict[tuple[str, str], str]":
        """Return the unit of each coefficient by equation and term, where the units of the variables tell it."""
        return {key: f"{unit:~P}" for key, unit in self._units().items()}

    def _units(self) -> "dict[tuple[str, str], pint.Unit]":
        found = units_of_coefficients(self.terms, self.support, self.schema, self.order)
        return {(self.left_hand_sides[j], self.terms.names[k]): unit for (j, k), unit in found.items()}

    def structure(self) -> tuple[str, ...]:
        """Return each equation's form, with letters for the coefficients: ``x'' = a + b v``; as given if it was.

        Known coefficients that all objects share are numbers: ``x'' = -9.81 + a v``.
        """
        if self.provenance.equations:
            return self.provenance.equations
        rows = text.labelled(self.terms.factors, self._labels(str))
        return text.written_structure(self.left_hand_sides, rows)

    def latex_structure(self) -> tuple[tuple[text.Addend, ...], ...]:
        """Return the right-hand sides of `structure` in LaTeX."""
        variables = self.terms.variables
        if self.provenance.equations:
            rows = latex_summands(self.provenance.equations, self.schema, variables, self.state_rates)
            return tuple(tuple(text.Addend(negative, "", latex) for negative, latex in row) for row in rows)
        factors = zip(self.terms.names, self.terms.latex_factors(variables.names), strict=True)
        names = ["1" if name == "1" else latex for name, latex in factors]
        return text.labelled(names, self._labels(latex_name), latex_with_error)

    def _labels(self, write: Callable[[str], str]) -> tuple[tuple[tuple[int, text.Label], ...], ...]:
        """Return for each equation its terms, by index, each with a number or a written letter before it."""
        letters = {(each.equation, each.term): write(each.name) for each in self.named_coefficients}
        rows: list[list[tuple[int, text.Label]]] = [[] for _ in self.states]
        for j, k in np.argwhere(self.support & self.terms.is_factor).tolist():
            rows[j].append((k, letters.get((j, k), float(self.coefficients[0, j, k]))))
        return tuple(map(tuple, rows))

    @property
    def letters(self) -> tuple[str, ...]:
        """The letters that `structure` uses, one for each coefficient that is no known number."""
        return tuple(each.name for each in self.named_coefficients)

    @cached_property
    def named_coefficients(self) -> tuple[Coefficient, ...]:
        """Where each letter of `structure` stands."""
        if self.provenance.equations:
            return self._given.coefficients
        alike = np.all((self.standard_errors == 0) & (self.coefficients == self.coefficients[:1]), axis=0)
        places = np.argwhere(self.support & ~(alike & self.terms.is_factor)).tolist()
        letters = iter(text.free_letters(len(places), self.terms.variables.names))
        named = ((self.terms.constant_name(k) or next(letters), j, k) for j, k in places)
        return tuple(Coefficient(letter, (Part(j, k),)) for letter, j, k in named)

    def _letters_of(self, name: str, errors: Floats) -> dict[str, tuple[float, float]]:
        """Return what the letters of given equations stand for, and their errors, zero where those of terms all are."""
        values, own = (each[self.index(name)].tolist() for each in self._letter_values)
        shown = np.nan_to_num(own) * bool(np.any(np.nan_to_num(errors)))
        return dict(zip(self.letters, zip(values, shown.tolist(), strict=True), strict=True))

    def _constants(self, name: str, errors: Floats) -> Iterator[tuple[float, float]]:
        """Yield the value of each constant inside of terms for an object, and its error of those of all terms."""
        own = self.coefficients_of(name)
        for k in self.terms.constants:
            j = int(np.argmax(own[:, k] != 0))
            yield float(own[j, k]), float(np.nan_to_num(errors[j, k]))

    def _factors(self, name: str) -> Floats:
        """Return the coefficients of an object that are factors of terms, shape (equations, terms)."""
        return np.where(self.terms.is_factor, self.coefficients_of(name), 0.0)

    @cached_property
    def named_products(self) -> tuple[Product, ...]:
        """What stands before each term, by the letters of `structure`."""
        if self.provenance.equations:
            return self._given.products
        return tuple(Product(each.equation, each.term, 1.0, ((each.name, 1),)) for each in self.named_coefficients)

    @cached_property
    def _given(self) -> GivenEquations:
        return read_equations(self.provenance.equations, self.schema, self.terms.variables)

    def letter_values(self) -> tuple[Floats, Floats]:
        """Return what the letters of `structure` stand for, and their standard errors, both (objects, letters)."""
        return self._letter_values

    @cached_property
    def _letter_values(self) -> tuple[Floats, Floats]:
        values, errors = np.empty((2, len(self.objects), len(self.named_coefficients)))
        for i, each in enumerate(self.named_coefficients):
            values[:, i] = each.of(self.coefficients)
            errors[:, i] = self._error(each)
        values.flags.writeable = errors.flags.writeable = False
        return values, errors

    def _error(self, coefficient: Coefficient) -> Floats:
        """Return the standard error of a named coefficient to first order, shape (objects,)."""
        covariance = self.uncertainty.covariance
        if covariance is None or not all(self.support[each.equation, each.term] for each in coefficient.parts):
            return np.full(len(self.objects), np.nan)
        indices = {index: i for i, index in enumerate(zip(*np.nonzero(self.support), strict=True))}
        own = [indices[each.equation, each.term] for each in coefficient.parts]
        slopes, inner = coefficient.gradient(self.coefficients), covariance[:, own][:, :, own]
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", slopes, inner, slopes), 0.0)))

    def letter_units(self) -> "tuple[str | None, ...]":
        """Return the unit of each letter of `structure`, as far as the units of the variables tell it."""
        units, found = self._units(), list[str | None]()
        for each in self.named_coefficients:
            own = [units.get((self.left_hand_sides[part.equation], self.terms.names[part.term])) for part in each.parts]
            powers = [None if unit is None else unit**part.power for unit, part in zip(own, each.parts, strict=True)]
            known = [unit for unit in powers if unit is not None]
            found.append(f"{reduce(mul, known):~P}" if len(known) == len(powers) else None)
        return tuple(found)

    def _heads(self) -> list[str]:
        return text.with_units(self.letters, self.letter_units())

    @property
    def _is_explained(self) -> bool:
        return self.uncertainty.explanation is not None and len(self.objects) > 1

    def _explained(self) -> Explanation:
        if self.uncertainty.explanation is None:
            raise CommonlawError("relations-missing")
        return self.uncertainty.explanation

    def relations(self) -> "pd.DataFrame":
        """Return a table of what decides each coefficient: its kind, the properties it follows, its factor, scatter.

        Columns are equation, term, kind, follows, factor, standard error, unit, scatter, its error and the probability
        of the relation; scatter is relative where all objects have the same sign, and factors of affine functions are
        their constants.

        Raises
        ------
        CommonlawError
            If `Law.explain` was not asked.
        """
        explanation, indices = self._explained(), np.argwhere(self.support)
        equations = [self.left_hand_sides[j] for j, _ in indices]
        return explanation.to_frame(equations, [self.terms.names[k] for _, k in indices], self._factor_units())

    def _factor_units(self) -> list[str | None]:
        """Return the units of the relations' factors, as far as they are known."""
        found: list[str | None] = []
        own, units = self.coefficient_units(), self.schema.units
        for (j, k), relation in zip(np.argwhere(self.support), self._explained().relations, strict=True):
            unit = own.get((self.left_hand_sides[j], self.terms.names[k]))
            if unit is None or relation is None or not {*relation.properties} <= units.keys():
                found.append(None)
            else:
                powers = zip(relation.properties, map(float, relation.exponents), strict=False)
                found.append(quotient_unit(unit, [(units[name], power) for name, power in powers]))
        return found

    @property
    def _related(self) -> RelatedCoefficients:
        return RelatedCoefficients(self.terms, self.support, self.coefficients, self._explained())

    def _explained_body(self) -> list[str]:
        """Return the lines that hold the relations, what they leave open, and coefficients that are objects' own."""
        return [*self.equations(), *self._related.lines(self.objects, self.standard_errors, self._factor_units())]

    def _only(self, name: str | None) -> str:
        if name is None and len(self.objects) > 1:
            names = ", ".join(self.objects)
            raise CommonlawError("several-objects", objects=names)
        return self.objects[0] if name is None else name

    def _shown_errors(self, name: str, wanted: bool | None) -> Floats:
        """Return the standard errors of one object to show, shape (equations, terms): zeros if they are not wanted."""
        if wanted:
            self.uncertainty.known_covariance()
        if wanted is False or self.uncertainty.covariance is None:
            return np.zeros(self.support.shape)
        return np.asarray(self.standard_errors[self.index(name)])
