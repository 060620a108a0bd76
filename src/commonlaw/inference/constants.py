"""Where constants inside of terms begin: a coarse bank of values, compared along smooth curves, then fitted.

Of ``V s/(K + s)``, say, V is found by least squares once K is given (variable projection; Golub and Pereyra 1973). So
values of K are compared by what they leave of the rates of smooth curves through the measurements; from the best of
them, that of all objects together and that of each, trajectories are fitted.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales
from commonlaw.inference.constant_values import divisors, values_to_try
from commonlaw.inference.fit_setup import FitSetup
from commonlaw.inference.law_search import fit_terms
from commonlaw.inference.search_state import SearchState
from commonlaw.inference.smooth_rates import smooth_curves, values_and_rates
from commonlaw.integration import VectorField
from commonlaw.law import Law
from commonlaw.library import Order, Terms
from commonlaw.library.bounds import Bound
from commonlaw.library.grammar import NUMPY, compiled
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.outcomes import Outcome, OutcomeKind
from commonlaw.parallel import in_parallel, threads
from commonlaw.progress import ProgressCallback, on_terminal
from commonlaw.spacing import evenly_spaced
from commonlaw.trials import Trials

_MOST_POINTS = 300
"""Points of an object's curves that values are compared at."""

_BEST = 5
"""Combinations of values that least squares makes better, of those in the bank."""

_DEPENDENT = 1e-7
"""Columns of unit norm whose directions are smaller than this are told by nothing but rounding."""

_FAR = 1e6
"""What is left of a rate, relative to what was left at first, where a term is not finite."""

_STEPS = 50
"""Of least squares on rates; trajectories say the rest."""

_ALIKE = 0.01
"""Deviances that differ by less say the same of the rates."""

_SHARE = 0.1
"""Of a direction that nothing tells: what counts as part of it."""


@dataclass(frozen=True, eq=False)
class _Profile:
    """What a law leaves of the rates of an object, as a function of those constants that are to be found.

    Variables along its curves, without constants, have the shape (n, variables), rates (n, equations), known
    coefficients (equations, terms), NaN where they are to be found.
    """

    terms: Terms
    known: Floats
    values: Floats
    rates: Floats

    @cached_property
    def inside(self) -> Bools:
        """Which coefficients are constants that are to be found, shape (equations, terms)."""
        return np.asarray(np.isnan(self.known) & ~self.terms.is_factor)

    def coefficients(self, constants: Floats) -> Floats:
        """Return the coefficients, of which factors are found by least squares, shape (equations, terms)."""
        return self._fitted(constants)[0]

    def left(self, constants: Floats) -> Floats:
        """Return what is left of the rates, shape (n, equations), infinite where a term is not finite."""
        return self._fitted(constants)[1]

    def deviance(self, constants: Floats) -> float:
        """Return minus twice the log-likelihood of rates whose errors have any size; infinite where a term has a pole.

        A pole between points shows by a divisor that changes its sign.
        """
        left = self.left(constants)
        if not np.isfinite(left).all() or any(np.ptp(np.sign(each)) for each in self._divisors(constants)):
            return np.inf
        floor = np.finfo(float).eps * np.std(self.rates, axis=0) + np.finfo(float).tiny
        return 2 * len(left) * float(np.sum(np.log(np.maximum(_size(left), floor))))

    def derivatives(self, constants: Floats, order: Order) -> Floats:
        """Return the derivatives of rates by everything that is to be found, of unit norm, shape (m, parameters)."""
        plain = replace(self.terms, variables=replace(self.terms.variables, logarithmic=()))
        field = VectorField(plain, self.coefficients(constants), order, free=np.isnan(self.known))
        found = field.linearize(self.values).by_parameters
        columns = found.reshape(-1, found.shape[2])
        return np.asarray(columns / column_scales(columns))

    def _fitted(self, constants: Floats) -> tuple[Floats, Floats]:
        found = np.nan_to_num(self.known)
        found[self.inside] = constants
        library = self.terms.evaluate(self.terms.at(self.values, found))
        if not np.isfinite(library).all():
            return found, np.full(self.rates.shape, np.inf)
        left, factors = np.empty(self.rates.shape), self.terms.is_factor
        for j, free in enumerate(np.isnan(self.known) & factors):
            rest = self.rates[:, j] - library[:, factors] @ found[j, factors]
            columns = library[:, free]
            scale = column_scales(columns)
            own = np.linalg.lstsq(columns / scale, rest)[0] / scale
            found[j, free] = own
            left[:, j] = rest - columns @ own
        return found, left

    def _divisors(self, constants: Floats) -> list[Floats]:
        found = np.nan_to_num(self.known)
        found[self.inside] = constants
        columns = self.terms.at(self.values, found).T
        with np.errstate(all="ignore"):
            return [compiled(code)(columns, NUMPY) for code in self._divisor_codes]

    @cached_property
    def _divisor_codes(self) -> list[str]:
        return divisors(self.terms)


