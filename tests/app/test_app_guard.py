"""Only the page that the app sent may ask its server, and only so much."""

import asyncio

import pytest

from commonlaw.app.access import HEADERS, ConnectionLimit, Guard, Keys, TooLargeError, TooSlowError
from commonlaw.app.server import hosts_at

HOST = "127.0.0.1:8000"
KEYS = {"name": "app", "printed": "printed", "once": "once", "room": "room", "session": "secret"}


async def everything(scope, receive, send):
    """Take what was sent, and answer with its length and the path."""
    body = b""
    while True:
        message = await receive()
        body += message["body"]
        if not message.get("more_body"):
            break
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": f"{scope['path']} {len(body)}".encode()})


def answer(path="/room/tables", method="POST", parts=(b"table",), more=False, keys=None, patience=30.0, **headers):
    """Return status, headers and body that a request gets."""
    sent, left = [], list(parts)
    named = {
        "host": HOST,
        "origin": f"http://{HOST}",
        "cookie": "app=another; app=secret",
        **{name.replace("_", "-"): header for name, header in headers.items()},
    }
    pairs = [(name.encode(), each.encode()) for name, each in named.items() if each is not None]

    async def receive():
        if not left:
            await asyncio.sleep(60)
        return {"type": "http.request", "body": left.pop(0), "more_body": bool(left) or more}

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "path": path, "method": method, "headers": pairs}
    guard = Guard(everything, keys or Keys(**KEYS), hosts_at(8000), ConnectionLimit(), patience=patience)
    asyncio.run(guard(scope, receive, send))
    return sent[0]["status"], sent[0]["headers"], sent[1]["body"]


def test_the_page_itself_is_answered_without_the_room_in_the_path_and_nothing_is_kept():
    status, headers, body = answer()
    assert (status, body) == (200, b"/tables 5")
    assert {*HEADERS} <= {*headers}
    assert answer(method="GET", origin=None)[0] == 200


@pytest.mark.parametrize(
    ("status", "request_"),
    [
        (404, {"path": "/tables"}),
        (401, {"cookie": None}),
        (401, {"cookie": "app=guess; b=secret"}),
        (404, {"path": "/room2/", "method": "GET"}),
        (404, {"path": "/printed/tables"}),
        (404, {"path": "/printed", "method": "HEAD"}),
        (404, {"path": "/guess/tables"}),
        (401, {"path": "/", "method": "GET"}),
        (403, {"host": "evil.example:8000"}),
        (403, {"host": None}),
        (403, {"origin": "http://evil.example"}),
        (403, {"origin": None}),
        (403, {"origin": "null"}),
        (403, {"sec_fetch_site": "cross-site"}),
        (403, {"sec_fetch_site": "same-site", "method": "GET"}),
        (413, {"content_length": str(Guard.largest + 1)}),
        (413, {"content_length": "-1"}),
        (413, {"content_length": "9" * 5000}),
    ],
)
def test_others_are_refused(status, request_):
    assert answer(**request_)[0] == status
    assert answer(**request_)[2].startswith(b'{"error"' if status == 401 else b"")


def test_more_than_is_taken_ends_the_request_however_it_is_announced():
    with pytest.raises(TooLargeError):
        answer(parts=[bytes(Guard.largest // 2)] * 3)


def test_what_stands_still_on_its_way_ends_the_request():
    with pytest.raises(TooSlowError):
        answer(parts=[b"ta"], more=True, patience=0.01)


@pytest.mark.parametrize("path", ["/printed", "/printed/", "/once"])
def test_a_key_gives_the_cookie_and_sends_the_browser_on_from_whatever_page(path):
    status, headers, body = answer(path, method="GET", cookie=None, origin=None, sec_fetch_site="cross-site")
    assert (status, dict(headers)[b"set-cookie"]) == (200, b"app=secret; Path=/room/; HttpOnly; SameSite=Strict")
    assert b"url=/room/" in body
    assert not any(each in body for each in (b"secret", b"printed", b"once"))


def test_the_key_of_the_page_works_once_and_that_which_is_printed_again():
    keys = Keys(**KEYS)
    asked = [
        answer(path, method="GET", keys=keys, sec_fetch_mode="navigate")
        for path in ("/once", "/once", "/printed", "/printed")
    ]
    assert [status for status, _, _ in asked] == [200, 404, 200, 200]
    assert b"Open the address that commonlaw app has printed" in asked[1][2]


def test_browsers_leave_out_the_port_of_http():
    assert hosts_at(80) >= {"127.0.0.1", "localhost", "localhost:80"}
    assert "localhost" not in hosts_at(8080)


class Transport:
    """What stands for a connection."""

    is_open = True

    def abort(self):
        self.is_open = False


def test_a_connection_waits_for_a_while_unless_it_is_let_through():
    async def wait():
        entered, connections = {name: Transport() for name in ("stranger", "page")}, ConnectionLimit(seconds=0.01)
        for name, each in entered.items():
            connections.enter(name, each)
        connections.accept("page")
        await asyncio.sleep(0.1)
        return [name for name, each in entered.items() if each.is_open]

    assert asyncio.run(wait()) == ["page"]


def test_the_oldest_of_too_many_strangers_gives_way():
    async def crowd():
        entered, connections = [Transport() for _ in range(70)], ConnectionLimit()
        for i, each in enumerate(entered):
            connections.enter(i, each)
            if i == 1:
                connections.accept(i)
        return [i for i, each in enumerate(entered) if not each.is_open]

    assert asyncio.run(crowd()) == [0, 2, 3, 4, 5]
