"""A page on a law, as one file that needs nothing else."""

import os
from dataclasses import dataclass
from html import escape

from commonlaw.runtime.files import write_whole


@dataclass(frozen=True)
class Page:
    """A report as one page that needs nothing else; notebooks show it.

    Parameters
    ----------
    html
        The page.
    """

    html: str

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page, whole or not at all.

        Raises `CommonlawError` if the file cannot be written, or must not.
        """
        write_whole(path, self.html.encode())

    def __repr__(self) -> str:
        return f"<Page of {len(self.html) / 1e6:.1f} MB: save(path), then open it in a browser>"

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{escape(self.html)}" style="width: 100%; height: 40rem; border: 0"></iframe>'
