"""Only the page that the app sent may ask its server, and only so much."""

import asyncio

import pytest

from commonlaw.app.guard import HEADERS, LARGEST, Guard, TooLargeError

HOST = "127.0.0.1:8000"


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


def answer(path="/secret/tables", method="POST", parts=(b"table",), **headers):
    """Return status, headers and body that a request gets."""
    sent, left = [], list(parts)
    named = {
        "host": HOST,
        "origin": f"http://{HOST}",
        **{name.replace("_", "-"): each for name, each in headers.items()},
    }
    pairs = [(name.encode(), each.encode()) for name, each in named.items() if each is not None]

    async def receive():
        return {"type": "http.request", "body": left.pop(0), "more_body": bool(left)}

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "path": path, "method": method, "headers": pairs}
    asyncio.run(Guard(everything, "secret", frozenset({HOST}))(scope, receive, send))
    return sent[0]["status"], sent[0]["headers"], sent[1]["body"]


def test_the_page_itself_is_answered_without_the_token_in_the_path_and_nothing_is_kept():
    status, headers, body = answer()
    assert (status, body) == (200, b"/tables 5")
    assert {*HEADERS} <= {*headers}
    assert answer(method="GET", origin=None)[0] == 200


@pytest.mark.parametrize(
    ("status", "request_"),
    [
        (404, {"path": "/tables"}),
        (404, {"path": "/guess/tables"}),
        (404, {"path": "/", "method": "GET"}),
        (403, {"host": "evil.example:8000"}),
        (403, {"host": None}),
        (403, {"origin": "http://evil.example"}),
        (403, {"origin": None}),
        (403, {"origin": "null"}),
        (403, {"sec_fetch_site": "cross-site"}),
        (403, {"sec_fetch_site": "same-site", "method": "GET"}),
        (413, {"content_length": str(LARGEST + 1)}),
        (413, {"content_length": "-1"}),
    ],
)
def test_others_are_refused(status, request_):
    assert answer(**request_)[0] == status
    assert answer(**request_)[2] == b""


def test_more_than_is_taken_ends_the_request_however_it_is_announced():
    with pytest.raises(TooLargeError):
        answer(parts=[bytes(LARGEST // 2)] * 3)
