"""Sessions that outlive the app, and coefficients for spreadsheets."""

import io

import numpy as np
import pandas as pd

import commonlaw as cl
from tests.in_browser import download, faults, fit_drag, offered, open_page, serious, text, wait
from tests.served import served


def test_a_session_is_saved_continued_by_another_app_and_taken_back_until_that_ends(
    page, app, sessions_folder, tmp_path
):
    table = tmp_path / "drops.csv"
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05, trials=1).until(2.0).to_csv(table)
    open_page(page, app, table, "2 trials of 2 objects")
    assert not page.find_element("id", "resume").is_displayed()
    name = page.find_element("id", "session_name")
    name.clear()
    name.send_keys("falling balls")
    page.find_element("id", "session_save").click()
    wait(page, "$('session_said').textContent.startsWith('Saved')")
    fit_drag(page)
    wait(page, "!$('session_undo').hidden")  # The law was saved with it
    before = text(page, "coefficients")
    link = offered(page)["coefficients.xlsx"]
    book = pd.read_excel(io.BytesIO(download(app, link)), sheet_name=None, engine="openpyxl")
    assert list(book) == ["objects", "coefficients"]
    law = cl.fit("x'' = -g - c v", cl.Trials.read(table), errors="white", guesses={"g": 1.0, "c": 1.0})
    np.testing.assert_allclose(book["coefficients"]["value"], law.params["estimate"], rtol=1e-6)
    tabs = app.say("GET", link.get_attribute("href").partition(app.host)[2].replace("xlsx", "tsv"))[1]
    frame = pd.read_csv(io.BytesIO(tabs), sep="\t", index_col=0)
    assert list(frame.index) == ["Ball 1", "Ball 2"]
    (file,) = sessions_folder.iterdir()
    assert file.stat().st_mode & 0o077 == 0 or sessions_folder.stat().st_mode & 0o077 == 0

    with served(environment={"COMMONLAW_SESSIONS": str(sessions_folder)}) as later:
        open_page(page, later)
        page.get_log("browser")  # The page before may have asked the app that has ended
        wait(page, "!$('resume').hidden")
        assert "falling balls (drops.csv, " in text(page, "saved_sessions")
        assert serious(page) == {}
        page.find_element("id", "session_open").click()
        wait(page, "!$('result').hidden && $('going').hidden")
        assert text(page, "coefficients") == before
        assert page.find_element("id", "equations").get_attribute("value") == "x'' = -g - c v"
        assert page.find_element("id", "session_name").get_attribute("value") == "falling balls"
        assert text(page, "command").startswith("commonlaw fit drops.csv")
        page.find_element("id", "session_undo").click()
        wait(page, "$('result').hidden && $('session_undo').hidden")
        assert "2 trials of 2 objects" in text(page, "counts")
        page.find_element("id", "session_delete").click()
        wait(page, "$('resume').hidden")
        page.find_element("id", "session_restore").click()
        wait(page, "!$('resume').hidden")
        assert faults(page) == []
        assert later.say("POST", f"{later.room}sessions/../../etc")[0] in (404, 405, 422)
        assert later.ask("sessions/0123456789abcdef", "POST")[0] == 422
        assert later.ask("sessions", "POST", {"name": " ", "table": "x", "columns": {}})[0] == 422
    page.find_element("id", "start").click()
    assert "Start commonlaw app again" in wait(page, "$('failed').textContent")
