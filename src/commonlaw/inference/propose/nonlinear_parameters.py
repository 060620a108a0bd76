"""Where constants inside of terms begin: a coarse bank of values, compared along smooth curves, then fitted.

Of ``V s/(K + s)``, say, V is found by least squares once K is given (variable projection; Golub and Pereyra 1973). So
values of K are compared by what they leave of the rates of smooth curves through the measurements; from the best of
them, that of all objects together and that of each, trajectories are fitted.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales
from commonlaw.inference import settings
from commonlaw.inference.data.smoothing import smooth_curves, values_and_rates
from commonlaw.inference.fit.integral_form import Integrals
from commonlaw.inference.fit.multistart import best_fits, drawn_together, every_way, usual_of_best
from commonlaw.inference.fit.parameter_grid import combined, divisors, values_of_each
from commonlaw.inference.fit.practical_identifiability import SURE
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.validity import has_pole, values_along
from commonlaw.inference.search.setup import FitSetup
from commonlaw.integration import VectorField
from commonlaw.law import Law
from commonlaw.library import Order, Terms
from commonlaw.library.bounds import Bound, limits_of
from commonlaw.library.grammar import NUMPY, compiled
from commonlaw.likelihood import HUBER_THRESHOLD, Estimate
from commonlaw.outcomes import Outcome, note
from commonlaw.parallel import in_parallel, threads
from commonlaw.progress import ProgressCallback, on_terminal
from commonlaw.spacing import evenly_spaced
from commonlaw.trials import Trials


@dataclass(frozen=True, eq=False)
class _Profile:
    """What a law leaves of what was measured of an object, as a function of those constants that are to be found.

    Variables along its curves, without constants, have the shape (n, variables), known coefficients (equations, terms),
    NaN where they are to be found. For each equation there is what is compared, rates or measurements, shape (m,), and
    what terms, shape (n, terms), say of it.
    """

    terms: Terms
    known: Floats
    values: Floats
    targets: Sequence[Floats]
    said: Sequence[Callable[[Floats], Floats]]

    @cached_property
    def inside(self) -> Bools:
        """Which coefficients are constants that are to be found, shape (equations, terms)."""
        return np.asarray(np.isnan(self.known) & ~self.terms.is_factor)

    def coefficients(self, constants: Floats) -> Floats:
        """Return the coefficients, of which factors are found by least squares, shape (equations, terms)."""
        return self._fitted(constants)[0]

    def left(self, constants: Floats) -> list[Floats]:
        """Return what is left in each equation, infinite where a term is not finite."""
        return self._fitted(constants)[1]

    def deviance(self, constants: Floats) -> float:
        """Return minus twice the log-likelihood where errors have any size; infinite where a term has a pole.

        A pole between points shows by a divisor that changes its sign.
        """
        left = self.left(constants)
        if not all(np.isfinite(own).all() for own in left) or self.has_pole(constants):
            return np.inf
        floors = [np.finfo(float).eps * np.std(own) + np.finfo(float).tiny for own in self.targets]
        pairs = zip(left, floors, strict=True)
        return float(sum(2 * len(own) * np.log(max(_size(own), floor)) for own, floor in pairs))

    def has_pole(self, constants: Floats) -> bool:
        """Return whether something that terms are divided by vanishes along the curves or between their points."""
        found = np.nan_to_num(self.known)
        found[self.inside] = constants
        columns = self.terms.at(self.values, found).T
        with np.errstate(all="ignore"):
            return any(np.ptp(np.sign(compiled(code)(columns, NUMPY))) for code in self._divisors)

    def derivatives(self, constants: Floats, order: Order) -> Floats:
        """Return the derivatives of rates by everything that is to be found, of unit norm, shape (m, parameters)."""
        plain = replace(self.terms, variables=replace(self.terms.variables, logarithmic=()))
        field = VectorField(plain, self.coefficients(constants), order, free=np.isnan(self.known))
        found = field.linearize(self.values).by_parameters
        columns = found.reshape(-1, found.shape[2])
        return np.asarray(columns / column_scales(columns))

    def _fitted(self, constants: Floats) -> tuple[Floats, list[Floats]]:
        found = np.nan_to_num(self.known)
        found[self.inside] = constants
        library = self.terms.evaluate(self.terms.at(self.values, found))
        if not np.isfinite(library).all():
            return found, [np.full_like(own, np.inf) for own in self.targets]
        left, factors = list[Floats](), self.terms.is_factor
        for j, (target, said) in enumerate(zip(self.targets, self.said, strict=True)):
            free = np.isnan(self.known[j]) & factors
            own = said(np.column_stack([library[:, factors] @ found[j, factors], library[:, free]]))
            rest, columns = target - own[:, 0], own[:, 1:]
            scale = column_scales(columns)
            found[j, free] = np.linalg.lstsq(columns / scale, rest)[0] / scale
            left.append(rest - columns @ found[j, free])
        return found, left

    @cached_property
    def _divisors(self) -> list[str]:
        return divisors(self.terms)


def with_constants_found(
    law: Law,
    trials: Trials,
    bounds: Sequence[Bound] = (),
    guesses: Mapping[str, float] | None = None,
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
    guesses
        Where to begin with constants, by name, in place of the values that are tried.
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
        rates = _of_rates(setup)
        tried = zip(law.terms.variables.constants, _within(_banks(setup.law, rates), setup.law, bounds), strict=True)
        banks = [np.array([guesses[name]]) if guesses and name in guesses else each for name, each in tried]
        bank, deviances = _banked(setup.law, rates, banks)
        least = bank[deviances.argmin(axis=1)]
        coefficients = [each.coefficients(own) for each, own in zip(rates, least, strict=True)]
        problem = replace(setup, law=replace(setup.law, coefficients=np.array(coefficients))).problem()
        starts = _starts(setup.law, _of_integrals(problem), bounds, banks, bank, deviances)
        inside = rates[0].inside
        _check_identifiable(setup.law, rates, [own[inside] for own in starts[-1]])
        found = _best_of_each(problem, starts)
    if found is None:
        names = ", ".join(law.terms.variables.constants)
        raise CommonlawError("parameters-not-found", structure=law.structure(), names=names)
    return replace(law, coefficients=found)


def _best_of_each(problem: SearchProblem, starts: Sequence[Floats]) -> Floats | None:
    """Return the coefficients of the best fit of trajectories of each object, from any start, without a pole.

    All have the shape (objects, equations, terms); there are none if an object has no such fit.
    """
    fits: list[list[Estimate]] = [[] for _ in problem.models]
    for start in starts:
        with suppress(CommonlawError):
            for o, each in enumerate(best_fits(problem, problem.starts, [start], every_way)):
                fits[o] += [] if has_pole(problem, o, each) else [each]
    if not all(fits):
        return None
    free = [usual_of_best(own) for own in fits]
    return np.array([each.coefficients for each in drawn_together(problem, free, starts)[1]])


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
            if there and SURE * error > abs(value)
        ]
        if len(lost) > 1 and {*lost} & {*law.terms.variables.constants}:
            found.setdefault(" and ".join(lost), []).append(name)
    return tuple(
        note("parameters-not-separable", ", ".join(objects), parameters=letters, limit=SURE)
        for letters, objects in found.items()
    )


def _of_rates(setup: FitSetup) -> list[_Profile]:
    """Return what each object's rates say, of smooth curves along the trials in which all states were measured."""
    law, found = setup.law, list[_Profile]()
    for name, known in zip(law.objects, setup.known, strict=True):
        curves = [(trial, smooth_curves(trial, law.order)) for trial in setup.trials.of_object(name)]
        complete = [pair for pair in curves if np.isfinite(pair[1][0]).all()]
        if not complete:
            raise CommonlawError("parameters-without-trials", where=name)
        along = [values_and_rates(law.terms.variables, *pair) for pair in complete]
        values, rates = (np.concatenate(each) for each in zip(*along, strict=True))
        few = evenly_spaced(len(values), settings.MAX_CURVE_POINTS)
        found.append(
            _Profile(law.terms, known, values[few], list(rates[few].T), [lambda terms: terms] * rates.shape[1])
        )
    return found


