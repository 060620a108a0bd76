"""Upper limits of the coefficients of terms that are not in a law."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.search.setup import RefitOptions
from commonlaw.inference.verbs.schemes import fit_of
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.law.law import shares_terms
from commonlaw.law.parameters import (
    degrees_of_equations,
    left_hand_sides,
    named_parameters,
    reach_of_equations,
    restrictions_of,
)
from commonlaw.law.printing import exact_equations
from commonlaw.law.quantiles import two_sided, upper_bound
from commonlaw.law.text import free_parameter_names
from commonlaw.library import Term, parse_term, parse_terms
from commonlaw.library.notation import quoted
from commonlaw.runtime.arguments import checks_types
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.runtime.progress import ProgressCallback, Stage, on_terminal, silent
from commonlaw.trials import Trials
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Bound:
    """The estimate and upper limit of an object's coefficient of a term that is not in the law.

    Parameters
    ----------
    equation, term, object
        The equation, term and object of the coefficient.
    coefficient, error
        Estimate together with the terms of the law, and its standard error.
    low, high
        Ends of its confidence interval.
    at_most
        Upper limit of its absolute value, with the probability of the interval under a flat prior.
    effect
        Largest contribution to the equation along the trajectories at that limit.
    unit
        Of the coefficient; empty if it does not follow from the units of the variables.
    """

    equation: str
    term: str
    object: str
    coefficient: float
    error: float
    low: float
    high: float
    at_most: float
    effect: float
    unit: str

    @property
    def seen(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0 or self.high < 0


@dataclass(frozen=True)
class Bounds(ShownInNotebooks):
    """Upper limits of the coefficients of absent terms; prints as sentences.

    Each term is fitted together with those of the law, with free initial values and its error model, as in
    `commonlaw.refine`. The limit is that of the absolute value with the probability `level` under a flat prior; the
    contribution is the largest one to the equation along the trajectories at that limit.

    Parameters
    ----------
    bounds
        One for each equation, term and object.
    level
        Of limits and intervals.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> print(cl.bounds(cl.fit("x'' = -g - c v", drops), drops, ["v^2"]))
    v^2 in x'': |coefficient| < 0.021 1/m, contribution < 15 (95 %; largest: Ball 5).
    """

    bounds: tuple[Bound, ...]
    level: float

    def to_frame(self) -> "pd.DataFrame":
        """Return a table with a row for each equation, term and object."""
        import pandas as pd

        names = {"error": "standard error", "at_most": "limit", "effect": "contribution"}
        rows = [vars(bound) | {"seen": bound.seen} for bound in self.bounds]
        return pd.DataFrame([{names.get(name, name): value for name, value in row.items()} for row in rows])

    @property
    def sentences(self) -> tuple[str, ...]:
        """The limits of each term in words."""
        result = list[str]()
        for equation, term in dict.fromkeys((bound.equation, bound.term) for bound in self.bounds):
            objects = [bound for bound in self.bounds if (bound.equation, bound.term) == (equation, term)]
            largest, seen = max(objects, key=lambda name: name.effect), [name.object for name in objects if name.seen]
            among = f" of {', '.join(seen)}" if len(objects) > 1 else ""
            beyond = f" The interval{among} excludes zero: the term may be present." if seen else ""
            size = f"{float(f'{largest.at_most:.2g}'):g} {largest.unit}".rstrip()
            whose = f"; largest: {largest.object}" if len(objects) > 1 else ""
            result.append(
                f"{term} in {equation}: |coefficient| < {size}, contribution < {float(f'{largest.effect:.2g}'):g} "
                f"({100 * self.level:.3g} %{whose}).{beyond}"
            )
        return tuple(result)

    def __str__(self) -> str:
        return "\n".join(self.sentences)


@checks_types
def bounds(
    law: Law,
    trials: Trials,
    terms: Sequence[str] | None = None,
    *,
    level: float = 0.95,
    progress: ProgressCallback | None = None,
) -> Bounds:
    """Return upper limits of the coefficients of absent terms, by default all terms of the library, see `Bounds`.

    Raises `CommonlawError` if there are no terms or more than 30, or one is already in the law or cannot be parsed.

    See Also
    --------
    compare : Compare laws with and without a term.
    design : An experiment that reduces the limit.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> limits = cl.bounds(cl.fit("x'' = -g - c v", drops), drops, ["v^2"])
    >>> limits.to_frame()["object"].tolist()
    ['Ball 1', 'Ball 2', 'Ball 3', 'Ball 4', 'Ball 5']
    """
    two_sided(level)
    progress = on_terminal() if progress is None else progress
    if law.schema.inputs != law.observation.measured.inputs:
        raise CommonlawError("limits-with-dead-times")
    if law.order == 0 or not shares_terms(law):
        raise CommonlawError("limits-unsupported")
    pairs = _absent(law, terms)
    if not pairs:
        raise CommonlawError("limits-without-terms")
    if terms is None and len(pairs) > settings.MAX_SCREENED_TERMS:
        raise CommonlawError("limits-of-many-terms", count=len(pairs))
    forecast = law.predict(trials, start="all", averaged=False)
    pairs_of_trials = zip(forecast.trials, forecast.solutions, strict=True)
    along = [np.column_stack([states, trial.inputs, trial.times]) for trial, states in pairs_of_trials]
    values = np.concatenate(along)
    values = values[np.isfinite(values).all(axis=1)]
    limits: list[Bound] = []
    for i, (equation, term) in enumerate(pairs):
        progress(Stage(f"fitting the law with {term.text(law.terms.variables.names)}", i / len(pairs)))
        limits += _of_term(law, trials, equation, term, values, level)
    return Bounds(tuple(limits), level)


def _absent(law: Law, terms: Sequence[str] | None) -> list[tuple[int, Term]]:
    """Return pairs of an equation and a term absent from it: those of the library, or named ones."""
    if terms is None:
        factors = np.flatnonzero(law.terms.is_factor).tolist()
        return [
            (j, law.terms.terms[k]) for j in range(len(law.schema.states)) for k in factors if not law.support[j, k]
        ]
    names = law.terms.variables.names
    wanted = [parse_term(text, law.terms.variables) for text in terms]
    listed = [(j, term) for term in wanted for j in range(len(law.schema.states))]
    there = [(j, law.terms.names[k]) for j, k in np.argwhere(law.support).tolist()]
    for j, term in listed:
        if (j, term.text(names)) in there and len(law.schema.states) == 1:
            raise CommonlawError("limit-of-present-term", term=term.text(names))
    return [(j, term) for j, term in listed if (j, term.text(names)) not in there]


def _of_term(law: Law, trials: Trials, equation: int, term: Term, values: Floats, level: float) -> Iterator[Bound]:
    """Yield the limits of an object's coefficient of a term, from values of all variables, shape (n, variables)."""
    side, names, matching = left_hand_sides(law)[equation], law.terms.variables.names, matched(law, trials)
    taken = (*names, *named_parameters(law).names, *matching.schema.states, *property_names(matching.properties))
    (parameter,) = free_parameter_names(1, taken)
    addend = f" + {parameter} {term.text([quoted(variable) for variable in names])}"
    equations = [text + addend if j == equation else text for j, text in enumerate(exact_equations(law))]
    options = RefitOptions(noise=_given_noise(law, matching) or None, errors=law.uncertainty.error_model.kind)
    fitted = fit_of(law).refitted(matching, options, silent, equations)
    named = named_parameters(fitted)
    at = named.names.index(parameter)
    coefficients, errors, unit = named.values[:, at], named.errors[:, at], named.units[at] or ""
    reach = float(reach_of_equations(fitted, level)[equation])
    known = degrees_of_equations(fitted)
    degrees = np.inf if known is None else float(known[equation])
    plain = replace(law.terms.variables, parameters=())
    sizes = np.abs(parse_terms([term.expression(law.terms.variables.names)], plain).evaluate(values))
    for owner, coefficient, error in zip(fitted.objects, coefficients.tolist(), errors.tolist(), strict=True):
        at_most = float(upper_bound(coefficient, error, degrees, level))
        ends = coefficient - reach * error, coefficient + reach * error
        effect = at_most * float(sizes.max())
        yield Bound(side, term.text(names), owner, coefficient, error, *ends, at_most, effect, unit)


def _given_noise(law: Law, trials: Trials) -> dict[str, float]:
    """Return the standard deviations that were given when a law was fitted, which stay."""
    given = {name: level for name, level in restrictions_of(law).noise.items() if not isinstance(level, str)}
    known, columns = law.uncertainty, trials.schema.noise_columns
    if given or known.error_model or known.noise is None or known.degrees_of_freedom is not None:
        return given
    pairs = zip(law.observation.measured.states, known.noise.tolist(), strict=True)
    return {name: level for name, level in pairs if name not in columns}
