"""The command line."""

from commonlaw.cli.main import main

__all__ = ["main"]
