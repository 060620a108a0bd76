"""Numbers with their standard errors, as people write them.

The package `uncertainties` writes 1230 ± 680 as (1.23 ± 0.68)e+03, a small negative number as -0.00, and does not part
a number from an error that asks for too many digits. These three rules would stay here, so that it would save nothing.
"""

from math import isfinite

_DIGITS = 2
"""Significant digits of an error."""

_LEAST_PROBABILITY = 1e-9
"""Below it a probability is shown as such: the models that it is computed from are not known so well."""

_MOST = 9
"""Significant digits of a number; where its error would ask for more, the two are written apart."""


_PLAIN = (-4, 6)
"""Decimal places of the first digit, from and below, of numbers that are written without a power of ten."""


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


class Written(str):
    """A number that is written already, to the digits that mean something."""

    __slots__ = ()


def probability_text(value: float) -> str:
    """Return a probability as text.

    >>> probability_text(0.71423), probability_text(4e-130)
    ('0.7142', '< 1e-9')
    """
    return f"{value:.4g}" if not value < _LEAST_PROBABILITY else "< 1e-9"


def rounded(value: float, error: float) -> str:
    """Return a number to the decimal place of the second digit of an error; to four digits if there is none.

    >>> rounded(0.44709, 0.0051), rounded(1.2e-5, 3.4e-7), rounded(12345, 678), rounded(-0.0001, 0.02)
    ('0.4471', '1.200e-05', '12340', '0.000')
    """
    if not (isfinite(error) and error > 0 and isfinite(value)):
        return f"{value:.4g}"
    last, size = _leading_digit(error, _DIGITS) - _DIGITS + 1, _leading_digit(max(abs(value), error), _MOST)
    if size - last >= _MOST:
        return f"{value:.{_MOST}g}"
    if not _PLAIN[0] <= size < _PLAIN[1]:
        return f"{value:.{size - last}e}"
    return f"{round(value, -last):z.{max(-last, 0)}f}"


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
    last, size = _leading_digit(error, _DIGITS) - _DIGITS + 1, _leading_digit(max(abs(value), error), _MOST)
    if size - last >= _MOST:
        return f"{value:.{_MOST}g}", f"{error:.{_DIGITS}g}", 0
    exponent = 0 if _PLAIN[0] <= size < _PLAIN[1] else size
    indices = exponent - last

    def text(number: float) -> str:
        return f"{round(number / 10.0**exponent, indices):z.{max(indices, 0)}f}"

    return text(value), text(error), exponent


def _leading_digit(number: float, digits: int) -> int:
    """Return the decimal place of the first digit of a number that is rounded to so many digits."""
    return int(f"{number:.{digits - 1}e}".partition("e")[2])


def _powers(text: str) -> str:
    mantissa, _, power = text.partition("e")
    return rf"{mantissa} \times 10^{{{int(power)}}}" if power else mantissa
