"""A model and trials before the fit: what is unknown, likely first values, bounds and priors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from itertools import compress, pairwise
from numbers import Real

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.estimation.model import Model, ModelText, read_model
from commonlaw.estimation.problem import NormalPrior, Problem, TrialData
from commonlaw.estimation.search import Bounds
from commonlaw.law import Law
from commonlaw.law.law import object_index, shares_terms
from commonlaw.law.parameters import named_parameters, recorded_restrictions
from commonlaw.law.printing import exact_equations
from commonlaw.law.restrictions import ALL, OBJECT, TRIAL, Restrictions
from commonlaw.library.bounds import bounds_in, limits_of
from commonlaw.library.equation import split_equations
from commonlaw.library.sizes import likely_sizes
from commonlaw.likelihood import ERRORS, ByGroup, Heteroscedastic
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import (
    known_inputs,
    number_of,
    refuse_overwhelming_noise,
    with_logarithms,
    with_noise,
)
from commonlaw.trials.trial import Start, has_sparse_states, property_names

FREE = "free"
"""The initial value of each trial that the measurements determine."""

NEAR_ZERO = 0.1
"""Size of a first measurement, in standard deviations of its trial, below which its sign may be that of its noise."""

NoiseGiven = float | str | Mapping[str, float]
"""The noise of a quantity: a standard deviation, of all objects or by object, or a property with one for each value."""
InitialGiven = Start | tuple[float, float] | Mapping[str, float | None]
"""An initial value as users give it: a `Start`, an expression of parameters, or a mean and a standard deviation."""


def beyond_collocation(
    text: ModelText,
    trials: Trials,
    initial_values: Mapping[str, InitialGiven],
    groups: Mapping[str, str],
    priors: Mapping[str, tuple[float, float]] | None,
    noise: Mapping[str, NoiseGiven] | None = None,
) -> list[str]:
    """Return in words what is to be fitted by shooting; equations with none of these are fitted by collocation.

    Groups of parameters are as in `Restrictions`. Doses are in the trials as `with_doses` adds them.
    """
    names = property_names(trials.properties)
    special = any(
        name in trials.schema.states
        or isinstance(start, tuple)
        or (isinstance(start, str) and start != FREE and start not in names)
        or (isinstance(start, Mapping) and not {*start} <= {*trials.objects})
        or (isinstance(start, Mapping) and any(value is None or isinstance(value, str) for value in start.values()))
        for name, start in initial_values.items()
    )
    latent = {equation.state for equation in split_equations(text.equations)} - {*trials.schema.states, *initial_values}
    unmeasured = any(trial.begins_with_dose and (latent or np.isnan(trial.states[0]).any()) for trial in trials)
    reasons = {
        "initial values": special,
        "values below a limit": any(np.isfinite(trial.below).any() for trial in trials),
        "states that are seldom measured": has_sparse_states(tuple(trials), trials.schema),
        "priors": priors,
        "groups of parameters": not {*groups.values()} <= {ALL, OBJECT},
        "noise by property": any(isinstance(level, str) for level in (noise or {}).values()),
        "doses": unmeasured,
    }
    return [*dict.fromkeys([*text.beyond_equations, *(name for name, is_there in reasons.items() if is_there)])]


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The unknown numbers of a model: which parameter of which trials, or which initial value, each one is.

    For each trial `parameters` and `initial` have the index of each parameter and initial value among the unknowns, or
    -1 for one that is known, in `values`, or follows from others.
    """

    names: list[str] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)
    parameters: list[list[int]] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)
    initial: list[list[int]] = field(default_factory=list)

    def add(self, name: str, label: str) -> int:
        self.names.append(name)
        self.labels.append(label)
        return len(self.names) - 1

    def means(self, trials: Trials, owner: str) -> tuple[Floats, Floats]:
        """Return M and m with parameters ``M unknowns + m`` of an object, means over its trials, (P, p) and (P,)."""
        rows = [i for i, trial in enumerate(trials) if trial.object == owner]
        indices = np.array([self.parameters[i] for i in rows]).reshape(len(rows), -1)
        shares = (indices[:, :, np.newaxis] == np.arange(len(self.names))).mean(axis=0)
        return shares, np.mean([self.values[i] for i in rows], axis=0)


