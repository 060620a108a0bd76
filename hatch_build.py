"""Builds the compiled kernel where there is a C compiler; without one commonlaw computes with NumPy.

Run by pip when it installs or makes a wheel, and by hand: ``python hatch_build.py``. CC names another compiler, and
with COMMONLAW_KERNEL=numpy nothing is built.
"""

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ModuleNotFoundError:  # By hand, outside of a build
    BuildHookInterface = object

KERNEL = Path(__file__).parent / "src" / "commonlaw" / "kernel"
# No contraction to fused operations: the same bits on all machines of a kind
FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared", "-fvisibility=hidden")


class CustomBuildHook(BuildHookInterface):
    """Called by hatchling before it makes a wheel, also that of an editable installation."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the kernel, and say that the wheel is for this platform if that succeeds."""
        library = build()
        if library is not None and version == "standard":
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data.update(pure_python=False, tag=f"py3-none-{platform}")


def build() -> Path | None:
    """Build the kernel beside its sources and return where it is; None if that cannot be done here."""
    library = KERNEL / ("kernel.dll" if os.name == "nt" else "kernel.so")
    library.unlink(missing_ok=True)
    compiler = _compiler()
    if compiler is None or os.environ.get("COMMONLAW_KERNEL") == "numpy":
        return None
    sources = sorted(KERNEL.glob("*.[ch]"))
    name = f'-DSOURCES="{digest(sources)}"'
    made = library.with_suffix(".new")
    command = [*compiler, *FLAGS, name, *(str(each) for each in sources if each.suffix == ".c"), "-o", str(made), "-lm"]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"the kernel was not built: {error}\n{getattr(error, 'stderr', '')}", file=sys.stderr)
        return None
    return made.replace(library)


def digest(sources: list[Path]) -> str:
    """Return what tells whether a kernel was made of these sources."""
    return hashlib.sha256(b"\0".join(each.read_bytes() for each in sources)).hexdigest()


def _compiler() -> list[str] | None:
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    found = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    return None if found is None else [found]


if __name__ == "__main__":
    found = build()
    sys.exit("no kernel was built: commonlaw computes with NumPy" if found is None else print(found))
