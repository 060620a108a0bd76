"""The law that objects share."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.files import write_whole
from commonlaw.foreign import read_file
from commonlaw.law import text
from commonlaw.law.checked_arrays import checked
from commonlaw.law.delegates import AbstractDelegates
from commonlaw.law.from_text import Names, read_equations, stated_law
from commonlaw.law.provenance import Provenance
from commonlaw.law.uncertainty import PlausibleLaw, Uncertainty
from commonlaw.library import Order, Terms, with_rates
from commonlaw.trials import Schema
from commonlaw.trials.properties import Properties
from commonlaw.trials.trial import ObjectProperties, normalized
from commonlaw.wording import counted

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.law.json import Decoded


@dataclass(frozen=True, eq=False)
class Law(AbstractDelegates):
    """Equations that several objects share, with each object's own coefficients.

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
        How accurate coefficients and measurements are, what decides them, and what else the law could be.
    provenance
        How the law was found.
    properties
        What is known of the objects, by object and name; the units stand in ``schema.units``.

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
        self._check_others()

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

    # Laws of other objects

    def average(self) -> "Law":
        """Return the law of one object, "average", whose coefficients are the mean over all objects.

        Their covariance is that of a mean, of objects that are independent unless they were partially pooled.
        """
        mean = self.coefficients.mean(axis=0, keepdims=True)
        others = self.each_other(lambda law: law.average())
        return self._of_others(("average",), mean, self.uncertainty.average(), others)

    def select(self, objects: Sequence[str]) -> "Law":
        """Return the law of these objects only.

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        indices = [self.index(name) for name in objects]
        others = self.each_other(lambda law: law.select(objects))
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

    def partial_pooling(self, universal: Bools | None = None, others: bool = True) -> "Law":
        """Return the law with each coefficient drawn to its mean over objects, as far as the objects are alike in it.

        What objects have in common, such as gravity, all trials tell together; what is an object's own stays so.
        Objects count as drawn from one population (parametric empirical Bayes; Morris 1983); `history` says how far
        each coefficient was drawn, and `Uncertainty.shared_factor` how their errors now depend on each other.

        Parameters
        ----------
        universal
            Coefficients that all objects have in common, shape (equations, terms).
        others
            Whether the other coefficients are drawn to their means.

        Raises
        ------
        CommonlawError
            If the law does not know how accurate its coefficients are, or is pooled already.
        """
        from commonlaw.law.partial_pooling import not_pooled, partially_pooled, pooling_step

        pooled = self.each_other(lambda law: law.partial_pooling(universal, others))
        found = partially_pooled(self.coefficients, self.uncertainty, self.support, universal, others)
        if found is None:
            return self.with_others(pooled) if pooled else self
        coefficients, uncertainty, shrinkage, told = found
        step = pooling_step(self.left_hand_sides, self.terms.names, self.support, shrinkage)
        outcomes = (*self.outcomes, *not_pooled(self.objects, told))
        provenance = replace(self.provenance, history=(*self.history, step), outcomes=outcomes)
        uncertainty = replace(uncertainty, other_laws=pooled)
        return replace(self, coefficients=coefficients, uncertainty=uncertainty, provenance=provenance)

    def explain(self, properties: Any = None) -> "Law":
        """Return the law with fewer numbers: what in it is universal, follows the objects' properties, or is their own.

        Each coefficient is the same for all objects, a factor times powers of properties with small rational exponents
        (``0.25 diameter^2/mass``), an affine function of properties where signs differ, or each object's own; objects
        may scatter about it. The evidence decides, with odds against properties: where these say nothing, they are
        taken in few of a hundred cases. The coefficients become what their relations say, and more precise.

        Parameters
        ----------
        properties
            Names of properties that the law knows of its objects; or the properties, a mapping from object to values
            by name, or a table (a file, a frame) with a row for each object. Default: all numbers that it knows of
            every object. Without any, ``[]``, coefficients are universal or each object's own.

        Raises
        ------
        CommonlawError
            If a property is not known or no number, objects have terms of their own, there is only one, or the law
            does not know how accurate its coefficients are.

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
        from commonlaw.law.explaining import offered
        from commonlaw.law.script import written

        if not self.shared:
            raise CommonlawError("explain-own-terms")
        found, names = offered(properties, self.properties, self.objects, self.schema.object)
        law, given = self._explained_by(found, names), "" if properties is None else written(properties)

        def other(each: Law) -> Law:
            with suppress(CommonlawError):  # It stays as it is where nothing decides its coefficients
                return replace(each._explained_by(found, names), provenance=each.provenance)
            return each

        provenance = replace(law.provenance, calls=(*law.provenance.calls, f"law.explain({given})"))
        return replace(law, provenance=provenance).with_others(self.each_other(other))

    def _explained_by(self, found: Properties, names: Sequence[str]) -> "Law":
        """Return the law by properties of these names, without looking at what else it could be."""
        from commonlaw.law.explaining import explained, explaining_step, table_of

        table = table_of(found, names, self.objects)
        keys = [(self.left_hand_sides[j], self.terms.names[k]) for j, k in np.argwhere(self.support)]
        units, given = self.coefficient_units(), {**self.schema.units, **found.units}
        values, uncertainty = explained(
            self.coefficients, self.uncertainty, self.support, [units.get(key) for key in keys], table, given
        )
        step = explaining_step(uncertainty, keys, names)
        return replace(
            self,
            coefficients=values,
            uncertainty=uncertainty,
            provenance=replace(self.provenance, history=(*self.history, step)),
            schema=replace(self.schema, units=given),
            properties=found.values,
        )

    # What the law says

    def candidates(self) -> "pd.DataFrame":
        """Return the candidates that the law was chosen from, what speaks for each, and which was chosen.

        By evidence: ``2 log B``, twice the logarithm of the Bayes factor of the law over each (Kass and Raftery 1995),
        and the probability if one of the equation's candidates is right. Where forecasts of what was left out chose the
        law: ``log score difference``, by how much less the logarithm of the probability of that is by each.
        """
        from commonlaw.law.tables import candidate_frame

        return candidate_frame(self.alternatives)

    def path(self) -> "pd.DataFrame":
        """Return the equations that all values of the solver's hyperparameter give, in segments from the smallest.

        Each row holds from its threshold, penalty or number of terms to the next row's, with the measures of
        `candidates`; a candidate may come more than once.

        Raises
        ------
        CommonlawError
            If the law was not chosen from the path of one solver.
        """
        from commonlaw.law.tables import path_frame

        return path_frame(self.left_hand_sides, self.alternatives)

    def __repr__(self) -> str:
        form = self.structure() if self.shared else ("each object with its own terms",)
        few = self.objects if len(self.objects) <= text.MANY else (counted(len(self.objects), "object"),)
        return f"<Law of {', '.join(few)}: {'; '.join(form)}>"

    def __str__(self) -> str:
        own = self.provenance.equations and len(self.objects) == 1
        values = zip(self._heads(), *(each[0] for each in self.letter_values()), strict=True) if own else ()
        simpler = resolve_name("commonlaw.law.simplifying:within_errors")(self)
        return text.printed(self._body(), self.state_rates, values, simpler, self.outcomes)

    def _body(self) -> list[str]:
        """Return the lines that hold the coefficients of all objects."""
        if len(self.objects) == 1:
            return [*self.equations()]
        if self.explanation is not None:
            return self._explained_body()
        if self.shared and not self.letters:
            return [*self.structure()]
        if self.shared:
            return [*self.structure(), "", *text.coefficient_table(self.objects, self._heads(), *self.letter_values())]
        return [line for name in self.objects for line in (f"{name}:", *(f"  {each}" for each in self.equations(name)))]

    # Keeping it, and writing it down

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
        from commonlaw.law.json import encode

        return encode(self).decode()

    @classmethod
    def from_json(cls, content: str | bytes) -> "Law":
        """Return the law that `to_json` wrote.

        Raises
        ------
        CommonlawError
            If the text is damaged, or written by another version of the schema.
        """
        from commonlaw.law.json import decode

        return cls._of(decode(content.encode() if isinstance(content, str) else content))

    @classmethod
    def _of(cls, decoded: "Decoded") -> "Law":
        own, wider, others = decoded
        plausible = tuple(PlausibleLaw(probability, cls(*each)) for probability, each in others)
        law = cls(*own)
        provenance = replace(law.provenance, with_discrepancy=wider and cls(*wider))
        return replace(law, provenance=provenance).with_others(plausible)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the law, whole or not at all: as JSON, or if the file is named ``.parquet`` with a row for each object.

        Raises
        ------
        CommonlawError
            If the file cannot be written, or must not: it is read-only, a folder, or one of several names of a file; or
            if it would not be read again, as of so many objects in JSON, or with numbers whose squares are infinite.
        """
        from commonlaw.law.file import law_bytes

        write_whole(path, law_bytes(self, path))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Law":
        """Read a law that `save` wrote.

        Raises
        ------
        CommonlawError
            If the file cannot be read or is no law; the message names the file.
        """
        from commonlaw.law.file import decoded_file

        content = read_file(path)
        try:
            return cls._of(decoded_file(content))
        except CommonlawError as error:
            raise error.at(str(path)) from None
