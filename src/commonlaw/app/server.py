"""The server: on this machine alone, for those who have a key."""

import os
import socket
import sys
import webbrowser
from collections.abc import Callable
from pathlib import Path
from threading import Thread

from commonlaw.app.question import named
from commonlaw.app.sessions import Sessions
from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import private_file, read_file
from commonlaw.runtime.packages import optional_import
from commonlaw.runtime.shutdown import put_away_first

_HERE = "127.0.0.1"


def serve(
    path: str | os.PathLike[str] | None = None,
    port: int = 0,
    tell: Callable[[str], None] = lambda _: None,
    open_browser: bool = True,
) -> None:
    """Serve the app until it is interrupted; then nothing of it goes on, whatever it was in.

    Raises `CommonlawError` if a package that it needs is not installed, the table cannot be read, or the port is taken.

    Parameters
    ----------
    path
        A table that the page opens with.
    port
        Where to listen; any that is free by default.
    tell
        Takes the address. Whoever has it can open the app as long as it runs.
    open_browser
        Whether a browser opens it. The browser is told by a file that nobody else can read, not by its arguments.
    """
    for package in ("starlette", "uvicorn", "latex2mathml"):
        optional_import(package, "the app", "app")
    import uvicorn

    from commonlaw.app.access import ConnectionLimit, Guard, Keys, protocol
    from commonlaw.app.routes import application

    sessions, connections = Sessions(), ConnectionLimit()
    if path is not None:
        sessions.open_table(named(Path(path).name, read_file(path)))
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listening:
        # What was served at this port before may still be on its way; on Windows this would share the port
        if sys.platform != "win32":
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((_HERE, port))
            listening.listen()
        except (OSError, OverflowError) as error:
            raise CommonlawError("port-taken", port=port, error=error) from None
        port = listening.getsockname()[1]
        keys = Keys(f"commonlaw-{port}")
        guard = Guard(application(sessions), keys, hosts_at(port), connections)
        # Fewer are taken in at once than may wait, so that each is heard before it must give way
        config = uvicorn.Config(
            guard, loop="asyncio", http=protocol(connections), ws="none", backlog=32, log_level="error",
            access_log=False, lifespan="off", server_header=False,
        )  # fmt: skip
        server = uvicorn.Server(config)
        # In a thread it leaves signals alone, by which it would wait for all that goes on
        serving = Thread(target=server.run, args=([listening],), daemon=True)
        address = f"http://{_HERE}:{port}"
        opens = f'<meta http-equiv="refresh" content="0; url={address}/{keys.once}">'
        link = f'<!DOCTYPE html><title>commonlaw</title>{opens}<a href="{address}/{keys.once}">Open commonlaw</a>'
        with put_away_first() as ending, private_file("open.html", link.encode()) as page:
            try:
                serving.start()
                tell(f"{address}/{keys.printed}")
                if open_browser and page is not None:
                    # A browser of a terminal returns when it is closed
                    Thread(target=webbrowser.open_new_tab, args=(page.as_uri(),), daemon=True).start()
                with ending.waiting():
                    while serving.is_alive():
                        serving.join(0.2)
            except KeyboardInterrupt:
                server.should_exit = server.force_exit = True
            finally:
                sessions.close()


def hosts_at(port: int) -> frozenset[str]:
    """Return the names by which browsers call a server of this machine; the port of HTTP they leave out."""
    names = (_HERE, "localhost")
    return frozenset([*(f"{name}:{port}" for name in names), *(names if port == 80 else ())])
