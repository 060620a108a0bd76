"""Forecasts of trials by a law, from given or estimated initial conditions, and how far they may be off."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from numbers import Real
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Diagnostic, marked
from commonlaw.errors import CommonlawError
from commonlaw.forecast.collocation import FromStarts
from commonlaw.forecast.forecast import Forecast, Part
from commonlaw.forecast.initial_state import FilteredStart, StartedTrial
from commonlaw.forecast.scheme import AbstractScheme, AbstractStarted, Extended, ForecastOptions, with_times
from commonlaw.forecast.schemes import scheme_of
from commonlaw.integration import Inputs, Trajectory
from commonlaw.law import Law, select_objects
from commonlaw.law.alignment import matched, matched_times
from commonlaw.law.population import with_objects_of
from commonlaw.runtime.arguments import check_type, numbers_of
from commonlaw.text import counted, shown
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import with_logarithms, with_noise, with_property_inputs
from commonlaw.trials.trial import property_names


def predict(
    law: Law,
    trials: Trials,
    *,
    times: ArrayLike | None = None,
    start: int | Literal["all"] | None = None,
    from_time: float | None = None,
    return_std: bool = False,
    method: str = "auto",
    tolerance: float = 1e-8,
    seed: int | None = None,
    input_interpolation: str | None = None,
    discrepancy: bool = False,
    averaged: bool = True,
) -> Forecast:
    """Forecast each trial from its own initial state, see `Law.predict`."""
    wanted, from_time = wanted_times(law, trials, times, from_time)
    trials = matched(law, trials)
    if (early := wanted[wanted < min(trial.times[0] for trial in trials)]).size:
        trial = min(trials, key=lambda trial: float(trial.times[0]))
        raise CommonlawError("forecast-before-start", trial=trial.label, time=early[0], begins=trial.times[0])
    if discrepancy:
        law, trials = with_discrepancy(law, trials)
    law, trials = with_object(law, trials)
    if return_std:
        law.uncertainty.known_covariance()
        if law.uncertainty.noise is None:
            raise CommonlawError("noise-unknown-at-start")
    options = ForecastOptions(start, from_time, return_std, method, tolerance, seed, input_interpolation)

    def forecast(law: Law) -> Forecast:
        scheme = scheme_of(law, property_names(trials.properties), input_interpolation)
        return _of_started(_begun(scheme, trials, wanted, options), options)

    first, *others = law.models if averaged else law.models[:1]
    parts = [Part(first.probability, forecast(law))]
    for model in others:
        with suppress(CommonlawError):  # Its start may not be fitted where that of the law is
            plausible = replace(model.law, provenance=law.provenance)
            parts.append(Part(model.probability, forecast(plausible), equations="; ".join(plausible.structure)))
    result = average(parts)
    notes = remarks_on(result)
    result = result.as_measured(trials) if result.trials.schema.logarithmic != trials.schema.logarithmic else result
    # Where it leaves what the law was learned from
    visited, ahead = list[tuple[str, dict[str, Floats]]](), 0.0
    schema = result.trials.schema
    for trial, trajectory, solution in zip(result.trials, result.trajectories, result.solutions, strict=True):
        columns = dict(zip(law.terms.variables.states, solution.T, strict=True))
        columns |= dict(zip(schema.states, trajectory.states.T, strict=False))
        columns |= dict(zip(schema.inputs, trial.inputs.T, strict=True))
        properties = result.trials.properties.get(trial.object, {})
        columns |= {name: np.array([value]) for name, value in properties.items() if isinstance(value, float)}
        visited.append((trial.label, columns))
        known = trial.times[np.isfinite(trial.states).any(axis=1)][-1]
        since = known if result.from_time is None else min(known, result.from_time)
        ahead = max(ahead, float(trial.times[-1] - since))
    unit = schema.units.get(schema.time, "")
    notes += tuple(law.provenance.domain.remarks(visited, unit, ahead))
    noted = replace(result.trials, notes=(*result.trials.notes, *notes)) if notes else result.trials
    return replace(result, trials=noted, wanted=wanted)


def _begun(scheme: AbstractScheme, trials: Trials, wanted: Floats, options: ForecastOptions) -> AbstractStarted:
    """Return the trials that can be forecast, with samples at all times that are wanted, and where each starts."""
    scheme.check(options)
    start, from_time, extended, lost = options.start, options.from_time, list[Extended](), list[str]()
    if (start not in (None, "all") or from_time is not None) and not any(map(scheme.free_starts, trials)):
        option = f"start={start}" if from_time is None else f"from_time={from_time:g}"
        raise CommonlawError("option-without-effect", option=option, kind="a law that gives all initial values")
    trials, times = scheme.taken(trials), np.unique(wanted)
    between = options.input_interpolation or scheme.law.observation.measured.input_interpolation
    for trial in trials:
        inputs = Inputs.of(trial.times, trial.inputs, between)
        whole = with_times(trial, inputs, times)
        if from_time is None or trial.times[0] < from_time <= whole.times[-1]:
            extended.append(Extended(trial, whole, inputs))
        else:
            lost.append(f"{trial.label}, t = {trial.times[0]:g} to {whole.times[-1]:g}")
    notes = notes_of_lost(lost, from_time, len(extended))
    notes += notes_of_few([whole for _, whole, _ in extended], start, from_time)
    return scheme.begin(trials.with_trials([whole for _, whole, _ in extended], *notes), extended, options)


def _of_started(started: AbstractStarted, options: ForecastOptions, times: Sequence[Floats] = ()) -> Forecast:
    """Return the forecasts of trials from where they start, at more times of each trial."""
    known, trials = started.law.uncertainty, started.trials
    if times:
        triples = zip(trials, started.inputs, times, strict=True)
        trials = trials.with_trials([with_times(*triple) for triple in triples])
    trials = with_noise(trials, known.noise_of)
    solved = started.solved(list(trials))
    latent = tuple(states for *_, states in solved if states is not None)
    return Forecast(
        trials,
        tuple(trajectory for trajectory, *_ in solved),
        tuple(std for _, std, _ in solved if std is not None) if options.return_std else None,
        known.noise if options.return_std else None,
        options.from_time,
        known.error_model,
        None if started.law.order == 0 else partial(_of_started, started, options),
        degrees_of_freedom=known.degrees_of_freedom,
        horizons=tuple(
            np.maximum(0.0, trial.times - until) for trial, until in zip(trials, started.known_until, strict=True)
        ),
        interval_inflation=known.interval_inflation,
        latent=latent,
    )


def notes_of_lost(lost: Sequence[str], from_time: float | None, kept: int) -> list[str]:
    """Return a note on trials without samples on both sides of a time; refused if none is kept."""
    why = Diagnostic("no-samples-around", {"from_time": from_time, "trials": shown(lost)})
    if not kept:
        raise CommonlawError("forecast-no-trial", reason=why)
    return [f"trials not forecast {why.sentence(marked)}"] if lost else []


def notes_of_few(trials: Iterable[Trial], start: int | Literal["all"] | None, from_time: float | None) -> list[str]:
    """Return a note on trials with fewer samples to start from than were asked for."""
    if start is None or start == "all":
        return []
    end = np.inf if from_time is None else from_time
    counts = [(trial.label, int(np.sum(trial.measured().times < end))) for trial in trials]
    few = [f"{label}: {counted(count, 'sample')}" for label, count in counts if count < start]
    return [f"initial states of {shown(few, 'trial')} have fewer than `start={start}`: all are taken"] if few else []


def wanted_times(
    law: Law, trials: Trials, times: ArrayLike | None, from_time: float | None
) -> tuple[Floats, float | None]:
    """Return further times of forecasts and that at which they begin, given in the unit of trials, in that of the law.

    Raises `CommonlawError` if the latter is no finite number.
    """
    wanted = np.atleast_1d(numbers_of("times", [] if times is None else matched_times(law, trials, times)))
    if from_time is not None:
        check_type("from_time", from_time, Real, "a number")
        if not np.isfinite(from_time):
            raise CommonlawError("forecast-from-time", from_time=from_time)
        from_time = float(np.asarray(matched_times(law, trials, from_time)))
    return wanted, from_time


def forecast_from(law: Law, name: str, times: Floats, start: Floats, limit: float | None = None) -> Forecast:
    """Forecast an object from a given state, with standard deviations where the law has a covariance.

    Raises `CommonlawError` if the start has the wrong number of values, or must be positive and is not.

    Parameters
    ----------
    law, name
        A law without inputs, and one of its objects.
    times
        Shape (n,); the first is that of the start.
    start
        The states, followed by the rates of those of second order, shape (width,), without error.
    limit
        A state larger than this is not followed on, see `simulate`.
    """
    variables, states = law.terms.variables.states, len(law.schema.states)
    if len(start) != len(variables):
        raise CommonlawError("start-size", given=len(start), expected=len(variables), variables=variables)
    unknown = np.full((len(times) - 1, states), np.nan)
    trial = Trial(name, "1", times, np.vstack([start[:states], unknown]))
    measured = Trials((trial,), replace(law.schema, logarithmic=()))
    followed = with_logarithms(measured, law.schema.logarithmic)
    initial = np.append(followed.trials[0].states[0], start[states:])
    width, certain = len(variables), np.zeros((1, len(variables)))
    inputs = Inputs.of(times, followed.trials[0].inputs, law.schema.input_interpolation)

    def forecast(plausible: Law) -> Forecast:
        sensitivity = np.zeros((width, int(plausible.support.sum())))
        given = FilteredStart(times[:1], initial[None], certain, np.zeros((width, width)), sensitivity[None])
        options = ForecastOptions(return_std=law.uncertainty.has_std, limit=limit)
        started = (StartedTrial(followed.trials[0], inputs, given),)
        return _of_started(FromStarts(plausible, followed, started, options), options)

    averaged = average([Part(model.probability, forecast(model.law)) for model in law.models])
    return averaged.as_measured(measured) if law.schema.logarithmic else averaged


def with_discrepancy(law: Law, trials: Trials) -> tuple[Law, Trials]:
    """Return the law with its discrepancy as further terms, and trials with the properties that these take as inputs.

    Raises `CommonlawError` if it has none, or the law was changed since.
    """
    wider = law.provenance.with_discrepancy
    if wider is None:
        raise CommonlawError("discrepancy-missing")
    if {*law.objects} <= {*wider.objects}:
        wider = select_objects(wider, law.objects)
    used, names = np.flatnonzero(law.support.any(axis=0)).tolist(), wider.terms.names
    used = [k for k in used if law.terms.parameter_name(k) not in wider.schema.inputs]  # Properties are inputs there
    same = wider.objects == law.objects and {law.terms.names[k] for k in used} <= {*names}
    if same:
        places = [names.index(law.terms.names[k]) for k in used]
        same = np.allclose(wider.coefficients[:, :, places], law.coefficients[:, :, used])
    if not same or (wider.schema.states, wider.order) != (law.schema.states, law.order):
        raise CommonlawError("discrepancy-outdated")
    known = {name: {**law.properties.get(name, {}), **trials.properties.get(name, {})} for name in trials.objects}
    taken = wider.schema.inputs[len(law.schema.inputs) :]
    return wider, with_property_inputs(replace(trials, properties=known), taken)


def with_object(law: Law, trials: Trials) -> tuple[Law, Trials]:
    """Return the law of these trials' objects; where their only one was not named, it is the only one of the law."""
    name, others = trials.objects[0], ", ".join(law.objects)
    if not trials.nameless or name in law.objects:
        if len(law.objects) == 1:
            select_objects(law, trials.objects)
        law, notes = with_objects_of(law, trials)
        return law, replace(trials, notes=(*trials.notes, *notes)) if notes else trials
    if len(law.objects) > 1:
        raise CommonlawError("object-unnamed", objects=others)
    note = f"no object is named: {name} has the coefficients of {others}, the only object of the law"
    other_laws = law.uncertainty.map_other_laws(lambda plausible: replace(plausible, objects=(name,)))
    uncertainty = replace(law.uncertainty, other_laws=other_laws)
    return replace(law, objects=(name,), uncertainty=uncertainty), trials.with_trials(trials.trials, note)


