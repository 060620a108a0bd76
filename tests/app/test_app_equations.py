"""Equations that are written in the app: read, solved, fitted and compared."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from selenium.webdriver import Keys

import commonlaw as cl
from commonlaw.app.equations import Moved, named, solved
from commonlaw.app.question import Columns, Equations, Table
from commonlaw.law import from_json
from tests.in_browser import PHONE, SCREEN, download
from tests.refusals import refused

TIMES = np.linspace(0.0, 4.0, 41)


def _pairs(noise=0.0):
    """A table of two predators with their prey, over which Lotka's equations were integrated."""
    rng, rows = np.random.default_rng(0), ["object,t,x,y"]
    for i, growth in enumerate((1.0, 1.2)):
        states = _lotka(growth, (10.0, 5.0)) + rng.normal(0.0, noise, (2, len(TIMES)))
        rows += [f"P{i},{t},{x},{y}" for t, x, y in zip(TIMES, *states, strict=True)]
    return Table("pairs.csv", "\n".join(rows).encode())


def _lotka(growth, start):
    def rates(_, z):
        return [growth * z[0] - 0.1 * z[0] * z[1], -1.5 * z[1] + 0.075 * z[0] * z[1]]

    return solve_ivp(rates, (TIMES[0], TIMES[-1]), start, t_eval=TIMES, rtol=1e-9, atol=1e-9).y


LOTKA = "x' = a x - b x y\ny' = -c y + d x y"
VALUES = {"a": (1.0, 1.2), "b": (0.1, 0.1), "c": (1.5, 1.5), "d": (0.075, 0.075)}


def test_curves_are_solutions_of_the_equations_with_each_objects_values_from_the_best_initial_conditions():
    found = solved(_pairs(), Columns(), Equations(LOTKA, VALUES))
    assert found["problem"] == ""
    assert [each["object"] for each in found["curves"]] == ["P0", "P1"]
    for curve, growth in zip(found["curves"], VALUES["a"], strict=True):
        at = [curve["t"].index(time) for time in TIMES]
        np.testing.assert_allclose(np.array(curve["states"])[:, at], _lotka(growth, (10.0, 5.0)), rtol=1e-3)
    known = solved(_pairs(), Columns(), Equations(f"{LOTKA}\nx(0) = 7", VALUES))["curves"][0]
    assert known["states"][0][0] == 7.0


def test_curves_follow_a_slider_from_the_initial_values_of_before():
    _, start = (found["initial"] for found in solved(_pairs(), Columns(), Equations(LOTKA, VALUES))["curves"])
    moved = solved(_pairs(), Columns(), Equations(LOTKA, VALUES | {"a": (1.0, 0.9)}), Moved([1], [[], start]))
    ((index, states),) = moved["curves"]
    assert index == 1
    np.testing.assert_allclose(np.array(states)[:, [0, -1]], _lotka(0.9, start)[:, [0, -1]], rtol=1e-3)
    for wrong, code in ((Moved([2], [start, start]), "unknown-name"), (Moved([1], [start, [1.0]]), "start-size")):
        with refused(code):
            solved(_pairs(), Columns(), Equations(LOTKA, VALUES), wrong)


@pytest.mark.parametrize(
    ("written", "code"),
    [
        ("x' = a x - b x z; y' = -c y", "equation"),
        ("x' = a x + b x; y' = -c y", "term-twice"),
        ("x' = a x; y' = sine(y)", "["),
        ("x' = a x", "equations-of-other-states"),
        ("x' =", "["),
    ],
)
def test_what_cannot_be_read_is_said_with_a_code(written, code):
    problem = solved(_pairs(), Columns(), Equations(written))["problem"]
    assert code in problem
    assert problem.endswith("]")


