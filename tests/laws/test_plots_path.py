"""The path of a solver: every segment of thresholds has its row, its step in the figure, and comes back from JSON."""

from typing import Any

import numpy as np
import pytest
from matplotlib.patches import Rectangle

import commonlaw as cl
from commonlaw.law import Alternative, Law, from_json, to_json
from commonlaw.law.provenance import path_segments
from commonlaw.plots import plot_path
from tests.refusals import refused

SETTINGS = {"order": 2, "library": "poly:2"}


def regression(**settings: Any) -> cl.DerivativeRegression:
    return cl.DerivativeRegression(differentiation="savgol:25:3", trim=8, n_resamples=0, **settings)


DROPS = cl.datasets.linear_drag()


@pytest.fixture(scope="module")
def law() -> Law:
    return cl.discover(DROPS, method=regression(solver=cl.solvers.STLSQ()), **SETTINGS)


def test_the_solver_gives_the_terms_of_each_stretch_from_its_beginning_to_its_end(law: Law) -> None:
    path = law.provenance.path()
    np.testing.assert_array_equal(path["to"].to_numpy()[:-1], path["from"].to_numpy()[1:])
    assert path["from"].iloc[0] == 0
    assert path["to"].iloc[-1] == np.inf
    assert path["chosen"].sum() == 1
    for row in path.to_dict("records"):
        for threshold in (row["from"] * (1 + 1e-9), min(row["to"], 1e300) * (1 - 1e-9)):
            at = cl.discover(DROPS, method=regression(solver=cl.solvers.STLSQ(threshold)), **SETTINGS)
            assert (
                ", ".join(name for name, used in zip(at.terms.names, at.support[0], strict=True) if used)
                == row["terms"]
            )


def test_the_path_is_saved_with_the_law(law: Law) -> None:
    assert from_json(to_json(law)).provenance.path().equals(law.provenance.path())


def test_hyperparameters_of_several_solvers_are_not_mixed_into_one_path() -> None:
    for several in (
        cl.discover(DROPS, method=regression(), **SETTINGS),
        cl.discover(DROPS, method=regression(solver="group-stlsq:1.5"), **SETTINGS),
    ):
        with refused("path-unknown"):
            several.provenance.path()


def test_a_candidate_that_comes_twice_has_two_segments_and_neighbours_are_joined() -> None:
    def one(*values: float) -> Alternative:
        return Alternative("x'", ("x",), {}, False, False, values)

    often, between = one(0.0, 1.0, 3.0), one(2.0)
    assert list(path_segments([between, often])) == [(0.0, 2.0, often), (2.0, 3.0, between), (3.0, np.inf, often)]
    assert list(path_segments([one()])) == []


def test_the_figure_steps_where_the_terms_change_and_shades_what_was_chosen(law: Law) -> None:
    figure = plot_path(law, marks={"mine": 1.5})
    above, below = figure.axes
    path = law.provenance.path()
    chosen = path[path["chosen"]].iloc[0]
    for panel, column in ((above, "size"), (below, "held-out error")):
        x, y = panel.get_lines()[0].get_data()
        np.testing.assert_array_equal(x[1:-1], path["from"].to_numpy()[1:])
        np.testing.assert_array_equal(y, [*path[column], path[column].iloc[-1]])
        (span,) = panel.patches
        assert isinstance(span, Rectangle)
        assert (span.get_x(), span.get_x() + span.get_width()) == pytest.approx((chosen["from"], chosen["to"]))
        assert panel.get_lines()[1].get_xdata() == [1.5, 1.5]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["chosen", "mine"]
    assert below.get_xlabel() == "threshold"