def with_constants_found(
    law: Law,
    trials: Trials,
    bounds: Sequence[Bound] = (),
    *,
    positive: Sequence[str] | None = None,
    input_between: str | None = None,
    noise: Mapping[str, float] | None = None,
    huber_threshold: float = HUBER_THRESHOLD,
    n_jobs: int = -1,
    progress: ProgressCallback | None = None,
    **_: Any,
) -> Law:
    """Return a law with the constants inside of its terms near where they fit best, for refinement to begin with.

    Parameters
    ----------
    law
        As it was stated, whose constants have any values.
    bounds
        Of the named coefficients of the law.
    trials, positive, input_between, noise, huber_threshold, n_jobs, progress
        See `refine`, whose other settings are of no matter here.

    Raises
    ------
    CommonlawError
        If no values make all terms finite, the trials cannot tell coefficients apart, or no fit succeeds.
    """
    if not law.terms.variables.constants or trials.schema.starts:  # There `known_starts` tries values
        return law
    setup = FitSetup.of(law, trials, noise, huber_threshold, input_between, positive)
    if law.terms.is_factor[np.isnan(setup.known[0]).any(axis=0)].all():
        return law
    (on_terminal() if progress is None else progress)("looking for constants inside of terms")
    with threads(n_jobs):
        profiles = _profiles(setup)
        starts = _starts(setup.law, profiles, bounds)
        _check_identifiable(setup.law, profiles, starts[-1])
        found = in_parallel(lambda start: _fitted(setup, profiles[0].inside, start), starts)
    states = [each for each in found if each is not None and _is_finite(each, profiles)]
    if not states:
        names = ", ".join(law.terms.variables.constants)
        raise CommonlawError(
            f"no fit of {'; '.join(law.structure())} succeeded from any values of {names} that were tried, without a "
            "pole where trials have been: give some of them as numbers"
        )
    best = min(states, key=lambda each: each.value)
    return replace(law, coefficients=np.array([each.coefficients for each in best.estimates]))


def _fitted(setup: FitSetup, inside: Bools, constants: Floats) -> SearchState | None:
    """Return the fit of trajectories from values of the constants, shape (objects, constants), if it succeeds."""
    coefficients = setup.law.coefficients.copy()
    coefficients[:, inside] = constants
    with suppress(CommonlawError):
        return fit_terms(replace(setup, law=replace(setup.law, coefficients=coefficients))).state
    return None


def _is_finite(state: SearchState, profiles: Sequence[_Profile]) -> bool:
    """Return whether no term of a fit has a pole where trials have been, or between."""
    pairs = zip(state.estimates, profiles, strict=True)
    return all(np.isfinite(profile.deviance(each.coefficients[profile.inside])) for each, profile in pairs)


def outcomes_of_constants(law: Law) -> tuple[Outcome, ...]:
    """Return that trials tell a combination of coefficients alone, where a term shows nothing of what is inside.

    As of V s/(K + s), where s is always small beside K: both could be of any size.
    """
    values, errors = law.letter_values()
    first, found = len(law.terms.variables.measured), dict[str, list[str]]()
    bent = [any(column >= first for column in law.terms.terms[each.term].columns()) for each in law.named_coefficients]
    for name, own, known in zip(law.objects, values, errors, strict=True):
        lost = [
            letter
            for letter, there, value, error in zip(law.letters, bent, own, known, strict=True)
            if there and error > abs(value)
        ]
        if len(lost) > 1 and {*lost} & {*law.terms.variables.constants}:
            found.setdefault(" and ".join(lost), []).append(name)
    return tuple(
        Outcome(
            OutcomeKind.NOT_IDENTIFIABLE,
            ", ".join(objects),
            f"the trials tell a combination of {letters} alone, whose standard errors are larger than themselves",
            "give one of them as a number, or measure where the term bends",
        )
        for letters, objects in found.items()
    )


def _profiles(setup: FitSetup) -> list[_Profile]:
    """Return the profile of each object, along the trials in which all states were measured."""
    law, found = setup.law, list[_Profile]()
    for name, known in zip(law.objects, setup.known, strict=True):
        curves = [(trial, smooth_curves(trial, law.order)) for trial in setup.trials.of_object(name)]
        complete = [pair for pair in curves if np.isfinite(pair[1][0]).all()]
        if not complete:
            raise CommonlawError(f"{name}: no trial has all states, from which constants inside of terms could begin")
        along = [values_and_rates(law.terms.variables, *pair) for pair in complete]
        values, rates = (np.concatenate(each) for each in zip(*along, strict=True))
        few = evenly_spaced(len(values), _MOST_POINTS)
        found.append(_Profile(law.terms, known, values[few], rates[few]))
    return found


