"""Data that are left out in the app, blanks that are subtracted, and how a table is read."""

import numpy as np
import pytest
from selenium.webdriver import ActionChains

import commonlaw as cl
from commonlaw.app.preview import preview
from commonlaw.app.question import Columns, Edit, Question, Table
from commonlaw.law import to_script
from tests.in_browser import PHONE, SCREEN

TIMES = np.arange(21) / 4
NOISE = 0.001 * (-1) ** np.arange(21)


def _plate():
    """A plate of two wells with growth and two blanks, read at the same times."""
    wells = {"A1": np.exp(0.5 * TIMES) / 10, "A2": np.exp(0.4 * TIMES) / 10, "H1": NOISE, "H2": 0.02 - NOISE}
    rows = [f"{t}," + ",".join(str(0.1 + well[i]) for well in wells.values()) for i, t in enumerate(TIMES)]
    return Table("plate.csv", "\n".join([f"time [h],{','.join(wells)}", *rows]).encode())


def test_changes_follow_one_another_and_are_in_previews_questions_and_programs(tmp_path, monkeypatch):
    edits = (Edit(blanks=("H1", "H2")), Edit(object="A2", between=(1.0, 2.0)), Edit(between=(5.0, 1e300)))
    columns = Columns(wide="OD", edits=edits)
    trials = _plate().trials(columns)
    assert trials.objects == ("A1", "A2")
    np.testing.assert_allclose(trials[0].states[:, 0], np.exp(0.5 * TIMES[TIMES < 5]) / 10 - 0.01)
    kept = TIMES[((TIMES < 1.0) | (TIMES > 2.0)) & (TIMES < 5.0)]
    np.testing.assert_array_equal(trials[1].times, kept)
    shown = preview(_plate(), columns)
    assert shown["problem"] == ""
    assert shown["samples"] == len(kept) + 20

    (tmp_path / "plate.csv").write_bytes(_plate().content)
    monkeypatch.chdir(tmp_path)
    source = Question("table", columns).source(_plate())
    program = to_script(cl.fit("OD' = r OD", trials, errors="white"), source)
    names = {}
    exec(program, names)
    assert names["trials"] == trials


def test_changes_that_leave_nothing_are_refused_and_can_be_undone():
    shown = preview(_plate(), Columns(wide="OD", edits=(Edit(between=(-1.0, 100.0)),)))
    assert shown["problem"].endswith("[everything-excluded]")
    assert shown["recognised"]["wide"] == "OD"
    assert preview(_plate(), Columns(wide="OD"))["problem"] == ""


def test_limits_of_quantification_are_read_by_their_marks():
    table = Table("doses.csv", b"object,t,conc\na,0,8\na,1,4\na,2,2\na,3,BLQ\n")
    (trial,) = table.trials(Columns(below=(("BLQ", 1.5),)))
    assert np.isnan(trial.states[3, 0])
    assert trial.below[3, 0] == 1.5


def test_the_mouse_excludes_a_range_of_times_and_a_curve_and_changes_are_undone(page, app, tmp_path):
    path = tmp_path / "plate.csv"
    path.write_bytes(_plate().content)
    page.open(app, path, "84 samples")
    assert page.find_element("id", "is_wide").get_attribute("checked")
    page.click("exclude_mouse")
    plot = page.find_element("css selector", "#forecast_plot .u-over")
    width = plot.size["width"]
    drag = ActionChains(page).move_to_element_with_offset(plot, -width // 4, 0).click_and_hold()
    drag.move_by_offset(width // 4, 5).release().perform()
    page.wait("$('edits').children.length === 1")
    assert page.text("edits").startswith("Excluded: all objects, time 1.2")
    assert page.text("counts") == "plate.csv: 4 trials of 4 objects, 64 samples. States: value."
    plot = page.find_element("css selector", "#forecast_plot .u-over")
    ActionChains(page).move_to_element_with_offset(
        plot, width // 2 - 8, 12 - plot.size["height"] // 2
    ).click().perform()
    page.wait("$('edits').children.length === 2")
    assert "Excluded: A1" in page.text("edits")
    assert "3 trials of 3 objects" in page.text("counts")
    page.click("undo_see")
    page.wait("$('edits').children.length === 1")
    page.execute_script("document.getElementById('edit').open = true")
    page.execute_script(
        "for (const each of document.getElementById('blanks').options) each.selected = each.value > 'B'"
    )
    page.click("subtract")
    page.wait("$('counts').textContent.includes('2 trials of 2 objects')")
    assert "Subtracted as blanks: H1, H2" in page.text("edits")
    page.click("log")
    assert page.serious() == {}
    page.choose("edit_object", "A2")
    for name, value in (("edit_first", "4"), ("edit_last", "5")):
        page.find_element("id", name).send_keys(value)
    page.click("exclude")
    page.wait("$('edits').children.length === 3")
    assert "Excluded: A2, time 4 to 5" in page.text("edits")
    page.execute_script("document.body.focus()")
    page.find_element("css selector", "body").send_keys("\ue009z\ue000")
    page.wait("$('edits').children.length === 2")
    page.execute_script("document.getElementById('is_wide').click()")
    page.wait("!$('is_wide').checked && $('problem').textContent")
    for width in (PHONE, SCREEN):
        page.resize(width)
    assert page.faults() == []


@pytest.mark.parametrize("edit", [Edit(object="Z9"), Edit(blanks=("A1", "A2", "H1", "H2"))])
def test_changes_of_what_is_not_there_are_refused(edit):
    with pytest.raises(cl.CommonlawError):
        edit.of(_plate().trials(Columns(wide="OD")))