def fitted(law: Law, trials: Trials, return_std: bool = False) -> Forecast:
    """Return the solutions of a law whose initial conditions are estimated from all samples of each trial.

    The coefficients are fixed. Process noise is left out, so that residuals are all that the equations leave; such fits
    have no bands.

    Raises `CommonlawError` if the law is in discrete time, or not finite near the samples of a trial.
    """
    errors = law.uncertainty.error_model
    solution = replace(law, uncertainty=replace(law.uncertainty, error_model=errors.of_measurements))
    return solution.predict(trials, start="all", return_std=return_std and not errors.of_law, averaged=False)


def average(parts: Sequence[Part]) -> Forecast:
    """Return the average of forecasts of the same trials, of which the first is that of the law itself.

    States are medians over laws, weighted by their probabilities; standard deviations are about these, and intervals
    hold their share of the mixture. A law that diverges in a trial does not count for it; where all do, the law stands
    alone.
    """
    if len(parts) == 1:
        return parts[0].forecast
    first = parts[0].forecast
    weights = [_weights(parts, i) for i in range(len(first.trajectories))]
    moments = [_moments(parts, i, weight) for i, weight in enumerate(weights)]
    return replace(
        first,
        trajectories=tuple(trajectory for trajectory, _ in moments),
        std=None if first.std is None else tuple(std for _, std in moments),
        at_more_times=None if first.at_more_times is None else partial(_averaged_at, tuple(parts)),
        parts=tuple(part._replace(weights=tuple(weight[k] for weight in weights)) for k, part in enumerate(parts)),
    )


