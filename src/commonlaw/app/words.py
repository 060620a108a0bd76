"""Messages of the library in the words of the page."""

import re

_COLUMNS = {
    "object": "object",
    "trial": "trial",
    "time": "time",
    "states": "state",
    "inputs": "input",
    "properties": "property",
}
"""What the page calls the settings that choose columns."""

_READING = {
    "dates": "the form of dates",
    "decimal": "the decimal mark",
    "missing": "a mark of missing values",
    "units": "the unit",
    "wide": "what the columns measure",
    "restarts": "what begins where the time goes back",
}
"""The same of other settings of how a table is read."""

_ONLY_IN_THE_COMMAND = {"clip_irregular()": "--clip", "order=0": "--order 0"}
"""What the page cannot do."""


def in_page(code: str) -> str:
    """Return a setting, written as an argument of a function, as the page calls it; the dialect of the page.

    >>> in_page("time=..."), in_page("trial='run'"), in_page("decimal=','")
    ("'time' under Columns", "trial 'run'", "',' as the decimal mark under Columns")
    >>> in_page("order=0")
    'the option --order 0 of the command'
    """
    name, _, value = code.partition("=")
    if code in _ONLY_IN_THE_COMMAND:
        return f"the option {_ONLY_IN_THE_COMMAND[code]} of the command"
    if name in _COLUMNS:
        return f"{_COLUMNS[name]!r} under Columns" if value in ("...", "[...]") else f"{_COLUMNS[name]} {value}"
    if name in _READING:
        return f"{_READING[name]} under Columns" if value == "..." else f"{value} as {_READING[name]} under Columns"
    return code


def text_in_page(text: str) -> str:
    """Return a text whose code, between backticks, is in the words of the page."""
    return re.sub(r"`(\w+=[^`]*|clip_irregular\(\))`", lambda found: in_page(found[1]), text)
