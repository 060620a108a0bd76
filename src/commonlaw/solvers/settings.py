"""Checks of the numbers that a user gives to a solver."""

import numpy as np

from commonlaw.errors import CommonlawError


def check_setting(
    name: str, value: float | None, least: float, *, whole: bool = False, optional: bool = False, above: bool = False
) -> None:
    """Refuse a value that is no finite number of at least `least`.

    Parameters
    ----------
    name, value
        The setting.
    least
        The smallest value that fits.
    whole
        Whether only whole numbers fit.
    optional
        Whether None fits.
    above
        Whether `least` itself does not fit.
    """
    if value is None and optional:
        return
    kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    number = isinstance(value, kinds) and not isinstance(value, bool)
    if not number or value is None or not np.isfinite(value) or value < least or (above and value == least):
        kind, bound = "whole number" if whole else "number", "above" if above else "of at least"
        raise CommonlawError(f"{name} {value!r} does not fit: give a {kind} {bound} {least}")


def check_shared(shared: object) -> None:
    """Refuse what is neither True nor False."""
    if not isinstance(shared, bool):
        raise CommonlawError(f"shared {shared!r} does not fit: give True for one support of all objects, or False")
