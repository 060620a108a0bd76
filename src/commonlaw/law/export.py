"""Laws as programs of other languages: C, Python, MATLAB, Modelica, SBML, and workbooks that integrate them."""

import keyword
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from html import escape
from io import BytesIO
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.law.law import Law, only_object
from commonlaw.law.parameters import followed_coefficients, named_parameters
from commonlaw.law.parse import event_equations, event_expressions, meanings_of
from commonlaw.library import highest_columns, with_rates
from commonlaw.library.grammar import FUNCTIONS, SHORT_NAMES, Algebra, evaluate
from commonlaw.runtime.files import read_file
from commonlaw.runtime.packages import optional_import
from commonlaw.text import in_line

if TYPE_CHECKING:
    from openpyxl.worksheet.worksheet import Worksheet

_RESERVED = re.compile(
    "auto|break|case|char|const|default|do|double|enum|extern|float|goto|int|long|register|return|"
    "short|signed|sizeof|static|struct|switch|typedef|union|unsigned|void|volatile|inline|restrict|"
    "algorithm|block|class|connector|constant|discrete|each|encapsulated|end|equation|expandable|"
    "external|final|flow|function|initial|inner|input|model|operator|outer|output|package|parameter|"
    "partial|protected|public|pure|record|redeclare|replaceable|stream|then|type|when|within|"
    "otherwise|persistent|global|spmd|t|k|h|der|time|math|abs|states|inputs|parameters|objects|"
    "equations|event|pre|reinit|elsewhen"
)
"""Words that have a meaning in one of the languages or in the programs that are written."""


