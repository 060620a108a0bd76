"""Parameters of parameters, named as scikit-learn names them: ``method__solver__threshold``."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

from commonlaw.errors import CommonlawError, unknown


def nested_parameters(name: str, value: object) -> Iterator[tuple[str, object]]:
    """Yield the fields of a value that is a dataclass, and of its fields, by their full names."""
    if is_dataclass(value):
        for field in fields(value):
            full, own = f"{name}__{field.name}", getattr(value, field.name)
            yield full, own
            yield from nested_parameters(full, own)


def with_parameter(name: str, value: Any, path: str, new: object) -> Any:
    """Return a value with one of its fields changed.

    Parameters
    ----------
    name, value
        The parameter, a dataclass.
    path
        Which field: ``"rule"``, ``"solver__threshold"``.
    new
        What it becomes.

    Raises
    ------
    CommonlawError
        If there is no such field.
    """
    if not is_dataclass(value) or isinstance(value, type):
        raise CommonlawError(f"{name} is {value!r} and has no parameter {path!r}: set {name} first")
    first, _, rest = path.partition("__")
    known = [field.name for field in fields(value) if field.init]
    if first not in known:
        raise unknown(f"parameter of {name}", first, known)
    own = with_parameter(f"{name}__{first}", getattr(value, first), rest, new) if rest else new
    return replace(value, **{first: own})
