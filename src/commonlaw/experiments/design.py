"""Which experiment next: the most informative one among those that can be made."""

from collections.abc import Mapping, Sequence

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.experiments.aims import COEFFICIENTS, LAW, Aim, coefficients
from commonlaw.experiments.experiment import (
    Options,
    Range,
    Settings,
    check_amount,
    given_starts,
    numbers_of,
    read,
    rounded_to,
)
from commonlaw.experiments.plan import Design, Forecasts, Gain, Planned
from commonlaw.experiments.predictive import Hypothesis
from commonlaw.experiments.search import POINTS, SETTLED, Effort, Search
from commonlaw.law import Law, PlausibleLaw
from commonlaw.law.alignment import matched
from commonlaw.law.parameters import named_parameters, state_rates
from commonlaw.law.provenance import Domain
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.progress import ProgressCallback, on_terminal
from commonlaw.trials import Trials


def design(
    law: Law | Sequence[Law],
    vary: Mapping[str, object] | None = None,
    *,
    trials: Trials | None = None,
    within: Mapping[str, object] | None = None,
    start_std: Mapping[str, float] | None = None,
    cost: Mapping[str, float] | None = None,
    budget: float = np.inf,
    experiments: int = 1,
    about: str | None = None,
    seed: int = 0,
    points: int = POINTS,
    progress: ProgressCallback | None = None,
) -> Design:
    """Return the experiments of largest expected information for their cost (Bayesian optimal design).

    Each plausible law predicts the measured quantities with the errors of its coefficients, of the measurements and of
    the law. The expected information is averaged over the laws (Lindley 1956; Box and Hill 1967), each linearized about
    its coefficients; for the most discriminating experiments it is simulated, with all laws refitted. Predictions of a
    law with observation equations have the derivatives by its parameters p and initial values, dy/dp = dh/dx dx/dp +
    dh/dp.

    Raises `CommonlawError` if a law has no noise or covariance, or only a limit of a parameter, laws do not match, a
    setting is unknown, or no experiment is within the budget.

    Parameters
    ----------
    law
        A law with its plausible alternatives, `Law.models`; or several equally probable laws of the same objects.
    vary
        What can be set, by name. A pair or text ``"5..60"`` is a range, a list gives choices, one value is fixed. Names
        are the states and rates where trials start; ``duration``; ``rate``, ``samples`` or ``times`` (lists of sample
        times); ``repeats``; ``object``, names of objects or ``"each"``; ``object.mass``, properties of a new object,
        where `Law.explain` found relations; and inputs: ``u`` is the level, ``u.shape`` of constant, step, ramp, sine
        and square, ``u.period`` the period of the last two. A dose of amount ``u`` is given at ``u.at`` after the first
        sample (default 0), and again after every ``u.every``.
    trials
        Trials that give the defaults of settings not in `vary`: initial conditions, duration and number of samples.
    within
        Ranges of states and rates, such as ``{"x": "0..100"}``: a trial ends where the most probable law leaves them.
        With `trials` the default is their range.
    start_std
        Standard deviation of a trial's initial condition about its setting, by state or rate: 0 where it is exact,
        ``{"x": 0.005, "v": 0}``. All others are estimated from the measurements.
    cost
        Cost of a ``trial``, a ``sample``, a unit of any setting, and a trial of an object by name. Default: 1 for each
        trial.
    budget
        The largest total cost.
    experiments
        Maximum number; each is chosen given those before it, then exchanged for better ones. Fewer if the true law is
        identified with probability 0.95.
    about
        ``"law"``, the default if the law is in doubt; ``"coefficients"``, all together (D-optimality); one of them,
        ``"c"`` or ``"c of Ball 3"``; or a forecast, ``"x at t=10 from 100, 0"``, perhaps of one object.
    seed
        Seed of the random numbers.
    points
        Number of candidate experiments within the ranges, besides their corners.
    progress
        Called with the text of each step.

    Returns
    -------
    Design
        The experiments; prints as text.

    See Also
    --------
    bounds : Limits of coefficients of absent terms.
    commonlaw.plots.plot_design

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(drag=(-0.3, -0.5), noise=0.5, samples=30)
    >>> laws = [cl.fit(text, drops) for text in ("x'' = -g - c v", "x'' = -g + b v^2")]
    >>> found = cl.design(laws, {"x": 50, "v": 0, "duration": "1..4", "rate": 5})
    >>> found.chance > found.chance_now
    True
    """
    arguments = locals()
    if vary is not None and not isinstance(vary, Mapping):
        raise CommonlawError("design-trials-by-name")
    # Laws and amounts in lists and mappings are checked by name below
    inside = [name for name in ("law", "start_std", "cost") if isinstance(arguments[name], Mapping | Sequence)]
    check_types(design, {name: value for name, value in arguments.items() if name not in inside})
    if experiments < 1:
        raise CommonlawError("design-count", count=experiments)
    laws = [law] if isinstance(law, Law) else list(law)
    if not laws or not all(isinstance(model, Law) for model in laws):
        raise CommonlawError("design-without-laws")
    if any(_setting_of(model) != _setting_of(laws[0]) for model in laws[1:]):
        raise CommonlawError("design-different-laws")
    share = 1 / len(laws)
    models = [model for candidate in laws for model in candidate.models]
    plausible = tuple(PlausibleLaw(share * model.probability, model.law) for model in models)
    first, prior = plausible[0].law, np.array([model.probability for model in plausible])
    settings = Settings.of(first, vary or {}, usual(first, trials) if trials is not None else {})
    unit_costs = {"trial": 1.0} if cost is None else cost
    chargeable = [name for name in settings.options if name not in ("object", "times", "repeats")]
    chargeable = ["trial", "sample", "duration", *chargeable, *first.objects]
    for name, unit_cost in unit_costs.items():
        if name not in chargeable:
            raise unknown("price", name, dict.fromkeys(chargeable))
        check_amount(f"the price of {name} is", unit_cost)
    hypotheses = tuple(Hypothesis.of(model.law, settings.objects) for model in plausible)
    aim = Aim.of(about, prior, hypotheses)
    known = start_std or {}
    for name, value in known.items():
        check_choice("state", name, first.terms.variables.states)
        check_amount(f"the start of {name} is off by", value)
    limits = dict[str, Range]()
    for name, wanted in (within or {}).items():
        check_choice("state", name, first.terms.variables.states)
        if not isinstance(limit := read(name, wanted), Range):
            raise CommonlawError("design-range", name=name, value=wanted)
        limits[name] = limit
    if trials is not None:
        visited = first.provenance.domain.visited or Domain.of(trials, state_rates(first)).visited
        ranges = dict[str, Range]()
        for name in first.schema.states:
            values = [*visited.get(name, ()), *numbers_of(settings.options.get(name, ()))]
            if name in visited and min(values) < max(values):
                ranges[name] = Range(min(values), max(values))
        limits = ranges | limits
    search = Search(first, hypotheses, aim, settings, limits, unit_costs, known, seed, points)
    return _designed(search, plausible, experiments, budget, on_terminal() if progress is None else progress)


