"""Functions of Python inside terms, with derivatives by complex steps or central differences."""

import inspect
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.library.grammar import FUNCTION_NAMES, SWITCHES

_RESERVED = re.compile(r"v\d+|e|pi")
"""Names with another meaning in expressions and equations."""


@dataclass(frozen=True)
class Function:
    """A function of arrays that terms call by its name, and the names of its arguments: ``drag(v, x)``.

    It computes an array of shape (n,) from arrays of shape (n,), or numbers.

    Examples
    --------
    >>> def drag(v, x):
    ...     return v * np.abs(v) * np.exp(-x)
    >>> Function.of(drag).text
    'drag(v, x)'
    """

    name: str
    arguments: tuple[str, ...]
    compute: Callable[..., Any] = field(repr=False)

    @classmethod
    def of(cls, function: Callable[..., Any]) -> "Function":
        """Return a function by its own name, a lambda as f, with the arguments of its signature.

        Raises `CommonlawError` if its name has another meaning in terms, or its arguments have no names.
        """
        name = getattr(function, "__name__", "")
        name = "f" if name == "<lambda>" else name
        if not name.isidentifier() or name in (*FUNCTION_NAMES, *SWITCHES) or _RESERVED.fullmatch(name):
            raise CommonlawError("function-name", name=name or repr(function))
        try:
            parameters = inspect.signature(function).parameters.values()
        except (TypeError, ValueError):
            parameters = dict[str, inspect.Parameter]().values()
        wanted = [parameter for parameter in parameters if parameter.default is parameter.empty]
        if not wanted or any(parameter.kind is not parameter.POSITIONAL_OR_KEYWORD for parameter in wanted):
            raise CommonlawError("function-arguments", name=name)
        return cls(name, tuple(parameter.name for parameter in wanted), function)

    @property
    def text(self) -> str:
        """It with its arguments, as a term is written."""
        return f"{self.name}({', '.join(self.arguments)})"

    def __call__(self, *values: Any, out: Floats | None = None) -> Floats:
        """Return its values at arrays of shape (n,), or numbers; raises `CommonlawError` if it fails there."""
        shape = np.broadcast_shapes(*map(np.shape, values))
        try:
            with np.errstate(all="ignore"):
                result = np.broadcast_to(np.asarray(self.compute(*values), dtype=np.float64), shape)
        except Exception as error:
            raise CommonlawError("function-failed", function=self.text, error=str(error)) from error
        if out is None:
            return np.array(result)
        out[:] = result
        return out

    def slopes(self, *values: Any) -> list[Floats]:
        """Return the derivative by each argument, shape (n,).

        It is the central difference of fourth order, ``(4 d(h) - d(2 h))/3``, ``d(h) = (f(x + h) - f(x - h))/(2 h)``,
        of the largest step for which d(h) and d(2 h) agree; where none does, at a kink or jump, the one-sided
        difference of smaller size. Where f is analytic the complex step ``Im f(x + i h)/h`` (Squire and Trapp 1998)
        agrees with that, and takes its place: it is exact to rounding.
        """
        arrays = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in values))
        return [self._slope(arrays, i) for i in range(len(arrays))]

    def _slope(self, values: Sequence[Floats], index: int) -> Floats:
        x, precision = values[index], float(np.finfo(np.float64).eps)

        def at(moved: Any) -> tuple[Any, ...]:
            return (*values[:index], moved, *values[index + 1 :])

        size = np.broadcast_to(np.abs(x).max(initial=0.0) or 1.0, x.shape)
        result, tolerance, is_open = np.full(x.shape, np.nan), np.zeros(x.shape), np.ones(x.shape, dtype=np.bool_)
        with np.errstate(all="ignore"):
            scales = size * np.geomspace(1.0, precision**0.4, 5)[:, np.newaxis]
            # The last step is for points close to the end of a domain, such as 0
            for scale in (*scales, np.where(x == 0, scales[-1], np.minimum(np.abs(x), scales[-1]))):
                h = precision**0.2 * scale  # Truncation is then as large as rounding
                low, down, now, up, high = (self(*at(x + k * h)) for k in (-2, -1, 0, 1, 2))
                near, far = (up - down) / (2 * h), (high - low) / (4 * h)
                rounding = 10 * precision * np.max(np.abs([low, down, now, up, high]), axis=0) / h
                # Second differences of h and 2 h differ at a kink in the middle, where near and far do not
                bend = (4 * (up - 2 * now + down) - (high - 2 * now + low)) / h
                gap = np.maximum(np.abs(near - far), np.abs(bend))
                # The error of fourth order is about the square of the difference
                agree = is_open & (gap <= 1e-4 * np.maximum(np.abs(near), np.abs(far)) + 10 * rounding)
                result[agree], tolerance[agree] = ((4 * near - far) / 3)[agree], (abs(near - far) / 2 + rounding)[agree]
                is_open &= ~agree
                if not is_open.any():
                    break
            else:
                before, after = (now - down) / h, (up - now) / h
                result = np.where(is_open, np.where(abs(before) <= abs(after), before, after), result)
            try:
                moved = np.asarray(self.compute(*at(x + 1j * 1e-20 * size)))
            except Exception:  # It is no function of complex numbers
                return result
            exact = moved.imag / (1e-20 * size) if moved.shape == x.shape else result
            return np.where(np.abs(exact - result) <= tolerance, exact, result)


def functions_in(given: Iterable[Callable[..., Any] | Function]) -> tuple[Function, ...]:
    """Return functions of Python as functions in terms, each once.

    Raises `CommonlawError` if two have one name.
    """
    result = tuple(
        dict.fromkeys(function if isinstance(function, Function) else Function.of(function) for function in given)
    )
    names = [function.name for function in result]
    for name in names:
        if names.count(name) > 1:
            raise CommonlawError("function-name-twice", name=name)
    return result