def _averaged_at(parts: Sequence[Part], times: Sequence[Floats]) -> Forecast:
    """Return the average of the forecasts at more times; a function of a module, as processes hand it to each other."""
    pairs = [(part, part.forecast.at_more_times) for part in parts]
    return average([part._replace(forecast=more(times)) for part, more in pairs if more])


def remarks_on(found: Forecast) -> tuple[str, ...]:
    """Return a sentence on rival laws where the law diverges, or where they shift a forecast by more than its error."""
    if len(found.parts) < 2:
        return ()
    first, farthest = found.parts[0], 0.0
    lost = [trial.label for trial, share in zip(found.trials, first.weights, strict=True) if not share]
    if lost:
        return (
            f"the law diverges in {', '.join(lost)}: its forecasts there average the other plausible laws, of total "
            f"posterior probability {1 - first.probability:.2g}",
        )
    if found.std is None:
        return ()
    width = len(found.trials.schema.states)
    for i, (std, noise) in enumerate(zip(first.forecast.std or (), first.forecast.measurement_std(), strict=True)):
        middle = found.trajectories[i].states[:, :width]
        others = [(part.weights[i], part.forecast.trajectories[i].states[:, :width]) for part in found.parts]
        between = np.sqrt(sum(share * (states - middle) ** 2 for share, states in others if share))
        farthest = max(farthest, float(np.nanmax(between / np.hypot(std, noise), initial=0.0)))
    if farthest <= 1:
        return ()
    second = found.parts[1]
    return (
        f"{second.equations} is also plausible (posterior probability {second.probability:.2g}): forecasts average "
        f"{len(found.parts)} laws, which differ by more than the standard error of one forecast",
    )


