"""Notes on alternatives to a law: rivals and discriminating experiments, confounded variables, discrete time."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.diagnostics import Outcome, marked, note
from commonlaw.discovery.log_scale import largest_change
from commonlaw.discovery.measured_rates import without_measured_rates
from commonlaw.discovery.method import with_properties_in
from commonlaw.errors import CommonlawError
from commonlaw.estimation.fitting import Fitted
from commonlaw.forecast import fitted, forecast_from
from commonlaw.forecast.forecast import Forecast
from commonlaw.formulation import law_variables
from commonlaw.inference.diagnose.confounding import ConfoundedVariables, confounded_sets
from commonlaw.inference.search.error_models import MISFIT, misfit_step_of
from commonlaw.inference.search.setup import stay_at_levels
from commonlaw.inference.settings import INDIFFERENT, SIGNIFICANT, STRONG, VERY_STRONG
from commonlaw.inference.verbs.schemes import fit_of
from commonlaw.integration import jumps
from commonlaw.law import Law, PlausibleLaw
from commonlaw.law.law import with_other_laws
from commonlaw.law.parameters import named_parameters, rate_names, state_rates
from commonlaw.law.quantiles import two_sided
from commonlaw.law.text import left_hand_sides
from commonlaw.library import AbstractLibrary, Order, PolynomialLibrary, parse_library
from commonlaw.library.libraries import LibraryGiven
from commonlaw.trials import Trial, Trials
from commonlaw.trials.check import Finding

_MAX_EXCESS_SHARE = 0.1
"""Share of a range: margin around visited states, and spread of similar initial values."""

_Found = tuple[Floats, Forecast, Forecast, tuple[int, int]]
"""An initial state, the forecasts of two laws from there, and the row and the state in which they differ most."""


def outcomes_of_rivals(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return notes on rivals of a law: those about as probable, and those that other initial values discriminate.

    About as probable are laws up to a 2 log B of 2, or the first two others where a law has less than half of the
    probability. Rivals are laws without strong evidence against them, which fit the trials equally well. From other
    initial values within the visited ranges, forecasts of the two may differ by more than the sum of their bands: a
    trial there discriminates.
    """
    share = 1.0 - sum(rival.probability for rival in law.uncertainty.other_laws)
    others = sorted(law.uncertainty.other_laws, key=lambda rival: -rival.probability)
    least = share * np.exp(-INDIFFERENT / 2)
    near = others[:2] if share < 0.5 else [rival for rival in others if rival.probability > least]
    if not near:
        return _outcomes_of_starts(law, others, share, trials)
    listed = [f"{'; '.join(rival.law.structure)} ({rival.probability:.2g})" for rival in near]
    indifferent = note("several-laws-plausible", probability=share, rivals=listed)
    return (indifferent, *_outcomes_of_starts(law, others, share, trials))


def _outcomes_of_starts(
    law: Law, others: Sequence[PlausibleLaw[Law]], share: float, trials: Trials
) -> tuple[Outcome, ...]:
    rivals = [rival for rival in others if rival.probability > share * np.exp(-STRONG / 2)][:2]
    if not rivals or law.order == 0 or law.schema.inputs or not law.uncertainty.has_std:
        return ()
    lasting = float(np.median([trial.times[-1] - trial.times[0] for trial in trials]))
    times = trials.trials[0].times[0] + np.linspace(0, lasting, 25)
    starts = ((rival, _discriminating_start(law, rival.law, times)) for rival in rivals)
    return tuple(_outcome(law, rival, start) for rival, start in starts if start is not None)


