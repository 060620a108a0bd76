"""Options in groups, each under a heading of its own in the help of a command."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from functools import wraps
from typing import Any

import click

Decorator = Callable[[Callable[..., None]], Callable[..., None]]


class GroupedOption(click.Option):
    """An option that stands under a heading."""

    def __init__(self, *args: Any, group: str, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.group = group


def option(group: str, *names: str, **settings: Any) -> Decorator:
    """Return the decorator that adds an option under a heading."""
    return click.option(*names, cls=GroupedOption, group=group, **settings)


def with_options(command: Callable[..., None], options: Sequence[Decorator]) -> Callable[..., None]:
    """Add options to a command; its help lists them in this order."""
    for each in reversed(options):
        command = each(command)
    return command


def as_one(name: str, kind: type, options: Sequence[Decorator]) -> Decorator:
    """Return the decorator that adds options to a command, which receives them as one argument of this name.

    It is a dataclass with a field for each of them; what adds its own argument to a command may be among the options.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def wrapped(**values: Any) -> None:
            own = {field.name: values.pop(field.name) for field in fields(kind) if field.name in values}
            command(**{name: kind(**own)}, **values)

        return with_options(wrapped, options)

    return decorate


def in_options(text: str) -> str:
    """Return a message of the library in the words of the command that runs: ``time=...`` becomes ``--time ...``.

    In threads of its own a command is not known, and a message stays as it is.
    """
    context = click.get_current_context(silent=True)
    if context is None:
        return text
    params = context.command.params
    words = {f"{each.name}=": f"{max(each.opts, key=len)} " for each in params} | {"clip_irregular()": "--clip"}
    text = re.sub(rf"(?<![\w:'-])({'|'.join(map(re.escape, words))})", lambda found: words[found[1]], text)
    text = re.sub(r"(--\S+ )\[(.*?)\]", lambda found: found[1] + found[2].replace(", ", f" {found[1]}"), text)
    text = re.sub(r"(--\S+ )\{\}", r"\1''", re.sub(r"(--\S+ )\{'(.*?)': (.*?)\}", r"\1\2=\3", text))
    return re.sub(r"(\w+)(Regression|Likelihood)\((.*?)\)", _method, text)


def _method(found: re.Match[str]) -> str:
    name = re.sub(r"(?<!^)(?=[A-Z])", "-", f"{found[1]}{found[2]}")
    return f"{name} {found[3]}".lower().rstrip()


def pairs(name: str, texts: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield name and value of texts like ``NAME=VALUE`` that an option got; any other text is wrong usage."""
    for text in texts:
        key, sign, value = text.partition("=")
        if not (key and sign and value):
            raise click.UsageError(f"{name} {text!r} is not of the form NAME=VALUE")
        yield key.strip(), value.strip()


def by_name(name: str, texts: Sequence[str]) -> dict[str, str]:
    """Return the values that an option gives by name; two for one name are wrong usage."""
    found: dict[str, str] = {}
    for key, value in pairs(name, texts):
        if key in found:
            raise click.UsageError(f"{name} gives {key} twice, {found[key]} and {value}: give it once")
        found[key] = value
    return found


def numbers(name: str, texts: Sequence[str]) -> dict[str, float]:
    """Return the numbers that an option gives by name."""
    found = {}
    for key, text in by_name(name, texts).items():
        try:
            found[key] = float(text)
        except ValueError:
            raise click.UsageError(f"{name} {key}={text}: {text!r} is not a number") from None
    return found


def number_or_text(text: str) -> float | str:
    """Return the number that a text is, or the text itself."""
    try:
        return float(text)
    except ValueError:
        return text
