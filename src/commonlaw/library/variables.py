"""The variables that terms are functions of."""

from collections.abc import Sequence
from dataclasses import dataclass

from commonlaw.errors import unknown


@dataclass(frozen=True)
class Variables:
    """The names that terms may use, in the order of the columns of the array that terms are evaluated on.

    Parameters
    ----------
    states
        The state variables; for a law of second order followed by their rates.
    inputs
        Measured inputs.
    time
        The name of time, the last column.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    time: str = "t"

    @property
    def names(self) -> tuple[str, ...]:
        """All names: states, inputs, time."""
        return (*self.states, *self.inputs, self.time)

    def index(self, name: str) -> int:
        """Return the column of a variable.

        Raises
        ------
        CommonlawError
            If there is no variable of that name.
        """
        if name not in self.names:
            raise unknown("variable", name, self.names)
        return self.names.index(name)

    def columns(self, names: Sequence[str] | None = None) -> tuple[int, ...]:
        """Return the columns of the named variables; without names those of all states and inputs, but not time.

        Raises
        ------
        CommonlawError
            If there is no variable of some name.
        """
        if names is None:
            return tuple(range(len(self.states) + len(self.inputs)))
        return tuple(self.index(name) for name in names)
