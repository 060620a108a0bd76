"""The law that objects share."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.errors import CommonlawError, unknown
from commonlaw.files import write_whole
from commonlaw.forecast import Event, Forecast, Run, Trajectory, VectorField, simulate
from commonlaw.law.alternative import Alternative
from commonlaw.library import Terms
from commonlaw.outcomes import Outcome
from commonlaw.trials import Schema, Trial, Trials

if TYPE_CHECKING:
    import pandas as pd
    import sympy

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


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
    """

    terms: Terms
    schema: Schema
    order: int
    objects: tuple[str, ...]
    coefficients: Floats
    differentiation: AbstractDifferentiator | None = None
    outcomes: tuple[Outcome, ...] = ()
    alternatives: tuple[Alternative, ...] = ()

    def __post_init__(self) -> None:
        expected = (len(self.objects), len(self.states), len(self.terms))
        coefficients = np.array(self.coefficients, dtype=np.float64)
        if coefficients.shape != expected:
            raise CommonlawError(
                f"coefficients have shape {coefficients.shape}, expected (objects, equations, terms) = {expected}"
            )
        if not np.all(np.isfinite(coefficients)):
            raise CommonlawError("a coefficient is not finite")
        coefficients.flags.writeable = False
        object.__setattr__(self, "coefficients", coefficients)

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
        return np.asarray(self.coefficients[self._place(name)])

    def average(self) -> "Law":
        """Return the law of one object, "average", whose coefficients are the mean over all objects."""
        return replace(self, objects=("average",), coefficients=self.coefficients.mean(axis=0, keepdims=True))

    def select(self, objects: Sequence[str]) -> "Law":
        """Return the law of these objects only."""
        places = [self._place(name) for name in objects]
        return replace(self, objects=tuple(objects), coefficients=self.coefficients[places])

    # What the law says

    def equations(self, name: str | None = None, digits: int = 4) -> tuple[str, ...]:
        """Return the equations of one object as text: ``x'' = -9.34 + 0.0466 v``.

        Parameters
        ----------
        name
            The object; may be left out when there is only one.
        digits
            Significant digits of the coefficients.
        """
        from commonlaw.law.text import equation

        return tuple(
            equation(left, row, self.terms.names, digits)
            for left, row in zip(self.left_sides, self.of(self._only(name)), strict=True)
        )

    def to_latex(self, name: str | None = None, digits: int = 4) -> str:
        """Return the equations of one object as LaTeX, an ``aligned`` block without dollar signs."""
        from commonlaw.law.text import latex

        return latex(self, self.of(self._only(name)), digits)

    def to_sympy(self, name: str | None = None) -> "dict[sympy.Expr, sympy.Expr]":
        """Return the equations of one object: left-hand side, such as ``Symbol("x''")``, to right-hand side."""
        import sympy

        symbols = [sympy.Symbol(each, real=True) for each in self.terms.variables.names]
        forms = [term.sympy(symbols) for term in self.terms.terms]
        return {
            sympy.Symbol(left, real=True): sympy.Add(
                *(sympy.Float(float(c)) * form for c, form in zip(row, forms, strict=True) if c)
            )
            for left, row in zip(self.left_sides, self.of(self._only(name)), strict=True)
        }

    def to_frame(self) -> "pd.DataFrame":
        """Return the coefficients: one row for each object, one column for each term that is in the law.

        With several equations the columns have two levels, the equation and the term.
        """
        import pandas as pd

        keys = [(self.left_sides[j], self.terms.names[k]) for j, k in np.argwhere(self.support)]
        values = self.coefficients[:, self.support]
        if len(self.states) == 1:
            columns = pd.Index([term for _, term in keys], dtype=object, name="term")
        else:
            columns = pd.MultiIndex.from_tuples(keys, names=["equation", "term"])
        return pd.DataFrame(values, index=pd.Index(self.objects, name="object"), columns=columns)

    def candidates(self) -> "pd.DataFrame":
        """Return the candidates that the law was chosen from, what speaks for each, and which was chosen."""
        import pandas as pd

        rows = [
            {
                "equation": each.equation,
                "terms": ", ".join(each.terms),
                "size": len(each.terms),
                **each.measures,
                "proven": each.proven,
                "chosen": each.chosen,
            }
            for each in self.alternatives
        ]
        return pd.DataFrame(rows)

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
    def left_sides(self) -> tuple[str, ...]:
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
            How to integrate, and the relative error of a step; see `commonlaw.forecast.simulate`.
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
            runs[name] = Run(self.vector_field(name), state, grid, name)
        found = simulate(
            runs.values(), method=method, tolerance=tolerance, events=events, dense=dense, sensitivities=sensitivities
        )
        return dict(zip(runs, found, strict=True))

    def predict(self, trials: Trials, *, method: str = "auto", tolerance: float = 1e-8) -> Forecast:
        """Forecast each trial from its own initial state: its first measured states and its estimated first rates.

        Parameters
        ----------
        trials
            What to forecast.
        method, tolerance
            How to integrate, and the relative error of a step; see `commonlaw.forecast.simulate`.

        Raises
        ------
        CommonlawError
            If a trial's object is not in the law, or its variables are not those of the law.
        """
        self._check_variables(trials)
        runs = [self._run(trial) for trial in trials]
        return Forecast(trials, simulate(runs, method=method, tolerance=tolerance))

    def score(self, trials: Trials) -> float:
        """Return the R^2 of the forecasts of these trials, see `Forecast.score`."""
        return self.predict(trials).score()

    def _run(self, trial: Trial) -> Run:
        start = [trial.states[0]]
        if self.order == 2:
            if self.differentiation is None:
                raise CommonlawError("this law does not know how to estimate initial rates; use simulate and give them")
            try:
                rates = self.differentiation.differentiate(trial.times, trial.states, 1)
            except CommonlawError as error:
                raise CommonlawError(f"{trial.label}: {error}") from None
            start.append(rates.derivatives[0][0])
        field = replace(self.vector_field(trial.object), inputs=_interpolated(trial) if trial.inputs.size else None)
        return Run(field, np.concatenate(start), trial.times, trial.label)

    def _check_variables(self, trials: Trials) -> None:
        for kind, wanted, given in (
            ("states", self.schema.states, trials.schema.states),
            ("inputs", self.schema.inputs, trials.schema.inputs),
        ):
            if wanted != given:
                raise CommonlawError(
                    f"the law has the {kind} {', '.join(wanted) or 'none'}, "
                    f"the trials have {', '.join(given) or 'none'}; name the columns of the table as in the law"
                )

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

    def _place(self, name: object) -> int:
        if name not in self.objects:
            raise unknown("object of this law", name, self.objects)
        return self.objects.index(str(name))

    def _only(self, name: str | None) -> str:
        if name is None and len(self.objects) > 1:
            names = ", ".join(self.objects)
            raise CommonlawError(f"the law has several objects: name one of {names}, or take average()")
        return self.objects[0] if name is None else name


def _interpolated(trial: Trial) -> Callable[[float], Floats]:
    """Return the inputs of a trial as a function of time, linear between samples."""

    def inputs(t: float) -> Floats:
        return np.array([np.interp(t, trial.times, column) for column in trial.inputs.T])

    return inputs
