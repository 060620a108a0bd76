"""Columns of trials as equations name them: letters that are columns, too, and columns of objects that are states."""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.roles import GUESSED
from commonlaw.trials.trial import Trial
from commonlaw.trials.trials import Trials
from commonlaw.trials.wide import quantity

_LETTER = re.compile(r"([^\W\d_]+)_?\d*")


def as_named(trials: Trials, states: Sequence[str], text: str = "") -> Trials:
    """Return trials whose columns are what equations take them for: an object each, or states of one object.

    Columns that were read as an object each are states if equations name them; a quantity without a name of its own is
    called as the only state.

    Parameters
    ----------
    states
        What has an equation or was observed, by name.
    text
        The equations. A letter in them that is a column of a guessed property is refused, unless it is in backticks or
        braces. So is a column of text, and one of numbers that was left out, unless it is called as rates are.

    Raises
    ------
    CommonlawError
        If a letter may be a column or a parameter; if a column of text or one that was left out is in equations; if
        columns of objects cannot be states.
    """
    for name in trials.guessed:
        if is_letter(name) and name not in states and re.search(rf"(?<![\w`{{]){re.escape(name)}(?![\w`}}])", text):
            raise CommonlawError("letter-of-column", name=name)
    rates = {"v", *(f"v_{state}" for state in states)} if "''" in text else set()
    for name in (*trials.text_columns, *trials.unread):
        is_named = re.search(rf"(?<!\w){re.escape(name)}(?![\w(])", text)  # A function may be called so
        if is_named and name not in states and name not in rates:
            is_text = name in trials.text_columns
            raise CommonlawError("column-of-text-in-equation" if is_text else "column-left-out-in-equation", name=name)
    schema = trials.schema
    if not schema.wide:
        return trials
    if not {*schema.wide}.isdisjoint(states):
        return _as_states(trials)
    (state,) = schema.measured
    others = [name for name in states if name not in (*schema.states, *schema.inputs)]
    if len(states) != 1 or len(others) != 1 or state != quantity(schema.wide, None):
        return trials
    renamed = {state: others[0]}
    return replace(
        trials,
        schema=replace(
            schema,
            states=tuple(renamed.get(name, name) for name in schema.states),
            units={renamed.get(name, name): unit for name, unit in schema.units.items()},
            noise_columns={renamed.get(name, name): column for name, column in schema.noise_columns.items()},
        ),
    )


def is_letter(name: str) -> bool:
    """Say whether a name is a letter, Latin or the name of a Greek one, perhaps with an index: k, K_1, tau2."""
    match = _LETTER.fullmatch(name)
    if match is None or len(match[1]) == 1:
        return match is not None
    try:
        unicodedata.lookup(f"GREEK SMALL LETTER {match[1].upper()}")
    except KeyError:
        return False
    return True


def _as_states(trials: Trials) -> Trials:
    """Return trials of one object, whose states are the columns that were read as an object each."""
    schema, names = trials.schema, trials.schema.wide
    if any(trial.repeats is not None or len(trial.earlier) for trial in trials):
        raise CommonlawError("wide-columns-as-states", states=list(names))
    by_name: dict[str, dict[str, Trial]] = {}
    for trial in trials:
        by_name.setdefault(trial.name, {})[trial.object] = trial
    joined = list[Trial]()
    for label, parts in by_name.items():
        times = np.unique(np.concatenate([part.times for part in parts.values()]))
        inputs = np.empty((len(times), len(schema.inputs)))
        for part in parts.values():
            inputs[np.searchsorted(times, part.times)] = part.inputs
        states, noise, below = (
            np.column_stack([_placed(getattr(parts[name], kind), parts[name].times, times) if name in parts
                             else np.full(len(times), np.nan) for name in names])
            for kind in ("states", "noise", "below")
        )  # fmt: skip
        joined.append(Trial("object", label, times, states, inputs, noise, below=below))
    units = dict.fromkeys(names, schema.units[schema.measured[0]]) if schema.measured[0] in schema.units else {}
    shared = [trials.properties.get(name, {}).items() for name in trials.objects]
    common = {name: value for name, value in shared[0] if all((name, value) in items for items in shared)}
    note = f"{', '.join(names)} are states of one object, as equations name them"
    return replace(
        trials,
        trials=tuple(joined),
        schema=replace(
            schema,
            object="object",
            states=names,
            wide=(),
            units={**{name: unit for name, unit in schema.units.items() if name not in schema.states}, **units},
            noise_columns={name: f"{name} noise" for name in names} if schema.noise_columns else {},
        ),
        properties={"object": common} if common else {},
        notes=(*(line for line in trials.notes if not line.startswith(GUESSED)), note),
        nameless=True,
    )


def _placed(values: Floats, there: Floats, times: Floats) -> Floats:
    """Return the only column of an array at some of the times, shape (n,), NaN at others."""
    result = np.full(len(times), np.nan)
    result[np.searchsorted(times, there)] = values[:, 0]
    return result
