"""The prior of strange objects, and the evidence of some objects alone, against independent computations."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import beta

from commonlaw.formulation import LeastSquaresProblem
from commonlaw.inference.score.evidence import NoiseScale
from commonlaw.inference.score.supports import StructurePrior, SupportEvidence
from commonlaw.inference.search.strange_objects import most_strange, partition_penalty


@pytest.mark.parametrize(("strange", "objects"), [(0, 5), (1, 5), (3, 10)])
def test_the_prior_integrates_over_the_share_of_strange_objects(strange, objects):
    def density(share):
        return share**strange * (1 - share) ** (objects - strange) * beta(1, 9).pdf(share)

    assert partition_penalty(strange, objects) == pytest.approx(-2 * np.log(quad(density, 0, 1)[0]), rel=1e-9)


def test_less_than_a_third_of_four_objects_or_more_may_be_strange():
    assert [most_strange(count) for count in (1, 3, 4, 6, 7, 9, 10)] == [0, 0, 1, 1, 2, 2, 3]


def test_the_evidence_of_one_object_is_the_bic_of_its_own_regression():
    generator, scale = np.random.default_rng(0), 1.3
    columns, targets = generator.standard_normal((3, 40, 4)), generator.standard_normal((3, 40, 1))
    problems = [LeastSquaresProblem.of(x, y) for x, y in zip(columns, targets, strict=True)]
    prior, allowed = StructurePrior(np.arange(4.0)), np.ones((1, 4), dtype=bool)
    evidence = SupportEvidence(problems, allowed, NoiseScale(120, 110.0), prior, offsets={"outliers": 5.0})
    support = np.array([[True, False, True, False]])
    _, squares, *_ = np.linalg.lstsq(columns[1][:, support[0]], targets[1][:, 0])
    expected = float(squares[0]) / scale**2 + 2 * np.log(40) + prior.of(support[0])
    assert evidence.of_objects([1], 40, scale).value(support) == pytest.approx(expected)
