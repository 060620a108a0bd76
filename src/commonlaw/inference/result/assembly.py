"""The last step from trials to a law: standard errors, plausible alternatives, and the history of choices."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.final_score import final
from commonlaw.inference.fit.fit import PLAUSIBLE, Fit
from commonlaw.inference.fit.misfit import with_misfit
from commonlaw.inference.result.held_out_forecasts import StandardizedErrors, interval_inflation
from commonlaw.inference.result.history import (
    Compared,
    alternatives,
    differing_trials,
    history,
    inclusion_probabilities,
    names_in,
    outcomes,
    with_approximation,
)
from commonlaw.inference.score.score import Kind
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Law, PlausibleLaw, Provenance
from commonlaw.law.alignment import with_parameters_of
from commonlaw.law.law import with_other_laws
from commonlaw.runtime.fit_options import CovarianceKind


def reported(pool: Pool) -> tuple[Pool, bool]:
    """Return the pool with the law that is printed and its plausible rivals as they are reported, see `final`.

    Others keep their differences of scores to it; all do if forecasts chose it. With it is whether it converged.
    """
    best, is_converged = final(pool.best)
    if pool.best.score.kind is Kind.FORECASTS:
        return pool.with_best(best.with_score(pool.best.score)), is_converged

    def of_rival(fit: Fit) -> Fit:
        above = fit.score - pool.best.score
        return final(fit)[0] if above < PLAUSIBLE else fit.with_score(best.score.plus("refit", above))

    best = best.with_alternatives([of_rival(fit) for fit in pool.best.alternatives])
    return replace(pool, fits=(best, *map(of_rival, pool.rivals))), is_converged


def assemble(
    pool: Pool,
    is_converged: bool,
    *,
    errors: Sequence[StandardizedErrors],
    pooled: Callable[[Law], Law],
    covariance: CovarianceKind,
    seed: int,
    tried_errors: bool,
) -> Law:
    """Return the law of the best `reported` fit: terms, coefficients, covariance, plausible alternatives, history.

    Its intervals are inflated by the `errors` of its held-out forecasts, and `pooled` pools the coefficients of the
    objects for forecasts. Remedies depend on whether other error models were tried.
    """
    compared, fit = compared_terms(pool), pool.best
    template = fit.problem.law
    law = with_misfit(fitted_law(template, fit, covariance, seed), fit)
    law = replace(
        law,
        uncertainty=replace(
            law.uncertainty,
            inclusion_probabilities=(
                None if pool.best.score.kind is Kind.FORECASTS else inclusion_probabilities(template, compared)
            ),
            interval_inflation=interval_inflation(errors),
        ),
        provenance=replace(
            template.provenance,
            outcomes=(
                *fit.outcomes,
                *with_approximation(pool, outcomes(law, fit, is_converged, tried_errors=tried_errors)),
                *differing_trials(fit),
            ),
            alternatives=alternatives(template, compared, pool.chosen_by),
            history=(*fit.steps, *history(template, fit, compared, pool.chosen_by)),
        ),
    )
    plausible = plausible_laws(pool, law)
    return with_other_laws(pooled(law), tuple(rival._replace(law=pooled(rival.law)) for rival in plausible))


def _is_same(one: Fit, other: Fit) -> bool:
    """Return whether two laws with equally many coefficients have equal trajectories, up to a share of the noise."""

    def ends(fit: Fit) -> Floats:
        """Return the states at both ends of each trajectory, shape (trajectories, 2, states)."""
        return np.array(
            [state[[0, -1], : len(fit.problem.noise)] for estimate in fit.estimates for state in estimate.states]
        )

    if one.size != other.size or one.problem.trials.schema.states != other.problem.trials.schema.states:
        return False
    apart = np.abs(ends(one) - ends(other)).max(axis=(0, 1))
    return bool((apart < settings.CONVERGED_NOISE * one.problem.noise).all())


def compared_terms(pool: Pool) -> list[Compared]:
    """Return the chosen terms of each equation and their rivals, with the same terms in the other equations.

    If the terms are given, only those of rival laws are listed. Supports that rank ahead of the chosen one failed when
    they were fitted, and are left out.
    """
    best, laws = pool.best, [(rival.score - pool.best.score, rival.model.equations) for rival in pool.rivals]
    template, first, compared = best.problem.law, best.model.equations, []
    near = best.neighbours() if best.problem.solver is not None else [[] for _ in first]
    for j, (chosen, given) in enumerate(zip(first, template.support, strict=True)):
        listed = {chosen: 0.0}
        for difference, support in near[j]:
            listed.setdefault(names_in(template, support | given), difference)
        for difference, of_rival in laws:
            if of_rival[:j] == first[:j] and of_rival[j + 1 :] == first[j + 1 :]:
                listed.setdefault(of_rival[j], difference)
        ranked = sorted(listed.items(), key=lambda pair: (pair[1], pair[0] != chosen))
        compared.append({names: difference for names, difference in ranked if difference >= 0})
    return compared


def plausible_laws(pool: Pool, law: Law) -> tuple[PlausibleLaw[Law], ...]:
    """Return the plausible alternatives to the law of the best fit, the most probable first.

    They are its alternatives among plain terms, under its noise, and rivals with other terms but the same measured
    states. A negative difference in -2 log evidence to the law counts as zero.
    """

    def as_stored(alternative: Law) -> Law:
        """Return an alternative without provenance, its bands inflated alike."""
        inflation = law.uncertainty.interval_inflation
        uncertainty = replace(alternative.uncertainty, inclusion_probabilities=None, interval_inflation=inflation)
        return replace(alternative, provenance=Provenance(), uncertainty=uncertainty)

    plausible = list[PlausibleLaw[Law]]()
    if pool.best.problem.solver is not None:
        (chosen_share, _), *others = weighted(pool.best)
        kept = [(share, fit) for share, fit in others if share > settings.MIN_PROBABILITY][: settings.MAX_MODELS - 1]
        total = chosen_share + sum(share for share, _ in kept)
        for share, fit in kept:
            plausible.append(PlausibleLaw(share / total, as_stored(with_misfit(fitted_law(law, fit), fit))))
    different = list[Fit]()  # Without reparametrizations of the same law
    for rival in pool.rivals:
        if not any(_is_same(rival, fit) for fit in (pool.best, *different)):
            different.append(rival)
    chosen_share = 1.0 - sum(alternative.probability for alternative in plausible)
    structures = {alternative.law.structure for alternative in plausible} | {law.structure}
    for above, fit in sorted(((fit.score - pool.best.score, fit) for fit in different), key=lambda pair: pair[0]):
        share = chosen_share * float(np.exp(-max(0.0, above) / 2))
        if share <= settings.MIN_PROBABILITY or len(plausible) == settings.MAX_MODELS - 1:
            break
        alternative = with_parameters_of(as_stored(with_misfit(fitted_law(fit.problem.law, fit), fit)), law)
        if alternative.schema == law.schema and alternative.structure not in structures:
            structures.add(alternative.structure)
            plausible.append(PlausibleLaw(share, alternative))
    total = chosen_share + sum(alternative.probability for alternative in plausible)
    plausible = [alternative._replace(probability=alternative.probability / total) for alternative in plausible]
    return tuple(sorted(plausible, key=lambda alternative: -alternative.probability))


def weighted(chosen: Fit) -> list[tuple[float, Fit]]:
    """Return a fit and its alternatives with their posterior probabilities exp(-d/2)/sum exp(-d/2), the fit first.

    d is the difference in -2 log evidence to the fit under the same errors; a negative one counts as zero.
    """
    above = np.array([0.0, *(max(0.0, alternative.score - chosen.score) for alternative in chosen.alternatives)])
    shares = np.exp(-above / 2) / np.exp(-above / 2).sum()
    others = sorted(zip(shares[1:].tolist(), chosen.alternatives, strict=True), key=lambda pair: -pair[0])
    return [(float(shares[0]), chosen), *others]
