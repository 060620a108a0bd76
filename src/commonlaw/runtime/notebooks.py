"""What notebooks show: values as tables and figures, and the progress of long work."""

import sys
from collections.abc import Callable
from html import escape
from pkgutil import resolve_name
from time import monotonic
from typing import Any
from weakref import finalize

from commonlaw.text import in_line


class ShownInNotebooks:
    """A value that notebooks show as its most important table and a small figure."""

    def _repr_html_(self) -> str:
        # What draws stands above what is drawn, so that it is found by name
        shown: str = resolve_name("commonlaw.report:notebook_html")(self)
        return shown


def in_notebook() -> bool:
    """Return whether Python runs in a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return type(shell).__name__ == "ZMQInteractiveShell"


def show_type(kind: type, svg: Callable[[Any], str]) -> None:
    """Have the notebook that runs, if one does, show values of a class as drawings."""
    if in_notebook():
        shell: Any = resolve_name("IPython:get_ipython")()
        shell.display_formatter.formatters["image/svg+xml"].for_type(kind, svg)


class ProgressBar:
    """Shows steps of work below the cell that runs, with a bar that stops when nothing holds this any longer."""

    def __init__(self) -> None:
        self._began = monotonic()
        self._handle: Any = None

    def __call__(self, step: str, interim: str = "") -> None:
        """Show a step, and below it what was found so far."""
        content = f"<progress></progress> {escape(in_line(step))} ({monotonic() - self._began:.0f} s)"
        content += f"<br>{escape(interim)}" * bool(interim)
        if self._handle is None:
            self._handle = resolve_name("IPython.display:display")(_html(content), display_id=True)
            finalize(self, _end, self._handle, self._began)
        else:
            self._handle.update(_html(content))


def _html(content: str) -> Any:
    return resolve_name("IPython.display:HTML")(content)


def _end(handle: Any, began: float) -> None:
    handle.update(_html(f"<progress value='1'></progress> done ({monotonic() - began:.0f} s)"))
