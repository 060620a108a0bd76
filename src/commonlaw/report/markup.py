"""Markdown with mathematics as HTML."""

import re
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape, unescape
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, fromstring, tostring

from commonlaw.errors import CommonlawError
from commonlaw.extras import optional_import
from commonlaw.names import visible

if TYPE_CHECKING:
    from markdown_it import MarkdownIt
    from markdown_it.token import Token

_NEED = "making a report"
_SIGNS = {"mfrac": "/", "msup": "^", "msub": "_"}
_ALOUD = {"aloud": True}
_DOTS, _DOT_SIZE = "˙¨", "150%"
"""Of derivatives, which are hard to see at the size that fonts draw them in."""
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
    fence = "`" * max(3, *(1 + len(each) for each in re.findall("`+", text)), 3)
    return f"\n\n{fence}{language}\n{text.rstrip()}\n{fence}\n\n"


def plain(text: str) -> str:
    """Return one line as bare text, for those who hear it.

    >>> plain("**Drag** is $F = \\\\frac{1}{2} C v^2$ & small")
    'Drag is F=1/2Cv^2 & small'
    """
    return unescape(re.sub("<[^>]*>", "", _parser().renderInline(visible(text), _ALOUD)))


def formula(latex: str, display: str = "inline") -> str:
    """Return LaTeX mathematics as MathML, which browsers draw by themselves.

    Raises
    ------
    CommonlawError
        If it cannot be read, or does more than mathematics does: links and styles.
    """
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
        if element.tag.endswith("mo") and element.text and element.text in _DOTS:
            element.set("mathsize", _DOT_SIZE)
    return tostring(tree, encoding="unicode")


def _show(_: object, tokens: "Sequence[Token]", index: int, __: object, env: Mapping[str, Any]) -> str:
    """Render a formula: as MathML, or as text where the page is read out."""
    token = tokens[index]
    mathml = formula(token.content, "block" if token.markup == "$$" else "inline")
    return escape(_read(fromstring(mathml))) if env == _ALOUD else mathml


def _read(element: Element) -> str:
    """Return a formula as one would read it out."""
    sign = _SIGNS.get(element.tag.rpartition("}")[2], "")
    return sign.join(_read(each) for each in element) or element.text or ""


@cache
def _parser() -> "MarkdownIt":
    markdown_it = optional_import("markdown_it", _NEED, "report")
    dollarmath = optional_import("mdit_py_plugins.dollarmath", _NEED, "report")
    # This preset shows HTML as text. Headings and pictures are the report's own, and tables have their captions there
    parser: MarkdownIt = markdown_it.MarkdownIt("js-default").disable(["heading", "lheading", "image", "table"])
    dollarmath.dollarmath_plugin(parser, double_inline=True)
    parser.disable("math_block")  # A formula on its own line stays in its paragraph
    for kind in ("math_inline", "math_inline_double"):
        parser.add_render_rule(kind, _show)
    return parser
