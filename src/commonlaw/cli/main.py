"""The command `commonlaw`, what holds for each of its commands, and how it ends.

Its codes are 0 for done, 1 for could not (the reason on stderr), 2 for wrong usage.
"""

import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from importlib import import_module
from io import StringIO
from textwrap import fill
from threading import Event, Thread
from typing import IO, Any

import click

from commonlaw import __version__
from commonlaw.cli.options import (
    OTHERS,
    GroupedOption,
    ReadFile,
    check_files,
    check_order,
    check_text,
    dialect,
    in_options,
    option,
    options_of_check,
    take_law_alone,
    usage,
)
from commonlaw.cli.output import changing_line, say, standard_streams
from commonlaw.diagnostics import meaning, notes, reference, sentences
from commonlaw.errors import CommonlawError
from commonlaw.runtime.progress import SECONDS_UNTIL_SHOWN, Elapsed, ProgressCallback
from commonlaw.runtime.shutdown import end_at_once

INTERVAL = 10.0
"""Seconds between lines where there is no terminal to show a line that changes; the first comes earlier, after
`SECONDS_UNTIL_SHOWN`."""


@contextmanager
def working(text: str) -> Iterator[ProgressCallback]:
    """Show on stderr that something is going on; yields what takes the text of each step.

    A terminal has one line that changes, with what was found so far below, and else there are lines now and then. With
    ``--verbose`` each step has one.
    """
    course = Elapsed()
    if click.get_current_context().meta.get(_VERBOSE):
        yield lambda step: say(f"commonlaw: {course.seconds:6.1f} s  {step}", err=True)
        return
    if sys.stderr.isatty():
        with changing_line(lambda: "\n".join(filter(None, (f"{text} {course}", course.interim)))):
            yield course.take
    else:
        with _lines(text, course):
            yield course.take


_VERBOSE = f"{__name__}.verbose"


def say_every_step(context: click.Context) -> None:
    """Have commands say every step, with the seconds since they began to work."""
    context.meta[_VERBOSE] = True


@contextmanager
def _lines(text: str, course: Elapsed) -> Iterator[None]:
    """Say now and then what goes on, and what was found since."""
    ended = Event()

    def tell() -> None:
        seconds = SECONDS_UNTIL_SHOWN
        while not ended.wait(seconds):
            *news, step = course.lines()
            for line in (*news, f"{text} {step}"):
                say(f"commonlaw: {line}", err=True)
            seconds = INTERVAL

    Thread(target=tell, daemon=True).start()
    try:
        yield
    finally:
        ended.set()


ALL_OPTIONS = f"{__name__}.all_options"
"""Set in the `meta` of a context whose help lists all options."""


def _show_all_options(context: click.Context, _: click.Parameter, value: bool) -> None:
    if value:
        context.meta[ALL_OPTIONS] = True
        say(context.get_help())
        context.exit()


class Refusal(click.ClickException):
    """An error that a user can mend, in the words of the command that ran; its end says where more is to be read."""

    def __init__(self, error: CommonlawError, command: click.Command | None, has_schema: bool = False) -> None:
        sentence = error.sentence(dialect(command, has_schema) if command else str)
        super().__init__(f"{sentence} [{reference(error.explained)}]" if error.explained else sentence)

    def show(self, file: IO[Any] | None = None) -> None:
        """Write the message as one line."""
        if file is None:
            say(f"commonlaw: {self.message}", err=True)
        else:
            file.write(f"commonlaw: {self.message}\n")


