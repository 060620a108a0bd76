"""A newcomer's way through the app in a browser: tables good and bad, a law, a search cancelled, reloads, two tabs."""

import base64
import csv
import io
import json
import os
import re
import time
import urllib.error
import urllib.request
from hashlib import sha256
from itertools import combinations

import numpy as np
import pytest
from selenium.webdriver import ActionChains, Keys

import commonlaw as cl
from commonlaw.law import from_json
from tests.in_browser import PHONE, SCREEN, download
from tests.ordinary_tables import ORDINARY

MOVES = """
const slider = document.getElementById("slider"), times = [];
for (let i = 0; i < 20; i++) {
  slider.value = i % (Number(slider.max) + 1);
  const began = performance.now();
  slider.dispatchEvent(new Event("input"));
  document.body.getBoundingClientRect();
  times.push(performance.now() - began);
}
return times.sort((a, b) => a - b)[10];
"""


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("app") / "drops.csv"
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05).until(2.0).to_csv(path)
    return path


def test_from_a_table_to_a_law_and_what_to_take_away(page, app, table):
    page.open(app, table, "4 trials of 2 objects")
    assert "x" in page.text("counts")
    page.choose("order", "2")
    page.choose("library", "poly:1")
    page.choose("hold_out", "trial")
    page.choose("held", "2")
    page.choose("setting_errors", "white")
    page.choose("setting_noise", "x=0.05")
    page.click("start")
    page.wait("$('going_done').textContent.includes('reading the table')")
    page.wait("!$('result').hidden")
    page.wait("$('going').hidden")  # The law is shown before its rivals are fitted
    assert re.search(r"\d+ % of the whole", page.text("going_time"))

    trials = cl.Trials.read(table)
    taken = {name: download(app, link, "&title=Balls+%26+<drag>") for name, link in page.files().items()}
    assert taken.pop("law.png").startswith(b"\x89PNG")
    assert taken.pop("coefficients.xlsx").startswith(b"PK")
    taken = {name: content.decode() for name, content in taken.items()}
    law = from_json(taken["law.json"])
    assert law.structure == ("x'' = a + b v",)
    assert law.assess(trials, trials.select(trial=1)).sentences[0] in page.text("verdict")
    assert page.text("command").startswith("commonlaw discover drops.csv --order 2")
    assert "--set noise=x=0.05 --set errors=white --hold-out trial=2" in page.text("command")
    np.testing.assert_allclose(law.uncertainty.noise, 0.05)
    rows = list(csv.DictReader(io.StringIO(taken["coefficients.csv"])))
    assert [(row["object"], row["term"]) for row in rows] == [(name, term) for name in law.objects for term in "1v"]
    np.testing.assert_allclose([float(row["value"]) for row in rows], law.params["estimate"])
    np.testing.assert_allclose([float(row["low"]) for row in rows], law.conf_int()["low"])
    terms = page.find_elements("css selector", "#terms button[aria-pressed=true]")
    assert [each.text for each in terms] == [law.terms.factors[k] for k in law.support[0].nonzero()[0]]
    assert page.execute_script(MOVES) < 100

    slide(page, 0)
    assert page.text("which").startswith("1 term")
    assert len(pressed(page)) == 1
    (term,) = pressed(page)
    assert (
        page.text("command") == f"commonlaw fit drops.csv \"x'' = {'a' if term == '1' else f'a {term}'}\" "
        "--set noise=x=0.05 --set errors=white --hold-out trial=2"
    )
    assert "candidate shown" in page.text("taken")
    assert "law.py" not in page.text("files")
    take_other_terms(page)
    page.wait("$('own_plot').querySelector('canvas')")
    over = page.find_element("css selector", "#forecast_plot .u-over")
    ActionChains(page).move_to_element_with_offset(over, 10, 10).perform()
    readout = page.find_element("css selector", "#forecast_plot .readout").text
    assert re.search(r"Ball 1: fitted [\d.]+ \([\d.]+ to [\d.]+\), measured [\d.]+ at t", readout)
    assert page.text("see_title") == "Measurements and fit"
    page.choose("view", "1")
    assert page.text("see_title") == "Measurements and forecast from the first 7 samples"
    before = page.value("start_0")
    over = page.find_element("css selector", "#own_plot .u-over")
    ActionChains(page).drag_and_drop_by_offset(over, 0, -30).perform()
    page.wait(f"Number($('start_0').value) > Number({before})")
    for width in (PHONE, SCREEN):
        page.resize(width)
        assert page.serious() == {}
        check_law_and_curves_are_in_sight_together(page, width)
    assert "Trials.read('drops.csv'" in taken["law.py"]

    folder = table.parent / "downloads"
    page.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(folder)})
    page.find_element("link text", "coefficients.csv").click()
    page.wait("$('taking').textContent === 'coefficients.csv is in your downloads.'")
    until = time.monotonic() + 10
    while not (folder / "coefficients.csv").exists() and time.monotonic() < until:
        time.sleep(0.1)
    assert (folder / "coefficients.csv").read_text() == taken["coefficients.csv"]

    saved = table.parent / "law.json"
    saved.write_text(taken["law.json"])
    page.type("saved", os.fspath(saved))
    page.wait("$('start').disabled")
    page.wait("!$('start').disabled")
    assert page.text("failed") == ""
    assert page.text("which").startswith("2 terms, chosen")
    assert page.faults() == []
    page.switch_to.new_window("tab")
    page.open(app)
    page.wait("!$('result').hidden")
    check_question(page)
    check_others_are_refused(app)
    check_report(page, taken["report.html"], table)


