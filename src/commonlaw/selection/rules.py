"""Information criteria, and the rules by which one equation is selected among candidates."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import lgamma

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import merge
from commonlaw.selection.cross_validation import (
    CrossValidationScore,
    ProblemGroups,
    ResidualError,
    Stability,
    make_folds,
)
from commonlaw.solvers import Candidate
from commonlaw.solvers.base import Problems, least_squares


@dataclass(frozen=True, eq=False)
class FitStatistics:
    """What criteria are computed from.

    Effective rows, mean squared residuals and numbers of terms have shape (objects,); `library` is the number of terms
    to choose from, and `shared` whether all objects share one choice.
    """

    rows: Floats
    variances: Floats
    terms: Floats
    library: int
    shared: bool

    @property
    def deviance(self) -> float:
        """Twice the negative log-likelihood, but for a constant: ``sum_o n_o log(RSS_o / N_o)``."""
        return float(self.rows @ np.log(self.variances))


def aic(fit: FitStatistics) -> float:
    """Return ``deviance + 2 sum_o k_o`` (Akaike 1974, "A new look at the statistical model identification")."""
    return fit.deviance + 2 * float(fit.terms.sum())


def aicc(fit: FitStatistics) -> float:
    """Return ``deviance + sum_o 2 (k_o + 1) n_o / (n_o - k_o - 2)``, infinite where there are too few rows.

    Hurvich and Tsai (1989), "Regression and time series model selection in small samples"; the variance is counted.
    """
    freedom = fit.rows - fit.terms - 2
    if np.any(freedom <= 0):
        return np.inf
    return fit.deviance + float(np.sum(2 * (fit.terms + 1) * fit.rows / freedom))


def bic(fit: FitStatistics) -> float:
    """Return ``deviance + sum_o k_o log n_o`` (Schwarz 1978, "Estimating the dimension of a model")."""
    return fit.deviance + float(fit.terms @ np.log(fit.rows))


def ebic(fit: FitStatistics) -> float:
    """Return the BIC plus ``2 log`` of the number of ways to choose the terms; shared supports count once.

    Chen and Chen (2008), "Extended Bayesian information criteria for model selection with large model spaces", gamma =
    1.
    """
    choices = fit.terms[:1] if fit.shared else fit.terms
    return bic(fit) + 2 * sum(log_choices(fit.library, int(terms)) for terms in choices)


CRITERIA: Mapping[str, Callable[[FitStatistics], float]] = {"aic": aic, "aicc": aicc, "bic": bic, "ebic": ebic}


def log_choices(library: int, size: int) -> float:
    """Return the logarithm of the number of ways to choose so many terms from a library."""
    return lgamma(library + 1) - lgamma(size + 1) - lgamma(library - size + 1)


_ROUNDING = 1e-20
"""Share of a target's sum of squares below which a residual is rounding: ten digits of the target agree."""

_LABELS = {"aic": "AIC", "aicc": "AICc", "bic": "BIC", "ebic": "EBIC"}

RULES = ("one-standard-error", "held-out", *CRITERIA)
"""Names of the rules by which a candidate is chosen."""


@dataclass(frozen=True, eq=False)
class ScoredCandidate:
    """A candidate, fitted to all data, with its information criteria by name, and its errors on held-out data.

    Its stability is how often the least certain of its terms is chosen on resampled data; NaN if that was not asked
    for. It is on the solver's path at these hyperparameters, ascending.
    """

    candidate: Candidate
    criteria: Mapping[str, float]
    held_out: CrossValidationScore
    stability: float
    hyperparameters: tuple[float, ...] = ()

    @property
    def terms(self) -> int:
        """Number of terms that some object has."""
        return int(self.candidate.support.any(axis=0).sum())

    def measures(self) -> dict[str, float | None]:
        """Return what speaks for the candidate by name, None where a measure is not to be had."""
        values = {
            **{_LABELS[name]: value for name, value in self.criteria.items()},
            "held-out error": self.held_out.mean,
            "standard error": self.held_out.standard_error,
            "stability": self.stability,
        }
        return {name: float(value) if np.isfinite(value) else None for name, value in values.items()}


@dataclass(frozen=True, eq=False)
class Selection:
    """The candidates of one equation, and which of them a rule chose, and why.

    The table goes from the fewest coefficients to the most; those of as many by their held-out error.
    """

    table: tuple[ScoredCandidate, ...]
    index: int
    rule: str
    reason: str

    @property
    def chosen(self) -> Candidate:
        return self.table[self.index].candidate


