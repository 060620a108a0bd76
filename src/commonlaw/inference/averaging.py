"""What else a law could be: the supports that the measurements leave plausible, fitted, with their probabilities."""

from dataclasses import replace
from itertools import product

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference.covariance import fitted_law
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.search_state import SearchState, evidence_of, fit_neighbours, neighbours
from commonlaw.law import Law, PlausibleLaw, Provenance

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
    template = replace(law, provenance=Provenance(), uncertainty=replace(law.uncertainty, inclusion_probabilities=None))
    found = [(share / total, fitted_law(template, problem, state)) for share, state in kept]
    wider = law.uncertainty.widening
    return tuple(
        PlausibleLaw(share, replace(each, uncertainty=replace(each.uncertainty, widening=wider)))
        for share, each in found
    )


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
