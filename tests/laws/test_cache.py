"""A law that was found once is taken from the user's cache when the same is asked of the same trials again."""

import os
from dataclasses import dataclass, replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.discovery import cache
from commonlaw.law import Provenance, from_json, to_json
from commonlaw.library import AbstractLibrary
from commonlaw.runtime.digest import digest

DROPS = cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=1, noise=0.01)
QUESTION = {"order": 2, "library": "poly:1"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "laws"))
    return tmp_path / "laws"


@pytest.fixture(scope="module")
def found():
    return cl.discover(DROPS, **QUESTION)


@pytest.fixture
def searches(found, monkeypatch):
    """How often a law was searched; all searches find the same law."""
    done = []

    def find(*_):
        done.append(1)
        return found

    monkeypatch.setattr(cl.LawDiscovery, "_found", find)
    return done


def numbers(law):
    """Return what is the same for laws that are alike in all that a file of a law keeps."""
    others = [(each.probability, replace(each.law, provenance=Provenance(None))) for each in law.uncertainty.other_laws]
    alone = replace(law, uncertainty=replace(law.uncertainty, other_laws=()))
    return digest((alone, others))


def entry(folder):
    (path,) = folder.iterdir()
    return path


def test_a_law_that_was_kept_is_the_one_that_was_found_in_every_number(found):
    assert numbers(from_json(to_json(found))) == numbers(found)
    assert numbers(replace(found, coefficients=np.nextafter(found.coefficients, 0))) != numbers(found)


def test_the_same_question_is_answered_once(folder, searches, found):
    for _ in range(3):
        assert numbers(cl.discover(DROPS, progress=print, **QUESTION)) == numbers(found)
    assert len(searches) == 1
    assert entry(folder).stat().st_size > 1000


def test_other_trials_questions_and_versions_are_answered_anew(folder, searches, monkeypatch):
    states = DROPS[0].states.copy()
    states[7] = np.nextafter(states[7], np.inf)
    nearly = DROPS.with_trials([replace(DROPS[0], states=states), *DROPS.trials[1:]])
    cl.discover(DROPS, **QUESTION)
    cl.discover(nearly, **QUESTION)
    cl.discover(DROPS, order=2, library="poly:2")
    cl.discover(DROPS, shared=("1",), **QUESTION)
    cl.discover(DROPS, method=cl.TrajectoryLikelihood(seed=1), **QUESTION)
    monkeypatch.setenv("COMMONLAW_KERNEL", "numpy")
    cl.discover(DROPS, **QUESTION)
    monkeypatch.setattr(cache, "_version", lambda: "another")
    cl.discover(DROPS, **QUESTION)
    assert len(searches) == len(list(folder.iterdir())) == 7


def test_values_of_which_nobody_knows_whether_they_are_the_same_are_not_kept(folder, searches):
    @dataclass(frozen=True)
    class Mine(AbstractLibrary):
        def bind(self, variables):
            return cl.library.PolynomialLibrary(1).bind(variables)

    for _ in range(2):
        cl.discover(DROPS, order=2, library=Mine())
        cl.discover(DROPS, known=lambda v: -v, **QUESTION)
    assert len(searches) == 4
    assert not folder.exists()


@pytest.mark.parametrize("content", [b"", b"half", b"0" * 64 + b"\n{}", None])
def test_a_damaged_law_is_found_anew_and_kept(content, folder, searches):
    cl.discover(DROPS, **QUESTION)
    whole = entry(folder).read_bytes()
    entry(folder).write_bytes(whole.replace(b"-9.", b"-8.", 1) if content is None else content)
    cl.discover(DROPS, **QUESTION)
    assert len(searches) == 2
    assert entry(folder).read_bytes() == whole


def test_laws_longest_not_asked_for_go_first(folder, searches, monkeypatch):
    cl.discover(DROPS, **QUESTION)
    oldest = entry(folder)
    monkeypatch.setattr(cache, "LARGEST", int(2.5 * oldest.stat().st_size))
    cl.discover(DROPS, order=2, library="poly:2")
    (second,) = set(folder.iterdir()) - {oldest}
    for age, path in enumerate((second, oldest)):
        os.utime(path, (age, age))
    cl.discover(DROPS, **QUESTION)  # Asked for just now, and the other is not
    cl.discover(DROPS, order=2, library="poly:3")
    assert len(searches) == 3
    assert len(list(folder.iterdir())) == 2
    assert oldest.exists()
    assert not second.exists()


def test_nothing_is_kept_where_that_is_not_wanted_or_not_possible(folder, searches, monkeypatch):
    for _ in range(2):
        cl.discover(DROPS, cache=False, **QUESTION)
    assert not folder.exists()
    folder.write_text("a file in its place")
    cl.discover(DROPS, **QUESTION)
    monkeypatch.setenv(cache.VARIABLE, "off")
    cl.discover(DROPS, **QUESTION)
    assert len(searches) == 4
