"""From trials to a law: the estimator, and the function that most people call."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from commonlaw.differentiation import AbstractDifferentiator, default_differentiation, parse_differentiation
from commonlaw.errors import CommonlawError, unknown
from commonlaw.formulation import AbstractFormulation, DiscreteForm, StrongForm, System, compress
from commonlaw.law import Law
from commonlaw.library import AbstractLibrary, PolynomialLibrary, Terms, parse_library
from commonlaw.outcomes import Outcome
from commonlaw.solvers import AbstractSolver, Fit, GroupSTLSQ, parse_solver
from commonlaw.trials import Trials, TrialStream

if TYPE_CHECKING:
    from sklearn.utils import Tags

    from commonlaw.forecast import Forecast

Floats = NDArray[np.float64]
Fixed = Mapping[str | tuple[str, str], float | Mapping[str, float]]

_ILL_CONDITIONED = 1e8
"""Above it, half of the digits of double precision are gone."""


class LawDiscovery:
    """Finds the law that objects share, in scikit-learn's conventions.

    Parameters
    ----------
    order
        Order of the law: 1 for ``x' = f(x)``, 2 for ``x'' = f(x, x')``; 0 for a law in discrete time,
        ``x[k+1] = f(x[k])``, which takes the states as measured and needs no rates.
    library
        Candidate terms, or their text such as ``"poly:3"``. Default: polynomials of degree 3.
    differentiation
        How rates are estimated, or its text such as ``"savgol:35:3"``. Default: `default_differentiation` of the order.
    solver
        How terms are chosen, or its text such as ``"group-stlsq:1.5"``. Default: ``GroupSTLSQ(0.1)``.
    fixed
        Known terms: term to coefficient (``{"1": -9.8}``), or to coefficients by object; with several states the term
        is given with its equation's state (``{("x", "1"): -9.8}``). They are moved to the left-hand side.
    library_states
        Whether terms are evaluated on the ``"smoothed"`` or on the ``"measured"`` states, see `StrongForm`.
    trim
        Rows left out at each end of a trial, see `StrongForm`.
    jobs
        Processes that share the trials; each computes with one thread.

    Attributes
    ----------
    law_
        The law that was found.

    Examples
    --------
    >>> from commonlaw import LawDiscovery, datasets
    >>> drops = datasets.linear_drag(noise=0.0)
    >>> model = LawDiscovery(order=2, library="poly:1", differentiation="finite:6", solver="group-stlsq:1").fit(drops)
    >>> model.law_.average().equations()
    ("x'' = -9.8 - 0.38 v",)
    """

    law_: Law

    def __init__(
        self,
        order: int = 1,
        library: AbstractLibrary | str | None = None,
        differentiation: AbstractDifferentiator | str | None = None,
        solver: AbstractSolver | str | None = None,
        fixed: Fixed | None = None,
        library_states: Literal["smoothed", "measured"] = "smoothed",
        trim: int = 0,
        jobs: int = 1,
    ) -> None:
        self.order = order
        self.library = library
        self.differentiation = differentiation
        self.solver = solver
        self.fixed = fixed
        self.library_states = library_states
        self.trim = trim
        self.jobs = jobs

    def fit(self, trials: Trials | TrialStream, y: None = None) -> Self:  # noqa: ARG002
        """Find the law of these trials, each of which is gone through once.

        Raises
        ------
        CommonlawError
            If the trials cannot be used as they are; the message names the object and trial and says what to do.
        """
        from threadpoolctl import threadpool_limits

        form, solver = self._formulation(), self._solver()
        terms = self._library().bind(form.variables(trials.schema))
        with threadpool_limits(1, "blas"):
            data = compress(trials, trials.schema, form, terms, jobs=self.jobs)
            known = _known_coefficients(self.fixed or {}, trials.schema.states, data.objects, terms)
            fit = _solve(data.systems, known, solver)
            coefficients = np.where(np.isnan(known), fit.coefficients, known)
            rates = None if self.order == 0 else self._differentiation()
            law = Law(terms, trials.schema, self.order, data.objects, coefficients, rates)
            self.law_ = replace(law, outcomes=tuple(_outcomes(law, fit, data.systems, solver)))
        return self

    def predict(self, trials: Trials) -> "Forecast":
        """Forecast each trial from its own initial state, see `Law.predict`."""
        return self._fitted().predict(trials)

    def score(self, trials: Trials, y: None = None) -> float:  # noqa: ARG002
        """Return the R^2 of the forecasts of these trials, see `Law.score`."""
        return self._fitted().score(trials)

    def get_params(self, deep: bool = True) -> dict[str, Any]:  # noqa: ARG002
        """Return the parameters by name."""
        return {name: getattr(self, name) for name in _PARAMETERS}

    def set_params(self, **parameters: Any) -> Self:
        """Set parameters by name and return the estimator.

        Raises
        ------
        CommonlawError
            If a name is not a parameter.
        """
        for name, value in parameters.items():
            if name not in _PARAMETERS:
                raise unknown("parameter", name, _PARAMETERS)
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        given = ", ".join(f"{name}={value!r}" for name, value in self.get_params().items() if value is not None)
        return f"LawDiscovery({given})"

    def __sklearn_tags__(self) -> "Tags":
        from sklearn.utils import InputTags, Tags, TargetTags

        inputs = InputTags(two_d_array=False)
        return Tags(estimator_type=None, target_tags=TargetTags(required=False), input_tags=inputs)

    def _fitted(self) -> Law:
        if not hasattr(self, "law_"):
            raise CommonlawError("no law was found yet: call fit first")
        return self.law_

    def _formulation(self) -> AbstractFormulation:
        if self.order == 0:
            return DiscreteForm()
        return StrongForm(self._differentiation(), self.order, self.library_states, self.trim)

    def _library(self) -> AbstractLibrary:
        if self.library is None:
            return PolynomialLibrary(3)
        return parse_library(self.library) if isinstance(self.library, str) else self.library

    def _differentiation(self) -> AbstractDifferentiator:
        if self.differentiation is None:
            return default_differentiation(self.order)
        if isinstance(self.differentiation, str):
            return parse_differentiation(self.differentiation)
        return self.differentiation

    def _solver(self) -> AbstractSolver:
        if self.solver is None:
            return GroupSTLSQ(0.1)
        return parse_solver(self.solver) if isinstance(self.solver, str) else self.solver


_PARAMETERS = ("order", "library", "differentiation", "solver", "fixed", "library_states", "trim", "jobs")


def discover(
    trials: Trials | TrialStream,
    *,
    order: int = 1,
    library: AbstractLibrary | str | None = None,
    differentiation: AbstractDifferentiator | str | None = None,
    solver: AbstractSolver | str | None = None,
    fixed: Fixed | None = None,
    library_states: Literal["smoothed", "measured"] = "smoothed",
    trim: int = 0,
    jobs: int = 1,
) -> Law:
    """Find the law that the objects of these trials share.

    Parameters are those of `LawDiscovery`.

    Raises
    ------
    CommonlawError
        If the trials cannot be used as they are, or settings do not fit; the message says where and what to do.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.0)
    >>> law = cl.discover(drops, order=2, differentiation="finite:6", solver="group-stlsq:1")
    >>> print(law.average())
    x'' = -9.8 - 0.38 v
    <BLANKLINE>
    with v = x'
    """
    model = LawDiscovery(order, library, differentiation, solver, fixed, library_states, trim, jobs)
    return model.fit(trials).law_


def _known_coefficients(fixed: Fixed, states: Sequence[str], objects: Sequence[str], terms: Terms) -> Floats:
    """Return the coefficients that are known, shape (objects, equations, terms), NaN where they are to be found."""
    known = np.full((len(objects), len(states), len(terms)), np.nan)
    for key, value in fixed.items():
        state, term = key if isinstance(key, tuple) else (states[0], key)
        if not isinstance(key, tuple) and len(states) > 1:
            raise CommonlawError(f"fixed term {key!r}: say of which equation, as ({states[0]!r}, {key!r})")
        if state not in states:
            raise unknown("state", state, states)
        values = value if isinstance(value, Mapping) else dict.fromkeys(objects, value)
        missing = [name for name in objects if name not in values]
        if missing:
            raise CommonlawError(
                f"fixed term {term!r} has no coefficient for {', '.join(missing)}; give one for each object"
            )
        known[:, states.index(state), terms.index(term)] = [values[name] for name in objects]
    return known


def _solve(systems: Sequence[System], known: Floats, solver: AbstractSolver) -> Fit:
    """Solve for what is not known, with the known terms moved to the left-hand side."""
    free = np.isnan(known)
    rest = [system.subtract(np.nan_to_num(own)) for system, own in zip(systems, known, strict=True)]
    return solver.solve(rest, free[0])


def _outcomes(law: Law, fit: Fit, systems: Sequence[System], solver: AbstractSolver) -> Iterator[Outcome]:
    """Yield what a user should know about this fit."""
    if isinstance(solver, GroupSTLSQ) and len(systems) == 1:
        yield Outcome(
            "one object",
            law.objects[0],
            "with a single object the group solver equals STLSQ",
            "add objects to let them vote on the terms",
        )
    if not fit.converged:
        yield Outcome(
            "not converged", "", "the support still changed in the last sweep", "give the solver more max_iterations"
        )
    for j, equation in enumerate(law.left_sides):
        if not law.support[j].any():
            yield Outcome(
                "empty support",
                equation,
                f"the threshold removed every term; the largest value it was last compared with is "
                f"{fit.largest[:, j].max():.4g}",
                "choose a threshold below that",
            )
        for system, name, support in zip(systems, law.objects, law.coefficients[:, j] != 0, strict=True):
            condition = system.condition(support)
            if condition > _ILL_CONDITIONED:
                yield Outcome(
                    "ill-conditioned",
                    f"{equation} of {name}",
                    f"its terms nearly depend on each other on these samples (condition number {condition:.1e})",
                    "raise the threshold, leave terms out, or measure over a wider range",
                )
