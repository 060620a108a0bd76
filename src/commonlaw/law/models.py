"""Models of textbooks by name: ``logistic`` stands for ``x' = r x (1 - x/K)``."""

import dataclasses
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import reduce
from itertools import chain
from pathlib import Path

import msgspec

from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.formulation import law_variables
from commonlaw.law.parse import latex_summands
from commonlaw.law.text import aligned, latex_left_hand_sides
from commonlaw.library import one_order
from commonlaw.library.bounds import is_bound, parts_of
from commonlaw.library.equation import split_equations
from commonlaw.library.grammar import FUNCTION_NAMES
from commonlaw.library.notation import latex_name, quoted
from commonlaw.runtime.files import read_file
from commonlaw.trials import Schema


@dataclass(frozen=True)
class NamedModel:
    """Textbook model that `commonlaw.fit` takes by name in place of equations.

    Parameters
    ----------
    name
        Such as ``logistic``.
    title
        Such as ``Logistic growth``.
    field
        Such as ``Growth``.
    equations
        As `commonlaw.fit` takes them, with bounds, and initial values where these are known.
    variables
        Meaning of each state, input and property in the equations, by name, states first.
    parameters
        Meaning of each parameter, by name.
    source
        Publication.
    inputs, properties, doses
        Variables that are inputs or properties of the objects, and inputs that are amounts given at once.
    initial_doses
        Properties that are amounts given at time zero.
    latent
        States that need no column, as their initial values are known.
    units
        Units of some variables, whose dimensions columns of other units do not have.

    Examples
    --------
    >>> import commonlaw as cl
    >>> cl.named_models["logistic"].over({"x": "weight", "K": "capacity"}).equations
    "weight' = r weight (1 - weight/capacity); r > 0; capacity > 0"
    """

    name: str
    title: str
    field: str
    equations: str
    variables: Mapping[str, str]
    parameters: Mapping[str, str]
    source: str
    inputs: tuple[str, ...] = ()
    properties: tuple[str, ...] = ()
    doses: tuple[str, ...] = ()
    initial_doses: tuple[str, ...] = ()
    latent: tuple[str, ...] = ()
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(name for name in self.variables if name not in (*self.inputs, *self.properties))

    @property
    def without_bounds(self) -> tuple[str, ...]:
        """The equations and initial values, one by one, without the bounds of parameters."""
        return tuple(part for part in parts_of(self.equations) if not is_bound(part))

    def to_latex(self) -> str:
        """Return the equations and initial values as an ``aligned`` block of LaTeX without dollars."""
        delayed = re.compile(r"\w+\(t - \w+\)")
        lagged = delayed.findall(self.equations)
        texts = [delayed.sub(r"`\g<0>`", without_bound) for without_bound in self.without_bounds]
        equations = split_equations([text for text in texts if "'" in text])
        initial = dict(text.split(" = ") for text in texts if "'" not in text)
        schema = Schema(self.states, (*self.inputs, *lagged, *self.properties))
        order = one_order([equation.order for equation in equations])
        variables = law_variables(schema, order)
        rates = [f"{name}'" for name in self.states] if order == 2 else []
        variables = replace(variables, states=(*self.states, *rates))
        rows = latex_summands([equation.text for equation in equations], schema, variables, initial)
        lefts = (*latex_left_hand_sides(self.states, order), *(f"{latex_name(start[:-3])}(0)" for start in initial))
        written = aligned(zip(lefts, rows, strict=True))
        return reduce(lambda text, name: text.replace(latex_name(name), name), lagged, written)

    def over(self, names: Mapping[str, str]) -> "NamedModel":
        """Return the model with other names of variables and parameters.

        Raises `CommonlawError` if a name is not of the model, or two things would have the same name.
        """
        self._check(names)
        known = (*self.variables, *self.parameters)
        new = [names.get(name, name) for name in known]
        if twice := [name for name in new if new.count(name) > 1]:
            raise CommonlawError("named-model-name-twice", model=self.name, name=twice[0])

        def changed(own: Iterable[str]) -> tuple[str, ...]:
            return tuple(names.get(name, name) for name in own)

        return replace(
            self,
            equations=renamed(self.equations, {name: names.get(name, name) for name in known}),
            variables={names.get(name, name): meaning for name, meaning in self.variables.items()},
            parameters={names.get(name, name): meaning for name, meaning in self.parameters.items()},
            inputs=changed(self.inputs),
            properties=changed(self.properties),
            doses=changed(self.doses),
            initial_doses=changed(self.initial_doses),
            latent=changed(self.latent),
            units={names.get(name, name): unit for name, unit in self.units.items()},
        )

    def with_recorded_doses(self) -> "NamedModel":
        """Return the model with doses at any time in place of those at time zero: summands of the equations.

        An initial value ``c(0) = dose/V`` is the summand ``dose/V`` of ``c'``, a rate at which the dose enters; before
        the first dose all states are zero.
        """
        starts = {match["state"]: match["value"] for part in self.without_bounds if (match := _START.fullmatch(part))}
        given = re.compile("|".join(rf"\b{re.escape(name)}\b" for name in self.initial_doses))
        parts = list[str]()
        for part in parts_of(self.equations):
            start = starts.get(part.partition("'")[0], "")
            parts += [] if _START.fullmatch(part) else [f"{part} + {start}" if given.search(start) else part]
        return replace(
            self,
            equations="; ".join(parts),
            inputs=(*self.inputs, *self.initial_doses),
            properties=tuple(name for name in self.properties if name not in self.initial_doses),
            doses=(*self.doses, *self.initial_doses),
            initial_doses=(),
        )

    def over_columns(self, schema: Schema, properties: Sequence[str], names: Mapping[str, str]) -> "NamedModel":
        """Return the model over the columns of trials: those that `names` gives, and those that are clear.

        A variable is the column of its name, in capitals or not, or else the only column that is left in its role.
        Doses that a table records are those of the model, unless `names` gives another column for these.

        Raises `CommonlawError` if it is unclear which column a variable is.
        """
        self._check(names)
        are_recorded = all(names.get(dose) in (None, *schema.administered) for dose in self.initial_doses)
        if schema.administered and self.initial_doses and are_recorded:
            return self.with_recorded_doses().over_columns(schema, properties, names)
        # Also where a property is called dose
        names = {**(dict.fromkeys(self.doses, schema.administered[0]) if schema.administered else {}), **names}
        inputs = (*schema.inputs, *schema.administered[:1])
        roles = ((self.states, schema.states), (self.inputs, inputs), (self.properties, tuple(properties)))
        columns = {name.casefold(): name for name in chain.from_iterable(there for _, there in roles)}
        columns |= {name: name for name in columns.values()}
        for name in self.variables:
            same = columns.get(name, columns.get(name.casefold()))
            if same is not None and same not in names.values():
                names.setdefault(name, same)
        for variables, there in roles:
            missing = [name for name in variables if name not in names and name not in self.latent]
            free = [name for name in there if name not in names.values()]
            if len(missing) == len(free) == 1:
                names[missing[0]] = free[0]
            elif missing:
                example = f"{self.name}:{missing[0]}={free[0] if free else 'COLUMN'}"
                raise CommonlawError(
                    "named-model-columns", model=self.name, missing=missing, columns=free or ["none"], example=example
                )
        return self.over(names)

    def _check(self, names: Iterable[str]) -> None:
        for name in names:
            check_choice(f"variable or parameter of {self.name}", name, (*self.variables, *self.parameters))