def check_question(page):
    """Check that the question is the one that was asked."""
    expected = {
        "order": "2", "library": "poly:1", "hold_out": "trial", "held": "2", "setting_errors": "white",
        "setting_noise": "x=0.05",
    }  # fmt: skip
    assert {name: page.value(name) for name in expected} == expected
    assert "x" in page.text("formula")


def check_report(page, report, table):
    """Check that a report names what it is of, that everybody can read it, also on a phone, and that it prints."""
    path = table.parent / "report.html"
    path.write_text(report)
    page.get(path.as_uri())
    assert page.find_element("tag name", "h1").text == "Balls & <drag>"
    about = rf"drops\.csv, [\d-]{{10}}, SHA-256 {sha256(table.read_bytes()).hexdigest()}"
    assert re.search(about, page.find_element("tag name", "body").text)
    assert page.find_elements("css selector", "#methods math")
    page.resize(PHONE)
    assert page.violations() == {}
    printed = base64.b64decode(page.print_page())
    assert 1 < len(re.findall(rb"/Type\s*/Page\b", printed)) <= 6


def check_law_and_curves_are_in_sight_together(page, width):
    """Check that the equation and the slider stand beside the curves, or on a phone stay above them."""
    page.execute_script("document.getElementById(arguments[0]).scrollIntoView()", "see" if width == PHONE else "result")
    places = "forecast_plot", "formula", "slider"
    plot, *others = (page.execute_script(BOX, place) for place in places)
    for box in others:
        assert box["top"] >= 0
        assert box["bottom"] <= 800
    assert plot["top"] < 800
    are_to_the_left = [box["right"] <= plot["left"] for box in others]
    assert are_to_the_left == [width != PHONE] * 2


BOX = "return document.getElementById(arguments[0]).getBoundingClientRect().toJSON()"


def pressed(page):
    return frozenset(each.text for each in page.find_elements("css selector", "#terms button[aria-pressed=true]"))


