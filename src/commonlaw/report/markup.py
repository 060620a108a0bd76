"""Markdown with mathematics as HTML."""

import re
from collections.abc import Callable
from functools import cache
from html import escape, unescape
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, fromstring

from commonlaw.errors import CommonlawError

if TYPE_CHECKING:
    from markdown_it import MarkdownIt

# Code, which stays as it is, or a formula between one or two dollar signs
_CODE_OR_FORMULA = re.compile(r"(`+)[^`]+\1|(?<!\\)(\${1,2})([^$]+)\2")
_MARK = "\ue000{}\ue001"
_MARKED = re.compile("\ue000(\\d+)\ue001")
_SIGNS = {"mfrac": "/", "msup": "^", "msub": "_"}


def markdown(text: str) -> str:
    """Return paragraphs as HTML; what looks like HTML in the text is shown as it stands.

    Raises
    ------
    CommonlawError
        If a formula cannot be read.

    >>> print(markdown("the *law* $x$ < 1").strip())
    <p>the <em>law</em> <math ...><mrow><mi>x</mi></mrow></math> &lt; 1</p>
    """
    return _with_formulas(text, _parser().render, formula)


def inline(text: str) -> str:
    """Return one line as HTML, without a paragraph around it."""
    return _with_formulas(text, _parser().renderInline, formula)


def plain(text: str) -> str:
    """Return one line as bare text, for those who hear it.

    >>> plain("**Drag** is $F = \\\\frac{1}{2} C v^2$ & small")
    'Drag is F=1/2Cv^2 & small'
    """
    html = _with_formulas(text, _parser().renderInline, lambda latex, _: escape(_read(fromstring(formula(latex)))))
    return unescape(re.sub("<[^>]*>", "", html))


def formula(latex: str, display: str = "inline") -> str:
    """Return LaTeX mathematics as MathML, which browsers draw by themselves.

    Raises
    ------
    CommonlawError
        If it cannot be read, or has a command that is not known.
    """
    from latex2mathml.converter import convert

    try:
        mathml = str(convert(latex, display=display))
        fromstring(mathml)
    # The errors of that package have no class in common
    except Exception as error:
        raise CommonlawError(f"cannot read the formula {latex!r}: {type(error).__name__}; mend its LaTeX") from error
    unread = re.search(r"\\\w+", mathml)
    if unread:
        raise CommonlawError(f"cannot read {unread[0]!r} in the formula {latex!r}; write it in other LaTeX commands")
    return mathml


def _with_formulas(text: str, render: Callable[[str], str], show: Callable[[str, str], str]) -> str:
    """Render text whose formulas are put aside meanwhile, as Markdown would take their signs for its own."""
    formulas: list[str] = []

    def put_aside(match: re.Match[str]) -> str:
        if match[1]:
            return match[0]
        formulas.append(show(match[3], "inline" if match[2] == "$" else "block"))
        return _MARK.format(len(formulas) - 1)

    rendered = render(_CODE_OR_FORMULA.sub(put_aside, text))
    return _MARKED.sub(lambda match: formulas[int(match[1])], rendered)


def _read(element: Element) -> str:
    """Return a formula as one would read it out."""
    sign = _SIGNS.get(element.tag.rpartition("}")[2], "")
    return sign.join(_read(each) for each in element) or element.text or ""


@cache
def _parser() -> "MarkdownIt":
    from markdown_it import MarkdownIt

    # This preset shows HTML as text. Headings and pictures are the report's own, and tables have their captions there
    return MarkdownIt("js-default").disable(["heading", "lheading", "image", "table"])
