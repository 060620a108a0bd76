"""`commonlaw app`: the same in a browser."""

import click

from commonlaw.cli.command import quick_command
from commonlaw.cli.output import say
from commonlaw.cli.paths import ReadFile


@quick_command
@click.argument("path", required=False, metavar="[FILE]", type=ReadFile())
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port to listen at; 0 for any that is free.")
@click.option("--browser/--no-browser", "open_browser", default=True, help="Whether to open a browser.")
def app(path: str | None, port: int, open_browser: bool) -> None:
    """Find laws in a browser, without code: open a table, choose, look, take away.

    The page is served to you alone, on this machine, and needs no network. The address that is printed opens it in any
    browser of yours as long as it runs. Ctrl-C ends it, and all that it does.

    \b
    Example:
      commonlaw app drops.csv
    """
    from commonlaw.app import serve

    opens = "The app opens" if open_browser else "Open the app"
    serve(path, port, lambda to: say(f"{opens} in your browser; Ctrl-C ends it. For you alone: {to}"), open_browser)
