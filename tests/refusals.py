"""What is refused, by the code of its message and not by its words."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from commonlaw import CommonlawError
from commonlaw.diagnostics import Diagnostic


def message(code: str, where: str = "", /, **parameters: object) -> Diagnostic:
    """Return a message of these parameters, and perhaps others."""
    return Diagnostic(code, parameters, where)


@contextmanager
def refused(expected: str | Diagnostic, /, where: str = "", **parameters: object) -> Iterator[Any]:
    """Expect an error with this code, its own or that of a message it holds, and with these parameters among others."""
    wanted = message(expected, where, **parameters) if isinstance(expected, str) else expected
    with pytest.raises(CommonlawError) as caught:
        yield caught
    error: CommonlawError = caught.value
    assert wanted.code in error.codes, str(error)
    given = _given(error.diagnostic)
    assert {name: given.get(name) for name in wanted.parameters} == dict(wanted.parameters), str(error)
    assert wanted.where in error.diagnostic.where, str(error)


def _given(diagnostic: Diagnostic) -> dict[str, object]:
    """Return the parameters of a message and of those that it holds."""
    found = dict(diagnostic.parameters)
    for inner in diagnostic.parameters.values():
        found |= _given(inner) if isinstance(inner, Diagnostic) else {}
    return found
