"""What every part of the study starts from."""

from dataclasses import dataclass

from commonlaw.report import Text
from commonlaw.trials import Trials
from studies.falling_balls.report import Section, Verdict


@dataclass(frozen=True)
class Inquiry:
    """What every part of the study starts from.

    Parameters
    ----------
    drops
        The measured drops; none if they cannot be had.
    missing
        Why there are none.
    seed
        Of the simulated noise.
    """

    drops: Trials | None
    missing: str
    seed: int


def left_out(name: str, title: str, missing: str) -> Section:
    """Return the section of a part that needs the measured drops when there are none."""
    verdict = Verdict("left out", "this part needs the measured drops")
    return Section(name, title, (Text(f"The measured drops are missing: {missing}"),), (verdict,))
