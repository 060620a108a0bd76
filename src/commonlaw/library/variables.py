"""The variables that terms are functions of."""

from collections.abc import Sequence
from dataclasses import dataclass

from commonlaw.errors import CommonlawError, unknown


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


def checked_names(names: Sequence[str] | str | None) -> tuple[str, ...] | None:
    """Return names as a tuple, hashable; a text is names between commas.

    Raises
    ------
    CommonlawError
        If there is none, or one is there twice.
    """
    if names is None:
        return None
    listed = tuple(each.strip() for each in names.split(",")) if isinstance(names, str) else tuple(names)
    if not listed or len(set(listed)) < len(listed):
        raise CommonlawError(
            f"name each variable of a library once, and at least one; got {', '.join(listed) or 'none'}"
        )
    return listed
