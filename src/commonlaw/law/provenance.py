"""How a law was found, and where it may be used."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product, zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Outcome, OutcomeKind
from commonlaw.differentiation import AbstractDifferentiator, RobustSpline
from commonlaw.errors import CommonlawError
from commonlaw.law.uncertainty import check_positive
from commonlaw.likelihood import ERRORS, ErrorModel
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.text import counted
from commonlaw.trials import Schema, Trial, Trials
from commonlaw.trials.transformations import natural
from commonlaw.trials.trial import property_names, value_range

if TYPE_CHECKING:
    import pandas as pd

WITHOUT_QUANTITIES = frozenset({OutcomeKind.NOT_CONVERGED, OutcomeKind.DIVERGED})
"""Of a fit: its coefficients describe no solution through the measurements, so no quantities derive from them."""

_BEYOND = 0.1
"""Share of a range that values may lie beyond it before it counts as left."""


@dataclass(frozen=True)
class Domain:
    """Where a law may be used.

    Parameters
    ----------
    visited
        The range of states, rates, inputs and properties in what it was learned from, by name.
    horizon, judged
        How far ahead its forecasts are reliable, with an error within half of the states' standard deviation, and how
        far was assessed; None if it was not.
    at_rest
        Objects that were left out, as nothing changed in their trials.
    constant
        States that were left out, as they stay constant within their noise in all trials.
    strange
        Objects that were left out, as they do not follow the law of the others.
    sizes
        The largest absolute value of each state and rate in the fitted solutions, where these are known.
    """

    visited: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    horizon: float | None = None
    judged: float | None = None
    at_rest: tuple[str, ...] = ()
    constant: tuple[str, ...] = ()
    strange: tuple[str, ...] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, size in self.sizes.items():
            check_positive(name, size)

    @classmethod
    def of(cls, trials: Trials, rates: Sequence[tuple[str, str]]) -> "Domain":
        """Return what trials have visited, latent states aside; of some states also the rates, named with them."""
        schema = trials.schema
        states = natural(np.concatenate([trial.states for trial in trials]), schema)
        inputs = np.concatenate([trial.inputs for trial in trials])
        columns = {
            name: column
            for name, column in zip(schema.states, states.T, strict=True)
            if name not in schema.initial_values
        }
        columns |= {
            name: column for name, column in zip(schema.inputs, inputs.T, strict=True) if name not in schema.doses
        }
        if rates:
            derivatives = np.concatenate([_rates(trial) for trial in trials])
            columns |= {rate: derivatives[:, schema.states.index(state)] for state, rate in rates}
        for name in property_names(trials.properties):
            values = [attribute[name] for attribute in trials.properties.values() if name in attribute]
            if isinstance(values[0], float):
                columns[name] = np.array(values)
        return cls({name: value_range(column) for name, column in columns.items()})

    def with_left_out(self, before: "Domain") -> "Domain":
        """Return this domain with the objects and states that an earlier law left out."""
        return replace(self, at_rest=before.at_rest, constant=before.constant, strange=before.strange)

    def to_frame(self, units: Mapping[str, str]) -> "pd.DataFrame":
        """Return a table of the visited ranges, with the units of their variables."""
        import pandas as pd

        rows = [(name, *ends, units.get(name, "")) for name, ends in self.visited.items()]
        return pd.DataFrame(rows, columns=["variable", "low", "high", "unit"])

    def horizon_sentence(self, unit: str) -> str:
        """Return how far ahead forecasts are good, in words, given the unit of time."""
        upto, farthest = (f"{value or 0.0:.3g} {unit}".rstrip() for value in (self.horizon, self.judged))
        return f"Reliable forecast horizon: {upto} (error below half a standard deviation; {farthest} tested)."

    def remarks(self, trials: Sequence[tuple[str, Mapping[str, Floats]]], unit: str, ahead: float) -> Iterator[str]:
        """Yield remarks on forecasts of trials, values of variables by name, that go so far `ahead` or leave it."""
        parts = []
        for name, (low, high) in self.visited.items():
            margin, beyond = max(_BEYOND * (high - low), 1e-9 * max(abs(low), abs(high))), dict[str, float]()
            for label, columns in trials:
                values = columns.get(name, np.empty(0))
                if len(values := values[np.isfinite(values)]):
                    least, largest = float(values.min()), float(values.max())
                    distance, farthest = max((low - least, least), (largest - high, largest))
                    beyond |= {label: farthest} if distance > margin else {}
            if beyond:
                where, farthest = next(iter(beyond.items()))
                where += f" and {len(beyond) - 1} more" if len(beyond) > 1 else ""
                parts.append(f"{name} reaches {farthest:.3g} in {where} (training range {low:.3g} to {high:.3g})")
        if parts:
            yield f"forecasts extrapolate beyond the training data and may be less accurate: {'; '.join(parts)}"
        if self.horizon is not None and ahead > (1 + _BEYOND) * self.horizon:
            reliable = f"{self.horizon:.3g} {unit}".rstrip() if self.horizon else "none"
            yield f"forecasts go {f'{ahead:.3g} {unit}'.rstrip()} ahead; reliable forecast horizon: {reliable}"


def _rates(trial: Trial) -> Floats:
    """Return the rates of all states at the samples, shape (n, states); of long trials, in twenty segments of 500."""
    result, segments = np.full(trial.states.shape, np.nan), [slice(len(trial))]
    if len(trial) > 20 * 500:  # Evenly spread
        segments = [slice(begin, begin + 500) for begin in np.linspace(0, len(trial) - 500, 20).astype(int)]
    for rows, j in product(segments, range(trial.states.shape[1])):
        column = trial.states[rows, j]
        seen = np.isfinite(column)
        times, values = trial.times[rows][seen], column[seen, np.newaxis]
        try:
            result[rows, j][seen] = RobustSpline().differentiate(times, values, 1).derivatives[0][:, 0]
        except CommonlawError:  # Too few samples for a smooth curve
            if len(times) > 1:
                result[rows, j][seen] = np.gradient(values[:, 0], times)
    return result


@dataclass(frozen=True)
class Alternative:
    """One of the candidates that an equation, named by its left-hand side, was chosen from.

    Parameters
    ----------
    measures
        Criteria, held-out error and its standard error, stability, by name; None where unknown.
    proven
        Whether no other support of its size fits better.
    chosen
        Whether it is the law.
    hyperparameters
        The values of the solver's hyperparameter at which its segments of the path begin; none if candidates of several
        solvers were compared.
    """

    equation: str
    terms: tuple[str, ...]
    measures: Mapping[str, float | None]
    proven: bool
    chosen: bool
    hyperparameters: tuple[float, ...] = ()


@dataclass(frozen=True)
class Step:
    """One choice on the way to a law.

    The stage is what was chosen, ``"noise"``; the choice its result, ``"x: 0.05 m"``; the reason has the numbers that
    decided.
    """

    stage: str
    choice: str
    reason: str


class History(ShownInNotebooks, tuple[Step, ...]):
    """Every choice on the way to a law, in order; it prints as a table.

    >>> print(History([Step("noise", "x: 0.05", "from differences of order 4")]))
    stage  choice   reason
    noise  x: 0.05  from differences of order 4
    """

    def __str__(self) -> str:
        if not self:
            return "no choices are on record"
        rows = [("stage", "choice", "reason"), *((step.stage, step.choice, step.reason) for step in self)]
        cells = [[textwrap.wrap(text, 60) or [""] for text in row] for row in rows]
        lines = [line for row in cells for line in zip_longest(*row, fillvalue="")]
        stages, choices, _ = (max(map(len, column)) for column in zip(*lines, strict=True))
        return "\n".join(f"{one:<{stages}}  {two:<{choices}}  {three}".rstrip() for one, two, three in lines)


@dataclass(frozen=True)
class Provenance:
    """Record of how a law was found: data range, candidates, choices and notes.

    Parameters
    ----------
    differentiation
        Differentiation method, also used for initial rates of forecasts; None if there was none or it is not known.
    outcomes
        Notes on the law, see `Law.diagnostics`.
    alternatives
        Candidates that the law was chosen from.
    history
        Choices of the search, in order.
    equations
        The equations as given, with their names of the parameters; None for a discovered law.
    calls
        Calls that made the law from ``trials``, as Python: ``cl.discover(trials, order=2)``; none if not known.
    domain
        Range of the training data, and reliable forecast horizon.
    log_likelihood
        Of the measurements, at the maximum, where it is known.
    searched
        Hash of the trials whose search was stopped, see `commonlaw.discover`; empty if none was.
    with_discrepancy
        The law with the discrepancy as further terms, if `Law.discrepancy` estimated these coefficients.
    """

    differentiation: AbstractDifferentiator | None = None
    outcomes: tuple[Outcome, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    history: tuple[Step, ...] = ()
    equations: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    domain: Domain = field(default_factory=Domain)
    log_likelihood: float | None = None
    searched: str = ""
    with_discrepancy: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "history", History(self.history))

    def path(self) -> "pd.DataFrame":
        """Return the equations that all values of the solver's hyperparameter give, in segments from the smallest.

        Each row holds from its threshold, penalty or number of terms to the next row's, with its measures; a candidate
        may come more than once.

        Raises `CommonlawError` if the law was not chosen from the path of one solver.
        """
        import pandas as pd

        rows = [
            {
                "equation": equation,
                "from": begin,
                "to": end,
                "terms": ", ".join(candidate.terms),
                "size": len(candidate.terms),
                **candidate.measures,
                "chosen": candidate.chosen,
            }
            for equation in dict.fromkeys(alternative.equation for alternative in self.alternatives)
            for begin, end, candidate in path_segments(
                [alternative for alternative in self.alternatives if alternative.equation == equation]
            )
        ]
        if not rows:
            raise CommonlawError("path-unknown")
        return pd.DataFrame(rows)

    @property
    def is_stopped(self) -> bool:
        """Whether the search for the law was ended before it had tried everything."""
        return any(outcome.kind is OutcomeKind.STOPPED for outcome in self.outcomes)

    @property
    def is_learned(self) -> bool:
        """Whether anything is on record of how the law was learned from trials: it may have been given as it is."""
        return bool(self.history or self.calls or self.alternatives or self.outcomes or self.differentiation)


def path_segments(alternatives: Sequence[Alternative]) -> Iterator[tuple[float, float, Alternative]]:
    """Yield where each segment of a solver's path begins and ends (the last has no end), and its candidate."""
    begins = sorted((value, i) for i, alternative in enumerate(alternatives) for value in alternative.hyperparameters)
    turns = [pair for k, pair in enumerate(begins) if k == 0 or begins[k - 1][1] != pair[1]]
    ends = [*(begin for begin, _ in turns[1:]), math.inf]
    for (begin, i), end in zip(turns, ends, strict=False):
        yield begin, end, alternatives[i]


