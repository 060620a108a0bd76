"""The law that objects share."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.hierarchy.dimensions import quotient_unit, units_of_coefficients
from commonlaw.integration import Event, Trajectory, VectorField
from commonlaw.law import text
from commonlaw.law.deprecated import Structure, deprecated_member
from commonlaw.law.explanation import LATEX, PLAIN, RelatedCoefficients
from commonlaw.law.parameters import Coefficient, Parameters, Part, Product
from commonlaw.law.parse import Names, latex_summands, read_equations, stated_law
from commonlaw.law.provenance import History, Provenance
from commonlaw.law.quantiles import mixture_interval
from commonlaw.law.simplification import Simplification
from commonlaw.law.text import latex_with_error, with_error
from commonlaw.law.uncertainty import PlausibleLaw, Uncertainty, checked
from commonlaw.library import Order, Terms, with_rates
from commonlaw.library.equation import split_equations
from commonlaw.library.notation import latex_name
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.outcomes import Outcome
from commonlaw.runtime.arguments import check_whole_number
from commonlaw.runtime.files import write_whole
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.runtime.packages import optional_import
from commonlaw.runtime.reading import read_file
from commonlaw.text import counted
from commonlaw.trials import Schema, Trials, TrialStream
from commonlaw.trials.trial import ObjectProperties, normalized

if TYPE_CHECKING:
    import pandas as pd
    import pint
    import sympy
    from distributed import Client

    from commonlaw.discrepancy.function import Discrepancy
    from commonlaw.discrepancy.residual_tests import Residuals
    from commonlaw.forecast.forecast import Forecast
    from commonlaw.inference.diagnose.coefficient_limits import Bounds
    from commonlaw.law.script import Source
    from commonlaw.report.page import Page
    from commonlaw.verdict.law_verdict import LawVerdict


@dataclass(frozen=True, eq=False)
class Law(ShownInNotebooks):
    """Equations that several objects share, with each object's own coefficients.

    A law is a value; what follows from it is computed by the package of that name when it is asked: `simulate`,
    `predict` and `score` by ``forecast``, `update` and `bounds` by ``inference``, `residuals` and `discrepancy` by
    ``discrepancy``, `assess` by ``verdict``, `report` by ``report``.

    Parameters
    ----------
    terms
        Candidate terms over the states, the rates of those of second order, inputs and time.
    schema
        Names and units of what was measured; equation j gives the highest derivative of ``schema.states[j]``.
    order
        1 or 2, or where equations differ that of each, as ``(2, 1)``; 0 for a law in discrete time, which gives the
        next sample's states.
    objects
        Names of the objects.
    coefficients
        Shape (objects, equations, terms).
    uncertainty
        Covariance of the coefficients, noise, relations to properties, and plausible other laws.
    provenance
        How the law was found.
    properties
        Of the objects, by object and name; the units stand in ``schema.units``.

    Raises
    ------
    CommonlawError
        If there is no object or term, the terms are not over the variables of schema and order, or an array does not
        have the shape that terms, schema and objects ask for, or a value that it cannot have.
    """

    terms: Terms
    schema: Schema
    order: Order
    objects: tuple[str, ...]
    coefficients: Floats
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    provenance: Provenance = field(default_factory=Provenance)
    properties: ObjectProperties = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check_names()
        shape = (len(self.objects), len(self.states), len(self.terms))
        values = checked(self.coefficients, "array of coefficients", "objects, equations, terms", shape)
        object.__setattr__(self, "coefficients", values)
        object.__setattr__(self, "uncertainty", self.uncertainty.checked(self.objects, self.support))
        object.__setattr__(self, "properties", normalized(self.properties))
        others = [name for name in self.properties if name not in self._indices]
        if others:
            raise CommonlawError("properties-of-others", objects=others)
        for probability, law in self.uncertainty.other_laws:
            same = (law.objects, law.order, law.states) == (self.objects, self.order, self.states)
            if not same or law.uncertainty.other_laws:
                raise CommonlawError("averaged-law-differs")
            if not 0 < probability < 1:
                raise CommonlawError("averaged-law-probability", probability=probability)
        if sum(each.probability for each in self.uncertainty.other_laws) >= 1:
            raise CommonlawError("averaged-laws-probability")

    def _check_names(self) -> None:
        _ = self.terms.constants  # Refused if they have no terms of their own
        if not self.objects or not len(self.terms):
            raise CommonlawError("law-empty", part="term" if self.objects else "object")
        variables, schema = self.terms.variables, self.schema
        if isinstance(self.order, tuple) and (len(self.order) != len(schema.states) or {*self.order} != {1, 2}):
            raise CommonlawError("order-of-states", order=self.order, states=schema.states)
        if schema.logarithmic and self.order != 1:
            raise CommonlawError(
                "log-states-order", states=schema.logarithmic, order=text.order_in_words(self.order, schema.states)
            )
        names = variables.states[: len(schema.states)], variables.inputs, variables.time, variables.logarithmic
        rates, order = len(with_rates(self.order, len(schema.states))), text.order_in_words(self.order, schema.states)
        is_over = names == (schema.states, schema.inputs, schema.time, schema.logarithmic)
        if not is_over or len(self.rates) != rates:
            raise CommonlawError(
                "law-terms-variables", order=order, states=schema.states, variables=variables.names, rates=rates
            )
        if variables.orders != (self.order if isinstance(self.order, tuple) else ()):
            raise CommonlawError("law-orders", order=order, orders=variables.orders or "that all have")
        twice = [name for name, count in Counter(variables.names).items() if count > 1]
        if twice:
            raise CommonlawError("variable-twice", name=twice[0])
        if self.provenance.equations:
            given = read_equations(self.provenance.equations, schema, variables)
            if (given.terms, given.order) != (self.terms, self.order):
                raise CommonlawError("law-terms-and-equations", terms=self.terms.names, equations=given.texts)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            return deprecated_member(self, name)

    # Structure

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.schema.states

    @property
    def rates(self) -> tuple[str, ...]:
        """Names of the rates of the states of second order."""
        return self.terms.variables.states[len(self.states) :]

    @property
    def state_rates(self) -> tuple[tuple[str, str], ...]:
        """The names of the states of second order, each with that of its rate."""
        second = (self.states[j] for j in with_rates(self.order, len(self.states)))
        return tuple(zip(second, self.rates, strict=True))

    @property
    def left_hand_sides(self) -> tuple[str, ...]:
        """What each equation gives, as text: ``x'``, ``x''``, or ``x[k+1]`` in a discrete-time law."""
        return text.left_hand_sides(self.states, self.order)

    @cached_property
    def support(self) -> Bools:
        """Which terms are in which equation for at least one object, shape (equations, terms)."""
        return np.asarray(np.any(self.coefficients != 0, axis=0))

    @cached_property
    def shared(self) -> bool:
        """Whether every object has the same terms."""
        return bool(np.all((self.coefficients != 0) == self.support))

    def index(self, name: object) -> int:
        """Return the index of an object among those of the law.

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        index = self._indices.get(str(name))
        if index is None:
            raise unknown("object of this law", name, self.objects)
        return index

    @cached_property
    def _indices(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.objects)}

    @cached_property
    def structure(self) -> Structure:
        """Each equation with names for its parameters: ``x'' = a + b v``; as it was given if it was.

        Known coefficients that all objects share are numbers: ``x'' = -9.81 + a v``.
        """
        if self.provenance.equations:
            return Structure(self.provenance.equations)
        rows = text.labelled(self.terms.factors, self._labels({name: name for name in self.parameters.names}))
        return Structure(text.written_structure(self.left_hand_sides, rows))

    def latex_structure(self) -> tuple[tuple[text.Addend, ...], ...]:
        """Return the right-hand sides of `structure` in LaTeX."""
        variables = self.terms.variables
        if self.provenance.equations:
            rows = latex_summands(self.provenance.equations, self.schema, variables, self.state_rates)
            return tuple(tuple(text.Addend(negative, "", latex) for negative, latex in row) for row in rows)
        factors = zip(self.terms.names, self.terms.latex_factors(variables.names), strict=True)
        names = ["1" if name == "1" else latex for name, latex in factors]
        labels = self._labels({name: latex_name(name) for name in self.parameters.names})
        return text.labelled(names, labels, latex_with_error)

    def _labels(self, written: Mapping[str, str]) -> list[list[tuple[int, text.Label]]]:
        """Return for each equation its terms, by index, each with a number or a written parameter before it."""
        names = {(each.equation, each.term): written[each.name] for each in self.parameters.definitions}
        rows: list[list[tuple[int, text.Label]]] = [[] for _ in self.states]
        for j, k in np.argwhere(self.support & self.terms.is_factor).tolist():
            rows[j].append((k, names.get((j, k), float(self.coefficients[0, j, k]))))
        return rows

    @cached_property
    def parameters(self) -> Parameters:
        """What the names in `structure` stand for: values, errors, covariance and units as arrays.

        One for each coefficient that is no known number, or those of the equations that were given.
        """
        if self.provenance.equations:
            given = read_equations(self.provenance.equations, self.schema, self.terms.variables)
            definitions, products = given.coefficients, given.products
        else:
            alike = np.all((self.standard_errors == 0) & (self.coefficients == self.coefficients[:1]), axis=0)
            places = np.argwhere(self.support & ~(alike & self.terms.is_factor)).tolist()
            letters = iter(text.free_letters(len(places), self.terms.variables.names))
            named = [(self.terms.constant_name(k) or next(letters), j, k) for j, k in places]
            definitions = tuple(Coefficient(name, (Part(j, k),)) for name, j, k in named)
            products = tuple(Product(j, k, 1.0, ((name, 1),)) for name, j, k in named)
        covariance = self.uncertainty.covariance
        return Parameters(definitions, products, self.coefficients, self.support, covariance, self._units)

    # Parameters and their uncertainty

    @cached_property
    def standard_errors(self) -> Floats:
        """Standard errors of the coefficients, shape (objects, equations, terms).

        Zero for coefficients that are known, NaN for terms that are not in the law, and everywhere if the covariance is
        not known.
        """
        errors = np.full(self.coefficients.shape, np.nan)
        if self.uncertainty.covariance is not None:
            errors[:, self.support] = np.sqrt(np.diagonal(self.uncertainty.covariance, axis1=1, axis2=2))
        errors.flags.writeable = False
        return errors

    @property
    def noise(self) -> Floats | None:
        """Standard deviation of the measurement noise of each state, shape (states,); None if it is not known."""
        return self.uncertainty.noise

    @property
    def params(self) -> "pd.DataFrame":
        """The parameters of every object, one row each, with standard errors and 95 % intervals.

        Columns are object, equation, term, parameter, estimate, standard error, low, high and unit, and where terms
        were chosen by evidence the inclusion probability. A row stands for a coefficient before a term, with its name
        in `structure`; in a law of given equations for a parameter, with the first term that it is in. Intervals are
        averaged over `models`, see `conf_int`. What is not known is NaN or empty.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> law.params[["object", "parameter", "estimate", "standard error", "unit"]].head(2).round(3)
           object parameter  estimate  standard error  unit
        0  Ball 1         g     9.769           0.082  m/s²
        1  Ball 1         c     0.099           0.006   1/s
        """
        return self._params(None if self.uncertainty.covariance is None else 0.95, True)

    def conf_int(self, level: float = 0.95, averaged: bool = True) -> "pd.DataFrame":
        """Return `params` with intervals of another level, or given the terms of this law.

        Averaged over `models`, a coefficient is zero where its term is not in the law, so that the interval of a term
        that may not be there tends to include zero. Errors follow Student's t distribution, with the degrees of freedom
        of the estimated noise.

        Parameters
        ----------
        level
            The probability that the parameter lies between low and high.
        averaged
            Whether low and high are averaged; else they are those given these terms.

        Raises
        ------
        CommonlawError
            If the covariance is not known, or the level is not between 0 and 1.
        """
        self.uncertainty.known_covariance()
        return self._params(level, averaged)

    def _params(self, level: float | None, averaged: bool) -> "pd.DataFrame":
        """Return the table of parameters, without intervals if there is no level."""
        import pandas as pd

        if self.provenance.equations:
            values, errors, names = self.parameters.values, self.parameters.errors, np.array(self.parameters.names)
            rows, p = np.indices(values.shape).reshape(2, -1)
            indices: tuple[Any, ...] = (rows, p)
            places = np.array([(each.equation, each.term) for each in self.parameters.definitions], dtype=np.intp)
            j, k = places.reshape(-1, 2)[p].T
            labels, units = names[p].tolist(), [self.parameters.units[each] or "" for each in p.tolist()]
            ends = None if level is None else self.parameter_intervals(level, averaged)
        else:
            values, errors = self.coefficients, self.standard_errors
            indices = rows, j, k = np.nonzero(values)
            named = {(each.equation, each.term): each.name for each in self.parameters.definitions}
            known, keys = self.coefficient_units(), list(zip(j.tolist(), k.tolist(), strict=True))
            labels = [named.get(key, "") for key in keys]
            units = [known.get((self.left_hand_sides[a], self.terms.names[b]), "") for a, b in keys]
            ends = None if level is None else self.coefficient_intervals(level, averaged)
        columns: dict[str, Any] = {
            "object": [self.objects[each] for each in rows.tolist()],
            "equation": [self.left_hand_sides[each] for each in j.tolist()],
            "term": [self.terms.names[each] for each in k.tolist()],
            "parameter": labels,
            "estimate": values[indices],
            "standard error": errors[indices],
            "low": np.nan if ends is None else ends[0][indices],
            "high": np.nan if ends is None else ends[1][indices],
            "unit": units,
        }
        inclusion = self.uncertainty.inclusion_probabilities
        if inclusion is not None and not self.provenance.equations:
            columns["inclusion probability"] = inclusion[j, k]
        return pd.DataFrame(columns)

    def cov_params(self, name: str | None = None) -> "pd.DataFrame":
        """Return the covariance of one object's parameters, by their names in rows and columns, to first order.

        Raises
        ------
        CommonlawError
            If it is not known, or the object is not named and there are several.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> float(law.cov_params("Ball 1").loc["g", "c"]) > 0
        True
        """
        import pandas as pd

        self.uncertainty.known_covariance()
        names = pd.Index(self.parameters.names, name="parameter")
        return pd.DataFrame(self.parameters.covariance[self.index(self._only(name))], index=names, columns=names)

    def coefficient_intervals(self, level: float = 0.95, averaged: bool = True) -> tuple[Floats, Floats]:
        """Return the ends of the coefficients' intervals, each of shape (objects, equations, terms); see `conf_int`.

        NaN for terms that an object does not have.

        Raises
        ------
        CommonlawError
            If the covariance is not known, or the level is not between 0 and 1.
        """
        self.uncertainty.known_covariance()
        laws = self.models if averaged else (PlausibleLaw(1.0, self),)
        weights = np.array([each.probability for each in laws]).reshape(-1, 1, 1, 1)
        values = np.array([self._by_own_terms(each.law, each.law.coefficients) for each in laws])
        errors = np.nan_to_num([self._by_own_terms(each.law, each.law.standard_errors) for each in laws])
        degrees = [each.law.uncertainty.degrees_of_freedom for each in laws]
        whole = np.array([np.full(len(self.states), np.inf) if each is None else each for each in degrees])
        low, high = mixture_interval(weights, values, errors, whole[:, np.newaxis, :, np.newaxis], level)
        absent = self.coefficients == 0
        return np.where(absent, np.nan, low), np.where(absent, np.nan, high)

    def parameter_intervals(self, level: float = 0.95, averaged: bool = True) -> tuple[Floats, Floats]:
        """Return the ends of the intervals of `parameters`, each of shape (objects, parameters); NaN where unknown."""
        places = np.array([(each.equation, each.term) for each in self.parameters.definitions], dtype=np.intp)
        j, k = places.reshape(-1, 2).T
        if self.uncertainty.other_laws and averaged:
            low, high = self.coefficient_intervals(level)
            return low[:, j, k], high[:, j, k]
        half = self.parameters.errors * self.uncertainty.reach(len(self.states), level)[j]
        return self.parameters.values - half, self.parameters.values + half

    def sample(self, n: int = 1000, seed: int = 0, averaged: bool = True) -> "pd.DataFrame":
        """Return draws of the parameters from their posterior, to propagate their uncertainty.

        Each is drawn from one of `models`, by their probabilities, with the covariance of that law over all objects,
        and has zeros for terms that are not in it. The distribution is normal, or Student's t where the noise was
        estimated.

        Parameters
        ----------
        n
            Draws of each object.
        seed
            The same seed gives the same draws.
        averaged
            Whether to draw from all models; else all draws have the terms of this law.

        Returns
        -------
        pandas.DataFrame
            A row for each draw and object, which are its index; a column for each parameter of `structure`.

        Raises
        ------
        CommonlawError
            If the covariance is not known, or no draw is asked for.

        Examples
        --------
        The terminal velocity of each object:

        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> draws = law.sample()
        >>> speeds = (draws["g"] / draws["c"]).groupby("object").quantile([0.025, 0.975]).unstack()
        >>> print(speeds.round(1).to_string(header=False, index_names=False))
        Ball 1  90.1  108.3
        Ball 2  31.7   33.7
        Ball 3  30.9   32.7
        Ball 4  19.2   19.9
        Ball 5  13.8   14.2
        """
        import pandas as pd

        from commonlaw.law.tables import MOST_DRAWS

        check_whole_number("n", n, 1, MOST_DRAWS)
        laws = self.models if averaged else self.models[:1]
        chosen = np.zeros(n, dtype=np.intp)
        if len(laws) > 1:
            shares = np.cumsum([each.probability for each in laws])
            chosen = np.searchsorted(shares, np.random.default_rng([seed, n]).uniform(0.0, shares[-1], n))
        draws = np.zeros((n, *self.coefficients.shape))
        for i in np.unique(chosen).tolist():
            law, rows = laws[i].law, chosen == i
            drawn = law.uncertainty.draws(law.coefficients[:, law.support], int(rows.sum()), seed)
            placed = np.zeros((len(drawn), *law.coefficients.shape))
            placed[..., law.support] = drawn
            draws[rows] = self._by_own_terms(law, placed)
        values = np.stack([each.of(draws) for each in self.parameters.definitions], axis=-1)
        index = pd.MultiIndex.from_product([range(n), self.objects], names=["draw", "object"])
        return pd.DataFrame(values.reshape(n * len(self.objects), -1), index=index, columns=list(self.parameters.names))

    def _by_own_terms(self, law: "Law", values: Floats) -> Floats:
        """Return values of another law's terms, shape (..., equations, terms), for the terms of this one, by name."""
        if law.terms is self.terms:
            return values
        placed = np.zeros((*values.shape[:-1], len(self.terms)))
        for name, column in zip(law.terms.names, np.moveaxis(values, -1, 0), strict=True):
            if name in self.terms.names:
                placed[..., self.terms.names.index(name)] = column
        return placed

    def coefficient_units(self) -> "dict[tuple[str, str], str]":
        """Return the unit of each coefficient by equation and term, where the units of the variables determine it."""
        return {(self.left_hand_sides[j], self.terms.names[k]): f"{unit:~P}" for (j, k), unit in self._units().items()}

    def _units(self) -> "dict[tuple[int, int], pint.Unit]":
        return units_of_coefficients(self.terms, self.support, self.schema, self.order)

    def to_frame(self, errors: bool = False) -> "pd.DataFrame":
        """Return the coefficients in a wide table: one row for each object, one column for each term in the law.

        With several equations the columns have two levels, the equation and the term. A law that was given as equations
        has a column for each parameter.

        Parameters
        ----------
        errors
            Whether each column is followed by one of standard errors, ``"v ±"`` after ``"v"``.

        Raises
        ------
        CommonlawError
            If errors are asked for that are not known.
        """
        import pandas as pd

        if errors:
            self.uncertainty.known_covariance()
        if self.provenance.equations:
            keys = [("", name) for name in self.parameters.names]
            values, deviations = self.parameters.values, self.parameters.errors
        else:
            keys = [(self.left_hand_sides[j], self.terms.names[k]) for j, k in np.argwhere(self.support)]
            values, deviations = self.coefficients[:, self.support], self.standard_errors[:, self.support]
        if errors:
            keys = [key for equation, name in keys for key in ((equation, name), (equation, f"{name} ±"))]
            values = np.stack([values, deviations], axis=2).reshape(len(values), -1)
        columns: pd.Index[Any] = pd.MultiIndex.from_tuples(keys, names=["equation", "term"])
        if self.provenance.equations or len(self.states) == 1:
            kind = None if self.provenance.equations else "term"
            columns = pd.Index([name for _, name in keys], dtype=object, name=kind)
        return pd.DataFrame(values, index=pd.Index(self.objects, name="object"), columns=columns)

    # Comparison with other models, and how the law was found

    @property
    def models(self) -> "tuple[PlausibleLaw[Law], ...]":
        """All laws with a posterior probability above 1 %, this one first; it alone if no other is known.

        The others have coefficients, covariance and errors of their own, and no record of how they were found. The
        probabilities add up to one.
        """
        others = self.uncertainty.other_laws
        return PlausibleLaw(1.0 - sum(each.probability for each in others), self), *others

    @property
    def comparison(self) -> "pd.DataFrame":
        """The candidates of each equation, from the best to the worst, with the difference of each from the best.

        Columns are equation, rank (from 0), terms, size, measure, score, difference, weight, further measures, proven
        (no other support of the size fits better) and chosen. The measure is ``2 log B``, twice the logarithm of the
        Bayes factor of the best over the candidate (Kass and Raftery 1995), the weight then its posterior probability;
        ``log score difference`` where forecasts of held-out data chose the law; or the criterion of a regression.
        Lower scores are better. Empty for a law whose terms were given.
        """
        from commonlaw.law.tables import comparison_frame

        return comparison_frame(self.provenance.alternatives)

    def path(self) -> "pd.DataFrame":
        """Return the equations that all values of the solver's hyperparameter give, in segments from the smallest.

        Each row holds from its threshold, penalty or number of terms to the next row's, with its measures; a candidate
        may come more than once.

        Raises
        ------
        CommonlawError
            If the law was not chosen from the path of one solver.
        """
        from commonlaw.law.tables import path_frame

        return path_frame(self.left_hand_sides, self.provenance.alternatives)

    @property
    def diagnostics(self) -> tuple[Outcome, ...]:
        """What a user should know of the law and of how it was found."""
        return self.provenance.outcomes

    @property
    def history(self) -> History:
        """Every choice on the way to the law; it prints as a table."""
        return History(self.provenance.history)

    def domain(self) -> "pd.DataFrame":
        """Return a table of where the law may be used: the ranges of what it was learned from, with their units.

        Rates are those of smooth curves through the samples. Forecasts that leave a range by more than a tenth of it
        say so, in ``Forecast.trials.notes``.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.0))
        >>> print(law.domain().round(1).drop(columns="unit").to_string(index=False))
        variable   low  high
               x   2.1  47.3
               v -26.7  -0.2
            drag  -0.7  -0.1
        """
        import pandas as pd

        units = self.schema.units
        rows = [(name, *ends, units.get(name, "")) for name, ends in self.provenance.domain.visited.items()]
        return pd.DataFrame(rows, columns=["variable", "low", "high", "unit"])

    def relations(self) -> "pd.DataFrame":
        """Return a table of what decides each coefficient: its kind, the properties it follows, its factor, scatter.

        Columns are equation, term, kind, follows, factor, standard error, unit, scatter, its error and the probability
        of the relation; scatter is relative where all objects have the same sign, and factors of affine functions are
        their constants.

        Raises
        ------
        CommonlawError
            If the law was not explained, see `explain`.
        """
        explanation, indices = self._related.explanation, np.argwhere(self.support)
        equations = [self.left_hand_sides[j] for j, _ in indices]
        return explanation.to_frame(equations, [self.terms.names[k] for _, k in indices], self._factor_units())

    @property
    def _related(self) -> RelatedCoefficients:
        explanation = self.uncertainty.explanation
        if explanation is None:
            raise CommonlawError("relations-missing")
        return RelatedCoefficients(self.terms, self.support, self.coefficients, explanation)

    def _factor_units(self) -> list[str | None]:
        """Return the units of the relations' factors, as far as they are known."""
        found: list[str | None] = []
        known, units = self.coefficient_units(), self.schema.units
        for (j, k), relation in zip(np.argwhere(self.support), self._related.explanation.relations, strict=True):
            unit = known.get((self.left_hand_sides[j], self.terms.names[k]))
            if unit is None or relation is None or not {*relation.properties} <= units.keys():
                found.append(None)
            else:
                powers = zip(relation.properties, map(float, relation.exponents), strict=False)
                found.append(quotient_unit(unit, [(units[name], power) for name, power in powers]))
        return found

    # Text

    def equations(self, name: str | None = None, digits: int = 4, errors: bool | None = None) -> tuple[str, ...]:
        """Return the equations of one object as text: ``x'' = -9.34 + 0.0466 v``.

        With errors: ``x'' = -9.34 ± 0.12 + (0.047 ± 0.010) v``, standard errors to two digits. A law that was given as
        equations is written as these, with numbers in place of its parameters: ``N' = 0.8 N (1 - N/1.4)``.

        Parameters
        ----------
        name
            The object; may be left out when there is only one. Of a law that `explain` gave, nothing gives the
            equations that hold for all objects: ``x'' = -9.8 + 0.25 diameter^2/mass v^2``.
        digits
            Significant digits of the coefficients that have no error.
        errors
            Whether to show standard errors; None shows them when they are known.

        Raises
        ------
        CommonlawError
            If the object is not named and there are several, or errors are asked for that are not known.
        """
        if name is None and self._is_explained:
            lefts = (*self.left_hand_sides, *self.terms.variables.constants)
            related = self._related.rows(PLAIN, lefts, self.terms.factors, digits, errors is not False)
            return tuple(f"{left} = {text.summed(addends, PLAIN.times)}" for left, addends in related)
        known = self._shown_errors(name := self._only(name), errors)
        if self.provenance.equations:
            numbers = {key: text.numbered(*pair, digits) for key, pair in self._given_values(name, known).items()}
            return tuple(each.with_numbers(numbers) for each in split_equations(self.provenance.equations))
        constants = [with_error(*pair, digits, bracket=True) for pair in self._constants(name, known)]
        written = (f"({each})" if each.startswith("-") else each for each in constants)
        names = self.terms.factors_over((*self.terms.variables.measured, *written))
        rows = zip(self.left_hand_sides, self._factors(name), known, strict=True)
        return tuple(text.equation(*row, names, digits, self.terms.have_constants) for row in rows)

    def to_latex(self, name: str | None = None, digits: int = 4, errors: bool | None = None) -> str:
        """Return `equations` as LaTeX, an ``aligned`` block without dollar signs; parameters have lines of their own.

        Raises
        ------
        CommonlawError
            If the object is not named and there are several, or errors are asked for that are not known.
        """
        left = text.latex_left_hand_sides(self.states, self.order)
        terms = self.terms.latex_factors(self.terms.variables.names)
        constants = [latex_name(each) for each in self.terms.variables.constants]
        if name is None and self._is_explained:
            return text.aligned(self._related.rows(LATEX, (*left, *constants), terms, digits, errors is not False))
        known = self._shown_errors(name := self._only(name), errors)
        if self.provenance.equations:
            values = [(latex_name(key), pair) for key, pair in self._given_values(name, known).items()]
            return text.aligned([*zip(left, self.latex_structure(), strict=True), *text.latex_values(values, digits)])
        pairs = zip(constants, self._constants(name, known), strict=True)
        rows = zip(left, self._factors(name), known, strict=True)
        equations = text.latex_equations(rows, terms, digits, self.terms.have_constants)
        return text.aligned([*equations, *text.latex_values(pairs, digits)])

    def to_sympy(self, name: str | None = None) -> "dict[sympy.Expr, sympy.Expr]":
        """Return the equations of one object: left-hand side, such as ``Symbol("x''")``, to right-hand side.

        Raises
        ------
        CommonlawError
            If the object is not named and there are several, or SymPy is not installed.
        """
        sympy = optional_import("sympy", "the SymPy form of a law", "symbolic")
        symbols = [sympy.Symbol(each, real=True) for each in self.terms.variables.names]
        name = self._only(name)
        pairs = zip(self.terms.variables.constants, self._constants(name, np.zeros(self.support.shape)), strict=True)
        values = {sympy.Symbol(each, real=True): sympy.Float(float(value)) for each, (value, _) in pairs}
        forms = [term.sympy(symbols).subs(values) for term in self.terms.terms]
        sums = [
            sympy.Add(*(sympy.Float(float(c)) * form for c, form in zip(row, forms, strict=True) if c))
            for row in self._factors(name)
        ]
        return {sympy.Symbol(left, real=True): each for left, each in zip(self.left_hand_sides, sums, strict=True)}

    def _only(self, name: str | None) -> str:
        if name is None and len(self.objects) > 1:
            raise CommonlawError("several-objects", objects=", ".join(self.objects))
        return self.objects[0] if name is None else name

    @property
    def _is_explained(self) -> bool:
        return self.uncertainty.explanation is not None and len(self.objects) > 1

    def _shown_errors(self, name: str, wanted: bool | None) -> Floats:
        """Return the standard errors of one object to show, shape (equations, terms): zeros if they are not wanted."""
        if wanted:
            self.uncertainty.known_covariance()
        if wanted is False or self.uncertainty.covariance is None:
            return np.zeros(self.support.shape)
        return np.asarray(self.standard_errors[self.index(name)])

    def _given_values(self, name: str, errors: Floats) -> dict[str, tuple[float, float]]:
        """Return the parameters of given equations, and their errors, zero where those of terms all are."""
        i = self.index(name)
        shown = np.nan_to_num(self.parameters.errors[i]) * bool(np.any(np.nan_to_num(errors)))
        pairs = zip(self.parameters.values[i].tolist(), shown.tolist(), strict=True)
        return dict(zip(self.parameters.names, pairs, strict=True))

    def _constants(self, name: str, errors: Floats) -> list[tuple[float, float]]:
        """Return the value of each parameter inside of terms for an object, and its error of those of all terms."""
        coefficients, found = self.coefficients[self.index(name)], []
        for k in self.terms.constants:
            j = int(np.argmax(coefficients[:, k] != 0))
            found.append((float(coefficients[j, k]), float(np.nan_to_num(errors[j, k]))))
        return found

    def _factors(self, name: str) -> Floats:
        """Return the coefficients of an object that are factors of terms, shape (equations, terms)."""
        return np.where(self.terms.is_factor, self.coefficients[self.index(name)], 0.0)

    def __repr__(self) -> str:
        form = self.structure if self.shared else ("each object with its own terms",)
        few = self.objects if len(self.objects) <= text.MANY else (counted(len(self.objects), "object"),)
        return f"<Law of {', '.join(few)}: {'; '.join(form)}>"

    def __str__(self) -> str:
        known, values = self.parameters, list[tuple[str, float, float]]()
        if len(self.objects) == 1:
            body = [*self.equations()]
            if self.provenance.equations:
                heads = text.with_units(known.names, known.units)
                values = list(zip(heads, known.values[0], known.errors[0], strict=True))
        elif self.uncertainty.explanation is not None:
            lines = self._related.lines(self.objects, self.standard_errors, self._factor_units())
            body = [*self.equations(), *lines]
        elif self.shared:
            body = [*self.structure]
            if known.names:
                heads = text.with_units(known.names, known.units)
                body += ["", *text.coefficient_table(self.objects, heads, known.values, known.errors)]
        else:
            own = {name: self.equations(name) for name in self.objects}
            body = [line for name in own for line in (f"{name}:", *(f"  {each}" for each in own[name]))]
        simpler = resolve_name("commonlaw.law.simplify:within_errors")(self)
        return text.printed(body, self.state_rates, values, simpler, self.diagnostics)

    def summary(self) -> str:
        """Return the law as it prints, followed by its table of `params` and the best rows of its `comparison`.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05).select(object="Ball 1"))
        >>> print(law.summary())
        x'' = -9.769 ± 0.075 - (0.0992 ± 0.0052) v
        <BLANKLINE>
        with v = x', g [m/s²] = 9.769 ± 0.075, c [1/s] = 0.0992 ± 0.0052
        <BLANKLINE>
        object equation term parameter estimate standard error    low   high unit
        Ball 1      x''    1         g    9.769          0.075  9.619  9.919 m/s²
        Ball 1      x''    v         c   0.0992         0.0052 0.0889 0.1096  1/s
        """
        from commonlaw.law.tables import readable, readable_candidates

        tables = [readable(self.params).dropna(axis=1, how="all")]
        if self.provenance.alternatives:
            tables.append(readable_candidates(self.provenance.alternatives))
        return "\n\n".join([str(self), *(each.to_string(index=False, na_rep="") for each in tables)])

    def to_script(self, path: "str | Source" = "trials.csv") -> str:
        """Return a Python program that finds this law again in the table of its trials.

        A law's file may come from a stranger: the program holds calls of commonlaw with plain values only, and a line
        for each recorded step that is something else.

        Parameters
        ----------
        path
            Of the table. What was selected from it before the law was found, the law does not know; a `Source` says it.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> for line in cl.fit("x'' = -g - c v", drops).to_script("drops.csv").splitlines()[2:4]:
        ...     print(line)
        trials = cl.Trials.read('drops.csv', time='t', states=['x'], units={'t': 's', 'x': 'm'})
        law = cl.fit("x'' = -g - c v", trials)
        """
        from commonlaw.law.script import Source, script

        equations = self.structure if self.shared else ()
        return script(self.provenance.calls, equations, self.schema, path if isinstance(path, Source) else Source(path))

    # Right-hand side, simulation, forecasts

    def rhs(self, name: str, values: ArrayLike) -> Floats:
        """Return the right-hand side of one object as forecasts follow it: the highest derivatives, (n, equations).

        By pooled coefficients where the law has them (``law.uncertainty.pooled``), as these err less.

        Parameters
        ----------
        name
            The object.
        values
            The law's variables (states, rates, inputs, time), shape (n, variables). Time may be left out where no term
            depends on it.

        Raises
        ------
        CommonlawError
            If there is no such object, or the values are not those of the variables.
        """
        coefficients, variables = self._followed_coefficients(name), self.terms.variables
        points, names = np.asarray(values, dtype=np.float64), variables.measured
        time = variables.index(variables.time)
        if points.ndim == 2 and points.shape[1] == len(names) - 1:
            used = np.flatnonzero(self.support.any(axis=0))
            if not any(time in self.terms.terms[k].columns() for k in used):
                points = np.insert(points, time, 0.0, axis=1)
        if points.ndim != 2 or points.shape[1] != len(names):
            raise CommonlawError("variables-shape", shape=points.shape, names=names)
        return np.asarray(self.terms.evaluate(self.terms.at(points, coefficients)) @ coefficients.T)

    def vector_field(self, name: str) -> VectorField:
        """Return the right-hand side for one object as forecasts follow it, ready to integrate, see `VectorField`.

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        free = self.support if self.shared else None
        return VectorField(self.terms, self._followed_coefficients(name), self.order, free=free)

    def _followed_coefficients(self, name: object) -> Floats:
        """Return the coefficients of one object that rates and forecasts follow: pooled ones if the law has them."""
        pooled, index = self.uncertainty.pooled, self.index(name)
        found: Floats = self.coefficients[index].copy()
        if pooled is not None:
            found[self.support] = pooled.coefficients[index]
        return found

    def simulate(
        self,
        times: ArrayLike,
        initial: "ArrayLike | Mapping[str, ArrayLike]",
        *,
        method: str = "auto",
        tolerance: float = 1e-8,
        events: Sequence[Event] = (),
        dense: bool = False,
        sensitivities: bool = False,
        doses: Mapping[str, Mapping[float, float]] | None = None,
    ) -> dict[str, Trajectory]:
        """Integrate the law for every object; a divergence is an outcome of its trajectory.

        Parameters
        ----------
        times
            When the states are wanted, shape (n,); the first is the time of the initial state.
        initial
            Initial states, followed by the initial rates of those of second order: one vector for all objects, or one
            by name of object.
        method, tolerance, events, dense
            See `commonlaw.integration.simulate`.
        sensitivities
            Whether to give the derivatives of states by coefficients in the support, row by row, and by initial states.
        doses
            Amounts by their times, of a law whose inputs are doses: ``{"dose": {3.0: 60.0}}``.

        Raises
        ------
        CommonlawError
            If the law has other inputs, lacks an object, or has not as many states as an initial state.
        """
        how = {"method": method, "tolerance": tolerance, "events": events, "dense": dense, "doses": doses}
        simulate = resolve_name("commonlaw.forecast:simulate_law")
        found: dict[str, Trajectory] = simulate(self, times, initial, sensitivities=sensitivities, **how)
        return found

    def predict(
        self,
        trials: Trials,
        *,
        times: ArrayLike | None = None,
        start: int | Literal["all"] | None = None,
        from_time: float | None = None,
        return_std: bool = False,
        method: str = "auto",
        tolerance: float = 1e-8,
        seed: int = 0,
        input_between: str | None = None,
        discrepancy: bool = False,
        averaged: bool = True,
    ) -> "Forecast":
        """Forecast each trial from its own initial state.

        Parameters
        ----------
        trials
            What to forecast, at all samples, measured or not. Objects that the law, if it has several, does not know
            get coefficients from their properties, if `explain` found how, else mean ones; the intervals include the
            scatter of the objects about these.
        times
            More times to forecast at after a trial's first sample, shape (m,). Inputs keep their last value.
        start
            How many of each trial's first measured samples determine its initial state. 1: the first states as
            measured, with rates estimated by the law's differentiation. 2 or more: the law, coefficients fixed, is
            fitted to them by likelihood, which needs its noise; states may be missing. ``"all"``: the whole trial, so
            that the trajectories are fits and no forecasts. Default: 1; if the noise is known, all that were measured
            where others follow, those that first rates would be estimated from, or as many as latent states need.
        from_time
            When forecasts begin: all samples before, or the last `start` of them, determine the initial state. Trials
            without samples on both sides are left out, see `Forecast.trials.notes`. Without known noise the last
            sample before, or for a law of second order the first of five, counts as measured.
        return_std
            Whether to compute intervals: the covariances of coefficients and initial state, taken as independent, are
            carried along each trajectory to first order.
        method, tolerance
            See `commonlaw.integration.simulate`.
        seed
            Of the noise that shows how accurate estimated initial rates are.
        input_between
            The interpolation of inputs between samples: ``"held"`` at the earlier value, ``"linear"`` or ``"cubic"``.
            Default: as the law was learned.
        discrepancy
            Whether to include the discrepancy that was found with the law, see `discrepancy`.
        averaged
            Whether to average over `models`: forecasts are weighted medians, intervals those of the mixture.

        Raises
        ------
        CommonlawError
            If a trial's object is not the only one of the law, its variables are not those of the law, an initial state
            cannot be fitted, or covariance, noise or discrepancy are asked for that the law does not have.
        """
        predict = resolve_name("commonlaw.forecast:predict")
        options = {"start": start, "from_time": from_time, "return_std": return_std, "input_between": input_between}
        how = {"method": method, "tolerance": tolerance, "seed": seed, "discrepancy": discrepancy, "averaged": averaged}
        forecast: Forecast = predict(self, trials, times=times, **options, **how)
        return forecast

    def score(self, trials: Trials, start: int | Literal["all"] | None = None) -> float:
        """Return the R^2 of the forecasts of these trials, see `Forecast.score`; for the start see `predict`."""
        return self.predict(trials, start=start).score()

    def update(self, trials: Trials) -> "Law":
        """Return the law of the objects of new trials, with coefficients that these trials have updated.

        The prior of an object's coefficients is what `predict` would take: its own, or those that follow from its
        properties or are typical, with their covariance. The likelihood of the trials, with free initial states,
        updates it to first order. Trials that the law was learned from would count twice.

        Raises
        ------
        CommonlawError
            If covariance or noise is not known, the law has errors other than white noise or is of discrete time; or
            the trials cannot be used.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> law = cl.fit("x'' = -g - c v", drops.select(object=drops.objects[:4])).explain([])
        >>> print(law.update(drops.select(object="Ball 5", trial=1).until(2.0)))
        x'' = -9.856 ± 0.046 - (0.714 ± 0.011) v
        <BLANKLINE>
        with v = x', g [m/s²] = 9.856 ± 0.046, c [1/s] = 0.714 ± 0.011
        """
        return cast("Law", resolve_name("commonlaw.inference:adapt")(self, trials))

    def bounds(self, trials: Trials, terms: Sequence[str] | None = None, *, level: float = 0.95) -> "Bounds":
        """Say how large coefficients of absent terms, by default all of the library, could be unseen: see `Bounds`.

        Raises
        ------
        CommonlawError
            If there are more than 30 such terms, or one is named that is in the law or cannot be read.
        """
        return cast("Bounds", resolve_name("commonlaw.inference:bounds")(self, trials, terms, level=level))

    def discrepancy(
        self,
        trials: Trials,
        of: str | None = None,
        *,
        times: str = "1",
        equation: str | None = None,
        zero_at: float | Literal["auto"] | None = "auto",
        noise: Mapping[str, float] | None = None,
        huber_threshold: float = HUBER_THRESHOLD,
    ) -> "Discrepancy[Law]":
        """Find what the law leaves unexplained as a smooth function of a coordinate, the same for all objects.

        The function is a Gaussian process in the likelihood of the trajectories, fitted with the law's coefficients and
        all initial states; its amplitude and length scale are integrated out. Departures that differ from trial to
        trial are a random walk, if the evidence supports it.

        So that coefficients keep their meaning, the function is zero where the coordinate is zero, if that was nearly
        visited, and orthogonal over the visited samples to the other terms that are functions of the coordinate; where
        no zero was visited, and of time, to all such terms.

        Parameters
        ----------
        trials
            Of objects of the law.
        of
            The coordinate: a state, its rate, an input, time, or an expression of these and of the objects' properties
            such as ``abs(v)*diameter/1.5e-5``. Default: the variable of largest evidence, penalized for the choice.
        times
            A term that multiplies the function, such as ``v*abs(v)*diameter^2/mass``.
        equation
            The state in whose equation the function stands. Default: that of largest evidence.
        zero_at
            Where the function is zero, instead of the rule above; None for nowhere.
        noise, huber_threshold
            See `commonlaw.refine`.

        Raises
        ------
        CommonlawError
            If the law is of discrete time, its objects do not share their terms, or a coordinate cannot be read, is
            not finite or does not change.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05, quadratic=-0.02)
        >>> found = cl.fit("x'' = -g - c v", drops).discrepancy(drops, of="v")
        >>> found.claimed
        True
        """
        options: dict[str, Any] = {"times": times, "equation": equation, "zero_at": zero_at}
        find = resolve_name("commonlaw.discrepancy:discrepancy")
        found: Discrepancy[Law] = find(self, trials, of, noise=noise, huber_threshold=huber_threshold, **options)
        return found

    def residuals(self, trials: Trials) -> "Residuals":
        """Return the residuals of trials about the law's trajectories, with tests for their patterns.

        Each trial's initial state is fitted to all of its samples; coefficients stay fixed. Tests compare residuals
        with the noise, hold them against time, states, rates and inputs, and look for autocorrelation,
        heteroscedasticity and non-normality (Ljung and Box, Spearman, Shapiro and Wilk, F tests). P-values are adjusted
        for their number (Benjamini and Yekutieli 2001).

        Raises
        ------
        CommonlawError
            If the law is of discrete time, or the trials cannot be used.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> print(cl.fit("x'' = -g - c v", drops).residuals(drops))
        The residuals look like white noise: no pattern is significant.
        """
        return cast("Residuals", resolve_name("commonlaw.discrepancy:residuals")(self, trials))

    def assess(self, trials: Trials, learned: Trials | None = None) -> "LawVerdict":
        """Assess the law's forecasts: their error, reliable horizon and coverage, and what is uncertain.

        Trials are forecast from their first samples over all that follows, and compared with persistence.

        Parameters
        ----------
        trials
            What was measured.
        learned
            The part of it that the law was learned from, such as ``trials.until(70)`` or ``trials.select(trial=1)``:
            the assessment uses held-out trials and later samples. Without it, or if nothing was held out, it uses all
            trials and says so.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> law = cl.fit("x'' = -g - c v", drops.select(trial=1))
        >>> print(law.assess(drops, drops.select(trial=1)).sentences[0])
        This law can be used for forecasts up to 2.6 s ahead (longest horizon tested).
        """
        return cast("LawVerdict", resolve_name("commonlaw.verdict:judge")(self, trials, learned))

    def report(
        self, trials: Trials | TrialStream, learned: Trials | TrialStream | None = None, client: "Client | None" = None
    ) -> "Page":
        """Return the page of `commonlaw report` on the law: to be saved, or looked at in a notebook.

        Parameters
        ----------
        trials
            What was measured. All of a stream is forecast, and the page shows few objects that stand for all.
        learned
            What of it, or of others, the law was learned from, see `verdict`: ``law.report(*stream.split(trial=3))``.
        client
            A dask client, whose workers go through a stream.

        Raises
        ------
        CommonlawError
            If the law and the trials do not go together, or one of the others does not go with them.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05, trials=1)
        >>> cl.fit("x'' = -g - c v", drops).report(drops).html[:15]
        '<!DOCTYPE html>'
        """
        return cast("Page", resolve_name("commonlaw.report:law_page")(self, trials, learned, client))

    def simplify(self, tolerance: float = 2.0) -> "Simplification[Law]":
        """Return the law in its simplest form: numbers that are nearly zero, one, a ratio, or each other replaced.

        A number is replaced by zero, a ratio of small whole numbers, or another number of the law or its opposite,
        where that is shorter to write than its known digits (minimum description length; Rissanen 1983): 0.667 ± 0.001
        becomes 2/3, and 0.67 ± 0.05 stays. Numbers with units become zero or each other. The numbers that remain follow
        by the covariance. Equations are in the shortest of their equivalent forms; a part of a fraction that vanishes
        within its error is left out. Replacements hold for all objects.

        Parameters
        ----------
        tolerance
            Standard errors that the mean over objects may be off. All replacements together may be as improbable, of
            the mean and of all objects, by chi-square tests.

        Raises
        ------
        CommonlawError
            If the covariance is not known, objects have terms of their own, or SymPy is not installed.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(drag=(-0.1, -0.2), noise=0.001)
        >>> print(cl.fit("x'' = -g - c v + b v^2", drops).simplify().equations[0])
        x'' = -(c*v + g)
        """
        return cast("Simplification[Law]", resolve_name("commonlaw.law.simplify:simplified")(self, tolerance))

    # Laws of other objects, and with fewer parameters

    def average(self) -> "Law":
        """Return the law of one object, "average", whose coefficients are the mean over all objects.

        Their covariance is that of a mean, of objects that are independent unless they were partially pooled.
        """
        mean = self.coefficients.mean(axis=0, keepdims=True)
        others = self.uncertainty.map_other_laws(lambda law: law.average())
        return self._of_others(("average",), mean, self.uncertainty.average(), others)

    def select(self, objects: Sequence[str]) -> "Law":
        """Return the law of these objects only.

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        indices = [self.index(name) for name in objects]
        others = self.uncertainty.map_other_laws(lambda law: law.select(objects))
        return self._of_others(tuple(objects), self.coefficients[indices], self.uncertainty.select(indices), others)

    def _of_others(
        self,
        objects: tuple[str, ...],
        coefficients: Floats,
        uncertainty: Uncertainty,
        other_laws: "tuple[PlausibleLaw[Law], ...]",
    ) -> "Law":
        """Return a law of other objects, their uncertainty still that of all terms in this law."""
        kept = np.any(coefficients != 0, axis=0)[self.support]
        return replace(
            self,
            objects=objects,
            coefficients=coefficients,
            uncertainty=replace(uncertainty.restrict(kept), other_laws=other_laws),
            properties={name: self.properties[name] for name in objects if name in self.properties},
        )

    def with_others(self, other_laws: "tuple[PlausibleLaw[Law], ...]") -> "Law":
        """Return the law with these as what else it could be."""
        return replace(self, uncertainty=replace(self.uncertainty, other_laws=other_laws))

    def pool(self, universal: Bools | None = None, others: bool = True) -> "Law":
        """Return the law with each coefficient shrunk to its mean over objects, by its scatter beyond its errors.

        Objects count as drawn from one population (parametric empirical Bayes; Morris 1983); `history` has the
        shrinkage of each coefficient, `Uncertainty.shared_factor` how errors of objects now depend on each other.

        Parameters
        ----------
        universal
            Coefficients that all objects have in common, shape (equations, terms).
        others
            Whether the other coefficients are shrunk.

        Raises
        ------
        CommonlawError
            If the covariance is not known, or the law is pooled already.
        """
        return cast("Law", resolve_name("commonlaw.law.pooling:pooled")(self, universal, others))

    def explain(self, properties: Any = None) -> "Law":
        """Return the law with its coefficients as functions of the objects' properties, or the same for all objects.

        Each coefficient is universal, a power law of properties with small rational exponents (``0.25
        diameter^2/mass``), an affine function of properties where signs differ, or specific to the object; objects may
        scatter about it. The evidence decides, with a prior against properties. The coefficients become what their
        relations say, and more precise.

        Parameters
        ----------
        properties
            Names of known properties; or the properties, a mapping from object to values by name, or a table (a file, a
            frame) with a row for each object. Default: all numbers that are known of every object. Without any, ``[]``,
            coefficients are universal or object-specific.

        Raises
        ------
        CommonlawError
            If a property is not known or no number, objects have terms of their own, there is only one, or the
            covariance is not known.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> masses = zip(drops.objects, [0.3, 0.1, 0.1, 0.06, 0.043], strict=True)
        >>> law = cl.fit("x'' = -g - c v", drops)
        >>> print(law.explain({name: {"mass": mass} for name, mass in masses}))
        x'' = -9.806 ± 0.015 - (0.03009 ± 0.00010)/mass v
        <BLANKLINE>
        with v = x'
        """
        return cast("Law", resolve_name("commonlaw.law.pooling:explained")(self, properties))

    # Files

    @classmethod
    def from_text(
        cls,
        equations: str | Sequence[str],
        values: Mapping[str, float | Mapping[str, float]] | None = None,
        **names: Unpack[Names],
    ) -> "Law":
        """Return the law that equations state, for instance to simulate it; `commonlaw.fit` finds coefficients instead.

        Parameters
        ----------
        equations
            As they print, one for each state, in one text between semicolons or in several: ``"x'' = -9.81 - c v"``.
            Left-hand sides may be ``dT/dt`` and ``d2T/dt2`` too. What is neither a variable nor a number and multiplies
            or divides a term is a coefficient.
        values
            Of these coefficients by name: one number, or one for each object by its name.
        **names
            Of inputs and time, and units, see `Schema`.

        Raises
        ------
        CommonlawError
            If the text cannot be read, the message says at which character; or if a coefficient has no value.

        Examples
        --------
        >>> law = Law.from_text("T' = -k (T - 20)", {"k": {"cup": 0.1, "mug": 0.05}})
        >>> law.simulate([0.0, 10.0], [80.0])["cup"].states[-1].round(2)
        array([42.07])
        """
        return cls(*stated_law(equations, values or {}, **names))

    def to_json(self) -> str:
        """Return the law as JSON of a versioned schema."""
        return cast(bytes, resolve_name("commonlaw.law.io:encode")(self)).decode()

    @classmethod
    def from_json(cls, content: str | bytes) -> "Law":
        """Return the law that `to_json` wrote.

        Raises
        ------
        CommonlawError
            If the text is damaged, or written by another version of the schema.
        """
        decode = resolve_name("commonlaw.law.io:decode")
        return cast("Law", decode(content.encode() if isinstance(content, str) else content))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the law, whole or not at all: as JSON, or if the file is named ``.parquet`` with a row for each object.

        Raises
        ------
        CommonlawError
            If the file cannot be written, or must not: it is read-only, a folder, or one of several names of a file; or
            if it would not be read again, as of so many objects in JSON, or with numbers whose squares are infinite.
        """
        write_whole(path, resolve_name("commonlaw.law.io:law_bytes")(self, path))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Law":
        """Read a law that `save` wrote.

        Raises
        ------
        CommonlawError
            If the file cannot be read or is no law; the message names the file.
        """
        content = read_file(path)
        try:
            return cast("Law", resolve_name("commonlaw.law.io:decoded_file")(content))
        except CommonlawError as error:
            raise error.at(str(path)) from None
