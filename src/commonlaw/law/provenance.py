"""How a law was found: the differentiation, the candidates, every choice, and what a user should know of it."""

from dataclasses import dataclass

from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.law.alternative import Alternative
from commonlaw.law.history import History, Step
from commonlaw.outcomes import Outcome


@dataclass(frozen=True)
class Provenance:
    """Where a law comes from.

    Parameters
    ----------
    differentiation
        How derivatives were estimated; a forecast from measurements estimates the initial derivatives in the same way.
        None if they were not, or if it is not known.
    outcomes
        What a user should know about how the law was found.
    alternatives
        The candidates that it was chosen from, if it was chosen.
    history
        Every choice on the way to the law, in order.
    """

    differentiation: AbstractDifferentiator | None = None
    outcomes: tuple[Outcome, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    history: tuple[Step, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "history", History(self.history))
