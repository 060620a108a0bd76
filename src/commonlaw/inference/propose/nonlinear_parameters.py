"""Fits of nonlinear parameters: starting values on a grid, multi-start, and shrinkage toward pooled parameters.

In ``V s/(K + s)``, say, V follows by least squares once K is given (variable projection; Golub and Pereyra 1973). So
values of K are compared by their residuals in the rates of smoothed trials. Trajectories are fitted from the best
values for all objects together, and for each alone.

A nonlinear parameter is not practically identifiable from an object in whose trials its term is linear, and diverges. A
normal prior with the between-object scatter, from the medians of all objects (empirical Bayes), bounds it.
"""

import ast
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.diagnostics import Outcome, note
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales
from commonlaw.inference import settings
from commonlaw.inference.data.smoothing import smooth_curves, values_and_rates
from commonlaw.inference.fit.annealing import fit_with
from commonlaw.inference.fit.fit import NO_MODEL_ERROR
from commonlaw.inference.fit.integral_form import Integrals, least_squares, values_between_jumps
from commonlaw.inference.fit.lack_of_fit import has_pole
from commonlaw.inference.fit.parameter_grid import (
    divisors,
    factor_powers,
    frequencies_in_time,
    grid_product,
    parameter_values,
)
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.structural_identifiability import are_confounded
from commonlaw.inference.search.setup import FitSetup, RefitOptions
from commonlaw.integration import VectorField
from commonlaw.law import Law
from commonlaw.law.parameters import named_parameters
from commonlaw.library import Order, Terms
from commonlaw.library.bounds import Bound, limits_of
from commonlaw.library.grammar import columns_in, evaluate, tree_of, with_names, write
from commonlaw.likelihood import Estimate, Prior, fit_each
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.parallel import in_parallel, threads
from commonlaw.runtime.progress import ProgressCallback, silent
from commonlaw.trials import Trials


