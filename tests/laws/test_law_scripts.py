"""A law as a program that finds it again."""

import ast
from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import Provenance, from_json, to_json, to_script
from commonlaw.law.script import LEFT_OUT, rewritten, written
from commonlaw.library import Terms, Variables, parse_term


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), trials=1, noise=0.05)


def rerun(law, drops, folder):
    path = folder / "drops.csv"
    drops.to_csv(path)
    scope = {}
    exec(to_script(law, str(path)), scope)
    return scope["law"]


@pytest.mark.parametrize(
    "find",
    [
        lambda drops: cl.discover(drops, order=2, library="poly:1"),
        lambda drops: cl.discover(
            drops,
            order=2,
            library=cl.library.PolynomialLibrary(1),
            known={("x", "1"): -9.8},
            method=cl.DerivativeRegression(differentiation="savgol:25:3", solver=cl.solvers.STLSQ(0.05)),
        ),
        lambda drops: cl.fit("x'' = -9.8 - c v", drops, errors="white", noise={"x": 0.05}),
        lambda drops: cl.refine(cl.fit("x'' = -g - c v", drops), drops, huber_threshold=3.0),
        lambda drops: cl.fit("x'' = -g - c v", drops).explain([]),
    ],
)
def test_the_program_finds_the_law_again(find, drops, tmp_path, capsys):
    law = find(drops)
    again = rerun(law, drops, tmp_path)
    assert again.terms.names == law.terms.names
    np.testing.assert_array_equal(again.coefficients, law.coefficients)
    assert (again.uncertainty.explanation is None) == (law.uncertainty.explanation is None)
    assert str(law) in capsys.readouterr().out


def test_a_saved_law_keeps_its_program(drops):
    law = cl.fit("x'' = -g - c v", drops)
    assert to_script(from_json(to_json(law))) == to_script(law)


def test_names_of_earlier_versions_in_a_recorded_call_become_the_present_ones():
    call = "cl.discover(trials, method=cl.DerivativeRegression(solver=cl.STLSQ(threshold=0.05)))"
    assert rewritten(call) == call.replace("cl.STLSQ", "cl.solvers.STLSQ")
    call = """cl.fit("x' = -k", trials, starts={'x': 1}, starts_at=0, universal=('k',), errors='walk')"""
    now = """cl.fit("x' = -k", trials, initial_values={'x': 1}, initial_time=0, shared=('k',), errors='random-walk')"""
    assert rewritten(call) == now


def test_a_law_of_unknown_making_is_fitted():
    law = cl.Law.from_text("T' = -k (T - 20)", {"k": 0.1})
    assert 'law = cl.fit("T\' = -k (T - 20)", trials)' in to_script(law)


HOSTILE = [
    "cl.discover(trials); open('PWNED', 'w')",
    "cl.discover(trials)\nopen('PWNED', 'w')",
    "cl.discover(trials) or open('PWNED', 'w')",
    "cl.discover(trials, order=open('PWNED', 'w'))",
    "cl.discover(trials, order=2, **open('PWNED', 'w'))",
    "cl.discover(*open('PWNED', 'w'))",
    "cl.discover(trials, library=f\"{open('PWNED', 'w')}\")",
    "cl.discover(trials, order=(law := open('PWNED', 'w')))",
    "cl.discover(trials, progress=lambda *_: open('PWNED', 'w'))",
    "cl.discover(trials, library=[open('PWNED', 'w') for _ in '1'])",
    "cl.discover(trials, method=cl.DerivativeRegression(solver=cl.solvers.STLSQ(open('PWNED', 'w'))))",
    "cl.discover(trials, known={open('PWNED', 'w'): 1})",
    "cl.discover(trials, known={**open('PWNED', 'w')})",
    "cl.discover(trials, no_such_argument=1)",
    "cl.discover(trials).save('PWNED')",
    "cl.files.write_whole('PWNED', b'')",
    "cl.Law.load('secret.json')",
    "cl.Trials.read('secret.csv')",
    "cl.plots.plot_law(law, trials)",
    "law.save('PWNED')",
    "law.explain('secret.csv')",
    "law.explain(properties='secret.csv')",
    "law.discrepancy(trials, of='v')",
    "law.discrepancy(trials).law.save('PWNED')",
    "cl.discover(trials, method=cl.LawDiscovery(order=2))",
    "cl.discover(trials, method=cl.datasets)",
    "cl.discover(trials, order=b'2')",
    "cl.discover(trials, order=2j)",
    "cl.discover(trials, order=...)",
    "__import__('pathlib').Path('PWNED').touch()",
    "open('PWNED', 'w')",
    "cl.discover(trials, order='\x00')",
    "cl.discover(trials, order=" + "-" * 100_000 + "1)",
    "cl.discover(trials, order=" + "[" * 100 + "]" * 100 + ")",
    "cl.discover(trials" + ".a" * 90_000 + ")",
    "cl.discover(trials, order=0x" + "f" * 10_000 + ")",
    "cl.discover(trials, order='" + "a" * 1_000_000 + "')",
    "",
]