@dataclass(frozen=True, eq=False)
class _System:
    """A law as a system of first order in plain names: states with rates, inputs, parameters.

    `values` has the parameters of each object, shape (objects, parameters), `initial` a state, shape (states + rates,).
    """

    law: Law
    objects: tuple[str, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    values: Floats
    initial: Floats

    @property
    def has_events(self) -> bool:
        """Whether states take new values at events."""
        return bool(self.law.observation.events)

    def events(
        self, algebra: Algebra, states: Sequence[str], inputs: Sequence[str], time: str, parameters: Sequence[str]
    ) -> list[tuple[str, dict[int, str]]]:
        """Return what is positive where the condition of each event is true, and the new values of states, by index."""
        law, values = self.law, dict(zip(named_parameters(self.law).names, parameters, strict=True))
        variables = law.terms.variables
        meanings = meanings_of(law.schema, law.order, variables, are_clear=True)
        given = event_equations(self.law.observation.events, meanings)
        columns = [*states, *inputs, time, *(values[name] for name in variables.parameters)]
        return [
            (
                evaluate(decided, columns, algebra),
                {j: evaluate(new, columns, algebra) for j, new in enumerate(after) if new != f"v{j}"},
            )
            for decided, after in event_expressions(given, variables, meanings)
        ]

    def rates(
        self, algebra: Algebra, states: Sequence[str], inputs: Sequence[str], time: str, parameters: Sequence[str]
    ) -> list[str]:
        """Return the derivatives of all states in a language, over texts for variables and parameters."""
        law, known = self.law, named_parameters(self.law)
        values = dict(zip(known.names, parameters, strict=True))
        inner = [values[name] for name in law.terms.variables.parameters]
        columns, count = [*states, *inputs, time, *inner], len(law.schema.states)
        products = {(product.equation, product.term): product for product in known.products}
        times, over = algebra.operations["multiply"], algebra.operations["divide"]
        rates = [*states]
        for i, j in enumerate(with_rates(law.order, count).tolist()):
            rates[j] = states[count + i]
        for j, column in enumerate(highest_columns(law.order, count).tolist()):
            summands = []
            for k in np.flatnonzero(law.support[j] & law.terms.is_factor).tolist():
                product = products.get((j, k))
                number = float(law.coefficients[0, j, k]) if product is None else product.factor
                text = algebra.number(number)
                for name, power in () if product is None else product.coefficients:
                    for _ in range(abs(power)):
                        text = (times if power > 0 else over)(text, values[name])
                term = evaluate(law.terms.terms[k].code, columns, algebra)
                summands.append(text if law.terms.names[k] == "1" else times(text, term))
            rates[column] = reduce(algebra.operations["add"], summands) if summands else algebra.number(0.0)
        return rates


def _system(law: Law, name: str | None, initial: ArrayLike | None) -> _System:
    """Return a law in plain names, of one object or of all."""
    delayed = [signal for signal in law.schema.inputs if "(" in signal]
    for problem, is_present in (
        ("discrete time", law.order == 0),
        ("doses", bool(law.schema.doses)),
        ("dead times", bool(delayed)),
    ):
        if is_present:
            raise CommonlawError("export-unsupported", problem=problem)
    objects = law.objects if name is None else (only_object(law, name),)
    coefficients = np.stack([followed_coefficients(law, owner) for owner in objects])
    known, variables = named_parameters(law), law.terms.variables
    names = _plain_names([*variables.states, *variables.inputs, *known.names])
    count, end = len(variables.states), len(variables.states) + len(variables.inputs)
    values = np.stack(
        [definition.of(coefficients) for definition in known.definitions] or [np.empty(len(objects))], axis=1
    )
    visited = law.provenance.domain.visited
    middle = [np.mean(visited[state]) if state in visited else 1.0 for state in variables.states]
    start = np.asarray(middle if initial is None else initial, dtype=np.float64)
    if start.shape != (count,) or not np.isfinite(start).all():
        raise CommonlawError("export-initial", names=variables.states)
    values = values[:, : len(known.names)]
    return _System(law, objects, names[:count], names[count:end], names[end:], values, start)


def _plain_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return different identifiers that are valid in all languages, capitals aside.

    >>> _plain_names(["x", "dry weight", "dry_weight", "3"])
    ('x', 'dry_weight', 'dry_weight_', 'n_3')
    """
    result = list[str]()
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name.replace("'", "_rate"))
        plain = plain if re.match(r"[A-Za-z]", plain) else f"n_{plain.lstrip('_')}"
        taken = (*map(str.lower, (*keyword.kwlist, *result)),)
        while _RESERVED.fullmatch(plain.lower()) or plain.lower() in taken:
            plain += "_"
        result.append(plain)
    return tuple(result)


def _number(value: float) -> str:
    return repr(float(value)) if value >= 0 else f"({float(value)!r})"


_SHORT = {name: short for short, name in SHORT_NAMES.items()}


def _infix(functions: Mapping[str, str], missing: Sequence[str] = (), **others: Callable[..., str]) -> Algebra:
    """Return a language with infix operators: names of its functions where they differ, missing ones, other forms."""
    names = {name: functions.get(name, _SHORT.get(name, name)) for name in FUNCTIONS if name not in missing}
    operations: dict[str, Callable[..., str]] = {
        name: lambda *operands, word=word: f"{word}({', '.join(operands)})" for name, word in names.items()
    }
    operations |= {
        "add": lambda x, y: f"({x} + {y})",
        "subtract": lambda x, y: f"({x} - {y})",
        "multiply": lambda x, y: f"{x}*{y}",
        "divide": lambda x, y: f"({x}/({y}))",
        "power": lambda x, y: f"(({x})^({y}))",
        "negate": lambda x: f"(-({x}))",
        "step": lambda x: f"({x} > 0)",
    }
    return Algebra(_number, {**operations, **others})


_C = _infix({"abs": "fabs"}, power=lambda x, y: f"pow({x}, {y})", sign=lambda x: f"(({x} > 0) - ({x} < 0))")
_PYTHON = _infix(
    {name: f"math.{_SHORT.get(name, name)}" for name in FUNCTIONS if name != "abs"},
    power=lambda x, y: f"(({x})**({y}))",
    sign=lambda x: f"math.copysign(float({x} != 0), {x})",
)
_MATLAB = _infix({})
_MODELICA = _infix(
    {},
    ("arcsinh", "arccosh", "arctanh", "erf", "erfc"),
    step=lambda x: f"(if {x} > 0 then 1.0 else 0.0)",
    log2=lambda x: f"(log({x})/log(2.0))",
)
_EXCEL = _infix(
    {name: _SHORT.get(name, name).upper() for name in FUNCTIONS} | {"log": "LN", "floor": "INT"},
    step=lambda x: f"IF({x}>0,1,0)",
    log2=lambda x: f"LOG({x},2)",
    ceil=lambda x: f"(-INT(-({x})))",
    arctan2=lambda y, x: f"ATAN2({x},{y})",
)


def _applied(operator: str) -> Callable[..., str]:
    return lambda *operands: f"<apply><{operator}/>{''.join(operands)}</apply>"


def _mathml_number(value: float) -> str:
    digits, _, power = repr(float(value)).partition("e")
    return f'<cn type="e-notation">{digits}<sep/>{int(power)}</cn>' if power else f"<cn>{digits}</cn>"


def _piecewise(*pieces: tuple[float, str], otherwise: float) -> Callable[[str], str]:
    def write(x: str) -> str:
        inner = "".join(
            f"<piece>{_mathml_number(value)}<apply><{relation}/>{x}<cn>0.0</cn></apply></piece>"
            for value, relation in pieces
        )
        return f"<piecewise>{inner}<otherwise>{_mathml_number(otherwise)}</otherwise></piecewise>"

    return write


_MATHML = Algebra(
    _mathml_number,
    {name: _applied(name) for name in FUNCTIONS if name not in ("erf", "erfc", "arctan2")}
    | {
        "power": _applied("power"),
        "add": _applied("plus"),
        "subtract": _applied("minus"),
        "multiply": _applied("times"),
        "divide": _applied("divide"),
        "negate": _applied("minus"),
        "sqrt": _applied("root"),
        "log": _applied("ln"),
        "log10": _applied("log"),
        "log2": lambda x: _applied("log")(f"<logbase>{_mathml_number(2.0)}</logbase>", x),
        "ceil": _applied("ceiling"),
        "sign": _piecewise((1.0, "gt"), (-1.0, "lt"), otherwise=0.0),
        "step": _piecewise((1.0, "gt"), otherwise=0.0),
    },
)


def _comment(law: Law) -> list[str]:
    """Return the law in lines without what could end a comment, or continue it in the next line."""
    return [re.sub(r"\\|\?\?", "_", in_line(line).replace("*/", "* /")) for line in law.structure]


def _quoted(name: str) -> str:
    """Return a name between double quotes in ASCII, as C, Python and Modelica read it.

    It has no question marks, of which C makes a backslash in ``??/``.
    """
    return '"' + re.sub(r"[^ !#->@-\[\]-~]", "_", name) + '"'


def _filled(template: str, **parts: str | int | Sequence[str]) -> list[str]:
    """Return the lines of a template; a line that is the name of a list, ``$rates``, stands for its lines."""
    lines, texts = list[str](), {name: part for name, part in parts.items() if isinstance(part, str | int)}
    path = Path(__file__).parent / "templates" / f"{template}.template"
    for line in read_file(path).decode().splitlines():
        part = parts.get(line.removeprefix("$")) if line.startswith("$") else None
        lines += [Template(line).substitute(texts)] if part is None or isinstance(part, str | int) else part
    return lines


def _indexed(form: str, first: int, *groups: Sequence[str]) -> list[list[str]]:
    """Return elements of the arrays x, u and p in place of names."""
    kinds = zip("xup", groups, strict=True)
    return [[form.format(kind, i) for i in range(first, first + len(names))] for kind, names in kinds]


def _c(system: _System, _: str) -> bytes:
    groups = system.states, system.inputs, system.parameters
    x, u, p = _indexed("{}[{}]", 0, *groups)
    named = (
        ", ".join(f"{place} is {name}" for place, name in zip(places, names, strict=True)) or f"no {kind}"
        for kind, places, names in zip("xup", (x, u, p), groups, strict=True)
    )
    rows = [", ".join(_number(number) for number in row) or "0.0" for row in system.values]
    events, changes = system.events(_C, x, u, "t", p), list[str]()
    for k, (_, new) in enumerate(events):
        changes += [f"    if (event == {k}) {{", *(f"        y[{i}] = {value};" for i, value in new.items()), "    }"]
    conditions = [f"    on[{k}] = {decided} > 0;" for k, (decided, _) in enumerate(events)]
    lines = _filled(
        "law.c",
        comment=[f"// {line}" for line in _comment(system.law)],
        names="; ".join(named),
        states=len(x),
        inputs=len(u),
        parameters=len(p),
        objects=len(rows),
        titles=", ".join(map(_quoted, system.objects)),
        width=max(len(p), 1),
        values=", ".join(f"{{{row}}}" for row in rows),
        rates=[f"    dx[{i}] = {rate};" for i, rate in enumerate(system.rates(_C, x, u, "t", p))],
        step="static void step" if events else "void advance",
        events=_filled("events.c", count=len(events), conditions=conditions, changes=changes) if events else [],
    )
    return _joined(lines)


def _python(system: _System, _: str) -> bytes:
    groups = (system.states, "states"), (system.inputs, "inputs")
    unpacked = [f"    {', '.join(names)}, = {group}" for names, group in groups if names]
    unpacked += [f"    {name} = parameters[{name!r}]" for name in system.parameters]
    events = system.events(_PYTHON, system.states, system.inputs, "t", system.parameters)
    changed = (", ".join(new.get(j, name) for j, name in enumerate(system.states)) for _, new in events)
    pairs = zip(system.objects, system.values.tolist(), strict=True)
    lines = _filled(
        "law.py",
        comment=[re.sub(r'[\\"]', "_", line) for line in _comment(system.law)],
        imports=["import numpy as np"] if events else [],
        states=str([*system.states]),
        inputs=str([*system.inputs]),
        parameters=[f"    {name!r}: {dict(zip(system.parameters, row, strict=True))}," for name, row in pairs],
        unpacked=unpacked,
        rates=", ".join(system.rates(_PYTHON, system.states, system.inputs, "t", system.parameters)),
        initial=str(system.initial.tolist()),
        name=repr(system.objects[0]),
        simulation=_filled("simulation_with_events.py" if events else "simulation.py"),
        events=_filled(
            "events.py",
            unpacked=unpacked,
            conditions=", ".join(decided for decided, _ in events),
            changes=[f"        [{values}]," for values in changed],
        )
        if events
        else [],
    )
    return _joined(lines)


def _matlab(system: _System, stem: str) -> bytes:
    function = _plain_names([stem])[0]
    x, u, p = _indexed("{}({})", 1, system.states, system.inputs, system.parameters)
    events, changes = system.events(_MATLAB, x, u, "t", p), list[str]()
    for k, (_, new) in enumerate(events, 1):
        changes += [f"        case {k}", *(f"            y({i + 1}) = {value};" for i, value in new.items())]
    lines = _filled(
        "law.m",
        function=function,
        title=function.upper(),
        comment=[f"%   {line}" for line in _comment(system.law)],
        states=", ".join(system.states),
        inputs=", ".join(system.inputs) or "none",
        parameters=", ".join(system.parameters) or "none",
        titles=", ".join("'" + _quoted(name)[1:-1].replace("'", "''") + "'" for name in system.objects),
        values="; ".join(" ".join(_number(number) for number in row) for row in system.values),
        initial=" ".join(map(_number, system.initial)),
        count=max(len(u), 1),
        simulation=_filled("simulation_with_events.m" if events else "simulation.m"),
        width=len(x),
        rates=[f"    dx({i}) = {rate};" for i, rate in enumerate(system.rates(_MATLAB, x, u, "t", p), 1)],
        events=_filled("events.m", conditions="; ".join(decided for decided, _ in events), changes=changes)
        if events
        else [],
    )
    return _joined(lines)


def _modelica(system: _System, stem: str) -> bytes:
    package, *models = _plain_names([stem, "Equations", *system.objects])
    rates = system.rates(_MODELICA, system.states, system.inputs, "time", system.parameters)
    conditions, changed = (
        system.events(_MODELICA, states, system.inputs, "time", system.parameters)
        for states in (system.states, [f"pre({name})" for name in system.states])
    )
    # One clause, as in several of them a state could not take new values
    clauses = ["    end when;"] if conditions else []
    for k, ((condition, _), (_, new)) in reversed([*enumerate(zip(conditions, changed, strict=True))]):
        reset = (f"      reinit({system.states[j]}, {value});" for j, value in new.items())
        clauses = [f"    {'elsewhen' if k else 'when'} {condition} > 0 then", *reset, *clauses]
    lines = [
        f"package {package}",
        *(f"  // {line}" for line in _comment(system.law)),
        f"  partial model {models[0]}",
        *(f"    parameter Real {name};" for name in system.parameters),
        *(f"    input Real {name};" for name in system.inputs),
        *(
            f"    Real {name}(start = {_number(value)}, fixed = true);"
            for name, value in zip(system.states, system.initial, strict=True)
        ),
        "  equation",
        *(f"    der({name}) = {rate};" for name, rate in zip(system.states, rates, strict=True)),
        *clauses,
        f"  end {models[0]};",
        "",
    ]
    for name, title, row in zip(models[1:], system.objects, system.values, strict=True):
        given = ", ".join(
            f"{parameter} = {_number(number)}" for parameter, number in zip(system.parameters, row, strict=True)
        )
        lines += [f"  model {name} {_quoted(title)}", f"    extends {models[0]}{f'({given})' if given else ''};"]
        lines += [f"  end {name};"]
    return _joined([*lines, f"end {package};"])


def _sbml(system: _System, stem: str) -> bytes:
    if len(system.objects) > 1:
        raise CommonlawError("several-objects", objects=system.objects, first=system.objects[0])
    symbols = {name: f"<ci>{name}</ci>" for name in (*system.states, *system.inputs, *system.parameters)}
    time = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time">t</csymbol>'
    states, inputs, parameters = (
        [symbols[name] for name in names] for names in (system.states, system.inputs, system.parameters)
    )
    rates = system.rates(_MATHML, states, inputs, time, parameters)
    fixed = dict(zip(system.parameters, system.values[0].tolist(), strict=True))
    varying = dict(zip(system.states, system.initial.tolist(), strict=True)) | dict.fromkeys(system.inputs, 0.0)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<sbml xmlns="http://www.sbml.org/sbml/level3/version2/core" level="3" version="2">',
        f'  <model id="{_plain_names([stem])[0]}" name="{escape(in_line(system.objects[0]))}">',
        "    <listOfParameters>",
        *(f'      <parameter id="{name}" value="{value!r}" constant="true"/>' for name, value in fixed.items()),
        *(f'      <parameter id="{name}" value="{value!r}" constant="false"/>' for name, value in varying.items()),
        "    </listOfParameters>",
        "    <listOfRules>",
    ]
    for name, rate in zip(system.states, rates, strict=True):
        lines += [f'      <rateRule variable="{name}">', f"        {_math(rate)}", "      </rateRule>"]
    lines.append("    </listOfRules>")
    events = system.events(_MATHML, states, inputs, time, parameters)
    lines += ["    <listOfEvents>"] if events else []
    for decided, new in events:
        lines += [
            '      <event useValuesFromTriggerTime="true">',
            '        <trigger initialValue="true" persistent="true">',
            f"          {_math(_applied('gt')(decided, _mathml_number(0.0)))}",
            "        </trigger>",
            "        <listOfEventAssignments>",
            *(
                f'          <eventAssignment variable="{system.states[j]}">{_math(value)}</eventAssignment>'
                for j, value in new.items()
            ),
            "        </listOfEventAssignments>",
            "      </event>",
        ]
    return _joined([*lines, *(["    </listOfEvents>"] if events else []), "  </model>", "</sbml>"])


def _math(content: str) -> str:
    return f'<math xmlns="http://www.w3.org/1998/Math/MathML">{content}</math>'


def _workbook(system: _System, _: str) -> bytes:
    """Return a workbook: parameters of all objects and a choice among them, and the Runge-Kutta method in formulas."""
    if system.has_events:
        raise CommonlawError("export-events-to-workbook")
    openpyxl = optional_import("openpyxl", "writing workbooks", "excel")
    from openpyxl.utils import get_column_letter as letter

    book = openpyxl.Workbook()
    sheet, table = book.active, book.create_sheet("Parameters")
    sheet.title, first, last = "Simulation", 5, 4 + len(system.objects)
    for at, text in (("A1", "object"), ("B1", system.objects[0]), ("A2", "step"), ("A4", "object")):
        _put(table, at, text)
    steps = 200
    table["B2"] = (system.law.provenance.domain.horizon or 10.0) / steps
    for i, name in enumerate(system.objects):
        _put(table, f"A{first + i}", name)
        # Formulas need numbers: those of parameters that have only a limit stand for any beyond it
        limits = [limit for limit in system.law.uncertainty.limits if limit.object == name]
        if limits:
            text = ", ".join(f"{limit.parameter} {limit.text}" for limit in limits)
            _put(table, f"{letter(len(system.parameters) + 2)}{first + i}", text)
    for k, name in enumerate(system.parameters):
        column = letter(k + 2)
        _put(table, f"{column}4", name)
        for i, value in enumerate(system.values[:, k].tolist()):
            table[f"{column}{first + i}"] = value
        table[f"{column}3"] = f"=INDEX({column}{first}:{column}{last},MATCH($B$1,$A${first}:$A${last},0))"
    _put(table, "A3", "chosen")
    parameters = [f"Parameters!${letter(k + 2)}$3" for k in range(len(system.parameters))]
    states, inputs = len(system.states), len(system.inputs)
    heads = ["t", *system.states, *system.inputs]
    heads += [f"k{stage} {name}" for stage in range(1, 5) for name in system.states]
    for k, head in enumerate(heads):
        _put(sheet, f"{letter(k + 1)}1", head)
    for row in range(2, steps + 3):
        x = [f"{letter(2 + j)}{row}" for j in range(states)]
        u, later = ([f"{letter(2 + states + i)}{at}" for i in range(inputs)] for at in (row, row + 1))
        slopes = [
            [f"{letter(2 + states + inputs + stage * states + j)}{row}" for j in range(states)] for stage in range(4)
        ]
        h = "Parameters!$B$2"
        sheet[f"A{row}"] = 0.0 if row == 2 else f"=A{row - 1}+{h}"
        for cell in u:
            sheet[cell] = 0.0
        for j, cell in enumerate(x):
            stages = [f"{letter(2 + states + inputs + stage * states + j)}{row - 1}" for stage in range(4)]
            sum_ = f"({stages[0]}+2*{stages[1]}+2*{stages[2]}+{stages[3]})/6"
            sheet[cell] = float(system.initial[j]) if row == 2 else f"={letter(2 + j)}{row - 1}+{h}*{sum_}"
        if row > steps + 1:
            break
        middle = [f"({here}+{there})/2" for here, there in zip(u, later, strict=True)]
        for stage, (part, given) in enumerate(((0.0, u), (0.5, middle), (0.5, middle), (1.0, later))):
            point = x if stage == 0 else [f"({here}+{part}*{h}*{slopes[stage - 1][j]})" for j, here in enumerate(x)]
            rates = system.rates(_EXCEL, point, given, f"(A{row}+{part}*{h})", parameters)
            for j, rate in enumerate(rates):
                sheet[slopes[stage][j]] = f"={rate}"
    content = BytesIO()
    book.save(content)
    return content.getvalue()


def _put(sheet: "Worksheet", at: str, text: str) -> None:
    """Write a text that is no formula, whatever it begins with."""
    sheet[at] = re.sub(r"[\x00-\x1f]", "_", text)
    sheet[at].data_type = "s"


def _joined(lines: Sequence[str]) -> bytes:
    return "\n".join([*lines, ""]).encode()


WRITERS: Mapping[str, Callable[[_System, str], bytes]] = {
    ".c": _c,
    ".py": _python,
    ".m": _matlab,
    ".mo": _modelica,
    ".xml": _sbml,
    ".sbml": _sbml,
    ".xlsx": _workbook,
}
"""What writes a law, by the ending of the file."""


def exported(law: Law, path: str | os.PathLike[str], name: str | None = None, initial: Any = None) -> bytes:
    """Return the content of a file that a law is exported to, see `Law.save`."""
    file = Path(path)
    if file.suffix.lower() not in WRITERS:
        raise CommonlawError("export-format", path=str(path), endings=[".json", ".parquet", *WRITERS])
    return WRITERS[file.suffix.lower()](_system(law, name, initial), file.stem)
