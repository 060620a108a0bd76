"""How accurate the coefficients of a law are."""

from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError

if TYPE_CHECKING:
    from commonlaw.law.law import Law


def covariance_of(law: "Law") -> Floats:
    """Return the covariance of the law's coefficients, shape (objects, parameters, parameters).

    Raises
    ------
    CommonlawError
        If it is not known.
    """
    if law.covariance is None:
        raise CommonlawError(
            "this law does not know how accurate its coefficients are: discover it without naming a solver, or give "
            "its covariance"
        )
    return law.covariance


def standard_errors(law: "Law") -> Floats:
    """Return the standard error of every coefficient in the law, shape (objects, equations, terms), NaN elsewhere."""
    errors = np.full(law.coefficients.shape, np.nan)
    if law.covariance is not None:
        errors[:, law.support] = np.sqrt(np.diagonal(law.covariance, axis1=1, axis2=2))
    errors.flags.writeable = False
    return errors


def shown_errors(law: "Law", name: str, wanted: bool | None) -> Floats:
    """Return the standard errors of one object to show, shape (equations, terms): zeros if they are not wanted.

    Parameters
    ----------
    law, name
        The law, and one of its objects.
    wanted
        Whether errors are to be shown; None if they are known.

    Raises
    ------
    CommonlawError
        If errors are wanted that are not known.
    """
    if wanted:
        covariance_of(law)
    if wanted is False or law.covariance is None:
        return np.zeros(law.support.shape)
    return np.asarray(law.standard_errors[law.objects.index(name)])


def normal_quantile(level: float) -> float:
    """Return how many standard deviations on both sides of the mean hold this share of a normal distribution.

    Raises
    ------
    CommonlawError
        If the share is not between 0 and 1.

    Examples
    --------
    >>> round(normal_quantile(0.95), 2)
    1.96
    """
    if not 0 < level < 1:
        raise CommonlawError(f"the level is {level}: give a share between 0 and 1, such as 0.95")
    return NormalDist().inv_cdf((1 + level) / 2)