def _designed(
    search: Search, plausible: tuple[PlausibleLaw[Law], ...], most: int, budget: float, progress: ProgressCallback
) -> Design:
    """Return up to so many of the best experiments of a search, and what is to be expected of them; see `design`."""
    first, hypotheses, aim = search.law, search.hypotheses, search.aim
    prior = np.array([model.probability for model in plausible])
    chosen = search.chosen(most, budget, progress)
    steps = [search.evidence(chosen[: i + 1]) for i in range(len(chosen))]
    repeats = search.repeats(chosen) if aim.of_law else None
    units = [unit or "" for unit in named_parameters(first).units for _ in hypotheses[0].objects]
    gains = [
        Gain(coefficient.name, unit, coefficient.std(prior), coefficient.expected_std(prior, steps[-1]))
        for coefficient, unit in zip(coefficients(hypotheses), units, strict=True)
    ]
    return Design(
        plausible,
        tuple(
            Planned(
                candidate.experiment,
                candidate.experiment.described(first),
                evidence.chance(prior) if len(plausible) > 1 else 1.0,
                aim.bits(evidence),
                aim.quantity.expected_std(prior, evidence) if aim.quantity else None,
                Forecasts.of(candidate.experiment, hypotheses),
            )
            for candidate, evidence in zip(chosen, steps, strict=True)
        ),
        repeats,
        search.limit(chosen) if aim.of_law and repeats is None else None,
        aim,
        tuple(sorted(gains, key=lambda gain: gain.then / gain.now if gain.now > 0 else 1.0)),
    )


def usual(law: Law, trials: Trials) -> dict[str, Options]:
    """Return how experiments were made: where trials start, how long they take, how many samples they have.

    Starts are those of fitted solutions, but not across zero from measurements of one sign, such as concentrations.
    """
    followed = law.predict(trials, start="all", averaged=False)
    trials, schema, given = matched(law, trials), law.observation.measured, given_starts(law)
    courses = followed.solutions
    starts = np.array([states[0] for states in courses])
    measured = np.concatenate([trial.states for trial in trials])
    result: dict[str, Options] = {}
    rates = [rate for _, rate in state_rates(law)]
    for j, name in enumerate(law.terms.variables.states):
        spread = max(np.ptp(states[:, j]) for states in courses)
        # Rates that begin below a fiftieth of their later range are zero: the objects are let go
        if name in rates and np.abs(starts[:, j]).max() < 0.02 * spread and name not in given:
            result[name] = (0.0,)
        elif name not in given:
            values = measured[:, trials.schema.states.index(name)] if name in trials.schema.states else np.empty(0)
            values = values[np.isfinite(values)]
            low = 0.0 if len(values) and values.min() >= 0 else -np.inf
            high = 0.0 if len(values) and values.max() <= 0 else np.inf
            result[name] = _between(np.clip(starts[:, j], low, high))
    for j, name in enumerate(schema.inputs):
        if not schema.doses:
            result[name] = _between(np.array([trial.inputs.mean(axis=0)[j] for trial in trials]))
            continue
        # Doses stand in trials as large inputs for a moment
        dosed = [(trial, np.flatnonzero(trial.inputs[:, j])) for trial in trials]
        pulses = [(trial, given) for trial, given in dosed if len(given)]
        amounts = [trial.inputs[i, j] * (trial.times[i] - trial.times[i - 1]) for trial, given in pulses for i in given]
        result[name] = _between(np.array(amounts)) if amounts else (0.0,)
        if pulses:
            firsts = [trial.times[given[0] - 1] - trial.times[0] for trial, given in pulses]
            result[f"{name}.at"] = (float(np.median(firsts)),)
    result["duration"] = (float(np.median([trial.times[-1] - trial.times[0] for trial in trials])),)
    result["samples"] = (float(np.median([len(trial.measured()) for trial in trials])),)
    return result


