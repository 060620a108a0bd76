"""Runs hostile cases, each in a process of its own, and counts how they end: `make fuzz`.

A case that is neither done nor refused in words is a fault; it is printed with the kind and the seed that make it.
"""

import argparse
import copy
import faulthandler
import json
import os
import pickle
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from contextlib import chdir, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from io import FileIO, TextIOWrapper
from pathlib import Path
from typing import Any
from unittest.mock import patch
from warnings import catch_warnings, simplefilter

import commonlaw
from tests.hostile.case import SECRET, Case
from tests.hostile.cases import COLUMNS, EXECUTED, KINDS, REGRESSION, folder, make, saved_law, shown, table

os.environ["COMMONLAW_CACHE"] = "off"  # Each case is worked on, whatever was asked before

SECONDS, BYTES = 20, 4 * 2**30
"""What a case may take: seconds of computing, and memory."""

_WAITING = 600.0
"""Seconds from its start after which a case is ended that computes little or nothing."""

PROGRESS = 1000
"""Cases after which is said how many there were."""

_VIRTUAL = 8 * 2**30
"""Of address space, which is more than the memory in use."""

_FELL = 70
"""Exit code of a case that ended in an exception."""

_WARNING = re.compile(r"^(\w+\.)*\w*Warning: ", re.MULTILINE)
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@dataclass(frozen=True)
class Ending:
    """How a case ended."""

    code: int
    output: str
    message: str
    seconds: float
    """Of computing."""
    memory: int


def run(case: Case, at: Path) -> Ending:
    """Run the command of a case in its folder, within limits."""
    began, child = time.monotonic(), os.fork()
    if not child:
        _become(case, at)
    while True:
        ended, status, used = os.wait4(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() - began > _WAITING:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.002)
    output, message = ((at.parent / each).read_bytes().decode(errors="replace") for each in ("stdout", "stderr"))
    code = os.waitstatus_to_exitcode(status)
    return Ending(code, output, message, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024)


def _become(case: Case, at: Path) -> None:
    """Be the process of a command, and end."""
    from commonlaw.cli import main

    code = _FELL
    try:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_AS, (_VIRTUAL, _VIRTUAL))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
        for number, each in enumerate((os.devnull, at.parent / "stdout", at.parent / "stderr")):
            os.dup2(os.open(each, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600), number)
        sys.stdout, sys.stderr = (TextIOWrapper(FileIO(number, "w", closefd=False), "utf-8") for number in (1, 2))
        faulthandler.register(signal.SIGXCPU, chain=True)  # Where a case that takes too long is
        os.chdir(at)
        sys.argv = ["commonlaw", *case.arguments]
        with catch_warnings():
            _raise_warnings()
            if case.program:
                exec("\n".join(case.program), {"cl": commonlaw, "copy": copy, "pickle": pickle})
                code = 0
            else:
                main()
    except commonlaw.CommonlawError as error:
        code = 1
        print(error, file=sys.stderr)
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _raise_warnings() -> None:
    """Make an exception of every warning that Python and its packages show by default."""
    for category in (BytesWarning, FutureWarning, RuntimeWarning, SyntaxWarning, UnicodeWarning, UserWarning):
        simplefilter("error", category)
    simplefilter("default", commonlaw.LongWorkWarning)


