"""What else a law could be: the supports that the measurements leave plausible, fitted, with their probabilities."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import LEAST, MOST, SearchState
from commonlaw.law import Law, PlausibleLaw, Provenance, with_constants_of


def other_laws(problem: SearchProblem, chosen: SearchState, law: Law) -> tuple[PlausibleLaw[Law], ...]:
    """Return what else a law could be that was found, with probabilities above `LEAST`, the most probable first.

    Parameters
    ----------
    problem, chosen
        What was measured, and the state that the law is of.
    law
        Whose terms, schema and objects the others have.
    """
    (own, _), *others = weighted(chosen)
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


def weighted(chosen: SearchState) -> list[tuple[float, SearchState]]:
    """Return a state and its alternatives with probabilities that add up to one, the state first.

    By their evidence under the same errors; the chosen counts as no less probable than any other.
    """
    above = np.array([0.0, *(max(0.0, each.score - chosen.score) for each in chosen.alternatives)])
    shares = np.exp(-above / 2) / np.exp(-above / 2).sum()
    others = sorted(zip(shares[1:].tolist(), chosen.alternatives, strict=True), key=lambda pair: -pair[0])
    return [(float(shares[0]), chosen), *others]
