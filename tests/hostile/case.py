"""What a hostile case is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

SECRET = "xyzzy-of-another-file"
"""What stands in a file that no command of a case names."""


@dataclass(frozen=True)
class Case:
    """A command or a program in a folder of files, what it may write, and what it must find, if that is known."""

    arguments: tuple[str, ...]
    files: Mapping[str, bytes]
    targets: frozenset[str] = frozenset()
    samples: int | None = None
    """How many samples it must find."""
    truth: Mapping[str, object] = field(default_factory=dict)
    """What it must find unless it refuses, by `found`."""
    refused: bool = False
    """Whether it must be refused."""
    program: Sequence[str] = ()
    """Statements in Python that are run in place of the command."""
    others: Mapping[str, bytes] = field(
        default_factory=lambda: {"secret.csv": f"ball,password\ngolf,{SECRET}\n".encode()}
    )
