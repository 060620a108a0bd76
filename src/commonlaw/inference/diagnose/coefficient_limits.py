"""The bounds of coefficients of terms that are not in a law, as `commonlaw.bounds` gives them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from commonlaw.runtime.notebooks import ShownInNotebooks

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Bound:
    """What the measurements say of the coefficient that an object would have of a term that is not in the law.

    Parameters
    ----------
    equation, term, object
        Whose coefficient.
    coefficient, error
        As it is fitted with the terms of the law, and its standard error.
    low, high
        The ends of its interval.
    at_most
        What its size stays below with the probability of the interval, if beforehand all values were as probable.
    effect
        What the term then adds to the equation at most, over the trajectories of the trials.
    unit
        Of the coefficient; empty where the units of the variables do not tell it.
    """

    equation: str
    term: str
    object: str
    coefficient: float
    error: float
    low: float
    high: float
    at_most: float
    effect: float
    unit: str

    @property
    def seen(self) -> bool:
        """Whether the interval does not hold zero."""
        return self.low > 0 or self.high < 0


@dataclass(frozen=True)
class Bounds(ShownInNotebooks):
    """How large coefficients of absent terms could be, without the trials showing it; it prints as sentences.

    Each term is fitted with those of the law, with free starts and all errors, and objects learn from each other as
    in `commonlaw.refine`. A coefficient stays below its bound with the probability `level`, if beforehand all values
    were as probable; next to it stands what the term then adds to the equation at most, over the trajectories of the
    trials.

    Parameters
    ----------
    bounds
        One for each equation, term and object.
    level
        Of bounds and intervals.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> print(cl.bounds(cl.fit("x'' = -g - c v", drops), drops, ["v^2"]))
    v^2 in x'': |coefficient| < 0.021 1/m, contribution < 15 (95 %; largest: Ball 5).
    """

    bounds: tuple[Bound, ...]
    level: float

    def to_frame(self) -> "pd.DataFrame":
        """Return a table with a row for each equation, term and object."""
        import pandas as pd

        names = {"error": "standard error", "at_most": "limit", "effect": "contribution"}
        rows = [vars(each) | {"seen": each.seen} for each in self.bounds]
        return pd.DataFrame([{names.get(name, name): value for name, value in row.items()} for row in rows])

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the measurements say of each term, in words."""
        found = list[str]()
        for equation, term in dict.fromkeys((each.equation, each.term) for each in self.bounds):
            objects = [each for each in self.bounds if (each.equation, each.term) == (equation, term)]
            largest, seen = max(objects, key=lambda each: each.effect), [each.object for each in objects if each.seen]
            among = f" of {', '.join(seen)}" if len(objects) > 1 else ""
            beyond = f" The interval{among} excludes zero: the term may be present." if seen else ""
            size = f"{float(f'{largest.at_most:.2g}'):g} {largest.unit}".rstrip()
            whose = f"; largest: {largest.object}" if len(objects) > 1 else ""
            found.append(
                f"{term} in {equation}: |coefficient| < {size}, contribution < {float(f'{largest.effect:.2g}'):g} "
                f"({100 * self.level:.3g} %{whose}).{beyond}"
            )
        return tuple(found)

    def __str__(self) -> str:
        return "\n".join(self.sentences)
