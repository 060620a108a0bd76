"""Messages of the library in the words of the page."""

import re

_ROLES = {
    "object": "object",
    "trial": "trial",
    "time": "time",
    "states": "state",
    "inputs": "input",
    "properties": "property",
}
_PARTS = {
    ", or give it with units=...": "",
    "Name it with ": "Choose ",
    ", or method=DerivativeRegression()": "",
    "say restarts='trials' if a trial begins": "tick under Columns that a trial begins",
    "give the decimal mark, decimal='.' or decimal=','": "choose the decimal mark under Columns",
    "read them with wide='value', or the name of what was measured": "say under Columns what they measured",
    "clip_irregular() would keep": "the option --clip of the command would keep",
}


def in_page(text: str) -> str:
    """Return a message in which arguments of functions are what the page calls them.

    >>> in_page("Name it with time=...; columns: a, b")
    "Choose 'time' under Columns; columns: a, b"
    >>> in_page("say trial='run'")
    "say trial 'run'"
    """
    for part, words in _PARTS.items():
        text = text.replace(part, words)
    roles = rf"\b({'|'.join(_ROLES)})=(\.\.\.|\[\.\.\.\])"
    text = re.sub(r"say which with dates='.+", "choose under Columns how they are written", text)
    text = re.sub(r"missing=('.+?') reads", r"\1 under Columns, as a mark of missing values, reads", text)
    text = re.sub(r"or read it as missing: missing='.*'", "or name it under Columns as a mark of missing values", text)
    text = re.sub(roles, lambda found: f"{_ROLES[found[1]]!r} under Columns", text)
    return re.sub(rf"\b({'|'.join(_ROLES)})=('[^']*')", r"\1 \2", text)