@dataclass(frozen=True, eq=False)
class _Profile:
    """The profile likelihood of an object's nonlinear parameters: linear coefficients follow by least squares.

    Known coefficients have shape (equations, terms), NaN where they are estimated; variables along the smoothed trials
    (n, variables). The targets of each equation are rates or measurements, shape (m,); its regressors, shape (m,
    terms), follow by a linear map from terms, shape (n, terms).
    """

    terms: Terms
    known: Floats
    values: Floats
    targets: Sequence[Floats]
    regressors: Sequence[Callable[[Floats], Floats]]

    @cached_property
    def divisors(self) -> list[str]:
        return divisors(self.terms)

    @cached_property
    def inside(self) -> Bools:
        """Which coefficients are estimated nonlinear parameters, shape (equations, terms)."""
        return np.asarray(np.isnan(self.known) & ~self.terms.is_factor)

    @cached_property
    def _fixed(self) -> Floats:
        """The known coefficients, and zero where they are estimated."""
        return np.nan_to_num(self.known)

    @cached_property
    def bases(self) -> list[str]:
        """Code of the bases of powers with estimated exponents, as K and x of ``K^n + x^n``."""
        return [write(power.left) for power in _estimated_powers(self.terms)]

    def deviance(self, parameters: Floats) -> float:
        """Return minus twice the profile log-likelihood, sum of 2 m log(RMS); infinite if a term is, or has a pole.

        So it is where the base of an estimated exponent is negative, as such a power is real at whole exponents alone.
        """
        _, residuals = self.fitted(parameters)
        if not all(np.isfinite(residual).all() for residual in residuals) or self.has_pole(parameters):
            return np.inf
        columns = self._columns(parameters)
        if any(np.min(evaluate(code, columns)) < 0 for code in self.bases):
            return np.inf
        floors = [np.finfo(float).eps * np.std(target) + np.finfo(float).tiny for target in self.targets]
        pairs = zip(residuals, floors, strict=True)
        return float(sum(2 * len(errors) * np.log(max(_rms(errors), floor)) for errors, floor in pairs))

    def has_pole(self, parameters: Floats) -> bool:
        """Return whether a denominator changes its sign along the trials."""
        columns = self._columns(parameters)
        with np.errstate(all="ignore"):
            return any(np.ptp(np.sign(evaluate(code, columns))) for code in self.divisors)

    def _columns(self, parameters: Floats) -> Floats:
        """Return the variables and parameters along the trials, shape (variables, n)."""
        coefficients = self._fixed.copy()
        coefficients[self.inside] = parameters
        return self.terms.at(self.values, coefficients).T

    def by_factors(self) -> Floats:
        """Return parameters p that are factors of terms, from log c = sum of powers times log p by least squares.

        They are NaN unless all parameters are factors of terms.
        """
        coefficients, factors = self._fixed.copy(), self.terms.is_factor
        coefficients[self.inside] = 1.0
        library = self.terms.evaluate(self.terms.at(self.values, coefficients))
        columns = [self.terms.parameters.index(k) for k in np.argwhere(self.inside)[:, 1]]
        powers, rows, logarithms = factor_powers(self.terms)[:, columns], list[Floats](), list[float]()
        if not (np.isfinite(powers[factors]).all() and np.isfinite(library).all()):
            return np.full(len(columns), np.nan)
        for j, (target, regressors) in enumerate(zip(self.targets, self.regressors, strict=True)):
            free, given = np.isnan(self.known[j]) & factors, (coefficients[j] != 0) & factors
            bound = np.flatnonzero(given & powers.any(axis=1))
            given[bound] = False
            parts = [
                library[:, given] @ coefficients[j, given],
                library[:, bound] * coefficients[j, bound],
                library[:, free],
            ]
            sides = regressors(np.column_stack(parts))
            numbers = least_squares(sides[:, 1:], target - sides[:, 0])[0][: len(bound)]
            weights = np.abs(numbers) * np.linalg.norm(sides[:, 1 : len(bound) + 1], axis=0)
            rows += list(powers[bound] * weights[:, np.newaxis])
            logarithms += (weights * np.log(np.abs(numbers) + np.finfo(float).tiny)).tolist()
        exponents = np.reshape(rows, (-1, len(columns)))  # No rows where no term has a coefficient
        scale = np.max(np.abs(exponents), initial=0.0) or 1.0
        return np.asarray(np.exp(np.linalg.lstsq(exponents / scale, np.array(logarithms) / scale)[0]))

    def derivatives(self, parameters: Floats, order: Order) -> Floats:
        """Return the derivatives of rates by all estimated coefficients, of unit norm, shape (m, parameters)."""
        plain = replace(self.terms, variables=replace(self.terms.variables, logarithmic=()))
        field = VectorField(plain, self.fitted(parameters)[0], order, free=np.isnan(self.known))
        with np.errstate(invalid="ignore"):  # Infinite derivatives, and these over their norm, which the caller refuses
            linear = field.linearize(self.values).by_parameters
            columns = linear.reshape(-1, linear.shape[2])
            return np.asarray(columns / column_scales(columns))

    def fitted(self, parameters: Floats) -> tuple[Floats, list[Floats]]:
        """Return all coefficients, shape (equations, terms), linear ones by least squares, and residuals by equation.

        Residuals are infinite if a term is not finite.
        """
        result = self._fixed.copy()
        result[self.inside] = parameters
        library = self.terms.evaluate(self.terms.at(self.values, result))
        if not np.isfinite(library).all():
            return result, [np.full_like(target, np.inf) for target in self.targets]
        residuals, factors = list[Floats](), self.terms.is_factor
        for j, (target, regressors) in enumerate(zip(self.targets, self.regressors, strict=True)):
            free = np.isnan(self.known[j]) & factors
            columns = regressors(np.column_stack([library[:, factors] @ result[j, factors], library[:, free]]))
            result[j, free], of_equation = least_squares(columns[:, 1:], target - columns[:, 0])
            residuals.append(of_equation)
        return result, residuals


