"""Laws as text, LaTeX and SymPy."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.law import text
from commonlaw.law.equations import left_hand_sides, state_rates
from commonlaw.law.law import Law, object_index, only_object, shares_terms
from commonlaw.law.parameters import named_parameters, standard_errors
from commonlaw.law.parse import latex_summands
from commonlaw.law.relations import LATEX, PLAIN, related_rows, relation_lines
from commonlaw.law.simplify import within_errors
from commonlaw.library.equation import split_equations
from commonlaw.library.notation import latex_name
from commonlaw.runtime.packages import optional_import
from commonlaw.text import in_line

if TYPE_CHECKING:
    import sympy


def structure(law: Law) -> tuple[str, ...]:
    """Return the equations with names for parameters, see `Law.structure`."""
    if law.provenance.equations:
        return law.provenance.equations
    rows = text.labelled(law.terms.factors, _labels(law, str))
    return text.written_structure(left_hand_sides(law), rows)


def _labels(law: Law, write: Callable[[str], str]) -> list[list[tuple[int, text.Label]]]:
    """Return for each equation its terms, by index, each with a number or a written parameter before it."""
    names = {(each.equation, each.term): write(each.name) for each in named_parameters(law).definitions}
    rows: list[list[tuple[int, text.Label]]] = [[] for _ in law.schema.states]
    for j, k in np.argwhere(law.support & law.terms.is_factor).tolist():
        rows[j].append((k, names.get((j, k), float(law.coefficients[0, j, k]))))
    return rows


def latex_structure(law: Law) -> tuple[tuple[text.Addend, ...], ...]:
    """Return the right-hand sides of `Law.structure` in LaTeX."""
    variables = law.terms.variables
    if law.provenance.equations:
        rows = latex_summands(law.provenance.equations, law.schema, variables, state_rates(law))
        return tuple(tuple(text.Addend(negative, "", latex) for negative, latex in row) for row in rows)
    factors = zip(law.terms.names, law.terms.latex_factors(variables.names), strict=True)
    names = ["1" if name == "1" else latex for name, latex in factors]
    return text.labelled(names, _labels(law, latex_name), text.latex_with_error)


def equations(law: Law, name: str | None, digits: int, errors: bool | None) -> tuple[str, ...]:
    """Return the equations of one object, see `Law.equations`."""
    lefts = left_hand_sides(law)
    if name is None and _has_relations(law):
        lefts = (*lefts, *law.terms.variables.constants)
        related = related_rows(law, PLAIN, lefts, law.terms.factors, digits, errors is not False)
        return tuple(f"{left} = {text.summed(addends, PLAIN.times)}" for left, addends in related)
    values = _Values.of(law, name, errors)
    if law.provenance.equations:
        numbers = {key: text.numbered(*pair, digits) for key, pair in values.parameters(law).items()}
        return tuple(each.with_numbers(numbers) for each in split_equations(law.provenance.equations))
    constants = [text.with_error(*pair, digits, bracket=True) for pair in values.constants(law)]
    written = (f"({each})" if each.startswith("-") else each for each in constants)
    names = law.terms.factors_over((*law.terms.variables.measured, *written))
    rows = zip(lefts, values.factors(law), values.errors, strict=True)
    return tuple(text.equation(*row, names, digits, law.terms.have_constants) for row in rows)


def latex(law: Law, name: str | None, digits: int, errors: bool | None) -> str:
    """Return the equations of one object in LaTeX, see `Law.to_latex`."""
    lefts = text.latex_left_hand_sides(law.schema.states, law.order)
    terms = law.terms.latex_factors(law.terms.variables.names)
    constants = [latex_name(each) for each in law.terms.variables.constants]
    if name is None and _has_relations(law):
        return text.aligned(related_rows(law, LATEX, (*lefts, *constants), terms, digits, errors is not False))
    values = _Values.of(law, name, errors)
    if law.provenance.equations:
        pairs = [(latex_name(key), pair) for key, pair in values.parameters(law).items()]
        return text.aligned([*zip(lefts, latex_structure(law), strict=True), *text.latex_values(pairs, digits)])
    rows = zip(lefts, values.factors(law), values.errors, strict=True)
    written = text.latex_equations(rows, terms, digits, law.terms.have_constants)
    return text.aligned([*written, *text.latex_values(zip(constants, values.constants(law), strict=True), digits)])


def sympy_equations(law: Law, name: str | None) -> "dict[sympy.Expr, sympy.Expr]":
    """Return the equations of one object as SymPy expressions, see `Law.to_sympy`."""
    sympy = optional_import("sympy", "the SymPy form of a law", "symbolic")
    symbols = [sympy.Symbol(each, real=True) for each in law.terms.variables.names]
    values = _Values.of(law, name, errors=False)
    pairs = zip(law.terms.variables.constants, values.constants(law), strict=True)
    constants = {sympy.Symbol(each, real=True): sympy.Float(value) for each, (value, _) in pairs}
    forms = [term.sympy(symbols).subs(constants) for term in law.terms.terms]
    sums = [
        sympy.Add(*(sympy.Float(float(c)) * form for c, form in zip(row, forms, strict=True) if c))
        for row in values.factors(law)
    ]
    return {sympy.Symbol(left, real=True): each for left, each in zip(left_hand_sides(law), sums, strict=True)}


class _Values(NamedTuple):
    """One object, by its index, and the standard errors of its coefficients to show, shape (equations, terms)."""

    position: int
    errors: Floats

    @classmethod
    def of(cls, law: Law, name: str | None, errors: bool | None) -> "_Values":
        """Return those of an object: zero errors if they are not wanted, or not known and not asked for."""
        if errors:
            law.uncertainty.known_covariance()
        position = object_index(law, only_object(law, name))
        if errors is False or law.uncertainty.covariance is None:
            return cls(position, np.zeros(law.support.shape))
        return cls(position, np.asarray(standard_errors(law)[position]))

    def parameters(self, law: Law) -> dict[str, tuple[float, float]]:
        """Return the parameters of given equations with their errors, zero where those of terms all are."""
        known = named_parameters(law)
        errors = np.nan_to_num(known.errors[self.position]) * bool(np.any(np.nan_to_num(self.errors)))
        pairs = zip(known.values[self.position].tolist(), errors.tolist(), strict=True)
        return dict(zip(known.names, pairs, strict=True))

    def constants(self, law: Law) -> list[tuple[float, float]]:
        """Return the value and the error of each parameter inside of terms."""
        coefficients, pairs = law.coefficients[self.position], []
        for k in law.terms.constants:
            j = int(np.argmax(coefficients[:, k] != 0))
            pairs.append((float(coefficients[j, k]), float(np.nan_to_num(self.errors[j, k]))))
        return pairs

    def factors(self, law: Law) -> Floats:
        """Return the coefficients that are factors of terms, shape (equations, terms)."""
        return np.where(law.terms.is_factor, law.coefficients[self.position], 0.0)


def _has_relations(law: Law) -> bool:
    return law.uncertainty.explanation is not None and len(law.objects) > 1


def printed(law: Law) -> str:
    """Return a law as `print` shows it: equations, what names stand for, and what a user should know."""
    known, values = named_parameters(law), list[str]()
    if len(law.objects) == 1:
        body = [*law.equations()]
        if law.provenance.equations:
            pairs = zip(known.values[0], np.nan_to_num(known.errors[0]), strict=True)
            heads = text.with_units(known.names, known.units)
            values = [f"{head} = {text.with_error(*pair)}" for head, pair in zip(heads, pairs, strict=True)]
    elif _has_relations(law):
        body = [*law.equations(), *relation_lines(law)]
    elif shares_terms(law):
        body = [*law.structure]
        if known.names:
            heads = text.with_units(known.names, known.units)
            body += ["", *text.coefficient_table(law.objects, heads, known.values, known.errors)]
    else:
        by_object = {name: law.equations(name) for name in law.objects}
        body = [line for name, lines in by_object.items() for line in (f"{name}:", *(f"  {each}" for each in lines))]
    meanings = ", ".join([*(f"{rate} = {state}'" for state, rate in state_rates(law)), *values])
    lines = [*body, *(["", f"with {meanings}"] if meanings else []), *text.said_within_errors(within_errors(law))]
    return "\n".join(map(in_line, [*lines, *(f"Note: {each}" for each in law.diagnostics)]))
