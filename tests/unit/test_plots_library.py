"""Candidate terms are drawn along a trial."""

import numpy as np

from commonlaw import datasets
from commonlaw.differentiation import parse_differentiation
from commonlaw.formulation import StrongForm, law_variables
from commonlaw.library import PolynomialLibrary, Terms
from commonlaw.plots import plot_library

DROPS = datasets.linear_drag(drag=(-0.1,))
FORM = StrongForm(parse_differentiation("savgol:35:3"), order=2)


def terms_of(degree: int) -> Terms:
    return PolynomialLibrary(degree).bind(law_variables(DROPS.schema, FORM.order))


def test_the_library_has_a_panel_for_each_term_with_its_values_along_the_trial() -> None:
    terms = terms_of(3)
    figure = plot_library(DROPS[0], FORM, terms, DROPS.schema.units)
    rows, _ = FORM.rows(DROPS[0], terms)
    assert [panel.get_title() for panel in figure.axes[:4]] == ["$1$", "$x$", "$v$", "$x^{2}$"]
    for i, panel in enumerate(figure.axes):
        np.testing.assert_array_equal(panel.get_lines()[0].get_xydata().T, (DROPS[0].times, rows[:, i]))
    assert [panel.get_xlabel() for panel in figure.axes] == [""] * 6 + ["t (s)"] * 4


def test_candidate_terms_have_their_units_beside_the_axes() -> None:
    terms = terms_of(2)
    labels = {
        panel.get_title(): panel.get_ylabel()
        for panel in plot_library(DROPS[0], FORM, terms, {"x": "m", "t": "s"}).axes
    }
    assert labels == {"$1$": "", "$x$": "m", "$v$": "m/s", "$x^{2}$": "m²", r"$x\,v$": "m²/s", "$v^{2}$": "m²/s²"}
    assert {panel.get_ylabel() for panel in plot_library(DROPS[0], FORM, terms).axes} == {""}
