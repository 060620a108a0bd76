"""Every message that the code can give has a sentence, and every sentence a place in the code that gives it."""

import ast
import pickle
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from string import Formatter

import pytest

import commonlaw
from commonlaw import CommonlawError
from commonlaw.diagnostics import Diagnostic, OutcomeKind, kinds, meaning, note, notes, sentences, topics
from commonlaw.errors import unknown
from commonlaw.likelihood import NotPositiveError

pytestmark = pytest.mark.xdist_group("catalogue")  # One worker reads all sources

_MAX_WORDS = 25
_REPLACED = re.compile(
    r"\b(nobody|tells?|told|says? nothing|does not know|besides?|alike|departs?|remembers?|honest|out of the question"
    r"|hangs?|sought|widening|constants inside|unseen|unmeasured|letters? inside|worth|judged?)\b"
)
"""Words of ordinary language where the field has a term, and verbs that only people can do."""
_REPLACED_IN_NAMES = re.compile(r"(^|_)(told|dearer|honest|alike|unseen|nobody|leftovers|drives|judge|verdict)(_|$)")
_UNSPECIFIC = {"own", "each", "found", "left", "said", "other"}

_SOURCES = sorted(Path(commonlaw.__file__).parent.rglob("*.py"))


@cache
def _nodes(path: Path) -> list[ast.AST]:
    return [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))]


def _given() -> Iterator[tuple[str, str, set[str]]]:
    """Yield where a message is given in the code, its code, and the names of its parameters."""
    for path in _SOURCES:
        for call in _nodes(path):
            if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.args):
                continue
            code = call.args[0]
            if not isinstance(code, ast.Constant):
                continue
            if call.func.id == "CommonlawError":
                names = {keyword.arg for keyword in call.keywords if keyword.arg} - {"where"}
            elif call.func.id == "note":
                names = {keyword.arg for keyword in call.keywords if keyword.arg}
            elif call.func.id == "Diagnostic":
                fields = call.args[1] if len(call.args) > 1 else ast.Dict([], [])
                if not isinstance(fields, ast.Dict):
                    continue
                names = {key.value for key in fields.keys if isinstance(key, ast.Constant)}
            else:
                continue
            yield f"{path.name}:{call.lineno}", str(code.value), {str(name) for name in names}


def _fields(sentence: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(sentence) if name}


def test_every_message_has_a_sentence_with_its_parameters() -> None:
    for place, code, names in _given():
        sentence = sentences().get(code) or "{0[text]} {0[remedy]}".format(notes()[code])
        assert _fields(sentence) == names, place


def test_every_sentence_is_given_somewhere() -> None:
    texts = {
        each.value
        for path in _SOURCES
        for each in _nodes(path)
        if isinstance(each, ast.Constant) and isinstance(each.value, str)
    }
    assert not (sentences().keys() | notes().keys()) - texts


def _texts() -> dict[str, str]:
    """Return every text of the catalogue: those of errors by their codes, of notes by code and part."""
    parts = {f"{code}.{part}": text for code, entry in notes().items() for part, text in entry.items()}
    return {**sentences(), **parts}


def test_code_in_a_sentence_is_closed() -> None:
    assert not [text for text in _texts().values() if text.count("`") % 2]


def test_sentences_are_short_and_in_the_terms_of_the_field() -> None:
    texts = {code: re.sub(r"`[^`]*`|\{[^{}]+\}", "CODE", text) for code, text in _texts().items()}
    lengths = {code: max(len(each.split()) for each in re.split(r"(?<=[.?!]) ", text)) for code, text in texts.items()}
    assert not [code for code, length in lengths.items() if length > _MAX_WORDS]
    assert not [code for code, text in texts.items() if _REPLACED.search(text)]


def test_public_names_are_terms_of_the_field() -> None:
    names = {*dir(commonlaw), *dir(commonlaw.Law), *dir(commonlaw.Trials)}
    assert not [name for name in names if name[0] != "_" and _REPLACED_IN_NAMES.search(name)]


