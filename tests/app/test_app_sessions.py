"""Sessions that outlive the app, and coefficients for spreadsheets."""

import io

import numpy as np
import pandas as pd

import commonlaw as cl
from tests.in_browser import download
from tests.served import served


def test_a_session_is_saved_continued_by_another_app_and_taken_back_until_that_ends(
    page, app, sessions_folder, tmp_path
):
    table = tmp_path / "drops.csv"
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05, trials=1).until(2.0).to_csv(table)
    page.open(app, table, "2 trials of 2 objects")
    assert not page.find_element("id", "resume").is_displayed()
    name = page.find_element("id", "session_name")
    name.clear()
    name.send_keys("falling balls")
    page.click("session_save")
    page.wait("$('session_said').textContent.startsWith('Saved')")
    page.fit_drag()
    page.wait("!$('session_undo').hidden")  # The law was saved with it
    before = page.text("coefficients")
    link = page.files()["coefficients.xlsx"]
    book = pd.read_excel(io.BytesIO(download(app, link)), sheet_name=None, engine="openpyxl")
    assert list(book) == ["objects", "coefficients"]
    law = cl.fit("x'' = -g - c v", cl.Trials.read(table), errors="white", guesses={"g": 1.0, "c": 1.0})
    np.testing.assert_allclose(book["coefficients"]["value"], law.params["estimate"], rtol=1e-6)
    tabs = app.say("GET", link.get_attribute("href").partition(app.host)[2].replace("xlsx", "tsv"))[1]
    frame = pd.read_csv(io.BytesIO(tabs), sep="\t", index_col=0)
    assert list(frame.index) == ["Ball 1", "Ball 2"]
    (file,) = sessions_folder.glob("*.json")
    assert file.stat().st_mode & 0o077 == sessions_folder.stat().st_mode & 0o077 == 0

    with served(environment={"COMMONLAW_SESSIONS": str(sessions_folder)}) as later:
        page.open(later)
        page.get_log("browser")  # The page before may have asked the app that has ended
        page.wait("!$('resume').hidden")
        assert "falling balls (drops.csv, " in page.text("saved_sessions")
        assert page.serious() == {}
        page.click("session_open")
        page.wait("!$('result').hidden && $('going').hidden")
        assert page.text("coefficients") == before
        assert page.value("equations") == "x'' = -g - c v"
        assert page.value("session_name") == "falling balls"
        assert page.text("command").startswith("commonlaw fit drops.csv")
        page.click("session_undo")
        page.wait("$('result').hidden && $('session_undo').hidden")
        assert "2 trials of 2 objects" in page.text("counts")
        page.click("session_delete")
        page.wait("$('resume').hidden")
        page.click("session_restore")
        page.wait("!$('resume').hidden")
        assert page.faults() == []
        assert later.say("POST", f"{later.room}sessions/../../etc")[0] in (404, 405, 422)
        assert later.ask("sessions/0123456789abcdef", "POST")[0] == 422
        assert later.ask("sessions", "POST", {"name": " ", "table": "x", "columns": {}})[0] == 422
    page.click("start")
    assert "Start commonlaw app again" in page.wait("$('failed').textContent")
