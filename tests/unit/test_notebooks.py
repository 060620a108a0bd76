"""What notebooks show of laws, trials and forecasts, and of work that goes on."""

import re
import sys
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from types import SimpleNamespace

import pytest

import commonlaw as cl
from commonlaw.law import select_objects
from commonlaw.law.parameters import named_parameters
from commonlaw.plots import Figure
from commonlaw.report import notebook
from commonlaw.runtime import progress
from commonlaw.runtime.notebooks import show_type


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=1, noise=0.05)


@pytest.fixture(scope="module")
def law(drops):
    return cl.fit("x'' = -9.8 - c v", drops, errors="white")


def test_laws_trials_and_forecasts_show_a_table_and_a_figure(law, drops):
    one = select_objects(law, ["Ball 1"])
    for value, words in ((one, "<math"), (law, "-9.8 - c v"), (drops, "Ball 2"), (law.predict(drops), "rms error")):
        shown = value._repr_html_()
        HTMLParser().feed(shown)
        assert words in shown.replace("&#x27;", "'")
        assert "<table" in shown
        assert shown.count("<svg") == 1
    assert named_parameters(law).names[0] == "c"


def test_verdicts_and_residuals_are_pages_with_a_heading_sentences_and_a_table(law, drops):
    for value, title in ((law.assess(drops), "Verdict"), (law.residuals(drops), "Residuals")):
        shown = value._repr_html_()
        HTMLParser().feed(shown)
        assert f"<h4>{title}</h4>" in shown
        assert escape(str(value).splitlines()[0].strip()) in shown
        assert "<table" in shown


def test_names_of_strangers_in_a_verdict_are_text(law, drops):
    verdict = law.assess(drops)
    hostile = replace(verdict, state_errors=(verdict.state_errors[0]._replace(state="<script>a</script>"),))
    assert "<script" not in hostile._repr_html_()


def test_a_history_shows_a_row_for_each_choice(law):
    shown = law.history._repr_html_()
    assert shown.count("<tr") == len(law.history) + 1
    assert "maximum likelihood" in shown


def test_anchors_of_two_figures_differ(law, drops):
    first, second = ({*re.findall(r' id="([^"]+)"', each._repr_html_())} for each in (law, drops))
    assert first
    assert not first & second


def test_names_of_strangers_are_shown_as_they_stand(drops):
    trials = cl.Trials.from_arrays(drops[0].times, drops[0].states, object="<script>a</script>\x1b", names=["x"])
    shown = trials._repr_html_()
    assert "<script" not in shown
    assert "\x1b" not in shown


def test_a_law_without_formulas_shows_its_text(law, monkeypatch):
    def missing(_):
        raise cl.CommonlawError("other", text="needs latex2mathml")

    monkeypatch.setattr(notebook, "law_markdown", missing)
    monkeypatch.setattr(notebook, "plot_intervals", lambda _: Figure())
    assert "x'' = -9.8 - c v" in law._repr_html_().replace("&#x27;", "'")


class ZMQInteractiveShell:
    """What stands for the shell of a notebook."""


def test_a_notebook_shows_figures_as_drawings(monkeypatch):
    known, shell = [], ZMQInteractiveShell()
    formatters = {"image/svg+xml": SimpleNamespace(for_type=lambda kind, svg: known.append((kind, svg)))}
    vars(shell)["display_formatter"] = SimpleNamespace(formatters=formatters)
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    show_type(Figure, lambda _: "<svg/>")
    assert [(kind, svg(None)) for kind, svg in known] == [(Figure, "<svg/>")]


@pytest.fixture
def shown(monkeypatch):
    """All that a notebook was asked to show, the last state of each display."""
    displays = []

    def display(content, **named):
        assert named == {"display_id": True}
        displays.append(content)
        at = len(displays) - 1
        return SimpleNamespace(update=lambda new: displays.__setitem__(at, new))

    python = SimpleNamespace(get_ipython=ZMQInteractiveShell, display=SimpleNamespace(display=display, HTML=str))
    monkeypatch.setitem(sys.modules, "IPython", python)
    monkeypatch.setitem(sys.modules, "IPython.display", python.display)
    return displays


def test_work_in_a_notebook_shows_one_bar_that_ends(shown):
    tell = progress.on_terminal()
    assert not shown
    tell("fitting <b>")
    tell("choosing")
    assert shown == ["<progress></progress> choosing (0 s)"]
    tell("<b>")
    assert "&lt;b&gt;" in shown[0]
    del tell
    assert shown == ["<progress value='1'></progress> done (0 s)"]
