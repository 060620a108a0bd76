"""commonlaw measured beside PySINDy and beside a bound: ``python -m benchmarks``."""
