"""What else a law could be: the supports that the measurements leave plausible, fitted, with their probabilities."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference.covariance import fitted_law
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.search_state import SearchState, evidence_of, fit_neighbours, neighbours
from commonlaw.law import Law, PlausibleLaw, Provenance, with_constants_of

LEAST = 0.01
"""Probability below which a law is not carried along: what it says would not move an interval of 95 % by much."""

MOST = 12
"""Laws that are carried along at most."""


def other_laws(problem: SearchProblem, chosen: SearchState, law: Law) -> tuple[PlausibleLaw[Law], ...]:
    """Return what else a law could be that was found, with probabilities above `LEAST`, the most probable first.

    Parameters
    ----------
    problem, chosen
        What was measured, and the state that the law is of.
    law
        Whose terms, schema and objects the others have.
    """
    (own, _), *others = weighted(problem, chosen)
    kept = [(share, state) for share, state in others if share > LEAST][: MOST - 1]
    total = own + sum(share for share, _ in kept)
    return tuple(PlausibleLaw(share / total, _beside(law, fitted_law(law, problem, state))) for share, state in kept)


def with_rivals(
    others: Sequence[PlausibleLaw[Law]], law: Law, rivals: Sequence[tuple[float, Callable[[], Law]]]
) -> tuple[PlausibleLaw[Law], ...]:
    """Return what else a law could be, with laws of other terms that were fitted beside it.

    Parameters
    ----------
    others
        What is known already, by `other_laws`.
    law
        What the others are no more probable than.
    rivals
        By how much -2 log evidence of each is above that of the law, and what returns it. Those that measure something
        else are left out.
    """
    own = 1.0 - sum(each.probability for each in others)
    found, said = [*others], {each.law.structure() for each in others} | {law.structure()}
    for above, fitted in sorted(rivals, key=lambda pair: pair[0]):
        share = own * float(np.exp(-max(0.0, above) / 2))
        if share <= LEAST or len(found) == MOST - 1:
            break
        rival = with_constants_of(_beside(law, fitted()), law)
        if rival.schema == law.schema and rival.structure() not in said:
            said.add(rival.structure())
            found.append(PlausibleLaw(share, rival))
    total = own + sum(each.probability for each in found)
    found = [each._replace(probability=each.probability / total) for each in found]
    return tuple(sorted(found, key=lambda each: -each.probability))


def _beside(law: Law, other: Law) -> Law:
    """Return another law as it is kept beside a law: without a record, its bands as much wider."""
    uncertainty = replace(other.uncertainty, inclusion_probabilities=None, widening=law.uncertainty.widening)
    return replace(other, provenance=Provenance(), uncertainty=uncertainty)


def weighted(problem: SearchProblem, chosen: SearchState) -> list[tuple[float, SearchState]]:
    """Return what the trials leave plausible with probabilities that add up to one, the chosen first.

    By their evidence, under the errors of the chosen state, which counts as no less probable than any other.
    """
    fitted = [chosen, *fit_neighbours(problem, chosen, _near(problem, chosen))]
    (value,) = evidence_of(problem, chosen, [chosen.supports])
    above = np.array([0.0, *(max(0.0, each.value - value) for each in fitted[1:])])
    shares = np.exp(-above / 2) / np.exp(-above / 2).sum()
    others = sorted(zip(shares[1:].tolist(), fitted[1:], strict=True), key=lambda pair: -pair[0])
    return [(float(shares[0]), chosen), *others]


def _near(problem: SearchProblem, chosen: SearchState) -> list[Bools]:
    """Return supports that may be as probable as `LEAST`, by evidence that is linearised about the chosen."""
    below = -2 * np.log(LEAST)
    listed = []
    for each, own in zip(neighbours(problem, chosen), chosen.supports, strict=True):
        here = next(other.twice_log_bayes_factor for other in each if other.chosen)
        behind = [(other.twice_log_bayes_factor - here, other.support) for other in each if not other.chosen]
        listed.append([(0.0, own), *((value, support) for value, support in behind if value < below)])
    near = []
    for several in product(*(each[:MOST] for each in listed)):
        value = sum(max(0.0, own) for own, _ in several)
        supports = np.array([own for _, own in several])
        if value < below:
            near.append((value, supports))
    near += [(max(0.0, above), supports) for above, supports in chosen.fitted if above < below]
    ordered = sorted(near, key=lambda pair: pair[0])
    different = {supports.tobytes(): supports for _, supports in ordered}
    different.pop(chosen.supports.tobytes(), None)
    return list(different.values())[: MOST - 1]