def fault(case: Case, ending: Ending, at: Path) -> str:
    """Return what is wrong with how a case ended, nothing if it was done or refused in words."""
    there = {str(each.relative_to(at)): each for each in at.rglob("*")}
    kept = {**case.files, **case.others}
    made = {*there} - {*kept, "pipe", "link.csv"}
    # A table of many files says of each what was wrong, also where none has a law
    done = ending.code == 0 or "--each" in case.arguments or bool(case.program)
    allowed = {os.path.normpath(target) for target in case.targets} if done else set()
    # What a command writes and does not read may be replaced
    named = Counter(os.path.normpath(argument) for argument in case.arguments)
    same = {*kept} - {each for each in allowed if named[each] == 1}
    known = case.samples is not None or case.truth
    answer = json.loads(ending.output)["trials"] if known and ending.code == 0 else None
    faults = {
        "hang": ending.code in (-signal.SIGXCPU, -signal.SIGKILL) or ending.seconds > SECONDS,
        "warning": bool(_WARNING.search(ending.message)),
        "memory": ending.memory > BYTES,
        "killed": ending.code < 0,
        "traceback": ending.code == _FELL or "Traceback (most recent" in ending.message,
        "code": ending.code not in (0, 1, 2, _FELL) and ending.code > 0,
        "mute": ending.code > 0 and not ending.message.strip(),
        "control characters": bool(_CONTROL.search(ending.output + ending.message)),
        "executed": EXECUTED in there,
        "leaked": SECRET in ending.output + ending.message + "".join(_texts(there[each]) for each in made),
        "files lost": any(not there[each].is_file() or there[each].read_bytes() != kept[each] for each in same),
        "accepted": case.refused and ending.code == 0,
        "files left": not made <= allowed,
        "wrong": case.samples is not None and (answer is None or _found(answer)["samples"] != case.samples),
        "silently wrong": answer is not None and any(_found(answer)[each] != case.truth[each] for each in case.truth),
    }
    return ", ".join(name for name, is_so in faults.items() if is_so)


def _found(trials: list[dict[str, Any]]) -> dict[str, object]:
    """Return what a check of data found: samples, objects, trials, states, and all durations."""
    return {
        "samples": sum(trial["samples"] for trial in trials),
        "objects": sorted({trial["object"] for trial in trials}),
        "trials": len(trials),
        "states": sorted(trials[0]["first"]),
        "durations": [round(trial["duration"], 6) for trial in trials],
    }


def _texts(file: Path) -> str:
    return file.read_bytes().decode(errors="replace") if file.is_file() else ""


def load() -> None:
    """Load what commands load when they run, so that cases, which are forks of this process, have it already."""
    from commonlaw.cli import main

    with tempfile.TemporaryDirectory() as at, chdir(at), redirect_stdout(None), redirect_stderr(None):
        Path("law.json").write_bytes(saved_law())
        Path("drops.csv").write_bytes(table(random.Random(0)))
        for arguments in (
            ("discover", "drops.csv", *COLUMNS, *REGRESSION),
            ("fit", "drops.csv", "height'' = a + b sin(height)", *COLUMNS),
            ("predict", "drops.csv", "law.json", "--save", "out.csv"),
            ("show", "law.json"),
            ("data", "check", "drops.csv", *COLUMNS, "--json"),
            ("data", "export", "drops.csv", "--save", "out.parquet"),
        ):
            with patch.object(sys, "argv", ["commonlaw", *arguments]), suppress(SystemExit):
                main()


def judged(kind: str, seed: int) -> tuple[str, str]:
    """Run a case; return how it ended, and the report of a fault."""
    case, at = make(kind, seed), Path(tempfile.mkdtemp()) / "case"
    try:
        at.mkdir()
        folder(case, at)
        ending = run(case, at)
        found = fault(case, ending, at)
        if not found:
            return ("done" if ending.code == 0 else "refused"), ""
        said = ending.message.strip()[-1500:]
        return found, f"{kind} {seed}: {found} ({ending.seconds:.1f} s): {shown(case)}\n{said}\n"
    finally:
        shutil.rmtree(at.parent)


def main() -> int:
    """Run so many cases of every kind from a seed on; return the number of faults."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000, help="of all kinds together")
    parser.add_argument("--seed", type=int, default=0, help="of the first case of each kind")
    parser.add_argument("--kind", choices=list(KINDS), action="append", help="only this kind; repeat for more")
    chosen = parser.parse_args()
    kinds, counts, faults = chosen.kind or list(KINDS), Counter[tuple[str, str]](), 0
    load()
    for i in range(chosen.cases):
        kind = kinds[i % len(kinds)]
        ended, report = judged(kind, chosen.seed + i // len(kinds))
        counts[kind, ended] += 1
        faults += bool(report)
        print(report, end="", flush=True)
        if (i + 1) % PROGRESS == 0:
            print(f"{i + 1} of {chosen.cases} cases, {faults} faults", file=sys.stderr)
    for (kind, ended), count in sorted(counts.items()):
        print(f"{kind:12} {ended:20} {count:6}")
    print(f"{chosen.cases} cases, {faults} faults")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
