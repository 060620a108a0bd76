"""How Sphinx builds the site: `make docs`. Nothing in it is fetched from elsewhere when it is read."""

import inspect
import re
from collections.abc import Sequence
from functools import cached_property
from html import unescape
from importlib import metadata
from pathlib import Path
from pkgutil import resolve_name
from types import FunctionType
from typing import Any
from urllib.parse import unquote

import click
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective
from sphinx.util.math import get_node_equation_number

import commonlaw
from commonlaw.cli.main import ALL_OPTIONS, commonlaw as command
from commonlaw.diagnostics import kinds, notes, sentences, template, topic_of, topics
from commonlaw.law.quantities import forms
from commonlaw.plots import render
from commonlaw.report.document import within
from commonlaw.report.markup import formula
from commonlaw.runtime.fit_options import FitOptions, setting_rows

project = "commonlaw"
author = "the maintainers of commonlaw"
version = release = metadata.version("commonlaw")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "myst-nb", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "scores.md", "more-scores.md"]  # Which are parts of other pages
default_role = "code"
language = "en"

html_theme = "furo"
html_title = "commonlaw"
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#005a9c", "color-brand-content": "#005a9c"},
    "dark_css_variables": {"color-brand-primary": "#6cb6ff", "color-brand-content": "#6cb6ff"},
    "top_of_page_buttons": [],
}
html_css_files = ["custom.css"]
html_show_sourcelink = False
html_static_path = ["_static"]
templates_path = ["_templates"]
_urls = (each.split(", ", 1) for each in metadata.metadata("commonlaw").get_all("Project-URL", []))
html_context = {"project_urls": [[name, address] for name, address in _urls if "example.org" not in address]}
html_math_renderer = "mathml"
# Equations are numbered by page of the method: (2.3)
numfig = math_numfig = True
html_copy_source = html_show_sphinx = html_show_copyright = False

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "auto"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_code_prompt_show, nb_code_prompt_hide = "Show the code", "Hide the code"
# The measured drops are not part of the project; where they cannot be had their page has no outputs, and says so
nb_execution_excludepatterns = []
try:
    commonlaw.datasets.ball_drops()
except commonlaw.CommonlawError:
    nb_execution_excludepatterns = ["tutorials/drops.md"]

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_class_signature = "separated"
napoleon_use_rtype = False
# Names of examples and of other packages, that no page here is about
nitpicky = False


class PublicNames(SphinxDirective):
    """Lists public names with the first lines of their docstrings: its argument is a module, and the names in it."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Return the list."""
        module, *names = self.arguments[0].split()
        rows = [(f":doc:`{name} <api/{name}>`", resolve_name(f"{module}:{name}")) for name in names]
        return self.parse_text_to_nodes("\n".join(_table(rows)))


def _table(rows: list[tuple[str, object]]) -> list[str]:
    """Return a table of names and the first lines of their docstrings, as lines of reStructuredText."""
    cells = [(name, (inspect.getdoc(found) or "").partition("\n")[0]) for name, found in rows]
    return [".. list-table::", "   :widths: auto", "", *(f"   * - {name}\n     - {text}" for name, text in cells), ""]


def _members(found: type) -> list[tuple[str, object]]:
    """Return the documented methods and properties of a class, in the order in which they are written."""
    classes = reversed(found.__mro__) if found is commonlaw.Law else [found]
    own = {name: each for base in classes if base is not object for name, each in vars(base).items()}
    kinds = property | cached_property | classmethod | staticmethod | FunctionType
    return [(name, each) for name, each in own.items() if name[0] != "_" and isinstance(each, kinds) and each.__doc__]


_MAX_USES = 8
"""Pages with examples of a name that its own page lists."""


def _used_in(name: str) -> list[str]:
    """Return links to the pages for users whose code has a public name, as lines of reStructuredText."""
    folder, uses = Path(__file__).parent, re.compile(rf"\b(?:cl|methods)\.(\w+\.)*{name}\b")
    pages = [each for kind in ("howto/*.md", "tutorials/*.md", "*.md") for each in sorted(folder.glob(kind))]
    blocks = re.compile(r"^```.*?^```|`[^`\n]+`", re.DOTALL | re.MULTILINE)
    code = {each: blocks.findall(each.read_text()) for each in pages}
    named = [each for each in pages if each.stem != "index" and any(map(uses.search, code[each]))]
    used = [each.relative_to(folder).with_suffix("") for each in named]
    links = [f":doc:`/{each.as_posix()}`" for each in used[:_MAX_USES]]
    return [f"Examples: {', '.join(links)}", ""] if links else []


_MAX_RELATED = 12
"""Names that a page refers to."""


