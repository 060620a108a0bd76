"""What an experiment is for: which law is right, what the coefficients are, or one number that follows from them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.experiments.gaussian import Evidence
from commonlaw.experiments.predictive import Hypothesis
from commonlaw.experiments.quantities import Quantity, quantity

LAW, COEFFICIENTS = "law", "coefficients"


@dataclass(frozen=True, eq=False)
class Aim:
    """What is to be learned, among hypotheses with these probabilities, shape (K,).

    Without a quantity: which hypothesis is right, or, if there is nothing to tell apart or if coefficients were asked
    for, all coefficients together (D-optimality).
    """

    prior: Floats
    of_law: bool
    quantity: Quantity | None = None

    @classmethod
    def of(cls, text: str | None, prior: Floats, hypotheses: Sequence[Hypothesis]) -> "Aim":
        """Return the aim that a text names; by default the law, if it is in doubt."""
        if text in (None, LAW, COEFFICIENTS):
            return cls(prior, len(prior) > 1 and text != COEFFICIENTS)
        return cls(prior, False, quantity(str(text), hypotheses))

    def bits(self, evidence: Evidence) -> float:
        """Return how much is learned of it, in bits."""
        if self.quantity is not None:
            now, then = self.quantity.std(self.prior), self.quantity.expected_std(self.prior, evidence)
            return float(np.log2(now / then)) if then > 0 else 0.0
        nats = (
            evidence.information_about_law(self.prior)
            if self.of_law
            else self.prior @ evidence.gain().mean(axis=(0, 2))
        )
        return float(nats / np.log(2))
