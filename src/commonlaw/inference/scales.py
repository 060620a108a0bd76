"""What goes with states on a logarithmic scale, and what does not."""

from collections.abc import Sequence
from typing import Literal, get_args

from commonlaw.errors import CommonlawError
from commonlaw.inference.error_search import ErrorKind
from commonlaw.law import Law
from commonlaw.trials import Schema


def error_kinds(errors: ErrorKind | Literal["auto"], schema: Schema) -> tuple[ErrorKind, ...]:
    """Return the kinds of errors that are compared for trials of a schema.

    Raises
    ------
    CommonlawError
        If noise is to grow with the logarithm of a state.
    """
    if errors == "proportional" and schema.logarithmic:
        raise CommonlawError(
            f"on a logarithmic scale, here of {', '.join(schema.logarithmic)}, errors are in proportion to the state: "
            "leave errors='proportional' out, or positive=..."
        )
    kinds: tuple[ErrorKind, ...] = get_args(ErrorKind) if errors == "auto" else (errors,)
    return tuple(each for each in kinds if each != "proportional" or not schema.logarithmic)


def check_one_scale(laws: Sequence[Law]) -> None:
    """Refuse to compare laws that follow states on different scales."""
    scales = [", ".join(law.schema.logarithmic) or "none" for law in laws]
    if len(set(scales)) > 1:
        raise CommonlawError(
            f"states on a logarithmic scale are {' and '.join(dict.fromkeys(scales))}, and evidence compares laws on "
            "one scale: fit all of them with positive=..., or none"
        )
