"""Pages as PDF, printed by a browser that is installed: Chromium, Chrome or Edge, without a window."""

import os
import subprocess
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory

from commonlaw.errors import CommonlawError

_BROWSERS = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge", "msedge"),
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)
_SECONDS = 120
"""For a page of some megabytes on a busy machine."""


def browser() -> str:
    """Return the program that prints; refuse a machine without one."""
    program = next(filter(None, map(which, _BROWSERS)), None)
    if program is None:
        raise CommonlawError("report-without-browser")
    return program


def printed(page: bytes) -> bytes:
    """Return a page as PDF.

    Raises `CommonlawError` if no browser is installed, or it does not print.
    """
    program = browser()
    with TemporaryDirectory(prefix="commonlaw-") as folder:
        source, target = Path(folder) / "report.html", Path(folder) / "report.pdf"
        source.write_bytes(page)
        options = ["--headless", "--disable-gpu", "--no-pdf-header-footer", f"--user-data-dir={folder}/profile"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:  # Browsers refuse their sandbox to the administrator
            options.append("--no-sandbox")
        try:
            command = [program, *options, f"--print-to-pdf={target}", source.as_uri()]
            done = subprocess.run(command, capture_output=True, timeout=_SECONDS)
            lines = done.stderr.decode(errors="replace").strip().splitlines()
        except (OSError, subprocess.TimeoutExpired) as error:
            lines = [str(error)]
        if not target.is_file():
            raise CommonlawError("report-not-printed", browser=program, error=lines[-1] if lines else "no file")
        return target.read_bytes()
