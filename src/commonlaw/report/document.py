"""A report and its sections."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from commonlaw.report.blocks import Block, check_name
from commonlaw.report.verdict import Verdict


@dataclass(frozen=True, eq=False)
class Section:
    """One part of a report.

    Parameters
    ----------
    name
        Anchor in the page: lower-case letters, digits and hyphens.
    title
        Heading.
    blocks
        Text, tables and pictures in the order of reading.
    verdicts
        How the results compare with what was published.
    results
        Numbers by key, nested as one likes, with NumPy arrays and numbers as they are. The keys are the report's own:
        no two sections have the same.

    Raises
    ------
    CommonlawError
        If the name is not of that kind.
    """

    name: str
    title: str
    blocks: tuple[Block, ...]
    verdicts: tuple[Verdict, ...] = ()
    results: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_name(self.name)


@dataclass(frozen=True, eq=False)
class Report:
    """A finished investigation.

    Parameters
    ----------
    title
        Heading of the page.
    summary
        What was asked, done and found; Markdown with LaTeX mathematics between dollar signs.
    sections
        In the order of reading.
    """

    title: str
    summary: str
    sections: tuple[Section, ...]

    @property
    def results(self) -> dict[str, Any]:
        """The results of all sections: what ``results.json`` holds."""
        return {key: value for section in self.sections for key, value in section.results.items()}

    def keep(self, *kinds: type[Block]) -> "Report":
        """Return the report with only these kinds of blocks."""
        sections = (
            replace(section, blocks=tuple(block for block in section.blocks if isinstance(block, kinds)))
            for section in self.sections
        )
        return replace(self, sections=tuple(sections))
