"""What can come out of a computation besides its numbers, said in words."""

from dataclasses import dataclass
from enum import StrEnum

from commonlaw.diagnostics import filled, marked, notes


class OutcomeKind(StrEnum):
    """The kinds of notes on results, as messages and saved laws name them; the catalogue has their meanings."""

    AMBIGUOUS = "ambiguous"
    APPROXIMATION = "approximation"
    BOUND = "bound"
    CHOSEN = "chosen"
    COPIES = "copies"
    DISCRETE_TIME = "discrete time"
    DIVERGED = "diverged"
    EMPTY_SUPPORT = "empty support"
    ERRORS = "errors"
    FEW_SAMPLES = "few samples"
    ILL_CONDITIONED = "ill-conditioned"
    METHOD = "method"
    MODEL_ERROR = "model error"
    NOT_CONVERGED = "not converged"
    NOT_IDENTIFIABLE = "not identifiable"
    NOT_INTEGRATED = "not integrated"
    ONE_OBJECT = "one object"
    RATES = "rates"
    RESIDUALS = "residuals"
    SAMPLES = "samples"
    SCALE = "scale"
    START = "start"
    TRIALS_DIFFER = "trials differ"
    UNITS = "units"


@dataclass(frozen=True)
class Outcome:
    """Something that a user should know about a result that was reached all the same.

    Parameters
    ----------
    kind
        Its name.
    where
        The equation, object or trial that it concerns; empty when it concerns the whole.
    text
        What happened, with its numbers.
    remedy
        What to do about it.
    code
        Names text and remedy in the catalogue; empty for what a law of an earlier version has on record.
    """

    kind: OutcomeKind
    where: str
    text: str
    remedy: str
    code: str = ""

    def __str__(self) -> str:
        index = f" ({self.where})" if self.where else ""
        return f"{self.kind}{index}: {self.text}; {self.remedy}" + (f" [{self.code}]" if self.code else "")


def note(code: str, where: str = "", /, **parameters: object) -> Outcome:
    """Return a note of the catalogue, its sentences filled in; code in them stays between backticks.

    >>> print(note("trials-differ", objects="2 (Ann, Ben)").kind)
    trials differ
    """
    entry = notes()[code]
    text, remedy = (filled(entry[part], parameters, marked) for part in ("text", "remedy"))
    return Outcome(OutcomeKind(entry["kind"]), where, text, remedy, code)
