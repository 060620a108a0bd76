"""What laws are compared by: minus twice the logarithm of a probability, as one sum of named parts.

By Laplace's method (Tierney and Kadane 1986) minus twice the log-evidence of a law is

    likelihood + latent states + coefficients + scatter + errors + outliers + structure + ...

with each part where it is computed: see `PARTS`. The least is the most probable. A difference of two is 2 log B of the
Bayes factor B (Kass and Raftery 1995).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from math import fsum
from typing import Literal

Part = Literal[
    "likelihood",
    "latent states",
    "coefficients",
    "scatter",
    "structure",
    "model error",
    "error levels",
    "outliers",
    "initial conditions",
    "Laplace correction",
    "multiplicity",
    "refit",
    "forecasts",
]
"""
``likelihood``
    Of the measurements, with the scale of the noise integrated out, see `evidence.Measured`.
``latent states``
    The log-determinant of the information on all states, which are integrated out.
``coefficients``
    log n for each mean over objects and log(objects) for each variance (BIC).
``scatter``
    What is lost by coefficients that scatter over objects, see `commonlaw.hierarchy.marginal_deviance`.
``structure``
    Of the supports of all equations, see `priors.StructurePrior`.
``model error``, ``error levels``
    Of a random walk in each step, and of the levels of other errors (BIC), with the prior of the noise.
``outliers``
    Of measurements beyond the Huber threshold.
``initial conditions``
    Of starts that are normal over trials, see `AlikeStarts`, or of rates at starts, see `score_of_order`.
``Laplace correction``
    What the likelihood linearized about a fit predicts to gain elsewhere (predicted decrease).
``multiplicity``
    2 log N of one among N hypotheses.
``refit``
    By how much the best law changed on a mesh or under a noise that an alternative was not fitted again on.
``forecasts``
    Of a predictive score, which has no other part.
"""


class Kind(StrEnum):
    """What a score is the logarithm of."""

    EVIDENCE = "largest evidence"
    FORECASTS = "best forecasts of held-out data"


@dataclass(frozen=True, eq=False)
class Score:
    """Minus twice the logarithm of a probability, in named parts.

    Parameters
    ----------
    parts
        They add up to the total.
    kind
        Evidence, or the predictive probability of what was left out; scores of two kinds do not compare.

    Examples
    --------
    >>> one, other = Score({"likelihood": 12.5, "structure": 3.0}), Score({"likelihood": 20.0})
    >>> one.total, one < other, other - one
    (15.5, True, 4.5)
    """

    parts: Mapping[Part, float]
    kind: Kind = Kind.EVIDENCE

    @cached_property
    def total(self) -> float:
        """The sum of the parts."""
        return fsum(self.parts.values())

    def plus(self, part: Part, value: float) -> "Score":
        """Return the score with this added to one of its parts."""
        return Score({**self.parts, part: self.parts.get(part, 0.0) + value}, self.kind)

    def __sub__(self, other: "Score") -> float:
        """Return 2 log B against this, of two scores of one kind."""
        self._check(other)
        return self.total - other.total

    def __lt__(self, other: "Score") -> bool:
        self._check(other)
        return self.total < other.total

    def _check(self, other: "Score") -> None:
        if self.kind is not other.kind:
            raise TypeError(f"a score by {self.kind} does not compare with one by {other.kind}")
