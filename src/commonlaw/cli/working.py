"""How commands show that they work, how far they have come and how long it takes still."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread

import click

from commonlaw.cli.output import changing_line, say
from commonlaw.runtime.progress import Course, ProgressCallback

INTERVAL = 10.0
"""Seconds between lines where there is no terminal to show a line that changes."""


def verbose_option() -> click.Option:
    """Return the option that has every step said, with the seconds since the command began to work."""
    text = "Say on standard error what is done, step by step, with the seconds that have passed."
    return click.Option(["-v", "--verbose"], is_flag=True, expose_value=False, callback=_remember, help=text)


@contextmanager
def working(text: str) -> Iterator[ProgressCallback]:
    """Show on stderr that something is going on; yields what takes the text of each step.

    A terminal has one line that changes, and else there is a line now and then. With ``--verbose`` each step has one.
    """
    course = Course()
    if click.get_current_context().meta.get(_VERBOSE):
        yield lambda step: say(f"commonlaw: {course.seconds:6.1f} s  {step}", err=True)
        return
    with (changing_line if sys.stderr.isatty() else _lines)(lambda: f"{text} {course}"):
        yield course.take


_VERBOSE = f"{__name__}.verbose"


def _remember(context: click.Context, _: click.Parameter, value: bool) -> None:
    context.meta[_VERBOSE] = value


@contextmanager
def _lines(words: Callable[[], str]) -> Iterator[None]:
    """Say now and then what goes on."""
    ended = Event()

    def tell() -> None:
        while not ended.wait(INTERVAL):
            say(f"commonlaw: {words()}", err=True)

    thread = Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