def with_initial_parameters(
    law: Law,
    trials: Trials,
    options: RefitOptions,
    bounds: Sequence[Bound] = (),
    guesses: Mapping[str, float] | None = None,
    progress: ProgressCallback = silent,
) -> Law:
    """Return a law with starting values of its nonlinear parameters, within bounds of named coefficients, for `refine`.

    Before, its parameters have arbitrary values. Guesses, by name, take the place of the grid.

    Raises `CommonlawError` if no values make all terms finite, coefficients are not identifiable, or no fit succeeds.
    """
    if not law.terms.variables.parameters:
        return law
    setup = FitSetup.of(law, trials, options)
    setup.check_determined()
    if law.terms.is_factor[np.isnan(setup.known[0]).any(axis=0)].all():
        return law
    if trials.schema.initial_values:  # There `initial_latent_estimates` tries values
        unknown = np.full(len(law.terms.variables.measured), np.nan)
        _refuse_combination(law, are_confounded(law.terms, setup.known[0], unknown))
        return law
    progress("looking for nonlinear parameters")
    with threads(options.n_jobs):
        rates = _rate_profiles(setup)
        for name, rate in zip(law.objects, rates, strict=True):
            _check_powers(name, rate)
        grid = _Grid.of(setup.law, rates, bounds, guesses or {})
        deviances = np.array(in_parallel(lambda rate: [rate.deviance(value) for value in grid.values], rates))
        if not len(grid.values) or not np.isfinite(deviances).any(axis=1).all():
            raise CommonlawError("terms-nowhere-finite", parameters=grid.names)
        least = grid.values[deviances.argmin(axis=1)]
        coefficients = [rate.fitted(parameters)[0] for rate, parameters in zip(rates, least, strict=True)]
        problem = replace(setup, law=replace(setup.law, coefficients=np.array(coefficients))).problem()
        integral = list[_Profile]()  # Along smoothed states, which is more accurate than rates
        for o, (model, known, start) in enumerate(zip(problem.models, problem.known, problem.starts, strict=True)):
            values = values_between_jumps(problem, o, start)
            matched = [Integrals.and_target(problem, o, j, values) for j in range(len(known))]
            targets = [target for _, target in matched]
            integral.append(_Profile(model.terms, known, values, targets, [integrals.of for integrals, _ in matched]))
        starts = grid.starts(integral, deviances)
        apart = starts[0 if len(rates) == 1 else -1]
        _check_identifiable(setup.law, rates, [coefficients[rates[0].inside] for coefficients in apart])
        fits: list[list[Estimate]] = [[] for _ in problem.models]
        for initial in starts:
            for o, estimate in enumerate(multistart(problem, [initial], full_schedule)):
                fits[o] += [] if has_pole(problem, o, estimate) else [estimate]
        if not all(fits):
            raise CommonlawError("parameters-not-found", structure=law.structure, names=", ".join(grid.names))
        estimates = shrink_to_pooled(problem, [best_estimate(fit) for fit in fits], starts)[1]
        inside = rates[0].inside
        _check_identifiable(setup.law, rates, [estimate.coefficients[inside] for estimate in estimates])
        return replace(law, coefficients=np.array([estimate.coefficients for estimate in estimates]))


def outcomes_of_parameters(law: Law) -> tuple[Outcome, ...]:
    """Return notes on coefficients of which only a combination is identifiable.

    This is the case of V s/(K + s), where s is always small compared with K: only V/K is.
    """
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    first, inseparable = len(law.terms.variables.measured), dict[str, list[str]]()
    terms = [law.terms.terms[definition.term] for definition in parameters.definitions]
    is_nonlinear = np.array([any(column >= first for column in term.columns()) for term in terms], dtype=bool)
    for name, estimates, known in zip(law.objects, values, errors, strict=True):
        unsure = np.flatnonzero(is_nonlinear & (settings.SIGNIFICANT * known > np.abs(estimates)))
        lost = [parameters.names[i] for i in unsure]
        if len(lost) > 1 and {*lost} & {*law.terms.variables.parameters}:
            inseparable.setdefault(" and ".join(lost), []).append(name)
    return tuple(
        note("parameters-not-separable", ", ".join(objects), parameters=names, limit=settings.SIGNIFICANT)
        for names, objects in inseparable.items()
    )


