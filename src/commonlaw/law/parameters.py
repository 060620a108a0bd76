"""The parameters and coefficients of a law as arrays, with errors, intervals and units; and its right-hand side."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import compress
from operator import mul
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import symmetric_root
from commonlaw.hierarchy.relation import units_of_coefficients
from commonlaw.integration import VectorField
from commonlaw.law import text
from commonlaw.law.law import Law, given_equations, object_index, shares_terms
from commonlaw.law.parse import Coefficient, Part, Product, read_equations
from commonlaw.law.quantiles import mixture_interval, propagated, two_sided
from commonlaw.law.restrictions import ALL, OBJECT, Restrictions
from commonlaw.law.text import free_parameter_names
from commonlaw.law.uncertainty import AtBound, OneSidedLimit, PlausibleLaw, Uncertainty
from commonlaw.library import with_rates
from commonlaw.library.bounds import bounds_in, limits_of
from commonlaw.runtime.arguments import numbers_of
from commonlaw.runtime.forking import cached_property

if TYPE_CHECKING:
    import pint


@dataclass(frozen=True, eq=False)
class Parameters:
    """What the names in `Law.structure` stand for.

    Definitions are products of powers of coefficients of terms; products are what stands before each term, by name.
    """

    law: Law
    definitions: tuple[Coefficient, ...]
    products: tuple[Product, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names, in the order of `Law.structure`."""
        return tuple(definition.name for definition in self.definitions)

    @property
    def places(self) -> tuple[list[int], list[int]]:
        """The equation and the term in which each parameter stands first."""
        return [definition.equation for definition in self.definitions], [
            definition.term for definition in self.definitions
        ]

    @cached_property
    def values(self) -> Floats:
        """Estimates, shape (objects, parameters)."""
        values = self.of(self.law.coefficients)
        values.flags.writeable = False
        return values

    def of(self, coefficients: Floats) -> Floats:
        """Return what they are by coefficients, from shape (..., equations, terms) to (..., parameters)."""
        columns = [definition.of(coefficients) for definition in self.definitions]
        return np.stack(columns, axis=-1) if columns else np.zeros((*coefficients.shape[:-2], 0))

    @cached_property
    def errors(self) -> Floats:
        """Standard errors to first order, shape (objects, parameters); NaN where unknown.

        They are given the parameters that have only a limit; of these themselves they are those of a parabola. What
        remains by rounding, of quotients that are at a bound, is zero.
        """
        known, slopes = self.law.uncertainty.covariance, self.slopes(self.law.coefficients)
        with np.errstate(invalid="ignore"):
            variances = np.diagonal(self.covariance, axis1=1, axis2=2)
            if self.limits and known is not None:
                variances = np.where(self.limited, np.einsum("opi,oij,opj->op", slopes, known, slopes), variances)
            if known is not None:
                parts = np.einsum("opi,oii->op", slopes**2, known)
                variances = np.where(variances < 8 * np.finfo(float).eps * parts, 0.0, variances)
            errors = np.sqrt(variances)
        errors.flags.writeable = False
        return errors

    @property
    def tabulated_errors(self) -> Floats:
        """Standard errors, NaN also for parameters that have only a limit, or are at a bound."""
        errors = np.where(self.limited, np.nan, self.errors)
        for place in self.at_bounds:
            errors[place] = np.nan
        return errors

    @cached_property
    def limits(self) -> dict[tuple[int, int], OneSidedLimit]:
        """The only limits of parameters, by the indices of object and parameter; see `Uncertainty.limits`."""
        indices = {name: i for i, name in enumerate(self.names)}
        return {
            (object_index(self.law, limit.object), indices[limit.parameter]): limit
            for limit in self.law.uncertainty.limits
            if limit.parameter in indices
        }

    @cached_property
    def at_bounds(self) -> dict[tuple[int, int], AtBound]:
        """The parameters at bounds, by the indices of object and parameter; see `Uncertainty.at_bounds`."""
        indices = {name: i for i, name in enumerate(self.names)}
        return {
            (object_index(self.law, estimate.object), indices[estimate.parameter]): estimate
            for estimate in self.law.uncertainty.at_bounds
            if estimate.parameter in indices
        }

    @cached_property
    def limited(self) -> Bools:
        """Which parameters have only a limit on one side, shape (objects, parameters)."""
        result = np.zeros(self.values.shape, dtype=np.bool_)
        for place in self.limits:
            result[place] = True
        return result

    @cached_property
    def held(self) -> Bools:
        """Those of them whose likelihood is flat without end, given which others have errors; the same shape.

        Between a limit and a bound the likelihood is integrated instead, see `commonlaw.estimation.one_sided`.
        """
        bounds, result = bounds_in(restrictions_of(self.law).bounds), self.limited.copy()
        for (o, p), limit in self.limits.items():
            result[o, p] = not np.isfinite(limits_of(self.names[p], bounds)[1 if limit.is_lower else 0])
        return result

    def beyond_limits(self, name: str) -> Iterator[tuple[Floats, Floats]]:
        """Yield coefficients of an object, (equations, terms), with a parameter at its only limit and far beyond."""
        o = object_index(self.law, name)
        for limit in (limit for (owner, _), limit in self.limits.items() if owner == o):
            ends = list[Floats]()
            for value in (limit.value, limit.beyond):
                known = dict(zip(self.names, self.values[o], strict=True)) | {limit.parameter: np.float64(value)}
                coefficients = self.law.coefficients[o].copy()
                for product in self.products:
                    if any(factor == limit.parameter for factor, _ in product.coefficients):
                        coefficients[product.equation, product.term] = product.value(known)
                ends.append(coefficients)
            yield ends[0], ends[1]

    def texts(self, o: int) -> list[str]:
        """Return the estimates of an object with their standard errors, or their only limits, as text."""
        pairs = zip(self.values[o].tolist(), np.nan_to_num(self.errors[o]).tolist(), strict=True)
        return [
            self.limits[o, p].text if (o, p) in self.limits else text.with_error(*pair) for p, pair in enumerate(pairs)
        ]

    @cached_property
    def covariance(self) -> Floats:
        """Covariance to first order, shape (objects, parameters, parameters); NaN where unknown.

        It is given the parameters that have only a limit, whose rows and columns are zero.
        """
        if (known := self.covariance_given_limits) is None:
            return np.full((*self.values.shape, self.values.shape[1]), np.nan)
        slopes = self.slopes(self.law.coefficients)
        covariance = np.asarray(slopes @ known @ slopes.transpose(0, 2, 1))
        covariance[self.limited] = 0.0
        covariance.transpose(0, 2, 1)[self.limited] = 0.0
        return covariance

    def joint_covariance(self, places: Sequence[tuple[int, int]]) -> Floats:
        """Return the covariance of parameters by the indices of object and parameter, shape (k, k).

        Objects depend on each other by the shared factor of the law.
        """
        objects, parameters = np.array(places).T
        within = self.covariance[objects[:, np.newaxis], parameters[:, np.newaxis], parameters]
        between, factor = np.zeros_like(within), self.law.uncertainty.shared_factor
        if factor is not None:
            rows = (self.slopes(self.law.coefficients) @ factor)[objects, parameters]
            between = rows @ rows.T
        return np.asarray(np.where(objects[:, np.newaxis] == objects, within, between))

    @cached_property
    def covariance_given_limits(self) -> Floats | None:
        """Covariance of coefficients in the support given the parameters that are `held`, shape (objects, p, p).

        Forecasts, draws and errors have it: ``P C P^T``, see `given_limits`. A root of C keeps variances from becoming
        negative where a parameter with a limit has a much larger one.
        """
        covariance = self.law.uncertainty.covariance
        if covariance is None or not self.held.any():
            return covariance
        root = self.given_limits @ symmetric_root(covariance)
        return np.asarray(root @ root.transpose(0, 2, 1))

    @cached_property
    def given_limits(self) -> Floats:
        """What deviations of coefficients in the support become given the parameters that are `held`.

        Of each object with the slopes G of these parameters it is ``P = I - C G^T inv(G C G^T) G``, by which
        ``P C P^T = C - C G^T inv(G C G^T) G C``; shape (objects, coefficients, coefficients).
        """
        covariance, unchanged = self.law.uncertainty.known_covariance(), np.eye(int(self.law.support.sum()))
        slopes = np.where(self.held[:, :, np.newaxis], self.slopes(self.law.coefficients), 0.0)
        joint = covariance @ slopes.transpose(0, 2, 1)
        return np.asarray(unchanged - joint @ np.linalg.pinv(np.nan_to_num(slopes @ joint)) @ slopes)

    @cached_property
    def degrees_of_freedom(self) -> Floats:
        """Degrees of freedom of their intervals, shape (objects, parameters); infinite where noise is known.

        They are those of the noise in the equation in which a parameter stands first. Normal priors of standard
        deviations s leave a share ``r_i = 1 - sum_p C_ip^2/(s_p^2 C_ii)`` of the variance of parameter i to
        measurements, and make them ``nu/r_i^2`` (Satterthwaite 1946, Biometrics Bull. 2, 110).
        """
        freedom = degrees_of_equations(self.law)
        if freedom is None:
            return np.full(self.values.shape, np.inf)
        degrees = np.broadcast_to(freedom[self.places[0]], self.values.shape)
        priors = restrictions_of(self.law).prior_std(self.law.observation.measured)
        if not priors:
            return degrees
        stds = np.array([priors.get(name, np.inf) for name in self.names])
        by_priors = np.sum((self.covariance / stds) ** 2, axis=2)
        variances = np.where(self.errors > 0, self.errors**2, 1.0)
        with np.errstate(divide="ignore"):
            return np.asarray(degrees / np.maximum(1 - by_priors / variances, 0.0) ** 2)

    def slopes(self, coefficients: Floats) -> Floats:
        """Return the derivatives by coefficients, shape (objects, parameters, coefficients in the support).

        NaN for a parameter that has a coefficient outside of the support.
        """
        places = {(j, k): i for i, (j, k) in enumerate(np.argwhere(self.law.support).tolist())}
        result = np.zeros((len(coefficients), len(self.definitions), len(places)))
        for i, definition in enumerate(self.definitions):
            pairs = [(part.equation, part.term) for part in definition.parts]
            if places.keys() >= {*pairs}:
                result[:, i, [places[place] for place in pairs]] = definition.gradient(coefficients)
            else:
                result[:, i] = np.nan
        return result

    @cached_property
    def units(self) -> tuple[str | None, ...]:
        """Units, as far as those of the variables determine them."""
        known, units = _units(self.law), list[str | None]()
        for definition in self.definitions:
            parts = [known.get((part.equation, part.term)) for part in definition.parts]
            powers = [unit**part.power for unit, part in zip(parts, definition.parts, strict=True) if unit is not None]
            units.append(f"{reduce(mul, powers):~P}" if len(powers) == len(definition.parts) else None)
        return tuple(units)

    def intervals(self, level: float = 0.95, averaged: bool = False) -> tuple[Floats, Floats]:
        """Return the ends of intervals given the terms, each of shape (objects, parameters); NaN where unknown.

        Those of ratios are Fieller's, see `propagated`; averaged ones are those of `coefficient_intervals`. They end at
        the bounds of parameters; of those at a bound they are one-sided, see `AtBound`. Those with a limit on one side
        only have that of 95 % up to this level, none beyond. A ratio that objects share, of coefficients that differ
        between them, has the same interval in all, that of its standard error.
        """
        j, k = self.places
        if self.law.uncertainty.other_laws and averaged and self.law.uncertainty.covariance is not None:
            low, high = (ends[:, j, k] for ends in coefficient_intervals(self.law, level, averaged))
            return self._within_limits(low, high, level)
        reach = two_sided(level, self.degrees_of_freedom)
        low, high = self.values - self.errors * reach, self.values + self.errors * reach
        support, known = self.law.support, self.covariance_given_limits
        covariances = () if known is None else known
        for i, definition in enumerate(self.definitions):

            def value(free: Floats, definition: Coefficient = definition) -> Floats:
                coefficients = np.zeros((len(free), *support.shape))
                coefficients[:, support] = free
                return definition.of(coefficients)

            for o, covariance in enumerate(covariances if self._is_ratio_of_objects(definition) else ()):
                interval = propagated(value, self.law.coefficients[o, support], covariance, float(reach[o, i]))
                low[o, i], high[o, i] = interval.low, interval.high
        return self._within_limits(low, high, level)

    def _is_ratio_of_objects(self, definition: Coefficient) -> bool:
        """Return whether a parameter is a ratio of coefficients that have one value where it has one."""
        if len(definition.parts) == 1 or len(self.law.objects) == 1:
            return len(definition.parts) > 1
        shared = restrictions_of(self.law).shared
        by, places = shared.get(definition.name, OBJECT), {(part.equation, part.term) for part in definition.parts}
        factors = {
            name
            for product in self.products
            if (product.equation, product.term) in places
            for name, _ in product.coefficients
        }
        return by == OBJECT or {shared.get(name, OBJECT) for name in factors} <= {ALL, by}

    def _within_limits(self, low: Floats, high: Floats, level: float) -> tuple[Floats, Floats]:
        known = self.law.uncertainty.degrees_of_freedom
        degrees = np.inf if known is None else float(known.min())
        for place, estimate in self.at_bounds.items():
            low[place], high[place] = estimate.interval(level, degrees)
        for place, limit in self.limits.items():
            low[place], high[place] = limit.interval if level <= 0.95 else (np.nan, np.nan)
        for bound in bounds_in(restrictions_of(self.law).bounds):
            if bound.name in self.names:
                column = self.names.index(bound.name)
                low[:, column] = np.maximum(low[:, column], bound.low)
                high[:, column] = np.minimum(high[:, column], bound.high)
        return low, high

    def draws(self, n: int, seed: int, averaged: bool) -> Floats:
        """Return draws from the posterior of the parameters, shape (n, objects, parameters), see `Law.sample`."""
        law = self.law
        laws = law.models if averaged else law.models[:1]
        chosen = np.zeros(n, dtype=np.intp)
        if len(laws) > 1:
            shares = np.cumsum([candidate.probability for candidate in laws])
            chosen = np.searchsorted(shares, np.random.default_rng([seed, n]).uniform(0.0, shares[-1], n))
        draws = np.zeros((n, *law.coefficients.shape))
        for i in np.unique(chosen).tolist():
            model, rows = laws[i].law, chosen == i
            means, given = model.coefficients[:, model.support], named_parameters(model).given_limits
            deviations = model.uncertainty.draws(means, int(rows.sum()), seed) - means
            drawn = means + np.einsum("opq,noq->nop", given, deviations)
            placed = np.zeros((len(drawn), *model.coefficients.shape))
            placed[..., model.support] = drawn
            draws[rows] = by_terms_of(law, model, placed)
        return self.of(draws)


