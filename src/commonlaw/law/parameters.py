"""The parameters of a law: what its names stand for, in the coefficients of terms."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import mul
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats

if TYPE_CHECKING:
    import pint


class Part(NamedTuple):
    """A power of a coefficient of the law, divided by a number, as it stands in what a name means."""

    equation: int
    term: int
    factor: float = 1.0
    power: int = 1


class Coefficient(NamedTuple):
    """A coefficient by the name that a user knows it by, as a product of powers of coefficients of terms.

    In ``x'' = -2 x/m`` it is -2 over that of x. In ``T' = -k (T - a)``, multiplied out ``-k T + k a``, a is the
    coefficient of 1 over minus that of T. A constant inside of terms is the coefficient of its own, see
    `Terms.constants`.
    """

    name: str
    parts: tuple[Part, ...]

    @property
    def equation(self) -> int:
        """The equation where it stands first."""
        return self.parts[0].equation

    @property
    def term(self) -> int:
        """The term that it stands before first."""
        return self.parts[0].term

    def value(self, wholes: Sequence[Floats]) -> Floats:
        """Return what the name stands for, from the whole number before each of its terms; infinite over 0."""
        found = np.ones_like(wholes[0])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for part, whole in zip(self.parts, wholes, strict=True):
                found = found * (whole / part.factor) ** np.float64(part.power)
        return np.asarray(found)

    def of(self, coefficients: Floats) -> Floats:
        """Return what it stands for, from coefficients whose last axes are equations and terms."""
        return self.value([coefficients[..., each.equation, each.term] for each in self.parts])

    def gradient(self, coefficients: Floats) -> Floats:
        """Return its derivatives by the coefficients of its parts, shape (objects, parts)."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            wholes = [coefficients[:, each.equation, each.term] for each in self.parts]
            shares = [part.power / whole for part, whole in zip(self.parts, wholes, strict=True)]
            return np.asarray(self.value(wholes)[:, np.newaxis] * np.stack(shares, axis=1))


class Product(NamedTuple):
    """What stands before a term: a number and coefficients with their powers of 1 or -1, by name."""

    equation: int
    term: int
    factor: float
    coefficients: tuple[tuple[str, int], ...]

    def value(self, values: Mapping[str, Floats]) -> Floats:
        """Return it, from values by name."""
        found = np.asarray(self.factor, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for name, power in self.coefficients:
                found = found * np.asarray(values[name], dtype=np.float64) ** power
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Parameters:
    """The parameters of a law: the names in `Law.structure`, and what they stand for.

    Parameters
    ----------
    definitions
        Each as a product of powers of coefficients of terms.
    products
        What stands before each term, by name.
    coefficients
        Of terms, shape (objects, equations, terms).
    support
        Which of these are in the law, shape (equations, terms).
    term_covariance
        Of each object's coefficients in the support, shape (objects, coefficients, coefficients); None if unknown.
    term_units
        Returns the known units of coefficients, by equation and term.
    """

    definitions: tuple[Coefficient, ...]
    products: tuple[Product, ...]
    coefficients: Floats
    support: Bools
    term_covariance: Floats | None
    term_units: "Callable[[], Mapping[tuple[int, int], pint.Unit]]"

    @property
    def names(self) -> tuple[str, ...]:
        """The names, in the order of `Law.structure`."""
        return tuple(each.name for each in self.definitions)

    @cached_property
    def values(self) -> Floats:
        """Estimates, shape (objects, parameters)."""
        values = np.empty((len(self.coefficients), len(self.definitions)))
        for i, each in enumerate(self.definitions):
            values[:, i] = each.of(self.coefficients)
        values.flags.writeable = False
        return values

    @cached_property
    def errors(self) -> Floats:
        """Standard errors to first order, shape (objects, parameters); NaN where unknown."""
        errors = np.full(self.values.shape, np.nan)
        for i, each in enumerate(self.definitions):
            indices = self._indices(each)
            if self.term_covariance is not None and indices:
                slopes, inner = each.gradient(self.coefficients), self.term_covariance[:, indices][:, :, indices]
                with np.errstate(invalid="ignore"):
                    errors[:, i] = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", slopes, inner, slopes), 0.0))
        errors.flags.writeable = False
        return errors

    @property
    def covariance(self) -> Floats:
        """Covariance to first order, shape (objects, parameters, parameters); NaN where unknown."""
        slopes = np.full((*self.values.shape, int(self.support.sum())), np.nan)
        for i, each in enumerate(self.definitions):
            if indices := self._indices(each):
                slopes[:, i] = 0.0
                slopes[:, i, indices] = each.gradient(self.coefficients)
        if self.term_covariance is None:
            return np.full((*self.values.shape, self.values.shape[1]), np.nan)
        return np.asarray(slopes @ self.term_covariance @ slopes.transpose(0, 2, 1))

    @cached_property
    def units(self) -> tuple[str | None, ...]:
        """Units, as far as those of the variables determine them."""
        known, found = self.term_units(), list[str | None]()
        for each in self.definitions:
            units = [known.get((part.equation, part.term)) for part in each.parts]
            powers = [unit**part.power for unit, part in zip(units, each.parts, strict=True) if unit is not None]
            found.append(f"{reduce(mul, powers):~P}" if len(powers) == len(each.parts) else None)
        return tuple(found)

    def _indices(self, parameter: Coefficient) -> list[int]:
        """Return the indices of its coefficients among those in the support; none if one is not in it."""
        indices = {(j, k): i for i, (j, k) in enumerate(np.argwhere(self.support).tolist())}
        found = [indices.get((part.equation, part.term)) for part in parameter.parts]
        return [each for each in found if each is not None] if None not in found else []
