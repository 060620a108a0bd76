"""From a model and trials to a law."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import partial
from typing import Any, Literal

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation.noise import noise_level
from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.estimation.model import Model, ModelText, read_model
from commonlaw.estimation.problem import NormalPrior, Problem, TrialData
from commonlaw.estimation.search import DRAWS, EVENT_SHARES, GROWING_SHARES, REACH, Bounds, Optimum, maximize
from commonlaw.law import Law, Provenance, Step, Uncertainty
from commonlaw.law.alignment import matched, matched_noise, measured_schema
from commonlaw.law.law import object_index, of_all_objects, shares_terms
from commonlaw.law.observation import ALL, OBJECT, TRIAL, Observation, Restrictions, TrialEstimate, by_trial
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import Product, read_equations
from commonlaw.law.provenance import Domain
from commonlaw.law.text import with_error
from commonlaw.library import Term, Terms
from commonlaw.library.bounds import bounds_in, limits_of
from commonlaw.library.sizes import likely_sizes
from commonlaw.likelihood.linearization import HETEROGENEITY_LEVEL, heterogeneity_p_value
from commonlaw.outcomes import Outcome, note
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.text import counted, shown
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import number_of, with_logarithms, with_noise
from commonlaw.trials.trial import Start, has_sparse_states, property_names

FREE = "free"
"""The initial value of each trial that the measurements determine."""

NoiseGiven = float | str | Mapping[str, float]
"""The noise of a quantity: a standard deviation, of all objects or by object, or a property with one for each value."""
InitialGiven = Start | tuple[float, float] | Mapping[str, float | None]
"""An initial value as users give it: a `Start`, an expression of parameters, or a mean and a standard deviation."""


def needs_model(
    text: ModelText,
    trials: Trials,
    initial_values: Mapping[str, InitialGiven],
    shared: Sequence[str] | Mapping[str, str],
    priors: Mapping[str, tuple[float, float]] | None,
) -> bool:
    """Return whether equations are to be fitted as a model: what `commonlaw.refine` fits has none of these."""
    names = property_names(trials.properties)
    special = any(
        name in trials.schema.states
        or isinstance(start, tuple)
        or (isinstance(start, str) and start != FREE and start not in names)
        or (isinstance(start, Mapping) and any(value is None or isinstance(value, str) for value in start.values()))
        for name, start in initial_values.items()
    )
    censored = any(np.isfinite(trial.below).any() for trial in trials)
    sparse = has_sparse_states(tuple(trials), trials.schema)
    return bool(not text.is_plain or special or censored or sparse or priors or isinstance(shared, Mapping))


_SETTINGS = ("log_states", "input_interpolation", "noise", "errors", "seed", "n_jobs", "progress")
"""Settings of fits that may be made here."""


def check_white(changed: Mapping[str, Any]) -> None:
    """Refuse settings that were changed and are of other fits than of trajectories under white noise."""
    refused = [name for name in changed if name not in _SETTINGS]
    if changed.get("errors", "auto") not in ("auto", "white"):
        refused.append("errors")
    if refused:
        raise CommonlawError("not-with-observation", settings=refused)


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


def refit(
    law: Law,
    trials: Trials,
    *,
    equations: Sequence[str] | None = None,
    inputs: Literal["same", "any"] = "same",
    noise: Mapping[str, float] | None = None,
    log_states: Sequence[str] | None = None,
    input_interpolation: str | None = None,
    seed: int = 0,
    progress: ProgressCallback,
) -> "Fitted":
    """Fit a law to trials, all parameters and initial values that it does not give anew; those it has are first values.

    Observation equations, given initial values and restrictions stay, but for noise of known standard deviation, and so
    do its equations where no other `equations` are given. A law without observation equations has white noise and
    parameters of each object. Only with `inputs` "any" may the trials have other inputs than the law.

    Raises
    ------
    CommonlawError
        If the objects do not share their equations, time is discrete, an object is not in the law, restrictions were
        not recorded, or the equations cannot be fitted to the trials.
    """
    levels = matched_noise(law, trials, noise)
    trials = matched(law, trials, inputs=inputs, observed=True)
    given = law.observation and law.observation.restrictions
    groups = {name: by for name, by in given.noise.items() if isinstance(by, str)} if given else {}
    begun = beginning_of(law, trials, {**groups, **(levels or {})}, equations, log_states, input_interpolation)
    return begun.fitted(seed, progress)


def beginning_of(
    law: Law,
    trials: Trials,
    noise: Mapping[str, NoiseGiven],
    equations: Sequence[str] | None = None,
    log_states: Sequence[str] | None = None,
    input_interpolation: str | None = None,
) -> "Beginning":
    """Return how a fit of a law to trials in its units begins, with noise as in `commonlaw.fit`, see `refit`."""
    if law.order == 0:
        raise CommonlawError("discrete-not-refined")
    if not shares_terms(law):
        raise CommonlawError("refine-own-terms")
    observation = law.observation
    between = input_interpolation or measured_schema(law).input_interpolation
    trials = replace(trials, schema=replace(trials.schema, input_interpolation=between))
    written = equations or law.provenance.equations or law.structure
    text, restrictions, free = ModelText.of(written), Restrictions(), list[str]()
    if observation is not None:
        if observation.restrictions is None:
            raise CommonlawError("restrictions-not-recorded")
        restrictions = observation.restrictions
        bounds = bounds_in(restrictions.bounds)
        text = replace(
            text,
            observed=observation.equations,
            initial=observation.initial,
            bounds=bounds,
            events=observation.events,
        )
        free = [name for name in law.terms.variables.states if name not in observation.initial]
    begun = begin(
        text,
        trials,
        dict(law.schema.initial_values) if observation is None else dict.fromkeys(free),
        law.schema.initial_time if observation is None else observation.initial_time,
        restrictions.shared,
        priors=restrictions.priors,
        log_states=measured_schema(law).logarithmic if log_states is None else log_states,
        noise=noise,
    )
    return replace(begun, first=_values_of(law, begun))


def updated(law: Law, trials: Trials) -> Law:
    """Return a law whose parameters were updated by new trials, see `Law.update`.

    Of each object the parameters p of the law, with their covariance, are the prior of the likelihood of its trials,
    under the noise of the law. What differs between trials, and initial values, has the priors of the law's fit.
    """
    trials, parts = matched(law, trials, observed=True), list[Law]()
    named, observation = named_parameters(law), law.observation
    assert observation is not None
    law.uncertainty.known_covariance()
    known = np.any([trial.known_noise for trial in trials], axis=0)
    levels = {
        name: observation.noise_of.get(name, observation.noise[name])
        for name in np.array(trials.schema.states)[~known].tolist()
    }
    for owner in trials.objects:
        begun, o = beginning_of(law, trials.select(object=owner), levels), object_index(law, owner)
        names, problem = begun.unknowns.names, begun.problem
        by = {name: begun.restrictions.shared.get(name, OBJECT) for name in named.names}
        indices = [i for i, name in enumerate(names) if name in by and not by_trial(by[name], trials.schema)]
        at = [named.names.index(names[i]) for i in indices]
        prior = NormalPrior.joint(indices, named.values[o, at], named.covariance[o][np.ix_(at, at)])
        others = [normal_prior for normal_prior in problem.priors if not {*normal_prior.indices.tolist()} & {*indices}]
        guessed = begun.guessed.copy()
        guessed[indices] = True
        begun = replace(begun, guessed=guessed, problem=replace(problem, priors=(*others, prior)))
        parts.append(begun.fitted(0, lambda _: None).law(()))
    coefficients, covariance = of_all_objects(parts)
    observations = [part.observation for part in parts if part.observation is not None]
    estimated = tuple(row for part_observation in observations for row in part_observation.estimated)
    likelihood = sum(part_observation.log_likelihood for part_observation in observations)
    return replace(
        law,
        objects=trials.objects,
        coefficients=coefficients,
        uncertainty=Uncertainty(covariance=covariance),
        properties={owner: attribute for part in parts for owner, attribute in part.properties.items()},
        observation=replace(observation, estimated=estimated, log_likelihood=likelihood),
    )


def _values_of(law: Law, begun: "Beginning") -> Floats:
    """Return first values of the unknowns: those of a law, as far as it has some that are not zero."""
    result, named = begun.first.copy(), named_parameters(law)
    estimated = () if law.observation is None else law.observation.estimated
    by_trial = {(estimate.object, estimate.trial, estimate.name): estimate.value for estimate in estimated}
    rows = zip(begun.trials, begun.unknowns.parameters, begun.unknowns.initial, strict=True)
    for trial, parameters, initial in rows:
        values = dict(zip(named.names, named.values[object_index(law, trial.object)].tolist(), strict=True))
        for k in (*parameters, *initial):
            name = begun.unknowns.names[k]
            value = by_trial.get((trial.object, trial.name, name), values.get(name, 0.0))
            if k >= 0 and value != 0 and np.isfinite(value):
                result[k] = value
    return result


@dataclass(frozen=True, eq=False)
class Beginning:
    """A model before it is fitted: what is unknown, likely first values of it, whether these were guessed, its bounds.

    First values have shape (p,), initial values among them; `groups` has the noise group of each object, by quantity,
    and `start` the time of initial values.
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

    def fitted(self, seed: int, progress: ProgressCallback, draws: int = DRAWS) -> "Fitted":
        """Return the maximum of the likelihood, from so many first values.

        Raises `CommonlawError` if the solution is finite from none of them, or the measurements do not determine all
        unknowns.
        """
        search = partial(
            maximize, self.problem, self.first, self.guessed, self.bounds, None, seed, progress, draws=draws
        )
        optimum = search(shares=EVENT_SHARES if self.problem.events_move and draws > 1 else (1.0,))
        lack_of_fit = self._lack_of_fit(optimum)
        if draws > 1 and lack_of_fit:
            optimum = max(optimum, search(shares=GROWING_SHARES), key=lambda candidate: candidate.log_likelihood)
            lack_of_fit = self._lack_of_fit(optimum)
        lost = np.flatnonzero(~np.isfinite(np.diagonal(optimum.covariance)))
        if len(lost):
            raise CommonlawError("parameters-not-identified", names=[self.unknowns.labels[i] for i in lost[:8]])
        return Fitted(self, optimum, lack_of_fit)

    def _lack_of_fit(self, optimum: Optimum) -> list[str]:
        """Return the quantities whose residuals exceed the noise by differences of neighbouring samples, with both.

        Residuals are three times as large, and more than a fiftieth of the standard deviation of the measurements.
        """
        listed, schema = list[str](), self.trials.schema
        for name, residual in zip(self.problem.model.observables, optimum.noise.tolist(), strict=True):
            if name in self.logarithmic or name not in schema.states or name in schema.noise_columns:
                continue
            columns = [(trial.times, trial.states[:, schema.states.index(name)]) for trial in self.trials]
            seen = [
                (times[kept], column[kept]) for times, column in columns if (kept := np.isfinite(column)).sum() >= 20
            ]
            if not seen:
                continue
            level = float(np.sqrt(np.mean([noise_level(times, column[:, np.newaxis]) ** 2 for times, column in seen])))
            if residual > max(3 * level, 0.02 * float(np.std(np.concatenate([column for _, column in seen])))):
                listed.append(f"{name}: {residual:.2g} (noise {level:.2g})")
        return listed


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
) -> Beginning:
    """Return a model and trials as a fit begins with them, see `commonlaw.fit`."""
    properties, shared, priors = property_names(trials.properties), shared or {}, priors or {}
    model = read_model(with_initial(text, initial_values, trials), trials.schema, properties)
    for j, state in enumerate(model.schema.states):
        is_free = model.initial[j] is None and j not in model.known
        # Nothing is said of it, and no observation equation may determine it
        if is_free and state not in (*model.observables, *initial_values) and not model.text.observed:
            raise CommonlawError("equation-without-column", name=state)
    unknowns = _unknowns(model, trials, properties, shared)
    known, groups = _checked_noise(trials, noise or {})
    shown = with_logarithms(trials, log_states)
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
        model, trials, unknowns, problem, first, guessed, bounds, groups, logarithmic, initial_time, restrictions
    )


