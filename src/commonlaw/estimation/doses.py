"""Where the doses that a table records enter given equations."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from commonlaw.errors import CommonlawError, check_choice
from commonlaw.estimation.model import ModelText
from commonlaw.library.bounds import parts_of
from commonlaw.library.equation import split_equations
from commonlaw.library.notation import quoted
from commonlaw.trials import Trials
from commonlaw.trials.transformations import acts_later, with_recorded_doses

_ZERO = re.compile(r"[+-]?\s*0*\.?0*")


def with_doses_in_equations(
    equations: str | Sequence[str], trials: Trials, names: Sequence[str] = ()
) -> tuple[str | Sequence[str], Trials]:
    """Return equations with the doses of trials by the names of inputs, and the trials with these.

    Compartments are the differential equations in their order, from 1 on. Doses are where an equation has ``AMT``, or
    ``RATE``; those into several compartments are ``AMT1``, ``AMT2``, ..., which is what ``AMT`` means in the first and
    second of several equations. Doses that no equation has are added to the state of their compartment, if it is
    latent. Trials without doses are returned as they are, as are those in which all doses precede the first sample and
    no equation has them. `names` are columns that are given as those of doses.

    Raises
    ------
    CommonlawError
        If it is not clear where a dose goes.
    """
    administered = trials.schema.administered
    if not administered:
        return equations, trials
    text, amount = ModelText.of(equations), administered[0]
    into = sorted({dose.compartment for trial in trials for dose in trial.doses if dose.amount})
    occurrences = re.compile(rf"(?<!\w)`?(?P<stem>{'|'.join(map(re.escape, administered))})(?P<number>\d*)`?(?!\w)")
    for name in names:
        if not occurrences.fullmatch(name):
            check_choice("dose", name, administered)
    sides = [equation.partition("=") for equation in text.equations]
    named = [[(match["stem"], match["number"]) for match in occurrences.finditer(right)] for *_, right in sides]
    plain = [number for number, doses in enumerate(named, 1) if any(not compartment for _, compartment in doses)]
    is_numbered = len(into) > 1 or (len(plain) > 1 and into != [0])
    if elsewhere := [number for number in plain if is_numbered and number not in into]:
        raise CommonlawError("dose-elsewhere", name=amount, equation=elsewhere[0], compartments=into)
    written, changed = list[str](), list[str]()
    for number, (before, sign, right) in enumerate(sides, 1):

        def with_number(match: re.Match[str], default: str = str(number) if is_numbered else "") -> str:
            written.append(f"{match['stem']}{match['number'] or default}")
            return quoted(written[-1])

        changed.append(before + sign + occurrences.sub(with_number, right))
    parts = [*parts_of(equations)]
    if outside := next((part for part in parts if part not in text.equations and occurrences.search(part)), None):
        raise CommonlawError("dose-outside-equation", name=amount, part=outside)
    stems = [*dict.fromkeys(stem for doses in named for stem, _ in doses)]
    if len(stems) > 1:
        raise CommonlawError("dose-twice", names=stems)
    stem = stems[0] if stems else amount
    missing = [] if stem in written else [number for number in into if f"{stem}{number}" not in written]
    states = [equation.state for equation in split_equations(text.equations)]
    is_latent = all(0 < number <= len(states) and states[number - 1] not in trials.schema.states for number in missing)
    starts = [text.initial.get(state) for state in states]
    if (
        not written
        and into
        and not is_latent
        and all(isinstance(start, str) and _ZERO.fullmatch(start) for start in starts)
    ):
        raise CommonlawError("doses-in-no-equation", amount=amount)
    if not written and (not into or not (is_latent or any(map(acts_later, trials)))):
        return equations, replace(trials, schema=replace(trials.schema, administered=()))
    for number in missing:
        if not number:
            raise CommonlawError("doses-in-no-equation", amount=amount)
        if number > len(states):
            raise CommonlawError("dose-into-no-equation", compartment=number, states=states)
        if states[number - 1] in trials.schema.states:
            raise CommonlawError("dose-into-measured", compartment=number, state=states[number - 1], amount=amount)
        changed[number - 1] += f" + {quoted(f'{stem}{number}')}"
        written.append(f"{stem}{number}")
    new = dict(zip(text.equations, changed, strict=True))
    dosed = with_recorded_doses(trials, [*dict.fromkeys(written)] or [stem])
    return [new.get(part, part) for part in parts], dosed


def usual_initial_time(trials: Trials) -> Literal["first"] | None:
    """Return when initial values hold unless a time is given, of trials with their doses: None for time zero.

    Where resets or steady states begin trials, it is the beginning of each.
    """
    begins_anew = len(trials) > len(trials.objects) or any(trial.cycle for trial in trials)
    return "first" if trials.schema.doses and begins_anew else None