def _between(values: Floats) -> Options:
    """Return the range of numbers, its ends rounded, or the only number."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if not low < high:
        return (low,)
    first, last = (rounded_to(end, (high - low) / 10) for end in (low, high))
    return Range(first if first * low > 0 else low, last if last * high > 0 else high)


def _setting_of(law: Law) -> tuple[object, ...]:
    """Return what laws of the same experiments have in common: variables, what is measured and what is set."""
    measured, variables = law.observation.measured, law.terms.variables
    names = (variables.states, measured.inputs, variables.time, measured.measured, measured.logarithmic)
    return *names, law.objects, given_starts(law)


_LITTLE_EFFORT = Effort(8, 8, 32, patience=2)
"""Of suggestions: an experiment is looked at by 8 simulated measurements, and reported by 32."""
_MIN_POINTS, _MAX_TRAJECTORIES, _MAX_REFITS = 16, 500, 350
"""Of suggestions: experiments, trajectories of all laws, and refits for an experiment that is looked at; a trajectory
takes about a millisecond, and a refit two."""


def suggestions(law: Law, trials: Trials, most: int = 1) -> dict[str, Design]:
    """Return what to measure next by purpose: the law if it is in doubt, all coefficients, the worst one.

    Trials start in the visited ranges, with rates, inputs, duration and samples as in the given trials, and end where
    they leave what was visited. All experiments for a purpose have at most `most` trials. Work is bounded: few
    experiments are compared, and laws refitted to few simulated measurements, to none where laws and objects are many.
    Laws without noise or covariance, or with only a limit of a parameter, and laws in discrete time, have no
    suggestions.
    """
    is_limited = any(model.law.uncertainty.limits for model in law.models)
    if not law.uncertainty.has_std or is_limited or law.order == 0 or not law.support.any():
        return {}
    visited = law.provenance.domain.visited or Domain.of(trials, state_rates(law)).visited
    spans = {name: Range(*visited[name]) for name in law.schema.states if name in visited and np.ptp(visited[name]) > 0}
    vary: dict[str, Options] = {**usual(law, trials), **spans}
    result = dict[str, Design]()
    purposes = [("To find out which law is right", LAW)] if law.models[0].probability < SETTLED else []
    purposes.append(("To know all coefficients better", COEFFICIENTS))
    parameters = named_parameters(law)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(parameters.errors > 0, parameters.errors / np.abs(parameters.values), 0.0)
    if relative.size > 1 and np.nanmax(relative) > 0:
        owner, column = np.unravel_index(int(np.nanargmax(relative)), relative.shape)
        name = parameters.names[int(column)]
        about = name if len(law.objects) == 1 else f"{name} of {law.objects[int(owner)]}"
        purposes.append((f"To know {about} better, the coefficient that is known worst", about))
    plausible = tuple(law.models)
    settings = Settings.of(law, vary, {})
    hypotheses = tuple(Hypothesis.of(model.law, settings.objects) for model in plausible)
    trajectories = len(plausible) * len(settings.objects)
    points = max(_MIN_POINTS, min(POINTS // 4, _MAX_TRAJECTORIES // trajectories))
    refits = trajectories * max(len(plausible), _LITTLE_EFFORT.look)
    effort = _LITTLE_EFFORT if refits <= _MAX_REFITS else _LITTLE_EFFORT._replace(look=0)
    prior, over = np.array([model.probability for model in plausible]), None
    for purpose, about in purposes:
        aim = Aim.of(about, prior, hypotheses)
        over = Search(law, hypotheses, aim, settings, spans, {"trial": 1.0}, {}, 0, points, effort, over)
        try:
            result[purpose] = _designed(over, plausible, most, np.inf, lambda _: None)
        except CommonlawError:  # Forecasts may diverge from everywhere
            continue
    return result
