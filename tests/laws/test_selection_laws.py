"""What holds for every rule of selection."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from commonlaw.formulation import LeastSquaresProblem, merge
from commonlaw.selection.rules import RULES, choose
from commonlaw.solvers import STLSQ

TRUTH = np.array([[2.0, 0.0, -1.0, 0.0], [1.5, 0.0, -0.7, 0.0]])
EVERYTHING = np.ones(4, dtype=bool)
every_rule = pytest.mark.parametrize("rule", RULES)
few = settings(max_examples=10)
every_seed = given(seed=st.integers(0, 10_000))


def problem(seed, unit=1.0):
    """Parts of two objects, three trials each in two blocks."""
    generator = np.random.default_rng(seed)

    def block(own):
        library = generator.standard_normal((15, 4))
        return LeastSquaresProblem.of(library, unit * (library @ own + generator.standard_normal(15))[:, np.newaxis])

    return [[[block(own) for _ in range(2)] for _ in range(3)] for own in TRUTH]


def path(parts, solver):
    return solver.path([merge(block for trial in trials for block in trial) for trials in parts], 0, EVERYTHING)


@every_rule
@few
@every_seed
def test_the_chosen_candidate_is_one_of_the_path(rule, seed):
    parts = problem(seed)
    for solver in (STLSQ(), STLSQ(shared=False)):
        candidates = path(parts, solver)
        choice = choose(candidates, parts, 0, EVERYTHING, rule=rule)
        assert any(choice.chosen is candidate for candidate in candidates)
        assert len(choice.table) == len({candidate.support.tobytes() for candidate in candidates})


@every_rule
@few
@every_seed
def test_the_order_of_candidates_objects_and_trials_and_the_unit_of_the_target_do_not_matter(rule, seed):
    parts = problem(seed)
    first = choose(path(parts, STLSQ()), parts, 0, EVERYTHING, rule=rule).chosen
    turned = [list(reversed(trials)) for trials in reversed(problem(seed, unit=1e-6))]
    again = choose(path(turned, STLSQ())[::-1], turned, 0, EVERYTHING, rule=rule).chosen
    np.testing.assert_array_equal(first.support, again.support)


@few
@every_seed
def test_the_default_rule_never_takes_more_terms_than_the_smallest_held_out_error(seed):
    parts = problem(seed)
    candidates = path(parts, STLSQ(shared=False))
    sizes = [
        choose(candidates, parts, 0, EVERYTHING, rule=rule).chosen.support.sum()
        for rule in ("one-standard-error", "held-out")
    ]
    assert sizes[0] <= sizes[1]


@every_rule
@few
@every_seed
def test_accuracy_that_is_worse_never_adds_terms(rule, seed):
    parts = problem(seed)
    candidates = path(parts, STLSQ())
    sizes = []
    for error in (0.0, 0.5, 100.0):
        choice = choose(
            candidates, parts, 0, EVERYTHING, rule=rule, differentiation_bias=lambda _, error=error: np.full(2, error)
        )
        sizes.append(choice.chosen.support.sum())
    assert sizes == sorted(sizes, reverse=True)
