"""What looks like more or other evidence than it is, is said: copies of trials, and choices that units decide."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl

DROPS = cl.datasets.linear_drag(drag=(-0.1, -0.3), noise=0.01, samples=20)
COPIED = DROPS.with_trials([*DROPS, replace(DROPS[0], name="again"), replace(DROPS[3], object="Ball 1", name="other")])


def test_a_check_names_exact_copies():
    assert not any("copy" in finding for finding in DROPS.check().findings)
    assert [finding for finding in COPIED.check().findings if "copy" in finding] == [
        "Ball 1, trial again: an exact copy of Ball 1, trial 1, which adds no information",
        "Ball 1, trial other: an exact copy of Ball 2, trial 2, which adds no information",
    ]


def test_trials_of_few_samples_can_agree_by_chance():
    short = cl.Trials.from_arrays([[0, 1, 2]] * 2, [[1, 2, 3]] * 2)
    assert not any("copy" in finding for finding in short.check().findings)


@pytest.mark.parametrize(
    "method", [cl.DerivativeRegression(solver="group-stlsq:1"), cl.TrajectoryLikelihood(errors="white")]
)
@pytest.mark.parametrize(("trials", "count"), [(DROPS, 0), (COPIED, 2)])
def test_a_law_of_copied_trials_says_so(trials, count, method):
    law = cl.discover(trials, order=2, library="poly:1", method=method)
    assert sum(diagnostic.kind == "copies" for diagnostic in law.diagnostics) == count


@pytest.mark.parametrize(
    ("solver", "is_said"),
    [
        ("group-stlsq", True),
        ("sr3", True),
        ("group-stlsq:1", False),
        ("group-stlsq:normalize=True", False),
        ("best-subset", False),
        (None, False),
    ],
)
def test_a_choice_that_other_units_may_change_says_so(solver, is_said):
    method = cl.DerivativeRegression(solver=solver, rule="bic", n_resamples=0)
    outcomes = [
        str(diagnostic) for diagnostic in cl.discover(DROPS, order=2, library="poly:1", method=method).diagnostics
    ]
    assert any("the candidates depend on the units of measurement" in outcome for outcome in outcomes) == is_said


@pytest.mark.parametrize(("noise", "seed", "is_said"), [(2.0, 2, True), (1.0, 0, False)])
def test_a_law_with_rivals_about_as_probable_says_so(noise, seed, is_said):
    times = np.linspace(0, 30, 10)
    measured = 20 + 70 * np.exp(-times / 8) + noise * np.random.default_rng(seed).standard_normal(10)
    law = cl.discover(cl.Trials.from_arrays([times], [measured], names=["T"]), order=1, library="poly:2")
    notes = [outcome for outcome in law.diagnostics if outcome.code == "several-laws-plausible"]
    assert len(notes) == is_said
    for outcome in notes:
        rival = law.uncertainty.other_laws[0]
        assert f"{'; '.join(rival.law.structure)} ({rival.probability:.2g})" in str(outcome)
