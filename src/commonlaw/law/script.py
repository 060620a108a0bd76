"""How a law was made, as Python that makes it again."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

from commonlaw.law.calls import readable
from commonlaw.trials import Schema

_NOT_SAID = ("n_jobs", "progress", "cache", "client")
"""Arguments that change nothing in a law."""


@dataclass(frozen=True)
class Source:
    """Where a program takes trials from, and which of them it learns from.

    Parameters
    ----------
    table
        Path of a table.
    dataset
        In place of a table, the data set as Python: ``"cl.datasets.load('lorenz')"``.
    properties
        Columns that are properties; those that the table says itself by default.
    training
        The trials that are learned from, as Python, of those ``measured``: ``"measured.until(2.0)"``; all by default.
    reading
        How rows are read, by keywords of `Trials.read`, which take precedence over what the law says; None leaves one
        out.
    stream
        Whether the table is a stream of Parquet files.
    kept
        What of the table is measured, as Python behind what reads it: ``".clip_irregular()"``.
    """

    table: str = "trials.csv"
    dataset: str = ""
    properties: tuple[str, ...] = ()
    training: str = ""
    reading: Mapping[str, Any] = field(default_factory=dict)
    stream: bool = False
    kept: str = ""


def call(function: Callable[..., Any], values: Mapping[str, Any], *first: str) -> str:
    """Return the call of a public function as Python: its first arguments, and those that are not its defaults.

    Parameters
    ----------
    function
        Or class, whose signature has the defaults.
    values
        Of its parameters, by name; others in it are left out.
    *first
        What the call begins with: its name, and arguments as Python.
    """
    name, *arguments = first
    for each in inspect.signature(function).parameters.values():
        value = values.get(each.name, each.default)
        if each.default is not each.empty and each.name not in _NOT_SAID and not _same(value, each.default):
            arguments.append(f"{each.name}={written(value)}")
    return f"{name}({', '.join(arguments)})"


def written(value: Any) -> str:
    """Return a value as Python: of dataclasses of the package the fields that are not their defaults.

    >>> from commonlaw.library import PolynomialLibrary
    >>> written({"library": PolynomialLibrary(3)})
    "{'library': cl.PolynomialLibrary(degree=3)}"
    """
    if is_dataclass(value) and not isinstance(value, type):
        own = {each.name: getattr(value, each.name) for each in fields(value) if each.init and each.compare}
        defaults = {each.name: _default(each) for each in fields(value)}
        said = [f"{name}={written(each)}" for name, each in own.items() if not _same(each, defaults[name])]
        return f"cl.{type(value).__name__}({', '.join(said)})"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{written(key)}: {written(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        inner = ", ".join(map(written, value))
        return f"[{inner}]" if isinstance(value, list) else f"({inner}{',' * (len(value) == 1)})"
    if isinstance(value, np.ndarray) and value.dtype == float and np.isfinite(value).all():
        return repr(value.tolist())
    if isinstance(value, np.ndarray | np.generic):
        return written(value.tolist())
    return f"float({str(value)!r})" if isinstance(value, float) and not np.isfinite(value) else repr(value)


def script(calls: Sequence[str], equations: Sequence[str], schema: Schema, source: Source) -> str:
    """Return a program that reads trials and makes a law by these calls, see `Law.to_script`.

    Without calls, or where they cannot be used, it fits the equations.
    """
    roles: dict[str, Any] = {
        "object": schema.object if source.stream or schema.object != "object" else None,
        "trial": schema.trial if source.stream or schema.trial != "trial" else None,
        "time": schema.time,
        "states": list(schema.measured),
        "inputs": list(schema.inputs) or None,
        "properties": list(source.properties) or None,
        "noise_columns": dict(schema.noise_columns) or None,
        "units": {name: schema.units[name] for name in _columns(schema) if name in schema.units} or None,
        **source.reading,
    }
    if schema.wide:
        roles |= {"object": None, "states": list(schema.wide), "wide": roles.get("wide") or schema.measured[0]}
        roles |= {"noise_columns": None}  # Those of the long table
    said = ", ".join(f"{name}={each!r}" for name, each in roles.items() if each is not None)
    reading = f"from_frame({source.dataset}.to_frame()" if source.dataset else f"read({source.table!r}"
    read = (
        f"cl.TrialStream.from_parquet({source.table!r}, {said})" if source.stream else f"cl.Trials.{reading}, {said})"
    )
    read += source.kept
    learned = [f"measured = {read}", f"trials = {source.training}"] if source.training else [f"trials = {read}"]
    judged = "measured, trials" if source.training else "trials"
    made = readable(calls, f"cl.fit({'; '.join(equations)!r}, trials)")
    last = "law.report(trials).save('report.html')" if source.stream else f"print(law.verdict({judged}))"
    return "\n".join(["import commonlaw as cl", "", *learned, *made, "print(law)", last, ""])


def _columns(schema: Schema) -> tuple[str, ...]:
    return (schema.time, *schema.measured, *schema.inputs)


def _default(field: Any) -> Any:
    return field.default_factory() if field.default_factory is not MISSING else field.default


def _same(one: Any, other: Any) -> bool:
    """Return whether two values are the same; arrays and frames are the same only if they are one."""
    if _is_nothing(one) and _is_nothing(other):
        return True
    try:
        return one is other or bool(one == other)
    except (TypeError, ValueError):
        return False


def _is_nothing(value: Any) -> bool:
    return value is None or (isinstance(value, Mapping | list | tuple) and not value)
