"""The evidence for shared terms against brute force, and the choice of all equations together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.special import beta

from commonlaw.formulation import LeastSquaresProblem, law_variables
from commonlaw.inference.score import evidence
from commonlaw.inference.score.evidence import NoiseScale, minus_twice_log_evidence, rss_with_added_term
from commonlaw.inference.score.supports import StructurePrior, SupportEvidence, shifted
from commonlaw.kernel import VARIABLE
from commonlaw.library import PolynomialLibrary, Terms, parse_term
from commonlaw.solvers import BestSubset, StepwiseSelection
from commonlaw.trials import Schema


def rows(coefficients, samples=40, seed=0, noise=1.0):
    """Rows of several objects: a library, and a target for these coefficients, shape (objects, terms)."""
    generator = np.random.default_rng(seed)
    found = []
    for coefficient in coefficients:
        library = generator.standard_normal((samples, len(coefficient))) * np.linspace(1, 3, len(coefficient))
        found.append((library, library @ coefficient + noise * generator.standard_normal(samples)))
    return found


def problems(data):
    return [LeastSquaresProblem.of(library, target[:, np.newaxis]) for library, target in data]


def factors(data):
    return np.array([problem.factor for problem in problems(data)])


def test_the_evidence_of_a_single_object_is_the_bic():
    data = rows([[2.0, 0.0, -1.0]])
    library, target = data[0]
    for indices in ([], [0], [0, 2], [2, 1]):
        rest = target - library[:, indices] @ np.linalg.lstsq(library[:, indices], target, rcond=None)[0]
        expected = rest @ rest + len(indices) * np.log(77)
        assert minus_twice_log_evidence(factors(data), np.array(indices, dtype=int), NoiseScale(77)) == pytest.approx(
            expected
        )


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(("apart", "are_told"), [(1e-6, True), (1e-9, False)])
def test_exact_data_tell_terms_of_a_single_object_that_are_nearly_alike(compiled, apart, are_told, monkeypatch):
    if not compiled:
        monkeypatch.setattr(evidence, "kernel", lambda: None)
    ((library, _),) = rows([[1.0, 1.0]])
    both = np.column_stack([library[:, 0], library[:, 0] + apart * library[:, 1]])
    target = 1e3 / apart * (both[:, 1] - both[:, 0])
    own = factors([(both, target)])
    alone, together = (minus_twice_log_evidence(own, np.array(k), NoiseScale(40)) for k in ([0], [0, 1]))
    assert together == (pytest.approx(2 * np.log(40), abs=0.1) if are_told else np.inf)
    assert together < alone or not are_told


def test_noise_of_unknown_scale_is_integrated_out():
    """For normal noise and an inverse gamma prior of its variance that is the density of the t distribution."""
    (library, target) = rows([[2.0, 0.0, -1.0]], noise=0.3)[0]
    measured = NoiseScale(77, freedom=len(target) + 4.0, prior=2.5)

    def exact(squares):
        def log_density(v):
            return -len(target) / 2 * np.log(v) - squares / v / 2 - 3 * np.log(v) - 2.5 / v / 2

        peak = minimize(lambda u: -log_density(np.exp(u[0])), [0.0]).fun
        area = quad(lambda u: np.exp(log_density(np.exp(u)) + u + peak), -8, 8, points=[0.0], limit=200)[0]
        return -2 * (np.log(area) - peak)

    squares = np.array([20.0, 40.0, 80.0])
    found = [measured.deviance(square, 0) for square in squares]
    np.testing.assert_allclose(np.diff(found), np.diff([exact(square) for square in squares]), rtol=1e-6)
    rests = [target - library[:, :k] @ np.linalg.lstsq(library[:, :k], target, rcond=None)[0] for k in (1, 3)]
    values = [minus_twice_log_evidence(factors([(library, target)]), np.arange(k), measured) for k in (1, 3)]
    expected = [measured.deviance(r @ r, k) + k * np.log(77) for r, k in zip(rests, (1, 3), strict=True)]
    np.testing.assert_allclose(values, expected, rtol=1e-9)
    assert measured.variance(rests[1] @ rests[1], 3) == pytest.approx((rests[1] @ rests[1] + 2.5) / (len(target) + 1))


def test_what_is_left_below_the_least_noise_says_no_more_than_noise_of_that_size():
    measured = NoiseScale(77, freedom=70.0, least=0.04)
    assert measured.variance(0.1, 5) == 0.04
    assert measured.deviance(0.2, 5) - measured.deviance(0.1, 5) == pytest.approx(0.1 / 0.04)
    free = replace(measured, least=0.0)
    assert measured.deviance(30.0, 5) == free.deviance(30.0, 5)
    assert free.deviance(0.1, 5) < measured.deviance(0.1, 5)


def marginal(data, indices):
    """Sum of squared residuals, estimates, and minus twice their log-evidence for means and variances over objects."""
    factors = [np.linalg.qr(np.column_stack([library[:, indices], target]), mode="r") for library, target in data]
    inverses = np.linalg.inv(np.array(factors)[:, :-1, :-1])
    estimates = np.array([inverse @ factor[:-1, -1] for inverse, factor in zip(inverses, factors, strict=True)])
    covariances = inverses @ inverses.transpose(0, 2, 1)

    def lost(means, variances):
        """As it is with a prior, less what it is at the estimates themselves."""
        whole, apart = covariances + np.diag(variances), estimates - means
        squares = np.einsum("ni,nij,nj", apart, np.linalg.inv(whole), apart)
        return squares + np.sum(np.linalg.slogdet(whole)[1] - np.linalg.slogdet(covariances)[1])

    return sum(factor[-1, -1] ** 2 for factor in factors), estimates, lost


def test_the_evidence_of_a_shared_term_is_the_marginal_likelihood():
    """With one term the grid of variances is gone through whole, and the best mean has a closed form."""
    for scatter in (0.0, 0.05, 1.0):
        own = 1.5 + scatter * np.random.default_rng(3).standard_normal((6, 1))
        data = rows(own, seed=4)
        rest, estimates, lost = marginal(data, [0])
        precisions = np.array([library[:, 0] @ library[:, 0] for library, _ in data])
        costs = []
        for variance in np.array([0, *10.0 ** np.arange(-4, 2.1, 0.5)]) * np.mean(estimates**2):
            weights = 1 / (1 / precisions + variance)
            costs.append(lost([weights @ estimates[:, 0] / weights.sum()], [variance]))
        expected = rest + min(costs) + np.log(500) + np.log(6)
        assert minus_twice_log_evidence(factors(data), np.array([0]), NoiseScale(500)) == pytest.approx(
            expected, rel=1e-9
        )


def cost_of_scatter(data):
    """What two coefficients cost at the best means and variances over objects."""
    _, estimates, lost = marginal(data, [0, 1])
    starts = ([*estimates.mean(axis=0), *np.log(begin)] for begin in ([1e-3, 1e-3], [0.5, 0.5], [1e-3, 0.5]))
    how = {"method": "Nelder-Mead", "options": {"xatol": 1e-3, "fatol": 1e-4}}
    return min(minimize(lambda p: lost(p[:2], np.exp(p[2:])), start, **how).fun for start in starts)


@pytest.mark.parametrize(("mixed", "scatter"), [(0.5, [0.8, 0.5]), (0.0, [0.0, 0.8])])
def test_the_evidence_of_several_terms_is_that_of_coefficients_orthogonal_mixtures_or_scatter_along_the_mean(
    mixed, scatter
):
    generator = np.random.default_rng(5)
    own = np.array([1.5, -2.0]) + scatter * generator.standard_normal((8, 2))
    data = [(np.column_stack([a[:, 0], mixed * a[:, 0] + a[:, 1]]), y) for a, y in rows(own, seed=6)]
    turn = np.linalg.inv(np.linalg.qr(np.concatenate([library for library, _ in data]), mode="r"))
    _, estimates, _ = marginal([(library @ turn, y) for library, y in data], [0, 1])
    grams = [(library @ turn).T @ (library @ turn) for library, _ in data]
    cosine, sine = np.average(estimates, axis=0, weights=[1 / np.trace(np.linalg.inv(gram)) for gram in grams])
    bases = [np.eye(2), turn, turn @ [[cosine, -sine], [sine, cosine]]]
    costs = np.array([cost_of_scatter([(library @ basis, y) for library, y in data]) for basis in bases])
    expected = -2 * np.log(np.mean(np.exp(-(costs - costs.min()) / 2))) + costs.min()
    rest, *_ = marginal(data, [0, 1])
    whole = minus_twice_log_evidence(factors(data), np.array([0, 1]), NoiseScale(500))
    found = whole - rest - 2 * np.log(500 * 8)
    # A variance that is off by a quarter of a decade costs at most 0.21 for each object
    assert expected - 1e-3 < found < expected + 0.21 * 8 * 2


def test_coefficients_that_are_multiples_of_each_other_scatter_by_one_number():
    """Rates k (21 - x) of objects that differ in k alone, beside those that differ in both coefficients."""
    generator = np.random.default_rng(3)
    scales = np.exp(0.5 * generator.standard_normal(8))
    others = np.exp(0.5 * generator.standard_normal(8))
    values = []
    for heights in (scales, others):
        data = []
        for height, slope in zip(heights, scales, strict=True):
            x = generator.uniform(25, 80, 60)
            y = 21 * height - slope * x + 0.1 * generator.standard_normal(60)
            data.append((np.column_stack([np.ones(60), x]) / 0.1, y / 0.1))
        values.append(minus_twice_log_evidence(factors(data), np.array([0, 1]), NoiseScale(480)))
    # Each object but one saves the scatter of a coefficient, whose error is a hundredth of it
    assert values[0] < values[1] - 7 * 2 * np.log(10)


def test_where_a_variable_is_counted_from_does_not_matter():
    """Relaxation at each object's own rate, seen from afar: the rate is a line, whose height and slope go together."""
    generator, values = np.random.default_rng(2), {}
    x = generator.uniform(0, 2, (6, 80))
    rates = -generator.uniform(0.5, 1.5, (6, 1)) * (x - 1) + 0.1 * generator.standard_normal((6, 80))
    for shift in (1e2, -1e4, 1e6):
        for power in (1, 2):
            library = [np.column_stack([np.ones(80), (each + shift) ** power]) for each in x]
            data = factors(zip(library, rates / 0.1, strict=True))
            values[shift, power] = minus_twice_log_evidence(data, np.array([0, 1]), NoiseScale(480))
    expected = values[1e6, 1]
    assert [values[shift, 1] for shift in (1e2, -1e4)] == pytest.approx([expected] * 2, abs=0.01)
    assert [values[shift, 2] for shift in (-1e4, 1e6)] == pytest.approx([expected] * 2, abs=0.1)


