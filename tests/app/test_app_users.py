"""From a table to a law with named quantities in three clicks: a plate reader and a drug."""

import numpy as np
import pandas as pd
import pytest


def plate():
    """Four wells of a wide table: two strains with rates of 0.5 and 0.35 per hour and capacities of 1.2 and 0.8."""
    random, t = np.random.default_rng(7), np.arange(0, 20, 0.5)
    columns, capacities = {"Time [h]": t}, [1.2] * 2 + [0.8] * 2
    for well, capacity in zip(("A1", "A2", "B1", "B2"), capacities, strict=True):
        first, rate = 0.03 * np.exp(0.1 * random.standard_normal()), 0.5 if capacity == 1.2 else 0.35
        size = capacity / (1 + (capacity / first - 1) * np.exp(-rate * t))
        columns[well] = (size + 0.006 * random.standard_normal(len(t))).round(4)
    return pd.DataFrame(columns), capacities


def drug():
    """Six subjects with a bolus of 100 or 200 into one compartment: clearances about 5, volumes about 40."""
    random, rows, half_lives = np.random.default_rng(7), [], []
    t = np.array([0.25, 0.5, 1, 2, 3, 4, 6, 8, 10, 12, 16, 24])
    for i in range(6):
        clearance, volume = 5 * np.exp(0.2 * random.standard_normal()), 40 * np.exp(0.15 * random.standard_normal())
        amount = (100.0, 200.0)[i % 2]
        level = amount / volume * np.exp(-clearance / volume * t) * np.exp(0.05 * random.standard_normal(len(t)))
        columns = {"time": np.append(0.0, t), "conc": np.append(np.nan, level.round(4)), "dose": [amount, *(0.0 * t)]}
        rows.append(pd.DataFrame({"ID": f"S{i + 1}", **columns}))
        half_lives.append(np.log(2) * volume / clearance)
    return pd.concat(rows), half_lives


def written(frame, path):
    frame.to_csv(path, index=False)
    return path


def quantities(page, name):
    """Wait for the quantities of a law; return those that are so called, each with an interval."""
    page.wait("!$('result').hidden && $('quantities').tBodies[0].rows.length", 120)
    head = page.wait("[...$('quantities').tHead.rows[0].cells].map(each => each.textContent)")
    column = next(i for i, each in enumerate(head) if each.startswith(name))
    cells = page.wait(f"[...$('quantities').tBodies[0].rows].map(each => each.cells[{column}].textContent)")
    assert all(" to " in cell for cell in cells)
    return [float(cell.split(" ± ")[0]) for cell in cells]


@pytest.mark.slow
def test_a_plate_leads_to_named_quantities_in_one_click(page, app, tmp_path):
    frame, capacities = plate()
    page.open(app, written(frame, tmp_path / "plate.csv"), "plate.csv: 4 trials")
    page.click("start")
    np.testing.assert_allclose(quantities(page, "carrying capacity"), capacities, rtol=0.03)
    assert page.faults() == []


def test_a_table_leads_to_named_quantities_in_three_clicks(page, app, tmp_path):
    frame, half_lives = drug()
    page.open(app, written(frame, tmp_path / "drug.csv"), "drug.csv: 6 trials")
    page.find_element("css selector", "#write summary").click()
    model = "model:one-compartment-with-doses"
    page.wait(f"[...$('write_from').querySelectorAll('option')].some(each => each.value === '{model}')")
    page.choose("write_from", model)
    page.wait("$('parameters').children.length || $('equations_problem').textContent")
    assert page.text("equations_problem") == ""
    page.click("fit")
    page.wait("[...$('quantities').tHead.rows].some(each => each.textContent.includes('half-life'))", 120)
    np.testing.assert_allclose(quantities(page, "half-life"), half_lives, rtol=0.1)
    assert page.faults() == []
