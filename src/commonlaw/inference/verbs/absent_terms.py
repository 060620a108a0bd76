"""Upper limits of the coefficients of terms that are not in a law."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.verbs.other_terms import candidate_law
from commonlaw.law import Law, Provenance
from commonlaw.law.alignment import refuse_observation
from commonlaw.law.law import shares_terms
from commonlaw.law.parameters import coefficient_units, left_hand_sides, standard_errors
from commonlaw.law.quantiles import two_sided, upper_bound
from commonlaw.library import Terms, parse_term, parse_terms
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.runtime.progress import ProgressCallback, Stage, on_terminal
from commonlaw.trials import Trials

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
        rows = [vars(each) | {"seen": each.seen} for each in self.bounds]
        return pd.DataFrame([{names.get(name, name): value for name, value in row.items()} for row in rows])

    @property
    def sentences(self) -> tuple[str, ...]:
        """The limits of each term in words."""
        found = list[str]()
        for equation, term in dict.fromkeys((each.equation, each.term) for each in self.bounds):
            objects = [each for each in self.bounds if (each.equation, each.term) == (equation, term)]
            largest, seen = max(objects, key=lambda each: each.effect), [each.object for each in objects if each.seen]
            among = f" of {', '.join(seen)}" if len(objects) > 1 else ""
            beyond = f" The interval{among} excludes zero: the term may be present." if seen else ""
            size = f"{float(f'{largest.at_most:.2g}'):g} {largest.unit}".rstrip()
            whose = f"; largest: {largest.object}" if len(objects) > 1 else ""
            found.append(
                f"{term} in {equation}: |coefficient| < {size}, contribution < {float(f'{largest.effect:.2g}'):g} "
                f"({100 * self.level:.3g} %{whose}).{beyond}"
            )
        return tuple(found)

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def bounds(
    law: Law,
    trials: Trials,
    terms: Sequence[str] | None = None,
    *,
    level: float = 0.95,
    progress: ProgressCallback | None = None,
) -> Bounds:
    """Return upper limits of the coefficients of absent terms, by default all of the library: see `Bounds`.

    Raises `CommonlawError` if there are more than 30 such terms, or one is named that is in the law or cannot be read.
    """
    two_sided(level)
    progress = on_terminal() if progress is None else progress
    refuse_observation(law)
    if law.order == 0 or not shares_terms(law):
        raise CommonlawError("limits-unsupported")
    pairs = _absent(law, terms)
    if terms is None and len(pairs) > settings.MAX_SCREENED_TERMS:
        raise CommonlawError("limits-of-many-terms", count=len(pairs))
    values = _visited(law, trials)
    found: list[Bound] = []
    for i, (equation, name) in enumerate(pairs):
        progress(Stage(f"fitting the law with {name}", i / len(pairs)))
        found += _of_term(law, trials, equation, name, values, level)
    return Bounds(tuple(found), level)


def _absent(law: Law, terms: Sequence[str] | None) -> list[tuple[int, str]]:
    """Return pairs of an equation and a term absent from it: those of the library, or named ones."""
    if terms is None:
        factors = np.flatnonzero(law.terms.is_factor).tolist()
        return [
            (j, law.terms.names[k]) for j in range(len(law.schema.states)) for k in factors if not law.support[j, k]
        ]
    names = law.terms.variables.names
    wanted = [parse_term(text, law.terms.variables).text(names) for text in terms]
    listed = [(j, name) for name in wanted for j in range(len(law.schema.states))]
    there = [(j, law.terms.names[k]) for j, k in np.argwhere(law.support).tolist()]
    for pair in listed:
        if pair in there and len(law.schema.states) == 1:
            raise CommonlawError("limit-of-present-term", term=pair[1])
    return [pair for pair in listed if pair not in there]


def _visited(law: Law, trials: Trials) -> Floats:
    """Return the variables along the law's trajectories of the trials, shape (n, variables)."""
    forecast = law.predict(trials, averaged=False)
    rows = []
    for trial, found in zip(forecast.trials, forecast.trajectories, strict=True):
        rows.append(law.terms.variables.natural(np.column_stack([found.states, trial.inputs, trial.times])))
    whole = np.concatenate(rows)
    return np.asarray(whole[np.isfinite(whole).all(axis=1)])


def _of_term(law: Law, trials: Trials, equation: int, name: str, values: Floats, level: float) -> Iterator[Bound]:
    wider = _with_term(law, name)
    index = wider.terms.index(name)
    support = wider.support.copy()
    support[equation, index] = True
    estimated = law.uncertainty.degrees_of_freedom is not None  # Given noise is kept
    fitted = candidate_law(wider, trials, support, own_noise=estimated).law
    place = fitted.terms.index(name)
    units = coefficient_units(fitted)
    reach = float(fitted.uncertainty.reach(len(law.schema.states), level)[equation])
    known = fitted.uncertainty.degrees_of_freedom
    degrees = np.inf if known is None else float(known[equation])
    plain = replace(law.terms.variables, parameters=())
    expression = wider.terms.terms[index].expression(law.terms.variables.names)
    sizes = np.abs(parse_terms([expression], plain).evaluate(values))
    left = left_hand_sides(law)[equation]
    errors = standard_errors(fitted)
    for o, owner in enumerate(fitted.objects):
        coefficient, error = (float(fitted.coefficients[o, equation, place]), float(errors[o, equation, place]))
        at_most = float(upper_bound(coefficient, error, degrees, level))
        ends = coefficient - reach * error, coefficient + reach * error
        yield Bound(
            left,
            name,
            owner,
            coefficient,
            error,
            *ends,
            at_most,
            at_most * float(sizes.max()),
            units.get((left, name), ""),
        )


def _with_term(law: Law, name: str) -> Law:
    """Return a law whose library contains a term."""
    bare = replace(
        law, provenance=Provenance(), uncertainty=replace(law.uncertainty, inclusion_probabilities=None, other_laws=())
    )
    if name in law.terms.names:
        return bare
    own, parameters = law.terms.terms, len(law.terms.parameters)
    at = len(own) - parameters
    terms = Terms(law.terms.variables, (*own[:at], parse_term(name, law.terms.variables), *own[at:]))
    return replace(bare, terms=terms, coefficients=np.insert(law.coefficients, at, 0.0, axis=2))
