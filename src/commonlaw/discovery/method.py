"""The interface of methods, and the structure that they fit: order, candidate terms, known coefficients."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import product
from operator import add
from typing import Any, ClassVar, TypeVar

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Diagnostic
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import TrialDerivatives, law_variables
from commonlaw.law import Law
from commonlaw.library import (
    AbstractLibrary,
    Order,
    ParametricTerm,
    PolynomialLibrary,
    Ratios,
    Terms,
    Variables,
    order_of_each,
    parse_library,
)
from commonlaw.library.functions import functions_in
from commonlaw.library.libraries import LibraryGiven
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.trials import Schema, Trials, TrialStream
from commonlaw.trials.transformations import with_property_inputs
from commonlaw.trials.trial import property_names

Key = str | tuple[str, str]
"""A term, with the state of its equation before it when there are several."""

Known = Mapping[Key, float | Mapping[str, float]]
"""Known coefficients: one number, or one for each object by its name."""


@dataclass(frozen=True, eq=False)
class ModelStructure:
    """The family of candidate laws, of order 1 or 2, or that of each equation; 0 for laws in discrete time.

    All objects share the coefficients of `shared` terms. Derivatives of the states in each trial may be given, and the
    orders of each state that a method with evidence chooses from, of which `order` has the first.
    """

    order: Order
    library: AbstractLibrary = field(default_factory=lambda: PolynomialLibrary(3))
    known: Known = field(default_factory=dict)
    shared: Sequence[Key] = ()
    derivatives: TrialDerivatives | None = None
    possible: tuple[tuple[int, ...], ...] = ()

    def terms(self, schema: Schema) -> Terms:
        """Return the candidate terms over the variables of trials of this schema.

        Raises `CommonlawError` if the library contains an unknown variable or term.
        """
        terms = self.library.bind(self._variables(schema))
        if not len(terms):
            raise CommonlawError("library-parametric-only")
        return terms

    def parametric(self, schema: Schema) -> tuple[ParametricTerm, ...]:
        """Return the candidate terms with nonlinear parameters, see `AbstractLibrary.parametric`."""
        return self.library.parametric(self._variables(schema))

    def ratios(self, schema: Schema) -> tuple[Ratios, ...]:
        """Return the candidate ratios of sums of terms, see `AbstractLibrary.ratios`."""
        return self.library.ratios(self._variables(schema))

    def _variables(self, schema: Schema) -> Variables:
        return replace(law_variables(schema, self.order), functions=self.library.functions)

    def known_coefficients(self, schema: Schema, objects: Sequence[str]) -> Floats:
        """Return the known coefficients, shape (objects, equations, terms), NaN where they are estimated.

        Raises `CommonlawError` if a term or state is unknown, or an object has no coefficient.
        """
        terms = self.terms(schema)
        result = np.full((len(objects), len(schema.states), len(terms)), np.nan)
        for key, value in self.known.items():
            equation, term = _index_of(key, schema.states, terms)
            values = value if isinstance(value, Mapping) else dict.fromkeys(objects, value)
            missing = [name for name in objects if name not in values]
            if missing:
                raise CommonlawError("known-coefficient-missing", term=terms.names[term], objects=missing)
            result[:, equation, term] = [_number(key, values[name]) for name in objects]
        return result

    def shared_coefficients(self, schema: Schema) -> Bools:
        """Return which coefficients are shared by all objects, shape (equations, terms).

        Raises `CommonlawError` if a term or state is unknown.
        """
        terms = self.terms(schema)
        result = np.zeros((len(schema.states), len(terms)), dtype=np.bool_)
        for key in self.shared:
            result[_index_of(key, schema.states, terms)] = True
        return result

    def shared_in(self, law: Law) -> Bools:
        """Return which coefficients of a law are shared by all objects, shape (equations, terms)."""
        schema = replace(law.schema, states=law.schema.measured, initial_values={}, initial_time=None)
        shared, names = self.shared_coefficients(schema), self.terms(schema).names
        shared = np.pad(shared, ((0, len(law.schema.states) - len(shared)), (0, 0)))
        columns = {name: shared[:, k] for k, name in enumerate(names)}
        return np.column_stack([columns.get(name, np.zeros(len(shared), dtype=bool)) for name in law.terms.names])


def of_each_equation(
    libraries: Mapping[str, LibraryGiven], schema: Schema, order: Order
) -> tuple[AbstractLibrary, Known]:
    """Return the joint library of all equations, and zero coefficients for the terms an equation does not have.

    Raises `CommonlawError` if a state has no library, or one has terms with nonlinear parameters, which apply to all
    equations.
    """
    for name in libraries:
        check_choice("state", name, schema.states)
    if missing := [name for name in schema.states if name not in libraries]:
        raise CommonlawError("library-of-equation-missing", states=missing)
    variables, parsed = law_variables(schema, order), list[AbstractLibrary]()
    for name in schema.states:
        library = libraries[name]
        parsed.append(parse_library(library))
        variables = replace(variables, functions=functions_in((*variables.functions, *parsed[-1].functions)))
        if library == "auto" or parsed[-1].parametric(variables) or parsed[-1].ratios(variables):
            raise CommonlawError("library-of-equation-parametric", state=name)
    whole = reduce(add, parsed)
    terms, terms_of_states = whole.bind(variables), [{*library.bind(variables).terms} for library in parsed]
    pairs = product(zip(schema.states, terms_of_states, strict=True), zip(terms.names, terms.terms, strict=True))
    return whole, {(state, name): 0.0 for (state, offered), (name, term) in pairs if term not in offered}


def _number(key: Key, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise CommonlawError("known-coefficient-not-a-number", key=key, value=str(value)[:60]) from None


def _index_of(key: Key, states: Sequence[str], terms: Terms) -> tuple[int, int]:
    if not isinstance(key, tuple) and len(states) > 1:
        raise CommonlawError("known-term-ambiguous", key=key, state=states[0])
    state, term = key if isinstance(key, tuple) else (states[0], key)
    check_choice("state", state, states)
    return states.index(state), terms.index(term)


def with_properties_in(libraries: Iterable[AbstractLibrary], trials: Trials) -> Trials:
    """Return trials with the properties of their objects that stand in terms of libraries as inputs.

    They are constant in each trial, and variables like others: ``x**2/K`` has a coefficient of each object, and a law
    in which all objects have the same one is more probable than one in which they differ.
    """
    variables, used = law_variables(trials.schema, 2), set[str]()
    names = [name for name in property_names(trials.properties) if name not in variables.names]
    for library in libraries if names else ():
        called = [function.name for function in library.functions]
        properties = tuple(name for name in names if name not in called)
        wide = replace(variables, parameters=properties, functions=library.functions)
        terms = [*library.bind(wide).terms, *(parametric.term for parametric in library.parametric(wide))]
        terms += [term for ratios in library.ratios(wide) for term in (*ratios.above, *ratios.below)]
        used |= {name for term in terms for name in (wide.names[i] for i in term.columns() if i < len(wide.names))}
    return with_property_inputs(trials, [name for name in names if name in used])


T = TypeVar("T")


class AbstractMethod(ABC):
    """A method that finds a law from trials; its fields are its settings."""

    orders: ClassVar[tuple[int, ...]]
    """Supported orders."""

    takes_mixed_orders: ClassVar[bool] = False
    """Whether equations may have different orders."""

    takes_noise_columns: ClassVar[bool] = False
    """Whether standard deviations of single measurements are used."""

    takes_derivatives: ClassVar[bool] = False
    """Whether given derivatives are supported."""

    takes_parameters: ClassVar[bool] = False
    """Whether terms with nonlinear parameters are supported."""

    @abstractmethod
    def find(self, trials: Trials, structure: ModelStructure, progress: ProgressCallback) -> Law:
        """Return the best law of a structure for these trials; `progress` is called with the text of each step.

        Raises `CommonlawError` if the method does not support the order, or the trials cannot be used as they are; the
        message names the object and trial, and a remedy.
        """

    @abstractmethod
    def find_by_file(self, stream: TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        """Return the best law of a structure for a stream, whose files are read one after the other, or by workers.

        Raises `CommonlawError` as `find` does, or if the method does not support streams.
        """


def check_supported(method: AbstractMethod, schema: Schema, structure: ModelStructure) -> None:
    """Raise an error for what a method does not support, and name one that does."""
    name, order = type(method).__name__, structure.order
    if isinstance(order, tuple) and not method.takes_mixed_orders:
        raise CommonlawError("mixed-orders-unsupported", method=name)
    if not {*order_of_each(order, 1)} <= {*method.orders}:
        alternative = "DiscreteTimeRegression" if order == 0 else "DerivativeRegression"
        raise CommonlawError("order-of-method", order=order, method=name, alternative=alternative)
    if structure.derivatives is not None and not (method.takes_derivatives and order == 1):
        raise CommonlawError("derivatives-unsupported", method=name, order=order)
    nonlinear = [term.text(law_variables(schema, order)) for term in structure.parametric(schema)]
    nonlinear += ["ratios of sums"] if structure.ratios(schema) else []
    others = [] if order == 0 else [Diagnostic("use-trajectory-likelihood")]
    if nonlinear and not method.takes_parameters:
        remedy = "take a library without ratios" if nonlinear[0] == "ratios of sums" else "give constants as numbers"
        raise CommonlawError("parametric-terms-unsupported", term=nonlinear[0], method=name, remedies=[remedy, *others])
    columns = schema.noise_columns
    if columns and not method.takes_noise_columns:
        others = [Diagnostic("read-without-deviations", {"states": [*schema.measured]}), *others]
        raise CommonlawError("noise-columns-unsupported", columns=columns.values(), method=name, remedies=others)


def parsed(value: T | str | None, parse: Callable[[str], T]) -> T | None:
    """Return the parsed value of a text; any other value unchanged."""
    return parse(value) if isinstance(value, str) else value
