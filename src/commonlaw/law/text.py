"""Numbers with their standard errors, and equations, as text and as LaTeX."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from math import isfinite
from string import ascii_lowercase
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library import Order, order_of_each
from commonlaw.library.notation import latex_name, shown_name
from commonlaw.library.term import Fraction
from commonlaw.text import counted, in_line


def with_error(value: float, error: float, digits: int = 4, bracket: bool = False) -> str:
    """Return ``value ± error``: the error to two significant digits, the value to the same decimal place.

    A number that is known, whose error is zero, stands alone, to so many digits. Brackets go around a pair that is to
    be multiplied with something; a common power of ten always is.

    >>> with_error(-9.4412, 0.1234), with_error(0.48, 0.02, bracket=True), with_error(-9.8, 0)
    ('-9.44 ± 0.12', '(0.480 ± 0.020)', '-9.8')
    >>> with_error(1.2e-5, 3.4e-7), with_error(0.012, 0.34), with_error(12345, 678)
    ('(1.200 ± 0.034)e-05', '0.01 ± 0.34', '12340 ± 680')
    """
    number, uncertainty, exponent = _rounded(value, error, digits)
    pair = f"{number} ± {uncertainty}" if uncertainty else number
    power = f"e{exponent:+03d}" if exponent else ""
    return f"({pair}){power}" if uncertainty and (bracket or power) else pair + power


def one_sided_text(low: float, high: float) -> str:
    """Return what stands in place of an estimate with its error if its 95 % interval has one end; else nothing.

    >>> one_sided_text(3.21, np.inf), one_sided_text(-np.inf, 0.5), one_sided_text(1.0, 2.0)
    ('> 3.21 (95 %)', '< 0.5 (95 %)', '')
    """
    if isfinite(low) == isfinite(high):
        return ""
    return f"> {low:.3g} (95 %)" if isfinite(low) else f"< {high:.3g} (95 %)"


def assigned(name: str, value: str) -> str:
    """Return a name with its value, or with its only limit.

    >>> assigned("k", "9.81"), assigned("k", one_sided_text(3.21, np.inf))
    ('k = 9.81', 'k > 3.21 (95 %)')
    """
    return f"{name} {value}" if value.startswith((">", "<")) else f"{name} = {value}"


class Written(str):
    """A number that is written already, to the digits that mean something."""

    __slots__ = ()


def probability_text(value: float) -> str:
    """Return a probability as text.

    >>> probability_text(0.71423), probability_text(4e-130)
    ('0.7142', '< 1e-9')
    """
    # Models that a probability is computed from are not known better
    return f"{value:.4g}" if not value < 1e-9 else "< 1e-9"


def rounded(value: float, error: float) -> str:
    """Return a number to the decimal place of the second digit of an error; to four digits if there is none.

    >>> rounded(0.44709, 0.0051), rounded(1.2e-5, 3.4e-7), rounded(12345, 678), rounded(-0.0001, 0.02)
    ('0.4471', '1.200e-05', '12340', '0.000')
    """
    if not (isfinite(error) and error > 0 and isfinite(value)):
        return f"{value:.4g}"
    if (places := _places(value, error)) is None:
        return f"{value:.9g}"
    last, exponent = places
    return f"{value:.{exponent - last}e}" if exponent else f"{round(value, -last):z.{max(-last, 0)}f}"


def latex_with_error(value: float, error: float, digits: int = 4, bracket: bool = False) -> str:
    r"""Return the same as LaTeX.

    >>> print(latex_with_error(1.2e-5, 3.4e-7), latex_with_error(9.44, 0.12), latex_with_error(2e7, 0))
    \left(1.200 \pm 0.034\right) \times 10^{-5} 9.44 \pm 0.12 2 \times 10^{7}
    """
    number, uncertainty, exponent = _rounded(value, error, digits)
    pair = rf"{_powers(number)} \pm {_powers(uncertainty)}" if uncertainty else number
    power = rf" \times 10^{{{exponent}}}" if exponent else ""
    return rf"\left({pair}\right){power}" if uncertainty and (bracket or power) else pair + power


def _rounded(value: float, error: float, digits: int) -> tuple[str, str, int]:
    """Return a number, its error (nothing for a known number) and the power of ten that both are multiplied with."""
    if error == 0:
        mantissa, _, power = f"{value:.{digits}g}".partition("e")
        return mantissa, "", int(power or 0)
    if (places := _places(value, error)) is None:
        return f"{value:.9g}", f"{error:.2g}", 0
    last, exponent = places
    indices = exponent - last

    def text(number: float) -> str:
        return f"{round(number / 10.0**exponent, indices):z.{max(indices, 0)}f}"

    return text(value), text(error), exponent


def _places(value: float, error: float) -> tuple[int, int] | None:
    """Return the decimal place of an error's second digit, and the power of ten that is written apart, zero for none.

    None where the number would have more than nine digits.
    """
    last, size = _leading_digit(error, 2) - 1, _leading_digit(max(abs(value), error), 9)
    return None if size - last >= 9 else (last, 0 if -4 <= size < 6 else size)


def _leading_digit(number: float, digits: int) -> int:
    """Return the decimal place of the first digit of a number that is rounded to so many digits."""
    return int(f"{number:.{digits - 1}e}".partition("e")[2])


def _powers(text: str) -> str:
    mantissa, _, power = text.partition("e")
    return rf"{mantissa} \times 10^{{{int(power)}}}" if power else mantissa


MANY = 50
"""Objects; of more a table with a row for each is no help to a reader."""

_TAKEN = ("e", "t")
"""Letters that mean something else in equations."""


class Addend(NamedTuple):
    """A term with its coefficient: whether it is subtracted, the coefficient's size as text, the term's name."""

    negative: bool
    number: str
    name: str


def aligned(rows: Iterable[tuple[str, Iterable[Addend]]], limits: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return equations, left-hand sides and addends in LaTeX, and limits by name, as an ``aligned`` block."""
    times = r"\, "
    lines = [f"{left_side} &= {summed(addends, times)}" for left_side, addends in rows]
    lines += [f"{name} &{limit}" for name, limit in limits.items()]
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def left_hand_sides(states: Sequence[str], order: Order) -> tuple[str, ...]:
    """Return what each equation gives: ``x'``, ``x''``, or ``x[k+1]`` in discrete time."""
    orders = order_of_each(order, len(states))
    names = map(shown_name, states)
    return tuple(name + ("'" * primes or "[k+1]") for name, primes in zip(names, orders, strict=True))


