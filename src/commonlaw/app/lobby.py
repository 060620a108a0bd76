"""Connections of strangers: few at a time, and not for long."""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

_WAITING, _OPEN = 64, 192
"""Connections that wait, and all of them; far fewer than the files that a process may have open."""

_SECONDS = 10.0
"""How long a connection may wait."""

BACKLOG = 32
"""Connections that are taken in at once: fewer than may wait, so that each is heard before it must give way."""

Peer = tuple[str, int]


class Lobby:
    """Connections that are open.

    Each waits until a request of it is let through, and is closed if that takes long, whatever it sends. When too many
    wait, the one that has waited longest gives way. So strangers, who cannot be told from a browser before they speak,
    neither take the place of those that are known nor wear out the process.
    """

    def __init__(self) -> None:
        self._waiting: dict[Peer, asyncio.Transport] = {}
        self._open = 0

    def enter(self, peer: Peer, transport: asyncio.Transport) -> None:
        """Let a connection wait."""
        self._open += 1
        self._waiting[peer] = transport
        asyncio.get_running_loop().call_later(_SECONDS, self._close, peer, transport)
        if len(self._waiting) > _WAITING or self._open > _OPEN:
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


def protocol(lobby: Lobby) -> type[asyncio.Protocol]:
    """Return the protocol by which a server speaks whose connections wait in a lobby."""

    class Waiting(H11Protocol):
        def connection_made(self, transport: Any) -> None:  # A server gives transports of its own
            super().connection_made(transport)
            lobby.enter(self._peer, transport)

        def connection_lost(self, exc: Exception | None) -> None:
            lobby.leave(self._peer)
            super().connection_lost(exc)

        @property
        def _peer(self) -> Any:
            return self.client

    return Waiting
