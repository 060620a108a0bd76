"""What came of comparing a result with what was published."""

from dataclasses import dataclass

from commonlaw.errors import unknown

KINDS = ("reproduced", "reproduced with correction", "differs", "beyond the paper", "left out")


@dataclass(frozen=True)
class Verdict:
    """One sentence on how a result compares with what was published.

    Parameters
    ----------
    kind
        ``"reproduced"``; ``"reproduced with correction"``, where the print errs and the method gives something else;
        ``"differs"``; ``"beyond the paper"``, where nothing was published; or ``"left out"``, where something that it
        needs is missing.
    text
        The sentence, with the numbers; Markdown with mathematics between dollar signs.

    Raises
    ------
    CommonlawError
        If the kind is not one of these.
    """

    kind: str
    text: str

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise unknown("kind of verdict", self.kind, KINDS)