def _of_integrals(problem: SearchProblem) -> list[_Profile]:
    """Return what each object's measurements say of integrals along smoothed states: more than rates of curves say."""
    found = list[_Profile]()
    for o, (model, known, start) in enumerate(zip(problem.models, problem.known, problem.starts, strict=True)):
        values = values_along(problem, o, start)
        matched = [Integrals.and_target(problem, o, j, values) for j in range(len(known))]
        said, targets = zip(*((each.of, target) for each, target in matched), strict=True)
        found.append(_Profile(model.terms, known, values, targets, said))
    return found


def _banks(law: Law, profiles: Sequence[_Profile]) -> list[Floats]:
    """Return the values that each constant is tried at."""
    return values_of_each(law.terms, np.concatenate([each.values for each in profiles]), _columns(profiles[0]))


def _within(banks: Sequence[Floats], law: Law, bounds: Sequence[Bound]) -> list[Floats]:
    """Return the values within the bounds of each constant, and where these are close, values evenly between them."""
    found = list[Floats]()
    for name, bank in zip(law.terms.variables.constants, banks, strict=True):
        low, high = limits_of(name, bounds)
        inside = bank[(bank > low) & (bank < high)]
        if len(inside) < settings.PER_CYCLE and np.isfinite(high - low):
            inside = np.concatenate([inside, np.linspace(low, high, settings.PER_CYCLE + 2)[1:-1]])
        found.append(inside)
    return found


