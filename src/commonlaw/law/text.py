"""Laws as people write them."""

from collections.abc import Sequence
from string import ascii_lowercase
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.law.numbers import latex_with_error, with_error
from commonlaw.library.naming import latex_name

if TYPE_CHECKING:
    from commonlaw.law.law import Law


def equation(left: str, coefficients: Floats, errors: Floats, names: Sequence[str], digits: int) -> str:
    """Return ``left = sum of coefficients times names``, terms with coefficient zero left out.

    >>> equation("x''", np.array([-9.34, 0.0, 0.0466]), np.zeros(3), ["1", "x", "v"], 4)
    "x'' = -9.34 + 0.0466 v"
    >>> equation("x''", np.array([-9.34, 0.0, 0.0466]), np.array([0.12, np.nan, 0.0051]), ["1", "x", "v"], 4)
    "x'' = -9.34 ± 0.12 + (0.0466 ± 0.0051) v"
    """
    parts: list[tuple[bool, str]] = []
    for c, error, name in zip(coefficients, errors, names, strict=True):
        if c:
            number = with_error(abs(c), error, digits, bracket=bool(parts) or name != "1")
            parts.append((c < 0, number if name == "1" else f"{number} {name}"))
    return f"{left} = {_joined(parts)}"


def latex(law: "Law", coefficients: Floats, errors: Floats, digits: int) -> str:
    """Return equations, coefficients and errors of shape (equations, terms), as an ``aligned`` block."""
    names = law.terms.variables.names
    forms = [term.latex(names) for term in law.terms.terms]
    lines = []
    for left, row, doubts in zip(latex_left_sides(law), coefficients, errors, strict=True):
        parts: list[tuple[bool, str]] = []
        for c, error, form in zip(row, doubts, forms, strict=True):
            if c:
                number = latex_with_error(abs(c), error, digits, bracket=bool(parts) or form != "1")
                parts.append((c < 0, number if form == "1" else rf"{number}\, {form}"))
        lines.append(f"{left} &= {_joined(parts)}")
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def latex_left_sides(law: "Law") -> tuple[str, ...]:
    """Return what each equation gives, as LaTeX."""
    form = ("{}_{{k+1}}", r"\dot{{{}}}", r"\ddot{{{}}}")[law.order]
    return tuple(form.format(latex_name(state)) for state in law.states)


def law_text(law: "Law") -> str:
    """Return the law as `print` shows it: its structure, then each object's coefficients."""
    lines: list[str] = []
    if len(law.objects) == 1:
        lines += law.equations()
    elif law.shared:
        lines += [*structure(law), "", _table(law)]
    else:
        for name in law.objects:
            lines += [f"{name}:", *(f"  {each}" for each in law.equations(name))]
    if law.rates:
        lines += ["", "with " + ", ".join(f"{r} = {s}'" for r, s in zip(law.rates, law.states, strict=True))]
    lines += [f"Note: {outcome}" for outcome in law.outcomes]
    return "\n".join(lines)


def structure(law: "Law") -> tuple[str, ...]:
    """Return the form of each equation, with letters for the coefficients: ``x'' = a + b v``."""
    parts: list[list[str]] = [[] for _ in law.states]
    for letter, (j, k) in zip(letters(law), np.argwhere(law.support), strict=True):
        name = law.terms.names[k]
        parts[j].append(letter if name == "1" else f"{letter} {name}")
    return tuple(f"{left} = {' + '.join(each) or '0'}" for left, each in zip(law.left_hand_sides, parts, strict=True))


def letters(law: "Law") -> tuple[str, ...]:
    """Return a letter for each coefficient of the law that is not the name of a variable: a, b, ..., a1, b1, ..."""
    free = [letter for letter in ascii_lowercase if letter not in law.terms.variables.names]
    return tuple(
        free[i % len(free)] + (str(i // len(free)) if i >= len(free) else "") for i in range(int(law.support.sum()))
    )


def _table(law: "Law") -> str:
    """Return each object's coefficients under their letters."""
    head = letters(law)
    errors = np.nan_to_num(law.standard_errors[:, law.support])
    pairs = zip(law.coefficients[:, law.support], errors, strict=True)
    cells = [[with_error(*pair) for pair in zip(*each, strict=True)] for each in pairs]
    widths = [max(map(len, column)) for column in zip(head, *cells, strict=True)]
    first = max(map(len, law.objects))
    rows = zip(["", *law.objects], [head, *cells], strict=True)
    return "\n".join(
        "  ".join([f"{name:<{first}}", *(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True))]).rstrip()
        for name, row in rows
    )


def _joined(parts: Sequence[tuple[bool, str]]) -> str:
    if not parts:
        return "0"
    first, *others = parts
    return ("-" if first[0] else "") + first[1] + "".join(f" {'-' if neg else '+'} {text}" for neg, text in others)
