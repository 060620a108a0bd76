"""Short texts for choices, such as ``savgol:35:3``: a name and its arguments, separated by colons."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from commonlaw.errors import CommonlawError, unknown

T = TypeVar("T")

_WORDS: Mapping[str, object] = {"True": True, "False": False, "None": None}


def parse_spec(kind: str, text: str, makers: Mapping[str, Callable[..., T]]) -> T:
    """Make what `text` names: ``name``, ``name:argument`` or ``name:argument:option=value``.

    Numbers, True, False and None among the arguments are read as in Python, all else as text. What is named is of a
    kind, such as ``"solver"``, and made by one of the makers.

    Raises
    ------
    CommonlawError
        If the name is not known, or the arguments do not fit or are given twice; the message shows those expected.

    Examples
    --------
    >>> parse_spec("number", "complex:3:imag=4", {"complex": complex})
    (3+4j)
    """
    name, *parts = text.split(":")
    if name not in makers:
        raise unknown(kind, name, makers)
    positional = [_value(part) for part in parts if "=" not in part]
    named = [part.split("=", 1) for part in parts if "=" in part]
    try:
        if len(dict(named)) < len(named):
            raise TypeError("an argument is given twice")
        return makers[name](*positional, **{key: _value(value) for key, value in named})
    except CommonlawError as error:
        raise error.at(f"{kind} {text!r}") from None
    except (TypeError, ValueError, OverflowError) as error:
        raise CommonlawError("spec-syntax", kind=kind, text=text, usage=_usage(name, makers[name])) from error


def format_spec(name: str, settings: object) -> str:
    """Return the text that `parse_spec` reads back, with every setting, so that it outlives a change of defaults."""
    return ":".join([name, *(str(getattr(settings, each)) for each in inspect.signature(type(settings)).parameters)])


def _value(text: str) -> Any:
    if text in _WORDS:
        return _WORDS[text]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def _usage(name: str, maker: Callable[..., object]) -> str:
    shown = []
    for parameter in inspect.signature(maker).parameters.values():
        required = parameter.default is parameter.empty
        shown.append(parameter.name.upper() if required else f"[{parameter.name.upper()}={parameter.default}]")
    return repr(":".join([name, *shown]))
