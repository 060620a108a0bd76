"""Choosing among candidates: folds, criteria, resamples, and the resolution of the targets."""

from math import comb

import numpy as np
import pytest

from commonlaw.differentiation import MedianFilter, SmoothedDifference, parse_differentiation
from commonlaw.formulation import (
    LeastSquaresProblem,
    StrongForm,
    differentiation_bias,
    effective_share,
    law_variables,
    merge,
)
from commonlaw.library import PolynomialLibrary
from commonlaw.selection.cross_validation import CrossValidationScore, ResidualError, make_folds, stability
from commonlaw.selection.rules import RULES, FitStatistics, aic, aicc, bic, choose, ebic
from commonlaw.solvers import STLSQ, Candidate
from commonlaw.trials import Schema, Trial
from tests.refusals import refused

TRUTH = np.array([[2.0, 0.0, -1.0, 0.0], [1.5, 0.0, -0.7, 0.0], [0.9, 0.0, -2.0, 0.0]])
EVERYTHING = np.ones(4, dtype=bool)
SHARED = np.repeat([[True, False, True, False]], 3, axis=0)


def rows(seed=0, noise=0.1, trials=3, blocks=2, samples=20):
    """Library and target of each block: objects, trials, blocks."""
    generator = np.random.default_rng(seed)

    def block(own):
        library = generator.standard_normal((samples, 4))
        return library, (library @ own + noise * generator.standard_normal(samples))[:, np.newaxis]

    return [[[block(own) for _ in range(blocks)] for _ in range(trials)] for own in TRUTH]


def compressed(data):
    return [[[LeastSquaresProblem.of(*block) for block in trial] for trial in trials] for trials in data]


def wholes(parts):
    return [merge(block for trial in trials for block in trial) for trials in parts]


def path(parts, solver=None):
    return (solver or STLSQ()).path(wholes(parts), 0, EVERYTHING)


def candidate(support, parts):
    pairs = zip(wholes(parts), support, strict=True)
    return Candidate(support, np.array([problem.least_squares(own, 0) for problem, own in pairs]), 0.0)


def stacked(blocks):
    library, target = zip(*blocks, strict=True)
    return np.concatenate(library), np.concatenate(target)[:, 0]


# Criteria


def evidence(terms=(2.0, 3.0), shared=False):
    rows, variances = np.array([20.0, 30.0]), np.array([0.5, 2.0])
    return FitStatistics(rows=rows, variances=variances, terms=np.array(terms), library=6, shared=shared)


def test_criteria_are_the_published_sums_over_objects():
    deviance = 20 * np.log(0.5) + 30 * np.log(2.0)
    assert aic(evidence()) == pytest.approx(deviance + 2 * 5)
    # Hurvich and Tsai's form, n log s^2 + n (1 + k / n) / (1 - (k + 2) / n), is larger by one for each row
    tsai = deviance + 20 * (1 + 2 / 20) / (1 - 4 / 20) + 30 * (1 + 3 / 30) / (1 - 5 / 30)
    assert aicc(evidence()) == pytest.approx(tsai - 50)
    assert bic(evidence()) == pytest.approx(deviance + 2 * np.log(20) + 3 * np.log(30))
    assert ebic(evidence()) == pytest.approx(bic(evidence()) + 2 * np.log(comb(6, 2) * comb(6, 3)))
    shared = evidence((2.0, 2.0), shared=True)
    assert ebic(shared) == pytest.approx(bic(shared) + 2 * np.log(comb(6, 2)))
    assert aicc(evidence((18.0, 3.0))) == np.inf  # Too few rows


def test_criteria_in_the_table_are_those_of_the_rows():
    data = rows()
    parts = compressed(data)
    choice = choose([candidate(SHARED, parts)], parts, 0, EVERYTHING, rows=np.array([50.0, 60.0, 70.0]))
    variances = []
    for trials in data:
        library, target = stacked([block for trial in trials for block in trial])
        _, (rss,), _, _ = np.linalg.lstsq(library[:, [0, 2]], target, rcond=None)
        variances.append(rss / len(target))
    expected = np.dot([50, 60, 70], np.log(variances)) + 2 * np.log([50, 60, 70]).sum()
    assert choice.table[0].criteria["bic"] == pytest.approx(expected)


# Held-out data


def test_leaving_out_trials_equals_refits_on_all_rows_of_the_others():
    data = rows()
    found = ResidualError(make_folds(compressed(data)), 0)(SHARED)
    expected = []
    for trials in data:
        target = stacked([block for trial in trials for block in trial])[1]
        for k, trial in enumerate(trials):
            library, known = stacked([block for other in trials[:k] + trials[k + 1 :] for block in other])
            fit = np.linalg.lstsq(library[:, [0, 2]], known, rcond=None)[0]
            held, measured = stacked(trial)
            expected.append(np.mean((held[:, [0, 2]] @ fit - measured) ** 2) / np.mean(target**2))
    np.testing.assert_allclose(found.errors, expected, rtol=1e-10)
    assert found.mean == pytest.approx(np.mean(expected))
    assert found.standard_error == pytest.approx(np.std(expected, ddof=1) / 3)


