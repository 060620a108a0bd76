import numpy as np
import pytest

from commonlaw.diagnostics import Diagnostic
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
from tests.refusals import refused

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
        ("stlqs:1", Diagnostic("unknown-name", {"kind": "solver", "name": "stlqs"})),
        (
            "stlsq:-1",
            Diagnostic("finite-number-bounded", {"name": "threshold", "value": -1, "bound": "of at least", "least": 0}),
        ),
        ("stlsq:nan", Diagnostic("finite-number-bounded", {"name": "threshold"})),
        ("stlsq:big", Diagnostic("finite-number-bounded", {"name": "threshold", "value": "big"})),
        ("group-stlsq:1:l3", Diagnostic("unknown-name", {"kind": "importance", "name": "l3"})),
        ("group-stlsq:1:l1:3", Diagnostic("importance-without-level", {"importance": "l1"})),
        ("group-stlsq:1:quantile:2", Diagnostic("quantile-level", {"level": 2})),
        ("group-stlsq:1:count:0", Diagnostic("vote-magnitude", {"magnitude": 0})),
        ("stlsq:1:2:3:4:5", "spec-syntax"),
        ("best-subset:0", Diagnostic("whole-number", {"name": "terms", "value": 0, "bounds": "of at least 1"})),
        ("best-subset:2.5", Diagnostic("whole-number", {"name": "terms", "value": 2.5})),
        ("best-subset:nodes=0", Diagnostic("whole-number", {"name": "nodes", "value": 0})),
        ("forward:True", Diagnostic("whole-number", {"name": "terms"})),
        ("forward:3:yes", Diagnostic("shared-not-a-choice", {"shared": "yes"})),
        (
            "lasso:-0.1",
            Diagnostic("finite-number-bounded", {"name": "penalty", "value": -0.1, "bound": "of at least", "least": 0}),
        ),
        ("sr3:1:nu=0", Diagnostic("finite-number-bounded", {"name": "nu", "value": 0, "bound": "above", "least": 0})),
    ],
)
def test_solvers_that_do_not_exist_or_fit_are_refused(text, message):
    with refused(message):
        parse_solver(text)
