"""The package as a whole: versions, public names, what modules import, extras, and systems without POSIX."""

import ast
import math
import re
import shlex
import subprocess
import sys
import tomllib
from operator import attrgetter
from pathlib import Path

import grimp
import openpyxl
import pytest
import yaml

import commonlaw
import commonlaw as cl
from commonlaw.app.server import serve
from commonlaw.law import to_sympy
from commonlaw.library import Variables, parse_term
from commonlaw.report import to_page
from commonlaw.report.document import Report
from commonlaw.runtime.cluster import connected
from commonlaw.runtime.packages import optional_import
from tests.refusals import refused

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
MAKEFILE = (ROOT / "Makefile").read_text()
FORGES = {name: yaml.safe_load((ROOT / name).read_text()) for name in (".github/workflows/tests.yml", ".gitlab-ci.yml")}
SYSTEMS = ("linux", "macos", "windows")


def steps(job):
    """Return the commands of a job on either forge."""
    github = [each["run"] for each in job.get("steps", ()) if "run" in each]
    return [*github, *job.get("before_script", ()), *job.get("script", ())]


def jobs(forge):
    return FORGES[forge].get("jobs", FORGES[forge])


def versions(job):
    """Return the Pythons that a job runs on."""
    if "strategy" in job:
        return job["strategy"]["matrix"]["python"]
    (matrix,) = job["parallel"]["matrix"]
    return matrix["VERSION"]


def recipe(target):
    """Return the commands of a target without the folder that programs are in."""
    lines = re.search(rf"^{target}:.*\n((?:\t.*\n)*)", MAKEFILE, flags=re.MULTILINE)[1]
    return lines.replace("\t", "").replace("$(BIN)/", "").splitlines()


def test_the_version_is_in_one_place_and_everything_shows_it() -> None:
    assert "version" in PROJECT["project"]["dynamic"]
    assert (ROOT / PROJECT["tool"]["hatch"]["version"]["path"]).samefile(commonlaw.__file__)
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == commonlaw.__version__
    shown = subprocess.run([sys.executable, "-m", "commonlaw", "--version"], capture_output=True, text=True, check=True)
    assert shown.stdout == f"commonlaw, version {commonlaw.__version__}\n"


@pytest.mark.parametrize("forge", FORGES)
def test_forges_run_what_the_project_runs(forge: str) -> None:
    asked = [line for line in (ROOT / ".ci" / "run").read_text().splitlines() if line.startswith("make ")]
    linux = [re.sub(" PYTHON=.*", "", each) for each in steps(jobs(forge)["linux"])]
    assert linux[-len(asked) - 1 :] == [*asked, "make docs"]
    assert re.sub(" PYTHON=.*", "", steps(jobs(forge)["macos"])[-1]) == "make test"
    every = [each for target in ("lint", "types", "contracts", "unit") for each in recipe(target)]
    assert steps(jobs(forge)["windows"])[-len(every) :] == every


@pytest.mark.parametrize("forge", FORGES)
def test_forges_have_all_systems_and_all_pythons_and_no_target_that_is_gone(forge: str) -> None:
    pythons = [each.rpartition(" ")[2] for each in PROJECT["project"]["classifiers"] if re.search(r":: 3\.\d", each)]
    assert PROJECT["project"]["requires-python"] == f">={pythons[0]}"
    tried = {system: set(versions(jobs(forge)[system])) for system in SYSTEMS}
    assert set(pythons) <= tried["linux"]
    assert all(pythons[0] in each and max(tried["linux"], key=lambda v: int(v[2:])) in each for each in tried.values())
    targets = set(re.findall(r"^([a-z-]+):", MAKEFILE, flags=re.MULTILINE))
    words = [shlex.split(each) for name in (*SYSTEMS, "release") for each in steps(jobs(forge)[name])]
    made = [word for first, *rest in words if first == "make" for word in rest if "=" not in word]
    assert "release-check" in made
    assert set(made) <= targets