def with_initial(text: ModelText, initial_values: Mapping[str, InitialGiven], trials: Trials) -> ModelText:
    """Return the text with initial values that are given apart from it."""
    properties, initial = property_names(trials.properties), dict(text.initial)
    for name, start in initial_values.items():
        if start is None or start == FREE:
            initial.pop(name, None)
        elif isinstance(start, str):
            if start.isidentifier() and start not in properties and get_close_matches(start, properties):
                raise unknown("property", start, properties)
            initial[name] = start
        elif isinstance(start, Mapping):
            known = dict[str, float]()
            for owner in trials.objects:
                value = start.get(owner, np.nan)
                if value is not None and not isinstance(value, str):
                    known[owner] = _finite(name, value, owner)
            initial[name] = known
        elif isinstance(start, tuple):
            mean, std = map(float, start)
            if not 0 < std < np.inf:
                raise CommonlawError("prior-not-positive", name=f"{name}(0)", std=std)
            initial[name] = mean, std
        else:
            initial[name] = repr(_finite(name, start, trials.objects[0]))
    return replace(text, initial=initial)


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
        determined = model.free_of(trial.object)
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
    check_choice("property", by, (*properties, *inputs))
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
            check_choice("property", given, property_names(trials.properties))
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
        if start is not None and start > trial.times[0]:
            raise CommonlawError("initial-time-late", trial=trial.label, time=trial.times[0], initial_time=start)
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
        values = np.concatenate([trial.inputs[:, model.column[i]] for trial in trials])
        known[columns[name]] = float(np.abs(values).max(initial=0.0)) or 1.0
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
    likely = likely_sizes(statements, known, len(columns), span)
    initial_values = {f"{name}(0)": likely[i] for i, name in enumerate(model.variables.states)}
    by_name = {**{name: likely[i] for name, i in columns.items()}}
    sizes = np.array([initial_values[name] if name in initial_values else by_name[name] for name in unknowns.names])
    guessed = np.array([name in guesses for name in unknowns.names], dtype=np.bool_)
    for i, name in enumerate(unknowns.names):
        if name in guesses:
            sizes[i] = guesses[name]
    for trial, indices in zip(trials, unknowns.initial, strict=True):
        for name, k in zip(model.variables.states, indices, strict=True):
            if k >= 0 and name in model.observables and name not in model.text.observed:
                seen = trial.states[:, model.observables.index(name)]
                seen = seen[np.isfinite(seen)]
                if len(seen) and seen[0] != 0:  # Measured states begin at their first measurements
                    sizes[k], guessed[k] = seen[0], True
    return sizes, likely[: model.width], guessed


