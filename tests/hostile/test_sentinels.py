"""A sentinel in every text of every file that is read: nothing of it runs in what is written of that file."""

import ast
import io
import json
import re
import shlex
import subprocess
import sys
import zipfile
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.cli.results import command_line
from commonlaw.law import Law, Provenance, from_json, to_json, to_latex, to_script
from commonlaw.law.io import file_content
from commonlaw.law.observation import Observation, TrialEstimate, TrialEstimates
from commonlaw.law.provenance import Alternative, Domain, Step
from commonlaw.law.restrictions import Restrictions
from commonlaw.law.script import Source
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.report import Report, Section, Table, Text, law_report, to_page
from commonlaw.report.markup import code, literal
from commonlaw.trials import Schema
from commonlaw.verdict import find

MARK = "SENTINEL"
SENTINELS = (
    f"__import__('os').system('touch {MARK}')",
    f"'); __import__('os').system('touch {MARK}') #",
    f'"""\nimport os; os.system("touch {MARK}")\n"""',
    f"</script></style></title><script>{MARK}()</script><img src=x onerror={MARK}()>",
    f"=cmd|' /C {MARK}'!A0",
    f"'; touch {MARK}; '",
    f"$(touch {MARK})`touch {MARK}`",
    f'\\"; {MARK}(); //\\',
    f"*/ {MARK}(); /*",
    f"??/\n{MARK}();\n%}}\n{MARK}",
    f"{MARK}\\",
    f"[{MARK}](javascript:{MARK}()) ${MARK}$",
)


@cache
def whole_law():
    """A law with a text in every field that a file has one in."""
    law = Law.from_text("x' = -k x + g u; y' = k x - y/(1 + y)", {"k": {"a": 0.5, "b": 0.7}, "g": 1.0}, inputs=("u",))
    schema = Schema(
        ("x", "y"), ("u",), "ball", "drop", "time_", units={"x": "m", "y": "m", "time_": "s"}, noise_columns={"x": "sd"}
    )
    variables = replace(law.terms.variables, time="time_")
    observation = Observation(
        Schema(("x", "y"), ("u",), "ball", "drop", "time_"),
        {"y": "2 y + k"},
        {"x": "2 k", "y": (1.0, 0.5)},
        0.0,
        events={"x < 0": {"x": "-x"}},
    )
    provenance = Provenance(
        alternatives=(Alternative("x'", ("x",), {"2 log B": 0.0}, proven=True, chosen=True),),
        history=(Step("noise", "x: 0.1", "from differences"),),
        equations=law.provenance.equations,
        calls=('cl.fit("x\' = -k x", trials)', "cl.refine(law, trials)"),
        domain=Domain({"x": (0.0, 1.0)}, at_rest=("c",), constant=("z",), strange=("d",), sizes={"x": 2.0}),
    )
    terms = replace(law.terms, variables=variables)
    return replace(
        law,
        terms=terms,
        schema=schema,
        provenance=provenance,
        properties={"a": {"mass": 1.0, "make": "A"}, "b": {"mass": 2.0, "make": "B"}},
        restrictions=Restrictions({"k": "trial"}, {"k": (1.0, 2.0)}, ("k > 0",), {"x": 0.1}),
        observation=observation,
        scheme="shooting",
        trial_estimates=TrialEstimates([TrialEstimate("a", "1", "x(0)", 1.0, 0.1)]),
        uncertainty=Uncertainty(noise_of={"x": {"a": 0.1}}),
    )


def texts_in(document, path=()):
    """Yield the path to each text in JSON, also the keys of its mappings, which end in None."""
    if isinstance(document, str):
        yield path
    elif isinstance(document, list):
        for i, part in enumerate(document):
            yield from texts_in(part, (*path, i))
    elif isinstance(document, dict):
        for key, part in document.items():
            yield (*path, key, None)
            yield from texts_in(part, (*path, key))


def planted(document, path, text):
    """Return a document with a text, or a key if the path ends in None, replaced."""
    key, *rest = path
    if rest == [None]:
        return {text if name == key else name: part for name, part in document.items()}
    copy = document.copy()
    copy[key] = planted(document[key], rest, text) if rest else text
    return copy


def planted_everywhere(document, name, text):
    """Return a document with a name replaced wherever it stands alone, as one of a column or an object does."""
    if isinstance(document, list):
        return [planted_everywhere(part, name, text) for part in document]
    if isinstance(document, dict):
        return {text if key == name else key: planted_everywhere(part, name, text) for key, part in document.items()}
    return text if document == name else document