def levels_in_words(levels: Floats, schema: Schema) -> str:
    """Return the levels of errors of measurements in words, of each state that has any."""
    return ", ".join(
        f"{name}: {100 * level:.3g} % of it, on a logarithmic scale"
        if name in schema.logarithmic
        else f"{name}: {level:.3g} {schema.units.get(name, '')}".rstrip()
        for name, level in zip(schema.states, levels, strict=True)
        if name not in schema.initial_values
    )


def levels_by_group(errors: ErrorModel, noise: Floats, schema: Schema) -> str:
    """Return the noise of each object, or trial, in words, of eight at most, given that of all, shape (states,)."""
    factors = errors.by_trial or errors.by_object
    levels = [f"{group}, {levels_in_words(noise * factor, schema)}" for group, factor in [*factors.items()][:8]]
    return "; ".join([*levels, *(["..."] if len(factors) > 8 else [])])


def error_steps(
    errors: ErrorModel, noise: Floats, schema: Schema, why: str, outliers: int, threshold: float
) -> list[Step]:
    """Return how many measurements are outliers, and levels of errors besides white noise, of states of a schema."""
    how = "have no weight" if ERRORS[errors.kind].is_independent else "count linearly instead of squared"
    beyond = f"beyond {threshold:g} standard deviations; they {how}"
    result = [Step("outliers", counted(outliers, "measurement"), beyond)] if outliers else []
    grown = errors.heteroscedastic_in_words(schema.states)
    result += [Step(ERRORS[kind].label, levels, why) for kind, levels in grown.items()]
    if errors.by_object:
        levels = levels_by_group(errors, noise, schema)
        result.append(Step(ERRORS[errors.grouping].label, levels, why))
    if errors.correlated is not None:
        time = f"{errors.memory:.3g} {schema.units.get(schema.time, '')}".rstrip()
        levels = levels_in_words(errors.correlated, schema)
        result.append(Step("autocorrelated errors", f"{levels}; of {time}", why))
    if errors.sensor_walk is not None:
        time = schema.units.get(schema.time, "unit of time")
        result.append(
            Step("random walk of the sensor", f"{levels_in_words(errors.sensor_walk, schema)} per root of {time}", why)
        )
    if errors.offset is not None and errors.slope is not None:
        offsets, slopes = levels_in_words(errors.offset, schema), levels_in_words(errors.slope, schema)
        time = schema.units.get(schema.time, "unit of time")
        mean = "" if errors.trend is None else f", about a mean of {levels_in_words(errors.trend, schema)}"
        result.append(Step("drift of the sensor", f"at first {offsets}; then {slopes} per {time}{mean}", why))
    return result
