"""Equations of a law as labels and lines of mathtext."""

import numpy as np

from commonlaw.law import Law
from commonlaw.law.parameters import left_hand_sides, named_parameters, state_rates
from commonlaw.law.printing import latex_lefts, latex_structure
from commonlaw.law.text import latex_left_hand_sides
from commonlaw.library import Terms
from commonlaw.library.notation import latex_name
from commonlaw.plots.style import math


def term_labels(terms: Terms) -> list[str]:
    """Return every term as a label."""
    names = terms.variables.names
    return [math(term.latex(names), text) for term, text in zip(terms.terms, terms.names, strict=True)]


def equation_labels(law: Law) -> list[str]:
    """Return the left-hand side of every equation as a label."""
    return [
        math(latex, text)
        for latex, text in zip(latex_left_hand_sides(law.schema.states, law.order), left_hand_sides(law), strict=True)
    ]


def equation_lines(law: Law) -> str:
    """Return the law as lines of mathtext: with numbers if it has one object, else with the names of coefficients.

    A last line defines rates and names.
    """
    lines = []
    for j, label in enumerate(equation_labels(law)):
        lines += _broken(f"{label} $=$", _summands(law, j))
    lefts, names = latex_lefts(law)[len(law.schema.states) :], law.observation.written
    for j, (label, name) in enumerate(zip(lefts, names, strict=True), len(law.schema.states)):
        lines += _broken(f"{math(label, name)} $=$", _summands(law, j))
    rates = [
        f"{math(latex_name(rate), rate)} $=$ " + math(rf"\dot{{{latex_name(state)}}}", f"{state}'")
        for state, rate in state_rates(law)
    ]
    parameters = named_parameters(law)
    given = parameters.names if law.provenance.equations else law.terms.variables.parameters
    pairs = zip(parameters.names, parameters.values[0], strict=True) if len(law.objects) == 1 else ()
    values = [f"{math(latex_name(name), name)} $=$ {_number(value)}" for name, value in pairs if name in given]
    meaning = ", ".join([*rates, *values])
    return "\n".join([*lines, f"with {meaning}"] if meaning else lines)


def parameter_label(law: Law, equation: int, term: int) -> str:
    """Return the parameters of a coefficient as a label, with its factor; empty if it is not in the law or has none."""
    factor, names = _factor_and_parameters(law, equation, term)
    sign = {1.0: "", -1.0: "$-$"}.get(factor, _number(factor))
    return sign + names if names and law.support[equation, term] else ""


def _factor_and_parameters(law: Law, equation: int, term: int) -> tuple[float, str]:
    """Return what a coefficient is as given: a factor times parameters or over them, or a number and none."""
    for product in named_parameters(law).products:
        if (product.equation, product.term) == (equation, term):
            above, below = (
                r"\, ".join(latex_name(name) for name, exponent in product.coefficients if exponent == power)
                for power in (1, -1)
            )
            latex = rf"\frac{{{above or 1}}}{{{below}}}" if below else above
            return product.factor, math(latex, " ".join(name for name, _ in product.coefficients))
    return float(law.coefficients[0, equation, term]), ""


def _summands(law: Law, j: int) -> list[tuple[str, str]]:
    """Return sign and text of each summand of equation j."""
    if law.provenance.equations:
        return [("$-$" if part.negative else "$+$", math(part.name, part.name)) for part in latex_structure(law)[j]]
    summands, labels, one = [], term_labels(law.terms), len(law.objects) == 1
    for k in np.flatnonzero(law.support[j] & law.terms.is_factor):
        value, names = (law.coefficients[0, j, k], "") if one else _factor_and_parameters(law, j, int(k))
        number = "" if names and abs(value) == 1 else _number(abs(value))
        label = f"({labels[k]})" if law.terms.terms[k].is_sum else labels[k]
        rest = "" if law.terms.names[k] == "1" else f" {label}"
        summands.append(("$-$" if value < 0 else "$+$", number + names + rest))
    return summands


def _broken(left: str, summands: list[tuple[str, str]]) -> list[str]:
    """Return an equation on a few lines, cut with an ellipsis if it is longer."""
    lines = [left if summands else f"{left} 0"]
    for i, (sign, text) in enumerate(summands):
        part = f" {sign} {text}" if i else f" {sign.replace('$+$', '')}{text}"
        if len(lines[-1]) + len(part) <= 90:
            lines[-1] += part
        elif len(lines) < 2:
            lines.append(part)
        else:
            lines[-1] += " …"
            break
    return lines


def _number(value: float) -> str:
    mantissa, _, exponent = f"{value:.4g}".partition("e")
    return rf"${mantissa} \times 10^{{{int(exponent)}}}$" if exponent else mantissa