def test_more_trials_than_folds_are_held_out_together():
    parts = compressed(rows(trials=7))
    folds = make_folds(parts, 3)
    assert [fold.trials for fold in folds[:3]] == [(0, 3, 6), (1, 4), (2, 5)]
    assert [fold.held.rows for fold in folds[:3]] == [120, 80, 80]
    assert all(fold.held.rows + fold.rest.rows == 280 for fold in folds)


def test_segments_of_a_single_trial_are_held_out():
    folds = make_folds(compressed(rows(trials=1, blocks=4)))
    assert len(folds) == 12
    assert all(fold.trials == () and fold.held.rows == 20 and fold.rest.rows == 60 for fold in folds)


def test_objects_count_equally_whatever_their_number_of_trials():
    parts = compressed(rows(trials=4))
    folds = make_folds([parts[0], parts[1][:2], parts[2]])
    by_object = [sum(fold.share for fold in folds if fold.object == index) for index in range(3)]
    np.testing.assert_allclose(by_object, 1 / 3)


def test_the_excess_of_a_candidate_is_taken_fold_by_fold():
    shares = np.full(4, 0.25)
    best = CrossValidationScore(np.array([1.0, 2, 3, 10]), shares)
    other = CrossValidationScore(np.array([1.1, 2.3, 3.2, 10.2]), shares)
    excess, error = other.excess(best)
    assert excess == pytest.approx(0.2)
    assert error == pytest.approx(np.std([0.1, 0.3, 0.2, 0.2], ddof=1) / 2)
    assert error < best.standard_error / 10


def test_one_segment_of_one_trial_cannot_be_held_out():
    parts = compressed(rows(trials=1, blocks=1))
    with refused("one-segment-to-hold-out"):
        make_folds(parts)
    with refused("too-few-folds", count=1):
        make_folds(parts, 1)


# Stability


def test_stability_is_high_for_true_terms_and_low_for_others():
    parts = compressed(rows(noise=0.3))
    found = stability(parts, lambda problems: STLSQ().path(problems, 0, EVERYTHING), 50, seed=1)
    frequencies = found.frequencies(6)
    np.testing.assert_array_equal(frequencies[:, [0, 2]], 1.0)
    assert found.certainty(SHARED) == 1.0
    assert found.certainty(np.repeat([[True, True, True, False]], 3, axis=0)) < 0.9
    assert found.certainty(np.zeros((3, 4), dtype=bool)) == 1.0


def test_resamples_are_rows_repeated_as_often_as_their_block_is_drawn():
    data = rows(trials=2)
    drawn = []

    def noted(problems):
        drawn.append(problems[0])
        return path(compressed(data))

    stability(compressed(data), noted, 1, seed=3)
    counts = np.bincount(np.random.default_rng(3).integers(4, size=4), minlength=4)
    blocks = [block for trial in data[0] for block in trial]
    library, target = stacked([block for block, count in zip(blocks, counts, strict=True) for _ in range(count)])
    expected = np.linalg.lstsq(library, target, rcond=None)[0]
    np.testing.assert_allclose(drawn[0].least_squares(EVERYTHING, 0), expected, rtol=1e-10)