def test_variables_are_named_by_what_they_hold() -> None:
    for path in _SOURCES:
        fields = {id(node.target) for node in _nodes(path) if isinstance(node, ast.AnnAssign)}
        names = [node for node in _nodes(path) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
        assert not [
            f"{path.name}:{node.lineno}: {node.id}"
            for node in names
            if node.id in _UNSPECIFIC and id(node) not in fields
        ]


def test_a_note_has_one_of_the_kinds_and_a_code_of_its_own() -> None:
    assert {entry["kind"] for entry in notes().values()} <= {*OutcomeKind}
    assert not notes().keys() & sentences().keys()
    found = note("estimate-at-bound", "Anna", name="K", end=0.0, estimate="-0.2 ± 0.1", within="", bound="K > 0")
    assert (found.code, found.kind, found.where) == ("estimate-at-bound", OutcomeKind.BOUND, "Anna")
    assert found.remedy == "check the equation, or leave K > 0 out"


def test_an_error_says_where_and_what_after_it_was_sent_to_another_process() -> None:
    error = pickle.loads(pickle.dumps(unknown("column", "hieght", ["t", "height"]).at("drops.csv")))
    assert str(error) == "drops.csv: unknown column 'hieght': did you mean 'height'? Known: t, height [unknown-name]"
    assert error.code == "unknown-name"


def test_errors_of_one_kind_stay_so_with_a_place_and_in_another_process() -> None:
    error = pickle.loads(pickle.dumps(NotPositiveError().at("a law")))
    assert isinstance(error, NotPositiveError)
    assert str(error).startswith("a law: the likelihood of this law cannot be computed")


def test_what_cannot_be_sent_to_another_process_stands_as_text() -> None:
    error = CommonlawError("download-name", name="law.zip", files={"law.json": lambda: None, "law.py": lambda: None})
    assert (
        str(pickle.loads(pickle.dumps(error)))
        == "there is no file 'law.zip': take one of law.json, law.py [download-name]"
    )


def test_a_front_end_writes_settings_its_own_way() -> None:
    error = CommonlawError("time-ambiguous", "drops.csv", columns=["t", "minutes"])
    assert error.sentence(lambda code: f"--{code.replace('=...', ' NAME')}") == (
        "drops.csv: which column holds the time, 't' or 'minutes'? Name it with --time NAME"
    )


def test_settings_in_lists_are_written_the_same_way() -> None:
    choices = [Diagnostic("dates-in-order", {"order": each}) for each in ("dmy", "mdy")]
    error = CommonlawError("dates-ambiguous", column="date", first="1/2/2024", ways="...", choices=choices)
    said = error.sentence(lambda code: f"--{code.replace('=', ' ')}")
    assert said.endswith("give --dates 'dmy' or --dates 'mdy'")


def test_names_with_backticks_stay() -> None:
    error = CommonlawError("unknown-name", kind="column", name="`a`", hint="", known=["b"])
    assert error.sentence(lambda _: "") == "unknown column '`a`': Known: b"


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"columns": ["a", "b"]}, "which column holds the time, 'a' or 'b'? Name it with time=..."),
        ({"columns": ["a"]}, "which column holds the time, 'a'? Name it with time=..."),
    ],
)
def test_lists_are_joined(parameters: dict[str, object], sentence: str) -> None:
    assert str(Diagnostic("time-ambiguous", parameters)) == sentence


def test_a_message_within_a_message_has_its_code_too() -> None:
    inner = unknown("variable", "w", ["x"])
    assert CommonlawError("term-syntax", term="w", error=inner).codes == ("term-syntax", "unknown-name")


def test_topics_and_kinds_explain_messages_that_exist() -> None:
    starts = {each for topic in topics().values() for each in topic["codes"]}
    assert not [start for start in starts if not any(f"{code}-".startswith(f"{start}-") for code in sentences())]
    assert {*kinds()} == {*OutcomeKind}
    pages = Path(commonlaw.__file__).parents[2] / "docs"
    assert all((pages / f"{topic['page']}.md").exists() for topic in topics().values())
    assert "What to do: add trials with other initial values of <first>." in meaning("confounded")
    assert "Read more: docs/data-format.md" in meaning("time-missing")


def test_names_of_any_length_and_lists_of_any_size_are_shortened() -> None:
    error = unknown("column", "b" * 10_000, [f"{i}" + "a" * 10_000 for i in range(10_000)])
    assert len(str(error)) < 25_000
    assert len(str(CommonlawError("candidate-name", text="a" * 10_000))) < 1000
    assert "...'" not in str(CommonlawError("candidate-name", text="a" * 300))
