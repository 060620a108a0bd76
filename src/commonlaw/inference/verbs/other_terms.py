"""Fits of the alternatives that a law was chosen from, from few terms to many."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference.search.setup import RefitOptions
from commonlaw.inference.verbs.schemes import fit_of
from commonlaw.law import Law, Provenance, Uncertainty
from commonlaw.law.law import shares_terms
from commonlaw.law.parameters import left_hand_sides, standard_errors
from commonlaw.law.provenance import Alternative
from commonlaw.law.tables import LOG_SCORE
from commonlaw.runtime.progress import Stage, silent
from commonlaw.text import counted
from commonlaw.trials import Trials

_MEASURES = ("2 log B", LOG_SCORE, "held-out error", "BIC", "EBIC", "AIC", "AICc")
"""Criteria that rank the candidates of a size, the first that all have; smaller is better."""


@dataclass(frozen=True, eq=False)
class CandidateLaw:
    """A law with an alternative support, fitted to the trials, or the chosen law.

    Its evidence is 2 log B relative to the most probable candidate, summed over equations; None if not computed.
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
    """Return a law and the alternatives that it was chosen from, from the fewest terms to the most.

    They form a path: the best support of each size, one equation growing after the other. If there is room, others
    follow that differ in one equation. Coefficients are fitted by `refine` under the noise of the law or, if it has
    another error model, under that model with levels estimated for each alternative.

    Parameters
    ----------
    law
        A law of order 1 or 2 whose objects share their terms; any other is returned alone.
    trials
        Its training data.
    most
        Largest number of laws.
    progress
        Takes what is being done.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(drag=(-0.3, -0.5), noise=0.05)
    >>> law = cl.discover(drops, order=2, library="poly:1")
    >>> [each.law.structure[0] for each in candidate_laws(law, drops, most=3)]
    ["x'' = a", "x'' = a + b v", "x'' = a + b x + c v"]
    """
    result = iterate_candidates(law, trials, most, progress)
    return tuple(sorted(result, key=lambda candidate: (candidate.size, -(candidate.evidence or 0.0), candidate.chosen)))


def iterate_candidates(law: Law, trials: Trials, most: int, progress: Callable[[str], None]) -> Iterator[CandidateLaw]:
    """Yield the laws of `candidate_laws` as soon as each is fitted, those of similar size first."""
    yield CandidateLaw(law, _evidence(law, law.support), True)
    if law.order == 0 or not shares_terms(law):
        return
    supports = _supports(law, most - 1)
    for k, support in enumerate(supports):
        progress(Stage(f"fitting the candidate with {counted(int(support.sum()), 'term')}", k / len(supports)))
        try:
            candidate = candidate_law(law, trials, support)
        except CommonlawError:  # Not an alternative
            continue
        yield candidate


def candidate_law(law: Law, trials: Trials, support: Bools) -> CandidateLaw:
    """Return the law with other terms of its library, fitted as by `candidate_laws`.

    Raises `CommonlawError` if there is no term, or coefficients cannot be found for them.

    Parameters
    ----------
    law
        A law of order 1 or 2 whose objects share their terms.
    trials
        Its training data.
    support
        Which terms it has, shape (equations, terms); known coefficients are always kept.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(drag=(-0.3, -0.5), noise=0.05)
    >>> law = cl.discover(drops, order=2, library="poly:1")
    >>> law.terms.names
    ('1', 'x', 'v')
    >>> candidate_law(law, drops, np.array([[True, True, False]])).law.structure
    ("x'' = a + b x",)
    """
    if not np.any(support):
        raise CommonlawError("law-without-terms")
    certain, evidence = (standard_errors(law) == 0).all(axis=0), _evidence(law, support)
    support = support | certain
    free = np.where(certain[support], 0.0, 1.0)
    template = replace(
        law,
        coefficients=np.where(certain, law.coefficients, support * 1.0),
        uncertainty=Uncertainty(np.tile(np.diag(free), (len(law.objects), 1, 1))),
        provenance=Provenance(law.provenance.differentiation),
    )
    # White noise has the level of the law; levels of other errors are estimated, as they depend on the lack of fit
    kind, levels, noise = law.uncertainty.error_model.kind, law.uncertainty.noise, dict[str, float]()
    if levels is not None and kind == "white":
        pairs = zip(law.schema.states, levels.tolist(), strict=True)
        noise = {name: level for name, level in pairs if name not in trials.schema.noise_columns}
    try:
        fitted = fit_of(template).refitted(trials, RefitOptions(noise=noise or None, errors=kind), silent)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise CommonlawError("terms-cannot-be-fitted", error=error) from None
    return CandidateLaw(fitted, evidence, False)