def named_parameters(law: Law) -> Parameters:
    """Return what the names in `Law.structure` stand for.

    One for each coefficient that is no known number, or those of the equations that were given.
    """
    if (given := given_equations(law)) is not None:
        return Parameters(law, given.coefficients, given.products)
    known = np.all((standard_errors(law) == 0) & (law.coefficients == law.coefficients[:1]), axis=0)
    places = np.argwhere(law.support & ~(known & law.terms.is_factor)).tolist()
    free = iter(free_parameter_names(len(places), law.terms.variables.names))
    named = [(law.terms.parameter_name(k) or next(free), j, k) for j, k in places]
    definitions = tuple(Coefficient(name, (Part(j, k),)) for name, j, k in named)
    return Parameters(law, definitions, tuple(Product(j, k, 1.0, ((name, 1),)) for name, j, k in named))


def with_equations(law: Law, equations: Sequence[str]) -> Law:
    """Return a law of other equations, to be fitted, in which parameters of the same names begin where they are.

    Only those that were not known have an error; new ones, and those that are zero, begin at 1.
    """
    named, variables = named_parameters(law), law.terms.variables
    given = read_equations(equations, law.schema, variables)
    known = {*compress(named.names, (named.errors == 0).all(axis=0).tolist())}
    values = {name: np.ones(len(law.objects)) for product in given.products for name, _ in product.coefficients}
    for name, column in zip(named.names, named.values.T, strict=True):
        values[name] = column if name in known else np.where(column == 0, 1.0, column)
    coefficients = np.tile(given.known, (len(law.objects), 1, 1))
    is_free = np.zeros(given.known.shape, dtype=np.bool_)
    for product in given.products:
        coefficients[:, product.equation, product.term] = product.value(values)
        is_free[product.equation, product.term] = not known.issuperset(name for name, _ in product.coefficients)
    free = is_free[np.any(coefficients != 0, axis=0)]
    return replace(
        law,
        terms=given.terms,
        coefficients=coefficients,
        uncertainty=Uncertainty(np.tile(np.diag(free.astype(np.float64)), (len(law.objects), 1, 1))),
        provenance=replace(law.provenance, equations=given.texts),
    )