def choose(
    candidates: Sequence[Candidate],
    groups: ProblemGroups,
    target: int,
    allowed: Bools,
    *,
    rule: str = "one-standard-error",
    rows: Floats | None = None,
    differentiation_bias: Callable[[Floats], Floats] | None = None,
    score: Callable[[Bools], CrossValidationScore] | None = None,
    stability: Stability | None = None,
) -> Selection:
    """Return the selection of one equation among candidates; candidates of the same support are listed once.

    Raises `CommonlawError` if there is no candidate or rule of that name, too little data to hold some out, or all
    forecasts diverge.

    Parameters
    ----------
    candidates
        From one or several solvers' paths; hyperparameters that cannot be compared are NaN.
    groups
        The problems of each object's trials and of their segments in time.
    target
        The equation.
    allowed
        Which terms might have entered, shape (terms,).
    rule
        ``"one-standard-error"``: the fewest coefficients whose held-out error exceeds the smallest by no more than the
        standard error of that difference and the bias of the differentiator (Breiman et al. 1984, section 3.4.3).
        ``"held-out"``: without the standard error. ``"aic"``, ``"aicc"``, ``"bic"``, ``"ebic"``: the smallest
        criterion.
    rows
        Effective number of rows of each object, shape (objects,), see `effective_share`; default: all of them.
    differentiation_bias
        From coefficients, shape (objects, terms), to mean squared errors of the differentiator, shape (objects,), see
        `formulation.differentiation_bias`; smaller improvements do not count. Default: a relative error of 1e-10.
    score
        From a support to its errors on held-out data; default: a `ResidualError` on the folds of `make_folds`.
    stability
        Of the solver on resampled data.
    """
    check_choice("rule", rule, RULES)
    if not candidates:
        raise CommonlawError("no-candidate")
    measure = score or ResidualError(make_folds(groups), target)
    scored = sorted(
        ((candidate, values, measure(candidate.support)) for candidate, values in _distinct(candidates)),
        key=lambda row: (int(row[0].support.sum()), row[2].mean),
    )
    problems = [merge(segment for trial in trials for segment in trial) for trials in groups]
    sizes = np.array([problem.tss(target) / problem.rows for problem in problems])
    best = min(scored, key=lambda row: row[2].mean)[0]
    bias = _ROUNDING * sizes + (0.0 if differentiation_bias is None else differentiation_bias(best.coefficients))
    effective = np.array([problem.rows for problem in problems], dtype=float) if rows is None else rows
    criteria = _criteria(
        [candidate for candidate, _, _ in scored], problems, target, int(allowed.sum()), effective, bias
    )
    certainties = [
        np.nan if stability is None else stability.certainty(candidate.support) for candidate, _, _ in scored
    ]
    table = [
        ScoredCandidate(candidate, of_candidate, errors, certainty, hyperparameters)
        for (candidate, hyperparameters, errors), of_candidate, certainty in zip(
            scored, criteria, certainties, strict=True
        )
    ]
    share = float(np.mean(bias / np.where(sizes > 0, sizes, 1.0)))  # In the unit of a `ResidualError`
    return Selection(tuple(table), *_by_rule(table, rule, share if score is None else _ROUNDING))


def _by_rule(table: Sequence[ScoredCandidate], rule: str, bias: float) -> tuple[int, str, str]:
    """Return the index of the chosen candidate, the rule, and why; `bias` is a held-out error that means nothing."""
    if rule in CRITERIA:
        values = [candidate.criteria[rule] for candidate in table]
        index = int(np.argmin(values))
        return index, rule, f"its {_LABELS[rule]}, {values[index]:.4g}, is the smallest of {len(table)} candidates"
    best = min(table, key=lambda candidate: candidate.held_out.mean)
    if not np.isfinite(best.held_out.mean):
        raise CommonlawError("candidates-diverge")
    excesses = (candidate.held_out.excess(best.held_out) for candidate in table)
    weight, slack = 0.0, "the accuracy of the derivatives"
    if rule == "one-standard-error":
        weight, slack = 1.0, f"one standard error and {slack}"
    index = next(i for i, (excess, error) in enumerate(excesses) if excess <= bias + weight * error)
    candidate = table[index]
    text = f"its held-out error is {candidate.held_out.mean:.3g}"
    if candidate is best:
        return index, rule, f"{text}, and that of every smaller candidate is larger by more than {slack}"
    smallest = f"the smallest is {best.held_out.mean:.3g} with {best.terms} terms"
    return index, rule, f"{text}, {smallest}, and no smaller candidate is within {slack} of that"


def _criteria(
    candidates: Sequence[Candidate], problems: Problems, target: int, library: int, rows: Floats, bias: Floats
) -> list[dict[str, float]]:
    """Return the information criteria of each candidate; fits as good as the best but for `bias` are equal."""
    fits = [zip(problems, least_squares(problems, target, candidate.support), strict=True) for candidate in candidates]
    variances = np.array(
        [[problem.rss(coefficients, target) / problem.rows for problem, coefficients in pairs] for pairs in fits]
    )
    variances = np.maximum(variances, variances.min(axis=0) + np.maximum(bias, np.finfo(float).tiny))
    result = []
    for candidate, variance in zip(candidates, variances, strict=True):
        shared = bool(np.all(candidate.support == candidate.support[0]))
        fit = FitStatistics(rows, variance, candidate.support.sum(axis=1).astype(float), library, shared)
        result.append({name: criterion(fit) for name, criterion in CRITERIA.items()})
    return result


def _distinct(candidates: Sequence[Candidate]) -> list[tuple[Candidate, tuple[float, ...]]]:
    """Return one candidate of each support, a proven one if there is one, and the hyperparameters that give it."""
    by_support: dict[bytes, list[Candidate]] = {}
    for candidate in candidates:
        by_support.setdefault(candidate.support.tobytes(), []).append(candidate)
    chosen = [max(same, key=lambda candidate: candidate.proven) for same in by_support.values()]
    values = [
        [candidate.hyperparameter for candidate in same if np.isfinite(candidate.hyperparameter)]
        for same in by_support.values()
    ]
    return [(candidate, tuple(sorted(value))) for candidate, value in zip(chosen, values, strict=True)]
