"""Whatever texts of a report say, only elements that are known reach its page, and none that does anything."""

from html.parser import HTMLParser

from hypothesis import given, strategies as st

from commonlaw.errors import CommonlawError
from commonlaw.report.markup import formula, inline, markdown

SHOWS = {"a", "blockquote", "br", "code", "em", "hr", "li", "ol", "p", "pre", "s", "strong", "ul"}
MATHEMATICS = {
    "math", "menclose", "mfrac", "mi", "mn", "mo", "mover", "mpadded", "mphantom", "mroot", "mrow", "mspace", "msqrt",
    "mstyle", "msub", "msubsup", "msup", "mtable", "mtd", "mtext", "mtr", "munder", "munderover",
}  # fmt: skip
ACTS = {"class", "href", "id", "src", "style"}

PIECES = st.sampled_from([
    "<script>", "</script>", "<img/src=x/onerror=alert(1)>", "javascript:alert(1)", "https://example.org", "&lt;",
    "$", "$$", r"\text{", r"\href{", r"\style{", r"\frac{", r"\begin{matrix}", r"\left(", r"\right)", "{",
    "}", "[", "](", ")", "`", "**", "~~", ">", "-", "#", '"', "=", "_", "^", "\\", "1", "x", "\n", " ", "\x1b", "\0",
])  # fmt: skip
COMMANDS = st.sampled_from(["text", "mathrm", "href", "style", "class", "color", "frac", "sqrt", "operatorname"])
FORMULAS = st.builds("\\{}{{{}}}{{{}}}".format, COMMANDS, PIECES, PIECES)
TEXTS = st.lists(PIECES | FORMULAS | FORMULAS.map("${}$".format) | st.text(max_size=3)).map("".join)


class Page(HTMLParser):
    """The tags of a page, and what its attributes are."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.attributes = set(), []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]


def made(render, text):
    """Return what a text becomes, or nothing where its formulas are refused."""
    try:
        return render(text)
    except CommonlawError:
        return ""


@given(TEXTS)
def test_only_elements_that_show_something_reach_a_page(text):
    for render in (markdown, inline):
        page = Page(made(render, text))
        assert page.tags <= SHOWS | MATHEMATICS
        acting = {attribute for attribute in page.attributes if attribute[1] in ACTS or attribute[1].startswith("on")}
        links = {each for each in acting if each[:2] == ("a", "href")}
        assert {each[:2] for each in acting - links} <= {("code", "class")}
        assert not any(value.startswith(("javascript:", "data:")) for _, _, value in links)


@given(TEXTS)
def test_a_formula_is_mathematics_only(text):
    page = Page(made(formula, text))
    assert page.tags <= MATHEMATICS
    assert not {name for _, name, _ in page.attributes} & ACTS
