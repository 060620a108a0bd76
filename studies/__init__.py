"""Studies: finished investigations that run from end to end and make a report."""

import os

os.environ["COMMONLAW_CACHE"] = "off"  # What is reported is found, not remembered
