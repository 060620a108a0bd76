"""Bounds and priors of parameters, held against least squares and integrals by SciPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import lsq_linear
from scipy.stats import norm

import commonlaw as cl
from commonlaw.estimation.search import Bounds, _polished
from commonlaw.law.tables import readable
from commonlaw.law.text import with_error
from commonlaw.summary import parameter_table
from tests.refusals import refused
from tests.unit.decays import T, estimates, least, trials_of

pytestmark = pytest.mark.usefixtures("few_starts")


def test_a_parameter_at_its_bound_is_reported_with_a_one_sided_interval():
    y = 2 * np.exp(-0.5 * T) + 0.05 * np.random.default_rng(6).standard_normal(len(T))
    law = cl.fit("x' = -k x + q; q > 0.2; x(0) = a", trials_of({"A": (T, y)}, ["x"]))
    assert estimates(law)["q"][0] == 0.2
    (note,) = [diagnostic for diagnostic in law.diagnostics if diagnostic.code == "estimate-at-bound"]
    assert "0.2" in note.text
    row = readable(parameter_table(law)).set_index("parameter").loc["q"]
    ends = ("estimate", "standard error", "95 % low", "95 % high")
    assert [str(row[name]) for name in ends] == ["0.2", "", "0.2", "0.2269"]

    def residuals(p):
        return 0.2 / p[0] + (p[1] - 0.2 / p[0]) * np.exp(-p[0] * T) - y

    found = least(residuals, [0.5, 2.0])
    assert [estimates(law)[each][0] for each in "ka"] == pytest.approx(found.x, rel=1e-6)


@pytest.mark.parametrize("ends", [(0.2, 0.21), (-np.inf, -0.5), (-5e-4, 5e-4), (-3.0, -2.0)])
def test_a_parameter_keeps_to_narrow_bounds(ends):
    y = np.exp(-T) + 0.05 * np.random.default_rng(6).standard_normal(len(T))
    found = least(lambda p: np.exp(-p[0] * T) - y, [1.0])
    error = np.sqrt(2 * found.cost / (len(T) - 1) / (found.jac.T @ found.jac)[0, 0])
    low, high = found.x[0] + np.array(ends)
    bound = f"k < {high}" if np.isinf(low) else f"{low} < k < {high}"
    law = cl.fit(f"x' = -k x; x(0) = 1; {bound}", trials_of({"A": (T, y)}, ["x"]))
    notes = [diagnostic.text for diagnostic in law.diagnostics if diagnostic.code == "estimate-at-bound"]
    if low < found.x[0] < high:
        assert estimates(law)["k"] == (pytest.approx(found.x[0], rel=1e-7), pytest.approx(error, rel=1e-4))
        assert not notes
    else:
        assert estimates(law)["k"] == (low if low > found.x[0] else high, pytest.approx(np.nan, nan_ok=True))
        assert with_error(found.x[0], error) in notes[0]


@pytest.mark.parametrize("start", ["", "; x(0) = a"])
def test_a_law_at_its_bound_is_refined_to_data_within_and_beyond_it(start):
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(T))
    fast, slow = (trials_of({"A": (T, np.exp(-rate * T) + noise)}, ["x"]) for rate in (1.0, 0.3))
    law = cl.fit(f"x' = -k x; 0 < k < 0.5{start}", fast, errors="white")
    for trials, held in ((slow, False), (fast, True)):
        refined = cl.refine(law, trials, errors="white")
        value, error = estimates(refined)["k"]
        assert value == (0.5 if held else pytest.approx(0.3, abs=3 * error))
        assert np.isnan(error) == held
        assert [note.code for note in refined.diagnostics].count("estimate-at-bound") == held


def test_a_parameter_at_a_bound_of_zero_is_estimated_again_by_refine():
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(T))
    falling, settling = (trials_of({"A": (T, end + (1 - end) * np.exp(-T) + noise)}, ["x"]) for end in (-0.1, 0.3))
    law = cl.fit("x' = -k x + q; q > 0", falling, errors="white")
    assert estimates(law)["q"][0] == 0
    value, error = estimates(cl.refine(law, settling, errors="white"))["q"]
    assert value == pytest.approx(0.3, abs=3 * error)


def test_intervals_end_at_the_bounds_of_parameters():
    y = np.exp(-T) + 0.05 * np.random.default_rng(6).standard_normal(len(T))
    trials = trials_of({"A": (T, y)}, ["x"])
    value, error = estimates(cl.fit("x' = -k x; x(0) = 1", trials))["k"]
    low, high = value - 0.5 * error, value + error
    (row,) = cl.fit(f"x' = -k x; x(0) = 1; {low} < k < {high}", trials).params.to_dict("records")
    assert row["estimate"] == pytest.approx(value, abs=1e-4 * error)
    assert (row["low"], row["high"]) == pytest.approx((low, high), rel=1e-12)


@pytest.mark.parametrize("settings", [{}, {"scheme": "shooting"}])
def test_a_likelihood_cut_by_a_bound_is_not_flat_beyond_it(settings):
    y = 1 + np.exp(-T) + 0.05 * np.random.default_rng(6).standard_normal(len(T))
    trials = trials_of({"A": (T, y)}, ["x"])
    free = cl.fit("x' = -k (x - c)", trials, **settings)
    value, error = estimates(free)["k"]
    law = cl.fit(f"x' = -k (x - c); k < {value + 0.1 * error}", trials, **settings)
    assert law.uncertainty.limits == ()
    assert estimates(law)["c"] == pytest.approx(estimates(free)["c"], rel=1e-3)
    row, wide = (fit.params.set_index("parameter").loc["k"] for fit in (law, free))
    assert (row["low"], row["high"]) == pytest.approx((wide["low"], value + 0.1 * error), rel=1e-3)


class Linear:
    """Residuals ``matrix @ unknowns - target`` in place of those of a model."""

    def __init__(self, matrix, target):
        self.matrix, self.target = matrix, target

    def residuals(self, unknowns, noise, slopes=True):
        return self.matrix @ unknowns - self.target, self.matrix


@pytest.mark.parametrize("seed", [245, 838, 2275])
def test_parameters_that_logarithms_drive_to_zero_come_back(seed):
    source = np.random.default_rng(seed)
    size = 3 if seed % 2 else 4
    matrix, target = source.normal(size=(size + 1, size)).round(1), (3 * source.normal(size=size + 1)).round(1)
    start, near = source.uniform(0, 3, size), source.random(size) < 0.5
    start = np.where(near, np.where(source.random(size) < 0.5, 1e-4, 3 - 1e-4), start)
    found = _polished(Linear(matrix, target), start, np.ones(1), Bounds(np.zeros(size), np.full(size, 3.0)))
    assert found == pytest.approx(lsq_linear(matrix, target, (0, 3), tol=1e-14, method="bvls").x, abs=1e-6)


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_the_optimum_within_bounds_is_that_of_an_active_set(size):
    active = set()
    for seed in range(12):
        source = np.random.default_rng([size, seed])
        matrix, target = source.normal(size=(size + 2, size)), 3 * source.normal(size=size + 2)
        low = source.uniform(-1, 0.5, size)
        high = low + source.uniform(0.1, 2, size)
        best = lsq_linear(matrix, target, (low, high), tol=1e-14, method="bvls")
        start = source.uniform(low, high)
        found = _polished(Linear(matrix, target), start, np.ones(1), Bounds(low, high))
        assert found == pytest.approx(best.x, abs=1e-6)
        assert np.array_equal(found == low, best.active_mask == -1)  # Exactly there, as `at_bound` compares
        assert np.array_equal(found == high, best.active_mask == 1)
        active |= {*best.active_mask.tolist()}
    assert active == {-1, 0, 1}


def test_a_law_with_a_parameter_at_a_bound_of_zero_is_printed():
    y = np.exp(-T) + 0.01 * np.random.default_rng(6).standard_normal(len(T))
    law = cl.fit("x' = -k x - q x^2; x(0) = 1; q >= 0; k < 3", trials_of({"A": (T, y * np.exp(-0.1 * T**2))}, ["x"]))
    assert estimates(law)["q"][0] == 0
    assert "q = 0" in str(law)


@pytest.mark.slow
def test_bounds_in_which_no_solution_is_finite_are_refused():
    with refused("no-finite-start"):
        cl.fit("s' = -V s/(K + s); s(0) = 5; -5 < K < -4.9", trials_of({"A": (T, 5 * np.exp(-T))}, ["s"]))


def test_priors_of_parameters_steer():
    y = 2 * np.exp(-0.5 * T) + 0.1 * np.random.default_rng(7).standard_normal(len(T))
    trials = trials_of({"A": (T, y)}, ["x"])
    law = cl.fit("x' = -k x", trials, initial_values={"x": "a"}, priors={"k": (0.7, 0.005)}, noise={"x": 0.1})

    def residuals(p):
        return np.append((p[1] * np.exp(-p[0] * T) - y) / 0.1, (p[0] - 0.7) / 0.005)

    found = least(residuals, [1.0, 1.0])
    assert [estimates(law)[each][0] for each in "ka"] == pytest.approx(found.x, rel=1e-5)


def test_evidence_with_priors_is_the_integral_of_the_likelihood():
    y = 2 * np.exp(-0.5 * T) + 0.03 * np.random.default_rng(33).standard_normal(len(T))
    trials = trials_of({"A": (T, y)})
    priors = [{"k": (0.6, 0.1), "c": (2.1, 0.2)}, {"k": (0.45, 0.02), "c": (2.0, 0.01)}]
    laws = [cl.fit("x' = -k x; y = c x; x(0) = 1", trials, priors=prior, noise={"y": 0.03}) for prior in priors]
    k, c = np.meshgrid(np.linspace(0.4, 0.6, 401), np.linspace(1.8, 2.2, 401))
    z = (c[..., None] * np.exp(-k[..., None] * T) - y) / 0.03

    def log_evidence(given):
        exponent = norm.logpdf(k, *given["k"]) + norm.logpdf(c, *given["c"]) - 0.5 * (z**2).sum(axis=-1)
        return exponent.max() + np.log(np.exp(exponent - exponent.max()).sum())

    expected = 2 * (log_evidence(priors[0]) - log_evidence(priors[1]))
    frame = cl.compare({"one": laws[0], "two": laws[1]}, trials, noise={"y": 0.03}).set_index("law")
    assert frame["2 log B"]["two"] - frame["2 log B"]["one"] == pytest.approx(expected, abs=0.01)


def test_equations_without_parameters_are_fitted_to_several_trials():
    times = np.linspace(0, 2, 6)
    trials = cl.Trials.from_arrays([times, times], [np.exp(times), np.exp(times) + 0.01], names=["x"])
    assert not estimates(cl.fit("x' = x", trials, initial_values={"x": 1.0}))


@pytest.mark.parametrize("settings", [pytest.param({}, marks=pytest.mark.slow), {"shared": ["c"]}])
def test_terms_are_limited_within_bounds_and_sharing(settings):
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), trials=1, noise=0.05)
    laws = [cl.fit("x'' = -g - c v; c > 0", drops, scheme=scheme, **settings) for scheme in ("collocation", "shooting")]
    one, other = (cl.bounds(law, drops, ["v^2"]).to_frame()[["coefficient", "standard error"]] for law in laws)
    assert_allclose(one, other, rtol=1e-4)
    if settings:  # What objects share is the better determined
        apart = cl.bounds(cl.fit("x'' = -g - c v", drops), drops, ["v^2"]).to_frame()
        assert (one["standard error"] < 0.8 * apart["standard error"]).sum() >= 2
