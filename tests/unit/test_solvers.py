import numpy as np
import pytest

from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers import (
    L1,
    L2,
    SR3,
    STLSQ,
    BestSubset,
    Count,
    Lasso,
    Mean,
    Median,
    Quantile,
    StepwiseSelection,
    parse_solver,
)

MAGNITUDES = np.array([[3.0, 0.0], [4.0, 0.2], [0.0, 0.1], [1.0, 0.3]])


@pytest.mark.parametrize(
    ("importance", "expected"),
    [
        (L1(), [8.0, 0.6]),
        (L2(), [np.sqrt(26), np.sqrt(0.14)]),
        (Mean(), [2.0, 0.15]),
        (Median(), [2.0, 0.15]),
        (Quantile(0.25), [0.75, 0.075]),
        (Count(0.2), [3, 2]),
    ],
)
def test_importance_of_a_term_over_the_objects(importance, expected):
    np.testing.assert_allclose(importance.measure(MAGNITUDES), expected)


def test_stlsq_repeats_until_the_support_is_stable():
    library = np.array([[1.0, 1.0], [1.0, 1.1], [1.0, 0.9], [1.0, 1.05]])
    target = np.array([[2.0], [2.0], [2.0], [2.1]])
    (fit,) = STLSQ(0.5, shared=False).solve([LeastSquaresProblem.of(library, target)], np.ones((1, 2), dtype=bool))
    full = np.linalg.lstsq(library, target, rcond=None)[0][:, 0]
    assert abs(full[1]) < 0.5 < abs(full[0])
    np.testing.assert_allclose(fit.coefficients[0], [target.mean(), 0])
    assert fit.largest == pytest.approx(target.mean())


def test_one_sweep_is_not_enough_and_says_so():
    generator = np.random.default_rng(1)
    library = generator.standard_normal((20, 3))
    target = library @ [[1.0], [0.01], [0.0]]
    (fit,) = STLSQ(threshold=0.5, max_iterations=1, shared=False).solve(
        [LeastSquaresProblem.of(library, target)], np.ones((1, 3), dtype=bool)
    )
    assert not fit.converged
    assert fit.support[0].tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("text", "solver"),
    [
        ("stlsq:0.04", STLSQ(0.04, shared=False)),
        ("stlsq:0.04:ridge=1", STLSQ(0.04, ridge=1, shared=False)),
        ("group-stlsq:1.5", STLSQ(1.5)),
        ("group-stlsq:0.2:quantile:0.25", STLSQ(0.2, importance=Quantile(0.25))),
        ("group-stlsq:3:count:0.1:normalize=True", STLSQ(3, importance=Count(0.1), normalize=True)),
        ("best-subset", BestSubset()),
        ("best-subset:3", BestSubset(3)),
        ("forward:4:shared=False", StepwiseSelection(4, shared=False)),
        ("backward:2", StepwiseSelection(2, "backward")),
        ("lasso:0.01", Lasso(0.01)),
        ("sr3:0.5:nu=2", SR3(0.5, nu=2)),
    ],
)
def test_solvers_are_named_by_text(text, solver):
    assert parse_solver(text) == solver


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stlqs:1", "unknown solver 'stlqs': did you mean 'stlsq'"),
        ("stlsq:-1", "threshold is -1: give a finite number of at least 0"),
        ("stlsq:nan", "threshold is nan: give a finite number"),
        ("stlsq:big", "threshold is 'big': give a finite number"),
        ("group-stlsq:1:l3", "unknown importance 'l3': Known: l1, l2, mean"),
        ("group-stlsq:1:l1:3", "importance 'l1' takes no level"),
        ("group-stlsq:1:quantile:2", "quantile level 2 does not fit: give a number from 0 to 1"),
        ("group-stlsq:1:count:0", "magnitude 0 of a vote does not fit"),
        ("stlsq:1:2:3:4:5", "write it as 'stlsq:"),
        ("best-subset:0", "terms is 0: give a whole number of at least 1"),
        ("best-subset:2.5", "terms is 2.5: give a whole number"),
        ("best-subset:nodes=0", "nodes is 0: give a whole number"),
        ("forward:True", "terms is True: give a whole number"),
        ("forward:3:yes", "shared is 'yes': give True"),
        ("lasso:-0.1", "penalty is -0.1: give a finite number of at least 0"),
        ("sr3:1:nu=0", "nu is 0: give a finite number above 0"),
    ],
)
def test_solvers_that_do_not_exist_or_fit_are_refused(text, message):
    with pytest.raises(CommonlawError, match=message):
        parse_solver(text)