MEASURED = (NoiseScale(77), NoiseScale(77, 77.0, 2.0, least=0.5), NoiseScale(77, 70.0, 2.0, outliers=9.0))


@pytest.mark.parametrize("measured", MEASURED)
@pytest.mark.parametrize("scatter", [0.0, pytest.param(0.3, marks=pytest.mark.slow), 3.0])
@pytest.mark.parametrize(("objects", "terms"), [(1, 3), (2, 1), (7, 3), (12, 6)])
def test_evidence_is_the_same_compiled(monkeypatch, objects, terms, scatter, measured):
    generator = np.random.default_rng(objects + terms)
    data = factors(rows(2.0 + scatter * generator.standard_normal((objects, terms))))
    nothing = data.copy()
    nothing[:, :, 0] = 0.0
    for size in range(terms + 1):
        indices = generator.permutation(terms)[:size]
        for own, needed in ((data, np.inf), (data, 100.0), (nothing, np.inf)):
            found = []
            for choice in ("", "numpy"):
                monkeypatch.setenv(VARIABLE, choice)
                found += [minus_twice_log_evidence(own, indices, measured, needed, k) for k in {0, min(1, size)}]
            assert found[: len(found) // 2] == pytest.approx(found[len(found) // 2 :], rel=1e-9)


def test_units_of_terms_do_not_matter():
    data = rows(1.5 + 0.5 * np.random.default_rng(1).standard_normal((5, 3)))
    other = [(library * [1e-4, 1.0, 1e5], target) for library, target in data]
    indices = np.array([0, 1, 2])
    assert minus_twice_log_evidence(factors(other), indices, NoiseScale(200)) == pytest.approx(
        minus_twice_log_evidence(factors(data), indices, NoiseScale(200))
    )


def test_terms_that_cannot_be_told_apart_have_no_evidence():
    data = [(np.column_stack([library, 0 * library[:, 0]]), target) for library, target in rows(np.ones((3, 2)))]
    assert minus_twice_log_evidence(factors(data), np.array([0, 2]), NoiseScale(100)) == np.inf


def test_supports_that_cannot_be_below_a_bar_get_a_lower_bound():
    data = factors(rows(1.5 + 0.5 * np.random.default_rng(1).standard_normal((5, 3))))
    whole = minus_twice_log_evidence(data, np.array([0, 2]), NoiseScale(200))
    assert minus_twice_log_evidence(data, np.array([0, 2]), NoiseScale(200), whole + 1) == whole
    assert minus_twice_log_evidence(data, np.array([0, 2]), NoiseScale(200), 1.0) <= whole


@pytest.mark.parametrize("indices", [[], [1], [0, 3]])
def test_sums_of_squares_with_each_other_term_are_those_of_least_squares(indices):
    data = rows([[2.0, 0.0, -1.0, 1.0], [1.0, 1.0, 0.0, 0.5]])
    data = [(np.column_stack([library, library[:, 1] + 1e-9 * library[:, 0]]), target) for library, target in data]
    found = rss_with_added_term(factors(data), np.array(indices, dtype=int))

    def rest(kept):
        return sum(np.sum((y - x[:, kept] @ np.linalg.lstsq(x[:, kept], y, rcond=None)[0]) ** 2) for x, y in data)

    assert found[-1] == pytest.approx(rest(indices))
    for index in range(5):
        unclear = index in indices or (index == 4 and 1 in indices)
        assert found[index] == (0.0 if unclear else pytest.approx(rest([*indices, index])))


PRICES = StructurePrior(np.array([0.0, 1.0, 1.0, 2.0, 3.0]))
TRUTH = np.array([[True, False, False, True, False], [False, True, False, True, True]])


def coupled(objects=4, samples=120, seed=1, noise=0.3):
    """Two equations of five terms whose errors are correlated, as least-squares problems of unit variance."""
    generator = np.random.default_rng(seed)
    covariance = noise**2 * np.array([[1.0, 0.95], [0.95, 1.0]])
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    found = []
    for _ in range(objects):
        coefficients = TRUTH * generator.uniform(0.5, 1.5, TRUTH.shape)
        library = generator.standard_normal((samples, 5))
        target = library @ coefficients.T + generator.multivariate_normal([0, 0], covariance, samples)
        both = np.zeros((samples, 2, 10))
        both[:, 0, :5], both[:, 1, 5:] = library, library
        both = np.einsum("ij,njk->nik", white, both).reshape(2 * samples, 10)
        found.append(LeastSquaresProblem.of(both, (target @ white.T).reshape(-1, 1)))
    return found


@pytest.mark.parametrize("objects", [1, 4])
@pytest.mark.parametrize("solver", [BestSubset(nodes=20), StepwiseSelection()])
def test_the_supports_of_coupled_equations_are_found_from_any_start(objects, solver):
    allowed = np.ones_like(TRUTH)
    evidence = SupportEvidence(coupled(objects), allowed, NoiseScale(240 * objects), PRICES)
    for start in (allowed, TRUTH, np.zeros_like(TRUTH)):
        np.testing.assert_array_equal(evidence.choose(start, solver), TRUTH)


def test_terms_that_are_not_allowed_or_too_many_are_not_chosen():
    allowed = np.ones_like(TRUTH)
    for most in (1, 2):
        evidence = SupportEvidence(coupled(), allowed, NoiseScale(480), PRICES, most)
        assert evidence.choose(allowed, BestSubset(nodes=20)).sum(axis=1).tolist() == [most, most]
    allowed[0, 3] = allowed[1] = False
    evidence = SupportEvidence(coupled(), allowed, NoiseScale(480), PRICES)
    chosen = evidence.choose(allowed, BestSubset(nodes=20))
    assert not (chosen & ~allowed).any()
    assert chosen[0, 0]
    for row, listed in zip(allowed, evidence.neighbours(chosen), strict=True):
        assert not any((support & ~row).any() for _, support in listed)


def test_no_other_supports_of_both_equations_have_more_evidence():
    allowed = np.ones_like(TRUTH)
    every = [np.array(list(np.binary_repr(number, 10)), dtype=int).astype(bool).reshape(2, 5) for number in range(1024)]
    for seed in range(4):
        evidence = SupportEvidence(coupled(1, seed=seed), allowed, NoiseScale(240), PRICES)
        best = min(every, key=evidence.value)
        np.testing.assert_array_equal(evidence.choose(allowed, BestSubset(nodes=20)), best)


def test_the_value_is_the_evidence_with_the_price_of_choosing():
    parts = coupled()
    evidence = SupportEvidence(parts, np.ones_like(TRUTH), NoiseScale(480), PRICES)
    alone = minus_twice_log_evidence(np.array([part.factor for part in parts]), np.flatnonzero(TRUTH), NoiseScale(480))
    chances = beta(1 + 2, 5 + 5 - 2) * beta(1 + 3, 5 + 5 - 3) / beta(1, 5) ** 2
    assert evidence.value(TRUTH) == pytest.approx(alone - 2 * np.log(chances) + (0 + 2) + (1 + 2 + 3))


def test_a_law_that_says_where_an_unmeasured_zero_is_pays_for_it():
    variables = law_variables(Schema(("x",)), 2)
    terms = PolynomialLibrary(2).bind(variables)
    prices = StructurePrior(np.zeros(len(terms)), (shifted(terms, 0),), 7.0)
    plain = StructurePrior(np.zeros(len(terms)))
    for names, keeps_its_form in (
        (["1", "v"], True),
        (["1", "x", "v^2"], True),
        (["v^2"], True),
        (["x", "v^2"], False),
        (["x", "v", "x v"], False),
        (["1", "v", "x v"], True),
        (["x^2", "1"], False),
    ):
        support = np.isin(terms.names, names)
        assert prices.of(support) - plain.of(support) == pytest.approx(0.0 if keeps_its_form else 7.0)
    damped = Terms(variables, tuple(parse_term(each, variables) for each in ("1", "v", "exp(-x)", "v*log(x)")))
    assert shifted(damped, 0)[2].tolist() == [False, False, True, False]
    assert shifted(damped, 0)[3].all()


@pytest.mark.parametrize("simple", [0, 1])
def test_of_terms_that_data_cannot_tell_apart_the_simpler_is_chosen(simple):
    prices = np.array([3.0, 3.0])
    prices[simple] = 1.0
    for seed in range(10):
        ((library, target),) = rows([[2.0]], seed=seed)
        both = library * [1, 1] + 1e-6 * np.random.default_rng(seed).standard_normal((40, 2))
        evidence = SupportEvidence(
            problems([(both, target)]), np.ones((1, 2), dtype=bool), NoiseScale(40), StructurePrior(prices)
        )
        assert evidence.choose(np.ones((1, 2), dtype=bool), BestSubset())[0].tolist() == [simple == 0, simple == 1]


def test_coefficients_are_those_of_least_squares_on_the_chosen_columns():
    parts = coupled(2)
    found = SupportEvidence(parts, np.ones_like(TRUTH), NoiseScale(240), PRICES).coefficients(TRUTH)
    assert found.shape == (2, 2, 5)
    for problem, own in zip(parts, found, strict=True):
        columns = np.flatnonzero(TRUTH)
        expected = np.linalg.lstsq(problem.factor[:, columns], problem.factor[:, -1], rcond=None)[0]
        np.testing.assert_allclose(own[TRUTH], expected)
        assert not own[~TRUTH].any()


@pytest.mark.parametrize("objects", [1, 3])
def test_neighbours_are_the_chosen_support_and_all_that_differ_by_one_term_or_an_exchange(objects):
    parts = coupled(objects, seed=1)
    evidence = SupportEvidence(parts, np.ones_like(TRUTH), NoiseScale(240 * objects), PRICES)
    np.testing.assert_array_equal(evidence.choose(TRUTH, BestSubset()), TRUTH)
    for equation, listed in enumerate(evidence.neighbours(TRUTH)):
        inside = TRUTH[equation].sum()
        assert len(listed) == len({support.tobytes() for _, support in listed}) == 1 + 5 + inside * (5 - inside)
        for above, support in listed:
            entered, left = (support & ~TRUTH[equation]).sum(), (TRUTH[equation] & ~support).sum()
            assert max(entered, left) <= 1
            if objects == 1:  # Where no variance over objects is chosen, other equations do not matter
                other = TRUTH.copy()
                other[equation] = support
                assert above == pytest.approx(evidence.value(other) - evidence.value(TRUTH), abs=1e-6)
        factors = [above for above, _ in listed]
        assert factors == sorted(factors)
        assert factors[0] == 0
        np.testing.assert_array_equal(listed[0][1], TRUTH[equation])