@dataclass(frozen=True, eq=False)
class Beginning:
    """A model before it is fitted: what is unknown, likely first values of it, whether these were guessed, its bounds.

    First values have shape (p,), initial values among them; if they are those of a fit, `likely` are those before it.
    The noise group of each object, by quantity, is in `groups`, and `start` is the time of initial values. Of `errors`
    the levels are estimated, unless the problem has them.
    """

    model: Model
    trials: Trials
    unknowns: Unknowns
    problem: Problem
    first: Floats
    guessed: Bools
    bounds: Bounds
    groups: Mapping[str, Mapping[str, str]]
    logarithmic: tuple[str, ...]
    start: float | None
    restrictions: Restrictions
    errors: ErrorKind = "white"
    huber_threshold: float = np.inf
    likely: Floats | None = None


def begin(
    text: ModelText,
    trials: Trials,
    initial_values: Mapping[str, InitialGiven],
    initial_time: float | None = None,
    shared: Mapping[str, str] | None = None,
    guesses: Mapping[str, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    log_states: Sequence[str] = (),
    noise: Mapping[str, NoiseGiven] | None = None,
    errors: ErrorKind = "white",
) -> Beginning:
    """Return a model and trials as a fit begins with them, see `commonlaw.fit`."""
    properties, shared, priors = property_names(trials.properties), shared or {}, priors or {}
    model = read_model(with_initial(text, initial_values, trials), trials.schema, properties)
    if any(np.ptp(known_inputs(trial)[1][:, model.starting_inputs], axis=0).any() for trial in trials):
        raise CommonlawError("initial-value-of-variables")
    for j, state in enumerate(model.schema.states):
        is_free = any(j in model.free_in(trial) for trial in trials)
        # Nothing is said of it, and no observation equation may determine it
        if is_free and state not in (*model.observables, *initial_values) and not model.text.observed:
            raise CommonlawError("equation-without-column", name=state)
    unknowns = _unknowns(model, trials, properties, shared)
    known, groups = _checked_noise(trials, noise or {})
    shown = with_logarithms(trials, log_states)
    if isinstance(ERRORS[errors], Heteroscedastic) and shown.schema.logarithmic:
        raise CommonlawError("log-states-with-errors", states=shown.schema.logarithmic)
    is_grouped = isinstance(ERRORS[errors], ByGroup)
    is_independent = ERRORS[errors].is_independent and not is_grouped
    if not is_independent and any(np.isfinite(trial.below).any() for trial in trials):
        raise CommonlawError("censored-with-errors", errors=errors)
    if is_grouped and trials.schema.noise_columns:
        raise CommonlawError("noise-by-group-given", errors=errors)
    if errors != "white" and groups:
        raise CommonlawError("noise-by-property-with-errors", errors=errors, names=[*groups])
    refuse_overwhelming_noise(shown, {name: level for name, level in known.items() if isinstance(level, float)})
    problem = _problem(model, with_noise(shown, known), unknowns, initial_time, priors)
    first, state_sizes, guessed = _sizes(model, trials, problem, unknowns, guesses or {})
    problem = _with_groups(replace(problem, sizes=state_sizes), groups)
    written = tuple(bound.text for bound in text.bounds)
    restrictions = Restrictions(
        dict(shared),
        dict(priors),
        written,
        {name: given for name, given in (noise or {}).items() if not isinstance(given, Mapping)},
    )
    bounds = _bounds(model, trials, unknowns)
    logarithmic = shown.schema.logarithmic
    return Beginning(
        model,
        trials,
        unknowns,
        problem,
        first,
        guessed,
        bounds,
        groups,
        logarithmic,
        initial_time,
        restrictions,
        errors,
    )


def written_starts(text: ModelText, initial_values: Mapping[str, InitialGiven]) -> list[str]:
    """Return the states and rates whose initial values are written, in equations or apart."""
    free = [name for name, start in initial_values.items() if start is None or start == FREE]
    return [name for name in dict.fromkeys((*text.initial, *initial_values)) if name not in free]


def initial_time_of(trials: Trials, given: float | str | None, written: Sequence[str]) -> float | None:
    """Return the time of initial values, None for that of each trial's first sample.

    By default it is zero for states whose initial values are written. That of dates and times of day is the first
    sample.

    Raises
    ------
    CommonlawError
        If by default a trial begins before time zero or more than the length of a trial after it, each trial begins
        after the last has ended, or the time is neither finite nor "first".
    """
    if (isinstance(given, str) and given == "first") or (given is None and (not written or trials.schema.calendar)):
        return None
    if given is not None:
        if not isinstance(given, Real) or not np.isfinite(given):
            raise CommonlawError("initial-time-unknown", given=given)
        return float(given)
    in_order = sorted(trials, key=lambda trial: trial.times[0])
    spans = [(float(trial.times[0]), float(trial.times[-1]), trial) for trial in in_order]
    if all(first == last for first, last, _ in spans):  # Trials of one sample each are points of one course
        spans = [(spans[0][0], spans[-1][1], in_order[0])]
    longest = max(last - first for first, last, _ in spans)
    start, after = f"{written[0]}(0)", all(begin[0] > end[1] > end[0] for end, begin in pairwise(spans))
    for first, _, trial in spans:
        if first > longest:
            raise CommonlawError("initial-time-far", trial=trial.label, time=first, length=longest, start=start)
    if after and len(spans) > 1:
        last = spans[-1][2].label
        raise CommonlawError("initial-time-of-clock", trial=last, time=spans[-1][0], end=spans[-2][1], start=start)
    return 0.0


def with_initial(text: ModelText, initial_values: Mapping[str, InitialGiven], trials: Trials) -> ModelText:
    """Return the text with initial values that are given apart from it."""
    properties = property_names(trials.properties)
    initial = {
        name: _by_label(name, start, trials) if isinstance(start, Mapping) else start
        for name, start in text.initial.items()
    }
    for name, start in initial_values.items():
        if start is None or start == FREE:
            initial.pop(name, None)
        elif isinstance(start, str):
            if start.isidentifier() and start not in properties and get_close_matches(start, properties):
                raise unknown("property", start, properties)
            initial[name] = start
        elif isinstance(start, Mapping):
            if {*start} <= {*trials.objects}:
                start = {owner: start.get(owner, np.nan) for owner in trials.objects}
            initial[name] = _by_label(name, start, trials)
        elif isinstance(start, tuple):
            mean, std = map(float, start)
            if not 0 < std < np.inf:
                raise CommonlawError("prior-not-positive", name=f"{name}(0)", std=std)
            initial[name] = mean, std
        else:
            initial[name] = repr(_finite(name, start, trials.objects[0]))
    return replace(text, initial=initial)


def _by_label(state: str, given: Mapping[str, float | None], trials: Trials) -> dict[str, float]:
    """Return numbers by object, and for trials, given by their names or labels, by label."""
    result, trial_names = dict[str, float](), {name for trial in trials for name in (trial.name, trial.label)}
    for name, value in given.items():
        if name not in trials.objects and name not in trial_names:
            raise unknown("trial or object", name, [*trials.objects, *(trial.name for trial in trials)])
        if value is None or isinstance(value, str):
            continue
        labels = [trial.label for trial in trials if name in (trial.name, trial.label)]
        result |= dict.fromkeys([name] if name in trials.objects else labels, _finite(state, value, name))
    return result


def _finite(state: str, value: float, owner: str) -> float:
    if not np.isfinite(value):
        raise CommonlawError("initial-value-not-finite", state=state, value=value, object=owner)
    return float(value)


def _unknowns(model: Model, trials: Trials, properties: Sequence[str], shared: Mapping[str, str]) -> Unknowns:
    result, indices_of = Unknowns(), dict[tuple[str, object], int]()
    for name in shared:
        check_choice("parameter", name, [parameter for parameter in model.parameters if parameter not in properties])
    for trial in trials:
        indices, values = list[int](), list[float]()
        for name in model.parameters:
            if name in properties:
                indices.append(-1)
                values.append(number_of(name, trial.object, trials))
                continue
            by = shared.get(name, OBJECT)
            key = _group(by, trial, trials)
            if (name, key) not in indices_of:
                alone = by == ALL or (by == OBJECT and len(trials.objects) == 1)
                label = trial.label if by == TRIAL else key
                indices_of[name, key] = result.add(name, name if alone else f"{name} of {label}")
            indices.append(indices_of[name, key])
            values.append(0.0)
        result.parameters.append(indices)
        result.values.append(values)
    for trial in trials:
        determined = model.free_in(trial)
        indices = [
            result.add(f"{name}(0)", f"{name}(0) of {trial.label}") if j in determined else -1
            for j, name in enumerate(model.variables.states)
        ]
        result.initial.append(indices)
    return result


def _group(by: str, trial: Trial, trials: Trials) -> object:
    """Return what a trial shares a parameter with: equal values are one group."""
    properties, inputs = property_names(trials.properties), trials.schema.inputs
    if by in (ALL, OBJECT, TRIAL):
        return {ALL: None, OBJECT: trial.object, TRIAL: (trial.object, trial.name)}[by]
    if by in inputs:
        column = trial.inputs[:, inputs.index(by)]
        if np.ptp(column) > 0:
            raise CommonlawError("group-varies-in-trial", trial=trial.label, column=by)
        return float(column[0])
    if by not in properties:
        raise CommonlawError("group-unknown", by=by, known=(ALL, OBJECT, TRIAL, *properties, *inputs))
    if by not in trials.properties.get(trial.object, {}):
        raise CommonlawError("property-missing", object=trial.object, property=by)
    return trials.properties[trial.object][by]


def _checked_noise(
    trials: Trials, noise: Mapping[str, NoiseGiven]
) -> tuple[dict[str, float | Mapping[str, float]], dict[str, dict[str, str]]]:
    """Return which measured quantities have known noise, and of which each object has that of its group, by name."""
    known, groups = dict[str, float | Mapping[str, float]](), dict[str, dict[str, str]]()
    for name, given in noise.items():
        check_choice("measured quantity", name, trials.schema.states)
        if isinstance(given, str):
            if given not in (properties := property_names(trials.properties)):
                raise CommonlawError("noise-not-a-property", name=name, given=given, properties=properties or ["none"])
            groups[name] = {trial.object: str(_group(given, trial, trials)) for trial in trials}
        elif isinstance(given, Mapping):
            known[name] = given
        elif not 0 < given < np.inf:
            raise CommonlawError("noise-not-positive", name=name, level=given)
        else:
            known[name] = float(given)
    return known, groups


def _problem(
    model: Model, trials: Trials, unknowns: Unknowns, start: float | None, priors: Mapping[str, tuple[float, float]]
) -> Problem:
    data = []
    rows = zip(trials, unknowns.parameters, unknowns.values, unknowns.initial, strict=True)
    for trial, parameters, values, initial in rows:
        data.append(TrialData.of(trial, model, start, parameters, values, initial))
    for name, (_, std) in priors.items():
        check_choice("parameter", name, list(dict.fromkeys(unknowns.names)))
        if not 0 < std < np.inf:
            raise CommonlawError("prior-not-positive", name=name, std=std)
    logarithmic = np.array([name in trials.schema.logarithmic for name in model.observables])
    priors = {f"{model.variables.states[j]}(0)": prior for j, prior in model.expected.items()} | dict(priors)
    normal_priors = tuple(NormalPrior.of(i, *priors[name]) for i, name in enumerate(unknowns.names) if name in priors)
    return Problem(model, tuple(data), len(unknowns.names), logarithmic, np.ones(model.width), normal_priors)


def _with_groups(problem: Problem, groups: Mapping[str, Mapping[str, str]]) -> Problem:
    """Return a problem in which a quantity is one for each group of objects, so that each has noise of its own."""
    model, columns, names = problem.model, list[tuple[int, str | None]](), list[str]()
    for k, name in enumerate(model.observables):
        for group in dict.fromkeys(groups[name].values()) if name in groups else [None]:
            columns.append((k, group))
            names.append(name if group is None else f"{name} of {group}")
    if names == list(model.observables):
        return problem
    order = [k for k, _ in columns]
    outputs = replace(model.outputs, outputs=model.outputs.outputs[order])
    data = []
    for trial_data in problem.trials:
        trial = trial_data.trial
        belongs = [g is None or groups[model.observables[k]][trial.object] == g for k, g in columns]
        states, noise, below = (
            np.where(belongs, values[:, order], np.nan) for values in (trial.states, trial.noise, trial.below)
        )
        repeats = trial.repeats and replace(
            trial.repeats, counts=trial.repeats.counts[:, order], squares=trial.repeats.squares[:, order]
        )
        data.append(replace(trial_data, trial=replace(trial, states=states, noise=noise, below=below, repeats=repeats)))
    grouped = replace(model, observables=tuple(names), outputs=outputs)
    return replace(problem, model=grouped, trials=tuple(data), logarithmic=problem.logarithmic[order])


def _sizes(
    model: Model, trials: Trials, problem: Problem, unknowns: Unknowns, guesses: Mapping[str, float]
) -> tuple[Floats, Floats, Bools]:
    """Return likely sizes of the unknowns, of the states and rates, and which unknowns were guessed."""
    columns = {name: i for i, name in enumerate(model.variables.names)}
    measured = dict[str, float]()
    for j, name in enumerate(model.observables):
        values = np.concatenate([np.append(trial.states[:, j], trial.below[:, j]) for trial in trials])
        measured[name] = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    known = {
        columns[name]: size
        for name, size in measured.items()
        if name in model.variables.states and name not in model.text.observed
    }
    span = max(trial.times[-1] - trial.times[0] for trial in problem.trials) or 1.0
    known[columns[model.variables.time]] = max(float(np.abs(trial.times).max()) for trial in problem.trials) or 1.0
    for i, name in enumerate(model.schema.inputs):
        signals = [(trial.times, np.abs(trial.inputs[:, model.column[i]])) for trial in trials]
        largest = max(signal.max(initial=0.0) for _, signal in signals)
        if model.schema.inputs[model.column[i]] in model.schema.doses:  # Over the trial, not in the moment of the dose
            largest = max(np.trapezoid(signal, times) for times, signal in signals) / span
        known[columns[name]] = float(largest) or 1.0
    for i, name in enumerate(model.parameters):
        pairs = zip(unknowns.parameters, unknowns.values, strict=True)
        known_values = [values[i] for indices, values in pairs if indices[i] < 0]
        if any(known_values):
            known[columns[name]] = float(np.mean(np.abs(known_values)))
        if i in model.delay:
            known[columns[name]] = 0.1 * span
    for name, value in guesses.items():
        check_choice("parameter", name, [parameter for parameter in unknowns.names if parameter in columns])
        if not np.isfinite(value) or value == 0:
            raise CommonlawError("guess-out-of-bounds", name=name, value=value)
        known[columns[name]] = abs(value)
    for prior in problem.priors:
        for name, mean, root in zip(np.array(unknowns.names)[prior.indices], prior.mean, prior.root, strict=True):
            if name in columns:
                known.setdefault(columns[name], abs(float(mean)) or 1 / float(np.linalg.norm(root)))
    for i, value_at_start in enumerate(model.initial):
        if i not in known and value_at_start is not None:
            try:
                known.update({i: abs(float(value_at_start))} if float(value_at_start) else {})
            except ValueError:
                continue
    statements: list[tuple[str, float | int | None]] = [
        (expression, i) for i, expression in enumerate(model.expressions[: model.width])
    ]
    for name, expression in zip(model.observables, model.expressions[model.width :], strict=True):
        statements.append((expression, measured[name]))
    statements += [(start, known[i]) for i, start in enumerate(model.initial) if start is not None and i in known]
    for condition, after in model.events:
        changes = [(f"v{j}", new) for j, new in enumerate(after) if new != f"v{j}"]
        statements += [(condition, None), *((f"{state} - ({new})", None) for state, new in changes)]
    # States change in times between a sampling step and a trial
    step = float(np.median(np.concatenate([[span], *(np.diff(np.unique(trial.times)) for trial in problem.trials)])))
    likely = likely_sizes(statements, known, len(columns), np.sqrt(step * span))
    by_name = {name: likely[i] for name, i in columns.items()}
    by_name |= {f"{name}(0)": likely[i] for i, name in enumerate(model.variables.states)} | dict(guesses)
    sizes = np.array([by_name[name] for name in unknowns.names])
    guessed = np.array([name in guesses for name in unknowns.names], dtype=np.bool_)
    starts = [start and start.removeprefix("+") for start in model.initial]
    columns_of = [f"v{i}" for i in range(model.first_parameter, len(model.variables.names))]
    for trial, parameters, initial in zip(trials, unknowns.parameters, unknowns.initial, strict=True):
        of_start = dict(zip(columns_of, parameters, strict=True))
        for name, k, start in zip(model.variables.states, initial, starts, strict=True):
            k = of_start.get(start, -1) if start else k
            if k >= 0 and unknowns.names[k] not in guesses and name in {*model.observables} - {*model.text.observed}:
                seen = trial.states[:, model.observables.index(name)]
                seen = seen[np.isfinite(seen)]
                if len(seen) and seen[0] != 0:  # Measured states begin at their first measurements
                    sizes[k], guessed[k] = seen[0], True
                    if abs(seen[0]) < (scatter := NEAR_ZERO * float(np.std(seen))):  # Of either sign
                        sizes[k], guessed[k] = scatter, False
    return sizes, likely[: model.width], guessed


def _bounds(model: Model, trials: Trials, unknowns: Unknowns) -> Bounds:
    limits = [limits_of(name, model.text.bounds) for name in unknowns.names]
    low, high = (
        (np.array(ends, dtype=np.float64) for ends in zip(*limits, strict=True)) if limits else (np.zeros(0),) * 2
    )
    longest = max(trial.times[-1] - trial.times[0] for trial in trials)
    delays = [model.parameters[index] for index in model.delay if index >= 0]
    for i, name in enumerate(unknowns.names):
        if name in delays:
            low[i], high[i] = max(low[i], 0.0), min(high[i], longest)
    return Bounds(low, high)


def beginning_of(
    law: Law,
    trials: Trials,
    noise: Mapping[str, NoiseGiven],
    equations: Sequence[str] | None = None,
    log_states: Sequence[str] | None = None,
    input_interpolation: str | None = None,
    errors: ErrorKind = "white",
) -> "Beginning":
    """Return how a fit of a law to trials in its units begins, with noise and errors as in `commonlaw.fit`."""
    if law.order == 0:
        raise CommonlawError("discrete-not-refined")
    if not shares_terms(law):
        raise CommonlawError("refine-own-terms")
    observation = law.observation
    between = input_interpolation or observation.measured.input_interpolation
    trials = replace(trials, schema=replace(trials.schema, input_interpolation=between))
    restrictions = recorded_restrictions(law)
    text = replace(ModelText.of(equations or exact_equations(law)), bounds=bounds_in(restrictions.bounds))
    names = {name for trial in trials for name in (trial.object, trial.label)}
    initial = {
        name: {where: value for where, value in start.items() if where in names}
        if isinstance(start, Mapping)
        else start
        for name, start in observation.initial.items()
    }
    text = replace(text, observed=observation.equations, initial=initial, events=observation.events)
    free = [name for name in law.terms.variables.states if name not in observation.initial]
    begun = begin(
        text,
        trials,
        {**dict.fromkeys(free), **law.schema.initial_values},
        observation.initial_time,
        restrictions.shared,
        priors=restrictions.priors,
        log_states=observation.measured.logarithmic if log_states is None else log_states,
        noise=noise,
        errors=errors,
    )
    begun = with_values_of(law, begun)
    if not equations:
        return begun
    # What these add is small at first, so that solutions are finite where those of the law are
    known, first = named_parameters(law).names, begun.first.copy()
    added = {k for row in begun.unknowns.parameters for k in row if k >= 0 and begun.unknowns.names[k] not in known}
    first[[*added]] *= 1e-3
    return replace(begun, first=first)


def with_values_of(law: Law, begun: Beginning) -> Beginning:
    """Return a beginning whose first values are those of a law that was fitted, as far as it has some but zero.

    Of parameters that several objects share they are medians.
    """
    first, named, by_unknown = begun.first.copy(), named_parameters(law), dict[int, list[float]]()
    by_trial = {(estimate.object, estimate.trial, estimate.name): estimate.value for estimate in law.trial_estimates}
    rows = zip(begun.trials, begun.unknowns.parameters, begun.unknowns.initial, strict=True)
    for trial, parameters, initial in rows:
        values = dict(zip(named.names, named.values[object_index(law, trial.object)].tolist(), strict=True))
        for k in (k for k in (*parameters, *initial) if k >= 0):
            name = begun.unknowns.names[k]
            value = by_trial.get((trial.object, trial.name, name), values.get(name, 0.0))
            if value != 0 and np.isfinite(value):
                by_unknown.setdefault(k, []).append(value)
    for k, several in by_unknown.items():
        first[k] = np.median(several)
    return replace(begun, first=first, likely=begun.first)


def zero_columns(trials: Trials) -> list[str]:
    """Return the inputs, then the properties, that are zero everywhere."""
    inputs, properties = trials.schema.inputs, property_names(trials.properties)
    still = [all(not trial.inputs[:, c].any() for trial in trials) for c in range(len(inputs))]
    zero = [all(trials.properties.get(owner, {}).get(name) == 0 for owner in trials.objects) for name in properties]
    return [*compress(inputs, still), *compress(properties, zero)]


def refuse_zero_columns(model: Model, trials: Trials, columns: Sequence[str]) -> None:
    """Refuse parameters that multiply, or are powers of, nothing but columns that are zero, see `zero_columns`.

    Rates, observables and initial values then have no derivative by them, whatever the states are; with other values of
    these columns they have.
    """
    signals = [trials.schema.inputs[c] in columns for c in model.column]
    zero = np.array([name in columns for name in model.parameters], dtype=np.bool_)
    if model.events:
        return
    points = np.random.default_rng(0).uniform(0.5, 2.0, (20, len(model.variables.names)))
    without, first = points.copy(), model.first_parameter
    without[:, model.width : model.width + len(signals)][:, signals] = 0.0
    without[:, first:][:, zero] = 0.0

    def matters(values: Floats) -> Bools:
        with np.errstate(all="ignore"):
            slopes = [program.jacobian(values)[:, :, first:] for program in (model.rates, model.outputs, model.starts)]
        return np.asarray(np.any(np.nan_to_num(np.concatenate(slopes, axis=1)) != 0, axis=(0, 1)))

    lost = matters(points) & ~matters(without) & ~zero
    if lost.any():
        columns = [name for name in columns if name in (*trials.schema.inputs, *model.parameters)]
        raise CommonlawError("parameters-of-zero-column", names=[*compress(model.parameters, lost)], columns=columns)
