"""The prior of strange objects, and the evidence of some objects alone, against independent computations."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.stats import beta

import commonlaw as cl
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.inference.score.evidence import NoiseScale
from commonlaw.inference.score.supports import StructurePrior, SupportEvidence
from commonlaw.inference.search.strange_objects import most_strange, partition_penalty, poorly_fitted


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


def series(correlated, generator):
    """White residuals of eight objects, those of some of which are autocorrelated by 0.8, in two trials of 50."""
    result = []
    for name in [f"o{i}" for i in range(8)] * 2:
        white = generator.standard_normal(50) * (3 if name == "o1" else 1)
        for k in range(1, 50 if name in correlated else 0):
            white[k] += 0.8 * white[k - 1]
        result.append((name, white))
    return result


def test_a_law_does_not_fit_few_objects_if_their_residuals_are_autocorrelated():
    generator = np.random.default_rng(0)
    assert poorly_fitted(series(("o3", "o6"), generator)) == ("o3", "o6")
    assert poorly_fitted(series(("o0", "o2", "o4", "o6"), generator)) == ()
    named = [bool(poorly_fitted(series((), generator))) for _ in range(300)]
    assert sum(named) <= 3  # At 0.1 % over all objects 0.3 are expected


@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
@pytest.mark.usefixtures("few_starts")
def test_a_fit_names_the_object_that_does_not_obey_its_law(scheme):
    generator, times, states = np.random.default_rng(1), np.linspace(0, 8, 60), []
    for i, k in enumerate((2.0, 2.5, 3.0, 3.5)):

        def rates(_, z, k=k, growth=float(i == 3)):
            return [z[1], -k * z[0] - 0.2 * z[1] + growth * (1.2 - z[0] ** 2) * z[1]]

        curve = solve_ivp(rates, (0, 8), [1.0, 0.0], t_eval=times, rtol=1e-8).y[:1].T
        states.append(curve + 0.02 * generator.standard_normal(curve.shape))
    trials = cl.Trials.from_arrays([times] * 4, states, names=["x"], object=["a", "b", "c", "d"])
    law = cl.fit("x'' = -k x - c v", trials, errors="white", scheme=scheme)
    (outcome,) = [outcome for outcome in law.diagnostics if outcome.code == "objects-not-fitted"]
    assert "(d)" in outcome.text
    fine = cl.fit("x'' = -k x - c v", trials.select(object=["a", "b", "c"]), errors="white", scheme=scheme)
    assert "objects-not-fitted" not in {outcome.code for outcome in fine.diagnostics}