def test_packages_are_pinned_once_each_in_plain_lines() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert not [line for line in lines if not re.fullmatch(r"[\w.-]+==[\w.]+", line)]
    names = [re.sub(r"[-_.]+", "-", line.partition("==")[0]).lower() for line in lines]
    assert len(set(names)) == len(names)
    extras = PROJECT["project"]["optional-dependencies"].values()
    needed = [each for few in (PROJECT["project"]["dependencies"], *extras) for each in few]
    wanted = {re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", each)[0]).lower() for each in needed} - {"commonlaw"}
    assert wanted <= set(names)


def test_every_public_name_is_there_and_documented() -> None:
    texts = {name: getattr(commonlaw, name).__doc__ or "" for name in dir(commonlaw)}
    # Dataclasses without a docstring have their signature in its place
    assert not [name for name, text in texts.items() if not text or text.startswith(f"{name}(")]


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        attrgetter("no_such_name")(commonlaw)


SOURCES = Path(commonlaw.__file__).parent

CHANGES_DISK = {
    "chmod", "hardlink_to", "makedirs", "mkdir", "open", "remove", "rename", "rmdir", "symlink_to", "tofile", "touch",
    "unlink", "write_bytes", "write_text",
}  # fmt: skip
"""Methods, and functions of modules, that change files or can."""

READS_DISK = {"fromfile", "genfromtxt", "loadtxt", "memmap", "open", "read_bytes", "read_excel", "read_text"}
"""What takes bytes out of a file by itself."""

MAKES_FILES = {"fcntl", "msvcrt", "shutil", "tempfile"}
"""Modules for that."""

TALKS = {"cli/output.py", "runtime/progress.py", "trials/workbook_process.py"}
"""What writes to standard output or standard error: what people are shown, and what another process reads."""


def reached(imports, start):
    """Return the modules that are imported from one on, directly or through others."""
    found, left = set(), [start]
    while left:
        new = imports[left.pop()] - found
        found |= new
        left += new
    return found


VALUES = "commonlaw.law.law", "commonlaw.law.simplification", "commonlaw.trials.trials"
"""Values with methods that call what is built on these values, and import it only then."""


def test_no_files_import_each_other_in_a_circle():
    graph = grimp.build_graph("commonlaw", cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    for module in VALUES:
        tree = ast.parse((SOURCES.parent / f"{module.replace('.', '/')}.py").read_text())
        first = {node.lineno for node in tree.body}
        lines = {name: graph.get_import_details(importer=module, imported=name) for name in imports[module]}
        imports[module] = {name for name, of in lines.items() if any(one["line_number"] in first for one in of)}
    reach = {module: reached(imports, module) for module in imports}
    circles = {frozenset(other for other in reach[module] if module in reach[other]) for module in reach}
    named = [" <-> ".join(sorted(circle)) for circle in circles if circle]
    assert not named, "import circles:\n" + "\n".join(named)


def nodes(names):
    """Yield modules in which one of these names stands, and each node of their syntax."""
    for module in SOURCES.rglob("*.py"):
        if re.search(rf"\b({'|'.join(names)})\b", text := module.read_text()):
            yield from ((module.relative_to(SOURCES).as_posix(), node) for node in ast.walk(ast.parse(text)))


def test_one_module_changes_what_is_on_disk():
    changes = []
    for module, node in nodes(CHANGES_DISK | MAKES_FILES):
        if isinstance(node, ast.Call):
            used = {getattr(node.func, "attr", "")} & CHANGES_DISK | {getattr(node.func, "id", "")} & {"open"}
        elif isinstance(node, ast.Import | ast.ImportFrom):
            used = {getattr(node, "module", None), *(each.name for each in node.names)} & MAKES_FILES
        else:
            continue
        if module not in ("runtime/files.py", "cli/output.py"):
            changes += [f"{module}:{node.lineno}: {each}" for each in used]
    assert not changes, "write by commonlaw.runtime.files"


def test_one_module_reads_what_is_on_disk():
    names = {
        getattr(node.func, "attr", getattr(node.func, "id", ""))
        for module, node in nodes(READS_DISK)
        if isinstance(node, ast.Call)
        and not module.endswith(("diagnostics.py", "files.py", "output.py", "kernel/__init__.py"))
    }
    assert not names & READS_DISK, "read by commonlaw.runtime.files, within its limits"


def test_one_module_shows_people_what_there_is_to_say():
    talk = re.compile(r"click\.s?echo\b|^ *print\(|sys\.std(out|err)\.\w*write|\bConsole\(", re.MULTILINE)
    talking = {str(each.relative_to(SOURCES)) for each in SOURCES.rglob("*.py") if talk.search(each.read_text())}
    assert talking == TALKS, "say it by commonlaw.cli.output"


OPTIONAL = {
    "pyarrow": "parquet",
    "sympy": "symbolic",
    "python_calamine": "excel",
    "jinja2": "report",
    "markdown_it": "report",
    "mdit_py_plugins": "report",
    "latex2mathml": "report",
    "starlette": "app",
    "uvicorn": "app",
    "distributed": "cluster",
}

HEAVY = {"click", "dask", "distributed", "matplotlib", "pandas", "pint", "pooch", "pyarrow", "rich", "scipy", "sympy"}

WITHOUT_EXTRAS = """
import sys
from commonlaw import datasets, differentiation, library, trials

assert {heavy}.isdisjoint(sys.modules), {heavy}.intersection(sys.modules)
from commonlaw.app import result

assert "matplotlib" not in sys.modules
sys.modules.update(dict.fromkeys([*{optional}, "heyoka"]))
import numpy as np, pandas as pd, polars as pl
import commonlaw as cl

for name in cl.__all__:
    getattr(cl, name)
drops = cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.01, trials=1)
drops.to_csv("drops.csv")
for read in (
    cl.Trials.read("drops.csv"),
    cl.Trials.from_frame(drops.to_frame()),
    cl.Trials.from_frame(pl.DataFrame({{name: column.to_list() for name, column in drops.to_frame().items()}})),
):
    for one, other in zip(read, drops, strict=True):
        assert one.label == other.label
        np.testing.assert_array_equal(one.states, other.states)
law = cl.Law.load("law.json")
assert r"\\left|" in cl.law.to_latex(law, law.objects[0])
law.predict(drops).errors()
assert all("<svg" in each._repr_html_() for each in (law, drops, law.predict(drops)))
assert not [name for name in {optional} if sys.modules[name]]
assert "matplotlib.pyplot" not in sys.modules
"""


@pytest.fixture(scope="module")
def law_file(tmp_path_factory):
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.01, trials=1)
    law = cl.fit("x'' = a + b v abs(v)", drops, errors="white")
    law.save(path := tmp_path_factory.mktemp("laws") / "law.json")
    return path


def test_packages_import_nothing_heavy_and_text_frames_and_laws_need_no_extra(law_file):
    code = WITHOUT_EXTRAS.format(optional=list(OPTIONAL), heavy=HEAVY)
    ended = subprocess.run([sys.executable, "-c", code], cwd=law_file.parent, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_help_imports_nothing_heavy():
    code = f"""
import sys
from commonlaw.cli import main

sys.argv = ["commonlaw", "--help"]
try:
    main()
except SystemExit:
    assert {HEAVY - {"click"}}.isdisjoint(sys.modules), {HEAVY}.intersection(sys.modules)
"""
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


@pytest.fixture
def missing(monkeypatch):
    def take_away(module):
        for name in [name for name in sys.modules if name.split(".")[0] == module]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, module, None)

    return take_away


def a_page(_folder):
    return to_page(Report("Balls", "What was found.", ()))


FEATURES = {
    "reading Parquet": ("pyarrow", lambda folder: cl.Trials.read(folder / "a.parquet")),
    "writing Parquet": ("pyarrow", lambda folder: cl.Trials.from_arrays([0], [1]).to_parquet(folder / "b.parquet")),
    "streaming Parquet": ("pyarrow", lambda folder: cl.TrialStream.from_parquet(folder / "a.parquet")),
    "reading workbooks": ("python_calamine", lambda folder: cl.Trials.read(folder / "a.xlsx")),
    "the SymPy form of a law": ("sympy", lambda folder: to_sympy(cl.Law.load(folder / "law.json"), "Ball 1")),
    "the SymPy form of a term": ("sympy", lambda _: parse_term("abs(x)", Variables(("x",))).sympy(["x", "t"])),
    "work on a cluster": ("distributed", lambda _: connected("local:1").__enter__()),
    **{f"the app without {name}": (name, lambda _: serve()) for name, extra in OPTIONAL.items() if extra == "app"},
    **{f"making a report without {name}": (name, a_page) for name, extra in OPTIONAL.items() if extra == "report"},
}


@pytest.mark.parametrize("feature", FEATURES)
def test_a_feature_names_the_package_and_the_extra_that_it_needs(feature, missing, law_file):
    (module, use), what = FEATURES[feature], feature.split(" without")[0]
    folder = law_file.parent
    cl.Trials.from_arrays([0, 1], [1, 2]).to_parquet(folder / "a.parquet")
    book = openpyxl.Workbook()
    book.active.append(["t", "x"])
    book.save(folder / "a.xlsx")
    missing(module)
    package, extra = module.replace("_", "-"), OPTIONAL[module]
    with refused("extra-missing", package=package, extra=extra) as raised:
        use(folder)
    assert what in raised.value.parameters["feature"]


def test_an_error_within_a_package_is_not_taken_for_its_absence(monkeypatch, tmp_path):
    (tmp_path / "half_there.py").write_text("import not_there_at_all")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="not_there_at_all"):
        optional_import("half_there", "this test", "none")


SCRIPT = """
import os, sys

for name in ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog"):
    sys.modules[name] = None
for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY", "set_blocking", "fork", "killpg"):
    delattr(os, name)

from commonlaw.cli import main

for line in (
    "data export decays.csv --save copy.csv",
    "discover copy.csv --library poly:1 --method derivative-regression --save law.json",
    "predict copy.csv law.json --save forecast.csv",
    "report copy.csv law.json --save report.html",
):
    sys.argv = ["commonlaw", *line.split()]
    try:
        main()
    except SystemExit as ended:
        if ended.code:
            sys.exit(f"{line}: {ended.code}")
"""


def test_laws_are_found_saved_and_reported_without_modules_of_posix(tmp_path):
    rows = [f"{t},{math.exp(-t / 2) + 1e-3 * math.sin(37 * t)}" for t in range(15)]
    (tmp_path / "decays.csv").write_text("\n".join(["t,x", *rows]))
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    written = {"decays.csv", "copy.csv", "law.json", "forecast.csv", "report.html"}
    assert {each.name for each in tmp_path.iterdir()} == written
