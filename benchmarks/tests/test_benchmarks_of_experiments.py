"""The benchmarks of designed experiments and of bounds, in their small size."""

import pytest

from benchmarks import next_experiment, unseen


@pytest.mark.slow
@pytest.mark.parametrize("designed", [pytest.param(True, marks=pytest.mark.slow), False])
def test_one_draw_of_designed_and_of_random_experiments(designed):
    found = next_experiment.drawn("heights of balls", 28, 1, designed, each=True)
    assert len(found.right) == 2
    assert found.right[1]
    assert all(0.5 < each <= 1 for each in found.promised)
    assert len(found.promised) == designed


def test_one_draw_of_bounds():
    ((interval, bound, hidden),) = unseen.drawn(0, 1)
    assert interval
    assert bound
    assert not hidden
