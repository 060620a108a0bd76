"""Checks of arguments, and the short texts that stand for them."""

import inspect
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache, wraps
from math import inf, isfinite, nan
from numbers import Integral, Real
from os import PathLike
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Union, cast, get_args, get_origin

from commonlaw.errors import CommonlawError, check_choice

if TYPE_CHECKING:
    from commonlaw.array_types import Floats


def check_type(name: str, value: object, kinds: type | tuple[type, ...], expected: str) -> None:
    """Refuse an argument of other types than these; the message says what is expected."""
    if not isinstance(value, kinds):
        raise CommonlawError("argument-type", name=name, kind=type(value).__name__, expected=expected)


F = TypeVar("F", bound=Callable[..., Any])


def checks_types(function: F) -> F:
    """Let a function refuse arguments of other types than its signature has, see `check_types`."""
    signature = inspect.signature(function)

    @wraps(function)
    def checked(*arguments: Any, **named: Any) -> Any:
        try:
            given = signature.bind(*arguments, **named).arguments
        except TypeError:  # The call itself says which argument is missing
            return function(*arguments, **named)
        check_types(function, given)
        return function(*arguments, **named)

    return cast(F, checked)


def check_types(function: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Refuse arguments, by name, of other types than the signature of a function or of a class has.

    Annotations of arrays, and those in quotes of what is not imported, allow anything. A class with the attribute
    `stands_for` may be given in place of that class, and refuses by itself what it lacks.
    """
    for parameter in _signature(function).parameters.values():
        name, annotation = parameter.name, parameter.annotation
        if name not in given or annotation is parameter.empty:
            continue
        if isinstance(annotation, str):
            annotation = getattr(function, "__globals__", {}).get(annotation, Any)
        if parameter.kind is parameter.VAR_POSITIONAL:
            for value in given[name]:
                _check_annotated(name, value, annotation)
        elif parameter.kind is parameter.VAR_KEYWORD:
            kinds = get_args(annotation)[0].__annotations__ if get_args(annotation) else {}
            for key, value in given[name].items():
                _check_annotated(key, value, kinds.get(key, Any))
        else:
            _check_annotated(name, given[name], annotation)


_signature = cache(inspect.signature)


def _check_annotated(name: str, value: object, annotation: Any) -> None:
    if _fits(value, annotation):
        return
    parts = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    mappings = [part for part in parts if get_origin(part) is Mapping]
    lists = [part for part in parts if get_origin(part) in (Sequence, Iterable)]
    if mappings and isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        for key, part in value.items():
            _check_annotated(f"{name} of {key}", part, get_args(mappings[0])[1])
    elif lists and isinstance(value, list | tuple):
        for i, part in enumerate(value, 1):
            _check_annotated(f"item {i} of {name}", part, get_args(lists[0])[0])
    else:
        kind = type(value).__name__
        raise CommonlawError("argument-type", name=name, kind=kind, expected=" or ".join(_expected(annotation)))


def _fits(value: Any, annotation: Any) -> bool:
    """Whether a value, and what it holds, is of the type of an annotation."""
    kind, inner = get_origin(annotation) or annotation, get_args(annotation)
    if kind in (Union, UnionType):
        return any(_fits(value, part) for part in inner)
    if kind is Literal:
        return isinstance(value, str)  # A function names its choices itself
    if annotation in (None, NoneType):
        return value is None
    if kind in (Any, object) or not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return True  # An annotation in quotes, a type variable or an array are among these
    if kind is bool:
        return type(value).__name__ in ("bool", "bool_")
    if kind in (int, float):
        return isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)
    if isinstance(value, str | bytes):
        return isinstance(value, kind) and kind not in (Sequence, Iterable)
    if kind is Mapping:
        keys, values = inner
        return isinstance(value, Mapping) and all(
            _fits(key, keys) and _fits(part, values) for key, part in value.items()
        )
    if kind is tuple and inner[-1] is not ...:
        return isinstance(value, tuple | list) and len(value) == len(inner) and all(map(_fits, value, inner))
    if kind in (tuple, Sequence, Iterable):
        if isinstance(value, Mapping) or not isinstance(value, Iterable) or getattr(value, "ndim", 1) != 1:
            return False  # A frame is a sequence of the names of its columns
        return not isinstance(value, Collection) or all(_fits(part, inner[0]) for part in value)
    return isinstance(value, kind) or getattr(type(value), "stands_for", None) is kind


_EXPECTED: Mapping[Any, str] = {
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "a text",
    Mapping: "a mapping by names, such as {'x': 1.0}",
    tuple: "a list",
    Sequence: "a list",
    Iterable: "a list",
    Callable: "a function",
    PathLike: "the name of a file",
}
"""What is asked for in place of a value of another type."""


def _expected(annotation: Any) -> list[str]:
    """Return what an annotation allows, in words."""
    kind, inner = get_origin(annotation) or annotation, get_args(annotation)
    if kind in (Union, UnionType):
        return list(dict.fromkeys(words for part in inner if part is not NoneType for words in _expected(part)))
    if kind is Literal:
        return [*map(repr, inner)]
    if kind is Mapping and inner[1] is str:
        return ["a mapping by names, such as {'x': 'y'}"]
    return [_EXPECTED.get(kind, kind.__name__)]


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
    check_type(kind, text, str, "a text")
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