def latex_left_hand_sides(states: Sequence[str], order: Order) -> tuple[str, ...]:
    """Return what each equation gives, as LaTeX."""
    forms = ("{}_{{k+1}}", r"\dot{{{}}}", r"\ddot{{{}}}")
    orders = order_of_each(order, len(states))
    return tuple(forms[dots].format(latex_name(state)) for state, dots in zip(states, orders, strict=True))


def latex_observed(names: Iterable[str]) -> tuple[str, ...]:
    """Return left-hand sides of observation equations, initial values and events as LaTeX, see `Observation.written`.

    >>> latex_observed(["x(0)", "t > 5: v"])
    ('x(0)', '\\\\mathrm{t\\\\ >\\\\ 5}:\\\\ v')
    """
    lefts = []
    for condition, colon, name in (label.rpartition(": ") for label in names):
        latex = latex_name(name.removesuffix("(0)")) + "(0)" * name.endswith("(0)")
        lefts.append(rf"{latex_name(condition)}:\ {latex}" if colon else latex)
    return tuple(lefts)


def order_in_words(order: Order, states: Sequence[str]) -> str:
    """Return the order of a law, or that of each state.

    >>> order_in_words(2, ["x", "y"]), order_in_words((2, 1), ["x", "y"])
    ('2', 'x 2, y 1')
    """
    if not isinstance(order, tuple):
        return str(order)
    return ", ".join(f"{state} {number}" for state, number in zip(states, order, strict=True))


def written_equations(lefts: Iterable[str], rows: Iterable[Iterable[Addend]]) -> tuple[str, ...]:
    """Return equations with these summands.

    >>> written_equations(["x'"], [[Addend(True, "9.81", "1"), Addend(False, "a", "v")]])
    ("x' = -9.81 + a v",)
    """
    return tuple(f"{left_side} = {summed(row, ' ')}" for left_side, row in zip(lefts, rows, strict=True))


