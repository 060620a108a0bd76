"""What can come out of a computation besides its numbers, said in words."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """Something that a user should know about a result that was reached all the same.

    Parameters
    ----------
    kind
        Its name: ``"empty support"``, ``"diverged"``, ``"few samples"``, ``"ill-conditioned"``, ``"not converged"``,
        ``"model error"``, ``"one object"``.
    where
        The equation, object or trial that it concerns; empty when it concerns the whole.
    text
        What happened, with its numbers.
    remedy
        What to do about it.
    """

    kind: str
    where: str
    text: str
    remedy: str

    def __str__(self) -> str:
        index = f" ({self.where})" if self.where else ""
        return f"{self.kind}{index}: {self.text}; {self.remedy}"
