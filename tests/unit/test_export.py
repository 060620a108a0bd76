"""Laws in other languages: what was written is compiled, run or interpreted, and compared with `Law.simulate`."""

import ctypes
import math
import os
import re
import shlex
import subprocess
import xml.etree.ElementTree as ET

import numpy as np
import openpyxl
import pytest
from openpyxl.utils import range_boundaries
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.estimation.beginning import begin
from commonlaw.estimation.fitting import fit_model
from commonlaw.estimation.model import ModelText
from commonlaw.law.export import _plain_names
from commonlaw.library import grammar
from tests.refusals import refused

TIMES = np.linspace(0.0, 2.0, 11)

LAWS = {
    "two objects": ("x'' = -g - c v", {"g": 9.8, "c": {"Ball 1": 0.2, '=Ball " 2*/': 0.5}}, [20.0, 1.0]),
    "ratio": ("s' = -V s/(K + s); b' = m s b/(K + s) - 0.1 b", {"V": 1.0, "K": 0.7, "m": 0.4}, [3.0, 0.2]),
    "functions": (
        "x' = a exp(-x) + b cos(2 t) - c abs(x)^1.5 sign(x) + log(1 + x^2) - d sqrt(abs(x)) tanh(x)"
        "; y' = -y^2 + f x + 0.1 asin(x/9) acos(x/9) + 0.1 cot(1 + t/9) log10(2 + x^2) - 0.1 log2(3 + x) sech(t)",
        {"a": 0.5, "b": 0.3, "c": 0.2, "d": 0.1, "f": -0.3},
        [0.5, 1.0],
    ),
    "mixed orders": (
        "q'' = -a sin(q) - b q' + k i; i' = -r i + 0.2 q",
        {"a": 4.0, "b": 0.1, "k": 2.0, "r": 0.5},
        [0.5, 1.0, 0.1],
    ),
    "names": ("`dry weight`' = r `dry weight` (1 - `dry weight`/end)", {"r": 0.8, "end": 2.0}, [0.1]),
}
"""Equations, parameters and initial states."""


EVENTS = {
    "ball": ("x'' = -9.8 - c v; x < 0: x = 0, v = -r v", {"c": 0.2, "r": 0.8}, [1.5, 0.3], 1.9),
    "dose": ("y' = -k y; t > tau: y = y/2 + d", {"k": 0.45, "tau": 4.3, "d": 3.0}, [2.0], 9.0),
    "relay": (
        "T' = -k (T - 5) + 9 u; u' = 0 u; u(0) = 1; T < low: u = 1; T > high: u = 0",
        {"k": 0.3, "low": 18.0, "high": 22.0},
        [10.0, 1.0],
        20.0,
    ),
}
"""Equations with events, parameters, initial states and how long these are followed."""


@pytest.fixture(params=LAWS)
def case(request):
    """Return a law, initial states, and the states of each object by `Law.simulate`."""
    text, values, initial = LAWS[request.param]
    law = cl.Law.from_text(text, values)
    return law, initial, {name: each.states for name, each in law.simulate(TIMES, initial).items()}


@pytest.fixture(scope="module", params=EVENTS)
def occurring(request):
    """Return a law with events whose parameters are all but known, initial states, times, and states."""
    text, values, initial, last = EVENTS[request.param]
    times, few = np.linspace(0, last, 41), np.linspace(0, last, 5)
    priors = {name: (value, 1e-7 * value) for name, value in values.items()}
    measured = cl.Trials.from_arrays(few, 1 + few / last, names=[text[0]])
    begun = begin(ModelText.of(text), measured, {}, guesses=values, priors=priors, noise={text[0]: 100.0})
    law = fit_model(begun, 0, lambda _: None, draws=1).law(())
    (path,) = law.simulate(times, initial).values()
    assert np.isfinite(path.states).all()
    assert np.abs(np.diff(path.states[:, -1])).max() > 0.9
    return law, initial, times, path.states


def integrated(rates, initial):
    """Return the states of derivatives, a function of time and states."""
    return solve_ivp(rates, (0.0, TIMES[-1]), initial, "LSODA", TIMES, rtol=1e-9, atol=1e-11).y.T


def as_python(text, power="^"):
    return text.replace(power, "**").rstrip(";")


