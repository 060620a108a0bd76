"""Profile likelihood of a parameter: how far it may move when all others follow."""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.estimation.beginning import Beginning, beginning_of
from commonlaw.estimation.fitting import notes_of_limits
from commonlaw.estimation.one_sided import MAX_PROFILES, VAGUE, OneSided, one_sided
from commonlaw.estimation.search import Objective, minimum
from commonlaw.formulation import inverse_information
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.law.law import only_object, shares_terms
from commonlaw.law.parameters import named_parameters, restrictions_of
from commonlaw.law.quantiles import two_sided
from commonlaw.law.restrictions import OBJECT, TRIAL, by_trial
from commonlaw.law.uncertainty import OneSidedLimit
from commonlaw.likelihood import ERRORS
from commonlaw.trials import Trials

_STEPS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0, 20.0)
"""Distances from the estimate at which the profile is computed, in standard errors."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Twice the log-likelihood ratio of the estimate to other values of a parameter, all other parameters fitted again.

    Parameters
    ----------
    parameter, object, unit
        Of what it is.
    values, deviance
        Increasing values of the parameter, shape (n,), and ``2 (log L(best) - log L(value))``, zero at the estimate.
    estimate, error
        The value of largest likelihood, and its standard error from the curvature there.
    degrees_of_freedom
        Of the noise estimate; infinite for known noise.
    """

    parameter: str
    object: str
    unit: str
    values: Floats
    deviance: Floats
    estimate: float
    error: float
    degrees_of_freedom: float

    @property
    def quantile(self) -> float:
        """The 95 % quantile of the deviance, the square of that of Student's t distribution: 3.84 for known noise."""
        return float(two_sided(0.95, self.degrees_of_freedom)) ** 2

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of the 95 % interval, where the deviance is its `quantile`; infinite where it stays below."""
        ends, middle, quantile = [], int(np.argmin(self.deviance)), self.quantile
        for values, deviance, far in (
            (self.values[middle::-1], self.deviance[middle::-1], -np.inf),
            (self.values[middle:], self.deviance[middle:], np.inf),
        ):
            above = np.flatnonzero(deviance > quantile)
            if not len(above):
                ends.append(far)
                continue
            # Roots of deviances are nearly straight lines
            last = int(above[0])
            roots = np.sqrt(np.maximum(deviance[last - 1 : last + 1], 0.0))
            ends.append(float(np.interp(np.sqrt(quantile), roots, values[last - 1 : last + 1])))
        return ends[0], ends[1]


def likelihood_profile(law: Law, trials: Trials, parameter: str, name: str | None = None) -> Profile:
    """Return the profile likelihood of a parameter of one object.

    ``2 (log L(best) - log L(k)) = min over the others of sum_i ((y_i - h(x(t_i; k, others)))/sigma)^2``, less its least
    value, with the noise sigma of the law, or if that is not known of what is left, its Huber threshold, and other
    measurement errors of the law as they are about its solutions. The trials are those of the object, or of all objects
    where these share parameters; priors and bounds are those of the law.

    Raises
    ------
    CommonlawError
        If there is no such object or parameter, the objects do not share their equations, time is discrete, the
        parameter has a value for each trial, or the equations cannot be solved for the trials.
    """
    owner = only_object(law, name)
    begun, index, known = _begun(law, trials, parameter, owner)
    parameters = named_parameters(law)
    profile = _profile(begun, begun.first, index, known, _degrees_of_freedom(law, parameter))
    unit = parameters.units[parameters.names.index(parameter)] or ""
    return Profile(parameter, owner, unit, *profile)


def _begun(law: Law, trials: Trials, parameter: str, owner: str) -> tuple[Beginning, int, Floats | None]:
    """Return the likelihood of an object's trials, the place of a parameter in it, and the noise, if it is known."""
    if not shares_terms(law) or law.order == 0:
        raise CommonlawError("profile-without-equations")
    parameters = named_parameters(law)
    check_choice("parameter", parameter, parameters.names)
    shared = restrictions_of(law).shared
    if by_trial(shared.get(parameter, OBJECT), law.observation.measured):
        raise CommonlawError("profile-by-trial", parameter=parameter, by=shared[parameter])
    alone = all(by in (OBJECT, TRIAL) for by in shared.values())
    related = trials.select(object=owner) if alone else trials
    groups = law.uncertainty.noise_of
    begun = beginning_of(law, matched(law, related), groups)
    rows = zip(begun.trials, begun.unknowns.parameters, strict=True)
    unknown_indices = next(indices for trial, indices in rows if trial.object == owner)
    index = unknown_indices[begun.model.parameters.index(parameter)]
    noise = law.uncertainty.noise
    known = None if noise is None else np.asarray(noise, dtype=np.float64)[: len(begun.model.observables)]
    errors = law.uncertainty.error_model
    if not begun.problem.censored.any():
        begun = replace(begun, problem=replace(begun.problem, huber_threshold=law.uncertainty.huber_threshold))
        if known is not None and ERRORS[errors.kind].is_independent:
            begun = _without_outliers(begun, known)
    if known is not None and errors and not errors.of_law:
        begun = replace(begun, problem=begun.problem.about(begun.first, known, errors))
    return begun, index, known


