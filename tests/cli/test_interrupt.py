"""Ctrl-C while the command is still being loaded."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from time import sleep

import pytest

STARTS = {
    "module": "import runpy; runpy.run_module('commonlaw', run_name='__main__')",
    "script": "import sys; from commonlaw.cli import main; sys.exit(main())",
}
"""What Python runs for `python -m commonlaw` and in the script of the installed command."""


@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS)
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.1, 0.3])
def test_ctrl_c_while_modules_are_imported_ends_without_a_traceback(start: str, delay: float) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    waiting = "import atexit, time; atexit.register(time.sleep, 60)"  # A fast machine is done before the signal
    process = subprocess.Popen(
        [sys.executable, "-X", "importtime", "-c", f"{waiting}; {start}", "data", "list"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # Jobs in the background ignore it
    )  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:  # Python lists each module once it is imported; this is among the first
        if "click" in line:
            break
    sleep(delay)
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=60)
    assert "Traceback" not in rest
    assert process.returncode == -signal.SIGINT  # Which shells show as 130
