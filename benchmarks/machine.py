"""What the numbers were measured on."""

import importlib.util
import os
import platform
from importlib.metadata import version
from pathlib import Path


def machine() -> str:
    """Return the processor, the versions of Python and of the packages that matter."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    packages = [name for name in ("numpy", "scipy", "pysindy", "heyoka") if importlib.util.find_spec(name)]
    versions = ", ".join(f"{name} {version(name)}" for name in ("commonlaw", *packages))
    return f"{model}, {os.cpu_count()} cores; Python {platform.python_version()}, {versions}"
