"""What commonlaw says of input and of results: a code with parameters. The sentences stand in one catalogue.

The catalogue is ``diagnostics.toml``: a sentence for each code, with the parameters as fields of `str.format`. Of lists
``{names:, }`` joins the items by commas, ``{names:or}`` and ``{names:and}`` by a word, and ``{names:repr or}`` quotes
them; ``{n:count trial}`` writes "1 trial", "2 trials". What stands between backticks is Python; a front end writes it
in its own way, see `Dialect`. Besides sentences the catalogue has topics, which say what the errors of a field have in
common, and the meaning of each kind of note.
"""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache
from importlib.resources import files
from itertools import chain
from string import Formatter
from typing import Any

from commonlaw.text import counted

DOCUMENTATION = ""
"""Address of the published documentation with a slash at its end; empty as long as it is not published."""

Dialect = Callable[[str], str]
"""Writes a piece of Python, such as ``time='t'``, as a front end calls it: ``--time t``."""


def marked(code: str) -> str:
    """Return a piece of Python between backticks, which a front end finds again in a text."""
    return f"`{code}`"


_WORDS = {"and": " and ", "or": " or "}


@dataclass(frozen=True)
class Diagnostic:
    """A message: a code, the parameters of its sentence, and where it applies.

    Parameters
    ----------
    code
        Names the sentence of the catalogue.
    parameters
        Fill in the sentence: numbers, texts, lists of these, or further diagnostics.
    where
        The file, object or trial concerned; it stands before the sentence. Empty where the whole is concerned.

    Examples
    --------
    >>> print(Diagnostic("trial-index", {"trials": 2, "error": "there is no trial 5"}))
    there are 2 trials, counted from 0: there is no trial 5
    """

    code: str
    parameters: Mapping[str, object] = field(default_factory=dict)
    where: str = ""

    @property
    def codes(self) -> tuple[str, ...]:
        """This code, and those of the diagnostics among the parameters."""
        inner = [parameter for parameter in self.parameters.values() if isinstance(parameter, Diagnostic)]
        return (self.code, *chain.from_iterable(diagnostic.codes for diagnostic in inner))

    def at(self, where: str) -> "Diagnostic":
        """Return the same message, with a further place before it."""
        return replace(self, where=f"{where}: {self.where}" if self.where else where)

    def sentence(self, dialect: Dialect = str) -> str:
        """Return the sentence in the dialect of a front end; by default as Python."""
        return (f"{self.where}: " if self.where else "") + filled(sentences()[self.code], self.parameters, dialect)

    def __str__(self) -> str:
        return self.sentence()


def filled(sentence: str, parameters: Mapping[str, object], dialect: Dialect = str) -> str:
    """Return a sentence of the catalogue with its parameters, and what stands between backticks in a dialect."""
    writer = _Writer(dialect)
    written = [writer.vformat(piece, (), parameters) for piece in sentence.split("`")]
    written[1::2] = map(dialect, written[1::2])
    return "".join(written)


def sentences() -> Mapping[str, str]:
    """Return the messages of the catalogue: a sentence for each code."""
    return _catalogue()[0]


def notes() -> Mapping[str, Mapping[str, str]]:
    """Return the notes on results of the catalogue: kind, text and remedy for each code."""
    return _catalogue()[1]


def topics() -> Mapping[str, Mapping[str, Any]]:
    """Return the topics of errors: the beginnings of their codes, what they are about, and a page of documentation."""
    return _catalogue()[2]


def kinds() -> Mapping[str, str]:
    """Return what each kind of note means."""
    return _catalogue()[3]


