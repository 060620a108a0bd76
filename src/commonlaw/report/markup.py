"""From Markdown and LaTeX to the markup of a page."""

import re
from collections.abc import Iterator, Sequence
from functools import cache
from html import unescape
from itertools import pairwise
from typing import TYPE_CHECKING
from xml.etree.ElementTree import tostring

from commonlaw.errors import CommonlawError
from commonlaw.law import Law, to_latex
from commonlaw.law.law import shares_terms
from commonlaw.law.misfit import misfit_lines
from commonlaw.law.pooling import by_properties
from commonlaw.law.printing import latex_lefts, latex_structure, start_lines
from commonlaw.law.simplify import within_errors
from commonlaw.law.text import aligned
from commonlaw.runtime.packages import optional_import
from commonlaw.text import visible

if TYPE_CHECKING:
    from markdown_it import MarkdownIt
    from markdown_it.token import Token


def law_markdown(law: Law) -> str:
    """Return the equations of a law as Markdown, with shared numbers, a simpler form, and its misfit."""
    if not shares_terms(law) and len(law.objects) > 1:
        return "\n\n".join(["".join(_own(law)), *map(literal, misfit_lines(law))])
    shown = _displayed(law_latex(law), law.equations() if _has_numbers(law) else law.structure)
    below = [*start_lines(law), *within_errors(law), *by_properties(law), *misfit_lines(law)]
    return "\n\n".join([shown, *map(literal, below)])


def law_latex(law: Law) -> str:
    """Return the equations of a law whose objects share them as LaTeX that pages draw, see `law_markdown`."""
    return _broken(_spelled(_latex(law)))


def equation_parts(law: Law) -> list[list[str]]:
    """Return each equation of a law whose objects share them as LaTeX in parts, between which a line may break."""
    return parts_of(_latex(law))


def parts_of(latex: str) -> list[list[str]]:
    """Return each line of an ``aligned`` block in parts, between which a line may break."""
    _, *lines, _ = _spelled(latex).splitlines()
    parts = [_parts(line.removesuffix(r"\\").rstrip().replace("&", "", 1)) for line in lines]
    # An empty group before a sign leaves it between two things, so that it has space around it
    return [[first, *(f"{{}}{part}" for part in others)] for first, *others in parts]


def _latex(law: Law) -> str:
    return to_latex(law) if _has_numbers(law) else aligned(zip(latex_lefts(law), latex_structure(law), strict=True))


def _has_numbers(law: Law) -> bool:
    """Whether the equations hold for all objects with numbers in place of parameters."""
    return len(law.objects) == 1 or law.uncertainty.explanation is not None


def _own(law: Law, most: int = 6) -> Iterator[str]:
    """Yield the equations of the first objects, each with terms of its own."""
    for name in law.objects[:most]:
        yield f"\n\n**{literal(name)}**" + _displayed(_broken(_spelled(to_latex(law, name))), law.equations(name))
    if len(law.objects) > most:
        yield f"\n\nand {len(law.objects) - most} more objects with terms of their own."


def _spelled(latex: str) -> str:
    """Return LaTeX in which words that are multiplied have a space between them, and rates of words are fractions."""

    def rate(found: re.Match[str]) -> str:
        power = "^2" * (found[1] == "dd")
        return rf"\frac{{\mathrm{{d}}{power}\, {found[2]}}}{{\mathrm{{d}}t{power}}}"

    latex = re.sub(r"\\(d+)ot\{(\\mathrm\{(?:[^{}]|\{[^{}]*\})*\})\}", rate, latex)
    latex = re.sub(r"(?<=[\w}]) (?=\\mathrm)", r"\\, ", latex)
    latex = latex.replace(r" \pm ", r"\,\pm\, ")
    return re.sub(r"(10\^\{-?\d+\}) ", r"\1\\, ", latex)


def _broken(latex: str) -> str:
    """Return an ``aligned`` block whose long equations go on in further lines."""
    head, *lines, foot = latex.splitlines()
    rows = [row for line in lines for row in _rows(line.removesuffix(r"\\").rstrip())]
    return "\n".join([head, " \\\\\n".join(rows), foot])


def _rows(line: str) -> list[str]:
    """Return an equation as rows, none much longer than a line of text is."""
    rows = [""]
    for part in _parts(line):
        if rows[-1] and len(re.sub(r"\\[a-zA-Z]+|[{}\\ ]", "", (rows[-1] + part))) > 40:
            rows.append("")
        rows[-1] += part
    return [rows[0], *(rf"&\quad {row.strip()}" for row in rows[1:])]


