"""What stands before every request: only the page that this server sent may ask, and only so much."""

from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass
from secrets import compare_digest
from typing import Any

LARGEST = 64 * 2**20
"""Bytes of a request; a table is sent whole."""

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


@dataclass(frozen=True)
class Guard:
    """Lets requests through to an application that name this server, carry its token, and come from its own page.

    Other sites in the same browser know neither the token nor may they send what changes something: their origin is
    not this one. A name that another site has pointed to this machine is not in `hosts`.

    Parameters
    ----------
    application
        What answers.
    token
        The first part of every path.
    hosts
        Names and ports that requests may be sent to.
    """

    application: Application
    token: str
    hosts: frozenset[str]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] != "http":
            await self.application(scope, receive, send)
            return
        status = self._refusal(scope)
        if status:
            await _refuse(status, send)
            return
        _, _, rest = scope["path"].removeprefix("/").partition("/")
        inner = {**scope, "path": f"/{rest}", "raw_path": f"/{rest}".encode(), "root_path": ""}
        await self.application(inner, _limited(receive), _with_headers(send))

    def _refusal(self, scope: Scope) -> int:
        """Return the status that a request is refused with; 0 if it is not."""
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        token = scope["path"].removeprefix("/").partition("/")[0]
        host = headers.get("host", "")
        if host not in self.hosts or headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return 403
        if not compare_digest(token.encode(), self.token.encode()):
            return 404
        if scope["method"] not in ("GET", "HEAD") and headers.get("origin") != f"http://{host}":
            return 403
        length = headers.get("content-length", "0")
        return 413 if not length.isdecimal() or int(length) > LARGEST else 0


class TooLargeError(Exception):
    """More was sent than is taken."""


def _limited(receive: Receive) -> Receive:
    taken = 0

    async def limited() -> Message:
        nonlocal taken
        message = await receive()
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


async def _refuse(status: int, send: Send) -> None:
    await send({"type": "http.response.start", "status": status, "headers": [*HEADERS]})
    await send({"type": "http.response.body", "body": b""})