class Command(click.Command):
    """A command that neither drops what it is given nor writes over what it reads.

    An option counts each time that it is given, or is refused where it has one value; so is what is no text. Files
    that are to be written and cannot be, or are read too, are refused before anything is done. The help lists everyday
    options by their headings, ``--help-all`` all of them.
    """

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        text = "Show this message with all options and exit."
        self._help_all = click.Option(
            ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all_options, help=text
        )

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters, with ``--help-all`` where the short help leaves some out."""
        params = super().get_params(ctx)
        is_short = all(getattr(param, "everyday", True) or getattr(param, "hidden", False) for param in params)
        return params if is_short else [*params, self._help_all]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the arguments; an option of one value that is given twice is wrong usage."""
        try:
            given = Counter(self.make_parser(ctx).parse_args(args=list(args))[2])
        except click.NoSuchOption as error:
            if way_out := _way_out(error.option_name, ctx):
                raise click.UsageError(f"{error.message} {way_out}", ctx) from None
            raise
        for param, count in given.items():
            if isinstance(param, click.Option) and count > 1 and not (param.multiple or param.count or param.is_eager):
                names = " or ".join(param.opts + param.secondary_opts)
                raise click.UsageError(f"{names} is given {count} times and counts once: give it once", ctx)
        rest = super().parse_args(ctx, args)
        check_text(self.params, ctx.params)
        take_law_alone(self, ctx.params)
        return rest

    def invoke(self, ctx: click.Context) -> Any:
        """Do what the command does once its files are found to be right."""
        check_order(ctx)
        check_files(self.params, ctx.params)
        try:
            return super().invoke(ctx)
        except CommonlawError as error:
            raise Refusal(error, self, bool(ctx.params.get("schema"))) from error

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under their headings, and those that are settings under theirs."""
        options = [param for param in self.get_params(ctx) if isinstance(param, click.Option) and not param.hidden]
        count, is_whole = len(options), bool(ctx.meta.get(ALL_OPTIONS))
        if not is_whole:
            options = [option for option in options if getattr(option, "everyday", True)]
        headings = dict.fromkeys(getattr(option, "group", OTHERS) for option in options)
        for heading in sorted(headings, key=OTHERS.__eq__):
            grouped = (option for option in options if getattr(option, "group", OTHERS) == heading)
            records = [record for option in grouped if (record := option.get_help_record(ctx)) is not None]
            with formatter.section(heading):
                formatter.write_dl(records)
        if len(options) < count:
            formatter.write(f"\n{count - len(options)} more options: {ctx.command_path} --help-all\n")
        for param in options if is_whole else ():
            for title, rows in param.settings().items() if isinstance(param, GroupedOption) else ():
                with formatter.section(title):
                    formatter.write_dl(rows)


class Commands(click.Group):
    """A group of such commands."""

    command_class = Command


def command(function: Callable[..., None]) -> Command:
    """Make a command of a function."""
    return click.command(cls=Command)(function)


_COMMANDS = {
    "learning": ("discover", "fit", "models", "compare", "refine"),
    "saved_law": ("predict", "explain", "check", "discrepancy", "bounds", "design", "report", "show"),
    "source": ("data",),
    "main": ("app", "help"),
}
"""The commands of each module, in the order of the help."""
_MODULES = {name: module for module, names in _COMMANDS.items() for name in names}


class _Commands(Commands):
    """A group whose commands are loaded when they are called, so that help and errors come at once."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_MODULES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _MODULES:
            return None
        command = getattr(import_module(f"commonlaw.cli.{_MODULES[cmd_name]}"), cmd_name)
        assert isinstance(command, click.Command)
        return command


