"""The law that objects share."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats, same_content
from commonlaw.errors import CommonlawError, unknown
from commonlaw.integration import Event, Trajectory
from commonlaw.law import text
from commonlaw.law.deprecated import DeprecatedClassMembers, Structure, deprecated_member
from commonlaw.law.observation import Observation
from commonlaw.law.parse import Names, read_equations, stated_law
from commonlaw.law.provenance import History, Provenance
from commonlaw.law.simplification import Simplification
from commonlaw.law.uncertainty import PlausibleLaw, Uncertainty, checked
from commonlaw.library import Order, Terms, with_rates
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.outcomes import Outcome
from commonlaw.runtime.arguments import with_renamed_arguments
from commonlaw.runtime.files import write_whole
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.runtime.reading import read_file
from commonlaw.text import counted
from commonlaw.trials import Schema, Trials, TrialStream
from commonlaw.trials.trial import ObjectProperties, normalized

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client

    from commonlaw.discrepancy.function import Discrepancy
    from commonlaw.discrepancy.residual_tests import Residuals
    from commonlaw.forecast.forecast import Forecast, Metric
    from commonlaw.integration.vector_field import InputFunction
    from commonlaw.report.page import Page
    from commonlaw.verdict.law_verdict import LawVerdict


@dataclass(frozen=True, eq=False)
class Law(ShownInNotebooks, metaclass=DeprecatedClassMembers):
    """Equations that several objects share, with each object's own coefficients.

    A law is a value, equal to another if all is but how they were found. What follows from it is computed when it is
    asked for, by the packages above this one.

    Raises `CommonlawError` if there is no object or term, the terms are not over the variables of schema and order, or
    an array has another shape or a value that it cannot have.

    Parameters
    ----------
    terms
        Candidate terms over the states, the rates of those of second order, inputs and time.
    schema
        Names and units of what was measured; equation j gives the highest derivative of ``schema.states[j]``.
    order
        1 or 2, or where equations differ that of each, as ``(2, 1)``; 0 in discrete time, where equations give the
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
    observation
        How the states were measured, if not directly, see `commonlaw.fit`.
    """

    terms: Terms
    schema: Schema
    order: Order
    objects: tuple[str, ...]
    coefficients: Floats
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    provenance: Provenance = field(default_factory=Provenance)
    properties: ObjectProperties = field(default_factory=dict)
    observation: Observation | None = None

    def __post_init__(self) -> None:
        self._check_names()
        shape = (len(self.objects), len(self.schema.states), len(self.terms))
        values = checked(self.coefficients, "array of coefficients", "objects, equations, terms", shape)
        object.__setattr__(self, "coefficients", values)
        object.__setattr__(self, "uncertainty", self.uncertainty.checked(self.objects, self.support))
        object.__setattr__(self, "properties", normalized(self.properties))
        strangers = [name for name in self.properties if name not in self._indices]
        if strangers:
            raise CommonlawError("properties-of-others", objects=strangers)
        for probability, law in self.uncertainty.other_laws:
            same = (law.objects, law.order, law.schema.states) == (self.objects, self.order, self.schema.states)
            if not same or law.uncertainty.other_laws:
                raise CommonlawError("averaged-law-differs")
            if not 0 < probability < 1:
                raise CommonlawError("averaged-law-probability", probability=probability)
        if sum(law.probability for law in self.uncertainty.other_laws) >= 1:
            raise CommonlawError("averaged-laws-probability")

    def _check_names(self) -> None:
        _ = self.terms.parameters  # Refused if they have no terms of their own
        if not self.objects or not len(self.terms):
            raise CommonlawError("law-empty", part="term" if self.objects else "object")
        variables, schema = self.terms.variables, self.schema
        if isinstance(self.order, tuple) and (len(self.order) != len(schema.states) or {*self.order} != {1, 2}):
            raise CommonlawError("order-of-states", order=self.order, states=schema.states)
        order = text.order_in_words(self.order, schema.states)
        if schema.logarithmic and self.order != 1:
            raise CommonlawError("log-states-order", states=schema.logarithmic, order=order)
        states, rates = len(schema.states), len(with_rates(self.order, len(schema.states)))
        names = variables.states[:states], variables.inputs, variables.time, variables.logarithmic
        is_over = names == (schema.states, schema.inputs, schema.time, schema.logarithmic)
        if not is_over or len(variables.states) != states + rates:
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

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Law):
            return NotImplemented
        return self.structure == other.structure and same_content(self, other, ("provenance",))

    def __hash__(self) -> int:
        return hash((self.objects, self.schema.states, self.order, self.coefficients.shape))

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            return deprecated_member(self, name)

    @cached_property
    def _indices(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.objects)}

    @cached_property
    def _shares_terms(self) -> bool:
        return bool(np.all((self.coefficients != 0) == self.support))

    # Structure and text

    @cached_property
    def support(self) -> Bools:
        """Which terms are in which equation for at least one object, shape (equations, terms)."""
        return np.asarray(np.any(self.coefficients != 0, axis=0))

    @cached_property
    def structure(self) -> Structure:
        """Each equation with names for its parameters, ``x'' = a + b v``, or as it was given.

        Known coefficients that all objects share are numbers: ``x'' = -9.81 + a v``.
        """
        return Structure(_call("law.printing:structure", self))

    def equations(self, name: str | None = None, digits: int = 4, errors: bool | None = None) -> tuple[str, ...]:
        """Return the equations of one object as text: ``x'' = -9.34 ± 0.12 + (0.047 ± 0.010) v``.

        A law of given equations is written as these, with numbers for its parameters: ``N' = 0.8 N (1 - N/1.4)``.

        Raises `CommonlawError` if no object is named of several, or errors are asked for that are not known.

        Parameters
        ----------
        name
            The object, if there are several. Without it, a law from `explain` has the equations of all objects:
            ``x'' = -9.8 + 0.25 diameter^2/mass v^2``.
        digits
            Significant digits of coefficients without error.
        errors
            Whether to show standard errors; None shows them when they are known.
        """
        return cast(tuple[str, ...], _call("law.printing:equations", self, name, digits, errors))

    def __repr__(self) -> str:
        form = self.structure if self._shares_terms else ("each object with its own terms",)
        few = self.objects if len(self.objects) <= text.MANY else (counted(len(self.objects), "object"),)
        return f"<Law of {', '.join(few)}: {'; '.join(form)}>"

    def __str__(self) -> str:
        return cast(str, _call("law.printing:printed", self))

    def summary(self) -> str:
        """Return the law as it prints, its table of `params`, its `quantities`, and the best rows of its `comparison`.

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
        <BLANKLINE>
        object                  form       quantity symbol estimate standard error  low  high unit
        Ball 1 Fall with linear drag terminal speed    v_t     98.4            4.4 90.5 108.2  m/s
        Ball 1 Fall with linear drag  time constant      τ    10.08           0.53 9.13 11.25    s
        """
        return cast(str, _call("law.tables:summary", self))

    # Parameters and their uncertainty

    @property
    def params(self) -> "pd.DataFrame":
        """The parameters of every object, one row each, with standard errors and 95 % intervals.

        Columns are object, equation, term, parameter, estimate, standard error, low, high and unit, and where terms
        were chosen by evidence the inclusion probability. A row is a coefficient of a term, with its name in
        `structure`; in a law of given equations a parameter, with its first term. Intervals are averaged over `models`,
        see `conf_int`. What is not known is NaN or empty.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> law.params[["object", "parameter", "estimate", "standard error", "unit"]].head(2).round(3)
           object parameter  estimate  standard error  unit
        0  Ball 1         g     9.769           0.082  m/s²
        1  Ball 1         c     0.099           0.006   1/s
        """
        level = None if self.uncertainty.covariance is None else 0.95
        return cast("pd.DataFrame", _call("law.tables:parameter_frame", self, level))

    def conf_int(self, level: float = 0.95, averaged: bool = True) -> "pd.DataFrame":
        """Return `params` with intervals of another level, or given the terms of this law.

        Averaged over `models`, a coefficient is zero where its term is not in the law, so that the interval of a
        doubtful term tends to include zero. Errors follow Student's t distribution, with the degrees of freedom of the
        estimated noise.

        Raises `CommonlawError` if the covariance is not known, or the level is not between 0 and 1.
        """
        self.uncertainty.known_covariance()
        return cast("pd.DataFrame", _call("law.tables:parameter_frame", self, level, averaged))

    def cov_params(self, name: str | None = None) -> "pd.DataFrame":
        """Return the covariance of one object's parameters, by their names in rows and columns, to first order.

        Raises `CommonlawError` if it is not known, or the object is not named and there are several.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> float(law.cov_params("Ball 1").loc["g", "c"]) > 0
        True
        """
        return cast("pd.DataFrame", _call("law.tables:covariance_frame", self, name))

    def sample(self, n: int = 1000, seed: int = 0, averaged: bool = True) -> "pd.DataFrame":
        """Return draws of the parameters from their posterior, to propagate their uncertainty.

        Each is drawn from one of `models`, by their probabilities, with the covariance of that law over all objects,
        and is zero for terms that are not in it. The distribution is normal, or Student's t where the noise was
        estimated.

        Raises `CommonlawError` if the covariance is not known, or no draw is asked for.

        Parameters
        ----------
        n
            Draws of each object, the same for the same seed.
        averaged
            Whether to draw from all models, or from this one only.

        Returns
        -------
        pandas.DataFrame
            A row for each draw and object, which are its index; a column for each parameter of `structure`.

        Examples
        --------
        The terminal velocity of each object:

        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> draws = law.sample()
        >>> speeds = (draws["g"] / draws["c"]).groupby("object").quantile([0.025, 0.975]).unstack()
        >>> print(speeds.round(1).head(2).to_string(header=False, index_names=False))
        Ball 1  90.1  108.3
        Ball 2  31.7   33.7
        """
        return cast("pd.DataFrame", _call("law.tables:sample_frame", self, n, seed, averaged))

    def quantities(self, level: float = 0.95, initial: Mapping[str, float] | None = None) -> "pd.DataFrame":
        """Return what is quoted of laws of a known form: half-lives, carrying capacities, periods, terminal speeds.

        Columns are object, form, quantity, symbol, estimate, standard error, low, high and unit. Forms are recognised
        by the terms of the equations, whatever their names, see the documentation for a list of them; the modes of
        other linear laws and the equilibria of laws without inputs follow. Errors are those of the delta method;
        intervals have all values in the confidence ellipsoid of the coefficients, which for ratios are those of
        Fieller (1954), infinite where a denominator may be zero. They are NaN without covariance.

        Raises `CommonlawError` if a state is not known, or the level is not between 0 and 1.

        Parameters
        ----------
        level
            Of the intervals.
        initial
            Initial values by state, for what depends on them, such as the lag of a growth curve.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05).select(object="Ball 2"))
        >>> law.quantities()[["quantity", "estimate", "low", "high", "unit"]].round(2)
                 quantity  estimate    low   high unit
        0  terminal speed     32.67  31.70  33.74  m/s
        1   time constant      3.33   3.17   3.50    s
        """
        return cast("pd.DataFrame", _call("law.quantities:quantity_frame", self, level, initial))

    # Comparison with other models, and how the law was found

    @property
    def models(self) -> "tuple[PlausibleLaw[Law], ...]":
        """All laws with a posterior probability above 1 %, this one first; the probabilities add up to one.

        The others have coefficients and covariance of their own, and no record of how they were found.
        """
        others = self.uncertainty.other_laws
        return PlausibleLaw(1.0 - sum(each.probability for each in others), self), *others

    @property
    def comparison(self) -> "pd.DataFrame":
        """The candidates of each equation, from the best to the worst, with the difference of each from the best.

        Columns are equation, rank, terms, size, measure, score, difference, weight, further measures, proven (no other
        support of the size fits better) and chosen. The measure, lower is better, is ``2 log B``, twice the log Bayes
        factor of the best over the candidate (Kass and Raftery 1995), with the posterior probability as weight; ``log
        score difference`` where forecasts of held-out data chose the law; or the criterion of a regression. Empty for a
        law whose terms were given.
        """
        return cast("pd.DataFrame", _call("law.tables:comparison_frame", self.provenance.alternatives))

    @property
    def diagnostics(self) -> tuple[Outcome, ...]:
        """What a user should know of the law and of how it was found."""
        return self.provenance.outcomes

    @property
    def history(self) -> History:
        """Every choice on the way to the law; it prints as a table."""
        return History(self.provenance.history)

    # Right-hand side, simulation, forecasts

    def rhs(self, name: str, values: ArrayLike) -> Floats:
        """Return the right-hand side of one object as forecasts follow it: the highest derivatives, (n, equations).

        Coefficients are the pooled ones of the law if it has any, as these err less. Values are states, rates, inputs
        and time, shape (n, variables); without time where no term depends on it.

        Raises `CommonlawError` if there is no such object, or the values are not those of the variables.
        """
        return cast(Floats, _call("law.parameters:right_hand_side", self, name, values))

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
        inputs: "ArrayLike | InputFunction | Mapping[str, ArrayLike | InputFunction] | None" = None,
    ) -> dict[str, Trajectory]:
        """Integrate the law for every object; a divergence is an outcome of its trajectory.

        A law that was fitted with events changes its states there; it takes no other events, no dense output and no
        sensitivities.

        Raises `CommonlawError` if an input is not given, or the law lacks an object, or has not as many states as an
        initial state.

        Parameters
        ----------
        times
            When the states are wanted, shape (n,); the first is the time of the initial state.
        initial
            Initial states, then initial rates of those of second order: one vector for all objects, or by object.
        method, tolerance, events, dense
            See `commonlaw.integration.simulate`.
        sensitivities
            Whether to give the derivatives of states by coefficients in the support, row by row, and by initial states.
        doses
            Amounts by their times, of inputs that are doses: ``{"dose": {3.0: 60.0}}``.
        inputs
            Other inputs: at the times, shape (n,) or (n, inputs), between which they are as in the trials that the law
            was found in; as a function of time; or by name: ``{"voltage": lambda t: np.sin(t), "load": 2.0}``.
        """
        how = {"method": method, "tolerance": tolerance, "events": events, "dense": dense, "doses": doses}
        how["inputs"] = inputs
        has_events = self.observation is not None and self.observation.events
        function = "estimation:simulate_observed" if has_events else "forecast:simulate_law"
        found = _call(function, self, times, initial, sensitivities=sensitivities, **how)
        return cast(dict[str, Trajectory], found)

    @with_renamed_arguments
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
        input_interpolation: str | None = None,
        discrepancy: bool = False,
        averaged: bool = True,
    ) -> "Forecast":
        """Forecast each trial from its own initial state.

        Raises `CommonlawError` if the variables are not those of the law, an initial state cannot be fitted, or
        covariance, noise or discrepancy are asked for that the law does not have.

        Parameters
        ----------
        trials
            What to forecast, at all samples, measured or not. Unknown objects get coefficients from their properties,
            if `explain` found how, else mean ones, with wider intervals.
        times
            More times to forecast at after a trial's first sample, shape (m,). Inputs keep their last value.
        start
            How many of each trial's first measured samples determine its initial state. 1: states as measured, rates by
            the law's differentiation. 2 or more: the law is fitted to them by likelihood, coefficients fixed; this
            needs its noise, and states may be missing. ``"all"``: fits to whole trials, no forecasts. Default: 1; with
            known noise all that were measured where others follow, or as many as rates or latent states need.
        from_time
            When forecasts begin: all samples before, or the last `start` of them, determine the initial state. Trials
            without samples on both sides are left out, see `Forecast.trials.notes`.
        return_std
            Whether to compute intervals, from the covariances of coefficients and initial state to first order.
        method, tolerance
            See `commonlaw.integration.simulate`.
        seed
            Of the noise that shows how accurate estimated initial rates are.
        input_interpolation
            The interpolation of inputs: ``"held"`` at the earlier value, ``"linear"`` or ``"cubic"``; default as the
            law was learned.
        discrepancy
            Whether to include the discrepancy that was found with the law, see `discrepancy`.
        averaged
            Whether to average over `models`: forecasts are weighted medians, intervals those of the mixture.
        """
        if start not in (None, "all") and (not isinstance(start, Integral) or start < 1):
            raise CommonlawError("forecast-start", start=start)
        options = {
            "start": start,
            "from_time": from_time,
            "return_std": return_std,
            "input_interpolation": input_interpolation,
        }
        how = {"method": method, "tolerance": tolerance, "seed": seed, "discrepancy": discrepancy, "averaged": averaged}
        if self.observation is not None:
            if discrepancy:
                raise CommonlawError("discrepancy-forecast-observed")
            known = self, self.observation, trials
            return cast("Forecast", _call("estimation:predict_observed", *known, times=times, **options))
        return cast("Forecast", _call("forecast:predict", self, trials, times=times, **options, **how))

    # Comparison with measurements

    def score(self, trials: Trials, metric: "Metric" = "r2", *, start: int | None = None) -> float:
        """Return how well trials are forecast, the mean over states of a metric of scikit-learn.

        Raises `CommonlawError` if there is no such metric, or the trials cannot be forecast.

        Parameters
        ----------
        trials
            What was measured; missing values do not count.
        metric
            ``"r2"``, 1 - sum (y - f)^2 / sum (y - mean y)^2; ``"rmse"`` or ``"mae"``, in the unit of the state; or a
            function of measurements and forecasts of a state, shape (n,) each.
        start
            How many first samples of each trial determine its initial state, see `predict`.
        """
        return self.predict(trials, start=start).metric(metric)

    def residuals(self, trials: Trials) -> "Residuals":
        """Return the residuals of trials about the law's trajectories, with tests for their patterns.

        Each trial's initial state is fitted to all of its samples; coefficients stay fixed. Tests compare residuals
        with the noise, with time, states, rates and inputs, and look for autocorrelation, heteroscedasticity and
        non-normality (Ljung and Box, Spearman, Shapiro and Wilk, F tests). P-values are adjusted for their number
        (Benjamini and Yekutieli 2001).

        Raises `CommonlawError` if the law is of discrete time, or the trials cannot be used.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> print(cl.fit("x'' = -g - c v", drops).residuals(drops))
        The residuals look like white noise: no pattern is significant.
        """
        return cast("Residuals", _call("discrepancy:residuals", self, trials))

    def assess(self, trials: Trials, learned: Trials | None = None) -> "LawVerdict":
        """Assess the law's forecasts: their error, reliable horizon and coverage, and what is uncertain.

        Trials are forecast from their first samples over all that follows, and compared with persistence. Where the
        part is given that the law was `learned` from, such as ``trials.until(70)``, only the rest is assessed.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> law = cl.fit("x'' = -g - c v", drops.select(trial=1))
        >>> print(law.assess(drops, drops.select(trial=1)).sentences[0])
        This law can be used for forecasts up to 2.6 s ahead (longest horizon tested).
        """
        return cast("LawVerdict", _call("verdict:judge", self, trials, learned))

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
        """Estimate the discrepancy: the residuals as a smooth function of a coordinate, the same for all objects.

        The function is a Gaussian process in the likelihood of the trajectories, fitted with the coefficients and all
        initial states; its amplitude and length scale are integrated out. Departures that differ between trials are a
        random walk, if the evidence supports it. The function is zero where the coordinate is, if that was nearly
        visited, and orthogonal over the samples to the law's other terms in the coordinate, so that these keep their
        meaning.

        Raises `CommonlawError` if the law is of discrete time, its objects do not share their terms, or a coordinate
        cannot be read, is not finite or does not change.

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

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05, quadratic=-0.02)
        >>> found = cl.fit("x'' = -g - c v", drops).discrepancy(drops, of="v")
        >>> found.claimed
        True
        """
        options: dict[str, Any] = {"times": times, "equation": equation, "zero_at": zero_at}
        options |= {"noise": noise, "huber_threshold": huber_threshold}
        return cast("Discrepancy[Law]", _call("discrepancy:discrepancy", self, trials, of, **options))

    def report(
        self, trials: Trials | TrialStream, learned: Trials | TrialStream | None = None, client: "Client | None" = None
    ) -> "Page":
        """Return the page of `commonlaw report` on the law, to save it or to show it in a notebook.

        See `assess` for what the law was `learned` from: ``law.report(*stream.split(trial=3))``. All of a stream is
        forecast, by the workers of a dask client if one is given, and the page shows few objects that stand for all.

        Raises `CommonlawError` if law and trials have other variables.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05, trials=1)
        >>> cl.fit("x'' = -g - c v", drops).report(drops).html[:15]
        '<!DOCTYPE html>'
        """
        return cast("Page", _call("report:law_page", self, trials, learned, client))

    # Laws that follow from this one

    def update(self, trials: Trials) -> "Law":
        """Return the law of the objects of new trials, with coefficients updated by these trials.

        The prior of an object's coefficients is what `predict` would take: its own, or those that follow from its
        properties or are typical, with their covariance. The likelihood of the trials, with free initial states,
        updates it to first order. Trials that the law was learned from would count twice. Of laws with observation
        equations the parameters are updated, with those of the law, of its own objects, as a normal prior.

        Raises `CommonlawError` if covariance or noise is not known, the law has errors other than white noise or is of
        discrete time; or the trials cannot be used.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> law = cl.fit("x'' = -g - c v", drops.select(object=drops.objects[:4])).explain([])
        >>> print(law.update(drops.select(object="Ball 5", trial=1).until(2.0)).equations()[0])
        x'' = -9.856 ± 0.046 - (0.714 ± 0.011) v
        """
        return cast("Law", _call("inference:adapt", self, trials))

    def simplify(self, tolerance: float = 2.0) -> "Simplification[Law]":
        """Return the law in its simplest form: numbers that are nearly zero, one, a ratio, or each other replaced.

        A number is replaced by zero, a ratio of small whole numbers, or another number of the law or its opposite,
        where that is shorter to write than its known digits (minimum description length; Rissanen 1983): 0.667 ± 0.001
        becomes 2/3, and 0.67 ± 0.05 stays. Numbers with units become zero or each other. The remaining numbers follow
        by the covariance. Equations are in the shortest of their equivalent forms; a part of a fraction that vanishes
        within its error is left out. The mean over objects may be `tolerance` standard errors off; all replacements
        together may be as improbable, of the mean and of all objects, by chi-square tests.

        Raises `CommonlawError` if the covariance is not known, objects have terms of their own, or SymPy is not
        installed.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(drag=(-0.1, -0.2), noise=0.001)
        >>> print(cl.fit("x'' = -g - c v + b v^2", drops).simplify().equations[0])
        x'' = -(c*v + g)
        """
        return cast("Simplification[Law]", _call("law.simplify:simplified", self, tolerance))

    def explain(self, properties: Any = None) -> "Law":
        """Return the law with its coefficients as functions of the objects' properties, or the same for all objects.

        Each coefficient is universal, a power law of properties with small rational exponents (``0.25
        diameter^2/mass``), an affine function of properties where signs differ, or object-specific; objects may scatter
        about it. The evidence decides, with a prior against properties. Coefficients become what their relations give.

        Raises `CommonlawError` if a property is not known or no number, objects have terms of their own, there is only
        one, or the covariance is not known.

        Parameters
        ----------
        properties
            Names of known properties; or a mapping from object to values by name; or a table (a file, a frame) with a
            row for each object. Default: all numbers that are known of every object; ``[]`` for none.

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
        return cast("Law", _call("law.pooling:explained", self, properties))

    def select(self, objects: Sequence[str]) -> "Law":
        """Return the law of these objects only.

        Raises `CommonlawError` if the law has no such object.
        """
        indices = [object_index(self, name) for name in objects]
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

    # Files

    @classmethod
    def from_text(
        cls,
        equations: str | Sequence[str],
        values: Mapping[str, float | Mapping[str, float]] | None = None,
        **names: Unpack[Names],
    ) -> "Law":
        """Return the law that equations state, for instance to simulate it; `commonlaw.fit` finds coefficients instead.

        Raises `CommonlawError` if the text cannot be read, the message says at which character; or if a coefficient has
        no value.

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

        Examples
        --------
        >>> law = Law.from_text("T' = -k (T - 20)", {"k": {"cup": 0.1, "mug": 0.05}})
        >>> law.simulate([0.0, 10.0], [80.0])["cup"].states[-1].round(2)
        array([42.07])
        """
        return cls(*stated_law(equations, values or {}, **names))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the law, whole or not at all: as JSON, or if the file is named ``.parquet`` with a row for each object.

        Raises `CommonlawError` if the file cannot be written, is read-only, a folder or one of several names of a file;
        or if the law could not be read again, for too many objects in JSON, or numbers whose squares are infinite.
        """
        write_whole(path, _call("law.io:law_bytes", self, path))

    def export(self, path: str | os.PathLike[str], name: str | None = None, initial: "ArrayLike | None" = None) -> None:
        """Write the law as a program of another language, by the ending of the file.

        ``.c`` C, ``.py`` Python, ``.m`` MATLAB, ``.mo`` Modelica, ``.xml`` or ``.sbml`` SBML (level 3, rate rules), and
        ``.xlsx`` a workbook whose formulas integrate the law. Files hold the parameters of all objects, SBML those of
        one. Inputs are arguments or, in SBML and workbooks, zero until they are set. Observation equations stay here.

        Raises `CommonlawError` if the ending is another, the file cannot be written, SBML is asked for several objects,
        or the law is in discrete time, or has doses, dead times or events.

        Parameters
        ----------
        name
            The object; default: all.
        initial
            Initial states, then initial rates; default: the middle of the measured range, or 1.
        """
        write_whole(path, _call("law.export:exported", self, path, name, initial))

    @classmethod
    def load(cls, path: str | os.PathLike[str], functions: Iterable[Callable[..., Any]] = ()) -> "Law":
        """Read a law that `save` wrote; the functions of Python that its terms call have to be given again.

        Raises `CommonlawError` if the file cannot be read or is no law, or a function is missing; the message names the
        file.
        """
        content = read_file(path)
        try:
            return cast("Law", _call("law.io:decoded_file", content, functions))
        except CommonlawError as error:
            raise error.at(str(path)) from None


def average_law(law: Law) -> Law:
    """Return the law of one object, "average", whose coefficients are the mean over all objects.

    Their covariance is that of a mean, of objects that are independent unless they were partially pooled.
    """
    mean = law.coefficients.mean(axis=0, keepdims=True)
    others = law.uncertainty.map_other_laws(average_law)
    return law._of_others(("average",), mean, law.uncertainty.average(), others)


def object_index(law: Law, name: object) -> int:
    """Return the index of an object among those of a law; refuse one that it does not have."""
    index = law._indices.get(str(name))
    if index is None:
        raise unknown("object of this law", name, law.objects)
    return index


def only_object(law: Law, name: str | None) -> str:
    """Return the name of an object that was given, or that is the only one."""
    if name is None and len(law.objects) > 1:
        raise CommonlawError("several-objects", objects=", ".join(law.objects))
    return law.objects[0] if name is None else name


def shares_terms(law: Law) -> bool:
    """Return whether every object has the same terms."""
    return law._shares_terms


def with_other_laws(law: Law, other_laws: tuple[PlausibleLaw[Law], ...]) -> Law:
    """Return a law with these as its plausible other laws."""
    return replace(law, uncertainty=replace(law.uncertainty, other_laws=other_laws))


def _call(function: str, *arguments: Any, **settings: Any) -> Any:
    """Return what a function of a module above this one returns, which imports laws itself."""
    return resolve_name(f"commonlaw.{function}")(*arguments, **settings)
