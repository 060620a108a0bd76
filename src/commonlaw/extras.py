"""Packages that only some features need: imported where they are used, or missed with the way to install them."""

from importlib import import_module
from typing import Any

from commonlaw.errors import CommonlawError


def optional_import(module: str, feature: str, extra: str) -> Any:
    """Return a module of a package that not every installation has, such as ``"pyarrow.parquet"``.

    The feature, such as ``"reading Parquet files"``, is what needs it, and the extra of commonlaw brings it.

    Raises
    ------
    CommonlawError
        If the package is not installed; the message says how to install it.
    """
    package = module.split(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != package:
            raise
        raise CommonlawError("extra-missing", feature=feature, package=package.replace("_", "-"), extra=extra) from None
