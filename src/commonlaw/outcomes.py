"""What can come out of a computation besides its numbers, said in words."""

from dataclasses import dataclass
from enum import StrEnum

from commonlaw.diagnostics import filled, marked, notes


class OutcomeKind(StrEnum):
    """Every kind of outcome there is; each is also its text, as messages and saved laws have it."""

    AMBIGUOUS = "ambiguous"
    """Other coefficients fit the measurements as well."""
    APPROXIMATION = "approximation"
    """The law with the best solutions, where no law of the library fits the measurements within their noise."""
    BOUND = "bound"
    """A coefficient is at its bound."""
    CHOSEN = "chosen"
    """The terms of an equation were chosen from candidates; the text says why these."""
    COPIES = "copies"
    """Trials are exact copies of others, and count all the same."""
    DISCRETE_TIME = "discrete time"
    """A law in discrete time explains what the one in continuous time does not."""
    DIVERGED = "diverged"
    """A trajectory ran away, or no number of steps could follow it on."""
    EMPTY_SUPPORT = "empty support"
    """An equation has no term."""
    ERRORS = "errors"
    """Other errors than white noise were chosen; the text says which, and what they change."""
    FEW_SAMPLES = "few samples"
    """An equation has as many terms as the samples can tell apart."""
    ILL_CONDITIONED = "ill-conditioned"
    """Terms nearly depend on each other on the samples."""
    METHOD = "method"
    """Another method than most laws are found by was taken."""
    MODEL_ERROR = "model error"
    """Lack of fit: no law of the library fits the measurements within their noise."""
    NOT_CONVERGED = "not converged"
    """A solver stopped before it was done."""
    NOT_IDENTIFIABLE = "not identifiable"
    """The trials cannot tell which of several laws holds where they have not been."""
    NOT_INTEGRATED = "not integrated"
    """An integrator could not follow a trajectory that another one may finish."""
    ONE_OBJECT = "one object"
    """What objects are to share was found from one of them."""
    RATES = "rates"
    """A measured column is the rate of another, and no state of its own."""
    RESIDUALS = "residuals"
    """The errors that were taken do not explain what a law leaves of the measurements."""
    SAMPLES = "samples"
    """A law was fitted to some of the samples, as they are many."""
    SCALE = "scale"
    """A term hangs on where the scale of a variable has its zero."""
    START = "start"
    """Trials start where the law says that nothing ever happens."""
    TRIALS_DIFFER = "trials differ"
    """Coefficients change from trial to trial of an object by more than errors of measurement."""
    UNITS = "units"
    """What was chosen depends on the units of measurement."""


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
        return f"{self.kind}{index}: {self.text}; {self.remedy}"


def note(code: str, where: str = "", /, **parameters: object) -> Outcome:
    """Return a note of the catalogue, its sentences filled in; code in them stays between backticks.

    >>> print(note("trials-differ", objects="2 (Ann, Ben)").kind)
    trials differ
    """
    entry = notes()[code]
    text, remedy = (filled(entry[part], parameters, marked) for part in ("text", "remedy"))
    return Outcome(OutcomeKind(entry["kind"]), where, text, remedy, code)
