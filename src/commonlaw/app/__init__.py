"""The app: a page on this machine alone, from a table to a law without code."""

from commonlaw.app.server import serve

__all__ = ["serve"]