def restrictions_of(law: Law) -> Restrictions:
    """Return the restrictions of the parameters of a law that are on record."""
    return law.restrictions or Restrictions()


def recorded_restrictions(law: Law) -> Restrictions:
    """Return the restrictions of a law that is fitted again; refused if it was saved before these were."""
    if law.restrictions is None and law.scheme == "shooting":
        raise CommonlawError("restrictions-not-recorded")
    return restrictions_of(law)


def shared_parameters(law: Law) -> tuple[str, ...]:
    """Return the names of the parameters that all objects of a law have in common."""
    return tuple(name for name, by in restrictions_of(law).shared.items() if by == ALL)


def shared_coefficients(law: Law) -> Bools:
    """Return which coefficients are parameters that the objects of a law share, shape (equations, terms)."""
    result, names = np.zeros(law.support.shape, dtype=np.bool_), shared_parameters(law)
    for definition in named_parameters(law).definitions:
        if definition.name in names and len(definition.parts) == 1:
            result[definition.equation, definition.term] = True
    return result


def tabulated_parameters(law: Law, support: Bools | None = None) -> Parameters:
    """Return what tables have a row or a column for: the parameters of given equations, else every coefficient.

    With a support, shape (equations, terms), the coefficients in it in any case. Known numbers have no name.
    """
    named = named_parameters(law)
    if support is None and law.provenance.equations:
        return named
    names = {(definition.equation, definition.term): definition.name for definition in named.definitions}
    places = np.argwhere(law.support if support is None else support).tolist()
    definitions = tuple(Coefficient(names.get((j, k), ""), (Part(j, k),)) for j, k in places)
    return replace(named, definitions=definitions)


