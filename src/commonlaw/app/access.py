"""Access control: only the page that this server sent may send requests, and only so many."""

import asyncio
import json
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass, field
from functools import partial
from secrets import compare_digest, token_hex
from typing import Any, cast

from uvicorn.protocols.http.h11_impl import H11Protocol

_secret = partial(token_hex, 16)


@dataclass
class Keys:
    """Secrets of one server.

    Cookies know no ports: the browser sends them to whatever else listens on this machine. So theirs is bound to a path
    that others do not know.

    Parameters
    ----------
    name
        Of the cookie.
    printed
        Key in the address that is shown; it opens any browser of theirs as long as the server runs.
    once
        Key in the page that opens their browser: it works for one visit.
    room
        First part of the path of all that is served.
    session
        What the cookie holds.
    """

    name: str
    printed: str = field(default_factory=_secret)
    once: str = field(default_factory=_secret)
    room: str = field(default_factory=_secret)
    session: str = field(default_factory=_secret)

    def opens(self, key: str) -> bool:
        """Return whether a key opens the app; one that works once works no more then."""
        if _same(key, self.once):
            self.once = _secret()
            return True
        return _same(key, self.printed)

    def knows(self, cookies: str) -> bool:
        """Return whether the cookies of a request hold that of this server."""
        pairs = (cookie.strip().partition("=") for cookie in cookies.split(";"))
        return any(name == self.name and _same(value, self.session) for name, _, value in pairs)

    @property
    def cookie(self) -> str:
        """The cookie, as it is set."""
        return f"{self.name}={self.session}; Path=/{self.room}/; HttpOnly; SameSite=Strict"


def _same(one: str, other: str) -> bool:
    return compare_digest(one.encode(errors="replace"), other.encode())


Peer = tuple[str, int]


@dataclass
class ConnectionLimit:
    """Connections that are open.

    Each waits until a request of it is let through, and is closed if that takes long, whatever it sends. When too many
    wait, the one that has waited longest gives way. So strangers, whom nothing distinguishes from a browser before they
    speak, neither take the place of those that are known nor wear out the process.

    Parameters
    ----------
    waiting, all_open
        Connections that wait, and all of them, at most; far fewer than the files that a process may have open.
    seconds
        How long a connection may wait.
    """

    waiting: int = 64
    all_open: int = 192
    seconds: float = 10.0

    def __post_init__(self) -> None:
        self._waiting: dict[Peer, asyncio.Transport] = {}
        self._open = 0

    def enter(self, peer: Peer, transport: asyncio.Transport) -> None:
        """Let a connection wait."""
        self._open += 1
        self._waiting[peer] = transport
        asyncio.get_running_loop().call_later(self.seconds, self._close, peer, transport)
        if len(self._waiting) > self.waiting or self._open > self.all_open:
            oldest = next(iter(self._waiting))
            self._close(oldest, self._waiting[oldest])

    def accept(self, peer: Peer | None) -> None:
        """Let a connection stay: it has carried a request that was let through."""
        if peer is not None:
            self._waiting.pop(peer, None)

    def leave(self, peer: Peer) -> None:
        """Forget a connection that is closed."""
        self._open -= 1
        self._waiting.pop(peer, None)

    def _close(self, peer: Peer, transport: asyncio.Transport) -> None:
        if self._waiting.get(peer) is transport:
            del self._waiting[peer]
            transport.abort()


def protocol(connections: ConnectionLimit) -> type[asyncio.Protocol]:
    """Return the protocol by which a server speaks whose connections are limited."""

    class Waiting(H11Protocol):
        def connection_made(self, transport: Any) -> None:  # A server gives transports of its own
            super().connection_made(transport)
            connections.enter(cast(Peer, self.client), transport)

        def connection_lost(self, exc: Exception | None) -> None:
            connections.leave(cast(Peer, self.client))
            super().connection_lost(exc)

    return Waiting


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

    Connections wait in `connections` until one of their requests was let through.
    """

    application: Application
    keys: Keys
    hosts: frozenset[str]
    """Names and ports that requests may be sent to, in small letters."""
    connections: ConnectionLimit
    largest: int = 64 * 2**20
    """Bytes of a request; a table is sent whole."""
    patience: float = 30.0
    """Seconds that the next bytes of a request may take."""

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
            self.connections.accept(scope.get("client"))
            inner = {**scope, "path": f"/{rest}", "raw_path": f"/{rest}".encode(), "root_path": ""}
            taken = 0

            async def limited() -> Message:
                nonlocal taken
                try:
                    message = await asyncio.wait_for(receive(), self.patience)
                except TimeoutError:
                    raise TooSlowError from None
                taken += len(message.get("body", b""))
                if taken > self.largest:
                    raise TooLargeError
                return message

            async def sending(message: Message) -> None:
                if message["type"] == "http.response.start":
                    message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
                await send(message)

            await self.application(inner, limited, sending)

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
        return 413 if not (length.isdecimal() and len(length) < 20 and int(length) <= self.largest) else 0


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
