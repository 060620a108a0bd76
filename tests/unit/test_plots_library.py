"""Candidate terms are drawn along a trial."""

import numpy as np

from commonlaw import datasets
from commonlaw.differentiation import parse_differentiation
from commonlaw.formulation import StrongForm, law_variables
from commonlaw.library import PolynomialLibrary
from commonlaw.plots import plot_library

FORM = StrongForm(parse_differentiation("savgol:35:3"), order=2)


def test_the_library_has_a_panel_for_each_term_with_its_values_and_unit_along_the_trial() -> None:
    drops = datasets.linear_drag(drag=(-0.1,))
    terms = PolynomialLibrary(2).bind(law_variables(drops.schema, FORM.order))
    panels = plot_library(drops[0], FORM, terms, drops.schema.units).axes
    rows, _ = FORM.rows(drops[0], terms)
    for i, panel in enumerate(panels):
        np.testing.assert_array_equal(panel.get_lines()[0].get_xydata().T, (drops[0].times, rows[:, i]))
    units = {"$1$": "", "$x$": "m", "$v$": "m/s", "$x^{2}$": "m²", r"$x\,v$": "m²/s", "$v^{2}$": "m²/s²"}
    assert {panel.get_title(): panel.get_ylabel() for panel in panels} == units
    assert [panel.get_xlabel() for panel in panels] == [""] * 3 + ["t (s)"] * 3
    assert {panel.get_ylabel() for panel in plot_library(drops[0], FORM, terms).axes} == {""}
