"""From a table to a law with named quantities in three clicks: a plate reader, a test rig, a drug, a pendulum."""

import time

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from tests.in_browser import choose, is_fault, open_page, wait
from tests.served import served


def plate():
    """Six wells of a wide table: two strains with rates of 0.5 and 0.35 per hour and capacities of 1.2 and 0.8."""
    random, t = np.random.default_rng(7), np.arange(0, 20, 0.25)
    columns = {"Time [h]": t}
    for i, well in enumerate(("A1", "A2", "A3", "B1", "B2", "B3")):
        rate, capacity = (0.5, 1.2) if i < 3 else (0.35, 0.8)
        first = 0.03 * np.exp(0.1 * random.standard_normal())
        size = capacity / (1 + (capacity / first - 1) * np.exp(-rate * t))
        columns[well] = (size + 0.006 * random.standard_normal(len(t))).round(4)
    return pd.DataFrame(columns)


def rig():
    """Two valves: lags with gains of 2 and 1.4, time constants of 6 and 9 s, and a dead time of 3 s."""
    random, t, rows = np.random.default_rng(7), np.arange(0, 60, 0.5), []
    for valve, (gain, constant) in {"one": (2.0, 6.0), "two": (1.4, 9.0)}.items():
        flow = np.zeros(len(t))
        for begin, step in ((5.0, 1.0), (30.0, -0.6)):
            flow += gain * step * np.where(t > begin + 3, 1 - np.exp(-np.maximum(t - begin - 3, 0) / constant), 0)
        opening = np.where(t < 5, 0.0, np.where(t < 30, 1.0, 0.4))
        flow += 0.01 * random.standard_normal(len(t))
        rows.append(pd.DataFrame({"valve": valve, "t_s": t, "u": opening, "flow": flow.round(4)}))
    return pd.concat(rows)


def drug():
    """Six subjects with a bolus of 100 or 200 into one compartment: clearances about 5, volumes about 40."""
    random, rows = np.random.default_rng(7), []
    t = np.array([0.25, 0.5, 1, 2, 3, 4, 6, 8, 10, 12, 16, 24])
    for i in range(6):
        clearance, volume = 5 * np.exp(0.2 * random.standard_normal()), 40 * np.exp(0.15 * random.standard_normal())
        amount = (100.0, 200.0)[i % 2]
        level = amount / volume * np.exp(-clearance / volume * t) * np.exp(0.05 * random.standard_normal(len(t)))
        columns = {"time": np.append(0.0, t), "conc": np.append(np.nan, level.round(4)), "dose": [amount, *(0.0 * t)]}
        rows.append(pd.DataFrame({"ID": f"S{i + 1}", **columns}))
    return pd.concat(rows)


def pendulum():
    """Two pendulums, 0.5 and 1.2 m long."""
    random, t, rows = np.random.default_rng(7), np.arange(0, 10, 0.05), []
    for name, length in {"short": 0.5, "long": 1.2}.items():

        def rates(_, state, length=length):
            return [state[1], -9.81 / length * np.sin(state[0]) - 0.12 * state[1]]

        angle = solve_ivp(rates, (0, 10), [1.2, 0.0], t_eval=t, rtol=1e-9).y[0] + 0.005 * random.standard_normal(len(t))
        rows.append(pd.DataFrame({"pendulum": name, "time": t, "angle": angle.round(4)}))
    return pd.concat(rows)


@pytest.mark.parametrize(
    ("table", "model", "quantity", "expected"),
    [
        (plate, "", "carrying capacity", [1.2] * 3 + [0.8] * 3),
        (rig, "first-order-lag-with-dead-time", "time constant", [6.0, 9.0]),
        (drug, "one-compartment-with-doses", "half-life", None),
        (pendulum, "", "period at small amplitude", [2 * np.pi * np.sqrt(each / 9.81) for each in (0.5, 1.2)]),
    ],
)
def test_a_table_leads_to_named_quantities_in_three_clicks(page, tmp_path, table, model, quantity, expected):
    path = tmp_path / "table.csv"
    table().to_csv(path, index=False)
    with served() as app:
        open_page(page, app)
        begun, clicks = time.monotonic(), 0
        page.find_element("id", "file").send_keys(str(path))
        wait(page, "$('counts').textContent.includes('trial')")
        if model:
            page.find_element("css selector", "#write summary").click()
            wait(page, f"[...$('write_from').querySelectorAll('option')].some(each => each.value === 'model:{model}')")
            choose(page, "write_from", f"model:{model}")
            wait(page, "$('parameters').children.length || $('equations_problem').textContent")
            assert page.find_element("id", "equations_problem").get_attribute("textContent") == ""
            page.find_element("id", "fit").click()
            clicks += 3
        else:
            page.find_element("id", "start").click()
            clicks += 1
        wait(page, "!$('result').hidden && $('quantities').tBodies[0].rows.length", 120)
        print(f"{table.__name__}: {clicks} clicks, {time.monotonic() - begun:.1f} s")
        head = wait(page, "[...$('quantities').tHead.rows[0].cells].map(each => each.textContent)")
        column = next(i for i, each in enumerate(head) if each.startswith(quantity))
        cells = wait(page, f"[...$('quantities').tBodies[0].rows].map(each => each.cells[{column}].textContent)")
        assert all(" to " in cell for cell in cells)  # With intervals
        values = [float(cell.split(" ± ")[0]) for cell in cells]
        if expected is not None:
            np.testing.assert_allclose(values, expected, rtol=0.03)
        assert clicks <= 3
        assert [each for each in page.get_log("browser") if is_fault(each)] == []
