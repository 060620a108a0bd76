"""From the candidates that a law was chosen from to laws: each fitted to the same trials, from few terms to many."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference.verbs.refinement import refine
from commonlaw.law import Law, Provenance, Uncertainty
from commonlaw.law.law import shares_terms
from commonlaw.law.parameters import left_hand_sides, standard_errors
from commonlaw.law.provenance import Alternative
from commonlaw.law.tables import LOG_SCORE
from commonlaw.runtime.progress import Stage
from commonlaw.text import counted
from commonlaw.trials import Trials

_MEASURES = ("2 log B", LOG_SCORE, "held-out error", "BIC", "EBIC", "AIC", "AICc")
"""What tells the best candidate of a size, the first that all have; small is good."""


@dataclass(frozen=True, eq=False)
class CandidateLaw:
    """A law that might have been chosen.

    Parameters
    ----------
    law
        With its coefficients fitted to the trials.
    evidence
        2 log B against the most probable candidate, summed over equations; None if it is not known.
    chosen
        Whether it is the law that was chosen, as it is.
    """

    law: Law
    evidence: float | None
    chosen: bool

    @property
    def size(self) -> int:
        """Number of terms in all equations."""
        return int(self.law.support.sum())


def candidate_laws(
    law: Law, trials: Trials, most: int = 8, progress: Callable[[str], None] = lambda _: None
) -> tuple[CandidateLaw, ...]:
    """Return the law among those that it was chosen from, from the fewest terms to the most.

    Of each number of terms that an equation may have, the best candidate comes first; of several equations one after
    the other grows. If there is room, others follow that differ in one equation. Coefficients are fitted as `refine`
    does it, with the noise of the law, or where it has other errors with errors of that kind, whose levels are found
    for each candidate.

    Parameters
    ----------
    law
        A law of order 1 or 2 whose objects share their terms; any other stands alone.
    trials
        Those that it was learned from.
    most
        How many laws there may be.
    progress
        Takes what is being done.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> law = cl.discover(drops, order=2, library="poly:1")
    >>> [each.law.structure[0] for each in candidate_laws(law, drops, most=3)]
    ["x'' = a", "x'' = a + b v", "x'' = a + b x + c v"]
    """
    found = candidates_in_turn(law, trials, most, progress)
    return tuple(sorted(found, key=lambda each: (each.size, -(each.evidence or 0.0), each.chosen)))


def candidates_in_turn(law: Law, trials: Trials, most: int, progress: Callable[[str], None]) -> Iterator[CandidateLaw]:
    """Yield the law, and the others of `candidate_laws` as soon as each is fitted, those near to it in size first."""
    yield CandidateLaw(law, _evidence(law, law.support), True)
    if law.order == 0 or not shares_terms(law):
        return
    supports = _supports(law, most - 1)
    for k, support in enumerate(supports):
        progress(Stage(f"fitting the candidate with {counted(int(support.sum()), 'term')}", k / len(supports)))
        try:
            candidate = candidate_law(law, trials, support)
        except CommonlawError:  # What cannot be fitted is no alternative
            continue
        yield candidate


def candidate_law(law: Law, trials: Trials, support: Bools, *, own_noise: bool = False) -> CandidateLaw:
    """Return the law with other terms of its library, fitted as `candidate_laws` does it.

    Parameters
    ----------
    law
        A law of order 1 or 2 whose objects share their terms.
    trials
        Those that it was learned from.
    support
        Which terms there are, shape (equations, terms); known coefficients stay in any case.
    own_noise
        Whether its white noise is what it leaves itself, and not that of the law.

    Raises
    ------
    CommonlawError
        If there is no term, or coefficients cannot be found for them.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> law = cl.discover(drops, order=2, library="poly:1")
    >>> law.terms.names
    ('1', 'x', 'v')
    >>> candidate_law(law, drops, np.array([[True, True, False]])).law.structure
    ("x'' = a + b x",)
    """
    if not np.any(support):
        raise CommonlawError("law-without-terms")
    try:
        fitted = _fitted(law, support, trials, own_noise)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise CommonlawError("terms-cannot-be-fitted", error=error) from None
    return CandidateLaw(fitted, _evidence(law, support), False)


def _supports(law: Law, most: int) -> list[Bools]:
    """Return the supports of so many other candidates, shape (equations, terms), each once, none of them empty.

    Those along the path come first, the nearest to the law in their number of terms before others; then those that
    differ in one equation, by what speaks for them.
    """
    size, found = int(law.support.sum()), dict[bytes, Bools]()
    along = sorted(_along_path(law), key=lambda each: abs(int(each.sum()) - size))
    for support in (*along, *_in_one_equation(law)):
        if support.any() and not np.array_equal(support, law.support):
            found.setdefault(support.tobytes(), support)
    return list(found.values())[:most]


def _in_one_equation(law: Law) -> Iterator[Bools]:
    """Yield the supports with another candidate for one of the equations, the best first."""
    known = (
        [value for name in _MEASURES if (value := each.measures.get(name)) is not None]
        for each in law.provenance.alternatives
    )
    values = [own[0] if own else 0.0 for own in known]
    lefts = left_hand_sides(law)
    for i in np.argsort(values, kind="stable"):
        each = law.provenance.alternatives[i]
        support = law.support.copy()
        support[lefts.index(each.equation)] = np.isin(law.terms.names, each.terms)
        yield support


def _along_path(law: Law) -> Iterator[Bools]:
    """Yield supports from few terms to many.

    From the smallest candidates of all equations on, that equation grows which gains most by it.
    """
    paths = [_path(law, left) or [_NestedModel(law.support[j], 0.0)] for j, left in enumerate(left_hand_sides(law))]
    at = [0] * len(paths)
    while True:
        yield np.array([path[i].terms for path, i in zip(paths, at, strict=True)])
        growing = [j for j, path in enumerate(paths) if at[j] + 1 < len(path)]
        if not growing:
            return
        gains = {j: paths[j][at[j]].measure - paths[j][at[j] + 1].measure for j in growing}
        at[max(gains, key=gains.__getitem__)] += 1


class _NestedModel(NamedTuple):
    """The best candidate of an equation that has so many terms: which these are, shape (terms,), and its measure."""

    terms: Bools
    measure: float


def _path(law: Law, left: str) -> list[_NestedModel]:
    """Return the best candidate of each size of an equation, from the fewest terms to the most."""
    own = [each for each in law.provenance.alternatives if each.equation == left]
    name = next((name for name in _MEASURES if all(each.measures.get(name) is not None for each in own)), "")
    best: dict[int, Alternative] = {}
    for each in sorted(own, key=lambda each: (not each.chosen, each.measures.get(name) or 0.0)):
        best.setdefault(len(each.terms), each)
    return [
        _NestedModel(np.isin(law.terms.names, best[size].terms), best[size].measures.get(name) or 0.0)
        for size in sorted(best)
    ]


def _evidence(law: Law, support: Bools) -> float | None:
    """Return the sum over equations of how far a support stays behind the most probable one."""
    terms, listed = np.array(law.terms.names, dtype=object), law.provenance.alternatives
    measures = {(each.equation, frozenset(each.terms)): each.measures.get("2 log B") for each in reversed(listed)}
    pairs = zip(left_hand_sides(law), support, strict=True)
    known = [measures.get((left, frozenset(terms[own]))) for left, own in pairs]
    return None if any(each is None for each in known) else float(sum(each or 0.0 for each in known))


def _fitted(law: Law, support: Bools, trials: Trials, own_noise: bool = False) -> Law:
    """Return the law with other terms, fitted with errors of its kind; its known coefficients stay.

    White noise has the level of the law. What else a law leaves, other terms leave more or less of.
    """
    certain = (standard_errors(law) == 0).all(axis=0)
    support = support | certain
    start = np.where(certain, law.coefficients, support * 1.0)
    free = np.where(certain[support], 0.0, 1.0)
    covariance = np.tile(np.diag(free), (len(law.objects), 1, 1))
    template = replace(
        law,
        coefficients=start,
        uncertainty=Uncertainty(covariance),
        provenance=Provenance(law.provenance.differentiation),
    )
    kind, given = law.uncertainty.error_model.kind, trials.schema.noise_columns
    levels = (
        {}
        if own_noise or law.uncertainty.noise is None or kind != "white"
        else dict(zip(law.schema.states, law.uncertainty.noise.tolist(), strict=True))
    )
    noise = {name: level for name, level in levels.items() if name not in given}
    return refine(template, trials, noise=noise or None, errors=kind, progress=lambda _: None)
