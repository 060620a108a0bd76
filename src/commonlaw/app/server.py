"""The server: on this machine alone, at an address that nobody can guess."""

import os
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path
from secrets import token_urlsafe

from commonlaw.app.question import named
from commonlaw.app.sessions import Sessions
from commonlaw.errors import CommonlawError
from commonlaw.extras import optional_import
from commonlaw.foreign import read_file

_HERE = "127.0.0.1"


def serve(
    path: str | os.PathLike[str] | None = None,
    port: int = 0,
    tell: Callable[[str], None] = lambda _: None,
    open_browser: bool = True,
) -> None:
    """Serve the app until it is interrupted.

    Parameters
    ----------
    path
        A table that the page opens with.
    port
        Where to listen; any that is free by default.
    tell
        Takes the address.
    open_browser
        Whether a browser opens it.

    Raises
    ------
    CommonlawError
        If a package that it needs is not installed, the table cannot be read, or the port is taken.
    """
    for package in ("starlette", "uvicorn", "latex2mathml"):
        optional_import(package, "the app", "app")
    import uvicorn

    from commonlaw.app.guard import Guard
    from commonlaw.app.routes import application

    sessions = Sessions()
    first = None if path is None else sessions.tables.add(named(Path(path).name, read_file(path)))
    listening = _listening(port)
    host = f"{_HERE}:{listening.getsockname()[1]}"
    token = token_urlsafe(24)
    guard = Guard(application(sessions, first), token, frozenset({host, host.replace(_HERE, "localhost")}))
    config = uvicorn.Config(guard, log_level="error", access_log=False, lifespan="off", server_header=False)
    address = f"http://{host}/{token}/"
    tell(address)
    if open_browser:
        webbrowser.open_new_tab(address)
    try:
        uvicorn.Server(config).run(sockets=[listening])
    except KeyboardInterrupt:
        pass
    finally:
        sessions.close()
        listening.close()


def _listening(port: int) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        opened.bind((_HERE, port))
        opened.listen()
    except (OSError, OverflowError) as error:
        opened.close()
        raise CommonlawError(f"cannot listen at port {port}: {error}; leave the port out to take a free one") from None
    return opened