def degrees_of_equations(law: Law) -> Floats | None:
    """Return the degrees of freedom of the noise of each equation's state, shape (equations,); None if it was given.

    A state that was not measured itself has those of all quantities.
    """
    known, names = law.uncertainty.degrees_of_freedom, law.observation.measured.states
    if known is None:
        return None
    return np.array([known[names.index(name)] if name in names else known.sum() for name in law.schema.states])


def reach_of_equations(law: Law, level: float = 0.95) -> Floats:
    """Return how many standard errors on both sides hold this share, of the coefficients of each equation.

    Raises `CommonlawError` if the share is not between 0 and 1.
    """
    degrees = degrees_of_equations(law)
    return np.broadcast_to(two_sided(level, np.inf if degrees is None else degrees), (len(law.schema.states),))


def standard_errors(law: Law) -> Floats:
    """Return the standard errors of the coefficients, shape (objects, equations, terms).

    Zero for coefficients that are known, NaN for terms that are not in the law, and everywhere without covariance.
    """
    errors = np.full(law.coefficients.shape, np.nan)
    if law.uncertainty.covariance is not None:
        errors[:, law.support] = np.sqrt(np.diagonal(law.uncertainty.covariance, axis1=1, axis2=2))
    return errors


def coefficient_intervals(law: Law, level: float = 0.95, averaged: bool = False) -> tuple[Floats, Floats]:
    """Return the ends of the coefficients' intervals, each of shape (objects, equations, terms), see `Law.conf_int`.

    NaN for terms that an object does not have.
    """
    law.uncertainty.known_covariance()
    laws = law.models if averaged else (PlausibleLaw(1.0, law),)
    weights = np.array([model.probability for model in laws]).reshape(-1, 1, 1, 1)
    values = np.array([by_terms_of(law, model.law, model.law.coefficients) for model in laws])
    errors = np.nan_to_num([by_terms_of(law, model.law, standard_errors(model.law)) for model in laws])
    degrees = [degrees_of_equations(model.law) for model in laws]
    whole = np.array([np.full(len(law.schema.states), np.inf) if degree is None else degree for degree in degrees])
    low, high = mixture_interval(weights, values, errors, whole[:, np.newaxis, :, np.newaxis], level)
    absent = law.coefficients == 0
    return np.where(absent, np.nan, low), np.where(absent, np.nan, high)


