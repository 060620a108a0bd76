"""A page on a law, as one file that needs nothing else."""

import os
from dataclasses import dataclass
from html import escape

from commonlaw.report.printing import printed
from commonlaw.runtime.files import write_whole


@dataclass(frozen=True)
class Page:
    """Report as a self-contained HTML page; notebooks display it.

    Parameters
    ----------
    html
        The HTML of the page.
    """

    html: str

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the page, completely or not at all; with the ending ``.pdf`` printed by an installed browser.

        Raises `CommonlawError` if the file cannot be written or must not be overwritten, or no browser prints it.
        """
        page = self.html.encode()
        write_whole(path, printed(page) if os.fspath(path).lower().endswith(".pdf") else page)

    def __repr__(self) -> str:
        return f"<Page of {len(self.html) / 1e6:.1f} MB: save(path), then open it in a browser>"

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{escape(self.html)}" style="width: 100%; height: 40rem; border: 0"></iframe>'