def _page(module: str, name: str, others: Sequence[str]) -> str:
    """Return the page of a public name with references to related ones, unless its docstring has them.

    It is in no table of contents: that of every page would list all names.
    """
    found, full = resolve_name(f"{module}:{name}"), f"{module}.{name}"
    lines = [":orphan:", "", name, "=" * len(name), "", *_used_in(name)]
    related = [] if "See Also\n" in (found.__doc__ or "") else [each for each in others if each != name][:_MAX_RELATED]
    links = [*(f":doc:`{each} </api/{each}>`" for each in related), ":doc:`Python reference </api>`"]
    lines += [f"See also: {', '.join(links)}", ""]
    if not isinstance(found, type):
        return "\n".join([*lines, f".. autofunction:: {full}", ""])
    if len(members := _members(found)) > 3:
        lines += _table([(f":py:obj:`{each} <{full}.{each}>`", value) for each, value in members])
    inherited = ["   :inherited-members:"] if found is commonlaw.Law else []
    return "\n".join([*lines, f".. autoclass:: {full}", "   :members:", *inherited, ""])


def _write_pages(app: Sphinx) -> None:
    """Write the pages of all public names, and touch only those that change."""
    folder = Path(app.srcdir, "api")
    folder.mkdir(exist_ok=True)
    blocks = re.findall(r"public-names:: (\S+)\n((?: +\S.*\n)+)", Path(app.srcdir, "api.rst").read_text())
    groups = [(module, names.split()) for module, names in blocks]
    pages = {folder / f"{name}.rst": _page(module, name, names) for module, names in groups for name in names}
    for old in {*folder.glob("*.rst")} - {*pages}:
        old.unlink()
    for file, text in pages.items():
        if not file.exists() or file.read_text() != text:
            file.write_text(text)


def _check_names(app: Sphinx) -> None:
    """Fail if the list of the reference leaves out a public function or class."""
    listed = set(Path(app.srcdir, "api.rst").read_text().split())
    modules = commonlaw, commonlaw.plots, commonlaw.datasets
    public = {name: getattr(module, name) for module in modules for name in module.__all__}
    documented = {name: found for name, found in public.items() if isinstance(found, type | FunctionType)}
    own = {name for name, found in documented.items() if found.__module__.startswith("commonlaw")}
    if missing := sorted(own - listed):
        raise ExtensionError(f"api.rst does not list {', '.join(missing)}")


class CommandHelp(SphinxDirective):
    """Shows what ``--help-all`` prints for every command."""

    def run(self) -> list[nodes.Node]:
        """Return the texts."""
        return [each for path, found in _commands(("commonlaw",), command) for each in self._shown(path, found)]

    def _shown(self, path: tuple[str, ...], found: click.Command) -> list[nodes.Node]:
        name = " ".join(path)
        context = click.Context(found, info_name=name, max_content_width=88, terminal_width=88)
        context.meta[ALL_OPTIONS] = True
        return [nodes.rubric(name, name), nodes.literal_block(text := found.get_help(context), text, language="none")]


def _commands(path: tuple[str, ...], found: click.Command) -> list[tuple[tuple[str, ...], click.Command]]:
    if not isinstance(found, click.Group):
        return [(path, found)]
    context = click.Context(found)
    inner = ((name, found.get_command(context, name)) for name in found.list_commands(context))
    return [(path, found), *(pair for name, each in inner if each for pair in _commands((*path, name), each))]


class FitSettings(SphinxDirective):
    """Lists the settings of a fit by name, with the defaults of `discover`, and others of `fit` and `refine`."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        given = {name: default for name, default, _ in setting_rows(FitOptions, "fit")}
        lines = [".. list-table::", "   :header-rows: 1", "", "   * - setting", "     - default", "     - meaning"]
        for name, default, text in setting_rows(FitOptions):
            own = f"; {given[name] or 'none'} in `fit` and `refine`" if given.get(name, default) != default else ""
            lines += [f"   * - ``{name}``", f"     - {default or 'none'}{own}", f"     - {text}"]
        return self.parse_text_to_nodes("\n".join([*lines, ""]))


class Drawing(SphinxDirective):
    """Draws the ``figure`` that its lines of Python make, in this process, as starting a kernel takes longer."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the figure as a part of the page."""
        names = dict[str, Any]()
        exec("\n".join(self.content), names)
        drawing = within(render(names["figure"], ".svg", text=True), Path(self.env.docname).name)
        return [nodes.raw("", f"<div class='drawing'>{drawing}</div>", format="html")]


class NamedModels(SphinxDirective):
    """Lists the named models by their fields: formula, equations, variables, parameters and source of each."""

    def run(self) -> list[nodes.Node]:
        """Return a section for each field, and in it one for each model."""
        lines, field = list[str](), ""
        for name, model in commonlaw.named_models.items():
            if model.field != field:
                field = model.field
                lines += [f"## {field}", ""]
            symbols = {**model.variables, **model.parameters}
            lines += [f"({name})=", f"### {model.title}", "", "$$", model.to_latex(), "$$", ""]
            lines += [f"`{name}`: `{model.equations}`", ""]
            lines += [f"- `{symbol}`: {meaning}" for symbol, meaning in symbols.items()]
            lines += ["", f"Source: {model.source}.", ""]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


