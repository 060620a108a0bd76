"""The calls that a program of a law may hold: a law's file says how it was made, and may come from a stranger.

A recorded call is parsed, never run. What is on the list below is written anew from what was parsed, so that comments,
line ends and look-alikes in the text are lost; all else is left out.
"""

import ast
import inspect
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from pkgutil import resolve_name
from typing import Any

LONGEST = 200_000
"""Characters of a call; the properties of hundreds of objects fit."""
DEEPEST = 12

MADE_OF_TRIALS = {
    "cl.discover": ("commonlaw:discover", ("trials",)),
    "cl.fit": ("commonlaw:fit", (str, "trials")),
    "cl.refine": ("commonlaw:refine", ("law", "trials")),
    "law.discrepancy": ("commonlaw:Law.discrepancy", ("trials",)),
    "law.explain": ("commonlaw:Law.explain", ()),
}
"""What makes laws: where its signature is, and what its first arguments are."""

SETTINGS = ("differentiation", "discovery", "formulation", "library", "solvers")
"""Rooms whose public dataclasses may be arguments."""

LEFT_OUT = "# A recorded step is left out here: it is no call of commonlaw with plain values"


class _NotOnListError(ValueError):
    """What was parsed is nothing that a program may hold."""


def readable(calls: Sequence[str], fallback: str) -> Iterator[str]:
    """Yield the lines of a program that makes a law by calls; what is not on the list is a line that says so.

    Parameters
    ----------
    calls
        As recorded.
    fallback
        A call that makes the law if the first ones are left out, or if there are none.
    """
    known = False
    for text in calls:
        call = rewritten(text)
        if call is None:
            yield LEFT_OUT
            continue
        if not known and call.startswith(("law.", "cl.refine(")):
            yield f"law = {fallback}"
        known = True
        yield f"law = {call}"
    if not known:
        yield f"law = {fallback}"


def rewritten(text: str) -> str | None:
    """Return a recorded call as it may stand in a program, nothing if it may not.

    Examples
    --------
    >>> rewritten("cl.discover(trials,order = 2)  # and"), rewritten("cl.discover(trials); print(1)")
    ('cl.discover(trials, order=2)', None)
    """
    if len(text) > LONGEST:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Of escapes in texts that are no Python of ours
            tree = ast.parse(text, mode="eval").body
        _check_step(tree)
        return ast.unparse(tree)
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError):
        return None


def _check_step(tree: ast.expr) -> None:
    """Refuse all but a call that makes a law."""
    match tree:
        case ast.Attribute(value=ast.Call(func=ast.Attribute(attr="discrepancy")) as call, attr="law"):
            pass
        case ast.Call(func=ast.Attribute(attr=name)) as call if name != "discrepancy":
            pass
        case _:
            raise _NotOnListError
    name = _dotted(call.func)
    if name not in MADE_OF_TRIALS:
        raise _NotOnListError
    function, first = MADE_OF_TRIALS[name]
    for wanted, given in zip(first, call.args[: len(first)], strict=True):
        if not (_is_text(given) if wanted is str else isinstance(given, ast.Name) and given.id == wanted):
            raise _NotOnListError
    others = call.args[len(first) :]
    if name == "law.explain" and any(map(_is_text, [*others, *(each.value for each in call.keywords)])):
        raise _NotOnListError  # The name of a file of properties: none but the user names files
    _check_arguments(resolve_name(function), others, call.keywords, 0)


def _check_arguments(function: Any, values: Sequence[ast.expr], keywords: Sequence[ast.keyword], depth: int) -> None:
    """Refuse keywords that the function does not have, and values that are not plain."""
    names = inspect.signature(function).parameters
    for each in keywords:
        if each.arg not in names:
            raise _NotOnListError
    for value in (*values, *(each.value for each in keywords)):
        _check_value(value, depth + 1)


def _check_value(tree: ast.expr | None, depth: int) -> None:
    """Refuse all but numbers, texts, containers of values, and public settings made of values."""
    if depth > DEEPEST:
        raise _NotOnListError
    values: Sequence[ast.expr | None] = ()
    match tree:
        case ast.Constant(value=None | bool() | int() | float() | str()):
            pass
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float())):
            pass
        case ast.Call(func=ast.Name(id="float"), args=[ast.Constant(value="inf" | "-inf" | "nan")], keywords=[]):
            pass
        case ast.List(elts=inner) | ast.Tuple(elts=inner):
            values = inner
        case ast.Dict(keys=keys, values=inner):
            values = [*keys, *inner]
        case ast.Call(func=ast.Attribute(value=ast.Name(id="cl"), attr=name), args=arguments, keywords=keywords):
            _check_arguments(_setting(name), arguments, keywords, depth)
        case _:
            raise _NotOnListError
    for each in values:
        _check_value(each, depth + 1)


def _setting(name: str) -> Any:
    """Return a public dataclass of the rooms of settings."""
    public = resolve_name("commonlaw")
    found = getattr(public, name) if name in public.__all__ else None
    if not (isinstance(found, type) and is_dataclass(found) and found.__module__.split(".")[1] in SETTINGS):
        raise _NotOnListError
    return found


def _dotted(tree: ast.expr) -> str:
    match tree:
        case ast.Attribute(value=ast.Name(id=base), attr=name):
            return f"{base}.{name}"
    return ""


def _is_text(tree: ast.expr) -> bool:
    return isinstance(tree, ast.Constant) and isinstance(tree.value, str)
