"""The command line."""

from commonlaw.runtime.shutdown import ending_at_once

with ending_at_once():  # These imports take half a second
    from commonlaw.cli.main import main

__all__ = ["main"]