class Quantities(SphinxDirective):
    """Lists the quantities of laws by their forms, with their formulas."""

    def run(self) -> list[nodes.Node]:
        """Return a section for each form; of several ways to write one the quantities of the first."""
        lines, shown = list[str](), set[str]()
        for form in forms():
            more = "; further terms without a state may be added" if form.forced else ""
            if form.title not in shown:
                lines += [f"### {form.title}", ""]
            lines += [f"`{equations}`{more}", ""] if (equations := "`, `".join(form.equations)) else []
            if form.title not in shown:
                lines += ["| quantity | symbol | formula |", "|---|---|---|"]
                lines += [f"| {name} | {symbol} | `{formula}` |" for name, symbol, formula, *_ in form.quantities]
            lines.append("")
            shown.add(form.title)
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


class Messages(SphinxDirective):
    """Lists the messages of a topic by their codes, each with an anchor of that name; ``notes`` is a topic too."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return what the topic is about, and of each code what it says and for notes what it means and what to do."""
        (name,) = self.arguments
        if name == "notes":
            entries = {
                code: [
                    each["text"],
                    f"{each['kind'].capitalize()}: {kinds()[each['kind']]}",
                    f"Remedy: {each['remedy']}.",
                ]
                for code, each in notes().items()
            }
            found = list[nodes.Node]()
        else:
            topic = topics().get(name, {"about": "", "page": ""})
            entries = {
                code: [text] for code, text in sentences().items() if topic_of(code) == name.replace("others", "")
            }
            found = self.parse_text_to_nodes(f"{topic['about']} {{doc}}`{topic['page']}`") if topic["about"] else []
        for code, paragraphs in sorted(entries.items()):
            found.append(nodes.rubric("", code, ids=[code]))
            found += [nodes.paragraph("", template(each)) for each in paragraphs]
        return found


def _inline_math(translator: Any, node: nodes.math) -> None:
    translator.body.append(formula(node.astext()))
    raise nodes.SkipNode


def _displayed_math(translator: Any, node: nodes.math_block) -> None:
    shown, anchor = formula(node.astext(), "block"), ""
    if node["number"]:
        shown += f"<span class='eqno'>({get_node_equation_number(translator, node)})</span>"
        anchor = f" id='{node['ids'][0]}'"
    translator.body.append(f"<p class='formula'{anchor}>{shown}</p>")
    raise nodes.SkipNode


_SHORT, _MANY_COLUMNS, _LONGEST_LINE = 28, 4, 100
"""Letters up to which a cell stays on one line, and columns of tables whose cells do; letters of a line of columns."""
_COLUMNS = re.compile(r"\S {2,}\S")


def _for_phones(_: Sphinx, doctree: nodes.document, __: str) -> None:
    """Mark short cells of wide tables, and printed columns, so that they scroll in place of being broken."""
    for group in doctree.findall(nodes.tgroup):
        if group["cols"] >= _MANY_COLUMNS:
            for cell in group.findall(nodes.entry):
                cell["classes"].append("short" if len(cell.astext()) <= _SHORT else "prose")
    for block in doctree.findall(nodes.literal_block):
        lines = block.astext().splitlines()
        if sum(map(bool, map(_COLUMNS.search, lines))) > 1 and max(map(len, lines)) <= _LONGEST_LINE:
            block["classes"].append("columns")


def _check_links(app: Sphinx, failed: Exception | None) -> None:
    """Fail if a page leads to what is not there, or loads anything from elsewhere."""
    if failed or app.builder.name != "html":
        return
    root = Path(app.outdir)
    pages = {page.resolve(): page.read_text() for page in root.rglob("*.html")}
    anchors = {page: {*re.findall(r'\bid="([^"]+)"', text)} for page, text in pages.items()}
    faults = []
    for page, text in pages.items():
        faults += [f"{page}: loads {each}" for each in re.findall(r'<(?:script|img|link)[^>]*?"(https?:[^"]+)"', text)]
        for link in map(unescape, re.findall(r'\b(?:href|src)="(?![a-z]+:)([^"]*)"', text)):
            file, _, anchor = link.partition("#")
            target = (page.parent / unquote(file.partition("?")[0])).resolve() if file else page
            if not target.exists() or (anchor and target in pages and unquote(anchor) not in anchors[target]):
                faults.append(f"{page}: leads to {link}, which is not there")
    if faults:
        raise ExtensionError("\n".join(faults))


def setup(app: Sphinx) -> None:
    """Add the directives, and formulas as MathML, which browsers draw by themselves."""
    if not nb_execution_excludepatterns:
        app.tags.add("measured_drops")
    app.add_directive("public-names", PublicNames)
    app.add_directive("command-help", CommandHelp)
    app.add_directive("messages", Messages)
    app.add_directive("drawing", Drawing)
    app.add_directive("named-models", NamedModels)
    app.add_directive("quantities", Quantities)
    app.add_directive("fit-options", FitSettings)
    app.connect("builder-inited", _check_names)
    app.connect("builder-inited", _write_pages)
    app.connect("doctree-resolved", _for_phones)
    app.connect("build-finished", _check_links)
    app.add_html_math_renderer("mathml", (_inline_math, None), (_displayed_math, None))
