"""What `refine`, `compare`, `bounds` and `update` ask of a scheme: a law fitted again to trials."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from commonlaw.inference.search.setup import RefitOptions
from commonlaw.law import Law
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.trials import Trials, TrialStream


@dataclass(frozen=True, eq=False)
class AbstractFit(ABC):
    """How a law is fitted to trials of its objects."""

    takes_rows_of_inputs: ClassVar[bool]
    """Whether inputs count in rows without measurements."""
    law: Law

    @property
    @abstractmethod
    def has_joint_objects(self) -> bool:
        """Whether objects are fitted together, so that laws are compared by fits of their trajectories."""

    @abstractmethod
    def refitted(
        self,
        trials: Trials,
        options: RefitOptions,
        progress: ProgressCallback,
        equations: Sequence[str] | None = None,
    ) -> Law:
        """Return the law fitted to trials, whose estimates are first values; of other equations, if there are some.

        Raises `CommonlawError` as `refine` does.
        """

    @abstractmethod
    def by_file(self, stream: TrialStream, options: RefitOptions, progress: ProgressCallback) -> Law:
        """Return the law fitted to each file of a stream, whose objects are in no other file."""

    @abstractmethod
    def updated(self, trials: Trials) -> Law:
        """Return the law of the objects of these trials with its parameters as prior of theirs, see `Law.update`."""
