"""Where parameters inside terms begin: a coarse bank of values, compared along smooth curves, then fitted.

Of ``V s/(K + s)``, say, V is found by least squares once K is given (variable projection; Golub and Pereyra 1973). So
values of K are compared by what they leave of the rates of smooth curves through the measurements; from the best of
them, that of all objects together and that of each, trajectories are fitted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales
from commonlaw.inference import settings
from commonlaw.inference.data.smoothing import smooth_curves, values_and_rates
from commonlaw.inference.fit.integral_form import Integrals, solved
from commonlaw.inference.fit.lack_of_fit import has_pole, values_along
from commonlaw.inference.fit.multistart import best_fits, full_schedule, pooled_estimate, shrink_to_pooled
from commonlaw.inference.fit.parameter_grid import combined, divisors, factor_powers, values_of_each
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.structural_identifiability import enters_in_combination
from commonlaw.inference.search.setup import FitSetup
from commonlaw.integration import VectorField
from commonlaw.law import Law
from commonlaw.law.parameters import named_parameters
from commonlaw.library import Order, Terms
from commonlaw.library.bounds import Bound, limits_of
from commonlaw.library.grammar import evaluate
from commonlaw.likelihood import HUBER_THRESHOLD, Estimate
from commonlaw.outcomes import Outcome, note
from commonlaw.runtime.parallel import in_parallel, threads
from commonlaw.runtime.progress import ProgressCallback, on_terminal
from commonlaw.trials import Trials


@dataclass(frozen=True, eq=False)
class _Profile:
    """What a law leaves of what was measured of an object, as a function of those parameters that are to be found.

    Variables along its curves, without parameters, have the shape (n, variables), known coefficients (equations,
    terms), NaN where they are to be found. For each equation there is what is compared, rates or measurements, shape
    (m,), and what terms, shape (n, terms), say of it.
    """

    terms: Terms
    known: Floats
    values: Floats
    targets: Sequence[Floats]
    said: Sequence[Callable[[Floats], Floats]]

    @cached_property
    def divisors(self) -> list[str]:
        """The code of what terms are divided by."""
        return divisors(self.terms)

    @cached_property
    def inside(self) -> Bools:
        """Which coefficients are parameters that are to be found, shape (equations, terms)."""
        return np.asarray(np.isnan(self.known) & ~self.terms.is_factor)

    def coefficients(self, parameters: Floats) -> Floats:
        """Return the coefficients, of which factors are found by least squares, shape (equations, terms)."""
        return self._fitted(parameters)[0]

    def left(self, parameters: Floats) -> list[Floats]:
        """Return what is left in each equation, infinite where a term is not finite."""
        return self._fitted(parameters)[1]

    def deviance(self, parameters: Floats) -> float:
        """Return minus twice the log-likelihood where errors have any size; infinite where a term is, or has a pole."""
        left = self.left(parameters)
        if not all(np.isfinite(own).all() for own in left) or self.has_pole(parameters):
            return np.inf
        floors = [np.finfo(float).eps * np.std(own) + np.finfo(float).tiny for own in self.targets]
        pairs = zip(left, floors, strict=True)
        return float(sum(2 * len(own) * np.log(max(_size(own), floor)) for own, floor in pairs))

    def has_pole(self, parameters: Floats) -> bool:
        """Return whether something that terms are divided by vanishes along the curves or between their points."""
        found = np.nan_to_num(self.known)
        found[self.inside] = parameters
        columns = self.terms.at(self.values, found).T
        with np.errstate(all="ignore"):
            return any(np.ptp(np.sign(evaluate(code, columns))) for code in self.divisors)

    def by_factors(self) -> Floats:
        """Return parameters by a coefficient c of least squares for each term: log c is the sum of powers times log p.

        They are NaN unless all of them are factors of terms.
        """
        found, factors = np.nan_to_num(self.known), self.terms.is_factor
        found[self.inside] = 1.0
        library = self.terms.evaluate(self.terms.at(self.values, found))
        columns = [self.terms.parameters.index(k) for k in np.argwhere(self.inside)[:, 1]]
        powers, rows, logarithms = factor_powers(self.terms)[:, columns], list[Floats](), list[float]()
        if not (np.isfinite(powers[factors]).all() and np.isfinite(library).all()):
            return np.full(len(columns), np.nan)
        for j, (target, said) in enumerate(zip(self.targets, self.said, strict=True)):
            free, given = np.isnan(self.known[j]) & factors, (found[j] != 0) & factors
            bound = np.flatnonzero(given & powers.any(axis=1))
            given[bound] = False
            parts = [library[:, given] @ found[j, given], library[:, bound] * found[j, bound], library[:, free]]
            sides = said(np.column_stack(parts))
            numbers = solved(sides[:, 1:], target - sides[:, 0])[0][: len(bound)]
            weights = np.abs(numbers) * np.linalg.norm(sides[:, 1 : len(bound) + 1], axis=0)
            rows += list(powers[bound] * weights[:, np.newaxis])
            logarithms += (weights * np.log(np.abs(numbers) + np.finfo(float).tiny)).tolist()
        scale = np.max(np.abs(rows), initial=0.0) or 1.0
        return np.asarray(np.exp(np.linalg.lstsq(np.array(rows) / scale, np.array(logarithms) / scale)[0]))

    def derivatives(self, parameters: Floats, order: Order) -> Floats:
        """Return the derivatives of rates by everything that is to be found, of unit norm, shape (m, parameters)."""
        plain = replace(self.terms, variables=replace(self.terms.variables, logarithmic=()))
        field = VectorField(plain, self.coefficients(parameters), order, free=np.isnan(self.known))
        found = field.linearize(self.values).by_parameters
        columns = found.reshape(-1, found.shape[2])
        return np.asarray(columns / column_scales(columns))

    def _fitted(self, parameters: Floats) -> tuple[Floats, list[Floats]]:
        found = np.nan_to_num(self.known)
        found[self.inside] = parameters
        library = self.terms.evaluate(self.terms.at(self.values, found))
        if not np.isfinite(library).all():
            return found, [np.full_like(own, np.inf) for own in self.targets]
        left, factors = list[Floats](), self.terms.is_factor
        for j, (target, said) in enumerate(zip(self.targets, self.said, strict=True)):
            free = np.isnan(self.known[j]) & factors
            columns = said(np.column_stack([library[:, factors] @ found[j, factors], library[:, free]]))
            found[j, free], residuals = solved(columns[:, 1:], target - columns[:, 0])
            left.append(residuals)
        return found, left


def with_parameters_found(
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
    """Return a law with the parameters inside its terms near where they fit best, for refinement to begin with.

    Parameters
    ----------
    law
        As it was stated, whose parameters have any values.
    bounds
        Of the named coefficients of the law.
    guesses
        Where to begin with parameters, by name, in place of the values that are tried.
    trials, positive, input_between, noise, huber_threshold, n_jobs, progress
        See `refine`, whose other settings are of no matter here.

    Raises `CommonlawError` if no values make all terms finite, the trials cannot tell coefficients apart, or no fit
    succeeds.
    """
    if not law.terms.variables.parameters:
        return law
    setup = FitSetup.of(law, trials, noise, huber_threshold, input_between, positive)
    if law.terms.is_factor[np.isnan(setup.known[0]).any(axis=0)].all():
        return law
    if trials.schema.starts:  # There `begun_at_starts` tries values
        unknown = np.full(len(law.terms.variables.measured), np.nan)
        _refuse_combination(law, enters_in_combination(law.terms, setup.known[0], unknown))
        return law
    (on_terminal() if progress is None else progress)("looking for nonlinear parameters")
    with threads(n_jobs):
        rates = _of_rates(setup)
        grid = _Grid.of(setup.law, rates, bounds, guesses or {})
        deviances = np.array(in_parallel(lambda each: [each.deviance(own) for own in grid.values], rates))
        if not len(grid.values) or not np.isfinite(deviances).any(axis=1).all():
            raise CommonlawError("terms-nowhere-finite", parameters=grid.names)
        least = grid.values[deviances.argmin(axis=1)]
        coefficients = [each.coefficients(own) for each, own in zip(rates, least, strict=True)]
        problem = replace(setup, law=replace(setup.law, coefficients=np.array(coefficients))).problem()
        starts = grid.starts(_of_integrals(problem), deviances)
        _check_identifiable(setup.law, rates, [each[rates[0].inside] for each in starts[-1]])
        fits: list[list[Estimate]] = [[] for _ in problem.models]
        for start in starts:
            for o, each in enumerate(best_fits(problem, problem.starts, [start], full_schedule)):
                fits[o] += [] if has_pole(problem, o, each) else [each]
        if not all(fits):
            raise CommonlawError("parameters-not-found", structure=law.structure, names=", ".join(grid.names))
        free = [pooled_estimate(each) for each in fits]
        return replace(
            law, coefficients=np.array([each.coefficients for each in shrink_to_pooled(problem, free, starts)[1]])
        )


def outcomes_of_parameters(law: Law) -> tuple[Outcome, ...]:
    """Return that trials tell a combination of coefficients alone, where a term shows nothing of what is inside.

    As of V s/(K + s), where s is always small compared with K: both could be of any size.
    """
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    first, found = len(law.terms.variables.measured), dict[str, list[str]]()
    bent = [any(column >= first for column in law.terms.terms[each.term].columns()) for each in parameters.definitions]
    for name, own, known in zip(law.objects, values, errors, strict=True):
        lost = [
            letter
            for letter, there, value, error in zip(parameters.names, bent, own, known, strict=True)
            if there and settings.SIGNIFICANT * error > abs(value)
        ]
        if len(lost) > 1 and {*lost} & {*law.terms.variables.parameters}:
            found.setdefault(" and ".join(lost), []).append(name)
    return tuple(
        note("parameters-not-separable", ", ".join(objects), parameters=letters, limit=settings.SIGNIFICANT)
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


@dataclass(frozen=True, eq=False)
class _Grid:
    """Values of each parameter that is to be found, by name, within its bounds, and combinations of them.

    Combinations have the shape (values, parameters).
    """

    law: Law
    names: Sequence[str]
    bounds: Sequence[Bound]
    banks: Sequence[Floats]
    values: Floats

    @classmethod
    def of(
        cls, law: Law, profiles: Sequence[_Profile], bounds: Sequence[Bound], guesses: Mapping[str, float]
    ) -> "_Grid":
        """Return guesses or the values that terms suggest, with more, evenly spaced, where bounds are close."""
        first, inside = profiles[0].values.shape[1], np.argwhere(profiles[0].inside)[:, 1]
        columns = [first + law.terms.parameters.index(k) for k in inside]
        names = [law.terms.variables.names[column] for column in columns]
        tried = values_of_each(law.terms, np.concatenate([each.values for each in profiles]), columns)
        banks = list[Floats]()
        for name, bank in zip(names, tried, strict=True):
            low, high = limits_of(name, bounds)
            within = bank[(bank > low) & (bank < high)]
            if len(within) < settings.PER_CYCLE and np.isfinite(high - low):
                within = np.concatenate([within, np.linspace(low, high, settings.PER_CYCLE + 2)[1:-1]])
            banks.append(np.array([guesses[name]]) if name in guesses else within)
        values = combined(banks)
        if not guesses:
            each = np.array([profile.by_factors() for profile in profiles])
            more = np.vstack([np.exp(np.log(each).mean(axis=0)), each])
            values = np.vstack([more[np.isfinite(more).all(axis=1)], values])
        return cls(law, names, bounds, banks, values)

    def starts(self, profiles: Sequence[_Profile], deviances: Floats) -> list[Floats]:
        """Return coefficients to begin with, each of shape (objects, equations, terms), by deviances of all values.

        First with parameters that are best for all objects together, then with others for all of them that differ, then
        with those that are best for each.
        """
        swept, swept_alone = list[Floats](), [list[Floats]() for _ in profiles]
        if np.prod([len(each) for each in self.banks], dtype=float) > settings.MAX_COMBINATIONS:
            best = self.values[np.argsort(deviances.sum(axis=0), kind="stable")[: settings.MAX_KEPT]]
            swept = [self._swept(profiles, each) for each in best]
            swept_alone = in_parallel(lambda each: [self._swept([each], own) for own in swept[:1]], profiles)
        together = self._best(profiles, deviances.sum(axis=0), swept)[: settings.MAX_KEPT]
        alone = in_parallel(
            lambda each, own, more: self._best([each], own, [*swept, *more])[:1], profiles, deviances, swept_alone
        )
        if not all(alone):
            raise CommonlawError("terms-nowhere-finite", parameters=self.names)
        starts = [*([each] * len(profiles) for each in together), [each for (each,) in alone]]
        return [
            np.array([each.coefficients(own) for each, own in zip(profiles, start, strict=True)]) for start in starts
        ]

    def _swept(self, profiles: Sequence[_Profile], begin: Floats) -> Floats:
        """Return the parameters that leave least of all values of one of them, given the others, one after the other.

        Of several frequencies this is the periodogram of what the others leave, again and again (the relaxation of Li
        and Stoica 1996), where their combinations are too many to be tried.
        """

        def deviance(parameters: Floats) -> float:
            return sum(each.deviance(parameters) for each in profiles)

        now, value = begin, deviance(begin)
        for _ in range(settings.MAX_SWEEPS):
            before = value
            for i, bank in enumerate(self.banks):
                tried = np.tile(now, (len(bank), 1))
                tried[:, i] = bank
                values = [deviance(each) for each in tried]
                best = int(np.argmin(values))
                if values[best] < value:
                    now, value = tried[best], values[best]
            if not value < before - settings.SAME_DEVIANCE:
                break
        return now

    def _best(self, profiles: Sequence[_Profile], deviances: Floats, swept: Sequence[Floats]) -> list[Floats]:
        """Return the parameters that leave least of some objects, from values that differ, and those found by sweeps.

        Where several leave the same, as -n and the other side of a saturation do, it is those by which more of what has
        a name is above zero, and then the smaller ones.
        """
        letters = {each.name: each for each in named_parameters(self.law).definitions}

        def holds(parameters: Floats) -> bool:
            coefficients = [each.coefficients(parameters) for each in profiles] if self.bounds else []
            return all(bound.holds(letters[bound.name].of(own)) for bound in self.bounds for own in coefficients)

        def unusual(parameters: Floats) -> tuple[int, float]:
            named = [each.of(profile.coefficients(parameters)) for profile in profiles for each in letters.values()]
            return int(np.sum(np.array(named) < 0)), float(np.sum(np.abs(parameters)))

        listed = [self.values[i] for i in np.argsort(deviances, kind="stable") if np.isfinite(deviances[i])]
        low, high = np.array([limits_of(name, self.bounds) for name in self.names]).reshape(-1, 2).T
        begun, wanted = list[Floats](), holds
        # Factors of terms may end at their bounds: where those of no values are within, the fit begins outside
        for wanted in (holds, lambda own: bool(np.all((low <= own) & (own <= high)))):
            first = islice(filter(wanted, listed), settings.MAX_REFINED)
            begun = [*filter(wanted, swept), *first, *_different(listed, wanted)]
            if begun:
                break
        found = [*begun, *filter(wanted, (_refined(profiles, each, np.stack([low, high])) for each in begun))]
        values = [sum(each.deviance(own) for each in profiles) for own in found]
        ordered = [found[k] for k in np.argsort(values, kind="stable")]
        same = [k for k, value in enumerate(values) if value <= min(values) + settings.SAME_DEVIANCE]
        return _different([*sorted((found[k] for k in same), key=unusual), *ordered])


def _different(listed: Sequence[Floats], holds: Callable[[Floats], bool] = lambda _: True) -> list[Floats]:
    """Return the first few of some parameters that differ, by their signs or a step of the grid."""
    found = list[Floats]()
    for each in listed:
        if len(found) == settings.MAX_REFINED:
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            distances = [np.abs(np.log(each / other)).max() for other in found]
        if all(not distance < np.log(10) / settings.PER_DECADE[1] for distance in distances) and holds(each):
            found.append(each)
    return found


def _refined(profiles: Sequence[_Profile], begin: Floats, limits: Floats) -> Floats:
    """Return the parameters that leave least of the rates near some values, between limits, shape (2, parameters)."""
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


def _check_identifiable(law: Law, profiles: Sequence[_Profile], parameters: Sequence[Floats]) -> None:
    """Refuse what no trial could tell: coefficients of which only a combination matters."""
    listed = []
    for each, own in zip(profiles, parameters, strict=True):
        _, sizes, directions = np.linalg.svd(each.derivatives(own, law.order), full_matrices=False)
        if len(sizes) == len(directions) and sizes[-1] > settings.MIN_SINGULAR_VALUE:
            return
        listed.append(np.abs(directions[-1]))
    part = np.mean(listed, axis=0) > settings.ALIKE
    found = np.zeros(profiles[0].known.shape, dtype=np.bool_)
    found[np.isnan(profiles[0].known)] = part
    _refuse_combination(law, found)


def _refuse_combination(law: Law, part: Bools) -> None:
    """Refuse coefficients, shape (equations, terms), of which only a combination enters the equations."""
    if not part.any():
        return
    before = [each for each in named_parameters(law).products if part[each.equation, each.term]]
    names = ", ".join(dict.fromkeys(name for each in before for name, _ in each.coefficients))
    variables = ", ".join(law.terms.variables.measured)
    raise CommonlawError("parameters-not-identifiable", names=names, structure=law.structure, variables=variables)


def _size(left: Floats) -> float:
    """Return the root mean square."""
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean(left**2)))