def test_the_same_seed_draws_the_same_resamples():
    parts = compressed(rows(noise=2.0))
    first, again, other = (
        stability(parts, lambda problems: STLSQ(shared=False).path(problems, 0, EVERYTHING), 20, seed).frequencies(6)
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_a_single_block_cannot_be_resampled():
    with refused("one-segment-to-draw"):
        stability(compressed(rows(trials=1, blocks=1)), lambda problems: path([[[s]] for s in problems]))


# The choice


@pytest.mark.parametrize("rule", RULES)
def test_supports_of_objects_of_their_own_hold_all_true_terms(rule):
    parts = compressed(rows(noise=0.3, trials=4))
    assert choose(path(parts, STLSQ(shared=False)), parts, 0, EVERYTHING, rule=rule).chosen.support[SHARED].all()


def test_the_default_rule_takes_the_smallest_candidate_within_one_standard_error_of_the_best():
    parts = compressed(rows(noise=1.5))
    choice = choose(path(parts), parts, 0, EVERYTHING)
    best = min(choice.table, key=lambda each: each.held_out.mean)
    within = [each.terms for each in choice.table if np.subtract(*each.held_out.excess(best.held_out)) <= 1e-15]
    assert choice.table[choice.index].terms == min(within)
    assert choice.table[choice.index].terms < choose(path(parts), parts, 0, EVERYTHING, rule="aic").table[-1].terms


def test_a_better_fit_does_not_count_if_the_differentiator_explains_it():
    data = rows(noise=0.0)
    for trials in data:
        for trial in trials:
            trial[:] = [(library, target + 0.01 * library[:, [1]]) for library, target in trial]
    parts = compressed(data)
    for rule in RULES:
        blind = choose(path(parts), parts, 0, EVERYTHING, rule=rule)
        bias = {"differentiation_bias": lambda coefficients: np.full(len(coefficients), 2e-4)}
        aware = choose(path(parts), parts, 0, EVERYTHING, rule=rule, **bias)
        assert blind.chosen.support.sum() == 9
        np.testing.assert_array_equal(aware.chosen.support, SHARED)


def test_candidates_of_equal_support_are_listed_once_and_a_proof_is_kept():
    parts = compressed(rows())
    plain = candidate(SHARED, parts)
    proven = Candidate(SHARED, plain.coefficients, 2.0, proven=True)
    choice = choose([plain, proven, plain], parts, 0, EVERYTHING)
    assert choice.table[0].candidate is proven
    assert len(choice.table) == 1


def test_a_rule_that_is_not_known_and_no_candidates_are_refused():
    parts = compressed(rows())
    with refused("unknown-name"):
        choose(path(parts), parts, 0, EVERYTHING, rule="aiccc")
    with refused("no-candidate"):
        choose([], parts, 0, EVERYTHING)


def test_a_score_by_which_every_candidate_diverges_is_refused():
    parts = compressed(rows())

    def lost(_):
        return CrossValidationScore(np.full(2, np.inf), np.full(2, 0.5))

    with refused("candidates-diverge"):
        choose(path(parts), parts, 0, EVERYTHING, score=lost)


def test_a_candidate_that_diverges_on_a_fold_is_not_chosen():
    parts = compressed(rows())

    def score(support):
        errors = [0.1, 0.2] if support.sum() > 6 else [0.1, np.inf]
        return CrossValidationScore(np.array(errors), np.full(2, 0.5))

    assert choose(path(parts), parts, 0, EVERYTHING, score=score).chosen.support.sum() == 9


TIMES = np.arange(200) / 10


def trial(noise=0.0, times=TIMES):
    states = np.sin(times) + noise * np.random.default_rng(0).standard_normal(len(times))
    return Trial("A", "1", times, states[:, np.newaxis])


def test_central_differences_of_white_noise_count_two_rows_of_three():
    # Differences two samples apart share a sample: correlation -1/2 at lags of two, so 1 / (1 + 2 / 4)
    assert effective_share(StrongForm(parse_differentiation("centered")), trial()) == pytest.approx(2 / 3, rel=1e-6)


@pytest.mark.parametrize("text", ["savgol:15:3", "savgol:25:3", "finite:4"])
@pytest.mark.parametrize("order", [1, 2])
def test_the_share_is_that_of_the_autocorrelation_of_differentiated_noise(text, order):
    differentiation, count = parse_differentiation(text), 200_000
    noise = np.random.default_rng(0).standard_normal((count, 1))
    rates = differentiation.differentiate(np.arange(count) / 10, noise, order).derivatives[-1][:, 0]
    middle = rates[100:-100]
    lags = [np.mean(middle[: len(middle) - k] * middle[k:]) for k in range(60)]
    expected = 1 / (1 + 2 * np.sum((np.array(lags[1:]) / lags[0]) ** 2))
    assert effective_share(StrongForm(differentiation, order), trial()) == pytest.approx(expected, rel=0.03)


def test_a_median_that_does_not_feel_an_impulse_counts_one_row_a_window():
    times = np.arange(50.0)
    peaked = Trial("A", "1", times, -np.abs(times - 25)[:, np.newaxis])
    form = StrongForm(SmoothedDifference(MedianFilter(5)))
    assert effective_share(form, peaked) == 1 / 7


def test_a_trial_that_is_too_short_is_named():
    with refused("window-too-long", where="A, trial 1"):
        effective_share(StrongForm(parse_differentiation("savgol:25:3")), trial(times=TIMES[:10]))


@pytest.mark.parametrize(
    ("text", "noise"), [("centered", 0.0), ("savgol:15:1", 0.0), ("savgol:15:1", 0.01), ("savgol:25:3", 0.01)]
)
def test_the_resolution_is_the_error_of_the_targets_without_noise(text, noise):
    form = StrongForm(parse_differentiation(text), 2, trim=15)
    terms = PolynomialLibrary(1).bind(law_variables(Schema(("x",)), form.order)).take([1, 2])
    targets = form.samples(trial())[1][:, 0]
    error = np.mean((targets + np.sin(TIMES[15:-15])) ** 2)  # x'' = -x
    found = differentiation_bias(form, terms, [trial(noise)], 0, np.array([-1.0, 0.0]))
    assert error / 2 < found < 2 * error


def test_the_resolution_of_a_method_that_is_exact_is_rounding():
    form = StrongForm(parse_differentiation("savgol:15:3"), 2, trim=10)
    terms = PolynomialLibrary(0).bind(law_variables(Schema(("x",)), form.order))
    falling = Trial("A", "1", TIMES, (10 - 4.9 * TIMES**2)[:, np.newaxis])
    assert differentiation_bias(form, terms, [falling], 0, np.array([-9.8])) < 1e-18
