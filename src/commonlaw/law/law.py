"""The law that objects share."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Literal, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats, same_content
from commonlaw.diagnostics import Outcome
from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.integration import BETWEEN, METHODS, Event, OutputOptions, Trajectory
from commonlaw.law import text
from commonlaw.law.observation import STATES, Observation, Scheme, TrialEstimates
from commonlaw.law.parse import GivenEquations, Names, read_equations, stated_law
from commonlaw.law.provenance import History, Provenance
from commonlaw.law.restrictions import Restrictions
from commonlaw.law.uncertainty import PlausibleLaw, Uncertainty, check_positive, checked
from commonlaw.library import Order, Terms, with_rates
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.runtime.arguments import check_types, check_whole_number, checks_types, numbers_of
from commonlaw.runtime.files import read_file, write_whole
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.text import counted
from commonlaw.trials import Schema, Trials, TrialStream
from commonlaw.trials.trial import ObjectProperties, normalized

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client

    from commonlaw.discovery.textbook import TextbookLaw
    from commonlaw.discrepancy.function import Discrepancy
    from commonlaw.discrepancy.residual_tests import Residuals
    from commonlaw.forecast.forecast import Forecast, Metric
    from commonlaw.integration.vector_field import InputFunction
    from commonlaw.law.simplification import Simplification
    from commonlaw.law.verdict import LawVerdict
    from commonlaw.report.page import Page


@dataclass(frozen=True, eq=False)
class Law(ShownInNotebooks):
    """Differential equations that several objects share, with object-specific coefficients.

    ``x_j' = sum_k c_ojk phi_k(x, u, t)`` for object o, or ``x_j''`` in equations of second order. A law is immutable;
    two laws are equal if all but their provenance is.

    Raises `CommonlawError` if there is no object or term, if the terms do not match schema and order, or if an array
    has a wrong shape or an invalid value.

    Parameters
    ----------
    terms
        Candidate terms over the states, the rates of those of second order, inputs and time.
    schema
        Names and units of the variables; equation j gives the highest derivative of ``schema.states[j]``.
    order
        1 or 2, or one for each equation, ``(2, 1)``; 0 in discrete time, where the equations give the states of the
        next sample.
    objects
        Names of the objects.
    coefficients
        Shape (objects, equations, terms).
    uncertainty
        Covariance of the coefficients, noise, relations to properties, and plausible other laws.
    provenance
        How the law was found.
    properties
        Of the objects, by object and name; their units are in ``schema.units``.
    observation
        What was measured: the states themselves, unless observation equations say otherwise, see `commonlaw.fit`.
    restrictions
        Of the parameters; None where none are on record, as of a law that was discovered.
    scheme
        How the law is fitted and forecast: "collocation", or "shooting", which observation equations, initial values
        and events need.
    trial_estimates
        Initial values of trials and what else differs between them, of a law that is fitted by shooting.

    See Also
    --------
    discover : Discover the law of trials.
    fit : Fit given equations to trials.
    refine : Refit a law to other trials.
    compare : Compare laws by their evidence.
    """

    terms: Terms
    schema: Schema
    order: Order
    objects: tuple[str, ...]
    coefficients: Floats
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    provenance: Provenance = field(default_factory=Provenance)
    properties: ObjectProperties = field(default_factory=dict)
    observation: Observation = STATES
    restrictions: Restrictions | None = None
    scheme: Scheme = "collocation"
    trial_estimates: TrialEstimates = field(default_factory=TrialEstimates)
    _given: GivenEquations | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._check_names()
        check_choice("scheme", self.scheme, get_args(Scheme))
        if self.scheme == "collocation" and self.observation.is_of_more:
            raise CommonlawError("law-beyond-collocation")
        if self.scheme == "collocation" or self.observation is STATES:
            object.__setattr__(self, "observation", Observation.direct(self.schema))
        object.__setattr__(self, "trial_estimates", TrialEstimates(self.trial_estimates))
        shape = (len(self.objects), len(self.schema.states), len(self.terms))
        values = checked(self.coefficients, "array of coefficients", "objects, equations, terms", shape)
        object.__setattr__(self, "coefficients", values)
        uncertainty = self.uncertainty.checked(self.objects, self.support, self.observation.measured.states)
        object.__setattr__(self, "uncertainty", uncertainty)
        if self.scheme == "shooting" and uncertainty.noise is not None:
            for name, level in zip(self.observation.measured.states, uncertainty.noise.tolist(), strict=True):
                check_positive(name, level)
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
        self._read_equations()

    def _read_equations(self) -> None:
        """Read the given equations, unless those of the law that this one replaces are the same."""
        texts, known = self.provenance.equations, (self.terms, self.order)
        if not texts:
            object.__setattr__(self, "_given", None)
        elif self._given is None or (self._given.texts, self._given.terms, self._given.order) != (texts, *known):
            given = read_equations(texts, self.schema, self.terms.variables)
            if (given.terms, given.order) != known:
                raise CommonlawError("law-terms-and-equations", terms=self.terms.names, equations=given.texts)
            object.__setattr__(self, "_given", given)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Law):
            return NotImplemented
        return self.structure == other.structure and same_content(self, other, ("provenance",))

    def __hash__(self) -> int:
        return hash((self.objects, self.schema.states, self.order, self.coefficients.shape))

    @cached_property
    def _indices(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.objects)}

    @cached_property
    def _shares_terms(self) -> bool:
        # A parameter of given equations may be zero, as at its bound
        return bool(self.provenance.equations) or bool(np.all((self.coefficients != 0) == self.support))

    # Structure and text

    @cached_property
    def support(self) -> Bools:
        """Terms with a nonzero coefficient for at least one object, shape (equations, terms)."""
        return np.asarray(np.any(self.coefficients != 0, axis=0))

    @cached_property
    def structure(self) -> tuple[str, ...]:
        """Equations with names for the parameters: ``x'' = a + b v``; given equations as they were written.

        Known shared coefficients are numbers: ``x'' = -9.81 + a v``.
        """
        from commonlaw.law.printing import structure

        return tuple(structure(self))

    @checks_types
    def equations(self, name: str | None = None, digits: int = 4, errors: bool | None = None) -> tuple[str, ...]:
        """Return the equations of one object as text: ``x'' = -9.34 ± 0.12 + (0.047 ± 0.010) v``.

        Given equations keep their form, with numbers for the parameters: ``N' = 0.8 N (1 - N/1.4)``.

        Raises `CommonlawError` if the law has several objects and none is named, or if standard errors are not known.

        Parameters
        ----------
        name
            The object, if there are several. Without it, a law from `explain` has the equations of all objects:
            ``x'' = -9.8 + 0.25 diameter^2/mass v^2``.
        digits
            Significant digits of coefficients without error, 1 to 17.
        errors
            Whether to show standard errors; None shows them when they are known.
        """
        check_whole_number("digits", digits, 1, 17)
        from commonlaw.law.printing import equations

        return equations(self, name, digits, errors)

    def __repr__(self) -> str:
        form = self.structure if self._shares_terms else ("each object with its own terms",)
        few = self.objects if len(self.objects) <= text.MANY else (counted(len(self.objects), "object"),)
        return f"<Law of {', '.join(few)}: {'; '.join(form)}>"

    def __str__(self) -> str:
        from commonlaw.law.printing import printed

        return printed(self)

    def summary(self) -> str:
        """Return the law, its `params`, its `quantities` and the best rows of its `comparison` as text.

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
        Ball 1      x''    1         g    9.769          0.075  9.619  9.918 m/s²
        Ball 1      x''    v         c   0.0992         0.0052 0.0889 0.1096  1/s
        <BLANKLINE>
        object                  form       quantity symbol estimate standard error  low  high unit
        Ball 1 Fall with linear drag terminal speed    v_t     98.4            4.4 90.5 108.2  m/s
        Ball 1 Fall with linear drag  time constant      τ    10.08           0.53 9.13 11.25    s
        """
        from commonlaw.law.tables import summary

        return summary(self)

    # Parameters and their uncertainty

    @property
    def params(self) -> "pd.DataFrame":
        """Table of the parameters of all objects with standard errors and 95 % intervals.

        Columns: object, equation, term, parameter, estimate, standard error, low, high and unit; for terms chosen by
        evidence also the inclusion probability. Parameters have their names in `structure`; a parameter of given
        equations has its first term. Standard errors and intervals are conditional on the terms of this law.
        Unknown values are NaN or empty. A parameter that has a limit on one side only, such as a rate too fast to be
        measured, has no standard error, and an interval with one end; its estimate is the value that forecasts follow.

        See Also
        --------
        conf_int, cov_params, sample, quantities

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> law.params[["object", "parameter", "estimate", "standard error", "unit"]].head(2).round(3)
           object parameter  estimate  standard error  unit
        0  Ball 1         g     9.769           0.082  m/s²
        1  Ball 1         c     0.099           0.006   1/s
        """
        from commonlaw.law.tables import parameter_frame

        return parameter_frame(self)

    @checks_types
    def conf_int(self, level: float = 0.95, averaged: bool = False) -> "pd.DataFrame":
        """Return `params` with intervals of another level, or averaged over `models`.

        By default intervals are conditional on the terms of this law, as the standard errors are. In the average over
        `models` a coefficient is zero where its term is absent, so that the interval of a doubtful term tends to
        include zero, and may not contain the estimate. Quantiles are those of Student's t distribution with the degrees
        of freedom of the noise estimate.

        Raises `CommonlawError` if the covariance is not known, or the level is not between 0 and 1.
        """
        self.uncertainty.known_covariance()
        from commonlaw.law.tables import parameter_frame

        return parameter_frame(self, level, averaged)

    @checks_types
    def cov_params(self, name: str | None = None) -> "pd.DataFrame":
        """Return the covariance matrix of the parameters of one object, with their names as rows and columns.

        It is given the parameters that have a limit on one side only, whose rows and columns are zero.

        Raises `CommonlawError` if it is not known, or if there are several objects and none is named.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05))
        >>> float(law.cov_params("Ball 1").loc["g", "c"]) > 0
        True
        """
        from commonlaw.law.tables import covariance_frame

        return covariance_frame(self, name)

    @checks_types
    def sample(self, n: int = 1000, seed: int = 0, averaged: bool = True) -> "pd.DataFrame":
        """Return posterior draws of the parameters, to propagate their uncertainty.

        Each draw is from one of `models`, chosen with its probability, with the covariance of that law over all
        objects; absent terms are zero. The distribution is normal, or Student's t if the noise was estimated.
        Parameters that have a limit on one side only have their estimates in each draw, and others are given these.

        Raises `CommonlawError` if the covariance is not known, or if `n` is not positive.

        Parameters
        ----------
        n
            Number of draws for each object.
        averaged
            Whether to draw from all `models`, or only from this law.

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
        Ball 1  90.4  109.1
        Ball 2  31.7   33.6
        """
        from commonlaw.law.tables import sample_frame

        return sample_frame(self, n, seed, averaged)

    @checks_types
    def quantities(self, level: float = 0.95, initial: Mapping[str, float] | None = None) -> "pd.DataFrame":
        """Return derived quantities of laws of a known form: half-life, carrying capacity, period, terminal speed.

        Columns: object, form, quantity, symbol, estimate, standard error, low, high and unit. The form is recognized by
        the terms of the equations, see the documentation for a list; then come the modes of other linear laws and the
        equilibria of laws without inputs. Standard errors are those of the delta method. An interval has all values
        within the confidence ellipsoid of the coefficients; for ratios it is that of Fieller (1954), infinite where the
        denominator may be zero. Without a covariance both are NaN. Fits that did not converge, or
        whose solutions diverge, have no quantities.

        Raises `CommonlawError` if there is no such state, or the level is not between 0 and 1.

        Parameters
        ----------
        level
            Probability of the intervals.
        initial
            Initial values by state, for quantities that depend on them, such as the lag of a growth curve.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05).select(object="Ball 2"))
        >>> law.quantities()[["quantity", "estimate", "low", "high", "unit"]].round(2)
                 quantity  estimate    low   high unit
        0  terminal speed     32.67  31.70  33.74  m/s
        1   time constant      3.33   3.17   3.50    s
        """
        from commonlaw.law.quantities import quantity_frame

        return quantity_frame(self, level, initial)

    # Comparison with other models, and how the law was found

    @property
    def models(self) -> "tuple[PlausibleLaw[Law], ...]":
        """Plausible laws with their posterior probabilities above 1 %, this law first; they add up to one.

        Each has its coefficients and their covariance; only this law has its provenance.
        """
        others = self.uncertainty.other_laws
        return PlausibleLaw(1.0 - sum(model.probability for model in others), self), *others

    @property
    def comparison(self) -> "pd.DataFrame":
        """Table of the candidates of each equation, ranked by their score.

        Columns: equation, rank, terms, size, measure, score, difference from the best, weight, further measures, proven
        (no other support of this size fits better) and chosen. The measure, lower is better, is ``2 log B``, twice the
        log Bayes factor of the best over the candidate (Kass and Raftery 1995), with the posterior probability as
        weight; ``log score difference`` where forecasts of held-out data chose the law; or the criterion of a
        regression. Empty for a law whose terms were given.
        """
        from commonlaw.law.tables import comparison_frame

        return comparison_frame(self.provenance.alternatives)

    @property
    def diagnostics(self) -> tuple[Outcome, ...]:
        """Notes on the law, such as lack of fit or confounded variables, each with a code."""
        return self.provenance.outcomes

    @property
    def history(self) -> History:
        """Choices of the search in order, with their reasons; prints as a table."""
        return History(self.provenance.history)

    # Right-hand side, simulation, forecasts

    @checks_types
    def rhs(self, name: str, values: ArrayLike) -> Floats:
        """Return the highest derivatives of one object, shape (n, equations).

        The coefficients are those of forecasts: partially pooled, if the law is. `values` are states, rates, inputs and
        time, shape (n, variables), without time if no term depends on it.

        Raises `CommonlawError` if there is no such object, or the values do not match the variables.
        """
        from commonlaw.law.parameters import right_hand_side

        return right_hand_side(self, name, values)

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
        """Integrate the law of every object from given initial states.

        A trajectory that diverges has an outcome and NaN from there on. A law that was fitted with events changes its
        states there. One with events or delayed inputs takes no other events, no dense output and no sensitivities.

        Raises `CommonlawError` if an input is missing, an object is not in the law, or an initial state has another
        number of states.

        Parameters
        ----------
        times
            Output times, shape (n,); the first is that of the initial state.
        initial
            Initial states, then initial rates of states of second order: one vector for all objects, or by object.
        method, tolerance, events, dense
            See `commonlaw.integration.simulate`.
        sensitivities
            Whether to compute the derivatives of the states by the coefficients in the support and by the initial
            states.
        doses
            Amounts by time, for inputs that are doses: ``{"dose": {3.0: 60.0}}``.
        inputs
            Other inputs: values at the times, shape (n,) or (n, inputs), interpolated as in the training data; a
            function of time; or either by name: ``{"voltage": lambda t: np.sin(t), "load": 2.0}``.
        """
        arguments = locals()
        OutputOptions(tolerance)
        check_choice("method of integration", method, METHODS)
        check_types(Law.simulate, arguments)
        from commonlaw.forecast import simulate_law

        return simulate_law(
            self,
            times,
            initial,
            method=method,
            tolerance=tolerance,
            doses=doses,
            inputs=inputs,
            events=events,
            dense=dense,
            sensitivities=sensitivities,
        )

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
        seed: int | None = None,
        input_interpolation: str | None = None,
        discrepancy: bool = False,
        averaged: bool = True,
    ) -> "Forecast":
        """Forecast each trial from its initial state, estimated from its first samples.

        Raises `CommonlawError` if the variables do not match the law, an initial state cannot be fitted, the law lacks
        the covariance, noise or discrepancy that an option needs, or an option has no effect for a law of its kind, as
        `start` or `from_time` where the law gives all initial values, ``x(0) = a``.

        Parameters
        ----------
        trials
            Trials to forecast, at all samples, measured or not. New objects get coefficients from their properties, if
            the law is from `explain`, else the mean ones, with wider intervals.
        times
            Further forecast times after a trial's first sample, shape (m,). Inputs keep their last value.
        start
            Number of first samples of each trial that determine its initial state. 1: states as measured, rates by the
            law's differentiation. 2 or more: maximum likelihood with fixed coefficients, which needs the noise of the
            law; states may be missing. ``"all"``: a fit to whole trials, not a forecast. Default: 1; with known noise
            all measured samples if later ones follow, or as many as rates or latent states need. With observation
            equations any number is of maximum likelihood; parameters that differ between trials need all by default.
        from_time
            Time at which forecasts begin: all samples before it, or the last `start` of them, determine the initial
            state. Trials without samples on both sides are left out, see `Forecast.trials.notes`.
        return_std
            Whether to compute intervals, from the covariances of coefficients and initial state to first order. They
            reach the forecasts with a parameter that has only a limit at this limit, and far beyond it.
        method, tolerance
            See `commonlaw.integration.simulate`. Laws with observation equations, and in discrete time, have a method
            of their own; laws in discrete time are exact within any tolerance.
        seed
            Of the simulated noise from which the error of estimated initial rates follows, by default 0; for states of
            second order without observation equations.
        input_interpolation
            The interpolation of inputs in continuous time: ``"held"`` at the earlier value, ``"linear"``, ``"cubic"``,
            or ``"jumps"`` between splines, at unknown times between two samples; default as the law was learned.
        discrepancy
            Whether to include the discrepancy that was found with the law, see `discrepancy`.
        averaged
            Whether to average over `models`: weighted medians, and intervals of the mixture.

        See Also
        --------
        simulate : Integrate from given initial states.
        assess : Forecast error, horizon and coverage on held-out trials.
        update : Update the coefficients by new trials.
        """
        arguments = locals()
        is_all = isinstance(start, str) and start == "all"
        if not (start is None or is_all) and (not isinstance(start, Integral) or start < 1):
            raise CommonlawError("forecast-start", start=start)
        OutputOptions(tolerance)
        check_choice("method of integration", method, METHODS)
        check_whole_number("seed", seed, 0, optional=True)
        if input_interpolation is not None:
            check_choice("interpolation of inputs between samples", input_interpolation, BETWEEN)
            if self.order == 0 or not self.schema.inputs:
                kind = "a law in discrete time" if self.order == 0 else "a law without inputs"
                option = f"input_interpolation={input_interpolation!r}"
                raise CommonlawError("option-without-effect", option=option, kind=kind)
        check_types(Law.predict, arguments)
        further = numbers_of("times", [] if times is None else times)
        if not np.isfinite(further).all():
            raise CommonlawError("forecast-times")
        if further.size and self.order == 0:
            raise CommonlawError("forecast-times-discrete")
        from commonlaw.forecast import predict

        return predict(
            self,
            trials,
            times=times,
            start=start,
            from_time=from_time,
            return_std=return_std,
            method=method,
            tolerance=tolerance,
            seed=seed,
            input_interpolation=input_interpolation,
            discrepancy=discrepancy,
            averaged=averaged,
        )

    # Comparison with measurements

    @checks_types
    def score(self, trials: Trials, metric: "Metric" = "r2", *, start: int | None = None) -> float:
        """Return the score of forecasts by a metric of scikit-learn, averaged over states.

        Raises `CommonlawError` if there is no such metric, or the trials cannot be forecast.

        Parameters
        ----------
        trials
            Measurements; missing values do not count.
        metric
            ``"r2"``, 1 - sum (y - f)^2 / sum (y - mean y)^2; ``"rmse"`` or ``"mae"``, in the unit of the state; or a
            function of measurements and forecasts of a state, shape (n,) each.
        start
            Number of first samples that determine the initial state, see `predict`.
        """
        return self.predict(trials, start=start).metric(metric)

    @checks_types
    def residuals(self, trials: Trials) -> "Residuals":
        """Return the residuals of trials about the trajectories of the law, with tests for patterns.

        The initial state of each trial is fitted to all of its samples; coefficients are fixed. F tests compare the
        size with the noise and look for trends with time, states, rates and inputs; others for autocorrelation (Ljung
        and Box), heteroscedasticity (Spearman) and non-normality (Shapiro and Wilk). P-values are adjusted for the
        number of tests (Benjamini and Yekutieli 2001).

        Raises `CommonlawError` if the law is in discrete time, or the trials do not match it.

        See Also
        --------
        discrepancy : Estimate the missing function.
        assess : Forecast error, horizon and coverage.
        commonlaw.plots.plot_residuals

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> print(cl.fit("x'' = -g - c v", drops).residuals(drops))
        The residuals look like white noise: no pattern is significant.
        """
        from commonlaw.discrepancy import residuals

        return residuals(self, trials)

    @checks_types
    def assess(self, trials: Trials, learned: Trials | None = None) -> "LawVerdict":
        """Assess the forecasts of the law: error, reliable horizon, coverage of the bands, uncertain coefficients.

        Trials are forecast from their first samples and compared with a constant forecast (persistence). If `learned`,
        the training part of the trials such as ``trials.until(70)``, is given, only the rest is assessed.

        See Also
        --------
        predict : Forecast trials.
        residuals : Tests of the fit.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> law = cl.fit("x'' = -g - c v", drops.select(trial=1))
        >>> print(law.assess(drops, drops.select(trial=1)).sentences[0])
        This law can be used for forecasts up to 2.6 s ahead (longest horizon tested).
        """
        from commonlaw.verdict import assess

        return assess(self, trials, learned)

    @checks_types
    def textbook(self, trials: Trials, learned: Trials | None = None) -> "TextbookLaw":
        """Return the law of textbooks nearest to this one: its evidence, its forecasts, and what it leaves unexplained.

        Named models with the states, inputs and order of the law are compared, if their parameters are factors of
        terms; the means of coefficients over objects have the signs of the model, and columns its units, as far as
        they are known. The nearest has the largest evidence; one whose variables have the names of the columns, as T or
        theta, comes before others. 2 log B is that of `commonlaw.compare` under the error model of the law. Forecasts
        are assessed as by `Law.assess`, and what is left are residuals beyond the noise of the law. If the law has the
        terms and signs of a named model with as many parameters, it is this one.

        Raises `CommonlawError` if no named model has the states, inputs and order of the law, or the law is in discrete
        time, has latent states, observation equations or relations to properties, or terms that differ between objects.

        See Also
        --------
        named_models : The models.
        commonlaw.plots.plot_textbook

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> cl.fit("x'' = -g - c v", drops).textbook(drops).title
        'Free fall with linear drag'
        """
        from commonlaw.discovery.textbook import nearest_textbook_law

        return nearest_textbook_law(self, trials, learned)

    @checks_types
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
        """Estimate the discrepancy: what an equation lacks, as a smooth function of a coordinate, for all objects.

        ``x_j' = law + g(q)``, with a Gaussian process g that is fitted together with the coefficients and all initial
        states; its amplitude and length scale are integrated out. Errors that differ between trials are a random walk,
        if the evidence supports it. ``g(0) = 0`` if the data come near q = 0, and g is orthogonal over the samples to
        the terms of the law in q, so that these keep their meaning.

        Raises `CommonlawError` if the law is in discrete time, its objects do not share their terms, or a coordinate
        cannot be parsed, is not finite or is constant.

        Parameters
        ----------
        trials
            Measurements of objects of the law.
        of
            The coordinate: a state, its rate, an input, time, or an expression of these and of the objects' properties
            such as ``abs(v)*diameter/1.5e-5``. Default: the variable of largest evidence, penalized for the choice.
        times
            Factor of the function, such as ``v*abs(v)*diameter^2/mass``.
        equation
            State whose equation has the function. Default: that of largest evidence.
        zero_at
            Where the function is zero, instead of the rule above; None for nowhere.
        noise, huber_threshold
            See `commonlaw.refine`.

        See Also
        --------
        residuals : Tests for patterns in residuals.
        bounds : Limits of absent terms.
        commonlaw.plots.plot_discrepancy

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05, quadratic=-0.02)
        >>> discrepancy = cl.fit("x'' = -g - c v", drops).discrepancy(drops, of="v")
        >>> discrepancy.claimed
        True
        """
        if isinstance(zero_at, str):
            check_choice("zero_at", zero_at, ("auto",))
        if isinstance(zero_at, Real) and not np.isfinite(float(zero_at)):
            raise CommonlawError("finite-number", name="zero_at", value=zero_at)
        from commonlaw.discrepancy import discrepancy

        return discrepancy(
            self,
            trials,
            of,
            times=times,
            equation=equation,
            zero_at=zero_at,
            noise=noise,
            huber_threshold=huber_threshold,
        )

    @checks_types
    def report(
        self, trials: Trials | TrialStream, learned: Trials | TrialStream | None = None, client: "Client | None" = None
    ) -> "Page":
        """Return a report on the law and its forecasts as a self-contained page, to save or to show in a notebook.

        `learned` is the training part of the trials, see `assess`: ``law.report(*stream.split(trial=3))``. All trials
        of a stream are forecast, by the workers of a dask client if one is given; the page shows representative
        objects.

        Raises `CommonlawError` if the trials do not match the law.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(drag=(-0.3,), noise=0.05, trials=1)
        >>> cl.fit("x'' = -g - c v", drops).report(drops).html[:15]
        '<!DOCTYPE html>'
        """
        from commonlaw.report import law_page

        return law_page(self, trials, learned, client)

    # Laws that follow from this one

    @checks_types
    def update(self, trials: Trials) -> "Law":
        """Return the law of the objects in new trials, with coefficients updated by these trials (Bayes).

        The prior is that of forecasts: the coefficients of the object, or those that follow from its properties, or the
        population mean, with their covariance. The likelihood of the trials, with free initial states, updates it to
        first order. Do not use training trials again: they would count twice. The prior of the parameters is normal,
        within their bounds; those that had only a limit have none. Noise and other measurement errors are those of the
        law.

        Raises `CommonlawError` if the covariance or noise is not known, the law has process noise or is in discrete
        time, or the trials do not match the law.

        See Also
        --------
        refine : Refit to trials, without a prior.
        predict : Forecast trials.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> law = cl.fit("x'' = -g - c v", drops.select(object=drops.objects[:4])).explain([])
        >>> print(law.update(drops.select(object="Ball 5", trial=1).until(2.0)).equations()[0])
        x'' = -9.856 ± 0.046 - (0.714 ± 0.011) v
        """
        from commonlaw.inference import adapt

        return adapt(self, trials)

    @checks_types
    def simplify(self, tolerance: float = 2.0) -> "Simplification":
        """Return the simplest form of the law that is consistent with the coefficients and their errors.

        A number is replaced by zero, a ratio of small integers, or plus or minus another number of the law, if that is
        shorter to write than its significant digits (minimum description length; Rissanen 1983): 0.667 ± 0.001 becomes
        2/3, and 0.67 ± 0.05 stays. Numbers with units become zero or each other. The remaining numbers are adjusted by
        the covariance, and equations take the shortest of their equivalent forms. Each replacement may be `tolerance`
        standard errors from the mean over objects; chi-square tests of all together, of the mean and of all objects,
        have the same significance level.

        Raises `CommonlawError` if the covariance is not known, objects have terms of their own, or SymPy is not
        installed.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(drag=(-0.1, -0.2), noise=0.001)
        >>> print(cl.fit("x'' = -g - c v + b v^2", drops).simplify().equations[0])
        x'' = -(c*v + g)
        """
        from commonlaw.law.simplify import simplified

        return simplified(self, tolerance)

    def explain(self, properties: Any = None) -> "Law":
        """Return the law with coefficients that are shared or functions of properties of the objects.

        Each coefficient is shared, a power law of properties with small rational exponents (``0.25 diameter^2/mass``),
        an affine function of properties if signs differ, or object-specific, with a between-object variance. The
        evidence decides, with a prior against properties. The coefficients become those of the relations. Objects that
        have only a limit of a parameter are left out: they keep their own coefficients, and a note names them.

        Raises `CommonlawError` if a property is unknown or not a number, objects do not share their terms, there is
        only one object, fewer than two have an estimate of every parameter, or the covariance is not known.

        Parameters
        ----------
        properties
            Names of properties of the law; or a mapping from object to values by name; or a table (a file, a frame)
            with a row for each object. Default: all numeric properties that every object has; ``[]`` for none.

        See Also
        --------
        commonlaw.law.contrasts : Differences between groups of objects.
        commonlaw.law.relations_frame : The relations as a table.

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
        from commonlaw.law.pooling import explained

        return explained(self, properties)

    # Files

    @classmethod
    @checks_types
    def from_text(
        cls,
        equations: str | Sequence[str],
        values: Mapping[str, float | Mapping[str, float]] | None = None,
        **names: Unpack[Names],
    ) -> "Law":
        """Return the law of equations with given coefficients, for instance to simulate it.

        Raises `CommonlawError` if the text cannot be parsed (the message names the character), or a coefficient has no
        value.

        Parameters
        ----------
        equations
            One for each state, as a list or separated by semicolons: ``"x'' = -9.81 - c v"``. Left-hand sides may also
            be ``dT/dt`` and ``d2T/dt2``. A name that is not a variable is a coefficient.
        values
            Values of the coefficients by name: a number, or a number for each object by its name.
        **names
            Names of inputs and time, and units, see `Schema`.

        See Also
        --------
        fit : Estimate the coefficients from trials.

        Examples
        --------
        >>> law = Law.from_text("T' = -k (T - 20)", {"k": {"cup": 0.1, "mug": 0.05}})
        >>> law.simulate([0.0, 10.0], [80.0])["cup"].states[-1].round(2)
        array([42.07])
        """
        return cls(*stated_law(equations, values or {}, **names))

    @checks_types
    def save(self, path: str | os.PathLike[str], name: str | None = None, initial: "ArrayLike | None" = None) -> None:
        """Save the law in the format of the file extension, or export it as a program in another language.

        ``.json``, or no extension: JSON; ``.parquet``: Parquet with a row for each object. `load` reads both. Programs
        are written as ``.c`` C, ``.py`` Python, ``.m`` MATLAB, ``.mo`` Modelica, ``.xml`` or ``.sbml`` SBML (level 3,
        rate rules), and ``.xlsx`` a workbook whose formulas integrate the law. They hold the parameters of all objects,
        SBML those of one. Inputs are arguments or, in SBML and workbooks, zero until they are set. Observation
        equations are left out.

        The file is written completely or not at all. Raises `CommonlawError` if it cannot be written, is read-only, a
        folder or a hard link, or the extension is another. JSON and Parquet refuse a law that could not be read again,
        as with too many objects for JSON. Programs refuse one in discrete time, or with doses or dead times; SBML more
        than one object, and workbooks events.

        Parameters
        ----------
        name
            The object; default: all.
        initial
            Initial states, then initial rates, of a program; default: the middle of the measured range, or 1.
        """
        from commonlaw.law.io import file_content

        write_whole(path, file_content(self, path, name, initial))

    @classmethod
    @checks_types
    def load(cls, path: str | os.PathLike[str], functions: Iterable[Callable[..., Any]] = ()) -> "Law":
        """Load a law that was written by `save`; Python functions in its terms have to be given again.

        Raises `CommonlawError` if the file cannot be read or is not a law, or if a function is missing.
        """
        from commonlaw.law.io import decoded_file

        content = read_file(path)
        try:
            return decoded_file(content, functions)
        except CommonlawError as error:
            raise error.at(str(path)) from None


def object_index(law: Law, name: object) -> int:
    """Return the index of an object among those of a law; refuse one that it does not have."""
    index = law._indices.get(str(name))
    if index is None:
        raise unknown("object of this law", name, law.objects)
    return index


def only_object(law: Law, name: str | None) -> str:
    """Return the name of an object that was given, or that is the only one."""
    if name is None and len(law.objects) > 1:
        raise CommonlawError("several-objects", objects=law.objects, first=law.objects[0])
    return law.objects[0] if name is None else name


def given_equations(law: Law) -> GivenEquations | None:
    """Return what the equations say that a law was given by, read once; None of a law that has none."""
    return law._given


def shares_terms(law: Law) -> bool:
    """Return whether every object has the same terms."""
    return law._shares_terms


def with_other_laws(law: Law, other_laws: tuple[PlausibleLaw[Law], ...]) -> Law:
    """Return a law with these as its plausible other laws."""
    return replace(law, uncertainty=replace(law.uncertainty, other_laws=other_laws))
