"""A stopped search goes on: what was done is not done again, and it ends with the law that it had found unstopped."""

from dataclasses import replace
from time import sleep

import numpy as np
import pytest
from msgspec import msgpack

import commonlaw as cl
from commonlaw.discovery import cache
from commonlaw.law import from_json, to_json
from commonlaw.law.script import recorded_arguments, written
from commonlaw.library.term import Factor, Term
from commonlaw.likelihood import Estimate
from commonlaw.runtime.checkpoint import at_checkpoint, checkpointed, with_checkpoint
from commonlaw.runtime.digest import digest
from commonlaw.runtime.time_limit import TimeLimit
from tests.refusals import refused

DROPS = cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=1, noise=0.01)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    return tmp_path


def stopped(**arguments):
    return from_json(to_json(cl.discover(DROPS, time_limit=0, **arguments)))


def check_same(law, other):
    np.testing.assert_array_equal(law.coefficients, other.coefficients)
    np.testing.assert_array_equal(law.params["standard error"], other.params["standard error"])
    assert law.history == other.history
    assert law.diagnostics == other.diagnostics
    assert law.provenance.calls == other.provenance.calls


def test_a_search_without_time_does_a_step_each_time_and_ends_with_the_law_of_one_that_was_not_stopped(folder):
    whole, first = cl.discover(DROPS, cache=False), stopped()
    (steps,) = folder.iterdir()
    law, sizes = first, [steps.stat().st_size]
    for _ in range(4):
        law = cl.discover(DROPS, time_limit=0, resume=law)
        assert law.provenance.is_stopped
        sizes.append(steps.stat().st_size)
    assert (np.diff(sizes) > 0).all()
    check_same(cl.discover(DROPS, resume=law), whole)
    assert not steps.exists()
    check_same(cl.discover(DROPS, resume=first), whole)  # From the cache


def test_a_search_goes_on_with_its_arguments():
    arguments = {"order": 2, "library": "poly:2", "method": cl.TrajectoryLikelihood(noise={"x": 0.02})}
    law = cl.discover(DROPS, resume=stopped(**arguments), order=2)
    check_same(law, cl.discover(DROPS, cache=False, **arguments))
    assert law.provenance.calls == stopped(**arguments).provenance.calls


def test_what_cannot_go_on_is_refused_by_name(folder):
    law = stopped(order=2)
    with refused("resume-with-changes", names=["order", "library"]):
        cl.discover(DROPS, resume=law, order=1, library="poly:2")
    others = DROPS.with_trials([replace(DROPS[0], states=DROPS[0].states + 1e-9), *DROPS.trials[1:]])
    with refused("resume-with-other-trials"):
        cl.discover(others, resume=law)
    with refused("resume-without-steps"):
        cl.discover(DROPS, resume=law, cache=False)
    with refused("resume-without-steps"):
        cl.discover(DROPS, resume=stopped(order=1, cache=False))
    with refused("resume-complete"):
        cl.discover(DROPS, resume=cl.discover(DROPS, order=2))
    for path in folder.iterdir():
        path.unlink()
    with refused("resume-without-steps"):
        cl.discover(DROPS, resume=law)


def test_steps_that_are_damaged_are_done_again(folder):
    law = stopped()
    (steps,) = folder.iterdir()
    steps.write_bytes(steps.read_bytes()[:-1])
    assert cl.discover(DROPS, resume=law).structure == ("x'' = a + b v",)


def test_a_step_is_taken_from_a_checkpoint_bit_by_bit():
    states = np.asfortranarray(np.random.default_rng(1).normal(size=(5, 3)))
    value = (
        {2: [Estimate((states, states[:, ::2]), np.array([[np.nan, -0.0, np.inf]]), 0.1, np.float64(0.3))]},
        (None, True, "text", 7, np.zeros((0, 2), dtype=bool)),
        Term(((Factor("v0"), 2),)),
    )
    done, results = list[int](), dict[str, bytes]()

    @checkpointed
    def step(number):
        done.append(number)
        sleep(0.01)
        return value

    with with_checkpoint(results):
        first, again, _ = step(1), step(1), step(2)
    assert done == [1, 2]
    assert len(results) == 2
    assert first is value
    assert digest(again) == digest(value)
    read = again[0][2][0]
    assert read.states[0].flags.f_contiguous
    assert read.states[0].flags.writeable
    assert isinstance(read.objective, np.float64)
    assert again[2] == value[2]
    assert again[1][0] is None


@pytest.mark.parametrize("kind", ["os:getcwd", "commonlaw.runtime.files:os.getcwd", "commonlaw.runtime.files:Path"])
def test_nothing_but_classes_of_the_package_is_made_of_a_step(kind):
    results = dict[str, bytes]()
    with with_checkpoint(results):
        at_checkpoint(lambda: sleep(0.01), "step")
        (name,) = results
        results[name] = msgpack.encode(msgpack.Ext(0, msgpack.encode([kind])))
        with pytest.raises(ValueError, match="no class"):
            at_checkpoint(lambda: None, "step")


def test_what_is_quick_or_no_value_is_no_step():
    results = dict[str, bytes]()
    with with_checkpoint(results):
        assert at_checkpoint(lambda: 1, "quick") == 1
        assert at_checkpoint(lambda: sleep(0.01), "of a function", np.sin) is None
    assert not results


def test_time_begins_with_the_first_new_step():
    seconds = [0.0]
    limit = TimeLimit(10, clock=lambda: seconds[0], replays=True)
    limit.take_result()
    seconds[0] = 100.0
    assert not limit.is_over
    limit.end_replay()
    seconds[0] = 109.0
    assert not limit.is_over
    limit.end_replay()
    seconds[0] = 111.0
    assert limit.is_over


def test_a_kept_hash_is_that_of_the_value():
    value = Estimate((np.ones((2, 2)),), np.zeros((1, 2)))
    assert digest([value], keep=True) == digest([value], keep=True) == digest([value])


def test_recorded_arguments_have_the_values_that_were_written():
    values = {
        "order": {"x": 2},
        "known": {("x", "1"): -9.8, "v": {"a": 1e-3}},
        "library": cl.library.PolynomialLibrary(2),
        "method": cl.DerivativeRegression(solver=cl.solvers.STLSQ(threshold=0.5)),
        "shared": ("1",),
        "latent_states": ["u", -1, float("inf")],
    }
    call = f"cl.discover(trials, {', '.join(f'{name}={written(value)}' for name, value in values.items())})"
    assert recorded_arguments(call) == values
    assert recorded_arguments("print(1)") == {}
