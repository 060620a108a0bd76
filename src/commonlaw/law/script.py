"""How a law was made, as Python that makes it again."""

import ast
import inspect
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from pkgutil import resolve_name
from typing import Any, Literal

import numpy as np

from commonlaw.law.law import Law, shares_terms
from commonlaw.runtime.arguments import checks_types

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


_MOVED = {
    "differentiation": "CenteredDifference FiniteDifference ForwardDifference MedianFilter RobustSpline SavitzkyGolay "
    "SmoothedDifference SmoothingSpline SpectralDerivative TotalVariationDerivative WienerFilter",
    "formulation": "DiscreteForm StrongForm WeakForm",
    "library": "AutoLibrary ConstantLibrary ExpressionLibrary FourierLibrary ParametricLibrary PolynomialLibrary "
    "RatioLibrary RationalLibrary",
    "solvers": "BestSubset ConstrainedSolver Lasso SR3 STLSQ StepwiseSelection",
}
_RENAMED = {name: f"{module}.{name}" for module, names in _MOVED.items() for name in names.split()}
_RENAMED |= {"FamilyLibrary": "library.ParametricLibrary"}
"""Classes that calls of version 0.1 recorded by other names, and their names now."""

_RENAMED_ARGUMENTS = {
    "input_between": "input_interpolation",
    "latent": "latent_states",
    "positive": "log_states",
    "starts": "initial_values",
    "starts_at": "initial_time",
    "universal": "shared",
    "unmeasured": "latent_states",
}
_RENAMED_ERRORS = {"correlated": "autocorrelated", "force": "gp-forcing", "walk": "random-walk"}


class _NotOnListError(ValueError):
    """What was parsed is nothing that a program may hold."""


def readable(calls: Sequence[str], fallback: str) -> Iterator[str]:
    """Yield the lines of a program that makes a law by recorded calls, or by a fallback if the first are left out."""
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


def rewritten(text: str, check: Callable[[ast.expr], None] | None = None) -> str | None:
    """Return a recorded call as it may stand in a program, nothing if it may not: by default one that makes a law.

    >>> rewritten("cl.discover(trials,order = 2)  # and"), rewritten("cl.discover(trials); print(1)")
    ('cl.discover(trials, order=2)', None)
    """
    # The properties of hundreds of objects fit
    if len(text) > 200_000:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Of escapes in texts that are no Python of ours
            tree = _PresentNames().visit(ast.parse(text, mode="eval").body)
        (check or _check_step)(tree)
        return ast.unparse(tree)
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError):
        return None


