"""What stands before every request: only the page that this server sent may ask, and only so much."""

import asyncio
import json
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass
from typing import Any

from commonlaw.app.keys import Keys
from commonlaw.app.lobby import Lobby

LARGEST = 64 * 2**20
"""Bytes of a request; a table is sent whole."""

PATIENCE = 30.0
"""Seconds that the next bytes of a request may take."""

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

HEADERS = (
    (b"cache-control", b"no-store"),
    (b"content-security-policy", b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
     b"connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)  # fmt: skip

_STRANGER = (
    "Open the address that commonlaw app has printed in the terminal: what led here works once, or in another browser."
)


class TooLargeError(Exception):
    """More was sent than is taken."""


class TooSlowError(Exception):
    """What is sent has come to a stop."""


@dataclass(frozen=True)
class Guard:
    """Lets requests through to an application that name this server, come from its own page, and carry its cookie.

    Other sites in the same browser have no cookie of it, nor may they send what changes something: their origin is not
    this one. A name that another site has pointed to this machine is not in `hosts`.

    Parameters
    ----------
    application
        What answers.
    keys
        What opens it.
    hosts
        Names and ports that requests may be sent to, in small letters.
    lobby
        Where connections wait until one of their requests was let through.
    """

    application: Application
    keys: Keys
    hosts: frozenset[str]
    lobby: Lobby

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] != "http":
            await self.application(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        room, _, rest = scope["path"].removeprefix("/").partition("/")
        if headers.get("host", "").lower() not in self.hosts:
            await _answer(403, send)
        elif scope["method"] == "GET" and not rest and self.keys.opens(room):
            # From whatever page: who has a key is no other site
            to = f'<a href="/{self.keys.room}/">Open commonlaw</a>'
            await _answer(200, send, f'<meta http-equiv="refresh" content="0; url=/{self.keys.room}/">{to}', self.keys)
        elif status := self._refusal(scope, headers, room):
            is_seen = headers.get("sec-fetch-mode") == "navigate"
            hint = _STRANGER if is_seen else json.dumps({"error": _STRANGER})
            await _answer(status, send, hint if is_seen or status == 401 else "")
        elif scope["path"] == f"/{room}":
            await _answer(308, send, to=f"/{room}/")
        else:
            self.lobby.accept(scope.get("client"))
            inner = {**scope, "path": f"/{rest}", "raw_path": f"/{rest}".encode(), "root_path": ""}
            await self.application(inner, _limited(receive), _with_headers(send))

    def _refusal(self, scope: Scope, headers: MutableMapping[str, str], room: str) -> int:
        """Return the status that a request is refused with; 0 if it is not."""
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return 403
        if room != self.keys.room:
            return 404 if room else 401
        if not self.keys.knows(headers.get("cookie", "")):
            return 401
        if scope["method"] not in ("GET", "HEAD") and headers.get("origin") != f"http://{headers['host']}":
            return 403
        length = headers.get("content-length", "0")
        return 413 if not (length.isdecimal() and len(length) < 20 and int(length) <= LARGEST) else 0


def _limited(receive: Receive) -> Receive:
    taken = 0

    async def limited() -> Message:
        nonlocal taken
        try:
            message = await asyncio.wait_for(receive(), PATIENCE)
        except TimeoutError:
            raise TooSlowError from None
        taken += len(message.get("body", b""))
        if taken > LARGEST:
            raise TooLargeError
        return message

    return limited


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
        await send(message)

    return sending


async def _answer(status: int, send: Send, text: str = "", keys: Keys | None = None, to: str = "") -> None:
    """Answer in place of the application, and hang up: text as a page, or to what the page asks for by itself."""
    headers = [*HEADERS, (b"connection", b"close")]
    headers += [(b"set-cookie", keys.cookie.encode())] if keys else []
    headers += [(b"location", to.encode())] if to else []
    is_json = text.startswith("{")
    body = text if is_json or not text else f"<!DOCTYPE html><title>commonlaw</title><p>{text}"
    kind = "application/json" if is_json else "text/html; charset=utf-8"
    headers += [(b"content-type", kind.encode())] if text else []
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body.encode()})
