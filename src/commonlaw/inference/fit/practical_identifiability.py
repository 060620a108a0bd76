"""Whether measurements tell the constants inside of terms."""

import numpy as np

from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.parameter_grid import frequencies_in_time


def are_parameters_identifiable(fit: Fit) -> bool:
    """Return whether measurements tell the constants of a law apart from what stands before their terms.

    Of ``V s/(K + s)`` for instance they tell V/K alone where s is small beside K. There the likelihood is nothing like
    the one that is linearised about a fit, and evidence that is computed from that means nothing. And of a drive that
    no trial has a whole cycle of they do not tell that it repeats itself, nor of one with less than two samples a cycle
    (Nyquist) its frequency, as slower ones have the same values there.
    """
    terms, trials = fit.problem.terms, fit.problem.trials
    first, times = len(terms.variables.measured), [trial.times for trial in trials]
    longest, shortest = max(map(np.ptp, times)), np.concatenate([*map(np.diff, times)]).min()
    for column in frequencies_in_time(terms):
        own = terms.constants[column - first]
        frequencies = [np.abs(each.coefficients[:, own]).sum() for each in fit.estimates]
        if np.median(frequencies) * longest < 2 * np.pi or np.max(frequencies) * shortest > np.pi:
            return False
    equations, chosen = np.nonzero(fit.supports)
    constant = ~terms.is_factor[chosen]
    bent = constant | np.array(terms.have_constants, dtype=bool)[chosen]
    squares = []
    for each, estimate in zip(fit.evidence.problems, fit.estimates, strict=True):
        columns = each.factor[:, np.flatnonzero(fit.supports)]
        found = estimate.coefficients[fit.supports]
        try:
            inverse = np.linalg.inv(np.linalg.qr(columns, mode="r"))
        except np.linalg.LinAlgError:
            return False
        with np.errstate(over="ignore"):
            squares.append(found**2 / np.sum(inverse**2, axis=1))
    signs = np.sign([each.coefficients[fit.supports] for each in fit.estimates])
    least = np.where(np.ptp(signs, axis=0) == 0, np.median(squares, axis=0), np.min(squares, axis=0))
    lost = bent & ~(least >= settings.SIGNIFICANT**2)
    return not any(
        lost[own].sum() > 1 and (lost & constant)[own].any() for own in equations == equations[:, np.newaxis]
    )
