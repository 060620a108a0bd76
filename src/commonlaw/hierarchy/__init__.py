"""Random effects: the scatter of coefficients over objects, its evidence, pooling, and relations to properties."""

from commonlaw.hierarchy.explain import Explained as Explained, explain as explain
from commonlaw.hierarchy.random_effects import (
    LIKELIEST_SWEEPS as LIKELIEST_SWEEPS,
    WORST_CONDITION as WORST_CONDITION,
    RandomEffects as RandomEffects,
    Shrinkage as Shrinkage,
    informative as informative,
    marginal_deviance as marginal_deviance,
    relative_variances as relative_variances,
    shrink as shrink,
)
from commonlaw.hierarchy.relation import (
    Dimensions as Dimensions,
    PropertyTable as PropertyTable,
    Relation as Relation,
    RelationKind as RelationKind,
)
