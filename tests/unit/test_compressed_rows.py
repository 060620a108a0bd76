"""Rows compressed block by block, and drawn again, against all rows at once."""

import numpy as np
import pytest

from commonlaw.formulation import LeastSquaresProblem, merge, redrawn
from commonlaw.formulation.least_squares_problem import BLOCK

TERMS = 70


def monomials(states):
    """All products of up to five of the columns x and y, and more of them with a third one: badly conditioned."""
    x, y, z = states.T
    return np.column_stack([x**i * y**j * z**k for i in range(6) for j in range(6 - i) for k in range(6)])[:, :TERMS]


def walk(rows, seed=0):
    """A slow walk: blocks that follow each other are not alike."""
    generator = np.random.default_rng(seed)
    return 3 * np.sin(np.cumsum(0.05 * generator.normal(size=(rows, 3)), axis=0)) + 1


def solved(library, target):
    """Least squares on all rows by a factorisation of all rows with columns of unit norm."""
    norms = np.linalg.norm(library, axis=0)
    return np.linalg.lstsq(library / norms, target, rcond=1e-15)[0]


@pytest.mark.parametrize("terms", [20, TERMS])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_coefficients_are_those_of_all_rows(scale, terms):
    library = monomials(walk(20 * BLOCK))[:, :terms] * scale ** np.linspace(-1, 1, terms)
    truth = np.random.default_rng(1).normal(size=terms) / np.linalg.norm(library, axis=0)
    target = library @ truth + np.random.default_rng(2).normal(size=len(library))
    problem = LeastSquaresProblem.of(library, target[:, np.newaxis])
    norms = np.linalg.norm(library, axis=0)
    assert problem.rows == len(library)
    np.testing.assert_allclose(problem.norms, norms, rtol=1e-11)
    expected = solved(library, target)
    found = problem.least_squares(np.ones(terms, dtype=bool), 0) * norms
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())
    assert problem.rss(found / norms, 0) == pytest.approx(np.sum((target - library / norms @ expected) ** 2), rel=1e-10)


def test_coefficients_are_those_of_all_rows_where_first_ones_visit_little():
    states = walk(8 * BLOCK)
    states[: 2 * BLOCK] = 1 + 0.01 * (states[: 2 * BLOCK] - 1)
    library = monomials(states)[:, :40]
    target = library @ np.random.default_rng(1).normal(size=40) + np.random.default_rng(2).normal(size=len(library))
    problem = LeastSquaresProblem.of(library, target[:, np.newaxis])
    found = problem.least_squares(np.ones(40, dtype=bool), 0) * problem.norms
    expected = solved(library, target)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_a_small_residual_is_as_accurate_as_by_orthogonal_transformations():
    library = monomials(walk(10 * BLOCK))
    truth = np.zeros(TERMS)
    truth[[1, 7, 12]] = 1, -2, 0.5
    noise = 1e-6 * np.random.default_rng(3).normal(size=len(library))
    problem = LeastSquaresProblem.of(library, (library @ truth + noise)[:, np.newaxis])
    support = truth != 0
    assert problem.rss(problem.least_squares(support, 0), 0) == pytest.approx(float(noise @ noise), rel=1e-3)


@pytest.mark.parametrize("change", ["louder", "constant at first", "zero at first", "dependent", "missing"])
def test_rows_unlike_the_first_ones_are_taken_otherwise(change):
    library = np.random.default_rng(4).normal(size=(6 * BLOCK, TERMS))
    begin = slice(BLOCK)
    if change == "louder":
        library[BLOCK:, 5] *= 1e9
    elif change == "constant at first":
        library[begin, 5] = 1 + 1e-13 * library[begin, 5]
        library[:, 6] = 1
    elif change == "zero at first":
        library[begin, 5] = 0
    elif change == "dependent":
        library[:, 9] = library[:, 4] - library[:, 5]
    else:
        library[-1, 3] = np.nan
    problem = LeastSquaresProblem.of(library, library[:, :1] * 2)
    if change == "missing":
        assert not np.isfinite(problem.factor).all()
        return
    scale = np.linalg.norm(library, axis=0)
    own, expected = problem.factor[:, :TERMS] / scale, library / scale
    np.testing.assert_allclose(own.T @ own, expected.T @ expected, atol=1e-12)


