"""The score by which laws are compared: minus twice the logarithm of a probability, a sum of named parts.

By Laplace's method (Tierney and Kadane 1986) minus twice the log-evidence of a law is

    likelihood + latent states + coefficients + scatter + errors + outliers + structure + ...

with the parts listed in `Part`. The difference of two scores is 2 log B of the Bayes factor B (Kass and Raftery 1995).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import fsum
from typing import Literal

from commonlaw.runtime.forking import cached_property

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
    "scatter of starts",
    "Laplace correction",
    "multiplicity",
    "strange objects",
    "refit",
    "forecasts",
]
"""
``likelihood``
    Of the measurements, with the noise scale integrated out, see `evidence.NoiseScale`.
``latent states``
    The log-determinant of the information on the trajectories, which are integrated out.
``coefficients``
    log n for each mean over objects and log(objects) for each variance (BIC).
``scatter``
    Marginal deviance of coefficients as random effects, see `commonlaw.hierarchy.marginal_deviance`.
``structure``
    Prior of the supports of all equations, see `supports.StructurePrior`.
``model error``, ``error levels``
    BIC of a random walk and of the levels of reference errors, with the prior of the noise.
``outliers``
    Penalty of measurements beyond the Huber threshold.
``initial conditions``
    Normal prior of initial states and rates, see `initial_conditions`.
``scatter of starts``
    What a normal distribution of initial states over trials adds, see `InitialConditionPrior`.
``Laplace correction``
    Predicted decrease to the maximum of the linearized likelihood.
``multiplicity``
    2 log N of one among N hypotheses.
``strange objects``
    Of the measurements of objects that do not follow the law of the others, by laws of their own, and their prior.
``refit``
    Change of the score of the best law on a finer mesh or under reference noise, added to laws that are not refitted.
``forecasts``
    The predictive score of held-out data, the only part of its kind.
"""


class Kind(StrEnum):
    """The probability whose logarithm a score is."""

    EVIDENCE = "largest evidence"
    FORECASTS = "best forecasts of held-out data"


@dataclass(frozen=True, eq=False)
class Score:
    """Minus twice the logarithm of a probability, in named parts.

    Parameters
    ----------
    parts
        Summands of the total.
    kind
        Marginal likelihood, or predictive probability of held-out data; scores of two kinds are not comparable.

    Examples
    --------
    >>> linear, cubic = Score({"likelihood": 12.5, "structure": 3.0}), Score({"likelihood": 20.0})
    >>> linear.total, linear < cubic, cubic - linear
    (15.5, True, 4.5)
    """

    parts: Mapping[Part, float]
    kind: Kind = Kind.EVIDENCE

    @cached_property
    def total(self) -> float:
        """The sum of the parts."""
        return fsum(self.parts.values())

    def plus(self, part: Part, value: float) -> "Score":
        """Return the score with a value added to one of its parts."""
        return Score({**self.parts, part: self.parts.get(part, 0.0) + value}, self.kind)

    def __sub__(self, reference: "Score") -> float:
        """Return 2 log B against this, of two scores of one kind."""
        self._check(reference)
        return self.total - reference.total

    def __lt__(self, reference: "Score") -> bool:
        self._check(reference)
        return self.total < reference.total

    def _check(self, reference: "Score") -> None:
        if self.kind is not reference.kind:
            raise TypeError(f"a score by {self.kind} does not compare with one by {reference.kind}")
