"""What else a law could be: the supports that the measurements leave plausible, fitted, with their probabilities."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.inference import settings
from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.fit import Fit
from commonlaw.law import Law, PlausibleLaw, Provenance, with_constants_of


def other_laws(chosen: Fit, law: Law) -> tuple[PlausibleLaw[Law], ...]:
    """Return what else a law could be that was found, the most probable first.

    Parameters
    ----------
    chosen
        The fit that the law is of.
    law
        Whose terms, schema and objects the others have.
    """
    (own, _), *others = weighted(chosen)
    kept = [(share, fit) for share, fit in others if share > settings.MIN_PROBABILITY][: settings.MAX_MODELS - 1]
    total = own + sum(share for share, _ in kept)
    laws = [fitted_law(law, replace(fit, problem=chosen.problem)) for _, fit in kept]  # Under the noise of the law
    return tuple(PlausibleLaw(share / total, _beside(law, each)) for (share, _), each in zip(kept, laws, strict=True))


def with_rivals(
    others: Sequence[PlausibleLaw[Law]], law: Law, rivals: Sequence[tuple[float, Fit]]
) -> tuple[PlausibleLaw[Law], ...]:
    """Return what else a law could be, with laws of other terms that were fitted beside it.

    Parameters
    ----------
    others
        What is known already, by `other_laws`.
    law
        What the others are no more probable than.
    rivals
        By how much -2 log evidence of each is above that of the law, and its fit. Those that measure something else are
        left out.
    """
    own = 1.0 - sum(each.probability for each in others)
    found, said = [*others], {each.law.structure() for each in others} | {law.structure()}
    for above, fit in sorted(rivals, key=lambda pair: pair[0]):
        share = own * float(np.exp(-max(0.0, above) / 2))
        if share <= settings.MIN_PROBABILITY or len(found) == settings.MAX_MODELS - 1:
            break
        rival = with_constants_of(_beside(law, fitted_law(fit.problem.law, fit)), law)
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


def weighted(chosen: Fit) -> list[tuple[float, Fit]]:
    """Return a fit and its alternatives with probabilities that add up to one, the fit first.

    By their evidence under the same errors; the chosen counts as no less probable than any other.
    """
    above = np.array([0.0, *(max(0.0, each.score - chosen.score) for each in chosen.alternatives)])
    shares = np.exp(-above / 2) / np.exp(-above / 2).sum()
    others = sorted(zip(shares[1:].tolist(), chosen.alternatives, strict=True), key=lambda pair: -pair[0])
    return [(float(shares[0]), chosen), *others]