@click.command(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(__version__, prog_name="commonlaw")
@click.option("-v", "--verbose", is_flag=True, help="Say on standard error what is done, step by step, with seconds.")
@click.pass_context
def commonlaw(context: click.Context, verbose: bool) -> None:
    """Find the law that repeated, noisy experiments on several objects have in common.

    A table holds measurements of several objects, each measured in one or more trials. `discover` finds the equation
    that all objects share, with each object's own coefficients, and checks it by forecasting.

    \b
    Start with:
      commonlaw data check drops.csv --object ball --trial drop --time t --state height --save drops.toml
      commonlaw discover drops.csv --schema drops.toml --order 2 --save law.json --save report.html
      commonlaw fit drops.csv "height'' = -9.81 - c v" --schema drops.toml
      commonlaw fit mice.csv logistic
      commonlaw compare drops.csv "height'' = -g" "height'' = -g - c v" --schema drops.toml
      commonlaw predict drops.csv law.json
      commonlaw explain law.json --property diameter,mass
      commonlaw check drops.csv law.json --save residuals.png
      commonlaw discrepancy drops.csv law.json --of v
      commonlaw bounds drops.csv law.json --term v^2
      commonlaw design drops.csv law.json --vary height=5..60 --within height=0..60
      commonlaw report drops.csv law.json
      commonlaw app drops.csv
      commonlaw show law.json --latex

    \b
    The table comes first, then laws. Without a table of your own:
      commonlaw discover dataset:linear-drag:noise=0.05 --order 2

    \b
    Have the shell complete commands, options and files (bash; write zsh or fish for these):
      eval "$(_COMMONLAW_COMPLETE=bash_source commonlaw)"
    """
    if verbose:
        say_every_step(context)


def _way_out(name: str, context: click.Context) -> str:
    """Return how to do what an unknown option asks for, if options of tables or of a single command have its name."""
    if name in options_of_check(context.command).values():
        written = f"commonlaw data check TABLE {name} ... --save schema.toml"
        return f"Describe the table by {written}, and give --schema schema.toml"
    root = context.find_root()
    commands = {word: commonlaw.get_command(root, word) for word in _MODULES}
    having = [
        usage(click.Context(command, root, word))
        for word, command in commands.items()
        if command and any(name in param.opts for param in command.params)
    ]
    return f"It is one of another command: {having[0]} {name}" if len(having) == 1 else ""


def main() -> None:
    """Run the command line; errors that a user can mend are one line on stderr, and Ctrl-C ends it at once."""
    end_at_once()
    try:
        with standard_streams(), warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: say(f"commonlaw: {in_options(str(message))}", err=True)
            code = commonlaw(prog_name="commonlaw", standalone_mode=False)
    except MemoryError:
        say("commonlaw: there is not enough memory for this: take fewer trials or a smaller library", err=True)
        code = 1
    except CommonlawError as error:
        Refusal(error, None).show()
        code = 1
    except click.ClickException as error:
        shown = StringIO()
        error.show(shown)
        say(shown.getvalue().rstrip(), err=True)
        code = error.exit_code
    sys.exit(code or 0)


@command
@click.argument("path", required=False, metavar="[TABLE]", type=ReadFile())
@option("--port", "Port to listen at; 0 for any that is free.", type=click.IntRange(0, 65535), default=0)
@option("--browser/--no-browser", "Whether to open a browser.", "open_browser", default=True)
def app(path: str | None, port: int, open_browser: bool) -> None:
    """Open the app in a browser: discover and fit laws without code.

    The app runs on this machine, for you alone, and needs no network. The address that is printed opens it in any of
    your browsers until Ctrl-C ends it.

    \b
    Example:
      commonlaw app drops.csv
    """
    from commonlaw.app.server import serve

    opens = "The app opens" if open_browser else "Open the app"
    serve(path, port, lambda to: say(f"{opens} in your browser; Ctrl-C ends it. For you alone: {to}"), open_browser)


@command
@click.argument("names", nargs=-1, metavar="[CODE | COMMAND...]")
@click.pass_context
def help(context: click.Context, names: tuple[str, ...]) -> None:
    """Explain a message by its code, or a command.

    Every error and note ends with its code in brackets. The explanation has the meaning and the remedy; <names> are
    placeholders, and settings between backticks are Python.

    \b
    Example:
      commonlaw help time-missing
    """
    inner = context.find_root()
    for word in names:
        nested = inner.command.get_command(inner, word) if isinstance(inner.command, click.Group) else None
        if nested is None:
            break
        inner = click.Context(nested, inner, word)
    else:
        say(inner.get_help())
        return
    name, codes = names[0], [*sentences(), *notes()]
    if name not in codes:
        near = get_close_matches(name, [*_MODULES, *codes], n=1)
        raise CommonlawError("message-unknown", name=name, hint=f"did you mean {near[0]!r}? " if near else "")
    for paragraph in meaning(name).splitlines():
        say(fill(paragraph, 100, break_long_words=False, break_on_hyphens=False))