def test_fits_take_fixed_values_bounds_shared_parameters_and_priors():
    trials = _pairs(0.05).trials(Columns())
    given = Equations(LOTKA, VALUES | {"b": (0.11, 0.11)}, fixed=("b",), bounds={"c": (None, 1.4)}, shared={"d": "all"})
    assert given.written == "x' = a x - 0.11 x y; y' = -c y + d x y; c < 1.4"
    law = given.fit(trials, {"errors": "white"})
    estimate = law.params.set_index(["object", "parameter"])["estimate"]
    assert {name for _, name in estimate.index} == {"a", "c", "d"}
    assert max(estimate["P0", "c"], estimate["P1", "c"]) <= 1.4
    assert estimate["P0", "d"] == estimate["P1", "d"]
    assert (
        Equations("x' = -k x; y' = k x", {"k": (-0.5, -0.5)}, fixed=("k",)).written == "x' = -(-0.5) x; y' = (-0.5) x"
    )

    near = Equations(LOTKA, VALUES, priors={"a": (3.0, 1e-6)}).fit(trials, {"errors": "white"})
    rows = near.params.set_index(["object", "parameter"])["estimate"]
    np.testing.assert_allclose([rows["P0", "a"], rows["P1", "a"]], 3.0, atol=1e-4)


def test_models_by_name_are_over_the_columns_of_a_table():
    found = {each["name"]: each for each in named(_pairs().trials(Columns()))}
    assert found["lotka-volterra"]["text"].startswith("x' = ")
    assert "logistic" not in found
    one = Table("weights.csv", b"object,t,weight\na,0,1\na,1,2\na,2,3\n").trials(Columns())
    assert {each["name"]: each for each in named(one)}["logistic"]["text"] == (
        "weight' = r weight (1 - weight/K)\nr > 0\nK > 0"
    )


def test_equations_are_typed_moved_by_sliders_fitted_and_compared(page, app, tmp_path):
    path = tmp_path / "pairs.csv"
    path.write_bytes(_pairs(0.05).content)
    page.open(app, path, "2 trials of 2 objects")
    page.execute_script("document.getElementById('write').open = true")
    field = page.find_element("id", "equations")
    field.send_keys("x' = a x - si")
    assert page.find_element("css selector", "#completions li").text == "sin("
    field.send_keys(Keys.TAB, "y) x")
    assert field.get_attribute("value") == "x' = a x - sin(y) x"
    assert page.wait("$('equations_problem').querySelector('a')?.textContent") == "equations-of-other-states"
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys(LOTKA)
    page.wait("$('parameters').children.length === 4 && !$('equations_problem').textContent")
    assert page.find_elements("css selector", "#equations_formula math")
    assert page.text("see_title") == "Measurements and your equations"
    before = page.execute_script(f"return {PATHS}")
    page.type("parameter_a", Keys.ARROW_RIGHT)
    page.wait(f"{PATHS} !== {before!r}")
    page.choose("setting_errors", "white")
    for name, (value, _) in VALUES.items():
        page.execute_script(SET, name, value)
    page.fit()
    assert page.text("command") == (
        "commonlaw fit pairs.csv \"x' = a x - b x y; y' = -c y + d x y\" --set errors=white"
    )
    law = from_json(download(app, page.files()["law.json"]).decode())
    np.testing.assert_allclose(law.params.query("parameter == 'a'")["estimate"], VALUES["a"], rtol=0.02)
    shown = page.execute_script("return document.querySelector('[data-name=a] input[type=number]').value")
    np.testing.assert_allclose(float(shown), np.mean(VALUES["a"]), rtol=0.02)

    page.choose("write_from", "model:lotka-volterra")
    page.wait("$('equations').value.startsWith(\"x' = \")")
    page.choose("write_from", "law")
    page.wait("document.querySelectorAll('#panels path.line').length === 2")
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys("x' = a x - b x y\ny' = d x y")
    page.wait("$('parameters').children.length === 3")
    page.click("fit")
    page.wait("$('result').hidden")
    page.wait("!$('result').hidden && $('going').hidden")
    page.execute_script("document.getElementById('compare').open = true")
    page.wait("$('rival').options.length === 2")
    page.choose("rival", page.execute_script("return document.getElementById('rival').options[1].value"))
    page.wait("!$('comparison').hidden")
    rows = [each.text for each in page.find_elements("css selector", "#comparison tbody tr")]
    assert any(row.startswith("2 log B") and row.endswith(" 0") for row in rows)
    assert "P0, compared law" in page.find_element("css selector", "#forecast_plot .readout").text
    for width in (PHONE, SCREEN):
        page.resize(width)
        assert page.serious() == {}
    page.refresh()
    page.wait("!$('result').hidden && $('equations').value")
    assert page.value("equations") == "x' = a x - b x y\ny' = d x y"
    assert page.faults() == []