def _discriminating_start(law: Law, rival: Law, times: Floats) -> _Found | None:
    """Return the initial state from which two laws differ most, their forecasts, and the sample at which they do."""
    best, visited = 1.0, law.provenance.domain.visited
    result: _Found | None = None
    # Solutions outside of the visited ranges do not count, see `_within`
    ends = [visited.get(name, (-np.inf, np.inf)) for name in law.terms.variables.states]
    limit = max(max(abs(low), abs(high)) + _MAX_EXCESS_SHARE * (high - low) for low, high in ends)
    for start in _starts(law):
        with suppress(CommonlawError):
            alone = (with_other_laws(either, ()) for either in (law, rival))
            bound = None if law.schema.logarithmic else limit
            one, of_rival = (forecast_from(either, law.objects[0], times, start, bound) for either in alone)
            (a, first), (b, second) = _first(one), _first(of_rival)
            with np.errstate(all="ignore"):
                apart = np.abs(a - b) / (two_sided(0.95) * (first + second))  # In the sum of their bands
            apart = np.where(np.isfinite(apart), apart, 0.0) * _within(law, one)
            if apart.max(initial=0.0) > best:
                row, state = np.unravel_index(int(apart.argmax()), apart.shape)
                best, result = float(apart.max()), (start, one, of_rival, (int(row), int(state)))
    return result


def _starts(law: Law) -> Iterator[Floats]:
    """Yield initial states at the ends and in the middle of the visited ranges, with zero rates if these are near."""
    variables, visited = law.terms.variables.states, law.provenance.domain.visited
    if not all(name in visited for name in variables):
        return
    values = []
    for name in variables:
        low, high = visited[name]
        near_zero = name in rate_names(law) and _beyond(np.zeros(1), (low, high))[0] <= _MAX_EXCESS_SHARE
        values.append((0.0 if near_zero else (low + high) / 2, low, high))
    for _, start in zip(range(27), product(*values), strict=False):
        yield np.array(start)


def _beyond(values: Floats, ends: tuple[float, float]) -> Floats:
    """Return the distances of values to a range, relative to its width, shape (n,)."""
    low, high = ends
    return np.asarray(np.maximum(np.maximum(low - values, values - high), 0.0) / max(high - low, 1e-300))


def _within(law: Law, forecast: Forecast) -> Floats:
    """Return 1 while a forecast stays near the visited ranges and 0 from then on, shape (n, 1)."""
    visited, (states, _) = law.provenance.domain.visited, _first(forecast)
    pairs = zip(law.schema.states, states.T, strict=True)
    near = np.all(
        [_beyond(np.nan_to_num(values, nan=np.inf), visited[name]) <= _MAX_EXCESS_SHARE for name, values in pairs],
        axis=0,
    )
    return np.logical_and.accumulate(near)[:, np.newaxis].astype(np.float64)


def _first(forecast: Forecast) -> tuple[Floats, Floats]:
    """Return the states of the only trajectory and the standard deviations of measurements, shape (n, states) each."""
    assert forecast.std is not None
    assert forecast.noise is not None
    names, followed = forecast.trials.schema.states, forecast.followed
    path = forecast.trajectories[0].states[:, : len(names)]
    relative = np.isin(names, followed.trials.schema.logarithmic if followed else ())
    return path, np.hypot(forecast.std[0], forecast.noise * np.where(relative, path, 1.0))


