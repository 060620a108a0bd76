"""What opens the app: keys for the first visit, and a cookie from then on."""

from dataclasses import dataclass, field
from secrets import compare_digest, token_hex


def _secret() -> str:
    return token_hex(16)


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
        Key in the address that people are told; it opens any browser of theirs as long as the server runs.
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
        pairs = (each.strip().partition("=") for each in cookies.split(";"))
        return any(name == self.name and _same(value, self.session) for name, _, value in pairs)

    @property
    def cookie(self) -> str:
        """The cookie, as it is set."""
        return f"{self.name}={self.session}; Path=/{self.room}/; HttpOnly; SameSite=Strict"


def _same(one: str, other: str) -> bool:
    return compare_digest(one.encode(errors="replace"), other.encode())