class _PresentNames(ast.NodeTransformer):
    """Replaces the names of earlier versions that saved laws have recorded."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.value, ast.Name) and node.value.id == "cl" and node.attr in _RENAMED:
            return ast.parse(f"cl.{_RENAMED[node.attr]}", mode="eval").body
        return node

    def visit_keyword(self, node: ast.keyword) -> ast.keyword:
        self.generic_visit(node)
        node.arg = node.arg and _RENAMED_ARGUMENTS.get(node.arg, node.arg)
        if node.arg == "errors" and isinstance(node.value, ast.Constant):
            node.value.value = _RENAMED_ERRORS.get(str(node.value.value), node.value.value)
        return node


def _check_step(tree: ast.expr) -> None:
    """Refuse all but a call that makes a law."""
    match tree:
        case ast.Attribute(value=ast.Call(func=ast.Attribute(attr="discrepancy")) as call, attr="law"):
            pass
        case ast.Call(func=ast.Attribute(attr=name)) as call if name != "discrepancy":
            pass
        case _:
            raise _NotOnListError
    name = ast.unparse(call.func)
    if name not in MADE_OF_TRIALS:
        raise _NotOnListError
    function, first = MADE_OF_TRIALS[name]
    for wanted, given in zip(first, call.args[: len(first)], strict=True):
        if not (_is_text(given) if wanted is str else isinstance(given, ast.Name) and given.id == wanted):
            raise _NotOnListError
    others = call.args[len(first) :]
    if name == "law.explain" and any(map(_is_text, [*others, *(keyword.value for keyword in call.keywords)])):
        raise _NotOnListError  # The name of a file of properties: none but the user names files
    _check_arguments(resolve_name(function), others, call.keywords, 0)


def _check_dataset(tree: ast.expr) -> None:
    """Refuse all but a call that simulates a data set, with numbers as options."""
    datasets: Mapping[str, Any] = resolve_name("commonlaw.datasets:DATASETS")
    match tree:
        case ast.Call(func=function, args=[ast.Constant(value=str() as name)], keywords=keywords) if name in datasets:
            options = [keyword.value for keyword in keywords]
        case _:
            raise _NotOnListError
    if ast.unparse(function) != "cl.datasets.load" or any(map(_is_text, options)):
        raise _NotOnListError
    _check_arguments(datasets[name].load, [], keywords, 0)


def _check_arguments(function: Any, values: Sequence[ast.expr], keywords: Sequence[ast.keyword], depth: int) -> None:
    """Refuse keywords that the function does not have, and values that are not plain."""
    names = inspect.signature(function).parameters
    for keyword in keywords:
        if keyword.arg not in names:
            raise _NotOnListError
    for value in (*values, *(keyword.value for keyword in keywords)):
        _check_value(value, depth + 1)


def _check_value(tree: ast.expr | None, depth: int) -> None:
    """Refuse all but numbers, texts, containers of values, and public settings made of values."""
    if depth > 12:
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
        case ast.Call(func=ast.Attribute(value=owner, attr=name), args=arguments, keywords=keywords):
            rooms = {"cl": "commonlaw"} | {f"cl.{room}": f"commonlaw.{room}" for room in SETTINGS}
            public = resolve_name(rooms.get(ast.unparse(owner), "commonlaw"))
            setting = getattr(public, name) if ast.unparse(owner) in rooms and name in public.__all__ else None
            is_setting = isinstance(setting, type) and is_dataclass(setting)
            if not (is_setting and setting.__module__.split(".")[1] in SETTINGS):
                raise _NotOnListError
            _check_arguments(setting, arguments, keywords, depth)
        case _:
            raise _NotOnListError
    for value in values:
        _check_value(value, depth + 1)


def _is_text(tree: ast.expr) -> bool:
    return isinstance(tree, ast.Constant) and isinstance(tree.value, str)


_NOT_SAID = ("n_jobs", "progress", "cache", "client", "time_limit")
"""Arguments that change nothing in a law, but that it may not be found."""


@dataclass(frozen=True)
class Source:
    """Where a program takes trials from, and which of them it learns from.

    Parameters
    ----------
    table
        Path of a table, or of several files.
    dataset
        In place of a table, the data set as Python: ``"cl.datasets.load('lorenz')"``; all else is left out.
    properties
        Columns that are properties; default as the table says.
    training
        The training trials, as Python, of those ``measured``: ``"measured.until(2.0)"``; default all.
    reading
        Keywords of `Trials.read`, in preference to those of the law; None leaves one out.
    stream
        Whether the table is a stream of Parquet files.
    kept
        What of the table is measured, as Python behind what reads it: ``".clip_irregular()"``.
    """

    table: str | Sequence[str] = "trials.csv"
    dataset: str = ""
    properties: tuple[str, ...] = ()
    training: str = ""
    reading: Mapping[str, Any] = field(default_factory=dict)
    stream: bool = False
    kept: str = ""


def call(function: Callable[..., Any], values: Mapping[str, Any], *first: str) -> str:
    """Return the call of a public function as Python: its name, first arguments, and values that are not defaults."""
    name, *arguments = first
    for parameter in inspect.signature(function).parameters.values():
        value = values.get(parameter.name, parameter.default)
        if (
            parameter.default is not parameter.empty
            and parameter.name not in _NOT_SAID
            and not is_same(value, parameter.default)
        ):
            arguments.append(f"{parameter.name}={written(value)}")
    return f"{name}({', '.join(arguments)})"


def recorded_arguments(text: str) -> dict[str, Any]:
    """Return the values of the keywords of a recorded call; none if it may not stand in a program.

    >>> recorded_arguments("cl.discover(trials, order=2, method=cl.TrajectoryLikelihood(seed=3))")["method"].seed
    3
    """
    tree = ast.parse(rewritten(text) or "cl.discover()", mode="eval").body
    return {str(keyword.arg): _value(keyword.value) for keyword in getattr(tree, "keywords", ())}


def _value(tree: ast.expr) -> Any:
    """Return the value of an expression that passed `_check_value`."""
    match tree:
        case ast.Call(func=ast.Name(id="float"), args=[number]):
            return float(ast.literal_eval(number))
        case ast.Call(func=function, args=arguments, keywords=keywords):
            setting = resolve_name(f"commonlaw{ast.unparse(function).removeprefix('cl')}")
            named = {str(keyword.arg): _value(keyword.value) for keyword in keywords}
            return setting(*map(_value, arguments), **named)
        case ast.List(elts=inner):
            return [*map(_value, inner)]
        case ast.Tuple(elts=inner):
            return tuple(map(_value, inner))
        case ast.Dict(keys=keys, values=inner):
            return {_value(key): _value(entry) for key, entry in zip(keys, inner, strict=True) if key is not None}
    return ast.literal_eval(tree)


def written(value: Any) -> str:
    """Return a value as Python: of dataclasses of the package the fields that are not their defaults.

    >>> from commonlaw.library import PolynomialLibrary
    >>> written({"library": PolynomialLibrary(3)})
    "{'library': cl.library.PolynomialLibrary(degree=3)}"
    """
    if is_dataclass(value) and not isinstance(value, type):
        values = {
            attribute.name: getattr(value, attribute.name)
            for attribute in fields(value)
            if attribute.init and attribute.compare
        }
        defaults = {
            attribute.name: attribute.default if attribute.default_factory is MISSING else attribute.default_factory()
            for attribute in fields(value)
        }
        arguments = [f"{name}={written(entry)}" for name, entry in values.items() if not is_same(entry, defaults[name])]
        name, module = type(value).__name__, type(value).__module__.split(".")
        home = f"cl.{module[1]}" if module[1:] and name not in resolve_name("commonlaw").__all__ else "cl"
        return f"{home}.{name}({', '.join(arguments)})"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{written(key)}: {written(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        inner = ", ".join(map(written, value))
        return f"[{inner}]" if isinstance(value, list) else f"({inner}{',' * (len(value) == 1)})"
    if isinstance(value, np.ndarray) and value.dtype == float and np.isfinite(value).all():
        return repr(value.tolist())
    if isinstance(value, np.ndarray | np.generic):
        return written(value.tolist())
    return f"float({str(value)!r})" if isinstance(value, float) and not np.isfinite(value) else repr(value)


@checks_types
def to_script(law: Law, path: str | Source = "trials.csv") -> str:
    """Return a Python script that repeats the analysis of a law from the table of its trials.

    It has only calls of commonlaw with plain values, since a saved law may come from an untrusted source, and a comment
    for every other recorded step; without recorded steps it fits the equations. A `Source` in place of the path states
    which trials were selected.

    Examples
    --------
    >>> import commonlaw as cl
    >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag())
    >>> print(to_script(law, "drops.csv").splitlines()[3])
    law = cl.fit("x'' = -g - c v", trials)
    """
    source = path if isinstance(path, Source) else Source(path)
    schema = law.observation.measured
    equations = law.structure if shares_terms(law) else ()
    columns = (schema.time, *schema.measured, *schema.inputs)
    roles: dict[str, Any] = {
        "object": schema.object if source.stream or schema.object != "object" else None,
        "trial": schema.trial if source.stream or schema.trial != "trial" else None,
        "time": schema.time,
        "states": list(schema.measured),
        "inputs": list(schema.inputs) or None,
        "properties": list(source.properties) or None,
        "noise_columns": dict(schema.noise_columns) or None,
        "units": {name: schema.units[name] for name in columns if name in schema.units} or None,
        **source.reading,
    }
    if schema.wide:
        roles |= {"object": None, "states": list(schema.wide), "wide": roles.get("wide") or schema.measured[0]}
        roles |= {"noise_columns": None}  # Those of the long table
    arguments = ", ".join(f"{name}={role!r}" for name, role in roles.items() if role is not None)
    dataset = rewritten(source.dataset, _check_dataset)
    reading = f"from_frame({dataset}.to_frame()" if dataset else f"read({source.table!r}"
    read = (
        f"cl.TrialStream.from_parquet({source.table!r}, {arguments})"
        if source.stream
        else f"cl.Trials.{reading}, {arguments})"
    )
    read += source.kept
    learned = [f"measured = {read}", f"trials = {source.training}"] if source.training else [f"trials = {read}"]
    judged = "measured, trials" if source.training else "trials"
    steps = readable(law.provenance.calls, f"cl.fit({'; '.join(equations)!r}, trials)")
    made = [_with_initial_time(line, given_initial_time(law)) for line in steps]
    last = "law.report(trials).save('report.html')" if source.stream else f"print(law.assess({judged}))"
    return "\n".join(["import commonlaw as cl", "", *learned, *made, "print(law)", last, ""])


def given_initial_time(law: Law) -> float | Literal["first"] | None:
    """Return the time of the initial values that a law gives, as `commonlaw.fit` takes it; None where it gives none."""
    at, starts = law.observation.initial_time, law.schema.initial_values.values()
    is_given = bool(law.observation.initial) or any(start is not None for start in starts)
    return "first" if at is None and is_given else at


def _with_initial_time(line: str, at: float | Literal["first"] | None) -> str:
    """Return a line of a program with the time of initial values, which fits of earlier versions did not record."""
    if at is None or not line.startswith("law = cl.fit("):
        return line
    is_recorded = any(
        isinstance(part, ast.keyword) and part.arg == "initial_time" for part in ast.walk(ast.parse(line))
    )
    return line if is_recorded else f"{line.removesuffix(')')}, initial_time={at!r})"


def is_same(one: Any, other: Any) -> bool:
    """Return whether two values are the same; arrays and frames are the same only if they are one."""
    if _is_nothing(one) and _is_nothing(other):
        return True
    try:
        return one is other or bool(one == other)
    except (TypeError, ValueError):
        return False


def _is_nothing(value: Any) -> bool:
    return value is None or (isinstance(value, Mapping | list | tuple) and not value)