def free_parameter_names(count: int, variables: Sequence[str]) -> tuple[str, ...]:
    """Return so many names of parameters that are not those of variables: a, b, ..., a1, b1, ...

    >>> free_parameter_names(3, ["b", "v"])
    ('a', 'c', 'd')
    """
    free = [name for name in ascii_lowercase if name not in (*variables, *_TAKEN)]
    return tuple(free[i % len(free)] + (str(i // len(free)) if i >= len(free) else "") for i in range(count))


def with_units(names: Iterable[str], units: Iterable[str | None]) -> list[str]:
    """Return names with their units, where there are any.

    >>> with_units(["a", "b", "c"], ["m/s²", "", None])
    ['a [m/s²]', 'b', 'c']
    """
    return [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]


def estimate_cells(values: Floats, errors: Floats) -> list[list[str]]:
    """Return estimates with their standard errors, each of shape (objects, parameters), as text; of many the first."""
    pairs = zip(values[:MANY].tolist(), np.nan_to_num(errors[:MANY]).tolist(), strict=True)
    return [[with_error(*pair) for pair in zip(*both, strict=True)] for both in pairs]


def coefficient_table(objects: Sequence[str], head: Sequence[str], cells: Sequence[Sequence[str]]) -> list[str]:
    """Return lines of objects' coefficients under their names, as they are written; of very many the first."""
    few, left_out = objects[:MANY], len(objects) - MANY
    widths = [max(map(len, column)) for column in zip(head, *cells, strict=True)]
    names = ["", *map(in_line, few)]
    first = max(map(len, names))
    rows = zip(names, [head, *cells], strict=True)
    lines = [
        "  ".join([f"{name:<{first}}", *(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True))]).rstrip()
        for name, row in rows
    ]
    return [*lines, *([f"and {counted(left_out, 'more object')}"] if left_out > 0 else [])]


def summed(addends: Iterable[Addend], times: str) -> str:
    """Return the sum of these: their signs, numbers and names; fractions of one denominator are one fraction."""
    text = ""
    for addend in _together(list(addends), times):
        text += (" - " if addend.negative else " + ") if text else ("-" if addend.negative else "")
        if addend.name == "1" or not addend.number:
            text += addend.number or addend.name
        elif isinstance(addend.name, Fraction):
            text += addend.name.behind(addend.number, times)
        elif addend.name.startswith("1/"):
            text += addend.number + addend.name.removeprefix("1")
        else:
            text += f"{addend.number}{times}{addend.name}"
    return text or "0"


def _together(addends: Sequence[Addend], times: str) -> Iterator[Addend]:
    """Yield addends, those one after the other that have the same denominator as one."""
    for _, group in groupby(enumerate(addends), key=lambda numbered: getattr(numbered[1].name, "below", numbered[0])):
        together = [addend for _, addend in group]
        fractions = [addend.name for addend in together if isinstance(addend.name, Fraction)]
        if len(fractions) > 1:
            above = (addend._replace(name=name.above) for addend, name in zip(together, fractions, strict=True))
            together = [Addend(False, "", fractions[0].over(summed(above, times)))]
        yield from together


def addends_of(
    coefficients: Floats,
    errors: Floats,
    names: Sequence[str],
    digits: int,
    numbered: Sequence[bool],
    write: Callable[..., str] = with_error,
    limited: Mapping[int, str] = MappingProxyType({}),
) -> Iterator[Addend]:
    """Yield coefficients that are not zero, with a function that writes a number and its error, and their names.

    Before names that have numbers of their own (`numbered`) a known coefficient of one is left out. Coefficients that
    have only a limit, by index, are written by their own names.

    >>> errors = np.array([0.12, np.nan, 0.0051])
    >>> summed(addends_of(np.array([-9.34, 0.0, 0.0466]), errors, ["1", "x", "v"], 4, [False] * 3), " ")
    '-9.34 ± 0.12 + (0.0466 ± 0.0051) v'
    """
    first = True
    for k, (c, error, name, alone) in enumerate(zip(coefficients, errors, names, numbered, strict=True)):
        if k in limited:
            yield Addend(False, limited[k], name)
            first = False
        elif c:
            one = alone and abs(c) == 1 and error == 0
            yield Addend(c < 0, "" if one else write(abs(c), error, digits, bracket=not first or name != "1"), name)
            first = False
