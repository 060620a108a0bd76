"""The search for strange objects, which are named and left out of the law of the others.

Objects that a linearization suspects are searched for laws of their own, and the others for theirs, see
`commonlaw.inference.search.strange_objects`. They are strange if both together are more probable than one law of all,
and if each contradicts the law of the others by itself: with coefficients and white noise of its own that is less
probable than a law with a term that the others lack, or than errors of another kind, such as a random walk. An object
that follows the law of the others with coefficients or noise far from theirs is strange if it changes the law of all.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.diagnostics import note
from commonlaw.discovery.candidate_search import Candidate, CandidateSearch
from commonlaw.discovery.hints import column_in_other_units, kelvin_offset
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_solutions
from commonlaw.inference.fit.covariance import fitted_law, residuals_by_group
from commonlaw.inference.fit.final_score import score_of_order
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.search.error_models import estimate_error_model, is_white
from commonlaw.inference.search.setup import error_kinds
from commonlaw.inference.search.strange_objects import (
    Apart,
    Reason,
    StrangeObject,
    most_strange,
    partition_penalty,
    suspects,
)
from commonlaw.law import Law, Provenance, Step
from commonlaw.law.provenance import levels_in_words
from commonlaw.likelihood import ERRORS, ByGroup
from commonlaw.text import counted
from commonlaw.trials import Trials

Find = Callable[[CandidateSearch], Candidate]
"""Returns the best law of the trials of a search."""


_STAGE = "strange objects"

_CODES: Mapping[Reason, str] = {
    "law": "strange-object",
    "units": "strange-object-units",
    "errors": "strange-object-errors",
    "coefficients": "strange-object-coefficients",
}
"""The notes on strange objects, by the reason."""


def with_objects_apart(candidate: Candidate, search: CandidateSearch, find: Find, *, is_plain: bool) -> Candidate:
    """Return a candidate with its strange objects apart, if these and a law of the others are more probable.

    Laws are compared on resolved meshes: errors of a coarse one are a misfit of those objects that change fastest.
    Objects that may be in other units come first; others wait for richer terms then, if the law `is_plain`, as these
    may hold in one unit only.
    """
    count, units = len(search.strange), in_other_units(candidate, len(search.strange))
    if search.options.strange_objects == "keep" or not (units or suspects(candidate.pool, count)):
        return candidate
    try:
        fine = search.resolved(candidate)
        others = () if (units and is_plain) or not fine.pool.best.is_resolved else suspects(fine.pool, count)
        for names in dict.fromkeys(names for names in (units, others) if names):
            fewer = _with_apart(fine, names, search, lambda some: some.resolved(find(some)))
            if fewer.score < fine.score:
                return replace(candidate, apart=fewer.apart, of_fewer=fewer.of_fewer)
    except CommonlawError:  # Too few samples for laws of their own
        pass
    return candidate


def _with_apart(candidate: Candidate, names: Sequence[str], search: CandidateSearch, find: Find) -> Candidate:
    """Return a candidate with the law of the other objects than some, and those of these apart that contradict it.

    Nothing contradicts a law with a lack of fit: objects with a misfit in common would contradict one another.
    """
    search.progress(f"seeking the law without {', '.join(names)}")
    of_fewer = find(search.of_objects([name for name in search.trials.objects if name not in names]))
    others = of_fewer.pool.best
    if others.lack_of_fit or not others.is_resolved:
        return candidate
    whole = candidate.pool.best
    supports = _supports_in(whole.problem, others)
    is_same = supports is not None and np.array_equal(supports, whole.supports)
    explained = dict[str, _Explanation]()
    for name in names:
        alone = find(search.of_objects([name]))
        if explanation := _explained(alone, others, search, is_same):
            units = _in_other_units(search.trials, alone.pool.best, others)
            explained[name] = replace(explanation, reason="units", words=units) if units else explanation
    if len(explained) < len(names):
        return _with_apart(candidate, [*explained], search, find) if explained else candidate
    excluded = len(search.strange)
    total = len(search.trials.objects) + excluded
    penalty = partition_penalty(excluded + len(names), total) - partition_penalty(excluded, total)
    if not whole.problem.noise_is_fixed:  # Each has levels of noise
        levels = len(names) * len(search.trials.schema.measured)
        penalty += levels * float(np.log(sum(whole.problem.measured)))
    score = score_of_order(others).plus("strange objects", penalty + sum(reason.score for reason in explained.values()))
    share = 1 / (1 + np.exp((score - candidate.score) / 2))
    objects = [
        StrangeObject(name, float(share * explanation.share), explanation.reason, explanation.words)
        for name, explanation in explained.items()
    ]
    return replace(candidate, apart=Apart(score, tuple(objects)), of_fewer=of_fewer)


@dataclass(frozen=True)
class _Explanation:
    """Why an object is strange, in words, and minus twice the log-evidence of its measurements then.

    Its share is the probability of this reason, the rest that it follows the law of the others.
    """

    reason: Reason
    words: str
    score: float
    share: float = 1.0


def _explained(own: Candidate, others: Fit, search: CandidateSearch, is_same: bool) -> _Explanation | None:
    """Return why an object of an own law is strange to the law of the others; None if it follows it.

    With coefficients or noise far from those of the others it still follows it if the law of all `is_same`.
    """
    fit, supports = own.pool.best, _supports_in(own.pool.best.problem, others)
    is_other = supports is None or bool((fit.supports & ~supports).any())
    problem, shared, follows = fit.problem, fit, np.inf
    if supports is None and not fit.problem.trials.schema.initial_values:  # Terms that are not plain
        problem, supports = _problem_of(fit.problem.trials, others), others.supports
    explanations = [_Explanation("law", _in_words(fit), own.score.total)] if is_other else []
    if supports is not None:
        shared = fit_solutions(problem, supports)
        kinds = error_kinds(search.options.errors, fit.problem.trials.schema) if shared.is_usable else ()
        for kind in (kind for kind in kinds if not isinstance(ERRORS[kind], ByGroup)):
            under = shared if kind == "white" else estimate_error_model(shared, kind)
            if under.is_usable:
                score = score_of_order(under)
                value = score.total - score.parts["structure"]  # The others pay for the terms
                follows = min(follows, value) if under.errors == "white" else follows
                explanations += [_Explanation("errors", ERRORS[kind].label, value)] * (not is_white(under))
    best = min(explanations, key=lambda explanation: explanation.score, default=None)
    if best is not None and best.score < follows:
        return replace(best, share=float(1 / (1 + np.exp((best.score - follows) / 2))))
    if is_same:
        return None
    words = _in_words(shared)
    if np.mean((shared.problem.noise / others.problem.noise) ** 2) > settings.MAX_REDUCED_CHI_SQUARED:
        words += f", with noise of {levels_in_words(shared.problem.noise, problem.trials.schema)}"
    return _Explanation("coefficients", words, follows)


def _problem_of(trials: Trials, others: Fit) -> SearchProblem:
    """Return the problem of the trials of an object with the terms of others, from their mean coefficients."""
    problem = others.problem
    mean = np.mean([estimate.coefficients for estimate in others.estimates], axis=0)
    known = np.where(problem.allowed, np.nan, 0.0)[np.newaxis]
    return problem.of_trials(trials.trials, known, mean[np.newaxis]).under_white_noise


def _in_words(fit: Fit) -> str:
    """Return the law of one object with its numbers."""
    return "; ".join(fitted_law(fit.problem.law, fit).equations(digits=3, errors=False))


def _in_other_units(trials: Trials, fit: Fit, others: Fit) -> str:
    """Return in words which columns of an object are in other units, by an offset or one factor of values and noise."""
    names, words = [*others.problem.trials.objects, *fit.problem.trials.objects], list[str]()
    if fit.has_process_noise:
        fit = fit_solutions(fit.problem.under_white_noise, fit.supports)
    residuals = residuals_by_group(others, "by-object")
    squares = np.maximum(residuals.squares, np.finfo(float).tiny) / np.maximum(residuals.freedom, 1.0)
    noise = dict(zip(names, [*np.sqrt(squares), fit.problem.noise], strict=True))
    for j, column in enumerate(trials.schema.states):
        *rest, last = [np.concatenate([trial.states[:, j] for trial in trials.of_object(name)]) for name in names]
        if offset := kelvin_offset(last, np.concatenate(rest), trials.schema.units.get(column, "")):
            words.append(f"{column} is {offset:+g} apart, as kelvin from degrees Celsius")
        ratio = column_in_other_units(trials, j, noise)
        if ratio is not None and ratio.object == len(names) - 1:
            words.append(f"{column} is about {ratio.in_words} times as large")
    return " and ".join(words)


def in_other_units(candidate: Candidate, excluded: int) -> tuple[str, ...]:
    """Return the few objects of which a column may be in other units, by its values and its noise that is by object.

    Another factor of a column may hide the law of all, such as a sine. So many objects were `excluded` before.
    """
    problem = candidate.pool.best.problem
    trials, errors = problem.trials, problem.errors
    if not errors.by_object or len(trials.objects) + excluded < 4:
        return ()
    noise = {name: errors.noise_of(name, problem.noise) for name in trials.objects}
    ratios = [column_in_other_units(trials, j, noise) for j in range(len(trials.schema.states))]
    names = tuple({trials.objects[ratio.object]: None for ratio in ratios if ratio})
    return names if len(names) + excluded <= most_strange(len(trials.objects) + excluded) else ()


def _supports_in(problem: SearchProblem, others: Fit) -> Bools | None:
    """Return the supports of the law of the others among the terms of a problem; None if one was screened out."""
    names, theirs = problem.terms.names, np.array(others.problem.terms.names)
    chosen = [theirs[support] for support in others.supports]
    if not np.isin(np.concatenate(chosen), names).all():
        return None
    return np.array([np.isin(names, of_equation) for of_equation in chosen])


def without_strange_objects(law: Law, strange: Sequence[StrangeObject]) -> Law:
    """Return a law with a step of its history, and notes, on the objects that were left out of it."""
    if not strange:
        return law
    provenance, names = law.provenance, tuple(stray.name for stray in strange)
    others = counted(len(law.objects), "other object")
    outcomes = [
        note(
            _CODES[stray.reason],
            stray.name,
            others=others,
            probability=stray.probability_in_words,
            words=stray.words,
        )
        for stray in strange
    ]
    why = (f"{stray.name}: {stray.words} (probability {stray.probability_in_words})" for stray in strange)
    step = Step(_STAGE, f"{', '.join(names)} left out", "; ".join(why))
    return replace(
        law,
        provenance=replace(
            provenance,
            history=(step, *provenance.history),
            outcomes=(*outcomes, *provenance.outcomes),
            domain=replace(provenance.domain, strange=names),
        ),
    )


def with_strange_objects(provenance: Provenance) -> Provenance:
    """Return the provenance of a law that is fitted to all objects in the end, also to those that were left out."""
    history = tuple(step for step in provenance.history if step.stage != _STAGE)
    outcomes = tuple(outcome for outcome in provenance.outcomes if outcome.code not in _CODES.values())
    return replace(provenance, history=history, outcomes=outcomes, domain=replace(provenance.domain, strange=()))
