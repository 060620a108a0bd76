"""Reports of laws of groups of objects, in discrete time, without terms, and overviews of very many objects."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.plots.forecast import ForecastPanels
from commonlaw.report import law_report, to_page
from commonlaw.report.document import Table, Text
from commonlaw.report.sections import coefficients
from commonlaw.summary import Summary
from commonlaw.verdict import find

TIMES = np.linspace(0, 3, 20)
RATES = {"a1": 0.5, "a2": 0.6, "b1": 1.5, "b2": 1.6}


def texts(report):
    return [block.text for section in report.sections for block in section.blocks if isinstance(block, Text)]


@pytest.fixture(scope="module")
def groups():
    random = np.random.default_rng(0)
    states = [3 * np.exp(-rate * TIMES) + random.normal(0, 0.01, 20) for rate in RATES.values()]
    kinds = {name: {"kind": name[0]} for name in RATES}
    trials = cl.Trials.from_arrays(TIMES, states, object=list(RATES), names=["x"], properties=kinds)
    return cl.fit("x' = -k x", trials, errors="white"), trials


def test_groups_of_objects_are_compared_in_a_table(groups):
    blocks = coefficients(Summary(find(*groups)))
    (table,) = (b for b in blocks if isinstance(b, Table) and b.caption.startswith("Differences from kind a"))
    (row,) = table.frame.to_dict("records")
    assert (row["kind"], row["parameter"]) == ("b", "k")
    assert float(row["difference"]) == pytest.approx(1.0, abs=0.02)


def test_the_overview_of_many_objects_has_a_cell_for_each(groups):
    law, trials = groups
    figure = ForecastPanels(law.predict(trials)).overview(trials.objects)
    (panel,) = figure.axes
    assert [text.get_text() for text in panel.texts] == list(RATES)
    assert len(panel.lines) == 2 * len(RATES)  # Measured, and forecast
    for k in range(len(RATES)):
        column, row = k % 3, k // 3
        for line in panel.lines[2 * k : 2 * k + 2]:
            x, y = np.array(line.get_data())
            assert np.all((column <= x) & (x <= column + 1) & (row <= y) & (y <= row + 1))


def test_a_law_in_discrete_time_has_forecasts_only():
    states = [0.1, *[0.0] * 11]
    for n in range(11):
        states[n + 1] = 2.5 * states[n] * (1 - states[n])
    trials = cl.Trials.from_arrays(np.arange(12.0), states, names=["x"])
    law = cl.fit("x[n+1] = r x + b x^2", trials)
    said = " ".join(texts(law_report(find(law, trials))))
    assert "least squares estimates from each sample to the next" in said
    assert "a law in discrete time has forecasts only" in said


@pytest.mark.usefixtures("undrawn")
def test_a_law_without_terms_says_so():
    random = np.random.default_rng(1)
    trials = cl.Trials.from_arrays(TIMES, 2 + random.normal(0, 0.1, 20), names=["x"])
    page = to_page(law_report(find(cl.fit("x' = 0", trials, errors="white"), trials))).decode()
    assert "The law has no term: all rates are zero." in page