def _banked(law: Law, profiles: Sequence[_Profile], banks: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return values of constants that are tried, shape (values, constants), and their deviances for each object."""
    bank = combined(banks)
    deviances = np.array(in_parallel(lambda each: [each.deviance(own) for own in bank], profiles))
    if not len(bank) or not np.isfinite(deviances).any(axis=1).all():
        raise _without_values(law)
    return bank, deviances


def _without_values(law: Law) -> CommonlawError:
    return CommonlawError("terms-nowhere-finite", parameters=law.terms.variables.constants)


def _starts(
    law: Law,
    profiles: Sequence[_Profile],
    bounds: Sequence[Bound],
    banks: Sequence[Floats],
    bank: Floats,
    deviances: Floats,
) -> list[Floats]:
    """Return coefficients to begin with, each of shape (objects, equations, terms).

    First with constants that are best for all objects together, then with others for all of them that differ, then with
    those that are best for each.
    """
    swept, swept_alone = list[Floats](), [list[Floats]() for _ in profiles]
    if np.prod([len(each) for each in banks], dtype=float) > settings.MAX_COMBINATIONS:
        best = [bank[i] for i in np.argsort(deviances.sum(axis=0), kind="stable")[: settings.MAX_KEPT]]
        swept = [_swept(profiles, banks, each) for each in best]
        swept_alone = in_parallel(lambda each: [_swept([each], banks, own) for own in swept[:1]], profiles)
    together = _best(law, profiles, bounds, bank, deviances.sum(axis=0), swept)[: settings.MAX_KEPT]
    alone = in_parallel(
        lambda each, own, more: _best(law, [each], bounds, bank, own, [*swept, *more])[:1],
        profiles,
        deviances,
        swept_alone,
    )
    if not all(alone):
        raise _without_values(law)
    starts = [*([each] * len(profiles) for each in together), [own for (own,) in alone]]
    return [np.array([each.coefficients(own) for each, own in zip(profiles, start, strict=True)]) for start in starts]


def _swept(profiles: Sequence[_Profile], banks: Sequence[Floats], begin: Floats) -> Floats:
    """Return the constants that leave least of all values of one of them, given the others, one after the other.

    Of several frequencies this is the periodogram of what the others leave, again and again (the relaxation of Li and
    Stoica 1996), where their combinations are too many to be tried.
    """

    def left(constants: Floats) -> float:
        return sum(each.deviance(constants) for each in profiles)

    now, value = begin, left(begin)
    for _ in range(settings.MAX_SWEEPS):
        before = value
        for i, bank in enumerate(banks):
            tried = np.tile(now, (len(bank), 1))
            tried[:, i] = bank
            values = [left(each) for each in tried]
            best = int(np.argmin(values))
            if values[best] < value:
                now, value = tried[best], values[best]
        if not value < before - settings.SAME_DEVIANCE:
            break
    return now


def _columns(profile: _Profile) -> list[int]:
    """Return the columns, among the variables, of the constants that are to be found."""
    first = profile.values.shape[1]
    return [first + profile.terms.constants.index(k) for k in np.argwhere(profile.inside)[:, 1]]


def _best(
    law: Law,
    profiles: Sequence[_Profile],
    bounds: Sequence[Bound],
    bank: Floats,
    deviances: Floats,
    swept: Sequence[Floats],
) -> list[Floats]:
    """Return the constants that leave least of the rates of some objects, from ones of a bank that differ.

    Constants that were found by sweeps are begun with, too.

    Where several leave the same, as -n and the other side of a saturation do, it is those by which more of what has a
    name is above zero, and then the smaller ones.
    """
    letters = {each.name: each for each in law.named_coefficients}

    def holds(constants: Floats) -> bool:
        coefficients = [each.coefficients(constants) for each in profiles] if bounds else []
        return all(bound.holds(letters[bound.name].of(own)) for bound in bounds for own in coefficients)

    listed = [bank[i] for i in np.argsort(deviances, kind="stable") if np.isfinite(deviances[i])]
    begun = [*filter(holds, swept), *islice(filter(holds, listed), settings.MAX_REFINED), *_different(listed, holds)]
    limits = np.array([limits_of(name, bounds) for name in law.terms.variables.constants]).reshape(-1, 2).T
    found = [*begun, *filter(holds, (_refined(profiles, each, limits) for each in begun))]
    values = [sum(each.deviance(own) for each in profiles) for own in found]

    def unusual(constants: Floats) -> tuple[int, float]:
        named = [each.of(profile.coefficients(constants)) for profile in profiles for each in letters.values()]
        return int(np.sum(np.array(named) < 0)), float(np.sum(np.abs(constants)))

    alike = [own for own, value in zip(found, values, strict=True) if value <= min(values) + settings.SAME_DEVIANCE]
    ordered = [found[k] for k in np.argsort(values, kind="stable")]
    return _different([*sorted(alike, key=unusual), *ordered])


def _different(listed: Sequence[Floats], holds: Callable[[Floats], bool] = lambda _: True) -> list[Floats]:
    """Return the first few of some constants that differ, by their signs or a factor."""
    found = list[Floats]()
    for each in listed:
        if len(found) < settings.MAX_REFINED and not any(_is_near(each, other) for other in found) and holds(each):
            found.append(each)
    return found


def _is_near(one: Floats, other: Floats) -> bool:
    with np.errstate(divide="ignore", invalid="ignore"):
        return bool((np.abs(np.log(one / other)) < np.log(settings.MIN_FACTOR)).all())


def _refined(profiles: Sequence[_Profile], begin: Floats, limits: Floats) -> Floats:
    """Return the constants that leave least of the rates near some values, between limits, shape (2, constants)."""
    from scipy.optimize import least_squares

    tiny = np.finfo(float).tiny
    units = [[max(_size(own), tiny) for own in each.left(begin)] for each in profiles]

    def left(relative: Floats) -> Floats:
        listed = [each.left(begin * relative) for each in profiles]
        pairs = [pair for own, sizes in zip(listed, units, strict=True) for pair in zip(own, sizes, strict=True)]
        whole = np.concatenate([own / size for own, size in pairs])
        return np.where(np.isfinite(whole), whole, 1 / settings.ROUNDING)

    low, high = np.sort(limits / begin, axis=0)
    return np.asarray(
        begin * least_squares(left, np.ones_like(begin), bounds=(low, high), max_nfev=settings.MAX_ITERATIONS).x
    )


def _check_identifiable(law: Law, profiles: Sequence[_Profile], constants: Sequence[Floats]) -> None:
    """Refuse what no trial could tell: coefficients of which only a combination matters."""
    listed = []
    for each, own in zip(profiles, constants, strict=True):
        _, sizes, directions = np.linalg.svd(each.derivatives(own, law.order), full_matrices=False)
        if len(sizes) == len(directions) and sizes[-1] > settings.MIN_SINGULAR_VALUE:
            return
        listed.append(np.abs(directions[-1]))
    part = np.mean(listed, axis=0) > settings.ALIKE
    free = np.argwhere(np.isnan(profiles[0].known))[part].tolist()
    before = [each for each in law.named_products if [each.equation, each.term] in free]
    names = ", ".join(dict.fromkeys(name for each in before for name, _ in each.coefficients))
    variables = ", ".join(law.terms.variables.measured)
    raise CommonlawError("parameters-not-identifiable", names=names, structure=law.structure(), variables=variables)


def _size(left: Floats) -> float:
    """Return the root mean square."""
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean(left**2)))
