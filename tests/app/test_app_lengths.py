"""Texts of any length are answered at once, in short messages; and the app ends at once whatever it is asked."""

import json
import time

import pytest

from commonlaw.app.question import LONGEST_TEXT
from commonlaw.trials.headers import LONGEST_NAME
from tests.served import Served
from tests.texts import planted, texts

TABLE = b"run,t,x\n" + b"".join(b"a,%d,%d\n" % (i, 2**i) for i in range(8))
COLUMNS = {
    "object": "run",
    "time": "t",
    "states": ["x"],
    "missing": ["n/a"],
    "edits": [{"object": "b", "blanks": ["c"]}],
}
EQUATIONS = {"text": "x' = -k x", "values": {"k": [1.0]}, "fixed": ["k"], "shared": {"k": "all"}, "doses": ["u"]}
QUESTION = {"library": "poly:1", "hold_out": {"kind": "object", "value": "b"}, "settings": {"errors": ["white"]}}
REQUESTS = {
    "previews": {"columns": COLUMNS},
    "equations": {"columns": COLUMNS, "equations": EQUATIONS},
    "searches": {"columns": COLUMNS, "equations": EQUATIONS} | QUESTION,
    "sessions": {"columns": COLUMNS, "name": "mine", "search": "a", "key": "b"},
}


def opened(app: Served, content: bytes = TABLE) -> dict[str, object]:
    status, body, _ = app.say("POST", f"{app.room}tables?name=a.csv", content)
    return json.loads(body) | {"status": status}


def test_a_text_of_any_length_in_a_request_is_refused_at_once(app: Served) -> None:
    table = {"table": opened(app)["table"]}
    for path, asked in REQUESTS.items():
        for place in texts(asked | table):
            if place[-1] in ("kind", "errors"):
                continue
            for letter in "a(`":
                began = time.monotonic()
                status, answer = app.ask(path, "POST", planted(asked | table, place, letter * 100_000))
                assert status == 422, place
                assert time.monotonic() - began < 5
                assert len(json.dumps(answer)) < 1000
    for letter in "a( `":
        began = time.monotonic()
        status, answer = app.ask(
            "equations",
            "POST",
            table | {"columns": {}, "equations": {"text": f"x' = {letter * LONGEST_TEXT}"[:LONGEST_TEXT]}},
        )
        assert (status, len(str(answer["problem"])) < 1000) == (200, True)
        assert time.monotonic() - began < 5


@pytest.mark.parametrize("letter", ["a", "(", " a", "µ", "[m] "])
def test_a_column_name_of_any_length_is_refused_at_once_and_the_longest_is_taken(app: Served, letter: str) -> None:
    began = time.monotonic()
    refused = opened(app, f"t,{letter * 50_000}\n0,1\n1,2\n2,3\n".encode())
    assert refused["status"] == 422
    assert len(str(refused["error"])) < 1000
    name = (letter * LONGEST_NAME)[: LONGEST_NAME - 1] + "a"
    taken = opened(app, f"t,{name}\n0,1\n1,2\n2,3\n".encode())
    status, answer = app.ask("previews", "POST", {"table": taken["table"]})
    assert (status, answer["problem"], answer["count"]) == (200, "", 1)
    assert time.monotonic() - began < 10
