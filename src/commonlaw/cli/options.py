"""Options in groups, each under a heading of its own in the help of a command."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from functools import wraps
from typing import Any

import click

from commonlaw.diagnostics import Dialect

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


def dialect(command: click.Command) -> Dialect:
    """Return what writes settings as the options of a command: ``time='t'`` is ``--time t``.

    A list is an option that is repeated, a mapping one of ``NAME=VALUE``; what is no option stays Python.
    """
    options = {each.name: max(each.opts, key=len) for each in command.params}

    def write(code: str) -> str:
        name, _, value = code.partition("=")
        if code == "clip_irregular()":
            return "--clip"
        return " ".join(f"{options[name]} {text}" for text in _texts(value, write)) if name in options else code

    return write


def _texts(value: str, write: Dialect) -> list[str]:
    """Return the texts that an option takes for a value in Python; settings within it are written by `write`."""
    if value.startswith("["):
        return value[1:-1].split(", ")
    if value.startswith("{"):
        return re.sub(r"'([^']*)': ", r"\1=", value[1:-1]).split(", ") if value != "{}" else ["''"]
    if made := re.fullmatch(r"(\w+(?:Regression|Likelihood))\((.*)\)", value):
        words = re.sub(r"(?<!^)(?=[A-Z])", "-", made[1]).lower()
        return [" ".join([words, *(write(each) for each in made[2].split(", ") if each)])]
    return [value]


def in_options(text: str) -> str:
    """Return a message whose code, between backticks, is in the words of the command that runs.

    In threads of its own a command is not known, and a message stays as it is.
    """
    context = click.get_current_context(silent=True)
    write = dialect(context.command) if context else str
    return re.sub(r"`(\w+=[^`]*|clip_irregular\(\))`", lambda found: write(found[1]), text)


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
