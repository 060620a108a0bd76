"""Checks of arguments, and the short texts that stand for them."""

import inspect
from collections.abc import Callable, Mapping
from math import inf, isfinite, nan
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeVar

from commonlaw.errors import CommonlawError, check_choice

if TYPE_CHECKING:
    from commonlaw.array_types import Floats


def check_type(name: str, value: object, kinds: type | tuple[type, ...], expected: str) -> None:
    """Refuse an argument of other types than these; the message says what is expected."""
    if not isinstance(value, kinds):
        raise CommonlawError("argument-type", name=name, kind=type(value).__name__, expected=expected)


def check_mapping(name: str, value: object) -> None:
    """Refuse an argument that is neither a mapping by names nor None."""
    check_type(name, value, (Mapping, type(None)), "a mapping by names, such as {'x': 1.0}")


def numbers_of(name: str, value: Any) -> "Floats":
    """Return an argument as an array of numbers; refused if it is text or anything else."""
    import numpy as np

    try:
        if isinstance(value, str | bytes):
            raise TypeError
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        kind = type(value).__name__
        raise CommonlawError("argument-type", name=name, kind=kind, expected="numbers") from None


def check_whole_number(
    name: str, value: object, least: int, most: int | None = None, *, optional: bool = False
) -> None:
    """Refuse an argument that is no whole number from `least` to `most`, if there is a most.

    None fits where it is `optional`.
    """
    if value is None and optional:
        return
    upper = inf if most is None else most
    if isinstance(value, bool) or not isinstance(value, Integral) or not least <= int(value) <= upper:
        bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise CommonlawError("whole-number", name=name, value=value, bounds=bounds)


def check_number(name: str, value: object, least: float, *, above: bool = False, optional: bool = False) -> None:
    """Refuse an argument that is no finite number of at least `least`, or `above` it; `optional` ones may be None."""
    if value is None and optional:
        return
    size = float(value) if isinstance(value, Real) and not isinstance(value, bool) else nan
    if not isfinite(size) or size < least or (above and size == least):
        raise CommonlawError(
            "finite-number-bounded", name=name, value=value, bound="above" if above else "of at least", least=least
        )


T = TypeVar("T")

_WORDS: Mapping[str, object] = {"True": True, "False": False, "None": None}


def parse_spec(kind: str, text: str, makers: Mapping[str, Callable[..., T]]) -> T:
    """Make what `text` names: ``name``, ``name:argument`` or ``name:argument:option=value``.

    Numbers, True, False and None among the arguments are read as in Python, all else as text. What is named is of a
    kind, such as ``"solver"``, and made by one of the makers.

    Raises `CommonlawError` if the name is not known, or the arguments do not fit or are given twice; the message shows
    those expected.

    Examples
    --------
    >>> parse_spec("number", "complex:3:imag=4", {"complex": complex})
    (3+4j)
    """
    name, *parts = text.split(":")
    check_choice(kind, name, makers)
    positional = [_value(part) for part in parts if "=" not in part]
    named = [part.split("=", 1) for part in parts if "=" in part]
    try:
        if len(dict(named)) < len(named):
            raise TypeError("an argument is given twice")
        return makers[name](*positional, **{key: _value(value) for key, value in named})
    except CommonlawError as error:
        raise error.at(f"{kind} {text!r}") from None
    except (TypeError, ValueError, OverflowError) as error:
        shown = []
        for parameter in inspect.signature(makers[name]).parameters.values():
            required = parameter.default is parameter.empty
            shown.append(parameter.name.upper() if required else f"[{parameter.name.upper()}={parameter.default}]")
        raise CommonlawError("spec-syntax", kind=kind, text=text, usage=repr(":".join([name, *shown]))) from error


def format_spec(name: str, settings: object) -> str:
    """Return the text that `parse_spec` reads back, with every setting, so that it outlives a change of defaults."""
    return ":".join(
        [name, *(str(getattr(settings, parameter)) for parameter in inspect.signature(type(settings)).parameters)]
    )


def _value(text: str) -> Any:
    if text in _WORDS:
        return _WORDS[text]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
