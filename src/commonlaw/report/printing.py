"""Pages as PDF, printed by a browser that is installed: Chromium, Chrome or Edge, without a window."""

import os
import subprocess
from pathlib import Path

from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import is_file, private_file, read_file

_BROWSERS = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge", "msedge"),
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)
_SECONDS = 120
"""For a page of some megabytes on a busy machine."""


def browser() -> Path:
    """Return the program that prints; refuse a machine without one."""
    places = (Path(folder, name) for name in _BROWSERS for folder in os.get_exec_path())
    program = next(filter(is_file, places), None)
    if program is None:
        raise CommonlawError("report-without-browser")
    return program


def printed(page: bytes) -> bytes:
    """Return a page as PDF.

    Raises `CommonlawError` if no browser is installed, or it does not print.
    """
    program = browser()
    with private_file("report.html", page) as source:
        target, lines = None, ["no place for temporary files"]
        if source is not None:
            target = source.with_suffix(".pdf")
            options = [
                "--headless",
                "--disable-gpu",
                "--no-pdf-header-footer",
                f"--user-data-dir={source.parent}/profile",
            ]
            if hasattr(os, "geteuid") and os.geteuid() == 0:  # Browsers refuse their sandbox to the administrator
                options.append("--no-sandbox")
            command = [str(program), *options, f"--print-to-pdf={target}", source.as_uri()]
            try:
                done = subprocess.run(command, capture_output=True, timeout=_SECONDS)
                lines = done.stderr.decode(errors="replace").strip().splitlines()
            except (OSError, subprocess.TimeoutExpired) as error:
                lines = [str(error)]
        if target is None or not is_file(target):
            raise CommonlawError("report-not-printed", browser=program, error=lines[-1] if lines else "no file")
        return read_file(target)