def _parts(line: str) -> list[str]:
    """Return an equation cut before the signs that are outside of brackets."""
    cuts, depth = [0], 0
    for match in re.finditer(r"\\left\(|\\right\)|[{}]| [-+] ", line):
        if match[0].strip() in ("+", "-"):
            cuts += [match.start()] * (depth == 0 and line[match.start() - 1] != "=")
        else:
            depth += 1 if match[0] in (r"\left(", "{") else -1
    return [line[begin:end] for begin, end in pairwise([*cuts, len(line)])]


def _displayed(latex: str, text: tuple[str, ...]) -> str:
    """Return a formula on its own lines; as code where it cannot be drawn, as with names that LaTeX cannot write."""
    try:
        formula(latex)
    except CommonlawError:
        return code("\n".join(text))
    return f"\n\n$${' '.join(latex.split())}$$\n\n"


_NEED = "making a report"
_ATTRIBUTES = {
    "accent", "align", "columnalign", "columnlines", "columnspacing", "depth", "display", "displaystyle", "fence",
    "form", "height", "largeop", "linebreak", "linethickness", "lspace", "mathbackground", "mathcolor", "mathsize",
    "mathvariant", "maxsize", "minsize", "movablelimits", "notation", "rowlines", "rowspacing", "rspace",
    "scriptlevel", "separator", "stretchy", "voffset", "width", "xmlns",
}  # fmt: skip
"""What an element of a formula may have; not among them are links and styles."""


def markdown(text: str) -> str:
    """Return paragraphs as HTML; what looks like HTML in the text is shown as it stands.

    >>> print(markdown("the *law* $x$ < 1").strip())
    <p>the <em>law</em> <math ...><mrow><mi>x</mi></mrow></math> &lt; 1</p>
    """
    return str(_parser().render(visible(text)))


def inline(text: str) -> str:
    """Return one line as HTML, without a paragraph around it."""
    return str(_parser().renderInline(visible(text)))


def literal(text: str) -> str:
    r"""Return a text as Markdown that shows it as it stands.

    >>> print(inline(literal("a *b* $c$ [d](e)")))
    a *b* $c$ [d](e)
    """
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", text)


def code(text: str, language: str = "") -> str:
    """Return lines of code as Markdown.

    >>> print(code("x = 1").strip())
    ```
    x = 1
    ```
    """
    fence = "`" * max(3, *(1 + len(run) for run in re.findall("`+", text)), 3)
    return f"\n\n{fence}{language}\n{text.rstrip()}\n{fence}\n\n"


def formula(latex: str, display: str = "inline") -> str:
    """Return LaTeX mathematics as MathML; raises `CommonlawError` for syntax errors, links and styles."""
    convert_to_element = optional_import("latex2mathml.converter", _NEED, "report").convert_to_element
    try:
        # That package draws the other name of this environment alone
        tree = convert_to_element(latex.replace("{aligned}", "{split}"), display=display)
    # The errors of that package have no class in common
    except Exception as error:
        raise CommonlawError("formula-syntax", latex=latex, problem=type(error).__name__) from error
    for element in tree.iter():
        # The package writes some signs as HTML does
        element.text = unescape(element.text or "")
        if more := set(element.attrib) - _ATTRIBUTES:
            raise CommonlawError("formula-forbidden", latex=latex, command=min(more))
        if unread := re.search(r"\\\w+", element.text):
            raise CommonlawError("formula-unread", command=unread[0], latex=latex)
        # Dots of derivatives are hard to see at the size that fonts draw them in
        if element.tag.endswith("mo") and element.text and element.text in "˙¨":
            element.set("mathsize", "150%")
    return tostring(tree, encoding="unicode")


@cache
def _parser() -> "MarkdownIt":
    markdown_it = optional_import("markdown_it", _NEED, "report")
    dollarmath = optional_import("mdit_py_plugins.dollarmath", _NEED, "report")
    # This preset shows HTML as text. Headings and pictures are the report's own, and tables have their captions there
    parser: MarkdownIt = markdown_it.MarkdownIt("js-default").disable(["heading", "lheading", "image", "table"])
    dollarmath.dollarmath_plugin(parser, double_inline=True)
    parser.disable("math_block")  # A formula on its own line stays in its paragraph

    def show(_: object, tokens: "Sequence[Token]", index: int, *__: object) -> str:
        return formula(tokens[index].content, "block" if tokens[index].markup == "$$" else "inline")

    for kind in ("math_inline", "math_inline_double"):
        parser.add_render_rule(kind, show)
    return parser
