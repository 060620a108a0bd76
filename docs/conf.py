"""How Sphinx builds the site: `make docs`. Nothing in it is fetched from elsewhere when it is read."""

import re
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import click
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

import commonlaw
from commonlaw.cli.main import commonlaw as command
from commonlaw.report.markup import formula

project = "commonlaw"
author = "the maintainers of commonlaw"
version = release = "0.1"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "myst-nb", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
default_role = "code"
language = "en"

html_theme = "alabaster"
html_theme_options = {
    "description": "Find the law that repeated measurements have in common",
    "fixed_sidebar": True,
    "page_width": "68rem",
    "github_button": False,
}
html_static_path: list[str] = []
html_math_renderer = "mathml"
html_copy_source = html_show_sphinx = html_show_copyright = False

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "auto"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_class_signature = "separated"
napoleon_use_rtype = False
# Names of examples and of other packages, that no page here is about
nitpicky = False


class PublicNames(SphinxDirective):
    """Describes every public name by its docstring."""

    def run(self) -> list[nodes.Node]:
        """Return the descriptions."""
        lines = []
        for name in sorted(commonlaw.__all__, key=str.casefold):
            found = getattr(commonlaw, name)
            if isinstance(found, type):
                inherited = ["   :inherited-members:"] if found is commonlaw.Law else []
                lines += [f".. autoclass:: commonlaw.{name}", "   :members:", *inherited, ""]
            elif callable(found):
                lines += [f".. autofunction:: commonlaw.{name}", ""]
        return self.parse_text_to_nodes("\n".join(lines))


class CommandHelp(SphinxDirective):
    """Shows what ``--help`` prints for every command."""

    def run(self) -> list[nodes.Node]:
        """Return the texts."""
        return [each for path, found in _commands(("commonlaw",), command) for each in self._shown(path, found)]

    def _shown(self, path: tuple[str, ...], found: click.Command) -> list[nodes.Node]:
        name = " ".join(path)
        context = click.Context(found, info_name=name, max_content_width=88, terminal_width=88)
        return [nodes.rubric(name, name), nodes.literal_block(text := found.get_help(context), text, language="none")]


def _commands(path: tuple[str, ...], found: click.Command) -> list[tuple[tuple[str, ...], click.Command]]:
    if not isinstance(found, click.Group):
        return [(path, found)]
    context = click.Context(found)
    inner = ((name, found.get_command(context, name)) for name in found.list_commands(context))
    return [(path, found), *(pair for name, each in inner if each for pair in _commands((*path, name), each))]


def _inline_math(translator: Any, node: nodes.math) -> None:
    translator.body.append(formula(node.astext()))
    raise nodes.SkipNode


def _displayed_math(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f"<p>{formula(node.astext(), 'block')}</p>")
    raise nodes.SkipNode


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
    app.add_directive("public-names", PublicNames)
    app.add_directive("command-help", CommandHelp)
    app.connect("build-finished", _check_links)
    app.add_html_math_renderer("mathml", (_inline_math, None), (_displayed_math, None))
