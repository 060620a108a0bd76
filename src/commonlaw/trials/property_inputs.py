"""Properties of objects as inputs that do not change, for functions of both."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.errors import CommonlawError, unknown
from commonlaw.trials.trial import property_names
from commonlaw.trials.trials import Trials


def with_property_inputs(trials: Trials, names: Sequence[str]) -> Trials:
    """Return trials with these properties of their objects as further inputs, the same throughout a trial.

    Raises
    ------
    CommonlawError
        If there is no such property, or it is no number for some object.
    """
    if not names:
        return trials
    changed = []
    for trial in trials:
        values = [number_of(name, trial.object, trials) for name in names]
        inputs = np.column_stack([trial.inputs, np.tile(values, (len(trial), 1))])
        changed.append(replace(trial, inputs=inputs))
    schema = replace(trials.schema, inputs=(*trials.schema.inputs, *names))
    left = {
        name: {key: value for key, value in own.items() if key not in names} for name, own in trials.properties.items()
    }
    return replace(trials, trials=tuple(changed), schema=schema, properties=left)


def number_of(name: str, owner: str, trials: Trials) -> float:
    """Return the value of a property of an object; refused if it has none, or one that is no number."""
    value = trials.properties.get(owner, {}).get(name)
    if value is None:
        known = property_names(trials.properties)
        if name not in known:
            raise unknown("property", name, known)
        raise CommonlawError("property-missing", object=owner, property=name)
    if not isinstance(value, float):
        raise CommonlawError("property-number", property=name, object=owner, value=value)
    return value
