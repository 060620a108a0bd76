"""What the documentation shows of the code is what the code is."""

import importlib.util
import re
from pathlib import Path
from pkgutil import resolve_name
from xml.etree import ElementTree

from benchmarks.published import published

ROOT = Path(__file__).parents[2]


def drawn():
    spec = importlib.util.spec_from_file_location("layers", ROOT / "docs" / "layers.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def words(svg):
    return ["".join(each.itertext()) for each in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")]


def test_the_picture_of_the_layers_is_that_of_the_import_contract():
    module = drawn()
    shown = words(module.PICTURE.read_bytes())
    assert shown == words(module.picture()), "the contract has changed: run make layers"


def test_every_file_that_contributors_are_led_to_is_there():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    walk = text.partition("## The pipeline")[2].partition("\n## ")[0]
    room = ""
    for bold, file in re.findall(r"\*\*(\w+)\*\*|`([\w/]+\.py|\w+/)`", walk):
        room = bold or room
        assert (ROOT / "src" / "commonlaw" / room / file).exists(), f"{room}/{file}"


METHOD = sorted((ROOT / "docs" / "method").glob("*.md"))
FORMULA = re.compile(r"^\$\$ ?\(\w+\)\n\n(.*)", re.MULTILINE)
"""The line below a displayed formula with a label."""


def test_every_formula_of_the_method_names_what_computes_it():
    text = "".join(page.read_text() for page in METHOD)
    below = FORMULA.findall(text)
    assert 2 * len(below) == len(re.findall(r"^\$\$", text, re.MULTILINE)) > 0
    assert all(line.startswith("*Computed by* `commonlaw.") for line in below)


def test_every_name_of_the_code_in_the_method_is_there():
    names = {name for page in METHOD for name in re.findall(r"`(commonlaw\.[\w.]+)`", page.read_text())}
    assert names
    for name in names:
        resolve_name(name)


PAGES = sorted(
    {*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "SECURITY.md"} - {*(ROOT / "docs/api").glob("*")}
)
REPLACED = re.compile(
    r"\b(nobody|tells? (?:them )?apart|departs?|remembers?|honest|out of the question|fits? alike|hangs? on|sought"
    r"|constants inside|judged?|strays?|worth knowing)\b"
)
"""Words of ordinary language where the field has a term, see also the test of messages."""


def prose(page):
    """Return the text of a page without code and formulas."""
    return re.sub(r"```.*?```|`[^`]*`|\$\$.*?\$\$", "", page.read_text(), flags=re.DOTALL)


def test_pages_are_in_the_words_of_the_field():
    found = [f"{page.relative_to(ROOT)}: {each}" for page in PAGES for each in REPLACED.findall(prose(page))]
    assert not found, "\n".join(found)


def test_every_link_of_the_sources_leads_to_a_file():
    faults = []
    for page in PAGES:
        for link in re.findall(
            r"\]\((?!https?:|mailto:|#)([^)\s#]+)", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
        ):
            if not (page.parent / link).exists():
                faults.append(f"{page.relative_to(ROOT)}: {link}")
    assert not faults, "\n".join(faults)


def test_scores_are_the_same_on_every_page():
    assert {path: path.read_text() for path in published()} == published()
    scores = (ROOT / "docs/scores.md").read_text()
    assert scores in (ROOT / "README.md").read_text()
    for name in ("compare", "benchmarks"):
        assert "{include} scores.md" in (ROOT / f"docs/{name}.md").read_text()
