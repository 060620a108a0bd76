"""What needs no POSIX works where its modules are missing, as on Windows."""

import math
import subprocess
import sys

SCRIPT = """
import os, sys

for name in ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog"):
    sys.modules[name] = None
for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY", "set_blocking", "fork", "killpg"):
    delattr(os, name)

from commonlaw.cli import main

for line in (
    "data export decays.csv --save copy.csv",
    "discover copy.csv --library poly:1 --method derivative-regression --save law.json",
    "predict copy.csv law.json --save forecast.csv",
    "report copy.csv law.json --save report.html",
):
    sys.argv = ["commonlaw", *line.split()]
    try:
        main()
    except SystemExit as ended:
        if ended.code:
            sys.exit(f"{line}: {ended.code}")
"""


def test_laws_are_found_saved_and_reported_without_modules_of_posix(tmp_path):
    rows = [
        f"{each},{t},{each * math.exp(-t / each) + 1e-3 * math.sin(37 * t * each)}"
        for each in (1, 2)
        for t in range(15)
    ]
    (tmp_path / "decays.csv").write_text("\n".join(["object,t,x", *rows]))
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    written = {"decays.csv", "copy.csv", "law.json", "forecast.csv", "report.html"}
    assert {each.name for each in tmp_path.iterdir()} == written
