"""How a coefficient goes with its object: alike for all, by the object's properties, or the object's own."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.hierarchy.dimensions import Dimensions


class RelationKind(StrEnum):
    """What decides a coefficient; each is also its text."""

    UNIVERSAL = "universal"
    """It is the same for all objects."""
    POWER_LAW = "power law"
    """It is a factor times powers of properties."""
    AFFINE = "affine"
    """It is a number and properties times numbers: for coefficients whose sign is not that of all."""
    OWN = "own"
    """It is each object's own, about a typical value."""


@dataclass(frozen=True)
class Relation:
    """What one coefficient is for every object.

    Parameters
    ----------
    kind
        What decides it.
    factors
        The factor C of ``C p^a q^b``, the universal or the typical value; or for an affine function the constant and
        what each property is multiplied with.
    errors
        Their standard errors.
    properties
        Those that it follows.
    exponents
        Theirs, in a power law.
    scatter, scatter_error
        How far objects stray from that, and the standard error of this number: the standard deviation of the
        coefficient's logarithm, or if the scatter is not relative, of the coefficient itself (in a power law at the
        typical object, elsewhere in proportion).
    relative
        Whether the scatter is that of the logarithm.
    probability
        How probable this relation is among all that were compared.
    typical
        Product of the powers of the properties at the typical object, the geometric mean: 1 without any.
    """

    kind: RelationKind
    factors: tuple[float, ...]
    errors: tuple[float, ...]
    properties: tuple[str, ...] = ()
    exponents: tuple[Fraction, ...] = ()
    scatter: float = 0.0
    scatter_error: float = 0.0
    relative: bool = True
    probability: float = 1.0
    typical: float = 1.0

    def columns(self, values: Floats) -> Floats:
        """Return what the factors are multiplied with, shape (objects, factors), by the properties of objects.

        Their values have the shape (objects, properties), in the order of `properties`.
        """
        ones = np.ones((len(values), 1))
        if self.kind is RelationKind.AFFINE:
            return np.concatenate([ones, values], axis=1)
        powers = np.prod(values ** np.array([float(each) for each in self.exponents]), axis=1, keepdims=True)
        return np.asarray(ones * powers)


@dataclass(frozen=True, eq=False)
class PropertyTable:
    """Numbers that objects carry: names of the properties, values of shape (objects, properties), known dimensions."""

    names: tuple[str, ...]
    values: Floats
    dimensions: Dimensions | None = None

    @property
    def varying(self) -> "PropertyTable":
        """Those that differ between objects; others explain nothing."""
        return self.choose([i for i, column in enumerate(self.values.T) if np.ptp(column) > 0])

    @property
    def positive(self) -> "PropertyTable":
        """Those that have a logarithm."""
        return self.choose([i for i, column in enumerate(self.values.T) if (column > 0).all()])

    def choose(self, indices: Sequence[int]) -> "PropertyTable":
        """Return some of them."""
        return PropertyTable(tuple(self.names[i] for i in indices), self.values[:, list(indices)], self.dimensions)

    @property
    def logs(self) -> Floats:
        """Their logarithms, less the means over objects."""
        logs = np.log(self.values)
        return np.asarray(logs - logs.mean(axis=0))

    @property
    def standardized(self) -> Floats:
        """Their values in standard deviations from the means over objects."""
        return np.asarray((self.values - self.values.mean(axis=0)) / self.values.std(axis=0))