_START = re.compile(r"(?P<state>\w+)\(0\) *= *(?P<value>.+)")
"""An initial value among equations, of a named model."""
_NEED_QUOTES = (*FUNCTION_NAMES, "e", "pi", "t", "time")
"""Words that have another meaning in equations."""


def renamed(equations: str, names: Mapping[str, str]) -> str:
    """Return equations with other names, quoted where they need it."""

    def written(match: re.Match[str]) -> str:
        name = names[match[0]]
        return f"`{name}`" if name in _NEED_QUOTES else quoted(name)

    return re.sub("|".join(rf"\b{re.escape(name)}\b" for name in names), written, equations)


class NamedModels(dict[str, NamedModel]):
    """The named models by name, in the order in which they are listed."""

    def __repr__(self) -> str:
        return "\n".join(f"{name}: {'; '.join(model.without_bounds)}" for name, model in self.items())


_tables = tomllib.loads(read_file(Path(__file__).with_name("models.toml")).decode())
named_models = NamedModels(
    {name: msgspec.convert({"name": name, **table}, NamedModel) for name, table in _tables.items()}
)


def model_named(text: str | Sequence[str]) -> tuple[NamedModel, dict[str, str]] | None:
    """Return the model that ``logistic`` or ``logistic:x=weight:K=capacity`` names, and the other names of variables.

    None if the text is of equations. Raises `CommonlawError` for a name that is nearly that of a model, and for what is
    not of the form ``name:variable=column``.
    """
    if not isinstance(text, str):
        return None
    name, *parts = (part.strip() for part in text.split(":"))
    if name not in named_models:
        if re.fullmatch(r"[a-z][a-z-]+", name) and get_close_matches(name, named_models):
            raise unknown("named model", name, named_models)
        return None
    names = dict[str, str]()
    for part in parts:
        variable, sign, column = (piece.strip() for piece in part.partition("="))
        if not (variable and sign and column) or variable in names:
            raise CommonlawError("named-model-syntax", text=text, name=name)
        names[variable] = column
    return named_models[name], names