def take_other_terms(page):
    """Click terms until they are those of a law that was not compared; it is then a candidate."""
    names = [each.text for each in page.find_elements("css selector", "#terms button")]
    most = int(page.find_element("id", "slider").get_attribute("max"))
    seen = set()
    for i in range(most + 1):
        slide(page, i)
        seen.add(pressed(page))
    (missing,) = {frozenset(own) for size in (1, 2, 3) for own in combinations(names, size)} - seen
    for name in pressed(page) - missing:
        click_term(page, name)
    page.wait("$('which').textContent.includes('your choice')")
    assert pressed(page) == missing
    for name in missing:
        click_term(page, name)
    assert "a law needs at least one term" in page.wait("$('terms_failed').textContent")
    assert len(pressed(page)) == 1
    page.refresh()  # and all is there again
    page.wait(f"Number($('slider').max) === {most + 1}")
    check_question(page)


def slide(page, index):
    page.execute_script(
        "const slider = document.getElementById('slider'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'))",
        index,
    )


def click_term(page, name):
    page.find_element("css selector", f'#terms button[data-term="{name}"]').click()


def check_others_are_refused(app):
    """Check that no other site may ask, and that no path of the machine can be named."""
    asked = [
        ("", {}, 401),
        ("guess/", {}, 404),
        (f"{app.room[1:]}../../etc/passwd", {}, 404),
        (f"{app.room[1:]}%2e%2e/routes.py", {}, 404),
        (app.room[1:], {"Host": "evil.example"}, 403),
        (f"{app.room[1:]}datasets", {"Origin": "http://evil.example"}, 403),
    ]
    for path, headers, status in asked:
        data = json.dumps({"name": "lorenz"}).encode() if "Origin" in headers else None
        request = urllib.request.Request(f"http://{app.host}/{path}", data, {"Cookie": app.cookie} | headers)
        with pytest.raises(urllib.error.HTTPError, match=str(status)):
            urllib.request.urlopen(request)


def test_bad_tables_say_what_is_wrong_a_search_can_be_cancelled_and_two_tabs_do_not_meet(page, app, table, tmp_path):
    bad = tmp_path / "bad.csv"
    bad.write_text("object,length\na,1\na,2\n")
    page.open(app, table, "trials")  # Or the last table may open after the bad one
    page.type("file", os.fspath(bad))
    assert "which column holds the time" in page.wait("$('problem').textContent")
    assert not page.find_element("id", "ask").is_displayed()
    (tmp_path / "empty.csv").write_text("")
    page.type("file", os.fspath(tmp_path / "empty.csv"))
    assert "is empty" in page.wait("$('failure').textContent")

    page.choose("sample", "lorenz")
    page.wait("$('counts').textContent.includes('lorenz')")
    page.click("start")
    page.wait("!$('going').hidden && $('going_stage').textContent")
    first = page.current_window_handle
    page.switch_to.new_window("tab")
    page.open(app, counts="lorenz")  # A new tab goes on where the last one is
    page.type("file", os.fspath(table))
    page.wait("$('counts').textContent.includes('drops.csv')")
    assert page.execute_script("return document.getElementById('going').hidden")
    page.close()
    page.switch_to.window(first)
    assert "lorenz" in page.text("counts")
    page.click("going_cancel")
    assert page.wait("$('failed').textContent") == "cancelled"
    assert page.find_element("id", "start").is_enabled()


def test_a_search_shows_its_best_law_so_far_and_stops_with_it(page, app, table):
    page.open(app, table, "trials")
    page.click("start")
    page.wait("!$('going_stop').hidden")
    assert "best law so far: x" in page.text("going_law")
    page.click("going_stop")
    page.wait("$('going').hidden && !$('result').hidden")
    assert not page.text("failed")