def _supports(law: Law, most: int) -> list[Bools]:
    """Return up to `most` other supports, shape (equations, terms), without duplicates or empty ones.

    Those along the path come first, ordered by their difference in size to the law; then those that differ in one
    equation, the best first.
    """
    size, distinct = int(law.support.sum()), dict[bytes, Bools]()
    measures = (
        [value for name in _MEASURES if (value := alternative.measures.get(name)) is not None]
        for alternative in law.provenance.alternatives
    )
    order = np.argsort([known[0] if known else 0.0 for known in measures], kind="stable")
    in_one_equation, lefts = list[Bools](), left_hand_sides(law)
    for alternative in (law.provenance.alternatives[i] for i in order):
        in_one_equation.append(law.support.copy())
        in_one_equation[-1][lefts.index(alternative.equation)] = np.isin(law.terms.names, alternative.terms)
    along = sorted(_along_path(law), key=lambda support: abs(int(support.sum()) - size))
    for support in (*along, *in_one_equation):
        if support.any() and not np.array_equal(support, law.support):
            distinct.setdefault(support.tobytes(), support)
    return list(distinct.values())[:most]


def _along_path(law: Law) -> Iterator[Bools]:
    """Yield supports from few terms to many, in each step growing the equation that gains most."""
    paths = [_path(law, side) or [(law.support[j], 0.0)] for j, side in enumerate(left_hand_sides(law))]
    at = [0] * len(paths)
    while True:
        yield np.array([path[i][0] for path, i in zip(paths, at, strict=True)])
        growing = [j for j, path in enumerate(paths) if at[j] + 1 < len(path)]
        if not growing:
            return
        at[max(growing, key=lambda j: paths[j][at[j]][1] - paths[j][at[j] + 1][1])] += 1


def _path(law: Law, left: str) -> list[tuple[Bools, float]]:
    """Return the best support of each size of an equation, shape (terms,), the smallest first, and its criterion."""
    listed = [alternative for alternative in law.provenance.alternatives if alternative.equation == left]
    name = next(
        (name for name in _MEASURES if all(candidate.measures.get(name) is not None for candidate in listed)), ""
    )
    best: dict[int, Alternative] = {}
    for alternative in sorted(
        listed, key=lambda candidate: (not candidate.chosen, candidate.measures.get(name) or 0.0)
    ):
        best.setdefault(len(alternative.terms), alternative)
    ordered = (best[size] for size in sorted(best))
    return [(np.isin(law.terms.names, candidate.terms), candidate.measures.get(name) or 0.0) for candidate in ordered]


def _evidence(law: Law, support: Bools) -> float | None:
    """Return 2 log B of a support relative to the most probable one, summed over equations; None if not computed."""
    terms, listed = np.array(law.terms.names, dtype=object), law.provenance.alternatives
    measures = {
        (alternative.equation, frozenset(alternative.terms)): alternative.measures.get("2 log B")
        for alternative in reversed(listed)
    }
    pairs = zip(left_hand_sides(law), support, strict=True)
    known = [measures.get((side, frozenset(terms[of_equation]))) for side, of_equation in pairs]
    return None if any(value is None for value in known) else float(sum(value or 0.0 for value in known))