def test_curves_of_twelve_objects_follow_a_slider_that_is_dragged(page, app, tmp_path):
    path, times = tmp_path / "pairs.csv", np.linspace(0.0, 4.0, 50)
    rows = [f"P{i},{t},{10 + i + np.sin(t)},{5 + i + np.cos(t)}" for i in range(12) for t in times]
    path.write_text("\n".join(["object,t,x,y", *rows]))
    page.open(app, path, "12 trials of 12 objects")
    page.write(LOTKA, 4)
    before = page.execute_script(f"return JSON.parse({PATHS})")
    first = float(page.execute_script("return document.querySelector('[data-name=a] input[type=number]').value"))
    delays, answer = page.execute_async_script(DRAG)
    print(f"slider to curves: {np.median(delays):.0f} ms, at most {max(delays):.0f} ms, {len(delays)} frames")
    waits = page.execute_script(WAITS)
    assert np.median(waits) < 20  # Or the body of each answer waits for the acknowledgement of its head, 40 ms
    assert answer["values"]["a"] == pytest.approx([first / 10 * 100**0.43] * 12, rel=1e-3)  # Where it was left
    equations = Equations(LOTKA, answer["values"])
    exact = solved(Table("pairs.csv", path.read_bytes()), Columns(), equations)["curves"]
    for curve, other in zip(answer["curves"], exact, strict=True):
        np.testing.assert_allclose(curve["states"], other["states"], rtol=1e-6)
    last = page.execute_script(f"return JSON.parse({PATHS})")
    assert all(one != other for one, other in zip(before, last, strict=True))
    assert page.faults() == []


WAITS = """
const answers = performance.getEntriesByType("resource").filter(each => each.name.endsWith("/equations"));
return answers.map(each => each.responseEnd - each.responseStart);
"""

DRAG = """
const done = arguments[arguments.length - 1], slider = document.getElementById("parameter_a");
const delays = [], asked = window.fetch;
let answer = null, place = 400;
window.fetch = async (...given) => {
  const got = await asked(...given);
  got.clone().json().then(found => { answer = found.values ? found : answer; });  // That estimates initial values
  return got;
};
const followed = () => delays.push(Number(document.body.dataset.followed));
new MutationObserver(followed).observe(document.body, { attributes: true, attributeFilter: ["data-followed"] });
const rest = () => answer ? done([delays, answer]) : setTimeout(rest, 50);
const move = () => {
  answer = null;
  slider.value = ++place;
  slider.dispatchEvent(new Event("input"));
  setTimeout(place < 430 ? move : rest, place < 430 ? 16 : 300);
};
move();
"""


