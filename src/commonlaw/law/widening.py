"""How much wider intervals of forecasts are than a law says, by how far ahead they forecast."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError


@dataclass(frozen=True, eq=False)
class Widening:
    """Factors of intervals of forecasts, as forecasts of what was left out asked for.

    Parameters
    ----------
    horizons
        How far ahead, increasing from zero or more, shape (m,).
    factors
        There, above zero, shape (m,); between horizons they lie on straight lines, and beyond them they stay.
    """

    horizons: Floats
    factors: Floats

    def checked(self) -> "Widening":
        """Return the same as read-only arrays, refusing what is no widening.

        Raises
        ------
        CommonlawError
            If the shapes differ, horizons do not increase, or a factor is not above zero.
        """
        arrays = [np.array(each, dtype=np.float64) for each in (self.horizons, self.factors)]
        horizons, factors = arrays
        fits = horizons.ndim == 1 and horizons.shape == factors.shape and len(horizons) > 0
        if not (fits and np.all(np.diff(horizons) > 0) and np.all(factors > 0) and np.isfinite(arrays).all()):
            raise CommonlawError("interval-inflation")
        for each in arrays:
            each.flags.writeable = False
        return Widening(horizons, factors)

    def at(self, ahead: Floats) -> Floats:
        """Return the factors so far ahead, of the shape of the horizons that are given."""
        return np.asarray(np.interp(ahead, self.horizons, self.factors))
