"""A fault of the program, wherever it is, is shown on the page at once."""

import os
import time
from pathlib import Path

import pytest

import commonlaw as cl
from tests.in_browser import Page
from tests.served import served

PLANTED = """
import os, signal
from commonlaw.app import preview, sessions

def fails(*_):
    raise ZeroDivisionError("planted")

class Breaking:
    def __reduce__(self):
        return fails, ()

def answer(question, table, known, show):
    show("reading the table")
    if table.name == "dies.csv":
        os.kill(os.getpid(), signal.SIGKILL)
    yield fails() if table.name == "raises.csv" else Breaking()

sessions.answer, preview.sample_table = answer, fails
"""
"""What Python loads before the app: searches that raise, send what cannot be received, or are killed."""


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faulty")
    (folder / "sitecustomize.py").write_text(PLANTED)
    path = os.pathsep.join([str(folder), str(Path(cl.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    with served(environment={"PYTHONPATH": path, "COMMONLAW_SESSIONS": str(folder / "sessions")}) as running:
        yield running


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("raises", "planted"),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("unreadable", "planted"), ("dies", "code -9"))),
    ],
)
def test_a_fault_of_a_search_is_on_the_page_within_two_seconds(page: Page, faulty, tmp_path, name, word):
    table = tmp_path / f"{name}.csv"
    cl.datasets.linear_drag(trials=1).to_csv(table)
    page.open(faulty, table, "5 trials of 5 objects")
    page.click("start")
    page.wait("$('going_done').textContent.includes('starting') || $('failed').textContent")
    began = time.monotonic()
    assert word in page.wait("$('failed').textContent")
    assert time.monotonic() - began < 2
    assert page.wait("$('going').hidden && !$('start').disabled")
    assert page.faults() == []


def test_a_fault_of_an_answer_is_on_the_page(page: Page, faulty):
    page.get(faulty.address)
    page.wait("$('file') && document.readyState === 'complete'")
    began = time.monotonic()
    page.choose("sample", "lorenz")
    assert "ZeroDivisionError" in page.wait("$('failure').textContent")
    assert time.monotonic() - began < 2
