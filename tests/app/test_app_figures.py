"""Pictures of a law in the app, and the programs that draw them."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.app.question import Columns, HoldOut, Question, Table
from commonlaw.app.result import figure_file, results
from tests.in_browser import PHONE, download
from tests.refusals import refused


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("pictures") / "drops.csv"
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05, trials=2).until(1.0).to_csv(path)
    return path


@pytest.fixture(scope="module")
def found(table):
    question = Question("table", hold_out=HoldOut("trial", "2"))
    trials = Table(table.name, table.read_bytes()).trials(Columns())
    training = question.hold_out.training(trials)
    law = cl.fit("x'' = -g - c v", training, errors="white")
    *_, last = results(law, trials, training, lambda _: None)
    return last, question.source(Table(table.name, table.read_bytes()))


@pytest.mark.slow
def test_every_picture_of_a_law_is_drawn_and_its_program_draws_the_same(found, table, monkeypatch, tmp_path):
    made, source = found
    monkeypatch.chdir(tmp_path)
    (tmp_path / table.name).write_bytes(table.read_bytes())
    kinds = [each["name"] for each in made.candidates[0].shown["figures"]]
    assert kinds == ["law", "fit", "forecast", "residuals", "coefficients", "phase-plane", "profile"]
    scope, fitting = {}, ""
    for kind in kinds:
        drawn = figure_file(f"{kind}.svg", made, source, owner="Ball 1", parameter="c")
        assert drawn.lstrip().startswith(b"<?xml")
        program = figure_file(f"{kind}.py", made, source, owner="Ball 1", parameter="c").decode()
        exec(program.removeprefix(fitting), scope)  # The law is the same for all pictures
        fitting = program.partition("figure = ")[0]
        again = (tmp_path / f"{kind}.svg").read_bytes()
        assert abs(len(again) - len(drawn)) < 0.02 * len(drawn), kind
    assert figure_file("phase-plane.png", made, source, owner="Ball 1").startswith(b"\x89PNG")
    assert b"cl.Law.load('law.json')" in figure_file("law.py", made, source, is_candidate=True)
    for name in ("map.svg", "law.exe"):
        with refused("unknown-name"):
            figure_file(name, made, source)


def test_a_picture_is_chosen_drawn_and_taken_away_and_experiments_are_suggested(page, app, table):
    page.open(app, table, "4 trials of 2 objects")
    page.fit_drag()
    assert len(page.find_elements("css selector", "#see .readout")) == 1  # One legend for curves and residuals
    page.choose("figure", "profile")
    page.choose("figure_object", "Ball 2")
    page.click("draw")
    page.wait("!$('drawn').hidden && $('picture').naturalWidth > 300")
    assert page.execute_script("return document.getElementById('picture').naturalWidth") <= 900
    assert "Ball 2" in page.find_element("id", "picture").get_attribute("alt")
    assert page.serious() == {}
    program = download(app, page.find_element("id", "figure_py")).decode()
    assert "cl.plots.plot_profile(law, trials, 'g', 'Ball 2')" in program
    page.choose("figure", "phase-plane")
    assert page.text("drawing") == ""
    assert not page.find_element("id", "drawn").is_displayed()
    page.click("next_suggest")
    page.wait("$('next_found').querySelector('h3')")
    assert "Expected standard errors" in page.text("next_found")
    page.click("draw")
    page.wait("!$('drawn').hidden")
    page.resize(PHONE)
    assert page.faults() == []


def test_bars_of_absolute_values_stand_apart_from_parameters():
    from commonlaw.plots.style import math

    assert math(r"c v \left|{v}\right|", "c v abs(v)") == r"$c\,v\,|{v}|$"


def test_figures_of_many_objects_fit_a_notebook():
    names = [f"P{i}" for i in range(12)]
    times = np.arange(20) / 10
    trials = cl.Trials.from_arrays(
        times, [np.stack([np.exp(-times), np.exp(-2 * times)], axis=1) for _ in names], object=names, names=["x", "y"]
    )
    law = cl.Law.from_text("x' = -a x; y' = -b y", {"a": dict.fromkeys(names, 1.0), "b": dict.fromkeys(names, 2.0)})
    assert cl.plots.plot_law(law, law.predict(trials)).get_figwidth() <= 9.0