def _starts(law: Law, profiles: Sequence[_Profile], bounds: Sequence[Bound]) -> list[Floats]:
    """Return values of constants to begin with, each of shape (objects, constants).

    First those that are best for all objects together, then those that are best for each.
    """
    terms = law.terms
    bank = values_to_try(terms, np.concatenate([each.values for each in profiles]), _columns(profiles[0]))
    deviances = np.array(in_parallel(lambda each: [each.deviance(own) for own in bank], profiles))
    together = _best(law, profiles, bounds, bank, deviances.sum(axis=0))
    alone = in_parallel(lambda each, own: _best(law, [each], bounds, bank, own), profiles, deviances)
    if any(each is None for each in alone):
        raise CommonlawError(
            f"no values of {', '.join(terms.variables.constants)} were found at which all terms are finite along the "
            "trials: check the equations for roots, logarithms and powers of negative numbers, widen bounds, or give "
            "numbers"
        )
    found = [] if together is None or len(profiles) == 1 else [np.tile(together, (len(profiles), 1))]
    return [*found, np.array(alone)]


def _columns(profile: _Profile) -> list[int]:
    """Return the columns, among the variables, of the constants that are to be found."""
    first = profile.values.shape[1]
    return [first + profile.terms.constants.index(k) for k in np.argwhere(profile.inside)[:, 1]]


def _best(
    law: Law, profiles: Sequence[_Profile], bounds: Sequence[Bound], bank: Floats, deviances: Floats
) -> Floats | None:
    """Return the constants that leave least of the rates of some objects, from the best ones of a bank.

    Where several leave the same, as -n and the other side of a saturation do, it is those by which more of what has a
    name is above zero, and then the smaller ones.
    """
    letters = {each.name: each for each in law.named_coefficients}

    def holds(constants: Floats) -> bool:
        coefficients = [each.coefficients(constants) for each in profiles]
        return all(bound.holds(letters[bound.name].of(own)) for bound in bounds for own in coefficients)

    listed = (bank[i] for i in np.argsort(deviances, kind="stable") if np.isfinite(deviances[i]))
    best = list(islice(filter(holds, listed), _BEST))
    found = [*best, *filter(holds, (_refined(profiles, each) for each in best))]
    values = [sum(each.deviance(own) for each in profiles) for own in found]
    alike = [own for own, value in zip(found, values, strict=True) if value <= min(values) + _ALIKE]

    def unusual(constants: Floats) -> tuple[int, float]:
        named = [each.of(profile.coefficients(constants)) for profile in profiles for each in letters.values()]
        return int(np.sum(np.array(named) < 0)), float(np.sum(np.abs(constants)))

    return min(alike, key=unusual, default=None)


def _refined(profiles: Sequence[_Profile], begin: Floats) -> Floats:
    """Return the constants that leave least of the rates near some values."""
    from scipy.optimize import least_squares

    units = [np.maximum(_size(each.left(begin)), np.finfo(float).tiny) for each in profiles]

    def left(relative: Floats) -> Floats:
        pairs = zip(profiles, units, strict=True)
        whole = np.concatenate([(each.left(begin * relative) / unit).ravel() for each, unit in pairs])
        return np.where(np.isfinite(whole), whole, _FAR)

    return np.asarray(begin * least_squares(left, np.ones_like(begin), max_nfev=_STEPS).x)


def _check_identifiable(law: Law, profiles: Sequence[_Profile], constants: Floats) -> None:
    """Refuse what no trial could tell: coefficients of which only a combination matters."""
    listed = []
    for each, own in zip(profiles, constants, strict=True):
        _, sizes, directions = np.linalg.svd(each.derivatives(own, law.order), full_matrices=False)
        if len(sizes) == len(directions) and sizes[-1] > _DEPENDENT:
            return
        listed.append(np.abs(directions[-1]))
    part = np.mean(listed, axis=0) > _SHARE
    free = np.argwhere(np.isnan(profiles[0].known))[part].tolist()
    before = [each for each in law.named_products if [each.equation, each.term] in free]
    names = ", ".join(dict.fromkeys(name for each in before for name, _ in each.coefficients))
    variables = ", ".join(law.terms.variables.measured)
    raise CommonlawError(
        f"the trials do not tell {names}: a combination of them is all that matters in {'; '.join(law.structure())}; "
        f"give one as a number, or correct its name; variables: {variables}"
    )


def _size(left: Floats) -> Floats:
    """Return the root mean square of each column."""
    with np.errstate(over="ignore"):
        return np.asarray(np.sqrt(np.mean(left**2, axis=0)))