def topic_of(code: str) -> str:
    """Return the topic with the longest beginning of the code of an error; empty if it has none."""
    beginnings = {beginning: name for name, topic in topics().items() for beginning in topic["codes"]}
    parts = code.split("-")
    beginnings_of_code = ("-".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((beginnings[beginning] for beginning in beginnings_of_code if beginning in beginnings), "")


def reference(code: str) -> str:
    """Return where a message is explained: its address, or the command that explains it.

    >>> reference("time-missing")
    'commonlaw help time-missing'
    """
    return f"{DOCUMENTATION}messages.html#{code}" if DOCUMENTATION else f"commonlaw help {code}"


def template(sentence: str) -> str:
    """Return a sentence of the catalogue with the names of its fields between angle brackets.

    >>> template("{trial} has {n:count sample}: give `start={{{name!r}: ...}}`")
    '<trial> has <n>: give `start={<name>: ...}`'
    """
    return "".join(text + (f"<{name}>" if name else "") for text, name, *_ in Formatter().parse(sentence))


def meaning(code: str) -> str:
    """Return what the catalogue has on a message, in paragraphs: its sentence, what it means, and what to do.

    Raises
    ------
    KeyError
        If the catalogue does not have this code.
    """
    page = "{}.html".format if DOCUMENTATION else "docs/{}.md".format
    if code in notes():
        note = notes()[code]
        paragraphs = [f"{code}: a note on a result ({note['kind']})", note["text"], kinds()[note["kind"]]]
        return template("\n\n".join([*paragraphs, f"What to do: {note['remedy']}."]))
    paragraphs = [f"{code}: an error; nothing was computed", template(sentences()[code])]
    if topic := topics().get(topic_of(code)):
        paragraphs += [topic["about"], f"Read more: {DOCUMENTATION}{page(topic['page'])}"]
    return "\n\n".join(paragraphs)


@cache
def _catalogue() -> tuple[dict[str, str], dict[str, dict[str, str]], dict[str, dict[str, Any]], dict[str, str]]:
    read = tomllib.loads(files("commonlaw").joinpath("diagnostics.toml").read_text(encoding="utf-8"))
    tables = [read.pop(name) for name in ("notes", "topics", "kinds")]
    return read, tables[0], tables[1], tables[2]


_LONGEST = 400
"""Characters of a name or another text in a sentence; of a longer one beginning and end are shown."""


_MOST = 50
"""Items of a list in a sentence."""


class _Writer(Formatter):
    """Fills in a sentence."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, Diagnostic):
            return value.sentence(self.dialect)
        if format_spec.startswith("count "):
            return counted(value, format_spec.removeprefix("count "))
        if format_spec and isinstance(value, list | tuple | Mapping):
            joint = format_spec.removeprefix("repr ")
            written = [
                _shortened(repr(item)) if joint != format_spec else self.format_field(item, "") for item in value
            ]
            if len(written) > _MOST:
                written[_MOST // 2 : -_MOST // 2] = ["..."]
            return _WORDS.get(joint, joint).join(written)
        return _shortened(value) if isinstance(value, str) else format(value, format_spec)


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]}...{text[-_LONGEST // 2 :]}"


class OutcomeKind(StrEnum):
    """The kinds of notes on results, as messages and saved laws name them; the catalogue has their meanings."""

    AMBIGUOUS = "ambiguous"
    APPROXIMATION = "approximation"
    BOUND = "bound"
    CHOSEN = "chosen"
    COPIES = "copies"
    DISCRETE_TIME = "discrete time"
    DIVERGED = "diverged"
    EMPTY_SUPPORT = "empty support"
    ERRORS = "errors"
    FEW_SAMPLES = "few samples"
    ILL_CONDITIONED = "ill-conditioned"
    METHOD = "method"
    MODEL_ERROR = "model error"
    NOISE = "noise"
    NOT_CONVERGED = "not converged"
    NOT_IDENTIFIABLE = "not identifiable"
    NOT_INTEGRATED = "not integrated"
    OBJECTS_DIFFER = "objects differ"
    ONE_OBJECT = "one object"
    RATES = "rates"
    RESIDUALS = "residuals"
    SAMPLES = "samples"
    SCALE = "scale"
    START = "start"
    STOPPED = "stopped"
    TRIALS_DIFFER = "trials differ"
    UNITS = "units"


@dataclass(frozen=True)
class Outcome:
    """Something that a user should know about a result that was reached all the same.

    Parameters
    ----------
    kind
        Its name.
    where
        The equation, object or trial that it concerns; empty when it concerns the whole.
    text
        What happened, with its numbers.
    remedy
        What to do about it.
    code
        Names text and remedy in the catalogue; empty for what a law of an earlier version has on record.
    """

    kind: OutcomeKind
    where: str
    text: str
    remedy: str
    code: str = ""

    def __str__(self) -> str:
        index = f" ({self.where})" if self.where else ""
        return f"{self.kind}{index}: {self.text}; {self.remedy}" + (f" [{self.code}]" if self.code else "")


def is_note(text: str, code: str, where: str) -> bool:
    """Return whether a text is that of a note of the catalogue on something, see `note`."""
    return text.startswith(f"{notes()[code]['kind']} ({where}): ") and text.endswith(f" [{code}]")


def note(code: str, where: str = "", /, **parameters: object) -> Outcome:
    """Return a note of the catalogue, its sentences filled in; code in them stays between backticks.

    >>> print(note("trials-differ", objects="2 (Ann, Ben)").kind)
    trials differ
    """
    entry = notes()[code]
    text, remedy = (filled(entry[part], parameters, marked) for part in ("text", "remedy"))
    return Outcome(OutcomeKind(entry["kind"]), where, text, remedy, code)
