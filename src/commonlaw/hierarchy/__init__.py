"""Random effects: the scatter of coefficients over objects, its evidence, pooling, and relations to properties."""

from commonlaw.hierarchy.explain import Explained, explain
from commonlaw.hierarchy.random_effects import (
    LIKELIEST_SWEEPS,
    WORST_CONDITION,
    RandomEffects,
    Shrinkage,
    informative,
    marginal_deviance,
    relative_variances,
    shrink,
)
from commonlaw.hierarchy.relation import Dimensions, PropertyTable, Relation, RelationKind

__all__ = [
    "LIKELIEST_SWEEPS",
    "WORST_CONDITION",
    "Dimensions",
    "Explained",
    "PropertyTable",
    "RandomEffects",
    "Relation",
    "RelationKind",
    "Shrinkage",
    "explain",
    "informative",
    "marginal_deviance",
    "relative_variances",
    "shrink",
]