class Tags(HTMLParser):
    """The tags of a page, and its attributes that run or load something."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.running = [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.running += [
            (name, value) for name, value in attrs if name.startswith("on") or "javascript:" in (value or "")
        ]


def check_page(page):
    found = Tags(page)
    assert not {"script", "iframe", "object", "embed"} & {*found.tags}
    assert found.running == []
    assert all(tag != "img" or "src=x" not in page for tag in found.tags)


def check_script(program):
    """Check that a program has calls of commonlaw alone."""
    tree = ast.parse(program)
    assert {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} <= {
        "cl",
        "law",
        "trials",
        "print",
        "float",
    }
    assert [node.names[0].name for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)] == [
        "commonlaw"
    ]
    called = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    assert called <= {"cl.Trials.read", "cl.fit", "cl.refine", "print", "law.assess", "float"}


def without_comments(code, comment, literal=r'"(?:[^"\\\n]|\\.)*"'):
    """Return code without texts and comments."""
    return re.sub(f"{literal}|{comment}", "", code, flags=re.DOTALL)


def check_programs(law):
    """Check the exports of a law to every language, as far as it can be written in them."""
    for ending in ("c", "py", "m", "mo", "xml", "xlsx"):
        try:
            name = law.objects[0] if ending in ("xml", "xlsx") else None
            content = file_content(law, f"law.{ending}", name)
        except cl.CommonlawError as error:
            if error.code != "export-unsupported":
                raise
            continue
        if ending == "xlsx":
            sheets = zipfile.ZipFile(io.BytesIO(content))
            formulas = [
                re.findall(rb"<f>(.*?)</f>", sheets.read(name)) for name in sheets.namelist() if "sheet" in name
            ]
            assert not [formula for listed in formulas for formula in listed if MARK.encode() in formula]
            continue
        text = content.decode()
        if ending == "xml":
            assert not [node for node in ElementTree.fromstring(text).iter() if MARK in node.tag]
        elif ending == "py":
            tree = ast.parse(text)
            called = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
            assert not [call for call in called if MARK in call or "import" in call or "system" in call]
        else:
            spliced = text.replace("\\\n", "").replace("??/\n", "")
            assert spliced == text
            comment = {"c": r"//[^\n]*|/\*.*?\*/", "m": r"%[^\n]*", "mo": r"//[^\n]*|/\*.*?\*/"}[ending]
            literal = r"'(?:[^'\n]|'')*'|\"[^\"\n]*\"" if ending == "m" else r'"(?:[^"\\]|\\.)*"'
            code = without_comments(text, comment, literal)
            assert not re.search(rf"(?<!\w){MARK}\(", code)
            assert f"touch {MARK}" not in code


def check(law):
    """Check everything that is written of a law."""
    check_script(to_script(law, "trials.csv"))
    check_programs(law)
    latex = to_latex(law, law.objects[0])
    assert not re.search(r"\\(input|write|include|href|def)", latex)


def opened(document):
    """Return the law of a document, or none where it is refused."""
    try:
        return from_json(json.dumps(document))
    except cl.CommonlawError:
        return None


DOCUMENT = json.loads(to_json(whole_law()))
PATHS = [*texts_in(DOCUMENT)]


@pytest.mark.parametrize("step", [12, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("number", range(len(SENTINELS)))
def test_a_text_of_a_saved_law_runs_nowhere(number, step):
    paths = PATHS[number % step :: step]
    laws = [law for path in paths if (law := opened(planted(DOCUMENT, path, SENTINELS[number])))]
    assert laws
    for law in laws:
        check_script(to_script(law, "trials.csv"))


@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("number", range(len(SENTINELS)))
def test_a_name_in_a_saved_law_runs_nowhere(number, step):
    sentinel = SENTINELS[number]
    law = Law.from_text("x' = -k x + u; y' = x - y", {"k": 0.5}, inputs=("u",))
    document = json.loads(to_json(law))
    for name in ("x", "y", "u", "object", "k", "t")[number % step :: step]:
        changed = planted_everywhere(document, name, sentinel)
        quoted = "`" + sentinel.replace("`", "``") + "`"
        changed["terms"] = [quoted if term in (name, sentinel) else term for term in document["terms"]]
        changed["provenance"] = document["provenance"] | {"equations": []}
        if found := opened(changed):
            check(found)


@pytest.mark.parametrize("step", [40, pytest.param(1, marks=pytest.mark.slow)])
def test_a_page_of_a_saved_law_runs_nothing(step):
    for path in PATHS[::step]:
        if law := opened(planted(DOCUMENT, path, SENTINELS[3])):
            check_page(law._repr_html_())


@pytest.mark.parametrize("sentinel", SENTINELS, ids=range(len(SENTINELS)))
def test_a_text_of_a_schema_or_a_data_set_runs_nowhere(sentinel):
    reading = dict.fromkeys(("object", "trial", "time"), sentinel) | {"units": {sentinel: sentinel}}
    for source in (
        Source(sentinel, properties=(sentinel,), reading=reading),
        Source([sentinel, sentinel], reading=reading),
        Source(dataset=sentinel),
    ):
        check_script(to_script(whole_law(), source))


def test_the_names_of_a_parquet_law_run_nowhere(tmp_path):
    for i, sentinel in enumerate(SENTINELS):
        document = planted_everywhere(DOCUMENT, "a", sentinel)
        law = opened(document)
        law.save(tmp_path / f"{i}.parquet")
        again = Law.load(tmp_path / f"{i}.parquet")
        assert again == law
        check_script(to_script(again, "trials.csv"))


def table(sentinel):
    times = np.linspace(0, 3, 12)
    return pd.DataFrame(
        {
            f"object {sentinel}": np.repeat([f"{sentinel} 1", f"{sentinel} 2"], 12),
            "t": np.tile(times, 2),
            f"x {sentinel}": np.concatenate([np.exp(-0.5 * times), 2 * np.exp(-0.6 * times)]),
            f"make {sentinel}": np.repeat([f"A{sentinel}", sentinel], 12),
        }
    )


def test_a_page_runs_nothing_of_the_texts_in_it():
    for sentinel in SENTINELS:
        values = Table("values", literal(sentinel), pd.DataFrame({sentinel: [sentinel]}))
        texts = (Text(code(sentinel, "sh")), Text(literal(sentinel)), values)
        check_page(to_page(Report(sentinel, literal(sentinel), (Section("part", sentinel, texts),))).decode())


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, len(SENTINELS), 3))
def test_a_report_on_hostile_names_runs_nothing(first):
    of_object, of_state, of_property = (text.replace("\n", " ") for text in SENTINELS[first : first + 3])
    frame = table(of_object).rename(columns={f"x {of_object}": f"x {of_state}", f"make {of_object}": of_property})
    trials = cl.Trials.from_frame(frame, object=frame.columns[0], time="t", states=[frame.columns[2]], units={})
    (state,) = trials.schema.states
    quoted = "`" + state.replace("`", "``") + "`"
    law = cl.fit(f"{quoted}' = -k {quoted}", trials)
    made = law_report(find(law, trials, None), shlex.join(["commonlaw", *SENTINELS]))
    page = to_page(made).decode()
    check_page(page)
    assert "onresidual" not in page  # The words of a table are not replaced within names


def test_the_command_that_a_report_shows_is_words_of_a_shell(tmp_path, monkeypatch):
    words = ["report", *SENTINELS, "\udcff.csv"]
    monkeypatch.setattr(sys, "argv", ["commonlaw", *words])
    line = command_line()
    program = f"commonlaw() {{ printf '%s\\0' \"$@\"; }}\n{line}"
    done = subprocess.run(["sh", "-c", program], cwd=tmp_path, capture_output=True, check=True)
    assert done.stdout.decode().split("\0")[:-1] == [*words[:-1], r"\xff.csv"]
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("ending", ["csv", "parquet", "xlsx"])
@pytest.mark.parametrize("sentinel", SENTINELS[3:5], ids=range(3, 5))
def test_headers_and_cells_of_a_table_run_nowhere(tmp_path, ending, sentinel):
    path, sentinel = tmp_path / f"table.{ending}", sentinel.replace("\n", " ")
    frame = table(sentinel)
    {"csv": frame.to_csv, "parquet": frame.to_parquet, "xlsx": frame.to_excel}[ending](path, index=False)
    try:
        trials = cl.Trials.read(path, object=frame.columns[0], time="t", states=[frame.columns[2]])
    except cl.CommonlawError:  # Such as a unit in the header that is none
        return
    (state,) = trials.schema.states
    quoted = "`" + state.replace("`", "``") + "`"
    check(cl.fit(f"{quoted}' = -k {quoted}", trials))


def test_c_with_a_hostile_name_compiles_without_it(tmp_path):
    for i, sentinel in enumerate(SENTINELS):
        name = "`" + sentinel.replace("`", "``") + "`"
        law = Law.from_text(f"{name}' = -k {name}", {"k": {sentinel: 0.5}})
        law.save(tmp_path / f"law{i}.c")
        made = subprocess.run(
            ["cc", "-Wall", "-Werror", "-Wno-unknown-pragmas", "-fsyntax-only", tmp_path / f"law{i}.c"],
            capture_output=True,
        )
        assert made.returncode == 0, made.stderr.decode()
        law.save(tmp_path / f"law{i}.py")
        compile((tmp_path / f"law{i}.py").read_text(), "law.py", "exec")
