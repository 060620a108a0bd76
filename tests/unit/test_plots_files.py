"""Figures become files of a format, whatever a user has set or imported."""

from functools import cache
from pathlib import Path

import matplotlib as mpl
import pytest

from commonlaw import datasets
from commonlaw.plots import plot_trials, render, save_figure
from commonlaw.plots.style import math
from commonlaw.trials import Trials
from tests.refusals import refused


@cache
def drops() -> Trials:
    return datasets.linear_drag(drag=(-0.2, -0.5))


@pytest.mark.parametrize(("suffix", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_the_suffix_of_a_path_chooses_the_format(suffix: str, start: bytes) -> None:
    figure = plot_trials(drops()[:1])
    first = render(figure, f"a folder/drops.2.{suffix}")
    assert first.startswith(start)
    assert first == render(figure, f".{suffix.upper()}")


@pytest.mark.parametrize(
    ("latex", "shown"),
    [
        (r"\dot{\mathrm{weight}}", r"$\mathrm{d}\ \mathrm{weight}/\mathrm{d}t$"),
        (r"\ddot{\mathrm{height}_{1}}", r"$\mathrm{d}^2\ \mathrm{height}_{1}/\mathrm{d}t^2$"),
        (r"\ddot{x}", r"$\ddot{x}$"),
        (r"\mathrm{Pc} \mathrm{Pa}^{2} v", r"$\mathrm{Pc}\ \mathrm{Pa}^{2}\ v$"),
        ("x^{2} v", r"$x^{2}\,v$"),
    ],
)
def test_words_have_no_dots_and_keep_a_space_between_them(latex: str, shown: str) -> None:
    assert math(latex, "") == shown


def test_matplotlib_settings_of_the_user_are_neither_used_nor_changed() -> None:
    usual = render(plot_trials(drops()), "png")
    with mpl.rc_context({"font.size": 30, "lines.linewidth": 9, "savefig.dpi": 40}):
        before = dict(mpl.rcParams)
        assert render(plot_trials(drops()), "png") == usual
        assert dict(mpl.rcParams) == before


def test_a_figure_is_saved_in_the_format_of_its_suffix(tmp_path: Path) -> None:
    figure = plot_trials(drops())
    save_figure(figure, tmp_path / "drops.svg")
    assert (tmp_path / "drops.svg").read_bytes() == render(figure, "svg")
    with refused("unknown-name", kind="format of a figure", name="jpeg"):
        save_figure(figure, tmp_path / "drops.jpeg")
    assert [path.name for path in tmp_path.iterdir()] == ["drops.svg"]