def _outcome(law: Law, rival: PlausibleLaw[Law], found: _Found) -> Outcome:
    start, one, forecast_of_rival, (row, state) = found
    variables, schema = law.terms.variables.states, law.schema
    units = {name: f" {schema.units.get(name, '')}".rstrip() for name in schema.states}
    begin = " and ".join(
        f"{name} = {value:.3g}{units.get(name, '')}" for name, value in zip(variables, start, strict=True)
    )
    one_end, other_end = (
        f"{states[row, state]:.3g} ± {two_sided(0.95) * std[row, state]:.2g}{units[schema.states[state]]}"
        for states, std in map(_first, (one, forecast_of_rival))
    )
    exchanges, lefts = list[str](), left_hand_sides(schema.states, law.order)
    supports = [either.support & either.terms.is_factor for either in (law, rival.law)]  # Without nonlinear parameters
    for side, support, of_rival in zip(lefts, *supports, strict=True):
        terms = [law.terms.names[k] for k in np.flatnonzero(support)]
        rivals = [rival.law.terms.names[k] for k in np.flatnonzero(of_rival)]
        more, fewer = (", ".join(x for x in a if x not in b) for a, b in ((rivals, terms), (terms, rivals)))
        if more or fewer:
            change = f"{more} in place of {fewer}" if more and fewer else f"{more} as well" if more else f"no {fewer}"
            exchanges.append(f"{side} with {change}")
    times = one.trials.trials[0].times
    after = f"{times[row] - times[0]:.3g} {schema.units.get(schema.time, '')}".rstrip()
    return note(
        "rival-plausible",
        exchange=", ".join(exchanges),
        probability=rival.probability,
        object=law.objects[0],
        begin=begin,
        state=schema.states[state],
        one_end=one_end,
        after=after,
        other_end=other_end,
    )


