"""The default way from trials to a law, every stage in its order."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.accuracy import Errors, covariances, inclusion
from commonlaw.inference.objects import Objects, prepare
from commonlaw.inference.record import alternatives, history, outcomes
from commonlaw.inference.resolution import FINEST, on_finer_mesh
from commonlaw.inference.search import FINAL, Found, rivals, search, settle, with_supports
from commonlaw.law import Law
from commonlaw.likelihood import NotPositiveError
from commonlaw.solvers import AbstractSolver, BestSubset
from commonlaw.trials import Trials

ProgressCallback = Callable[[str], None]

PATH = BestSubset(largest=8, nodes=1)
"""Lists the candidates of an equation. They need not be proven the best: neighbours of the chosen are compared too."""

OUTLIERS = 4.0
"""Standard deviations from which a measurement is an outlier: of normal noise, one in 16 000 is."""


def find_law(
    trials: Trials,
    law: Law,
    known: Floats,
    *,
    by_rates: Callable[[], Bools],
    solver: AbstractSolver = PATH,
    noise: Floats | None = None,
    outliers: float = OUTLIERS,
    errors: Errors = "likelihood",
    universal: Bools | None = None,
    pool: bool = True,
    progress: ProgressCallback = lambda _: None,
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
    errors
        How the coefficients' covariance is found, see `accuracy.covariances`.
    universal
        Coefficients that all objects have in common, shape (equations, terms).
    pool
        Whether the others are drawn to their means as far as the objects are alike, see `Law.partial_pooling`.
    progress
        Takes what is being done.

    Raises
    ------
    CommonlawError
        If a trial is too short, or a term is not finite on it; the message names the trial.
    """
    progress("estimating noise, smoothing")
    objects = prepare(trials, law.terms, law.order, known, noise=noise, bound=outliers)
    objects, found = _searched(trials, objects, solver, progress)
    if not found.obeyed:
        progress("no law is obeyed: choosing terms by trials held out")
        found = with_supports(objects, by_rates())
    objects, found = _settled(trials, objects, found, solver, progress)
    progress("judging terms and coefficients")
    others = [
        [(support | given, above) for support, above in listed]
        for given, listed in zip(law.support, rivals(objects, found), strict=True)
    ]
    law = replace(
        law,
        coefficients=np.array([each.coefficients for each in found.estimates]),
        uncertainty=replace(
            law.uncertainty,
            covariance=covariances(objects, found, errors),
            noise=objects.noise,
            inclusion_probabilities=inclusion(others),
        ),
        provenance=replace(
            law.provenance,
            outcomes=outcomes(trials, law, objects, found),
            alternatives=alternatives(law, others),
            history=history(trials, law, objects, found, others, noise is not None, objects.points < FINEST),
        ),
    )
    return law.partial_pooling(universal, pool)


def _searched(
    trials: Trials, objects: Objects, solver: AbstractSolver, progress: ProgressCallback
) -> tuple[Objects, Found]:
    """Search, on finer meshes too where no law is obeyed and these matter: a coarse one looks like an error."""
    found = search(objects, solver, progress)
    while not found.obeyed:
        # The random walk is to be the same in twice as many steps
        finer = on_finer_mesh(trials, objects, found, (found.tolerance / np.sqrt(2),))
        if finer is None:
            break
        progress("searching again on a finer mesh")
        objects, _ = finer
        found = search(objects, solver, progress)
    return objects, found


def _settled(
    trials: Trials, objects: Objects, found: Found, solver: AbstractSolver, progress: ProgressCallback
) -> tuple[Objects, Found]:
    """Choose again on finer meshes until these do not matter, for laws that move fast between samples."""
    while found.obeyed:
        finer = on_finer_mesh(trials, objects, found, FINAL)
        if finer is None:
            break
        progress("choosing terms again on a finer mesh")
        try:
            objects, found = finer[0], settle(finer[0], found.supports, finer[1], found.tolerance, solver)
        except NotPositiveError:
            break
    return objects, found