FUNCTIONS = {
    name: getattr(math, name)
    for name in ("exp", "sin", "cos", "tan", "tanh", "sqrt", "atan", "sinh", "cosh", "asin", "acos", "log10", "log2")
} | {"abs": abs, "sign": lambda x: int(x > 0) - int(x < 0), "log": lambda x, base=math.e: math.log(x) / math.log(base)}


def compiled(law, folder):
    """Return the library of a law in C."""
    law.save(folder / "law.c")
    flags = ["-O1", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC", "-lm"]
    compiler = shlex.split(os.environ.get("CC", "cc"))
    subprocess.run([*compiler, folder / "law.c", "-o", folder / "law.so", *flags], check=True)
    return ctypes.CDLL(str(folder / "law.so"))


def advanced(library, times, initial, parameters, *on):
    """Return the states at times by the function of a library that advances them, in a hundred steps between them."""
    state, h = (ctypes.c_double * len(initial))(*initial), times[1] / 100
    if on:
        library.conditions(ctypes.c_double(times[0]), state, None, parameters, *on)
    found = [list(state)]
    for at in times[:-1]:
        for n in range(100):
            assert (
                library.advance(ctypes.c_double(at + n * h), ctypes.c_double(h), state, None, parameters, *on) or not on
            )
        found.append(list(state))
    return found


def test_c_is_compiled_and_run(case, tmp_path):
    law, initial, expected = case
    library = compiled(law, tmp_path)
    width = int(re.search(r"OBJECTS\]\[(\d+)\]", (tmp_path / "law.c").read_text())[1])
    table = (ctypes.c_double * width * len(law.objects)).in_dll(library, "parameters")
    for name, parameters in zip(law.objects, table, strict=True):
        found = advanced(library, TIMES, initial, parameters)
        np.testing.assert_allclose(found, expected[name], rtol=1e-6, atol=1e-7)


def test_functions_have_their_forms_in_programs_or_are_refused(tmp_path):
    """C and Python have all functions; workbooks round by INT, and have the arguments of ATAN2 the other way round."""
    inner = {"arccosh": "2 + x^2", "arctan2": "0.5, x - 3"}
    parts = [f"{name}({inner.get(name, 'x/9')})" for name in grammar.FUNCTIONS]
    law = cl.Law.from_text(f"x' = 0.02 x*({' + '.join(parts)})", {})
    expected = law.simulate(TIMES, [1.0])["object"].states
    found = advanced(compiled(law, tmp_path), TIMES, [1.0], None)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    np.testing.assert_allclose(simulated_in_python(law, tmp_path, TIMES, [1.0]), expected, rtol=1e-5)
    law = cl.Law.from_text("x' = floor(x) + ceil(x) + arctan2(0.5, x) + erfc(x) + asinh(x) + log2(x)", {})
    law.save(tmp_path / "law.xlsx", initial=[1.0])
    formula = str(openpyxl.load_workbook(tmp_path / "law.xlsx")["Simulation"]["C2"].value)
    for part in ("INT(B2)", "(-INT(-(B2)))", "ATAN2(B2,0.5)", "ERFC(B2)", "ASINH(B2)", "LOG(B2,2)"):
        assert part in formula
    for ending in ("xml", "mo"):
        with refused(Diagnostic("function-unavailable", {"function": "erf"})):
            cl.Law.from_text("x' = -k erf(x)", {"k": 1.0}).save(tmp_path / f"law.{ending}")


def simulated_in_python(law, folder, *arguments, **inputs):
    law.save(folder / "law.py")
    space = {}
    exec((folder / "law.py").read_text(), space)
    return space["simulate"](*arguments, **inputs)


def test_python_is_run(case, tmp_path):
    law, initial, expected = case
    for name in law.objects:
        found = simulated_in_python(law, tmp_path, TIMES, initial, name)
        np.testing.assert_allclose(found, expected[name], rtol=1e-5, atol=1e-6)


def test_matlab_has_the_equations(case, tmp_path):
    law, initial, expected = case
    law.save(tmp_path / "law.m")
    text = (tmp_path / "law.m").read_text()
    assert text.startswith("function [t, x] = law(times")
    rows = re.search(r"parameters = \[(.*)\];", text)[1].split("; ")
    lines = [as_python(each) for each in re.findall(r"dx\(\d+\) = (.*);", text)]
    lines = [re.sub(r"\b([xp])\((\d+)\)", lambda m: f"{m[1]}[{int(m[2]) - 1}]", line) for line in lines]
    for name, row in zip(law.objects, rows, strict=True):
        p = [float(each.strip("()")) for each in row.split()]

        def rates(t, x, p=p):
            return [eval(line, {**FUNCTIONS, "t": t, "x": x, "p": p}) for line in lines]

        np.testing.assert_allclose(integrated(rates, initial), expected[name], rtol=1e-5, atol=1e-6)


def test_modelica_has_the_equations(case, tmp_path):
    law, initial, expected = case
    law.save(tmp_path / "law.mo", initial=initial)
    text = (tmp_path / "law.mo").read_text()
    states = re.findall(r"Real (\w+)\(start = ([^,]*), fixed", text)
    assert [float(value.strip("()")) for _, value in states] == initial
    lines = [as_python(each) for each in re.findall(r"der\(\w+\) = (.*);", text)]
    given = re.findall(r"extends Equations_\((.*)\);", text)
    for name, row in zip(law.objects, given, strict=True):
        known = {key: float(value.strip("()")) for key, value in (each.split(" = ") for each in row.split(", "))}

        def rates(t, x, known=known):
            names = dict(zip([each for each, _ in states], x, strict=True))
            return [eval(line, {**FUNCTIONS, **known, **names, "time": t}) for line in lines]

        np.testing.assert_allclose(integrated(rates, initial), expected[name], rtol=1e-5, atol=1e-6)


SBML = "{http://www.sbml.org/sbml/level3/version2/core}"
MATHML = "{http://www.w3.org/1998/Math/MathML}"
OPERATIONS = {
    "plus": lambda *x: math.fsum(x),
    "minus": lambda *x: -x[0] if len(x) == 1 else x[0] - x[1],
    "times": lambda *x: math.prod(x),
    "divide": lambda x, y: x / y,
    "power": lambda x, y: x**y,
    "root": math.sqrt,
    "ln": math.log,
    "log": lambda *x: math.log10(x[0]) if len(x) == 1 else math.log(x[1], x[0]),
    "arcsin": math.asin,
    "arccos": math.acos,
    "gt": lambda x, y: x > y,
    "lt": lambda x, y: x < y,
    **{name: function for name, function in FUNCTIONS.items() if name != "log"},
}


def mathml(node, values):
    """Return the value of MathML, as SBML has it."""
    kind, inner = node.tag.removeprefix(MATHML), list(node)
    if kind == "cn":
        return float(f"{node.text}e{inner[0].tail}") if node.get("type") == "e-notation" else float(node.text)
    if kind in ("ci", "csymbol"):
        return values["time" if kind == "csymbol" else node.text]
    if kind == "piecewise":
        for piece in inner:
            parts = list(piece)
            if len(parts) == 1 or mathml(parts[1], values):
                return mathml(parts[0], values)
    if kind == "logbase":
        return mathml(inner[0], values)
    operator, *operands = inner
    return OPERATIONS[operator.tag.removeprefix(MATHML)](*(mathml(operand, values) for operand in operands))


def test_sbml_is_interpreted(case, tmp_path):
    law, initial, expected = case
    for name in law.objects:
        law.save(tmp_path / "law.xml", name, initial)
        root = ET.parse(tmp_path / "law.xml").getroot()
        assert root.tag == f"{SBML}sbml"
        assert (root.get("level"), root.get("version")) == ("3", "2")
        known = {each.get("id"): each for each in root.iter(f"{SBML}parameter")}
        rules = {each.get("variable"): each[0][0] for each in root.iter(f"{SBML}rateRule")}
        assert {key for key, each in known.items() if each.get("constant") == "false"} == {*rules}
        values = {key: float(each.get("value")) for key, each in known.items()}

        def rates(t, x, values=values, rules=rules):
            here = {**values, **dict(zip(rules, x, strict=True)), "time": t}
            return [mathml(rule, here) for rule in rules.values()]

        start = [values[rule] for rule in rules]
        assert start == initial
        np.testing.assert_allclose(integrated(rates, start), expected[name], rtol=1e-5, atol=1e-6)


def computed(book):
    """Return what computes a cell of a workbook by its formula: sheet and place."""
    known = {}

    def value(sheet, at):
        key = sheet, at.replace("$", "")
        if key not in known:
            content = book[sheet][key[1]].value
            is_formula = isinstance(content, str) and book[sheet][key[1]].data_type == "f"
            known[key] = evaluated(sheet, content[1:]) if is_formula else content
        return known[key]

    def evaluated(sheet, formula):
        if found := re.fullmatch(r"INDEX\((\S+),MATCH\((\S+),(\S+),0\)\)", formula):
            _, top, _, bottom = range_boundaries(found[3])
            cells = [value(sheet, f"A{row}") for row in range(top, bottom + 1)]
            row = range_boundaries(found[1])[1] + cells.index(value(sheet, found[2]))
            return value(sheet, f"{re.match('[A-Z]+', found[1])[0]}{row}")
        reference = r"(?:(Parameters)!)?(\$?[A-Z]+\$?\d+)\b(?!\()"
        code = re.sub(reference, lambda found: f"value({(found[1] or sheet)!r}, {found[2]!r})", formula)
        functions = {name.upper(): each for name, each in FUNCTIONS.items()} | {"LN": math.log}
        return eval(code.replace("^", "**"), {**functions, "value": value})

    return value


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("case", ["two objects", "functions"], indirect=True)
def test_workbooks_integrate(case, tmp_path):
    law, initial, _ = case
    law.save(tmp_path / "law.xlsx", initial=initial)
    book = openpyxl.load_workbook(tmp_path / "law.xlsx")
    step = book["Parameters"]["B2"].value
    times = step * np.arange(5)
    expected = law.simulate(times, initial)
    for name in law.objects:
        book["Parameters"]["B1"] = name
        book["Parameters"]["B1"].data_type = "s"
        value = computed(book)
        rows = [[value("Simulation", f"{'ABCDEFG'[j]}{row}") for j in range(len(initial) + 1)] for row in range(2, 7)]
        np.testing.assert_allclose([row[0] for row in rows], times)
        np.testing.assert_allclose([row[1:] for row in rows], expected[name].states, rtol=1e-4, atol=1e-5)


def test_c_with_events_is_compiled_and_run(occurring, tmp_path):
    law, initial, times, expected = occurring
    library = compiled(law, tmp_path)
    table = (ctypes.c_double * len(law.terms.variables.parameters) * 2).in_dll(library, "parameters")
    found = advanced(library, times, initial, table, (ctypes.c_int * 2)())
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


def test_python_with_events_is_run(occurring, tmp_path):
    law, initial, times, expected = occurring
    np.testing.assert_allclose(simulated_in_python(law, tmp_path, times, initial), expected, rtol=1e-5, atol=1e-5)


def test_sbml_with_events_is_interpreted(occurring, tmp_path):
    """A trigger that becomes true makes all assignments at once, here at the end of a short step."""
    law, initial, times, expected = occurring
    law.save(tmp_path / "law.xml", initial=initial)
    root = ET.parse(tmp_path / "law.xml").getroot()
    assert [each.tag.removeprefix(SBML) for each in root[0]] == ["listOfParameters", "listOfRules", "listOfEvents"]
    values = {each.get("id"): float(each.get("value")) for each in root.iter(f"{SBML}parameter")}
    rules = {each.get("variable"): each[0][0] for each in root.iter(f"{SBML}rateRule")}
    triggers = [each[0][0] for each in root.iter(f"{SBML}trigger")]
    changes = [
        {each.get("variable"): each[0][0] for each in event.iter(f"{SBML}eventAssignment")}
        for event in root.iter(f"{SBML}event")
    ]

    def of(nodes, t, x):
        known = {**values, **dict(zip(rules, x, strict=True)), "time": t}
        return {key: mathml(node, known) for key, node in nodes.items()}

    h, x, found = times[1] / 50, np.array(initial), [initial]
    on = of(dict(enumerate(triggers)), 0.0, x)
    for i in range(50 * (len(times) - 1)):
        middle = x + h / 2 * np.array([*of(rules, i * h, x).values()])
        x, t = x + h * np.array([*of(rules, (i + 0.5) * h, middle).values()]), (i + 1) * h
        now = of(dict(enumerate(triggers)), t, x)
        for k in [k for k in now if now[k] and not on[k]]:
            new = of(changes[k], t, x)
            x = np.array([new.get(name, value) for name, value in zip(rules, x, strict=True)])
        on = of(dict(enumerate(triggers)), t, x)
        found += [x] if i % 50 == 49 else []
    assert np.median(np.abs(np.array(found) - expected).max(axis=1)) < 0.02 * np.ptp(expected)


def test_modelica_and_matlab_have_the_events_and_workbooks_refuse_them(occurring, tmp_path):
    law, *_, expected = occurring
    law.save(tmp_path / "law.mo")
    whole = (tmp_path / "law.mo").read_text()
    clauses = re.findall(r"(when|elsewhen) (.*) > 0 then\n((?: *reinit.*\n)+)", whole)
    assert [word for word, *_ in clauses] == ["when", "elsewhen"][: len(law.observation.events)]
    assert whole.count("end when;") == 1
    law.save(tmp_path / "law.m")
    text = (tmp_path / "law.m").read_text()
    (row,) = re.findall(r"parameters = \[(.*)\];", text)
    p = [float(each.strip("()")) for each in row.split()]
    names = dict(re.findall(r"(\w+) = (\S+?)[,)]", re.search(r"extends Equations_\((.*)\);", whole)[1] + ","))
    decided = re.search(r"g = \[(.*)\];", text)[1].split("; ")
    cases = re.split(r"case \d+\n", text)[1:]
    states = [name for name, _ in re.findall(r"Real (\w+)\(start = ([^,]*), fixed", whole)]
    for x in expected[::7]:
        indexed = {**FUNCTIONS, "t": 3.0, "p": p, "x": x}
        named = {**FUNCTIONS, "time": 3.0, "pre": float, **{name: float(each) for name, each in names.items()}}
        named |= dict(zip(states, x, strict=True))
        for (_, condition, reinit), other, case in zip(clauses, decided, cases, strict=True):
            matlab = {int(i): value for i, value in re.findall(r"y\((\d+)\) = (.*);", case)}
            modelica = {states.index(name) + 1: value for name, value in re.findall(r"reinit\((\w+), (.*)\);", reinit)}
            assert matlab.keys() == modelica.keys()
            for one, two in [(condition, other), *((modelica[i], matlab[i]) for i in matlab)]:
                two = re.sub(r"\b([xp])\((\d+)\)", lambda m: f"{m[1]}[{int(m[2]) - 1}]", two)
                assert eval(as_python(one), named) == pytest.approx(eval(as_python(two), indexed))
    with refused("export-events-to-workbook"):
        law.save(tmp_path / "law.xlsx")


def test_inputs_are_arguments(tmp_path):
    law = cl.Law.from_text("x' = (G u - x)/T", {"G": 2.0, "T": 0.5}, inputs=("u",))
    found = simulated_in_python(law, tmp_path, TIMES, [0.0], inputs=lambda _: [1.0])
    np.testing.assert_allclose(found[:, 0], 2.0 * (1 - np.exp(-TIMES / 0.5)), rtol=1e-5, atol=1e-7)
    law.save(tmp_path / "lag.mo")
    assert "input Real u;" in (tmp_path / "lag.mo").read_text()


def test_what_has_no_common_form_is_refused(tmp_path):
    law = cl.Law.from_text("x' = -k x", {"k": {"A": 1.0, "B": 2.0}})
    with refused("export-format"):
        law.save(tmp_path / "law.f90")
    with refused("several-objects"):
        law.save(tmp_path / "law.xml")
    with refused("export-initial"):
        law.save(tmp_path / "law.c", initial=[1.0, 2.0])
    with refused("export-initial-of-law"):
        law.save(tmp_path / "law.json", initial=[1.0])
    with refused("unknown-name"):
        law.save(tmp_path / "law.c", "C")
    with refused("export-unsupported"):
        cl.Law.from_text("x[k+1] = r x", {"r": 0.5}).save(tmp_path / "law.c")
    law.save(tmp_path / "law.json", "B")
    assert cl.Law.load(tmp_path / "law.json").objects == ("B",)


def test_names_are_different_words_of_every_language():
    names = ["x", "X", "while", "dx/dt", "3", "Länge", "x'", "", "__"]
    found = _plain_names(names)
    assert len({each.lower() for each in found}) == len(names)
    assert all(re.fullmatch(r"[A-Za-z]\w*", each, re.ASCII) for each in found)