@pytest.mark.parametrize("call", HOSTILE, ids=lambda call: call[:60])
def test_a_program_holds_nothing_of_a_strangers_law_but_calls_with_plain_values(call):
    law = cl.Law.from_text("x'' = -g", {"g": 9.8})
    law = from_json(to_json(replace(law, provenance=Provenance(calls=(call,)))))
    program = to_script(law)
    assert "PWNED" not in program
    assert "secret" not in program
    assert program.splitlines()[3:5] == [LEFT_OUT, "law = cl.fit(\"x'' = a\", trials)"]


def test_what_is_recorded_is_written_anew_from_what_was_parsed():
    law = cl.Law.from_text("x'' = -g", {"g": 9.8})
    call = "cl.\uff44iscover(trials,order = 2, library='poly:1',\n known={('x', '\u202e'): -1e999}) # open('PWNED')"
    lines = to_script(replace(law, provenance=Provenance(calls=(call, "law.explain( [] )")))).splitlines()
    assert lines[3] == r"law = cl.discover(trials, order=2, library='poly:1', known={('x', '\u202e'): -1e309})"
    assert lines[4] == "law = law.explain([])"


def test_steps_on_a_law_whose_making_is_left_out_follow_a_fit_of_its_terms():
    law = cl.Law.from_text("x'' = -g", {"g": 9.8})
    lines = to_script(replace(law, provenance=Provenance(calls=("print(1)", "law.explain([])")))).splitlines()
    assert lines[3:6] == [LEFT_OUT, "law = cl.fit(\"x'' = a\", trials)", "law = law.explain([])"]


def test_names_of_strangers_are_texts_in_a_program():
    name = "x'); open('PWNED', 'w') #\n\"\"\"`\u2028"
    schema = cl.Schema((name,), time="t", units={name: "m"})
    base = cl.Law.from_text("x'' = -g", {"g": 9.8})
    terms = Terms(Variables((name, "v"), (), "t"), (parse_term("1", Variables((name, "v"), (), "t")),))
    law = cl.Law(terms, schema, 2, ("a'b",), base.coefficients)
    tree = ast.parse(to_script(law, "d'; open('PWNED')\n.csv"))
    called = {ast.unparse(each.func) for each in ast.walk(tree) if isinstance(each, ast.Call)}
    assert called == {"cl.Trials.read", "cl.fit", "print", "law.assess"}


@pytest.mark.parametrize("value", [float("inf"), float("nan"), np.float64(0.5), np.array([1.0, 2.0]), (1,), {"a": -2}])
def test_values_are_written_as_what_a_program_may_hold(value):
    assert rewritten(f"cl.discover(trials, order={written(value)})") == f"cl.discover(trials, order={written(value)})"
