"""What the study finds on examples without noise."""

from dataclasses import replace

import pytest

from commonlaw.report import Picture, Table
from studies.falling_balls.examples import learned_fall
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.worked_examples import _coefficient_verdict, _coefficients, worked_examples


@pytest.fixture(scope="module")
def section():
    return worked_examples(Inquiry(None, "not asked for", 100))


def test_every_printed_coefficient_is_found_but_for_the_one_in_the_errata(section):
    coefficients, trajectories = section.verdicts
    assert coefficients.kind == "reproduced with correction"
    assert coefficients.text.startswith("10 of 11 coefficients")
    assert "0.17 printed, 0.0172 found" in coefficients.text
    assert trajectories.kind == "reproduced"


def test_results_hold_what_was_printed_and_what_was_found(section):
    found = section.results["worked_examples"]
    assert len(found) == 5
    assert found["nonlinear oscillator"]["y"]["x^3"] == {"printed": -1.999, "found": pytest.approx(-1.9988, abs=5e-5)}
    assert found["nonlinear oscillator"]["y"]["y^3"]["found"] == pytest.approx(-0.09949, abs=5e-6)
    assert found["linear-drag fall, threshold 0.1"]["v"]["v"]["found"] == pytest.approx(-0.499, abs=5e-4)
    assert found["Reynolds-drag fall, threshold 0.004"]["v"]["v^2"]["printed"] == 0.17


def test_the_oscillator_is_followed_through_the_part_that_was_not_seen(section):
    assert "up to $t = 25$: they part by at most 0.27%" in section.verdicts[1].text
    assert "−0.1004 and −0.0995: the last digit does not agree for 1 of them" in " ".join(
        section.blocks[-1].text.split()
    )


def test_the_verdict_turns_when_a_number_moves_or_a_term_is_added():
    name = "linear-drag fall, threshold 0.1"
    rows = _coefficients({name: learned_fall(name)})
    assert [row.term for row in rows] == ["1", "v"]
    assert _coefficient_verdict(rows).kind == "reproduced"
    assert _coefficient_verdict([replace(rows[0], found=-9.78), rows[1]]).kind == "differs"
    assert _coefficient_verdict([*rows, replace(rows[0], term="v^2", printed="", found=0.1)]).kind == "differs"


def test_every_figure_is_drawn_and_every_coefficient_is_in_the_table(section):
    pictures = {block.name: block for block in section.blocks if isinstance(block, Picture)}
    assert [len(picture.draw().axes) for picture in pictures.values()] == [3, 4]
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert table.frame["agrees"].tolist() == [True] * 10 + [False]
