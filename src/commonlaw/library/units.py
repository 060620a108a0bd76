"""The unit of a term, and of parameters inside terms."""

import ast
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.library.grammar import FUNCTIONS, OPERATIONS, Algebra, columns_in, constant, evaluate, tree_of
from commonlaw.library.term import Term, Terms
from commonlaw.library.variables import Variables
from commonlaw.trials.headers import check_unit, parse_unit, registry

if TYPE_CHECKING:
    import pint


def term_unit(term: Term, variables: Variables, units: "Mapping[str, str | pint.Unit]") -> "pint.Unit | None":
    """Return the unit of a term, from units of variables by name, of pint or as text: ``"m/s^2"``.

    None when a variable has no unit, or for the sine of a length, or a length added to a number. Raises
    `CommonlawError` if a unit is unknown.

    >>> from commonlaw.library import parse_term
    >>> variables = Variables(("x", "v"))
    >>> print(term_unit(parse_term("x*v^2", variables), variables, {"x": "m", "v": "m/s"}))
    meter ** 3 / second ** 2
    """
    names = {column: variables.names[column] for column in term.columns()}
    if not all(name in units for name in names.values()):
        return None
    known, result = dict[int, "pint.Unit"](), registry().dimensionless
    for column, name in names.items():
        given = units[name]
        known[column] = parse_unit(check_unit(given, f"variable {name!r}")) if isinstance(given, str) else given
    for factor, power in term.powers:
        unit = known[factor.column] if factor.column is not None else _expression_unit(factor, known)
        if unit is None:
            return None
        result = result * unit**power
    return result


_QUANTITIES = Algebra(float, {**OPERATIONS, **dict.fromkeys(("erf", "erfc", "floor", "ceil"), np.exp)})
"""Operations on quantities; those that pint lacks, or computes in the unit at hand, are of numbers without unit."""


def _expression_unit(code: str, units: Mapping[int, "pint.Unit"]) -> "pint.Unit | None":
    """Return the unit of an expression by computing it for quantities of these units."""
    import pint

    quantities = [registry().Quantity(np.ones(1), units.get(i)) for i in range(max(units) + 1)]
    try:
        with np.errstate(all="ignore"):
            return registry().Unit(registry().Quantity(evaluate(code, quantities, _QUANTITIES)).units)
    except (pint.PintError, TypeError, CommonlawError):  # Functions of Python have no unit
        return None


_OF_ANY_UNIT = ("abs", "sqrt", "sign", "step")
"""Functions whose argument may have a unit."""


def units_of_parameters(terms: Terms, units: "Mapping[str, pint.Unit]") -> "dict[str, pint.Unit]":
    """Return the units of parameters that follow from those of variables by name.

    K of ``s/(K + s)`` has the unit of s, U of ``exp(u/U)`` that of u, and a power none.
    """
    names, first = terms.variables.names, len(terms.variables.measured)
    known = {i: units[name] for i, name in enumerate(names[:first]) if name in units}
    trees = [tree_of(term.code) for term in terms.terms]
    count = -1
    while count < len(known):  # What one term tells of a constant may tell another's unit
        count = len(known)
        for tree in trees:
            _look(tree, None, known, first)
    return {names[i]: unit for i, unit in known.items() if i >= first}


def _look(tree: ast.expr, wanted: "pint.Unit | None", known: "dict[int, pint.Unit]", first: int) -> None:
    """Note the units of parameters in a tree that has a unit, if it is known which."""
    none = registry().dimensionless
    match tree:
        case ast.Name(id=name) if (column := int(name[1:])) >= first and wanted is not None:
            known.setdefault(column, wanted)
        case ast.UnaryOp(operand=operand):
            _look(operand, wanted, known, first)
        case ast.Call(func=ast.Name(id=name), args=[argument]) if name in FUNCTIONS:
            _look(argument, None if name in _OF_ANY_UNIT else none, known, first)
        case ast.Call(func=ast.Name(id="arctan2"), args=arguments):
            common = next((unit for part in arguments if (unit := _tree_unit(part, known)) is not None), None)
            for part in arguments:
                _look(part, common, known, first)
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
            number = constant(exponent)
            root = None if wanted is None or not number else registry().Unit(wanted ** (1 / number))
            _look(base, root, known, first)
            _look(exponent, none, known, first)
        case ast.BinOp(op=op, left=left, right=right):
            units = [_tree_unit(side, known) for side in (left, right)]
            if isinstance(op, ast.Add | ast.Sub):
                common = next((unit for unit in (*units, wanted) if unit is not None), None)
                sides = common, common
            elif wanted is None:
                sides = None, None
            else:  # From that of the result and of the other operand
                is_product, (left_unit, right_unit) = isinstance(op, ast.Mult), units
                of_left = None if right_unit is None else wanted / right_unit if is_product else wanted * right_unit
                sides = of_left, None if left_unit is None else wanted / left_unit if is_product else left_unit / wanted
            _look(left, sides[0], known, first)
            _look(right, sides[1], known, first)


def _tree_unit(tree: ast.expr, known: "Mapping[int, pint.Unit]") -> "pint.Unit | None":
    code = ast.unparse(tree)
    columns = columns_in(code)
    if not columns:
        return registry().dimensionless
    return _expression_unit(code, known) if columns <= known.keys() else None
