"""A law and trials, or two laws, brought to the same variables, units and names."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.errors import CommonlawError
from commonlaw.law.law import Law
from commonlaw.library.parametric import free_name
from commonlaw.runtime.arguments import check_type
from commonlaw.trials import Schema, Trials, TrialStream
from commonlaw.trials.equation_columns import as_named
from commonlaw.trials.headers import find_name
from commonlaw.trials.tables import unanswered_notes
from commonlaw.trials.transformations import (
    in_units,
    objects_at_rest,
    refuse_amounts,
    with_doses,
    with_property_inputs,
    with_recorded_doses,
    with_starts,
    without_objects,
    without_rates,
    without_states,
)
from commonlaw.trials.trial import as_numbers, property_names
from commonlaw.trials.units import Conversion

TRIALS = "Trials, as `cl.Trials.read` and `cl.Trials.from_frame` return"
"""What an argument of trials may be."""


def matched(
    law: Law,
    trials: Trials,
    *,
    inputs: Literal["same", "any"] = "same",
) -> Trials:
    """Return trials of the variables of a law in its units; everything that takes a law and trials begins with this.

    What has no unit there or in the law is taken as it is. Left out are rates of the law's states, objects at rest that
    the law left out, objects that are strange to it, with a note, and notes that ask for its initial values. Latent
    states come with their initial values, and doses as they are added. Properties may be inputs of the law; only with
    `inputs` "any" may the trials have others.

    Raises `CommonlawError` if the variables are not those of the law, all objects are strange to it, or a unit cannot
    be converted.
    """
    check_type("trials", trials, (Trials, TrialStream), TRIALS)
    schema = law.observation.measured
    trials = as_named(_with_recorded_doses(trials, schema), schema.measured)
    trials = without_states(without_rates(trials, schema.rates), law.provenance.domain.constant)
    known = property_names(trials.properties)
    missing = [name for name in schema.inputs if name not in trials.schema.inputs]
    trials = with_property_inputs(trials, [name for name in missing if name in known])
    if resting := {*law.provenance.domain.at_rest} - {*law.objects}:
        trials = without_objects(trials, tuple(name for name in objects_at_rest(trials) if name in resting))
    if isinstance(trials, Trials):
        trials = without_strange(law, trials)
    if isinstance(trials, Trials) and (written := law.observation.initial):
        owners = {name: start if isinstance(start, Mapping) else None for name, start in written.items()}
        notes = unanswered_notes(trials.notes, trials.trials, trials.schema.states, owners)
        trials = trials if notes == trials.notes else replace(trials, notes=notes)
    starts = {name: start for name, start in schema.initial_values.items() if name not in trials.schema.states}
    measured = tuple(name for name in schema.states if name not in starts)
    kinds = [("states", measured, trials.schema.states)]
    kinds += [("inputs", schema.inputs, trials.schema.inputs)] if inputs == "same" else []
    for kind, wanted, given in kinds:
        if wanted != given:
            raise CommonlawError("columns-differ", kind=kind, expected=wanted or ["none"], given=given or ["none"])
    wider, explanation = law.provenance.with_discrepancy, law.uncertainty.explanation
    used = {*schema.states, *schema.inputs, *(explanation.properties if explanation else ())}
    used |= {*wider.schema.inputs} if wider else set()
    used |= {start for start in schema.initial_values.values() if isinstance(start, str)}
    units = {name: unit for name, unit in schema.units.items() if name in used}
    units |= {trials.schema.time: schema.units[schema.time]} if schema.time in schema.units else {}
    converted = with_doses(in_units(trials, units), schema.doses)
    return with_starts(converted, starts, schema.initial_time)


def _with_recorded_doses(trials: Trials, schema: Schema) -> Trials:
    """Return trials with the doses that their table records as the inputs of a law's schema, in its units."""
    administered, units = trials.schema.administered, dict[str, str]()
    if not administered:
        return trials
    if not schema.doses:
        refuse_amounts(trials)
        return replace(trials, schema=replace(trials.schema, administered=()))
    units |= {administered[0]: schema.units[schema.doses[0]]} if schema.doses[0] in schema.units else {}
    units |= {trials.schema.time: schema.units[schema.time]} if schema.time in schema.units else {}
    return with_recorded_doses(in_units(trials, units), schema.doses)


def strange_objects(law: Law, trials: Trials) -> tuple[str, ...]:
    """Return the objects of trials that were left out of a law, as they do not follow it."""
    strange = {*law.provenance.domain.strange} - {*law.objects}
    return tuple(name for name in trials.objects if name in strange)


def without_strange(law: Law, trials: Trials) -> Trials:
    """Return trials without the objects that are strange to a law, with a note; refuse trials of these alone."""
    names = strange_objects(law, trials)
    if not names:
        return trials
    if len(names) == len(trials.objects):
        raise CommonlawError("law-of-other-objects", objects=names, first=names[0])
    kept = without_objects(trials, names)
    return kept.with_trials(kept.trials, f"left out, as strange to the law: {', '.join(names)}")


def matched_times(law: Law, trials: Trials, times: ArrayLike | None) -> ArrayLike | None:
    """Return times that were given with trials, in the unit of their time, in that of the law."""
    check_type("trials", trials, (Trials, TrialStream), TRIALS)
    unit, time = trials.schema.units.get(trials.schema.time), law.schema.units.get(law.schema.time)
    turn = Conversion.between(trials.schema.time, unit, time)
    return times if times is None or not turn else turn.of(as_numbers(times))


def matched_noise(law: Law, trials: Trials, noise: Mapping[str, float] | None) -> dict[str, float] | None:
    """Return standard deviations by state, given in the units of the trials, in those of the law."""
    if noise is None:
        return None
    given, measured, result = trials.schema, law.observation.measured, {}
    for key, level in noise.items():
        name = find_name(key, given.states, "state")
        is_share = name in measured.logarithmic or name in given.logarithmic
        turn = Conversion() if is_share else Conversion.between(name, given.units.get(name), measured.units.get(name))
        result[name] = abs(turn.scale) * level
    return result


def with_parameters_of(other: Law, law: Law) -> Law:
    """Return another law in which a constant has the name that it has in a law, where it is inside the same terms."""
    same = defaultdict[frozenset[tuple[int, str]], list[str]](list)
    for name in law.terms.variables.parameters:
        same[_places(law, name)].append(name)
    variables, names = other.terms.variables, list[str]()
    for parameter in variables.parameters:
        known = same[_places(other, parameter)]
        taken = (*law.terms.variables.names, *variables.measured, *names)
        names.append(known.pop(0) if known else free_name(parameter, taken))
    return replace(other, terms=replace(other.terms, variables=replace(variables, parameters=tuple(names))))


def _places(law: Law, name: str) -> frozenset[tuple[int, str]]:
    """Return in which equations' terms a constant is, these with a sign in place of it and of others."""
    variables, column = law.terms.variables, law.terms.variables.index(name)
    signs = [*variables.measured, *("?" if parameter == name else "#" for parameter in variables.parameters)]
    pairs = np.argwhere(law.support & law.terms.is_factor).tolist()
    return frozenset((j, law.terms.terms[k].text(signs)) for j, k in pairs if column in law.terms.terms[k].columns())
