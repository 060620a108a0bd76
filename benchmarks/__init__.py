"""commonlaw measured beside PySINDy and beside a bound: ``python -m benchmarks``."""

import os

os.environ["COMMONLAW_CACHE"] = "off"  # What is measured is found, not remembered