def test_ever_louder_rows_are_compressed():
    rows, louder = np.random.default_rng(5).normal(size=(200, 30)), [1, 50, 90, 90, 1e4]
    problem = LeastSquaresProblem.of(*np.split(np.concatenate([rows * factor for factor in louder]), [-1], axis=1))
    assert problem.rows == 1000
    expected = np.sum(np.square(louder)) * rows.T @ rows
    np.testing.assert_allclose(problem.factor.T @ problem.factor, expected, rtol=1e-10)


@pytest.mark.parametrize("columns", [5, 40])
def test_draws_of_blocks_are_the_merger_of_what_was_drawn(columns):
    generator = np.random.default_rng(6)
    blocks = [LeastSquaresProblem.of(*np.split(generator.normal(size=(90, columns)), [-2], axis=1)) for _ in range(30)]
    only = generator.normal(size=(90, columns))
    only[:, 1] *= 1e6  # A draw without it is of quite other columns
    blocks.append(LeastSquaresProblem.of(*np.split(only, [-2], axis=1)))
    counts = np.array([np.bincount(generator.integers(31, size=31), minlength=31) for _ in range(12)], dtype=np.float64)
    assert (counts[:, -1] == 0).any()
    for own in counts:
        found = redrawn(blocks, own)
        assert found.rows == own @ [block.rows for block in blocks]
        merged = merge(block.weighted(count) for block, count in zip(blocks, own, strict=True) if count)
        assert found.terms == merged.terms
        scale = np.linalg.norm(merged.factor, axis=0)
        mine, theirs = found.factor / scale, merged.factor / scale
        np.testing.assert_allclose(mine.T @ mine, theirs.T @ theirs, atol=1e-11)
        for target in range(2):
            support = np.ones(columns - 2, dtype=bool)
            expected = merged.least_squares(support, target)
            np.testing.assert_allclose(found.least_squares(support, target), expected, rtol=1e-7)


def test_draws_of_blocks_with_dependent_columns_are_merged():
    library = np.random.default_rng(7).normal(size=(400, 6))
    library[:, 3] = library[:, 2]
    blocks = [LeastSquaresProblem.of(library[i : i + 50], library[i : i + 50, :1]) for i in range(0, 400, 50)]
    found = redrawn(blocks, np.ones(8))
    np.testing.assert_allclose(found.factor.T @ found.factor, merge(blocks).factor.T @ merge(blocks).factor, atol=1e-9)
    assert found.rows == 400


def test_weighted_rows_are_copies_of_these():
    generator = np.random.default_rng(5)
    library = monomials(walk(3000))[:, :30]
    targets = library[:, :2] @ [[1.0, 2.0], [3.0, -1.0]] + 1e-3 * generator.normal(size=(3000, 2))
    targets[-1] += 5.0  # A row without which much less is left
    support = np.ones(30, dtype=bool)
    for _ in range(2):
        count = np.bincount(generator.integers(3000, size=3000), minlength=3000)
        found = LeastSquaresProblem.of(library, targets, count.astype(float))
        expected = LeastSquaresProblem.of(np.repeat(library, count, axis=0), np.repeat(targets, count, axis=0))
        assert (found.terms, found.rows, expected.rows) == (30, 3000, 3000)
        for target in range(2):
            values = expected.least_squares(support, target)
            misses = (found.least_squares(support, target) - values) * expected.norms
            assert np.abs(misses).max() < 1e-8 * np.abs(values * expected.norms).max()
            assert found.rss(values, target) == pytest.approx(expected.rss(values, target), rel=1e-7)