def outcomes_of_generations(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return a note on discrete time for each state whose next sample is a function of the present one.

    This applies if samples are at equally spaced whole numbers that do not resolve the motion of the state:

    ``sum_k (x[k+1] - x[k])^2 >= sum_k (x[k+1] - mean of the object)^2``

    The next sample is regressed on polynomials of degree 2 in the present states and inputs, with an intercept of each
    object and p common coefficients. By the Bayesian information criterion (Schwarz 1978), the evidence for this is
    very strong against the means and against the solutions of the law, where S are residual sums of squares:

    ``n log(min(S_mean, S_law) / S_regression) - p log n > 10``
    """
    times = [trial.times for trial in trials]
    steps = np.unique(np.concatenate([np.diff(time) for time in times]))
    whole = len(steps) == 1 and all(np.array_equal(numbers, np.round(numbers)) for numbers in (steps, *times))
    if not whole or not (regressions := [*_regressions(trials)]):
        return ()
    equations = dict(zip(law.schema.states, left_hand_sides(law.schema.states, law.order), strict=True))
    result = list[Outcome]()
    try:
        solutions = np.concatenate([trajectory.states[1:] for trajectory in fitted(law, trials).trajectories])
    except CommonlawError:  # They diverge
        solutions = np.full((sum(len(trial) - 1 for trial in trials), len(law.schema.states)), np.nan)
    for regression in regressions:
        solution = solutions[regression.rows, law.schema.states.index(regression.state)]
        squares = float(np.sum((regression.target - solution) ** 2)) if np.isfinite(solution).all() else np.inf
        if regression.evidence_against(squares) > VERY_STRONG:
            both = [100 * max(0.0, 1 - rss / regression.about_means) for rss in (squares, regression.squares)]
            where, state = equations[regression.state], regression.state
            result.append(note("discrete-time-plausible", where, state=state, by_law=both[0], by_regression=both[1]))
    return tuple(result)


_FACTORS = np.array(
    [
        factor**sign
        for sign in (1.0, -1.0)
        for factor in (*10.0 ** np.arange(1, 7), 60.0, 3600.0, 2.54, 9.81, 180 / np.pi)
    ]
)
"""Ratios between common units: powers of ten, minutes and hours in seconds, inches in centimetres, the acceleration of
gravity in m/s^2, and radians in degrees."""


KELVIN_OFFSET = 273.15
"""Kelvin at zero degrees Celsius."""

_TEMPERATURES = ("", "K", "kelvin", "C", "degC", "°C", "celsius", "degree_Celsius")


def outcomes_of_units(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return notes on objects that differ from all others by a factor between two units.

    There must be three objects. Kelvin differ from degrees Celsius by an offset, see `kelvin_offset`. Other units
    multiply the values of a column and their noise alike: both have a ratio near that factor, see `unit_ratio`, where
    the noise differs between objects. Other objects differ in either, but not in both by one factor. Of the parameters
    of objects without such a column there is a note for each such ratio.
    """
    if len(law.objects) < 3:
        return ()
    of_columns = (*_outcomes_of_columns(law, trials), *_outcomes_of_offsets(trials))
    return (*of_columns, *_outcomes_of_parameters(law, [outcome.where for outcome in of_columns]))


def _outcomes_of_columns(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return a note for each column whose values and noise differ in one object by the same factor."""
    errors, noise, schema = law.uncertainty.error_model, law.uncertainty.noise, law.observation.measured
    if not errors.by_object or noise is None:
        return ()
    levels = {name: errors.noise_of(name, noise) for name in law.objects}
    left_out = (*schema.logarithmic, *schema.initial_values)
    columns = ((name, j) for j, name in enumerate(schema.states) if name not in left_out)
    ratios = [(name, ratio) for name, j in columns if (ratio := column_in_other_units(trials, j, levels))]
    return tuple(
        note(
            "column-in-other-units",
            law.objects[of_one.object],
            column=name,
            ratio=of_one.ratio,
            factors=of_one.in_words,
        )
        for name, of_one in ratios
    )


def _outcomes_of_offsets(trials: Trials) -> Iterator[Outcome]:
    """Yield a note for each column that is in kelvin in one object and in degrees Celsius in others, or vice versa."""
    for j, column in enumerate(trials.schema.states):
        groups = [np.concatenate([trial.states[:, j] for trial in trials.of_object(name)]) for name in trials.objects]
        for o, name in enumerate(trials.objects):
            others = np.concatenate([*groups[:o], *groups[o + 1 :]])
            if offset := kelvin_offset(groups[o], others, trials.schema.units.get(column, "")):
                yield note("column-with-offset", name, column=column, offset=offset)


def kelvin_offset(values: Floats, others: Floats, unit: str) -> float:
    """Return by how much values of an object exceed those of others in another unit of temperature, zero if not.

    The values lie apart from the range of the others, which is less than half of this offset, and their median less
    the offset lies within it. The unit of both is one of temperature, or is not known.
    """
    seen, others = values[np.isfinite(values)], others[np.isfinite(others)]
    if not (len(seen) and len(others)) or unit not in _TEMPERATURES or 2 * np.ptp(others) >= KELVIN_OFFSET:
        return 0.0
    low, high = others.min(), others.max()
    offset = KELVIN_OFFSET if seen.min() > high else -KELVIN_OFFSET if seen.max() < low else 0.0
    return offset if low <= np.median(seen) - offset <= high else 0.0


class UnitRatio(NamedTuple):
    """An object, by index, its ratio to all others, and the factors between two units that it may be, nearest first."""

    object: int
    ratio: float
    factors: list[float]

    @property
    def in_words(self) -> str:
        """The factors."""
        return " or ".join(f"{factor:.4g}" for factor in self.factors)


def column_in_other_units(trials: Trials, column: int, noise: Mapping[str, Floats]) -> UnitRatio | None:
    """Return the object whose values and noise of a state differ from those of all others by the same factors.

    `noise` is that of the states of each object to compare, shape (states,); the index is that of an object in it.
    """
    groups = [np.concatenate([trial.states[:, column] for trial in trials.of_object(name)]) for name in noise]
    seen = [group[np.isfinite(group)] for group in groups]
    levels = np.array([level[column] for level in noise.values()])
    if not all(len(values) and values.any() for values in seen) or not np.all(levels > 0):
        return None
    sizes = np.log([float(np.mean(values**2)) for values in seen]) / 2
    of_noise = unit_ratio(np.log(levels), np.array([(2 * len(values)) ** -0.5 for values in seen]))
    of_values = unit_ratio(sizes, np.zeros(len(seen)))
    if of_noise is None or of_values is None or of_noise.object != of_values.object:
        return None
    factors = [factor for factor in of_values.factors if factor in of_noise.factors]
    return of_values._replace(factors=factors) if factors else None


def unit_ratio(logarithms: Floats, errors: Floats) -> UnitRatio | None:
    """Return the object that differs from all others by a factor between two units; None if there is none.

    The ratio to the geometric mean of the others has a logarithm that exceeds three times the range of theirs, and lies
    within that range, and two standard errors, of a factor's; within a tenth of the factor's, of an inch, as objects
    differ so much.
    """
    o = int(np.argmax(np.abs(logarithms - np.median(logarithms))))
    others = np.delete(logarithms, o)
    ratio, tolerance = float(logarithms[o] - others.mean()), float(np.ptp(others)) + SIGNIFICANT * float(errors[o])
    if abs(ratio) <= 3 * tolerance:
        return None
    distances, sizes = np.abs(ratio - np.log(_FACTORS)), np.abs(np.log(_FACTORS))
    is_near = (distances <= tolerance) & ((sizes > np.log(9)) | (tolerance <= 0.1 * sizes))
    factors = [float(_FACTORS[i]) for i in np.argsort(distances, kind="stable") if is_near[i]]
    return UnitRatio(o, float(np.exp(ratio)), factors) if factors else None


def _outcomes_of_parameters(law: Law, noted: Sequence[str]) -> tuple[Outcome, ...]:
    """Return a note for each parameter by which one object, if it was not noted before, differs from all others."""
    parameters, result = named_parameters(law), list[Outcome]()
    for p, name in enumerate(parameters.names):
        values, errors = parameters.values[:, p], parameters.errors[:, p]
        if not (np.isfinite(values).all() and (np.all(values > 0) or np.all(values < 0))):
            continue
        ratio = unit_ratio(np.log(np.abs(values)), np.nan_to_num(errors / np.abs(values)))
        if ratio:
            at, factor = law.objects[ratio.object], ratio.factors[0]
            if at not in noted:
                result.append(note("object-in-other-units", name=name, object=at, ratio=ratio.ratio, factor=factor))
    return tuple(result)


def outcomes_of_inputs(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return a note if inputs in the equations stay at levels and others do not, as all have one interpolation.

    So do inputs that jump between samples, at times that solutions from a start take for known.
    """
    variables = law.terms.variables.names
    columns = {column for k in np.flatnonzero(law.support.any(axis=0)) for column in law.terms.terms[k].columns()}
    used = {re.sub(r"\(t - \w+\)$", "", variables[column]) for column in columns}
    takes_rows = fit_of(law).takes_rows_of_inputs
    if not takes_rows:
        trials = trials.with_trials([trial.measured() for trial in trials])
    varying = {name: stays for name, stays in stay_at_levels(trials).items() if name in used}
    levels, rest = ([name for name, stays in varying.items() if stays is wanted] for wanted in (True, False))
    between = law.observation.measured.input_interpolation
    if between == "jumps":
        if not takes_rows:
            return ()
        jumping = np.any([jumps(trial.times, trial.inputs).any(axis=0) for trial in trials], axis=0)
        names = [name for name, jump in zip(trials.schema.inputs, jumping, strict=True) if jump and name in used]
        return (note("inputs-jump", inputs=names),) if names else ()
    columns_of_levels = [trials.schema.inputs.index(name) for name in levels]
    if trials.schema.doses or not rest or not any(_steps_slowly(trial, columns_of_levels) for trial in trials):
        return ()
    code = "inputs-interpolated-together" if takes_rows else "inputs-interpolated-together-in-collocation"
    return (note(code, levels=levels, rest=rest, between=between),)


def _steps_slowly(trial: Trial, columns: Sequence[int]) -> bool:
    """Return whether one of these inputs changes over a step in time of more than a tenth of the median one."""
    steps, changes = np.diff(trial.times), np.diff(trial.inputs[:, columns], axis=0).any(axis=1)
    return bool(np.any(steps[changes] > 0.1 * np.median(steps)))


def outcomes_of_separate_states(law: Law) -> tuple[Outcome, ...]:
    """Return a note if states of one unit have the same terms, each of itself alone, as columns of objects have."""
    schema, rates = law.schema, dict(state_rates(law))
    units = {schema.units.get(name) for name in schema.states}
    if len(schema.states) < 2 or len(units) > 1 or units == {None} or len(law.objects) > 1:
        return ()
    forms = set[frozenset[str]]()
    for name, support in zip(schema.states, law.support, strict=True):
        variables = {law.terms.variables.states.index(variable): variable for variable in (name, rates.get(name, name))}
        terms = [law.terms.terms[k] for k in np.flatnonzero(support)]
        used = {column for term in terms for column in term.columns() if column < len(law.terms.variables.states)}
        if not used or not used <= variables.keys():
            return ()
        form = [law.terms.names[k] for k in np.flatnonzero(support)]
        for placeholder, variable in zip("xv", dict.fromkeys(variables.values()), strict=False):
            form = [re.sub(rf"(?<!\w){re.escape(variable)}(?!\w)", f"{{{placeholder}}}", text) for text in form]
        forms.add(frozenset(text.replace("({x})", "{x}") for text in form))
    return (note("states-separate", states=schema.states),) if len(forms) == 1 else ()


class _Regression(NamedTuple):
    """A regression of the next samples of a state, shape (n,), with its residual sum of squares and that of means."""

    state: str
    rows: Bools
    target: Floats
    coefficients: int
    squares: float
    about_means: float

    def evidence_against(self, squares: float) -> float:
        """Return twice the log Bayes factor for the regression against a model with this residual sum of squares."""
        count, rounding = len(self.target), np.finfo(float).eps ** 2 * self.about_means
        ratio = (squares + rounding) / (self.squares + rounding)
        return float(count * np.log(ratio) - self.coefficients * np.log(count))


def _regressions(trials: Trials) -> Iterator[_Regression]:
    """Yield regressions of states that samples do not resolve, if their evidence against means is very strong."""
    terms = PolynomialLibrary(2, constant=False).bind(law_variables(trials.schema, 0))
    samples = [np.column_stack([trial.states, trial.inputs, trial.times]) for trial in trials]
    present, following = (np.concatenate([sample[part] for sample in samples]) for part in (slice(-1), slice(1, None)))
    objects = np.repeat([trials.objects.index(trial.object) for trial in trials], [len(trial) - 1 for trial in trials])
    for j, state in enumerate(trials.schema.states):
        rows = np.isfinite(present).all(axis=1) & np.isfinite(following[:, j])
        now, target = present[rows], following[rows, j]
        varied = _about_means(target[:, np.newaxis], objects[rows])[:, 0]
        about_means = float(varied @ varied)
        if len(target) <= len(terms) + len(trials.objects) or not 0 < about_means <= np.sum((target - now[:, j]) ** 2):
            continue
        matrix = _about_means(terms.evaluate(now), objects[rows])
        norms = np.linalg.norm(matrix, axis=0)
        matrix = matrix / np.where(norms > 0, norms, 1.0)
        coefficients, _, rank, _ = np.linalg.lstsq(matrix, varied, rcond=None)
        residuals = varied - matrix @ coefficients
        regression = _Regression(state, rows, target, int(rank), float(residuals @ residuals), about_means)
        if regression.evidence_against(about_means) > VERY_STRONG:
            yield regression


def _about_means(values: Floats, objects: Indices) -> Floats:
    counts = np.maximum(np.bincount(objects), 1)
    means = [np.bincount(objects, column) / counts for column in values.T]
    return values - np.column_stack(means)[objects]


def confounded_variables(
    trials: Trials, order: int | None = None, library: LibraryGiven | None = None
) -> tuple[Finding, ...]:
    """Return the confounded variables of trials, see `Trials.check`.

    Raises `CommonlawError` if the order does not exist, or the library does not match the variables.
    """
    order = (2 if len(trials.schema.states) == 1 else 1) if order is None else order
    if order not in (0, 1, 2):
        raise CommonlawError("order-unsupported", order=order)
    if order == 0:
        return ()
    asked, _ = without_measured_rates(trials, trials.schema.states if order == 2 else ())
    given = None if library is None else parse_library(library)
    asked = with_properties_in([given] if given else [], asked)
    noted = [(confounded, _note(confounded, asked, order)) for confounded in confounded_sets(asked, order, given)]
    return tuple(
        Finding(f"{note.where}: {note.text}; {note.remedy}", column=confounded.state) for confounded, note in noted
    )


def outcomes_of_confounding(trials: Trials, order: Order, library: AbstractLibrary) -> tuple[Outcome, ...]:
    """Return notes on variables that the training trials confound."""
    return tuple(
        _note(confounded, trials, order) for confounded in (confounded_sets(trials, order, library) if order else ())
    )


def _note(found: ConfoundedVariables, trials: Trials, order: Order, listed: int = 4) -> Outcome:
    """Return the note on a set of confounded variables, of which as many subsets as are `listed` are named."""
    states = trials.schema.states
    varying = ", with coefficients by trial," if found.by_trial else ""
    rms = " or ".join(f"{value:.3g}" for value in found.rms[:listed])
    cause, units = "", {name: f" {trials.schema.units.get(name, '')}".rstrip() for name in states}
    widths = {name: high - low for name, (low, high) in found.visited.items()}
    if all(high - low <= _MAX_EXCESS_SHARE * widths[name] for name, (low, high) in found.starts.items()):
        ranges = [  # Of what was measured: rates are too uncertain at the start
            f"{name} = {low:.3g} to {high:.3g}{units[name]}"
            for name, (low, high) in found.starts.items()
            if name in states
        ]
        where = f", at {_and(ranges)}" if ranges else ""
        cause = f", because all trials have similar initial conditions{where}"
    *first, last = (f"{subset[0]} alone" if len(subset) == 1 else _and(subset) for subset in found.sets[:listed])
    more = f", or {len(found.sets) - listed} other sets" if len(found.sets) > listed else ""
    return note(
        "confounded",
        left_hand_sides(states, order)[states.index(found.state)],
        variables=_and(list(found.starts)),
        cause=cause,
        alternatives=f"{', '.join(first)}{',' if more else ' or'} {last}{more}{varying}",
        residuals=rms,
        residual=found.rms_of_all,
        unit=units[found.state],
        first=next(iter(found.starts)),
    )


def _and(parts: Sequence[str]) -> str:
    """Return words with commas between them, and ``and`` before the last."""
    *first, last = parts
    return f"{', '.join(first)} and {last}" if first else last


def law_under_errors(chosen: Fitted, white: Fitted, calls: tuple[str, ...]) -> Law:
    """Return the law of a fit by shooting, whose history says what errors in place of white noise changed."""
    law = chosen.law(calls)
    if chosen is white:
        return law
    history = (*law.history, misfit_step_of(chosen, white))
    law = replace(law, provenance=replace(law.provenance, history=history))
    return with_change_by_errors(law, lambda: white.law(()))


def with_change_by_errors(law: Law, under_white_noise: Callable[[], Law]) -> Law:
    """Return a law whose history says what the errors that were chosen in place of white noise change, if any."""
    if not (law.uncertainty.error_model and named_parameters(law).names):
        return law
    try:
        changed = largest_change(law, under_white_noise(), "under white noise")
    except CommonlawError as error:
        changed = f"under white noise: {error.sentence(marked)}"
    steps = [
        replace(step, reason=f"{step.reason}; {changed}") if step.stage == MISFIT else step for step in law.history
    ]
    return replace(law, provenance=replace(law.provenance, history=tuple(steps)))
