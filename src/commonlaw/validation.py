"""Checks of the numbers that a user gives as arguments."""

import numpy as np

from commonlaw.errors import CommonlawError


def check_whole_number(
    name: str, value: object, least: int, most: int | None = None, *, optional: bool = False
) -> None:
    """Refuse an argument that is no whole number from `least` to `most`, if there is a most.

    None fits where it is `optional`.
    """
    if value is None and optional:
        return
    upper = np.inf if most is None else most
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not least <= value <= upper:
        bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise CommonlawError("whole-number", name=name, value=value, bounds=bounds)


def check_number(name: str, value: object, least: float, *, above: bool = False, optional: bool = False) -> None:
    """Refuse an argument that is no finite number of at least `least`, or `above` it; `optional` ones may be None."""
    if value is None and optional:
        return
    size = np.nan
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        size = float(value)
    if not np.isfinite(size) or size < least or (above and size == least):
        raise CommonlawError(
            "finite-number-bounded", name=name, value=value, bound="above" if above else "of at least", least=least
        )
