"""The command `commonlaw` and how it ends: 0 done, 1 could not (the reason on stderr), 2 wrong usage."""

import sys
import warnings
from difflib import get_close_matches
from importlib import import_module
from io import StringIO
from textwrap import fill

import click

from commonlaw import __version__
from commonlaw.cli.command import Commands, Refusal, command, say_every_step
from commonlaw.cli.options import ReadFile, in_options, is_of_kind, option
from commonlaw.cli.output import say, standard_streams
from commonlaw.diagnostics import meaning, notes, sentences
from commonlaw.errors import CommonlawError
from commonlaw.runtime.shutdown import end_at_once

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

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is named, and its words; a report without a law is one of `discover`."""
        name, *rest = args
        if name == "report" and not any(each.startswith(("-h", "--help")) or is_of_kind(each, "law") for each in rest):
            say("commonlaw: report without a law is deprecated: write discover ... --save report.html", err=True)
            page = [] if any(each.endswith(".html") for each in rest) else ["--save", "report.html"]
            args = ["discover", *rest, *page]
        return super().resolve_command(ctx, args)


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
    from commonlaw.app import serve

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
    for each in names:
        found = inner.command.get_command(inner, each) if isinstance(inner.command, click.Group) else None
        if found is None:
            break
        inner = click.Context(found, inner, each)
    else:
        say(inner.get_help())
        return
    name, codes = names[0], [*sentences(), *notes()]
    if name not in codes:
        near = get_close_matches(name, [*_MODULES, *codes], n=1)
        raise CommonlawError("message-unknown", name=name, hint=f"did you mean {near[0]!r}? " if near else "")
    for paragraph in meaning(name).splitlines():
        say(fill(paragraph, 100, break_long_words=False, break_on_hyphens=False))
