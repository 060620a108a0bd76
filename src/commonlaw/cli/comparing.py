"""Laws in mind beside each other: trials in the roles that equations give, and the evidence."""

import re
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from commonlaw.cli.output import print_frame, say
from commonlaw.cli.source import Source
from commonlaw.errors import CommonlawError

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.law import Law
    from commonlaw.trials import Trials

_SETTINGS = ("noise", "errors", "huber_threshold", "n_jobs")
"""Settings of a fit that a comparison shares."""


def compared(laws: "Mapping[str, Law]", training: "Trials", settings: Mapping[str, Any]) -> "pd.DataFrame":
    """Return the evidence of laws beside each other, under the settings that they were fitted with."""
    from commonlaw.inference import compare

    return compare(laws, training, **{name: settings[name] for name in _SETTINGS if name in settings})


def print_compared(frame: "pd.DataFrame") -> None:
    """Print the evidence of laws beside each other, and what its numbers mean."""
    from commonlaw.law.tables import MEANINGS

    say("\nEvidence from the same measurements, the most probable law first:\n")
    print_frame(frame)
    say(f"\n{MEANINGS['2 log B']}.")
    say("More coefficients cost evidence by themselves. The probability holds if one of these laws is true.")


def load(source: Source, equations: Sequence[str], laws: "Iterable[Law]" = (), starts: Container[str] = ()) -> "Trials":
    """Return the trials, their columns in the roles that equations and other laws give them.

    States of equations whose starts are known have no column.
    """
    from commonlaw.library.equation import split_equations

    schemas = [each.schema for each in laws]
    if not equations:
        return source.load(schemas[0])
    trials, asked = source.load(), split_equations(equations[0])
    states = tuple(each.state for each in asked if each.state not in starts)
    if source.dataset or source.states:
        return trials
    if trials.schema.wide and len(states) == 1:
        return replace(source, wide=source.wide or states[0]).load()
    taken = {name for schema in schemas for name in schema.inputs}
    others = [name for name in (*trials.schema.states, *trials.schema.inputs) if name not in states]
    inputs = tuple(name for name in others if name in taken or any(_occurs(name, each) for each in equations))
    if {*states} == {*trials.schema.states} and {*inputs} == {*trials.schema.inputs}:
        return trials
    try:
        return replace(source, states=states, inputs=source.inputs or inputs).load()
    except CommonlawError as error:
        name = error.parameters.get("name")
        if name not in states or error.parameters.get("kind") != "column":
            raise
        raise CommonlawError("column-of-latent-state", error=error, name=name) from None


def _occurs(name: str, equations: str) -> bool:
    return re.search(rf"(?<!\w){re.escape(name)}(?!\w)", equations) is not None
