"""What works without the packages of the extras, and how a feature asks for the one that it needs."""

import subprocess
import sys

import openpyxl
import pytest

import commonlaw as cl
from commonlaw.app import serve
from commonlaw.law import to_sympy
from commonlaw.library import Variables, parse_term
from commonlaw.report.document import Report
from commonlaw.report.write import to_html
from commonlaw.runtime.cluster import connected
from commonlaw.runtime.packages import optional_import
from tests.refusals import refused

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

WITHOUT_EXTRAS = """
import sys
sys.modules.update(dict.fromkeys([*{optional}, "heyoka"]))
import numpy as np, pandas as pd, polars as pl
import commonlaw as cl

for name in cl.__all__:
    getattr(cl, name)
drops = cl.datasets.linear_drag(noise=0.01, trials=1)
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
assert r"\\left|" in law.to_latex(law.objects[0]), law.to_latex(law.objects[0])
law.predict(drops).errors()
assert all("<svg" in each._repr_html_() for each in (law, drops, law.predict(drops)))
assert not [name for name in {optional} if sys.modules[name]]
"""


@pytest.fixture(scope="module")
def law_file(tmp_path_factory):
    law = cl.fit("x'' = a + b v abs(v)", cl.datasets.linear_drag(noise=0.01, trials=1))
    law.save(path := tmp_path_factory.mktemp("laws") / "law.json")
    return path


def test_text_frames_and_laws_need_no_extra(law_file):
    code = WITHOUT_EXTRAS.format(optional=list(OPTIONAL))
    ended = subprocess.run([sys.executable, "-c", code], cwd=law_file.parent, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


@pytest.fixture
def missing(monkeypatch):
    def take_away(module):
        for name in [name for name in sys.modules if name.split(".")[0] == module]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, module, None)

    return take_away


def a_page(_folder):
    return to_html(Report("Balls", "What was found.", ()), {})


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