def _bounds(model: Model, trials: Trials, unknowns: Unknowns) -> Bounds:
    limits = [limits_of(name, model.text.bounds) for name in unknowns.names]
    low, high = (
        (np.array(ends, dtype=np.float64) for ends in zip(*limits, strict=True)) if limits else (np.zeros(0),) * 2
    )
    for name, least, most in zip(unknowns.names, low, high, strict=True):
        if not least < most:
            texts = [bound.text for bound in model.text.bounds if bound.name == name]
            raise CommonlawError("bound-empty", text="; ".join(texts))
    longest = max(trial.times[-1] - trial.times[0] for trial in trials)
    delays = [model.parameters[index] for index in model.delay if index >= 0]
    for i, name in enumerate(unknowns.names):
        if name in delays:
            low[i], high[i] = max(low[i], 0.0), min(high[i], longest)
    return Bounds(low, high)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model with its maximum-likelihood estimates, and the quantities whose residuals exceed their noise."""

    begun: Beginning
    optimum: Optimum
    lack_of_fit: Sequence[str]

    @property
    def parameters(self) -> int:
        """How many unknown parameters an object has, initial values apart."""
        trials = self.begun.trials
        rows = zip(trials, self.begun.unknowns.parameters, strict=True)
        return len({k for trial, indices in rows for k in indices if k >= 0 and trial.object == trials.objects[0]})

    def minus_twice_log_evidence(self) -> float:
        """Return minus twice the log-evidence: ``-2 log L + sum_j log n_j + sum_k log n_k + (priors)``.

        An unknown j costs the logarithm of the number n_j of measurements in the trials that it is of, and an unknown
        noise that of the measurements of its quantity (BIC; Schwarz 1978, Ann. Statist. 6, 461, with the n of Pauler
        1998, Biometrika 85, 13, for what differs between groups). Unknowns with normal priors are integrated out
        (Laplace's method): ``sum ((p - m)/s)^2 + log s^2 - log det V``, with their covariance V.
        """
        problem, unknowns, optimum = self.begun.problem, self.begun.unknowns, self.optimum
        counts = np.zeros(len(unknowns.names))
        for data, parameter, initial in zip(problem.trials, unknowns.parameters, unknowns.initial, strict=True):
            used = np.unique([k for k in (*parameter, *initial) if k >= 0]).astype(int)
            counts[used] += data.trial.counts.sum() + np.isfinite(data.trial.below).sum()
        inner = [k for prior in problem.priors for k in prior.indices if not optimum.at_bound[k]]
        costs = np.log(np.maximum(np.delete(counts, inner), 1.0)).sum()
        levels = problem.counts + sum(np.isfinite(trial.trial.below).sum(axis=0) for trial in problem.trials)
        costs += np.log(levels[~problem.known_noise & (levels > 0)]).sum()
        for prior in problem.priors:
            kept = ~optimum.at_bound[prior.indices]
            costs += np.sum(prior.residuals(optimum.unknowns) ** 2)
            costs -= float(np.linalg.slogdet((prior.root.T @ prior.root)[np.ix_(kept, kept)])[1])
        costs -= float(np.linalg.slogdet(optimum.covariance[np.ix_(inner, inner)])[1])
        return float(costs) - 2 * optimum.log_likelihood

    def law(self, calls: tuple[str, ...]) -> Law:
        """Return the law, which records the calls."""
        begun, optimum = self.begun, self.optimum
        model, trials, problem, unknowns = begun.model, begun.trials, begun.problem, begun.unknowns
        groups = begun.groups
        given = read_equations(model.text.equations, model.schema, properties=property_names(trials.properties))
        inside = {coefficient.name for coefficient in given.coefficients}
        extra = [name for name in model.parameters if name not in inside]
        variables = replace(given.terms.variables, parameters=(*given.terms.variables.parameters, *extra))
        extra_terms = tuple(Term(parameter=variables.index(name)) for name in extra)
        terms = Terms(variables, (*given.terms.terms, *extra_terms))
        products = (*given.products, *(Product(0, len(given.terms) + i, 1.0, ((n, 1),)) for i, n in enumerate(extra)))
        known = np.nan_to_num(np.pad(given.known, ((0, 0), (0, len(extra)))))
        coefficients = np.tile(known, (len(trials.objects), 1, 1))
        for owner, whole in zip(trials.objects, coefficients, strict=True):
            values = _values(model, unknowns, optimum.unknowns, trials, owner)
            for product in products:
                whole[product.equation, product.term] = float(product.value(values))
        support = np.any(coefficients != 0, axis=0)
        covariance, shared = _covariance(model, trials, unknowns, optimum, products, support)
        levels = optimum.noise.copy()
        for k in np.flatnonzero(problem.known_noise):  # Where each measurement has its own, the median
            of_each = np.concatenate([(data.trial.std(levels) / data.trial.averaging)[:, k] for data in problem.trials])
            known_each = np.concatenate([np.isfinite(data.trial.noise[:, k]) for data in problem.trials])
            levels[k] = np.median(of_each[known_each])
        noise = dict(zip(problem.model.observables, levels.tolist(), strict=True))
        noise_of = {
            name: {owner: noise[f"{name} of {group}"] for owner, group in group_of.items()}
            for name, group_of in groups.items()
        }
        noise = {name: noise.get(name) or float(np.median(list(noise_of[name].values()))) for name in model.observables}
        largest = [
            np.abs(problem.predicted(trial, optimum.unknowns, False).states).max(axis=0) for trial in problem.trials
        ]
        # A state may always be zero
        sizes = dict(zip(model.variables.states, np.maximum(np.max(largest, axis=0), 1e-300).tolist(), strict=True))
        errors = np.sqrt(np.diagonal(optimum.covariance))
        apart = [by_trial(begun.restrictions.shared.get(name, OBJECT), trials.schema) for name in model.parameters]
        estimated = tuple(
            TrialEstimate(trial.object, trial.name, unknowns.names[k], float(optimum.unknowns[k]), float(errors[k]))
            for trial, parameter, indices in zip(trials, unknowns.parameters, unknowns.initial, strict=True)
            for k in [*np.array(parameter, dtype=int)[apart].tolist(), *indices]
            if k >= 0
        )
        initial = dict(model.text.initial)
        schema = replace(trials.schema, logarithmic=begun.logarithmic)
        observation = Observation(
            schema,
            dict(model.text.observed),
            initial,
            begun.start,
            noise,
            sizes,
            estimated,
            optimum.log_likelihood,
            noise_of,
            begun.restrictions,
            model.text.events,
            model.text.functions,
        )
        steps = (
            Step("equations", "; ".join(given.texts), "as given"),
            *(Step("observation", f"{name} = {right}", "as given") for name, right in model.text.observed.items()),
            *(
                Step("event" if ": " in line else "start" if "(0) = " in line else "parameters", line, "as given")
                for line in observation.lines[len(model.text.observed) :]
            ),
            Step(
                "fit",
                f"-log L = {-optimum.log_likelihood:.6g}",
                f"maximum likelihood of {counted(len(unknowns.names), 'parameter')} by least squares of trajectories; "
                f"{optimum.starts_alike} of the best starts end there",
            ),
        )
        vague = np.flatnonzero(~begun.guessed & (errors > np.exp(REACH) * np.abs(begun.first)))
        names = [unknowns.labels[i] for i in vague[:8]]
        limitless = (note("parameters-without-limits", parameters=names),) if names else ()
        provenance = Provenance(
            outcomes=(
                *_at_bounds(model, unknowns, begun.bounds, optimum),
                *limitless,
                *((note("residuals-exceed-noise", residuals=self.lack_of_fit),) if self.lack_of_fit else ()),
                *((note("trials-differ", objects=shown(differing)),) if (differing := _differing_trials(self)) else ()),
            ),
            history=steps,
            equations=given.texts,
            calls=calls,
            domain=Domain.of(trials, ()),
        )
        properties = {owner: values for owner, values in trials.properties.items() if owner in trials.objects}
        return Law(
            terms,
            model.schema,
            model.order,
            trials.objects,
            coefficients,
            Uncertainty(covariance=covariance, shared_factor=shared),
            provenance=provenance,
            properties=properties,
            observation=observation,
        )


def _differing_trials(fitted: Fitted, rounding: float = 1e-9) -> list[str]:
    """Return the objects whose parameters differ between trials, but for initial values and what may differ."""
    begun, optimum, p_values = fitted.begun, fitted.optimum, dict[str, float]()
    shared, names = begun.restrictions.shared, begun.unknowns.names
    may = np.array([by_trial(shared.get(name, OBJECT), begun.trials.schema) for name in names])
    for owner in begun.trials.objects:
        datasets = [data for data in begun.problem.trials if data.trial.object == owner]
        factors, measurements = list[Floats](), 0
        for data in datasets if len(datasets) > 1 else ():
            used = np.isin(np.arange(len(names)), data.parameter) & ~may & ~optimum.at_bound
            free = np.isin(np.arange(len(names)), [*data.initial, *data.parameter]) & ~used & ~optimum.at_bound
            residuals, slopes = replace(begun.problem, trials=(data,), priors=()).residuals(
                optimum.unknowns, optimum.noise
            )
            assert slopes is not None
            rows = np.column_stack([slopes[:, used], slopes[:, used] @ optimum.unknowns[used] - residuals])
            basis, sizes, _ = np.linalg.svd(slopes[:, free], full_matrices=False)
            basis = basis[:, sizes > rounding * sizes.max(initial=0.0)]
            rest = rows - basis @ (
                basis.T @ rows
            )  # Slopes that those by others, such as initial values, do not explain
            rest *= np.linalg.norm(rest, axis=0) > rounding * np.linalg.norm(rows, axis=0)
            factors.append(np.asarray(np.linalg.qr(rest, mode="r")))
            measurements += len(rows) - basis.shape[1]
        if factors:
            p_values[owner] = heterogeneity_p_value(factors, measurements)
    return [owner for owner, p_value in p_values.items() if p_value < HETEROGENEITY_LEVEL / len(p_values)]


def _values(model: Model, unknowns: Unknowns, found: Floats, trials: Trials, owner: str) -> dict[str, Floats]:
    """Return the value of each parameter of an object, the mean over its trials."""
    shares, known = unknowns.means(trials, owner)
    return dict(zip(model.parameters, map(np.asarray, shares @ found + known), strict=True))


def _covariance(
    model: Model, trials: Trials, unknowns: Unknowns, optimum: Optimum, products: Sequence[Product], support: Bools
) -> tuple[Floats, Floats | None]:
    """Return the covariance of each object's coefficients, and the factor of that between objects.

    Given what objects share they are independent: with the shared unknowns s of covariance S, Cov(a, b) = A S B' for
    A = Cov(a, s) inv(S).
    """
    place = {(j, k): i for i, (j, k) in enumerate(np.argwhere(support).tolist())}
    size, covariance = int(support.sum()), optimum.covariance
    means = {owner: unknowns.means(trials, owner)[0] for owner in trials.objects}
    uses = np.sum([mean.any(axis=0) for mean in means.values()], axis=0)
    shared = np.flatnonzero((uses > 1) & ~optimum.at_bound)
    result, factors = np.zeros((len(trials.objects), size, size)), list[Floats]()
    std = np.sqrt(np.diagonal(covariance)[shared])
    std = np.where(std > 0, std, 1.0)
    # Of nearly collinear unknowns the rounded correlations are hardly positive definite
    correlations = covariance[np.ix_(shared, shared)] / std / std[:, np.newaxis] + 1e-13 * np.eye(len(shared))
    root = std[:, np.newaxis] * np.linalg.cholesky(correlations)
    for i, owner in enumerate(trials.objects):
        values = _values(model, unknowns, optimum.unknowns, trials, owner)
        slopes = np.zeros((size, len(model.parameters)))
        for product in products:
            for name, power in product.coefficients:
                if (product.equation, product.term) in place:
                    others = product._replace(coefficients=tuple(c for c in product.coefficients if c[0] != name))
                    outer = float(others.value(values))
                    slope = outer * power * float(values[name]) ** (power - 1)
                    slopes[place[product.equation, product.term], model.parameters.index(name)] += slope
        slopes = slopes @ means[owner]
        result[i] = slopes @ covariance @ slopes.T
        if len(shared):
            half = np.linalg.solve(root, covariance[shared] @ slopes.T)
            factors.append(half.T)
    return result, np.array(factors) if len(shared) and len(trials.objects) > 1 else None


def estimate_at_bound(
    where: str, name: str, end: float, is_low: bool, value: float, error: float, bound: str
) -> Outcome:
    """Return that a parameter is at an end of its bound, with the 95 % interval on the other side.

    The interval is of the normal distribution about the estimate without the bound, as far as it is within.
    """
    from scipy.stats import norm

    side = 1 if is_low else -1
    reach = side * error * norm.isf(0.05 * norm.sf(side * (end - value) / error)) if 0 < error < np.inf else np.nan
    within = f"; 95 %: {'up' if is_low else 'down'} to {value + reach:.4g}" if np.isfinite(reach) else ""
    estimate = with_error(value, error) if np.isfinite(error) else f"{value:.4g}"
    return note("estimate-at-bound", where, name=name, end=end, estimate=estimate, within=within, bound=bound)


def _at_bounds(model: Model, unknowns: Unknowns, bounds: Bounds, optimum: Optimum) -> Iterator[Outcome]:
    """Yield which parameters are at a bound."""
    for i in np.flatnonzero(optimum.at_bound):
        name, end = unknowns.names[i], float(optimum.unknowns[i])
        value, error = (float(column[i]) for column in optimum.beyond)
        text = next((bound.text for bound in model.text.bounds if bound.name == name), name)
        where = unknowns.labels[i].removeprefix(f"{name} of ") if unknowns.labels[i] != name else ""
        yield estimate_at_bound(where, name, end, end == bounds.low[i], value, error, text)