def coefficient_units(law: Law) -> dict[tuple[str, str], str]:
    """Return the unit of each coefficient by equation and term, where the units of the variables determine it."""
    lefts, names = left_hand_sides(law), law.terms.names
    return {(lefts[j], names[k]): f"{unit:~P}" for (j, k), unit in _units(law).items()}


def _units(law: Law) -> "dict[tuple[int, int], pint.Unit]":
    return units_of_coefficients(law.terms, law.support, law.schema, law.order)


def by_terms_of(law: Law, model: Law, values: Floats) -> Floats:
    """Return values of the terms of a model, shape (..., equations, terms), for the terms of a law, by name."""
    if model.terms is law.terms:
        return values
    placed = np.zeros((*values.shape[:-1], len(law.terms)))
    for name, column in zip(model.terms.names, np.moveaxis(values, -1, 0), strict=True):
        if name in law.terms.names:
            placed[..., law.terms.names.index(name)] = column
    return placed


def left_hand_sides(law: Law) -> tuple[str, ...]:
    """Return what each equation gives: ``x'``, ``x''``, or ``x[k+1]`` in discrete time."""
    return text.left_hand_sides(law.schema.states, law.order)


def equation_label(law: Law, equation: int, term: int) -> str:
    """Return the left-hand side of the equation that a coefficient stands in: of an observation, if in no other."""
    column = law.terms.terms[term].parameter
    inside = frozenset[int]().union(*(factor.columns() for factor in law.terms.terms if factor.parameter is None))
    if column is None or column in inside:
        return left_hand_sides(law)[equation]
    return law.observation.place_of(law.terms.variables.names[column])


