"""Whatever a name holds, it is shown as itself and nothing obeys it."""

import json
import re
import unicodedata

from hypothesis import given, strategies as st

from commonlaw.errors import CommonlawError
from commonlaw.library.notation import latex_name
from commonlaw.text import in_latex, in_line, visible

DANGERS = st.sampled_from("\x1b\x07\x9b\n\r\t\u202e\u2028\ud800\\{}^%$~日 ")
TEXTS = st.text(st.characters(codec=None) | DANGERS)
"""Any text, surrogates included, with much of what is dangerous."""

SAFE = {"Lu", "Ll", "Lt", "Lm", "Lo", "Mn", "Mc", "Me", "Nd", "Nl", "No", "Pc", "Pd", "Ps", "Pe", "Pi", "Pf", "Po"} | {
    "Sm", "Sc", "Sk", "So", "Zs"
}  # fmt: skip


def is_safe(text):
    return {unicodedata.category(each) for each in text} <= SAFE


@given(TEXTS)
def test_a_visible_text_has_nothing_that_a_terminal_obeys(text):
    assert is_safe(re.sub("[\n\t\u200c\u200d]", "", visible(text)))
    assert is_safe(re.sub("[\u200c\u200d]", "", in_line(text)))


@given(TEXTS)
def test_what_is_shown_twice_is_shown_the_same(text):
    assert visible(visible(text)) == visible(text)
    assert in_line(visible(text)) == in_line(in_line(text)) == in_line(text)


@given(TEXTS)
def test_lines_stay_lines_and_a_name_is_one(text):
    assert visible(text).split("\n") == [visible(line) for line in text.split("\n")]
    assert in_line(text).splitlines() in ([], [in_line(text)])


@given(st.text(st.characters(categories=["L", "M", "N", "P", "S", "Zs"])))
def test_a_text_without_controls_is_shown_as_it_is(text):
    assert visible(text) == in_line(text) == text


@given(st.recursive(TEXTS, lambda inner: st.lists(inner) | st.dictionaries(TEXTS, inner)))
def test_json_says_the_same_when_it_is_made_visible(document):
    for indent in (None, 1):
        assert json.loads(visible(json.dumps(document, indent=indent, ensure_ascii=False))) == document


@given(TEXTS)
def test_latex_of_a_name_is_one_line_that_opens_no_group_and_runs_no_command(text):
    for latex in (in_latex(text), latex_name(text)):
        assert "\n" not in latex
        without = re.sub(r"\\[#$%&_{} ]", "", latex)
        commands = set(re.findall(r"\\([A-Za-z]+|.)", without))
        assert commands <= {"backslash", "sim", "hat", "mathrm"} or latex == f"\\{text}"
        assert not re.search(r"[#$%&~^]", without)
        assert without.count("{") == without.count("}")


@given(TEXTS)
def test_an_error_is_one_line_whatever_it_names(text):
    assert (
        str(CommonlawError("other", text=f"unknown ball {text}: name another"))
        == f"unknown ball {in_line(text)}: name another"
    )