def _rate_profiles(setup: FitSetup) -> list[_Profile]:
    """Return each object's profile in rates of smoothed trials in which all states were measured."""
    law, result = setup.law, list[_Profile]()
    for name, known in zip(law.objects, setup.known, strict=True):
        curves = [(trial, smooth_curves(trial, law.order)) for trial in setup.trials.of_object(name)]
        complete = [pair for pair in curves if np.isfinite(pair[1][0]).all()]
        if not complete:
            raise CommonlawError("parameters-without-trials", where=name)
        along = [values_and_rates(law.terms.variables, *pair) for pair in complete]
        values, rates = (np.concatenate(arrays) for arrays in zip(*along, strict=True))
        few = evenly_spaced(len(values), settings.MAX_CURVE_POINTS)
        result.append(
            _Profile(law.terms, known, values[few], list(rates[few].T), [lambda terms: terms] * rates.shape[1])
        )
    return result


def _check_powers(name: str, profile: _Profile) -> None:
    """Refuse a power of a negative number with an estimated exponent: it is real at whole exponents alone."""
    terms = profile.terms
    for power in _estimated_powers(terms):
        if max(columns_in(power.left), default=0) >= len(terms.variables.measured):
            continue
        with np.errstate(all="ignore"):
            least = float(np.min(evaluate(power.left, profile.values.T)))
        if least < 0:
            lower, upper = (with_names(write(side), terms.variables.names) for side in (power.left, power.right))
            upper = upper if upper.isidentifier() else f"({upper})"
            raise CommonlawError("power-of-negative", name, base=lower, exponent=upper, value=least)