def _weights(parts: Sequence[Part], trial: int) -> Floats:
    """Return what each forecast of a trial counts, shape (parts,)."""
    shares: Floats = np.array([part.probability for part in parts])
    whole = np.zeros(len(parts), dtype=np.bool_)
    for k, (forecast, trajectory) in enumerate((part.forecast, part.forecast.trajectories[trial]) for part in parts):
        std = 0.0 if forecast.std is None else forecast.std[trial]
        whole[k] = trajectory.outcome is None and np.isfinite(trajectory.states).all() and np.isfinite(std).all()
    if not whole.any():
        return np.asarray(np.eye(len(parts))[0])
    return np.asarray(shares * whole / shares[whole].sum())


def _moments(parts: Sequence[Part], trial: int, weights: Floats) -> tuple[Trajectory, Floats]:
    """Return the median trajectory of a trial and the standard deviation of its states about it, shape (n, states)."""
    kept = [(share, part.forecast) for share, part in zip(weights, parts, strict=True) if share]
    states = np.array([forecast.trajectories[trial].states for _, forecast in kept])
    # The least of the values up to which half of the weight lies
    order = np.argsort(states, axis=0)
    reached = np.cumsum(weights[weights > 0][order], axis=0) >= 0.5 * (1 - 1e-12)
    places = np.take_along_axis(order, reached.argmax(axis=0)[np.newaxis], axis=0)
    median = np.take_along_axis(states, places, axis=0)[0]
    width = len(parts[0].forecast.trials.schema.states)
    variance = np.zeros_like(median[:, :width])
    for (share, forecast), state in zip(kept, states, strict=True):
        with np.errstate(invalid="ignore"):
            about = (state - median)[:, :width]
            variance += share * ((0.0 if forecast.std is None else forecast.std[trial]) ** 2 + about**2)
    return replace(kept[0][1].trajectories[trial], states=median), np.sqrt(variance)
