"""How often the terms of a known law are found again."""

from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.law import Law


@dataclass(frozen=True)
class Recovery:
    """In how many of some independent tries the right terms were found.

    Parameters
    ----------
    found, tried
        Numbers of tries.

    Raises
    ------
    CommonlawError
        If nothing was tried, or more was found than tried.

    Examples
    --------
    >>> Recovery(45, 50).share
    0.9
    >>> low, high = Recovery(45, 50).interval()
    >>> print(f"{low:.3f} to {high:.3f}")
    0.786 to 0.957
    """

    found: int
    tried: int

    def __post_init__(self) -> None:
        if self.tried < 1 or not 0 <= self.found <= self.tried:
            raise CommonlawError(
                f"{self.found} found of {self.tried} tried: try at least once, and count what was found among the tries"
            )

    @property
    def share(self) -> float:
        """Share of the tries in which the right terms were found."""
        return self.found / self.tried

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the interval that holds the probability of finding them with a confidence of `level`.

        Wilson (1927), "Probable inference, the law of succession, and statistical inference".

        Raises
        ------
        CommonlawError
            If the level is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise CommonlawError(f"level is {level:g}: give a confidence between 0 and 1, such as 0.95")
        z = NormalDist().inv_cdf((1 + level) / 2)
        scale = 1 + z**2 / self.tried
        middle = (self.share + z**2 / (2 * self.tried)) / scale
        half = z / scale * sqrt(self.share * (1 - self.share) / self.tried + z**2 / (4 * self.tried**2))
        # Rounding must not leave the share outside, as at 0 and 1
        return min(self.share, max(0.0, middle - half)), max(self.share, min(1.0, middle + half))


def recovered(law: Law, truth: Law) -> Bools:
    """Return which objects of a law have exactly the terms of the true law in every equation, shape (objects,).

    Terms are compared by their names; the libraries may differ.

    Raises
    ------
    CommonlawError
        If the true law has no such object, or other equations.
    """
    if law.left_hand_sides != truth.left_hand_sides:
        raise CommonlawError(
            f"the law gives {', '.join(law.left_hand_sides)}, the true law {', '.join(truth.left_hand_sides)}; "
            "compare laws of the same states and order"
        )
    return np.array([_terms(law, name) == _terms(truth, name) for name in law.objects])


def recovers(law: Law, truth: Law) -> bool:
    """Return whether every object of a law has exactly the terms of the true law, see `recovered`."""
    return bool(recovered(law, truth).all())


def _terms(law: Law, name: str) -> set[tuple[int, str]]:
    """Return the equation and name of each term of an object."""
    return {(int(j), law.terms.names[k]) for j, k in np.argwhere(law.coefficients_of(name))}
