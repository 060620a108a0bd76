"""Laws as text, LaTeX and SymPy, with what decides their coefficients by `Law.explain`."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import compress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.hierarchy import Relation, RelationKind
from commonlaw.hierarchy.relation import meaning, quotient_unit
from commonlaw.law import text
from commonlaw.law.law import Law, object_index, only_object, shares_terms
from commonlaw.law.misfit import misfit_lines
from commonlaw.law.parameters import (
    coefficient_units,
    left_hand_sides,
    named_parameters,
    restrictions_of,
    standard_errors,
    state_rates,
)
from commonlaw.law.parse import latex_summands
from commonlaw.law.simplify import within_errors
from commonlaw.law.text import (
    Addend,
    coefficient_table,
    estimate_cells,
    free_parameter_names,
    latex_with_error,
    summed,
    with_error,
    with_units,
)
from commonlaw.law.uncertainty import Explanation, OneSidedLimit
from commonlaw.library.equation import split_equations
from commonlaw.library.notation import latex_name, powered, quoted
from commonlaw.runtime.arguments import checks_types
from commonlaw.runtime.packages import optional_import
from commonlaw.text import in_line
from commonlaw.trials.headers import parse_unit

if TYPE_CHECKING:
    import pandas as pd
    import sympy


def structure(law: Law) -> tuple[str, ...]:
    """Return the equations with names for parameters, see `Law.structure`."""
    return law.provenance.equations or _written(law, PLAIN)


def exact_equations(law: Law) -> tuple[str, ...]:
    """Return the equations of `structure` with all digits of known numbers, so that they can be read again."""
    return law.provenance.equations or _written(law, replace(PLAIN, number=lambda value, _: repr(value)))


def _written(law: Law, notation: "Notation") -> tuple[str, ...]:
    factors = law.terms.factors_over([quoted(name) for name in law.terms.variables.names])
    lefts = text.left_hand_sides([quoted(name) for name in law.schema.states], law.order)
    return text.written_equations(lefts, _with_names(law, factors, notation))


def _with_names(law: Law, terms: Sequence[str], notation: "Notation") -> tuple[tuple[Addend, ...], ...]:
    """Return the right-hand sides of `Law.structure`: terms with a name or a known number before each."""
    names = {
        (definition.equation, definition.term): notation.name(definition.name)
        for definition in named_parameters(law).definitions
    }
    rows: list[list[Addend]] = [[] for _ in law.schema.states]
    for j, k in np.argwhere(law.support & law.terms.is_factor).tolist():
        known = float(law.coefficients[0, j, k])
        number = "" if abs(known) == 1 and terms[k] != "1" else notation.number(abs(known), 0.0)
        is_named = (j, k) in names
        rows[j].append(Addend(not is_named and known < 0, names.get((j, k), number), terms[k]))
    return tuple(map(tuple, rows))


def latex_structure(law: Law) -> tuple[tuple[Addend, ...], ...]:
    """Return the right-hand sides of `Law.structure` in LaTeX."""
    variables = law.terms.variables
    if law.provenance.equations:
        return latex_summands(law.provenance.equations, law.schema, variables, law.observation.written)
    factors = zip(law.terms.names, law.terms.latex_factors(variables.names), strict=True)
    return _with_names(law, ["1" if name == "1" else latex for name, latex in factors], LATEX)


def equations(law: Law, name: str | None, digits: int, errors: bool | None) -> tuple[str, ...]:
    """Return the equations of one object, see `Law.equations`."""
    lefts = left_hand_sides(law)
    if name is None and _has_relations(law):
        lefts = (*lefts, *law.terms.variables.parameters)
        related = related_rows(law, PLAIN, lefts, law.terms.factors, digits, errors is not False)
        return text.written_equations(*zip(*related, strict=True))
    values = _Values.of(law, name, errors)
    limits = values.limits(law, errors)
    if law.provenance.equations:

        def number(value: float, error: float) -> Callable[[bool], tuple[bool, str]]:
            return lambda is_factor: (value < 0, with_error(abs(value), error, digits, bracket=is_factor))

        numbers = {key: number(*pair) for key, pair in values.parameters(law).items() if key not in limits}
        return tuple(equation.with_numbers(numbers) for equation in split_equations(law.provenance.equations))
    parameters = [
        name if name in limits else text.with_error(*pair, digits, bracket=True)
        for name, pair in zip(law.terms.variables.parameters, values.inner_parameters(law), strict=True)
    ]
    written = (f"({parameter})" if parameter.startswith("-") else parameter for parameter in parameters)
    names = law.terms.factors_over((*law.terms.variables.measured, *written))
    return text.written_equations(
        lefts,
        (
            text.addends_of(*pair, names, digits, law.terms.have_parameters, limited=_limited(law, limits, j))
            for j, pair in enumerate(zip(values.factors(law), values.errors, strict=True))
        ),
    )


def latex_lefts(law: Law) -> tuple[str, ...]:
    """Return the left-hand sides of `latex_structure` in LaTeX."""
    lefts = text.latex_left_hand_sides(law.schema.states, law.order)
    return (*lefts, *text.latex_observed(law.observation.written))


@checks_types
def to_latex(law: Law, name: str | None = None, digits: int = 4, errors: bool | None = None) -> str:
    """Return the equations as a LaTeX ``aligned`` block without dollars, with the arguments of `Law.equations`."""
    lefts = text.latex_left_hand_sides(law.schema.states, law.order)
    terms = law.terms.latex_factors(law.terms.variables.names)
    parameters = [latex_name(parameter) for parameter in law.terms.variables.parameters]
    if name is None and _has_relations(law):
        return text.aligned(related_rows(law, LATEX, (*lefts, *parameters), terms, digits, errors is not False))
    values, rows = _Values.of(law, name, errors), list[tuple[str, Iterable[Addend]]]()
    limits = values.limits(law, errors)
    latex_limits = {latex_name(key): limit.latex for key, limit in limits.items()}
    if law.provenance.equations:
        rows += zip(latex_lefts(law), latex_structure(law), strict=True)
        pairs = {latex_name(key): pair for key, pair in values.parameters(law).items()}
    else:
        numbers = zip(values.factors(law), values.errors, strict=True)
        have = law.terms.have_parameters
        sums = (
            text.addends_of(
                *pair,
                terms,
                digits,
                have,
                latex_with_error,
                {k: latex_name(parameter) for k, parameter in _limited(law, limits, j).items()},
            )
            for j, pair in enumerate(numbers)
        )
        rows += zip(lefts, sums, strict=True)
        pairs = dict(zip(parameters, values.inner_parameters(law), strict=True))
    for key, (value, error) in pairs.items():
        if key not in latex_limits:
            rows.append((key, [Addend(value < 0, latex_with_error(abs(value), error, digits), "1")]))
    return text.aligned(rows, latex_limits)


@checks_types
def to_sympy(law: Law, name: str | None = None) -> "dict[sympy.Expr, sympy.Expr]":
    """Return the equations of one object in SymPy: a mapping from ``Symbol("x''")`` to the right-hand side.

    Raises `CommonlawError` if there are several objects and none is named, or if SymPy is not installed.

    Examples
    --------
    >>> import commonlaw as cl
    >>> cl.law.to_sympy(cl.Law.from_text("T' = -k T", {"k": 0.5}))
    {T': -0.5*T}
    """
    sympy = optional_import("sympy", "the SymPy form of a law", "symbolic")
    symbols = [sympy.Symbol(variable, real=True) for variable in law.terms.variables.names]
    values = _Values.of(law, name, errors=False)
    pairs = zip(law.terms.variables.parameters, values.inner_parameters(law), strict=True)
    parameters = {sympy.Symbol(parameter, real=True): sympy.Float(value) for parameter, (value, _) in pairs}
    forms = [term.sympy(symbols).subs(parameters) for term in law.terms.terms]
    sums = [
        sympy.Add(*(sympy.Float(float(c)) * form for c, form in zip(row, forms, strict=True) if c))
        for row in values.factors(law)
    ]
    return {
        sympy.Symbol(left_side, real=True): right_side
        for left_side, right_side in zip(left_hand_sides(law), sums, strict=True)
    }


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

    def limits(self, law: Law, errors: bool | None) -> dict[str, OneSidedLimit]:
        """Return the only limits of parameters, which stand in equations with errors by their names."""
        known = named_parameters(law).limits if errors is not False else {}
        return {limit.parameter: limit for (o, _), limit in known.items() if o == self.position}

    def inner_parameters(self, law: Law) -> list[tuple[float, float]]:
        """Return the value and the error of each parameter inside terms."""
        coefficients, pairs = law.coefficients[self.position], []
        for k in law.terms.parameters:
            j = int(np.argmax(coefficients[:, k] != 0))
            pairs.append((float(coefficients[j, k]), float(np.nan_to_num(self.errors[j, k]))))
        return pairs

    def factors(self, law: Law) -> Floats:
        """Return the coefficients that are factors of terms, shape (equations, terms)."""
        return np.where(law.terms.is_factor, law.coefficients[self.position], 0.0)


def _limited(law: Law, limits: Collection[str], equation: int) -> dict[int, str]:
    """Return the names of coefficients of an equation that have only a limit, by term."""
    definitions = named_parameters(law).definitions if limits else ()
    return {
        definition.term: definition.name
        for definition in definitions
        if definition.name in limits and definition.equation == equation and law.terms.is_factor[definition.term]
    }


def _has_relations(law: Law) -> bool:
    return law.uncertainty.explanation is not None and len(law.objects) > 1


def equation_lines(law: Law) -> list[str]:
    """Return the equations of a law: with numbers of one object, with relations to properties, or of each object."""
    observed = [*law.observation.lines(law.objects, restrictions_of(law).shared), *start_lines(law)]
    if len(law.objects) == 1:
        return [*law.equations(), *observed]
    if _has_relations(law):
        return [*law.equations(), *relation_lines(law), *start_lines(law)]
    if shares_terms(law):
        return [*law.structure, *observed]
    by_object = {name: law.equations(name) for name in law.objects}
    lines = [line for name, lines in by_object.items() for line in (f"{name}:", *(f"  {line}" for line in lines))]
    return [*lines, *start_lines(law)]


def start_lines(law: Law) -> list[str]:
    """Return a line with the time of the initial values that a law gives, or that were estimated in each trial.

    >>> start_lines(Law.from_text("x' = -x"))
    []
    """
    schema, at, starts = law.observation.measured, law.observation.initial_time, law.schema.initial_values
    written = {name: start for name, start in starts.items() if isinstance(start, str | float)}
    names = [f"{name}(0) = {written[name]}" if name in written else f"{name}(0)" for name in starts]
    estimated = [estimate.name for estimate in law.trial_estimates if estimate.name.endswith("(0)")]
    names += dict.fromkeys((*(f"{name}(0)" for name in law.observation.initial), *estimated))
    if not names:
        return []
    # Doses that precede the first sample begin a trial
    when = f"the first {'dose or ' if law.schema.doses else ''}sample of each trial"
    if at is not None:
        when = f"{schema.time} = {at:g} {schema.units.get(schema.time, '')}".rstrip()
    return [f"{', '.join(names)} at {when}"]


def printed(law: Law) -> str:
    """Return a law as `print` shows it: equations, what names stand for, and what a user should know."""
    known, values, body = named_parameters(law), list[str](), equation_lines(law)
    heads = text.with_units(known.names, known.units)
    if len(law.objects) == 1:
        # Coefficients of terms stand in the equations
        shown = np.ones(len(heads), dtype=np.bool_) if law.provenance.equations else known.limited[0]
        values = [*compress(map(text.assigned, heads, known.texts(0)), shown)]
    elif not _has_relations(law) and shares_terms(law) and known.names:
        rows = map(known.texts, range(min(len(law.objects), text.MANY)))
        body += ["", *text.coefficient_table(law.objects, heads, [*rows])]
    meanings = ", ".join([*(f"{rate} = {state}'" for state, rate in state_rates(law)), *values])
    lines = [*body, *(["", f"with {meanings}"] if meanings else []), *within_errors(law), *misfit_lines(law)]
    return "\n".join(map(in_line, [*lines, *(f"Note: {diagnostic}" for diagnostic in law.diagnostics)]))


@checks_types
def relations_frame(law: Law) -> "pd.DataFrame":
    """Return a table of the relations of coefficients to properties, found by `Law.explain`.

    Columns: equation, term, kind, follows (the properties), factor, standard error, unit, scatter (the between-object
    standard deviation, relative if all objects have the same sign), its error, and the probability of the relation. The
    factor of an affine function is its constant.

    Raises `CommonlawError` if the law is not from `Law.explain`.
    """
    import pandas as pd

    lefts, indices = left_hand_sides(law), np.argwhere(law.support).tolist()
    rows = [
        {
            "equation": lefts[j],
            "term": law.terms.names[k],
            "kind": str(relation.kind),
            "follows": dependence(relation),
            "factor": relation.factors[0],
            "standard error": relation.errors[0],
            "unit": unit,
            "scatter": relation.scatter,
            "scatter error": relation.scatter_error,
            "probability": relation.probability,
        }
        for (j, k), unit, relation in zip(indices, _factor_units(law), _explanation(law).relations, strict=True)
        if relation is not None
    ]
    return pd.DataFrame(rows)


def dependence(relation: Relation) -> str:
    """Return the properties that a coefficient follows, as text: ``diameter^2/mass``; nothing without any.

    >>> powers = Fraction(2), Fraction(-1), Fraction(-1, 2)
    >>> dependence(Relation(RelationKind.POWER_LAW, (0.25,), (0.01,), ("diameter", "mass", "charge"), powers))
    'diameter^2/(mass charge^(1/2))'
    """
    if relation.kind is RelationKind.AFFINE:
        return " + ".join(relation.properties)
    above, below = _above_and_below(
        relation, lambda name, p: powered(name, int(p)) if p.denominator == 1 else f"{powered(name, 1)}^({p})"
    )
    under = f"({' '.join(below)})" if len(below) > 1 else " ".join(below)
    return (" ".join(above) or ("1" if below else "")) + (f"/{under}" if below else "")


def _above_and_below(relation: Relation, power: Callable[[str, Fraction], str]) -> list[list[str]]:
    """Return the written powers of the properties in a power law, those above and those below."""
    pairs = list(zip(relation.properties, relation.exponents, strict=True))
    return [[power(name, abs(p)) for name, p in pairs if (p > 0) == is_above] for is_above in (True, False)]


@dataclass(frozen=True)
class Notation:
    """How relations are written: numbers with errors, names, what stands between factors, and powers of properties."""

    number: Callable[..., str]
    name: Callable[[str], str]
    times: str
    powers: Callable[[Relation], str]

    def addend(self, relation: Relation, parameter: str, name: str, digits: int, errors: bool, first: bool) -> Addend:
        """Return a coefficient and its term in an equation; an object-specific coefficient is a parameter."""
        if relation.kind is RelationKind.OWN:
            return Addend(False, self.name(parameter), name)
        known = relation.errors if errors else [0.0] * len(relation.errors)
        alone = relation.kind is RelationKind.UNIVERSAL and first and name == "1"
        pairs = zip(relation.factors, known, strict=True)
        numbers = [self.number(abs(value), error, digits, bracket=not alone) for value, error in pairs]
        negative = [value < 0 for value in relation.factors]
        if relation.kind is RelationKind.AFFINE:
            names = ["1", *map(self.name, relation.properties)]
            return Addend(False, f"({summed(map(Addend, negative, numbers, names), self.times)})", name)
        return Addend(negative[0], numbers[0] + self.powers(relation), name)


def _plain_powers(relation: Relation) -> str:
    follows = dependence(relation)
    return follows[1:] if follows.startswith("1/") else follows and f" {follows}"


def _latex_powers(relation: Relation) -> str:
    parts = _above_and_below(relation, lambda name, p: latex_name(name) + (f"^{{{p}}}" if p != 1 else ""))
    above, below = map(r"\, ".join, parts)
    fraction = rf"\frac{{{above or 1}}}{{{below}}}" if below else above
    return fraction and rf"\, {fraction}"


PLAIN = Notation(with_error, lambda name: powered(name, 1), " ", _plain_powers)
LATEX = Notation(latex_with_error, latex_name, r"\, ", _latex_powers)


def related_rows(
    law: Law, notation: Notation, lefts: Sequence[str], names: Sequence[str], digits: int, errors: bool
) -> list[tuple[str, list[Addend]]]:
    """Return equations with relations before their terms, then shared parameters; left-hand sides are those of both."""
    rows: list[list[Addend]] = [[] for _ in lefts]
    equations, parameters = len(law.support), law.terms.parameters
    related = zip(
        np.argwhere(law.support).tolist(), _explanation(law).relations, _specific_parameters(law), strict=True
    )
    for (j, k), relation, parameter in related:
        row, term = rows[j], names[k]
        if k in parameters:
            if parameter:  # Its values stand in the table of object-specific coefficients
                continue
            row, term = rows[equations + parameters.index(k)], "1"
        if relation is None:
            value = float(law.coefficients[0, j, k])
            row.append(Addend(value < 0, notation.number(abs(value), 0.0, digits), term))
        else:
            row.append(notation.addend(relation, parameter or "", term, digits, errors, not row))
    return [
        (left_side, row) for i, (left_side, row) in enumerate(zip(lefts, rows, strict=True)) if row or i < equations
    ]


def relation_lines(law: Law) -> list[str]:
    """Return the lines on what relations leave open, and a table of object-specific coefficients."""
    units, parameters = _factor_units(law), _specific_parameters(law)
    names = [law.terms.names[k] for _, k in np.argwhere(law.support)]
    related = zip(_explanation(law).relations, parameters, names, units, strict=True)
    remarks = [words for relation, *how in related if relation for words in _remarks(relation, *how)]
    lines, specific = [*([""] if remarks else []), *remarks], [parameter is not None for parameter in parameters]
    limited = law.uncertainty.limited_objects
    if any(specific):
        rows = [o for o, name in enumerate(law.objects) if name not in limited]
        values, errors = law.coefficients[rows][:, law.support], standard_errors(law)[rows][:, law.support]
        pairs = zip(parameters, units, strict=True)
        heads = with_units(*zip(*((name, unit) for name, unit in pairs if name), strict=True))
        cells = estimate_cells(values[:, specific], errors[:, specific])
        lines += ["", *coefficient_table([law.objects[o] for o in rows], heads, cells)]
    for name in (name for name in law.objects if name in limited):
        limits = (f"{limit.parameter} {limit.text}" for limit in law.uncertainty.limits if limit.object == name)
        lines.append(f"{name}: {'; '.join(law.equations(name))}, {', '.join(limits)}")
    return lines


def _remarks(relation: Relation, parameter: str | None, name: str, unit: str | None) -> Iterator[str]:
    """Yield what an equation does not say of a relation, given the unit of its factor if it is known."""
    scatter = with_error(relation.scatter, relation.scatter_error)
    amount = f"standard deviation between objects{' in logarithms' if relation.relative else ''} {scatter}"
    if relation.kind is RelationKind.OWN:
        typical = with_error(relation.factors[0], relation.errors[0])
        yield f"{parameter} is object-specific: typical value {typical}, {amount}"
    elif relation.scatter:
        yield f"coefficients of {name} deviate from this: {amount}"
    if relation.kind is not RelationKind.POWER_LAW or unit is None:
        return
    if parse_unit(unit).dimensionless:
        inverse = dependence(replace(relation, exponents=tuple(-power for power in relation.exponents)))
        yield f"the coefficient of {name} times {inverse} is a pi group: it has no unit"
    elif meaning(unit):
        yield f"the factor of {name} has the unit {unit}, that of {meaning(unit)}"
    else:
        yield f"the factor of {name} has the unit {unit}, which no common constant has: a property may be missing"


def _specific_parameters(law: Law) -> list[str | None]:
    """Return a name for each coefficient in the law that is object-specific."""
    explanation, columns = _explanation(law), np.argwhere(law.support)[:, 1].tolist()
    variables = law.terms.variables.names
    free = iter(free_parameter_names(len(columns), (*variables, *explanation.properties)))
    return [
        law.terms.parameter_name(k) or next(free) if relation and relation.kind is RelationKind.OWN else None
        for relation, k in zip(explanation.relations, columns, strict=True)
    ]


def _factor_units(law: Law) -> list[str | None]:
    """Return the units of the relations' factors, as far as they are known."""
    result: list[str | None] = []
    known, units, lefts = coefficient_units(law), law.schema.units, left_hand_sides(law)
    for (j, k), relation in zip(np.argwhere(law.support), _explanation(law).relations, strict=True):
        unit = known.get((lefts[j], law.terms.names[k]))
        if unit is None or relation is None or not {*relation.properties} <= units.keys():
            result.append(None)
        else:
            powers = zip(relation.properties, map(float, relation.exponents), strict=False)
            result.append(quotient_unit(unit, [(units[name], power) for name, power in powers]))
    return result


def _explanation(law: Law) -> Explanation:
    if law.uncertainty.explanation is None:
        raise CommonlawError("relations-missing")
    return law.uncertainty.explanation
