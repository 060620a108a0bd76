"""How often the stated 95 % intervals of fits of few samples hold the true coefficients."""

import numpy as np
import pytest

from benchmarks.coverage_of_fits import experiment, holds, least_squares, main, stated, stated_of_terms
from tests.refusals import refused


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "objects", "draws"), [(3, 1, 40), (6, 8, 12)])
def test_intervals_of_few_samples_hold_the_truth_as_often_as_they_state(samples, objects, draws):
    drawn = [experiment("decay", samples, objects, seed) for seed in range(draws)]
    share = np.mean([holds(*stated(each.fit("unknown"), each.family), each.truth) for each in drawn])
    assert abs(share - 0.95) < 3 * np.sqrt(0.95 * 0.05 / (draws * objects))  # Three binomial standard errors


@pytest.mark.parametrize(
    ("family", "samples", "kind", "seeds"),
    [
        ("growth", 6, "unknown", range(2)),
        ("growth", 6, "given", range(2)),
        ("growth", 6, "columns", range(2)),
        ("decay", 3, "unknown", range(15, 19)),  # One degree of freedom, to rounding
    ],
)
def test_intervals_of_one_object_are_those_of_least_squares(family, samples, kind, seeds):
    for seed in seeds:
        drawn = experiment(family, samples, 1, seed)
        found = stated_of_terms(drawn.fit(kind), drawn.family, False)
        middle, half = least_squares(drawn, kind, by_terms=True)
        np.testing.assert_allclose(found[0], middle, rtol=1e-3)
        np.testing.assert_allclose(found[1], half, rtol=0.02)


@pytest.mark.parametrize("objects", [1, 8])
def test_residuals_without_degrees_of_freedom_give_no_intervals(objects):
    drawn = experiment("growth", 3, objects, 0)
    with refused("no-degrees-of-freedom", name="x"):
        drawn.fit("unknown")
    found = stated_of_terms(drawn.fit("given", partial_pooling=False), drawn.family, False)
    expected = least_squares(drawn, "given", by_terms=True)
    np.testing.assert_allclose(found[1], expected[1], rtol=0.02)


def test_a_small_run_prints_a_cell(capsys):
    main(["--draws", "1", "--families", "decay", "--samples", "6", "--objects", "1", "--noise", "given"])
    assert "| decay | 6 | 1 | given |" in capsys.readouterr().out