def _estimated_powers(terms: Terms) -> Iterator[ast.BinOp]:
    """Yield the powers in terms whose exponents have parameters."""
    first = len(terms.variables.measured)
    for factor in (factor for term in terms.terms for factor, _ in term.powers):
        nodes = (node for node in ast.walk(tree_of(factor)) if isinstance(node, ast.BinOp))
        powers = (node for node in nodes if isinstance(node.op, ast.Pow))
        yield from (power for power in powers if max(columns_in(power.right), default=0) >= first)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Values of each estimated parameter within its bounds, and combinations of them, shape (values, parameters)."""

    law: Law
    names: Sequence[str]
    bounds: Sequence[Bound]
    banks: Sequence[Floats]
    values: Floats

    @classmethod
    def of(
        cls, law: Law, profiles: Sequence[_Profile], bounds: Sequence[Bound], guesses: Mapping[str, float]
    ) -> "_Grid":
        """Return guesses, or a grid of likely values, with evenly spaced ones within narrow bounds."""
        first, inside = profiles[0].values.shape[1], np.argwhere(profiles[0].inside)[:, 1]
        columns = [first + law.terms.parameters.index(k) for k in inside]
        names = [law.terms.variables.names[column] for column in columns]
        tried = parameter_values(law.terms, np.concatenate([profile.values for profile in profiles]), columns)
        banks = list[Floats]()
        for name, bank in zip(names, tried, strict=True):
            low, high = limits_of(name, bounds)
            within = bank[(bank > low) & (bank < high)]
            if len(within) < settings.PER_CYCLE and np.isfinite(high - low):
                within = np.concatenate([within, np.linspace(low, high, settings.PER_CYCLE + 2)[1:-1]])
            banks.append(np.array([guesses[name]]) if name in guesses else within)
        values = grid_product(banks)
        if not guesses:
            by_object = np.array([profile.by_factors() for profile in profiles])
            more = np.vstack([np.exp(np.log(by_object).mean(axis=0)), by_object])
            values = np.vstack([more[np.isfinite(more).all(axis=1)], values])
        return cls(law, names, bounds, banks, values)

    def starts(self, profiles: Sequence[_Profile], deviances: Floats) -> list[Floats]:
        """Return starting values, each of shape (objects, equations, terms), from the deviances of all combinations.

        First come distinct parameters that are best for all objects together, then those that are best for each.
        """
        swept, swept_alone = list[Floats](), [list[Floats]() for _ in profiles]
        if np.prod([len(bank) for bank in self.banks], dtype=float) > settings.MAX_COMBINATIONS:
            best = self.values[np.argsort(deviances.sum(axis=0), kind="stable")[: settings.MAX_KEPT]]
            swept = [self._swept(profiles, parameters) for parameters in best]
            swept_alone = in_parallel(lambda profile: [self._swept([profile], start) for start in swept[:1]], profiles)
        together = self._best(profiles, deviances.sum(axis=0), swept)[: settings.MAX_KEPT]
        if len(profiles) == 1 and not swept and together:  # The first is the best of the only object too
            return [np.array([profiles[0].fitted(parameters)[0]]) for parameters in together]
        alone = in_parallel(
            lambda profile, deviance, more: self._best([profile], deviance, [*swept, *more])[:1],
            profiles,
            deviances,
            swept_alone,
        )
        if not all(alone):
            raise CommonlawError("terms-nowhere-finite", parameters=self.names)
        starts = [*([parameters] * len(profiles) for parameters in together), [parameters for (parameters,) in alone]]
        return [
            np.array([profile.fitted(row)[0] for profile, row in zip(profiles, start, strict=True)]) for start in starts
        ]

    def _swept(self, profiles: Sequence[_Profile], begin: Floats) -> Floats:
        """Return the parameters of least deviance in a cyclic coordinate search over the grid.

        For several frequencies this is the repeated periodogram of the residuals (RELAX; Li and Stoica 1996). It is
        used if there are too many combinations.
        """

        def deviance(parameters: Floats) -> float:
            return sum(profile.deviance(parameters) for profile in profiles)

        now, value = begin, deviance(begin)
        for _ in range(settings.MAX_SWEEPS):
            before = value
            for i, bank in enumerate(self.banks):
                tried = np.tile(now, (len(bank), 1))
                tried[:, i] = bank
                values = [deviance(row) for row in tried]
                best = int(np.argmin(values))
                if values[best] < value:
                    now, value = tried[best], values[best]
            if not value < before - settings.SAME_DEVIANCE:
                break
        return now

    def _best(self, profiles: Sequence[_Profile], deviances: Floats, swept: Sequence[Floats]) -> list[Floats]:
        """Return the parameters of least deviance for some objects, refined from distinct values of the grid.

        Among those of equal deviance, such as equivalent parametrizations of a saturation, parameters with more
        positive named coefficients come first, then smaller ones.
        """
        definitions = {definition.name: definition for definition in named_parameters(self.law).definitions}

        def holds(parameters: Floats) -> bool:
            coefficients = [profile.fitted(parameters)[0] for profile in profiles] if self.bounds else []
            pairs = product(self.bounds, coefficients)
            return all(bound.holds(definitions[bound.name].of(coefficient)) for bound, coefficient in pairs)

        def preference(parameters: Floats) -> tuple[int, float]:
            fitted = [profile.fitted(parameters)[0] for profile in profiles]
            named = [definition.of(coefficients) for coefficients in fitted for definition in definitions.values()]
            return int(np.sum(np.array(named) < 0)), float(np.sum(np.abs(parameters)))

        listed = [self.values[i] for i in np.argsort(deviances, kind="stable") if np.isfinite(deviances[i])]
        low, high = np.array([limits_of(name, self.bounds) for name in self.names]).reshape(-1, 2).T
        in_time = [self.law.terms.variables.names[column] for column in frequencies_in_time(self.law.terms)]
        for i, bank in enumerate(self.banks):
            if self.names[i] in in_time and len(bank) > 1:  # Beyond the largest one are aliases of those on the grid
                low[i], high[i] = max(low[i], -bank.max()), min(high[i], bank.max())
        begun, wanted = list[Floats](), holds
        # Linear coefficients may end at their bounds: if those of no value are within, the fit starts outside
        for wanted in (holds, lambda start: bool(np.all((low <= start) & (start <= high)))):
            first = islice(filter(wanted, listed), settings.MAX_REFINED)
            begun = [*filter(wanted, swept), *first, *_distinct(listed, wanted)]
            if begun:
                break
        ends = [*begun, *filter(wanted, (_refined(profiles, start, np.stack([low, high])) for start in begun))]
        values = [sum(profile.deviance(end) for profile in profiles) for end in ends]
        ordered = [ends[k] for k in np.argsort(values, kind="stable")]
        same = [k for k, value in enumerate(values) if value <= min(values) + settings.SAME_DEVIANCE]
        return _distinct([*sorted((ends[k] for k in same), key=preference), *ordered])


def _distinct(listed: Sequence[Floats], holds: Callable[[Floats], bool] = lambda _: True) -> list[Floats]:
    """Return the first few distinct parameters, which differ in a sign or by a step of the grid."""
    result = list[Floats]()
    for parameters in listed:
        if len(result) == settings.MAX_REFINED:
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            distances = [np.abs(np.log(parameters / kept)).max() for kept in result]
        if all(not distance < np.log(10) / settings.PER_DECADE[1] for distance in distances) and holds(parameters):
            result.append(parameters)
    return result


def _refined(profiles: Sequence[_Profile], begin: Floats, limits: Floats) -> Floats:
    """Return a local optimum of the parameters between limits, shape (2, parameters), by nonlinear least squares."""
    from scipy.optimize import least_squares

    tiny = np.finfo(float).tiny
    units = [[max(_rms(errors), tiny) for errors in profile.fitted(begin)[1]] for profile in profiles]

    def residuals(relative: Floats) -> Floats:
        listed = [profile.fitted(begin * relative)[1] for profile in profiles]
        pairs = [
            pair for of_object, sizes in zip(listed, units, strict=True) for pair in zip(of_object, sizes, strict=True)
        ]
        whole = np.concatenate([errors / size for errors, size in pairs])
        return np.where(np.isfinite(whole), whole, 1 / settings.ROUNDING)

    low, high = np.sort(limits / begin, axis=0)
    bounds, most = (low, high), settings.MAX_ITERATIONS
    with np.errstate(over="ignore", invalid="ignore"):  # Squares of large residuals
        relative = least_squares(residuals, np.ones_like(begin), bounds=bounds, max_nfev=most).x
    return np.asarray(begin * np.where(np.isfinite(relative), relative, 1.0))


def _check_identifiable(law: Law, profiles: Sequence[_Profile], parameters: Sequence[Floats]) -> None:
    """Refuse coefficients that no object determines at these parameters: in combination only, or by its trials."""
    listed = []
    for profile, parameter in zip(profiles, parameters, strict=True):
        derivatives = profile.derivatives(parameter, law.order)
        if not np.isfinite(derivatives).all():
            raise CommonlawError("terms-nowhere-finite", parameters=law.terms.variables.parameters)
        _, sizes, directions = np.linalg.svd(derivatives, full_matrices=False)
        if len(sizes) == len(directions) and sizes[-1] > settings.MIN_SINGULAR_VALUE:
            return
        listed.append(np.abs(directions[-1]))
    part, known = np.mean(listed, axis=0) > settings.MAX_RELATIVE_DIFFERENCE, profiles[0].known
    confounded = are_confounded(law.terms, known, np.full(len(law.terms.variables.measured), np.nan))
    _refuse_combination(law, confounded)
    unidentified = np.zeros(known.shape, dtype=np.bool_)
    unidentified[np.isnan(known)] = part
    raise CommonlawError("parameters-not-identified", names=_names_of(law, unidentified))


def _refuse_combination(law: Law, part: Bools) -> None:
    """Refuse coefficients, shape (equations, terms), of which only a combination is identifiable."""
    if part.any():
        variables = ", ".join(law.terms.variables.measured)
        names = ", ".join(_names_of(law, part))
        raise CommonlawError("parameters-not-identifiable", names=names, structure=law.structure, variables=variables)


def _names_of(law: Law, part: Bools) -> list[str]:
    """Return the names of coefficients, shape (equations, terms)."""
    before = [product for product in named_parameters(law).products if part[product.equation, product.term]]
    return [*dict.fromkeys(name for combined in before for name, _ in combined.coefficients)]


def _rms(residuals: Floats) -> float:
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean(residuals**2)))


def full_schedule(problem: SearchProblem) -> Sequence[Estimate]:
    """Return the estimates without model error by `fit_with`; none if they fail."""
    return fit_with(problem, problem.allowed, NO_MODEL_ERROR).estimates


def short_schedule(problem: SearchProblem) -> Sequence[Estimate]:
    """Return the estimates without model error by one short continuation, which may fail in single objects."""
    return fit_each(problem.models, problem.starts, problem.allowed, settings.SHORT_SCHEDULE)


def multistart(
    problem: SearchProblem, initial: Sequence[Floats], fitting: Callable[[SearchProblem], Sequence[Estimate]]
) -> list[Estimate]:
    """Return the best fit of each object from several initial coefficients; none if no fit succeeds.

    Initial states are those of the problem, new latent processes are zero. Initial coefficients have shape (objects,
    equations, terms); `fitting` is `full_schedule` or `short_schedule`.
    """
    fits = list[Sequence[Estimate]]()
    for coefficients in initial:
        pairs = zip(problem.starts, coefficients, strict=True)
        starts = problem.padded([Estimate(start.states, theta) for start, theta in pairs])
        fits.append(fitting(replace(problem, starts=starts)))
    return [best_estimate(candidates) for candidates in zip(*filter(None, fits), strict=True)]


def best_estimate(fits: Sequence[Estimate]) -> Estimate:
    """Return the fit of largest likelihood; of equal ones that with the fewest negative, then smallest coefficients.

    This makes ``A cos(w*t + p) = -A cos(w*t + p + pi)`` unique.
    """
    least = min(fit.objective for fit in fits)
    equal = [fit for fit in fits if fit.objective <= least + settings.SAME_DEVIANCE]
    return min(equal, key=lambda fit: (int(np.sum(fit.coefficients < 0)), float(np.abs(fit.coefficients).sum())))


def shrink_to_pooled(
    problem: SearchProblem, separate: Sequence[Estimate], initial: Sequence[Floats] = ()
) -> tuple[SearchProblem, list[Estimate]]:
    """Return the problem with priors, and estimates, of objects that shrinkage toward pooled parameters fits as well.

    Priors are normal about medians over objects, with `PRIOR_WIDTH` times their median absolute deviations, of the
    unpooled estimates or of initial coefficients, each of shape (objects, equations, terms), whichever has the larger
    joint likelihood. Objects whose deviance increases by `INDIFFERENT` or more stay unpooled.
    """
    best = list(separate)
    if len(separate) < settings.MIN_OBJECTS or not problem.models[0].terms.parameters:
        return problem, best
    unpooled = np.array([estimate.coefficients for estimate in separate])
    ranked = list[tuple[float, Prior, list[Estimate]]]()
    (width, least), allowed = settings.PRIOR_WIDTH, problem.allowed
    for coefficients in (unpooled, *initial):
        median = np.median(coefficients, axis=0)
        sigma = 1.4826 * np.median(np.abs(coefficients - median), axis=0)
        sigma = np.maximum(sigma, least * np.abs(median))
        precision = np.divide(1.0, width * sigma, out=np.zeros_like(sigma), where=allowed & (sigma > 0)) ** 2
        prior = Prior(median, precision)
        both = [unpooled, np.broadcast_to(median, unpooled.shape)]
        shrinking = replace(problem.with_priors([prior] * len(separate)), starts=tuple(separate))
        shrunken = multistart(shrinking, both, short_schedule)
        if shrunken:  # Minus twice the joint log-likelihood of measurements and coefficients
            normal = float(np.sum(np.log(precision[precision > 0])))
            objective = sum(estimate.objective for estimate in shrunken) - len(shrunken) * normal
            ranked.append((objective, prior, shrunken))
    if not ranked:
        return problem, best
    _, prior, shrunken = min(ranked, key=lambda entry: entry[0])
    priors = list[Prior | None]([None] * len(separate))
    for o, (pooled, free) in enumerate(zip(shrunken, separate, strict=True)):
        if pooled.deviance < free.deviance + settings.INDIFFERENT:
            priors[o], best[o] = prior, pooled
    return problem.with_priors(priors), best


def empirical_priors(problem: SearchProblem, initial: Floats) -> tuple[Prior | None, ...]:
    """Return the empirical prior of each object's coefficients, from fits that start at initial ones.

    None for laws without nonlinear parameters, fewer than `MIN_OBJECTS` objects, or failed fits. Coefficients have
    shape (objects, equations, terms).
    """
    nothing = (None,) * len(initial)
    if len(initial) < settings.MIN_OBJECTS or not problem.models[0].terms.parameters:
        return nothing
    separate = multistart(problem, [initial], full_schedule)
    return tuple(m.prior for m in shrink_to_pooled(problem, separate, [initial])[0].models) if separate else nothing
