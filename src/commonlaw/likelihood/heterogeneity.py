"""Between-trial heterogeneity: the F test of coefficients that differ between the trials of an object.

With the likelihood linearized about the law, R_1 the residual sum of squares with coefficients common to the trials of
an object, R_2 with those of each trial, and degrees of freedom nu_1 and nu_2 of these,

    F = (R_1 - R_2) / (nu_1 - nu_2) / (R_2 / nu_2).
"""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.formulation import column_scales

HETEROGENEITY_LEVEL = 0.01
"""P-value, times the number of objects that are tested (Bonferroni), below which trials differ."""


def heterogeneity_p_value(factors: Sequence[Floats], measurements: int, least_variance: float = 0.0) -> float:
    """Return the p-value of the F test for rows ``[columns | target]`` of each trial; one if it cannot be made.

    Initial states are eliminated from the rows, and from the number of measurements; columns have unit noise, or at
    least a variance of as much.
    """
    from scipy.special import fdtrc

    common = factors[0].shape[1] - 1
    rss_common, rss = _rss(np.concatenate(factors)), sum(_rss(factor) for factor in factors)
    separate = sum(np.linalg.matrix_rank(factor[:, :-1]) for factor in factors)
    additional, nu = separate - common, measurements - separate
    variance = max(rss / nu, least_variance) if nu > 0 else 0.0
    if additional <= 0 or not common or not variance:
        return 1.0
    return float(fdtrc(additional, nu, max(rss_common - rss, 0.0) / additional / variance))


def _rss(factor: Floats) -> float:
    columns, target = factor[:, :-1], factor[:, -1]
    scaled = columns / column_scales(columns)
    theta = np.linalg.lstsq(scaled, target, rcond=1e-10)[0]
    return float(np.sum((target - scaled @ theta) ** 2))
