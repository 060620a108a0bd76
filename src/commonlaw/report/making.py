"""The parts of a law's report that say what it was made from, how, and how to make it again."""

import platform
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

import pandas as pd

from commonlaw import __version__
from commonlaw.law.script import Source
from commonlaw.report.document import Block, Section, Table, Text
from commonlaw.report.law_case import LawCase, folded, listed
from commonlaw.report.markup import code
from commonlaw.wording import counted

_SPOKEN = {"median_step": "median step", "largest_deviation": "largest deviation"}
_PACKAGES = ("numpy", "scipy", "pandas", "matplotlib", "heyoka")


def data_checks(case: LawCase) -> Section:
    """Return the part on what the data checks found."""
    found = case.trials.check(order=0)  # What trials cannot tell is among the outcomes of the law
    remarks = [*found.lines(), *dict.fromkeys(found.notes), *map(str, case.law.outcomes)]
    said = "The data checks found nothing." if not remarks else listed([case.said(each) for each in remarks])
    trials = case.trials
    objects, samples = counted(len(trials.objects), "object"), sum(map(len, trials))
    counts = f"{counted(len(trials), 'trial')} of {objects}, {samples} samples."
    learned, some = sum(map(len, case.findings.training)), counted(len(case.findings.training), "trial")
    held_out = "" if case.findings.training is trials else f" Learned from {learned} samples of {some}."
    frame = found.to_frame().drop(columns="clipped")
    frame.columns = [_SPOKEN.get(name, name) for name in frame.columns]
    table = Table("trials", "All trials.", frame)
    return Section("data-checks", "Data checks", (Text(f"{counts}{held_out}{said}"), folded(table, "All trials")))


def choices(case: LawCase) -> Section:
    """Return the part on every choice on the way."""
    rows = [
        {"stage": each.stage, "choice": each.choice, "reason": case.words(each.reason)} for each in case.law.history
    ]
    block: Block = Text("No choices are on record.")
    if rows:
        block = Table("history", "Every choice on the way to the law, and why.", pd.DataFrame(rows))
    return Section("choices", "How it was found", (block,))


def again(case: LawCase, command: str, table: str | Source) -> Section:
    """Return the part that says how to make the law again."""
    asked = f"The command:{code(command, 'sh')}" if command else ""
    text = asked
    if table:
        is_said = isinstance(table, Source) and not table.stream
        is_whole = case.findings.training is case.trials or is_said
        some = "" if is_whole else ", which learns from all trials of the table"
        text += f"In Python{some}:{code(case.law.to_script(table), 'python')}"
    made_with = ", ".join([f"Python {platform.python_version()}", *_versions()])
    return Section("again", "How to make it again", (Text(f"{text}Made with {made_with}."),))


def _versions() -> Iterator[str]:
    yield f"commonlaw {__version__}"
    for name in _PACKAGES:
        with suppress(PackageNotFoundError):
            yield f"{name} {version(name)}"