def rate_names(law: Law) -> tuple[str, ...]:
    """Return the names of the rates of the states of second order."""
    return law.terms.variables.states[len(law.schema.states) :]


def refuse_infinite(law: Law) -> None:
    """Refuse a law with parameters that are not finite, such as 1/c of a coefficient c of zero.

    Raises `CommonlawError`, which names them.
    """
    parameters = named_parameters(law)
    lost = np.argwhere(~np.isfinite(parameters.values)).tolist()
    if lost:
        several = len(law.objects) > 1
        names = [parameters.names[j] + f" of {law.objects[i]}" * several for i, j in lost[:8]]
        raise CommonlawError("parameters-not-identified", names=names)


def state_rates(law: Law) -> tuple[tuple[str, str], ...]:
    """Return the names of the states of second order, each with that of its rate."""
    second = (law.schema.states[j] for j in with_rates(law.order, len(law.schema.states)))
    return tuple(zip(second, rate_names(law), strict=True))


def units_with_rates(law: Law) -> dict[str, str]:
    """Return the units of the columns of a law, and of rates of which state and time have one."""
    units, time = law.schema.units, law.schema.units.get(law.schema.time)
    return {**units, **{rate: f"{units[name]}/{time}" for name, rate in state_rates(law) if time and units.get(name)}}


def vector_field(law: Law, name: str) -> VectorField:
    """Return the right-hand side of one object as forecasts follow it, ready to integrate."""
    free = law.support if shares_terms(law) else None
    return VectorField(law.terms, followed_coefficients(law, name), law.order, free=free)


def right_hand_side(law: Law, name: str, values: ArrayLike) -> Floats:
    """Return the highest derivatives of one object, see `Law.rhs`."""
    coefficients, variables = followed_coefficients(law, name), law.terms.variables
    points, names = numbers_of("values", values), variables.measured
    time = variables.index(variables.time)
    if points.ndim == 2 and points.shape[1] == len(names) - 1:
        used = np.flatnonzero(law.support.any(axis=0))
        if not any(time in law.terms.terms[k].columns() for k in used):
            points = np.insert(points, time, 0.0, axis=1)
    if points.ndim != 2 or points.shape[1] != len(names):
        raise CommonlawError("variables-shape", shape=points.shape, names=names)
    return np.asarray(law.terms.evaluate(law.terms.at(points, coefficients)) @ coefficients.T)


def followed_coefficients(law: Law, name: str) -> Floats:
    """Return the coefficients that forecasts of an object follow: pooled ones if the law has them."""
    pooled, index = law.uncertainty.pooled, object_index(law, name)
    coefficients: Floats = law.coefficients[index].copy()
    if pooled is not None:
        coefficients[law.support] = pooled.coefficients[index]
    return coefficients
