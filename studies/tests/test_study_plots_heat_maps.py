"""Grids of heat maps have one scale for all laws, and say what they refuse."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from commonlaw import datasets
from commonlaw.discovery import DerivativeRegression, discover
from commonlaw.law import Law
from studies.falling_balls.plots import plot_heat_maps
from tests.refusals import refused


def law_of(*coefficients: dict[str, float]) -> Law:
    """A law of balls with these coefficients over polynomials of degree 2."""
    drops = datasets.linear_drag(drag=(-0.1,) * len(coefficients), noise=0.0)
    law = discover(drops, order=2, library="poly:2", method=DerivativeRegression(solver="group-stlsq:1e9"))
    values = [[coefficient.get(term, 0.0) for term in law.terms.names] for coefficient in coefficients]
    return replace(law, coefficients=np.array(values)[:, np.newaxis], provenance=replace(law.provenance, outcomes=()))


LAWS = {
    "alone, drop 1": law_of({"1": -9.0, "x": 0.5}, {"1": -8.0}),
    "alone, drop 2": law_of({"1": -10.0}, {"1": -9.0, "v": 0.01}),
    "group, drop 1": law_of({"1": -9.0, "v": -0.1}, {"1": -9.5, "v": -0.2}),
}


def mesh_of(panel: Axes) -> QuadMesh:
    return next(collection for collection in panel.collections if isinstance(collection, QuadMesh))


def maps(figure: Figure) -> list[Axes]:
    return figure.axes[:-1]


def labels(panel: Axes) -> tuple[list[str], ...]:
    return tuple(
        [text.get_text() for text in axis.get_ticklabels() if text.get_text()] for axis in (panel.xaxis, panel.yaxis)
    )


def test_every_panel_shows_magnitudes_on_the_one_scale_and_blanks_zeros() -> None:
    figure = plot_heat_maps(LAWS, 2)
    assert [panel.get_title() for panel in maps(figure)] == list(LAWS)
    for panel, law in zip(maps(figure), LAWS.values(), strict=True):
        shown = np.ma.asarray(mesh_of(panel).get_array()).reshape(2, -1)
        np.testing.assert_array_equal(shown.filled(0), np.abs(law.coefficients[:, 0]))
        assert mesh_of(panel).get_clim() == pytest.approx((0.01, 10))
    assert "grey: term absent" in figure.axes[-1].get_xlabel()


def test_objects_are_named_at_the_left_and_terms_below_only() -> None:
    first, second, third = maps(plot_heat_maps(LAWS, 2, row_titles=("alone", "group")))
    names, terms = ["Ball 1", "Ball 2"], len(LAWS["group, drop 1"].terms)
    assert [labels(panel)[1] for panel in (first, second, third)] == [names, [], names]
    assert [len(labels(panel)[0]) for panel in (first, second, third)] == [0, terms, terms]
    assert [panel.get_ylabel() for panel in (first, second, third)] == ["alone", "", "group"]
    assert [panel.get_title() for panel in (first, second, third)] == ["drop 1", "drop 2", "drop 1"]


def test_a_grid_of_empty_laws_is_drawn_without_a_scale() -> None:
    figure = plot_heat_maps({"none": law_of({}, {})}, 1)
    assert len(figure.axes) == 1


def test_laws_that_do_not_fit_into_one_grid_are_refused() -> None:
    with refused("other") as raised:
        plot_heat_maps({"a": LAWS["alone, drop 1"], "b": law_of({"1": -9.8})}, 2)
    assert "draw laws of the same objects together" in raised.value.parameters["text"]
    pairs = datasets.lotka_volterra(trials=1)
    two = discover(pairs, library="poly:2", method=DerivativeRegression(solver="stlsq:0.1"))
    with refused("other", text="pair: the law has 2 equations, and a grid shows one: use plot_coefficients"):
        plot_heat_maps({"pair": two}, 1)
    with refused("other", text="there is no law to draw; give at least one"):
        plot_heat_maps({}, 1)
    with refused("other", text="1 titles for 2 rows of heat maps; give one for each row"):
        plot_heat_maps(LAWS, 2, row_titles=("alone",))
