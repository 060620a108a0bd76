"""From a law whose terms are known to the coefficients that its trajectories need."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from commonlaw.errors import CommonlawError, unknown
from commonlaw.inference.accuracy import Errors, covariances
from commonlaw.inference.objects import Objects, known_noise, prepare
from commonlaw.inference.pipeline import OUTLIERS
from commonlaw.inference.record import coefficients_step, error_step, noise_step
from commonlaw.inference.resolution import on_finer_mesh
from commonlaw.inference.search import ERRORS, FINAL, OBEYED, Found, with_supports
from commonlaw.law import Law
from commonlaw.trials import Trials


def refine(
    law: Law,
    trials: Trials,
    *,
    noise: Mapping[str, float] | None = None,
    outliers: float = OUTLIERS,
    errors: Errors = "likelihood",
    pool: bool = True,
) -> Law:
    """Fit a law's coefficients, and the states of each trial, to what was measured: maximum likelihood.

    The terms stay, whatever method found them; the law gets standard errors. Initial states are free, chaotic laws are
    welcome, and values may be missing (multiple shooting with a shot for each step, see `commonlaw.likelihood`).

    Parameters
    ----------
    law
        Of order 1 or 2. Coefficients whose standard error is zero are known and stay.
    trials
        Of objects of the law.
    noise
        Standard deviation of each state's measurement noise by name. Default: it is estimated.
    outliers
        Standard deviations of noise beyond which a measurement counts as an outlier, infinite for none.
    errors
        How the covariance is found: ``"likelihood"`` or ``"bootstrap"``, see `LawDiscovery`.
    pool
        Whether coefficients are drawn to their means as far as the objects are alike, see `Law.partial_pooling`.

    Returns
    -------
    Law
        Of the objects of the trials.

    Raises
    ------
    CommonlawError
        If the law is of discrete time, its objects do not share their terms, an object or a variable is not in it, a
        setting does not exist, or a trial cannot be used; the message says which.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> method = cl.DerivativeRegression(differentiation="savgol:25:3", solver="group-stlsq:1.5")
    >>> law = cl.discover(drops, order=2, library="poly:1", method=method)
    >>> print(cl.refine(law, drops).average())
    x'' = -9.836 ± 0.046 - (0.3834 ± 0.0041) v
    <BLANKLINE>
    with v = x'
    """
    if law.order == 0:
        raise CommonlawError("a law of discrete time has no trajectories between samples: discover it from the samples")
    if errors not in ("likelihood", "bootstrap"):
        raise unknown("kind of errors", errors, ("likelihood", "bootstrap"))
    if not outliers > 0:
        raise CommonlawError(f"outliers is {outliers}: give standard deviations of noise, above zero")
    wanted, given = ((*each.schema.states, *each.schema.inputs) for each in (law, trials))
    if wanted != given:
        raise CommonlawError(
            f"the law has {', '.join(wanted)}, the trials have {', '.join(given)}; name the columns as in the law"
        )
    law = law.select(trials.objects)
    if not law.shared:
        raise CommonlawError(
            "the objects of this law have terms of their own: refine each by itself, law.select([name])"
        )
    known = np.where(law.support, np.nan, 0.0) + np.zeros_like(law.coefficients)
    certain = law.standard_errors == 0
    known[certain] = law.coefficients[certain]
    levels = None if noise is None else known_noise(noise, law.states)
    objects = prepare(trials, law.terms, law.order, known, noise=levels, bound=outliers)
    objects, found = _resolved(trials, objects, with_supports(objects, objects.allowed, (*ERRORS, OBEYED)))
    steps = (noise_step(trials.schema, objects, noise is not None), error_step(found))
    refined = replace(
        law,
        coefficients=np.array([each.coefficients for each in found.estimates]),
        uncertainty=replace(
            law.uncertainty, covariance=covariances(objects, found, errors), shared_factor=None, noise=objects.noise
        ),
        provenance=replace(law.provenance, history=(*law.history, *steps, coefficients_step(trials, objects, found))),
    )
    return refined.partial_pooling(None, pool)


def _resolved(trials: Trials, objects: Objects, found: Found) -> tuple[Objects, Found]:
    """Fit on finer meshes until these do not matter."""
    while found.obeyed:
        finer = on_finer_mesh(trials, objects, found, FINAL)
        if finer is None:
            break
        objects, found = finer[0], replace(found, estimates=finer[1])
    return objects, found
