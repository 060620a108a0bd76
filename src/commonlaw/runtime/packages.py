"""Other packages: optional ones, and warnings of them that say nothing to users."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from commonlaw.errors import CommonlawError
from commonlaw.runtime.forking import ProcessLock


def optional_import(module: str, feature: str, extra: str) -> Any:
    """Return a module of a package that not every installation has, such as ``"pyarrow.parquet"``.

    The feature, such as ``"reading Parquet files"``, is what needs it, and the extra of commonlaw brings it.

    Raises `CommonlawError` if the package is not installed; the message says how to install it.
    """
    package = module.split(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != package:
            raise
        raise CommonlawError("extra-missing", feature=feature, package=package.replace("_", "-"), extra=extra) from None


_ALONE = ProcessLock()
"""What warnings are shown is set for the whole process: of two threads, each would put back what the other has set."""


@contextmanager
def quiet(category: type[Warning], message: str = "") -> Iterator[None]:
    """Leave out warnings of a category whose text begins with a regular expression."""
    with _ALONE.held(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message, category)
        yield
