"""The law that objects share."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.errors import CommonlawError, unknown
from commonlaw.files import write_whole
from commonlaw.integration import Event, InitialValueProblem, Trajectory, VectorField, simulate
from commonlaw.law.alternative import Alternative
from commonlaw.law.check import checked, checked_covariance
from commonlaw.law.forecast import Forecast
from commonlaw.law.history import History, Step
from commonlaw.library import Terms
from commonlaw.outcomes import Outcome
from commonlaw.trials import Schema, Trials

if TYPE_CHECKING:
    import pandas as pd
    import sympy


@dataclass(frozen=True, eq=False)
class Law:
    """Equations that several objects share, with each object's own coefficients.

    Parameters
    ----------
    terms
        Candidate terms over the states (and, for a law of second order, their rates), inputs and time.
    schema
        Names and units of what was measured; equation j gives the `order`-th derivative of ``schema.states[j]``.
    order
        1 or 2; 0 for a law in discrete time, which gives the next sample's states.
    objects
        Names of the objects.
    coefficients
        Shape (objects, equations, terms).
    differentiation
        How rates were estimated; a forecast from measurements estimates the initial rates in the same way.
    outcomes
        What a user should know about how the law was found.
    alternatives
        The candidates that it was chosen from, if it was chosen.
    covariance
        Of each object's coefficients in `support`, in the order of ``numpy.argwhere(law.support)``, shape (objects,
        parameters, parameters); zero for those that are known or that the object does not have. None if it is not
        known how accurate the coefficients are.
    noise
        Standard deviation of the measurement noise of each state, shape (states,); None if it is not known.
    inclusion
        Probability that a term is in the law, shape (equations, terms); None if it is not known.
    history
        Every choice on the way to the law, in order.
    common
        What the errors of different objects have in common since they were pooled: the covariance of two objects'
        coefficients is the product of one's matrix with the other's transposed, shape (objects, parameters,
        parameters). None if objects do not depend on each other, see `pooled`.
    """

    terms: Terms
    schema: Schema
    order: int
    objects: tuple[str, ...]
    coefficients: Floats
    differentiation: AbstractDifferentiator | None = None
    outcomes: tuple[Outcome, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    covariance: Floats | None = None
    noise: Floats | None = None
    inclusion: Floats | None = None
    history: tuple[Step, ...] = ()
    common: Floats | None = None

    def __post_init__(self) -> None:
        shape = (len(self.objects), len(self.states), len(self.terms))
        self._set(
            "coefficients", checked(self.coefficients, "array of coefficients", "objects, equations, terms", shape)
        )
        if self.covariance is not None:
            self._set("covariance", checked_covariance(self.covariance, self.objects, int(self.support.sum())))
        if self.noise is not None:
            self._set("noise", checked(self.noise, "noise", "states", shape[1:2], low=0))
        if self.inclusion is not None:
            self._set("inclusion", checked(self.inclusion, "inclusion", "equations, terms", shape[1:], 0, 1))
        if self.common is not None:
            axes, size = "objects, coefficients in the law, the same", int(self.support.sum())
            self._set("common", checked(self.common, "common errors", axes, (len(self.objects), size, size)))
        self._set("history", History(self.history))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the measured states."""
        return self.schema.states

    @cached_property
    def support(self) -> Bools:
        """Which terms are in which equation for at least one object, shape (equations, terms)."""
        return np.asarray(np.any(self.coefficients != 0, axis=0))

    @property
    def rates(self) -> tuple[str, ...]:
        """Names of the states' rates in a law of second order; none in a law of first order."""
        return self.terms.variables.states[len(self.states) :]

    def of(self, name: object) -> Floats:
        """Return the coefficients of one object, shape (equations, terms).

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        return np.asarray(self.coefficients[self.index(name)])

    def average(self) -> "Law":
        """Return the law of one object, "average", whose coefficients are the mean over all objects.

        Their covariance is that of a mean, of objects that are independent unless they were pooled.
        """
        from commonlaw.law.objects import average

        return average(self)

    def select(self, objects: Sequence[str]) -> "Law":
        """Return the law of these objects only."""
        from commonlaw.law.objects import select

        return select(self, objects)

    def pooled(self) -> "Law":
        """Return the law with each coefficient drawn to its mean over objects, as far as the objects are alike in it.

        What objects have in common, such as gravity, all trials tell together; what is an object's own stays so.
        Objects count as drawn from one population (parametric empirical Bayes; Morris 1983); `history` says how far
        each coefficient was drawn, and `common` how their errors now depend on each other.

        Raises
        ------
        CommonlawError
            If the law does not know how accurate its coefficients are, or is pooled already.
        """
        from commonlaw.law.objects import pooled

        return pooled(self)

    # How accurate it is

    @cached_property
    def standard_errors(self) -> Floats:
        """Standard errors of the coefficients, shape (objects, equations, terms).

        Zero for coefficients that are known, NaN for terms that are not in the law, and everywhere if the covariance is
        not known.
        """
        from commonlaw.law.uncertainty import standard_errors

        return standard_errors(self)

    def intervals(self, level: float = 0.95) -> "pd.DataFrame":
        """Return a table of all coefficients: object, equation, term, coefficient, standard error, low and high.

        And how probable it is that the term is in the law, where that is known.

        Parameters
        ----------
        level
            The probability that the coefficient lies between low and high, if its error is normally distributed.

        Raises
        ------
        CommonlawError
            If the covariance is not known, or the level is not between 0 and 1.
        """
        from commonlaw.law.tables import intervals

        return intervals(self, level)

    @property
    def has_spread(self) -> bool:
        """Whether `predict` can tell how far off forecasts may be: covariance and noise are known."""
        return self.covariance is not None and self.noise is not None

    # What the law says

    def equations(self, name: str | None = None, digits: int = 4, errors: bool | None = None) -> tuple[str, ...]:
        """Return the equations of one object as text: ``x'' = -9.34 + 0.0466 v``.

        With errors: ``x'' = -9.34 ± 0.12 + (0.047 ± 0.010) v``, standard errors to two digits.

        Parameters
        ----------
        name
            The object; may be left out when there is only one.
        digits
            Significant digits of the coefficients that have no error.
        errors
            Whether to show standard errors; None shows them when they are known.

        Raises
        ------
        CommonlawError
            If errors are asked for that are not known.
        """
        from commonlaw.law.text import equation
        from commonlaw.law.uncertainty import shown_errors

        name = self._only(name)
        parts = zip(self.left_hand_sides, self.of(name), shown_errors(self, name, errors), strict=True)
        return tuple(equation(left, row, doubts, self.terms.names, digits) for left, row, doubts in parts)

    def to_latex(self, name: str | None = None, digits: int = 4, errors: bool | None = None) -> str:
        """Return the equations of one object as LaTeX, an ``aligned`` block without dollar signs; see `equations`."""
        from commonlaw.law.text import latex
        from commonlaw.law.uncertainty import shown_errors

        name = self._only(name)
        return latex(self, self.of(name), shown_errors(self, name, errors), digits)

    def to_sympy(self, name: str | None = None) -> "dict[sympy.Expr, sympy.Expr]":
        """Return the equations of one object: left-hand side, such as ``Symbol("x''")``, to right-hand side."""
        import sympy

        symbols = [sympy.Symbol(each, real=True) for each in self.terms.variables.names]
        forms = [term.sympy(symbols) for term in self.terms.terms]
        return {
            sympy.Symbol(left, real=True): sympy.Add(
                *(sympy.Float(float(c)) * form for c, form in zip(row, forms, strict=True) if c)
            )
            for left, row in zip(self.left_hand_sides, self.of(self._only(name)), strict=True)
        }

    def to_frame(self, errors: bool = False) -> "pd.DataFrame":
        """Return the coefficients: one row for each object, one column for each term that is in the law.

        With several equations the columns have two levels, the equation and the term.

        Parameters
        ----------
        errors
            Whether each column is followed by one of standard errors, ``"v ±"`` after ``"v"``.

        Raises
        ------
        CommonlawError
            If errors are asked for that are not known.
        """
        from commonlaw.law.tables import coefficients

        return coefficients(self, errors)

    def candidates(self) -> "pd.DataFrame":
        """Return the candidates that the law was chosen from, what speaks for each, and which was chosen."""
        from commonlaw.law.tables import candidates

        return candidates(self)

    def path(self) -> "pd.DataFrame":
        """Return the equations that all settings of the solver give, in stretches from the smallest setting.

        Each row holds from its threshold, penalty or number of terms to the next row's, with the measures of
        `candidates`; a candidate may come more than once.

        Raises
        ------
        CommonlawError
            If the law was not chosen from the path of one solver.
        """
        from commonlaw.law.tables import path

        return path(self)

    def coefficient_units(self) -> "dict[tuple[str, str], str]":
        """Return the unit of each coefficient by equation and term, where the units of the variables tell it."""
        from commonlaw.law.units import coefficient_units

        return coefficient_units(self)

    def structure(self) -> tuple[str, ...]:
        """Return each equation's form, with letters for the coefficients: ``x'' = a + b v``."""
        from commonlaw.law.text import structure

        return structure(self)

    @property
    def letters(self) -> tuple[str, ...]:
        """The letters that `structure` uses, one for each coefficient in the law."""
        from commonlaw.law.text import letters

        return letters(self)

    @cached_property
    def shared(self) -> bool:
        """Whether every object has the same terms."""
        return bool(np.all((self.coefficients != 0) == self.support))

    def __repr__(self) -> str:
        form = self.structure() if self.shared else ("each object with its own terms",)
        return f"<Law of {', '.join(self.objects)}: {'; '.join(form)}>"

    def __str__(self) -> str:
        from commonlaw.law.text import law_text

        return law_text(self)

    @property
    def left_hand_sides(self) -> tuple[str, ...]:
        """What each equation gives, as text: ``x'``, ``x''``, or ``x[k+1]`` in a discrete-time law."""
        mark = "'" * self.order if self.order else "[k+1]"
        return tuple(f"{state}{mark}" for state in self.states)

    # What the law predicts

    def evaluate(self, name: str, values: ArrayLike) -> Floats:
        """Return the highest derivatives of one object, shape (n, equations).

        Parameters
        ----------
        name
            The object.
        values
            The law's variables (states, rates, inputs, time), shape (n, variables).
        """
        return np.asarray(self.terms.evaluate(np.asarray(values, dtype=np.float64)) @ self.of(name).T)

    def vector_field(self, name: str) -> VectorField:
        """Return the right-hand side for one object, ready to integrate."""
        return VectorField(self.terms, self.of(name), self.order, support=self.support if self.shared else None)

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
    ) -> dict[str, Trajectory]:
        """Integrate the law for every object; a divergence is an outcome of its trajectory.

        Parameters
        ----------
        times
            When the states are wanted; the first is the time of the initial state. Shape (n,).
        initial
            Initial states, for a law of second order followed by the initial rates: one vector for all objects,
            or one by name of object; objects that are not named are left out.
        method, tolerance
            How to integrate, and the relative error of a step; see `commonlaw.integration.simulate`.
        events
            What to look for on the way: ``Event("x", direction="falling", terminal=True)``.
        dense
            Whether `Trajectory.at` is to give states at any time.
        sensitivities
            Whether to give the derivatives of the states by the object's coefficients (those in the support of a
            shared law, else the object's own), equation by equation, and by the initial states.
        """
        if self.schema.inputs:
            raise CommonlawError("this law has inputs: forecast trials that hold them with predict")
        starts = initial if isinstance(initial, Mapping) else dict.fromkeys(self.objects, initial)
        width, grid = len(self.states) * max(1, self.order), np.asarray(times, dtype=np.float64)
        runs = {}
        for name, start in starts.items():
            state = np.atleast_1d(np.asarray(start, dtype=np.float64))
            if state.shape != (width,):
                wanted = ", ".join(self.terms.variables.states)
                raise CommonlawError(f"{name}: the initial state has {state.size} numbers, expected {width}: {wanted}")
            runs[name] = InitialValueProblem(self.vector_field(name), state, grid, name)
        found = simulate(
            runs.values(), method=method, tolerance=tolerance, events=events, dense=dense, sensitivities=sensitivities
        )
        return dict(zip(runs, found, strict=True))

    def predict(
        self,
        trials: Trials,
        *,
        start: int | None = None,
        spread: bool = False,
        method: str = "auto",
        tolerance: float = 1e-8,
    ) -> Forecast:
        """Forecast each trial from its own initial state.

        Parameters
        ----------
        trials
            What to forecast.
        start
            How many of each trial's first samples tell where its forecast starts. 1: the first states as measured, and
            for a law of second order the rates that `differentiation` estimates there. 5 or more: the law, with its
            coefficients as they are, is fitted to so many samples by likelihood, which needs its noise; states may be
            missing. More samples leave less noise in the start, and make it matter more that the law is right.
            Default: 1, but for a law of second order that knows its noise the samples that the first rates would be
            estimated from.
        spread
            Whether `Forecast.bands` is to say how far off the forecasts may be. To first order the covariance of the
            coefficients and that of the initial state, which the noise of the trial's first samples makes uncertain,
            are carried along each trajectory; that noise and the errors of the coefficients count as independent, also
            where the law was learned from these samples.
        method, tolerance
            How to integrate, and the relative error of a step; see `commonlaw.integration.simulate`.

        Raises
        ------
        CommonlawError
            If a trial's object is not in the law, its variables are not those of the law, a spread is asked for and the
            law's covariance or noise is not known, or a start cannot be fitted.
        """
        # Forecasting stands above laws; this entrance finds it when called, so that no import goes up.
        forecasting = import_module("commonlaw.forecast")
        forecast: Forecast = forecasting.predict(
            self, trials, start=start, return_std=spread, method=method, tolerance=tolerance
        )
        return forecast

    def score(self, trials: Trials) -> float:
        """Return the R^2 of the forecasts of these trials, see `Forecast.score`."""
        return self.predict(trials).score()

    # Keeping it

    def to_json(self) -> str:
        """Return the law as JSON of a versioned schema."""
        from commonlaw.law.json import encode

        return encode(self).decode()

    @classmethod
    def from_json(cls, text: str | bytes) -> "Law":
        """Return the law that `to_json` wrote.

        Raises
        ------
        CommonlawError
            If the text is damaged, or written by another version of the schema.
        """
        from commonlaw.law.json import decode

        return decode(text.encode() if isinstance(text, str) else text)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the law as JSON, whole or not at all."""
        write_whole(path, self.to_json().encode())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Law":
        """Read a law that `save` wrote; errors name the file."""
        from commonlaw.law.json import read

        return read(path)

    def index(self, name: object) -> int:
        """Return the place of an object among those of the law.

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        if name not in self.objects:
            raise unknown("object of this law", name, self.objects)
        return self.objects.index(str(name))

    def _only(self, name: str | None) -> str:
        if name is None and len(self.objects) > 1:
            names = ", ".join(self.objects)
            raise CommonlawError(f"the law has several objects: name one of {names}, or take average()")
        return self.objects[0] if name is None else name