def _without_outliers(begun: Beginning, noise: Floats) -> Beginning:
    """Return a beginning at the optimum under the Huber loss, from where outliers are rejected if there are any."""
    problem, everything = begun.problem, np.ones(len(begun.first), dtype=np.bool_)
    if not np.isfinite(problem.huber_threshold):
        return begun
    first, cost = minimum(Objective(problem, noise), begun.first, everything, begun.bounds, tolerance=1e-8, steps=40)
    if not np.isfinite(cost) or not any(far.any() for far in problem.outliers(first, noise)):
        return begun
    return replace(begun, problem=replace(problem, rejects=True), first=first)


def with_one_sided_limits(law: Law, trials: Trials) -> Law:
    """Return a law with the limits, and notes on these, of the least certain parameters that have only one.

    Such is a rate too fast to be measured, see `commonlaw.estimation.one_sided`. Where the likelihood of a law has no
    profile, as in discrete time or with terms of each object, there are none.
    """
    parameters, limits = named_parameters(law), list[OneSidedLimit]()
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(parameters.errors / np.abs(parameters.values))
    ranked = np.argsort(-relative, axis=None, kind="stable")[:MAX_PROFILES]
    unsure = zip(*np.unravel_index(ranked[relative.flat[ranked] > VAGUE], relative.shape), strict=True)
    of_unknowns = dict[tuple[tuple[str, ...], int], OneSided | None]()  # Objects may share an unknown
    for o, p in unsure if shares_terms(law) else ():
        owner, name = law.objects[o], parameters.names[p]
        with suppress(CommonlawError):
            begun, index, known = _begun(law, trials, name, owner)
            unknown = tuple(trial.object for trial in begun.trials), index
            if unknown not in of_unknowns:
                of_unknowns[unknown] = _one_sided(law, begun, index, known, name, owner)
            limit = of_unknowns[unknown]
            limits += [] if limit is None else [OneSidedLimit(owner, name, limit.limit, limit.is_lower)]
    others = [outcome for outcome in law.provenance.outcomes if outcome.code != "one-sided-limit"]
    outcomes = (*others, *notes_of_limits(limits, law.objects))
    uncertainty = replace(law.uncertainty, limits=tuple(limits))
    return replace(law, uncertainty=uncertainty, provenance=replace(law.provenance, outcomes=outcomes))


def _one_sided(
    law: Law, begun: Beginning, index: int, known: Floats | None, parameter: str, owner: str
) -> OneSided | None:
    """Return the limit of an unknown, the parameter of an object, under noise that is known; None of others."""
    if known is None:
        return None
    parameters = named_parameters(law)
    error = float(parameters.errors[law.objects.index(owner), parameters.names.index(parameter)])
    degrees = _degrees_of_freedom(law, parameter)
    return one_sided(begun.problem, begun.first, known, begun.bounds, index, error, degrees)


def _degrees_of_freedom(law: Law, parameter: str) -> float:
    """Return those of the noise of the law in the equation of a parameter; infinite where it is known."""
    parameters, degrees = named_parameters(law), law.uncertainty.degrees_of_freedom
    return np.inf if degrees is None else float(degrees[parameters.places[0][parameters.names.index(parameter)]])


def _profile(
    begun: Beginning, first: Floats, index: int, noise: Floats | None, degrees: float
) -> tuple[Floats, Floats, float, float, float]:
    """Return values, their deviance, the estimate, its error and degrees of freedom, see `Profile`."""
    problem, everything = begun.problem, np.ones(len(first), dtype=np.bool_)

    def least(start: Floats, free: Bools) -> tuple[Floats, float]:
        return minimum(Objective(problem, known), start, free, begun.bounds, tolerance=1e-8, steps=40)

    known = np.ones(len(begun.model.observables)) if noise is None else noise
    best, cost = least(first, everything)
    if not np.isfinite(cost):
        raise CommonlawError("profile-not-finite")
    if noise is None:
        count = sum(int(np.isfinite(trial.trial.states).sum()) for trial in problem.trials)
        degrees = max(count - len(first), 1)
        known = known * np.sqrt(cost / degrees)
        best, cost = least(best, everything)
    slopes = problem.residuals(best, known)[1]
    assert slopes is not None
    variance = inverse_information(slopes)[index, index]
    error = float(np.sqrt(variance)) or 0.1 * abs(float(best[index])) or 1.0
    others = everything.copy()
    others[index] = False
    points = [(float(best[index]), 0.0)]
    for side in (-1, 1):
        at, wanted = best, [best[index] + side * step * error for step in _STEPS]
        for value in wanted:
            # A step to where the equations have no solution is shortened
            for share in (1.0, 0.5, 0.25):
                start = at.copy()
                start[index] += share * (value - at[index])
                reached, here = least(start, others)
                if np.isfinite(here):
                    break
            if not np.isfinite(here):
                break
            at = reached
            points.append((float(at[index]), max(here - cost, 0.0)))
            if here - cost > two_sided(0.99, degrees) ** 2:
                break
    values, deviance = np.array(sorted(points)).T
    return values, deviance, float(best[index]), error, degrees