def test_roles_that_are_chosen_stay_and_a_file_whose_roles_are_not_recognised_is_opened(page, app, tmp_path):
    rows = [
        f"{sample};{run};{hour / 2};0,{100 + 10 * hour * run};{'late' * (hour > 3)}"
        for sample in ("blank", "yeast") for run in (1, 2) for hour in range(6)
    ]  # fmt: skip
    path = tmp_path / "plate.csv"
    path.write_text("\n".join(["Sample;Run;Time (h);OD600;Note", *rows]))
    page.open(app, path, "4 trials of 2 objects")
    choose_role(page, "Sample", "")
    page.wait("$('problem').textContent.includes('Sample')")
    assert roles(page) == {"Sample": "", "Run": "trial", "Time": "time", "OD600": "state", "Note": ""}
    choose_role(page, "Sample", "object")
    page.wait("$('counts').textContent.includes('4 trials of 2 objects')")
    assert roles(page) == {"Sample": "object", "Run": "trial", "Time": "time", "OD600": "state", "Note": ""}
    assert page.text("problem") == ""
    choose_role(page, "Note", "trial")  # which takes the role from the other column
    assert "the trial is missing" in page.wait("$('problem').textContent")
    assert roles(page) == {"Sample": "object", "Run": "", "Time": "time", "OD600": "state", "Note": "trial"}


GUESSED = {
    "drops": (
        "property: Mass",
        {"Ball": "object", "Drop": "trial", "Mass": "property", "t": "time", "Height": "state"},
    ),
    "growth in rows": (
        "trial: replicate",
        {"strain": "object", "replicate": "trial", "time_h": "time", "OD600": "state"},
    ),
    "driven": (
        "input: F (held at levels)",
        {"rig": "object", "run": "trial", "t": "time", "x": "state", "F": "input"},
    ),
    "growth in columns": (
        "(4 columns), each of an object",
        {"Time": "time", "WT_1": "state", "WT_2": "state", "mut_1": "state", "mut_2": "state"},
    ),
}


def test_ordinary_tables_are_understood_and_a_click_confirms_them(page, app, tmp_path):
    page.open(app)
    for kind, (said, columns) in GUESSED.items():
        path = tmp_path / f"{kind}.csv"
        path.write_text(ORDINARY[kind].table())
        page.type("file", os.fspath(path))
        page.wait(f"$('counts').textContent.includes('{kind}.csv: {ORDINARY[kind].counted}')")
        assert said in page.text("guessed")
        page.click("confirm")
        page.wait("$('guessed').hidden")
        assert page.text("counts").startswith(f"{kind}.csv: {ORDINARY[kind].counted}")
        assert roles(page) == columns
    assert page.serious() == {}


def roles(page):
    found = page.find_elements("css selector", "#columns select[data-column]")
    return {each.get_attribute("data-column"): each.get_attribute("value") for each in found}


def choose_role(page, column, role):
    page.choose_in(f'#columns select[data-column="{column}"]', role)


def test_objects_are_found_by_name_and_seen_large(page, app, tmp_path):
    names = [f"{kind} {i}" for kind in ("carp", "tench") for i in range(6)]
    rows = [f"{name},{t},{i + 0.5 * t}" for i, name in enumerate(names) for t in range(5)]
    path = tmp_path / "ponds.csv"
    path.write_text("\n".join(["object,t [d],mass [g]", *rows]))
    page.open(app, path, "12 objects")
    assert len(page.find_elements("css selector", "#panels path.points[d]")) == 12
    page.type("find", "TENCH")
    shown = [each for each in page.find_elements("css selector", "#panels button") if each.is_displayed()]
    assert [each.text for each in shown] == names[6:]
    assert page.text("matching") == "6 of 12"
    shown[2].click()
    assert page.find_element("css selector", "#forecast_plot .readout").text == "tench 2"
    ActionChains(page).key_down(Keys.CONTROL).click(shown[4]).key_up(Keys.CONTROL).perform()
    assert page.find_element("css selector", "#forecast_plot .readout").text == "tench 2\ntench 4"
    assert page.serious() == {}


def test_the_page_weighs_little():
    from commonlaw.app.routes import ASSETS

    assert sum(map(len, ASSETS.values())) < 1e6
