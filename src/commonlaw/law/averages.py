"""What a law and what else it could be say together: averages over all that remains plausible, by probability.

Bayesian model averaging (Hoeting and others 1999), over the supports that the trials leave plausible.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Self

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.errors import CommonlawError
from commonlaw.law.equations import AbstractEquations
from commonlaw.law.explanation import Explanation
from commonlaw.law.provenance import Alternative, History
from commonlaw.law.quantiles import mixture_interval
from commonlaw.law.uncertainty import PlausibleLaw
from commonlaw.outcomes import Outcome
from commonlaw.trials.trial import ObjectProperties
from commonlaw.validation import check_whole_number

if TYPE_CHECKING:
    import pandas as pd


class AbstractAverages(AbstractEquations):
    """What is known of a law, and of what else it could be."""

    properties: ObjectProperties

    @property
    def explanation(self) -> Explanation | None:
        """See `Uncertainty`."""
        return self.uncertainty.explanation

    @property
    def other_laws(self) -> tuple[PlausibleLaw[Self], ...]:
        """See `Uncertainty`."""
        return self.uncertainty.other_laws

    @property
    def with_discrepancy(self) -> Self | None:
        """See `Provenance`."""
        wider: Self | None = self.provenance.with_discrepancy
        return wider

    @property
    def differentiation(self) -> AbstractDifferentiator | None:
        """See `Provenance`."""
        return self.provenance.differentiation

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """See `Provenance`."""
        return self.provenance.outcomes

    @property
    def alternatives(self) -> tuple[Alternative, ...]:
        """See `Provenance`."""
        return self.provenance.alternatives

    @property
    def history(self) -> History:
        """Every choice on the way to the law; it prints as a table."""
        return History(self.provenance.history)

    @property
    def covariance(self) -> Floats | None:
        """See `Uncertainty`."""
        return self.uncertainty.covariance

    @property
    def noise(self) -> Floats | None:
        """See `Uncertainty`."""
        return self.uncertainty.noise

    @property
    def inclusion_probabilities(self) -> Floats | None:
        """See `Uncertainty`."""
        return self.uncertainty.inclusion_probabilities

    @property
    def has_std(self) -> bool:
        """Whether `predict` can return standard deviations: covariance and noise are known."""
        return self.covariance is not None and self.noise is not None

    @property
    def plausible(self) -> tuple[PlausibleLaw[Self], ...]:
        """All that the law could be with a probability above 1 %, itself first; it alone if no other is known.

        The others have coefficients of their own, with their covariance and errors, and no record of how they were
        found. Their probabilities and its own add up to one.
        """
        return PlausibleLaw(1.0 - sum(each.probability for each in self.other_laws), self), *self.other_laws

    def interval_ends(self, level: float = 0.95, averaged: bool = True) -> tuple[Floats, Floats]:
        """Return the lower and upper ends of the coefficients' intervals, each of shape (objects, equations, terms).

        NaN for terms that an object does not have; see `intervals`.

        Raises
        ------
        CommonlawError
            If the covariance is not known, or the level is not between 0 and 1.
        """
        self.uncertainty.known_covariance()
        laws = self.plausible if averaged else (PlausibleLaw(1.0, self),)
        weights = np.array([each.probability for each in laws]).reshape(-1, 1, 1, 1)
        values = np.array([self._by_own_terms(each.law, each.law.coefficients) for each in laws])
        errors = np.nan_to_num([self._by_own_terms(each.law, each.law.standard_errors) for each in laws])
        degrees = [each.law.uncertainty.degrees_of_freedom for each in laws]
        whole = np.array([np.full(len(self.states), np.inf) if each is None else each for each in degrees])
        low, high = mixture_interval(weights, values, errors, whole[:, np.newaxis, :, np.newaxis], level)
        absent = self.coefficients == 0
        return np.where(absent, np.nan, low), np.where(absent, np.nan, high)

    def letter_interval_ends(self, level: float = 0.95, averaged: bool = True) -> tuple[Floats, Floats]:
        """Return the ends of the intervals of what the letters of `structure` stand for, each (objects, letters).

        NaN where they are not known; see `intervals`.
        """
        values, errors = self.letter_values()
        equations = [each.parts[0].equation for each in self.named_coefficients]
        half = errors * self.uncertainty.reach(len(self.states), level)[equations]
        if not self.other_laws or not averaged:
            return values - half, values + half
        low, high = self.interval_ends(level)
        indices = tuple(np.array([(each.parts[0].equation, each.parts[0].term) for each in self.named_coefficients]).T)
        return low[:, *indices], high[:, *indices]

    def intervals(self, level: float = 0.95, averaged: bool = True) -> "pd.DataFrame":
        """Return a table of all coefficients: object, equation, term, coefficient, standard error, low and high.

        And how probable it is that the term is in the law, and the unit of its coefficient, where that is known. Of a
        law that was given as equations it is a table of their letters: object, parameter, coefficient, standard error,
        low, high, unit.

        Low and high are averaged over what the law could be, `plausible`: the coefficient is zero where its term is
        not in the law, so that the interval of a term that may well not be there tends to include zero. Where there is
        something else that the law could be, the interval if it has these terms and no others stands beside it, as
        "low given these terms" and "high given these terms". Errors follow Student's t distribution, with the degrees
        of freedom of the estimate of the noise.

        Parameters
        ----------
        level
            The probability that the coefficient lies between low and high.
        averaged
            Whether low and high are averaged; else they are those given these terms.

        Raises
        ------
        CommonlawError
            If the covariance is not known, or the level is not between 0 and 1.
        """
        from commonlaw.law.tables import interval_frame, letter_interval_frame

        if self.provenance.equations:
            self.uncertainty.known_covariance()
            ends_of_letters = self.letter_interval_ends(level, averaged)
            found = letter_interval_frame(self.objects, self.letters, *self.letter_values(), *ends_of_letters)
            of_letters = [unit or "" for unit in self.letter_units()]
            return found.assign(unit=of_letters * len(self.objects)) if any(of_letters) else found
        ends = {"": self.interval_ends(level, averaged)}
        if averaged and self.other_laws:
            ends[" given these terms"] = self.interval_ends(level, averaged=False)
        names, errors = (self.objects, self.left_hand_sides, self.terms.names), self.standard_errors
        found = interval_frame(*names, self.coefficients, errors, ends, self.uncertainty.inclusion_probabilities)
        units = self.coefficient_units()
        if units:
            found["unit"] = [units.get(key, "") for key in zip(found["equation"], found["term"], strict=True)]
        return found

    def draws(self, count: int = 1000, seed: int = 0, averaged: bool = True) -> "pd.DataFrame":
        """Return draws of the coefficients from what the trials tell of them, for quantities of one's own.

        Each is drawn from one of the laws that are `plausible`, by their probabilities, and has zeros for terms that
        are not in it; with the covariance of that law, of all objects together. The distribution is normal, or
        Student's t distribution where the noise was estimated.

        Parameters
        ----------
        count
            How many draws of each object.
        seed
            The same seed gives the same draws.
        averaged
            Whether to draw from all that is plausible; else all draws have the terms of this law.

        Returns
        -------
        pandas.DataFrame
            A row for each draw and object, which are its index; a column for each letter of `structure`.

        Raises
        ------
        CommonlawError
            If the law does not know how accurate its coefficients are, or no draw is asked for.

        Examples
        --------
        The speed at which drops no longer accelerate, of each object:

        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> draws = law.draws()
        >>> speeds = (draws["g"] / draws["c"]).groupby("object").quantile([0.025, 0.975]).unstack()
        >>> print(speeds.round(1).to_string(header=False, index_names=False))
        Ball 1  90.1  108.3
        Ball 2  31.7   33.7
        Ball 3  30.9   32.7
        Ball 4  19.2   19.9
        Ball 5  13.8   14.2
        """
        from commonlaw.law.tables import MOST_DRAWS, draws_frame

        check_whole_number("count", count, 1, MOST_DRAWS)
        laws = self.plausible if averaged else self.plausible[:1]
        chosen = np.zeros(count, dtype=np.intp)
        if len(laws) > 1:
            shares = np.cumsum([each.probability for each in laws])
            chosen = np.searchsorted(shares, np.random.default_rng([seed, count]).uniform(0.0, shares[-1], count))
        whole = np.zeros((count, *self.coefficients.shape))
        for i in np.unique(chosen).tolist():
            law, own = laws[i].law, chosen == i
            drawn = law.uncertainty.draws(law.coefficients[:, law.support], int(own.sum()), seed)
            whole[own] = self._by_own_terms(law, _placed(drawn, law))
        values = [each.of(whole) for each in self.named_coefficients]
        return draws_frame(self.objects, self.letters, np.stack(values, axis=-1))

    def each_other(self, change: Callable[[Self], Self]) -> tuple[PlausibleLaw[Self], ...]:
        """Return what else the law could be, each law changed alike."""
        return tuple(PlausibleLaw(each.probability, change(each.law)) for each in self.other_laws)

    def _by_own_terms(self, law: AbstractEquations, values: Floats) -> Floats:
        """Return values of another law's terms, shape (..., equations, terms), for the terms of this one, by name."""
        if law.terms is self.terms:
            return values
        found = np.zeros((*values.shape[:-1], len(self.terms)))
        for name, own in zip(law.terms.names, np.moveaxis(values, -1, 0), strict=True):
            if name in self.terms.names:
                found[..., self.terms.names.index(name)] = own
        return found

    def _check_others(self) -> None:
        """Refuse other laws that are not of the same objects and states, or whose probabilities are none."""
        for probability, law in self.other_laws:
            same = (law.objects, law.order, law.states) == (self.objects, self.order, self.states)
            if not same or law.other_laws:
                raise CommonlawError("averaged-law-differs")
            if not 0 < probability < 1:
                raise CommonlawError("averaged-law-probability", probability=probability)
        if sum(each.probability for each in self.other_laws) >= 1:
            raise CommonlawError("averaged-laws-probability")


def _placed(drawn: Floats, law: AbstractEquations) -> Floats:
    """Return draws of the coefficients in the support of a law among all, shape (draws, objects, equations, terms)."""
    whole = np.zeros((len(drawn), *law.coefficients.shape))
    whole[..., law.support] = drawn
    return whole
