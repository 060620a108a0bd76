"""The default way from trials to a law, every stage in its order."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from commonlaw.inference.accuracy import Rivals, covariances, inclusion, probabilities
from commonlaw.inference.objects import Objects, prepare
from commonlaw.inference.search import FINAL, Found, rivals, search, settle, with_error
from commonlaw.law import Alternative, Law, Step, pooled
from commonlaw.likelihood import Estimate, NotPositiveError, fit
from commonlaw.solvers import AbstractSolver, BestSubset
from commonlaw.trials import Trials

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Told = Callable[[str], None]

PATH = BestSubset(largest=8, nodes=1)
"""Lists the candidates of an equation. They need not be proven the best: neighbours of the chosen are compared too."""

OUTLIERS = 4.0
"""Standard deviations from which a measurement is an outlier: of normal noise, one in 16 000 is."""

_RESOLVED = 1.0
"""What a finer mesh may change in twice the log-likelihood; a term is worth many times that."""

_FINEST = 4
"""Points for each sampling step; laws that need more are not resolved by their samples."""

_LISTED = 12
"""Supports of each equation that are kept as alternatives."""


def find_law(
    trials: Trials,
    law: Law,
    known: Floats,
    *,
    by_rates: Callable[[], Bools],
    solver: AbstractSolver = PATH,
    noise: Floats | None = None,
    outliers: float = OUTLIERS,
    universal: Bools | None = None,
    pool: bool = True,
    told: Told = lambda _: None,
) -> Law:
    """Return the law of these trials: its terms, coefficients, their covariance, and every choice on the way.

    Parameters
    ----------
    trials
        What was measured.
    law
        Terms, schema, order and objects of the law that is sought.
    known
        Coefficients that are known, NaN where they are to be found, shape (objects, equations, terms).
    by_rates
        Returns the supports that rates choose, shape (equations, terms). They are taken where the measurements obey no
        law of the library: then evidence is gathered by terms that explain the error of the law.
    solver
        Whose path lists the candidates of each equation.
    noise
        Standard deviation of each state's measurement noise, shape (states,), if it is known.
    outliers
        Standard deviations beyond which a measurement counts as an outlier, infinite for none.
    universal
        Coefficients that all objects have in common, shape (equations, terms).
    pool
        Whether the others are drawn to their means as far as the objects are alike, see `Law.pooled`.
    told
        Takes what is being done.

    Raises
    ------
    CommonlawError
        If a trial is too short, or a term is not finite on it; the message names the trial.
    """
    told("estimating noise, smoothing")
    objects = prepare(trials, law.terms, law.order, known, noise=noise, bound=outliers)
    objects, found = _searched(trials, objects, solver, told)
    if not found.obeyed:
        told("no law is obeyed: choosing terms by trials held out")
        found = with_error(objects, by_rates(), solver)
    objects, found = _on_finer_mesh(trials, objects, found, solver, told)
    told("judging terms and coefficients")
    others = [
        [(support | given, above) for support, above in listed]
        for given, listed in zip(law.support, rivals(objects, found, solver), strict=True)
    ]
    law = replace(
        law,
        coefficients=np.array([each.coefficients for each in found.estimates]),
        covariance=covariances(objects, found),
        noise=objects.noise,
        inclusion=inclusion(others),
        alternatives=_alternatives(law, others),
        history=_history(trials, law, objects, found, others, noise is not None),
    )
    return pooled(law, universal, pool)


def _searched(trials: Trials, objects: Objects, solver: AbstractSolver, told: Told) -> tuple[Objects, Found]:
    """Search, on finer meshes too where no law is obeyed and these matter: a coarse one looks like an error."""
    found = search(objects, solver, told)
    while not found.obeyed and objects.points < _FINEST:
        # The random walk is to be the same in twice as many steps
        finer, estimates = _refitted(trials, objects, found, (found.tolerance / np.sqrt(2),))
        if _change(objects, found.estimates, finer, estimates) < _RESOLVED:
            break
        told("searching again on a finer mesh")
        objects, found = finer, search(finer, solver, told)
    return objects, found


def _on_finer_mesh(
    trials: Trials, objects: Objects, found: Found, solver: AbstractSolver, told: Told
) -> tuple[Objects, Found]:
    """Choose again on finer meshes until these do not matter, for laws that move fast between samples."""
    while found.obeyed and objects.points < _FINEST:
        finer, estimates = _refitted(trials, objects, found, FINAL)
        if _change(objects, found.estimates, finer, estimates) < _RESOLVED:
            break
        told("choosing terms again on a finer mesh")
        try:
            objects, found = finer, settle(finer, found.supports, estimates, found.tolerance, solver)
        except NotPositiveError:
            break
    return objects, found


def _refitted(
    trials: Trials, objects: Objects, found: Found, tolerances: Sequence[float]
) -> tuple[Objects, tuple[Estimate, ...]]:
    """Return the objects on a finer mesh, and what was found fitted to them."""
    finer = objects.finer(trials)
    estimates = tuple(
        fit(problem, replace(start, coefficients=own.coefficients), found.supports, tolerances)
        for problem, start, own in zip(finer.problems, finer.starts, found.estimates, strict=True)
    )
    return finer, estimates


def _change(objects: Objects, coarse: Sequence[Estimate], finer: Objects, fine: Sequence[Estimate]) -> float:
    """Return the sum of squared differences between measured states on two meshes, relative to the noise."""
    total, stride = 0.0, finer.points // objects.points
    for problem, one, other in zip(objects.problems, coarse, fine, strict=True):
        for mesh, states, finest in zip(problem.meshes, one.states, other.states, strict=True):
            gap = (_at_samples(finest, mesh.linked, stride) - states)[:, : len(objects.noise)] / objects.noise
            total += float(np.sum(gap[mesh.seen] ** 2))
    return total


def _at_samples(states: Floats, linked: Bools, stride: int) -> Floats:
    """Return the rows of a finer mesh at the points of a coarser one, whose links are given."""
    places = np.concatenate([[0], np.cumsum(np.where(linked, stride, 1))])
    rows: Floats = states[places]
    return rows


def _alternatives(law: Law, others: Rivals) -> tuple[Alternative, ...]:
    found = []
    for equation, listed in zip(law.left_sides, others, strict=True):
        likely = probabilities(listed)
        chosen = next(i for i, (_, above) in enumerate(listed) if above == 0)
        for i, (support, above) in enumerate(listed[:_LISTED]):
            names = tuple(law.terms.names[k] for k in np.flatnonzero(support))
            measures = {"evidence lost": float(above), "probability": float(likely[i])}
            found.append(Alternative(equation, names, measures, False, i == chosen))
    return tuple(found)


def _why(law: Law, listed: Sequence[tuple[Bools, float]]) -> str:
    """Return what speaks for the chosen support of an equation."""
    second = next((pair for pair in listed if pair[1] != 0), None)
    if second is None:
        return "no other support was compared"
    runner = ", ".join(law.terms.names[k] for k in np.flatnonzero(second[0])) or "no term"
    ratio = np.exp(min(abs(second[1]) / 2, 700))
    if second[1] < 0:
        return f"largest evidence once fitted; before that, {runner} is {ratio:.3g} times more probable"
    return f"largest evidence; the next, {runner}, is {ratio:.3g} times less probable"


def _history(trials: Trials, law: Law, objects: Objects, found: Found, others: Rivals, given: bool) -> tuple[Step, ...]:
    """Return every choice that was made, in order."""
    schema = trials.schema
    levels = [
        f"{name}: {level:.3g} {schema.units.get(name, '')}".rstrip()
        for name, level in zip(schema.states, objects.noise, strict=True)
    ]
    misfit, count = sum(each.misfit for each in found.estimates), sum(objects.measured)
    resolved = "a finer mesh changes nothing" if objects.points < _FINEST else "the finest there is"
    steps = [
        Step("noise", ", ".join(levels), "as given" if given else "from differences of neighbouring samples"),
        Step(
            "library",
            f"{len(law.terms)} terms for each of {len(law.states)} equations",
            ", ".join(law.terms.names[:10]) + (", ..." if len(law.terms) > 10 else ""),
        ),
        Step(
            "mesh",
            f"{objects.points} step{'s' if objects.points > 1 else ''} from sample to sample",
            resolved if found.obeyed else "a law with an error needs no finer one",
        ),
    ]
    for equation, listed in zip(law.left_sides, others, strict=True):
        chosen = next(support for support, above in listed if above == 0)
        names = [law.terms.names[k] for k in np.flatnonzero(chosen)]
        reason = _why(law, listed) if found.obeyed else "the fewest within one standard error, on trials held out"
        steps.append(Step(f"terms of {equation}", ", ".join(names) or "none", reason))
    if found.obeyed:
        steps.append(Step("error of the law", "none", "the trajectories are solutions of the law, up to the noise"))
    else:
        text = f"a random walk, in each step {found.tolerance:g} times the noise"
        steps.append(Step("error of the law", text, "the measurements stray further from the law than noise explains"))
    steps.append(
        Step(
            "coefficients",
            f"maximum likelihood of {len(trials)} trajectories",
            f"misfit {misfit / count:.3f} for each of {count} measurements, where noise alone leaves about 1",
        )
    )
    return tuple(steps)