def test_a_parameter_of_each_trial_is_chosen_fitted_and_shown_by_trial(page, app, tmp_path):
    times, rng = np.linspace(0.0, 4.0, 30), np.random.default_rng(0)
    rates = {("A", "1"): 0.5, ("A", "2"): 0.9, ("B", "1"): 0.6, ("B", "2"): 1.1}
    rows = [
        f"{owner},{trial},{t},{3 * np.exp(-k * t) + 1 + noise}"
        for (owner, trial), k in rates.items()
        for t, noise in zip(times, rng.normal(0.0, 0.02, len(times)), strict=True)
    ]
    path = tmp_path / "decays.csv"
    path.write_text("\n".join(["object,trial,t [h],x [mg]", *rows]))
    page.open(app, path, "4 trials of 2 objects")
    page.write("x' = -k (x - c)", 2)
    for name, by in (("k", "trial"), ("c", "all")):
        line = page.find_element("css selector", f"#parameters [data-name={name}]")
        line.find_element("css selector", "button").click()
        offered = line.find_elements("css selector", "option")
        assert [each.get_attribute("value") for each in offered] == ["object", "trial", "all"]
        next(each for each in offered if each.get_attribute("value") == by).click()
    page.fit()
    assert page.text("command") == ('commonlaw fit decays.csv "x\' = -k (x - c)" --shared k=trial --shared c')
    rows = page.wait("[...$('coefficients').rows].map(row => [...row.cells].map(cell => cell.textContent))")
    shown = {row[0]: row[1 + ["k" in cell for cell in rows[0][1:]].index(True)] for row in rows[1:]}
    for (owner, trial), k in rates.items():
        value, error = map(float, shown[f"{owner}, trial {trial}"].split(" ± "))
        assert abs(value - k) < 4 * error < 0.1
    law = cl.fit("x' = -k (x - c)", cl.Trials.read(path), shared={"k": "trial", "c": "all"})
    for owner, trial, _, value, _ in law.trial_estimates.to_frame().query("parameter == 'k'").values.tolist():
        assert float(shown[f"{owner}, trial {trial}"].split(" ± ")[0]) == pytest.approx(value, 0.01)
    page.refresh()
    page.wait("!$('result').hidden && $('parameters').children.length === 2")
    kept = "[...document.querySelectorAll('#parameters select')].map(each => each.value).join()"
    assert page.execute_script(f"return {kept}") == "trial,all"
    assert page.faults() == []


def test_groups_of_objects_are_compared_with_the_reference_that_is_chosen(page, app, tmp_path):
    hulls = ["bare", "bare", "finned", "finned", "rough", "rough"]
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.12, -0.5, -0.52, -0.3, -0.28), noise=0.05, trials=1).until(2.0)
    drops = drops.with_properties({name: {"hull": hull} for name, hull in zip(drops.objects, hulls, strict=True)})
    path = tmp_path / "drops.csv"
    drops.to_csv(path)
    page.open(app, path, "6 trials of 6 objects")
    page.fit_drag()
    page.find_element("css selector", "#groups_part summary").click()
    page.wait("$('groups').tBodies[0].rows.length === 4")
    page.choose("groups_by", "hull")
    page.choose("groups_reference", "1")
    page.wait("$('groups').tHead.textContent.includes('difference from finned')")
    rows = page.wait("[...$('groups').tBodies[0].rows].map(row => [...row.cells].map(cell => cell.textContent))")
    law = cl.fit("x'' = -g - c v", cl.Trials.read(path), errors="white")
    expected = cl.law.contrasts(law, "hull", "finned")
    assert [row[0].split()[0] for row in rows] == ["g", "g", "c", "c"]
    assert [row[1] for row in rows] == ["bare", "rough"] * 2
    for row, ends in zip(rows, expected[["low", "high"]].to_numpy(dtype=float), strict=True):
        shown = [float(each) for each in row[2].split("\n")[1].split(" to ")]
        np.testing.assert_allclose(shown, ends, rtol=0.03, atol=0.03 * np.ptp(ends))
    assert page.serious() == {}


SET = """
const field = document.querySelector(`[data-name=${arguments[0]}] input[type=number]`);
field.value = arguments[1];
field.dispatchEvent(new Event("change"));
"""


PATHS = "JSON.stringify([...document.querySelectorAll('#panels path.line')].map(each => each.getAttribute('d')))"
