"""What there is to know about trials before they are used."""

import hashlib
import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.trial import Schema, Trial, TrialData

if TYPE_CHECKING:
    import pandas as pd

_MIN_SAMPLES = 5  # fewer leave nothing to judge a rate by


@dataclass(frozen=True)
class TrialCheck:
    """Summary of one trial.

    Parameters
    ----------
    duration
        Time from the first sample to the last.
    median_step, largest_deviation
        The median step between samples, and the largest deviation from it, zero if that is rounding; None for a single
        sample.
    clipped
        Number of samples at the end that `clip_irregular` would remove.
    first, last
        First and last measured values by state; None for a state that never was measured.
    missing
        The number of samples without a measurement, by state.
    """

    object: str
    trial: str
    samples: int
    duration: float
    median_step: float | None
    largest_deviation: float | None
    clipped: int
    first: dict[str, float | None]
    last: dict[str, float | None]
    missing: dict[str, int]


@dataclass(frozen=True)
class Finding:
    """What a data check found: a sentence; and if it is in one place the trial, the sample from 0, and the column."""

    text: str
    object: str | None = None
    trial: str | None = None
    sample: int | None = None
    column: str | None = None

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Report:
    """Result of `Trials.check`: a summary of each trial, the findings, and notes on the data."""

    trials: tuple[TrialCheck, ...]
    found: tuple[Finding, ...]
    notes: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(map(str, self.found))

    def kinds(self) -> dict[str, tuple[Finding, ...]]:
        """Return findings of the same kind together by a line: up to three cases, or their number and one of them."""
        kinds: dict[str, list[Finding]] = {}
        for finding in self.found:
            kinds.setdefault(re.sub(r"^.*?: |(?<!\w)-?\d[\d.e+-]*", "", finding.text), []).append(finding)
        lines: dict[str, tuple[Finding, ...]] = {}
        for same in kinds.values():
            if len(same) <= 3:
                lines |= {finding.text: (finding,) for finding in same}
            else:
                lines[f"in {len(same)} cases, such as {same[0]}"] = tuple(same)
        return lines

    def lines(self) -> tuple[str, ...]:
        """Return the findings; more than three of the same kind are counted, with one example."""
        return tuple(self.kinds())

    def to_frame(self) -> "pd.DataFrame":
        """Return a frame with a row for each trial, and columns such as ``height (first)`` and ``height (missing)``."""
        import pandas as pd

        rows, gaps = [], any(count for trial in self.trials for count in trial.missing.values())
        for trial in self.trials:
            row = asdict(trial)
            if not gaps:
                del row["missing"]
            for kind in ("first", "last", *(["missing"] * gaps)):
                row |= {f"{name} ({kind})": value for name, value in row.pop(kind).items()}
            rows.append(row)
        return pd.DataFrame(rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON-compatible values."""
        held = asdict(self)
        return {"trials": held["trials"], "findings": self.findings, "notes": held["notes"]}


def check(data: TrialData, tolerance: float | None) -> Report:
    """Return figures of every trial and what data checks find, see `Trials.check`."""
    trials, schema = data.trials, data.schema
    rows = tuple(_figures(trial, schema.states, tolerance) for trial in trials)
    findings = (
        finding
        for trial, row in zip(trials, rows, strict=True)
        for finding in (*_sampling(trial, row, schema, tolerance), *_values(trial, schema, len(trial) - row.clipped))
    )
    lengths: dict[str, list[int]] = {}
    for trial in trials:
        lengths.setdefault(trial.object, []).append(len(trial))
    uneven = [
        Finding(f"{name}: trials of very different lengths, {min(length)} to {max(length)} samples", name)
        for name, length in lengths.items()
        if max(length) >= 2 * min(length)
    ]
    copies = [
        _in(trial, f"an exact copy of {before.label}, which adds no information")
        for trial, before in exact_copies(trials)
    ]
    bare = ", ".join(name for name in (schema.time, *schema.states, *schema.inputs) if name not in schema.units)
    text = f"no unit is known for {bare}: write it in the header, as in 'x [m]', or give it with `units=...`"
    return Report(rows, (*findings, *uneven, *copies, *([Finding(text)] if bare else [])), data.notes)


def _unit(schema: Schema, name: str) -> str:
    return f" {schema.units[name]}" if name in schema.units else ""


def _in(trial: Trial, text: str, sample: int | None = None, column: str | None = None) -> Finding:
    return Finding(f"{trial.label}: {text}", trial.object, trial.name, sample, column)


def _figures(trial: Trial, names: tuple[str, ...], tolerance: float | None) -> TrialCheck:
    steps, median, deviation = np.diff(trial.times), None, None
    if len(steps):
        median = float(np.median(steps))
        deviation = float(np.abs(steps - median).max())
        deviation = deviation if deviation > 1e-9 * median else 0.0  # Less is rounding
    measured = {name: column[~np.isnan(column)] for name, column in zip(names, trial.states.T, strict=True)}
    return TrialCheck(
        trial.object,
        trial.name,
        len(trial),
        float(trial.times[-1] - trial.times[0]),
        median,
        deviation,
        len(trial) - regular_length(trial.times, tolerance),
        {name: float(values[0]) if len(values) else None for name, values in measured.items()},
        {name: float(values[-1]) if len(values) else None for name, values in measured.items()},
        {name: len(trial) - len(values) for name, values in measured.items()},
    )


def _sampling(trial: Trial, row: TrialCheck, schema: Schema, tolerance: float | None) -> Iterator[Finding]:
    """Yield findings about a trial's length, steps and gaps."""
    if row.samples < _MIN_SAMPLES:
        yield _in(trial, f"very short, {row.samples} samples")
    # Where more than a quarter of steps are irregular, or of samples follow one, no frame is out of the ordinary
    if 0 < row.clipped <= 0.25 * row.samples and np.mean(_irregular(trial.times, tolerance)) <= 0.25:
        kept = row.samples - row.clipped
        text = f"irregular frame: `clip_irregular()` would keep {kept} of {row.samples} samples"
        yield _in(trial, text, kept, schema.time)
    elif row.median_step and row.largest_deviation and row.largest_deviation > 0.1 * row.median_step:
        off, usual = (f"{step:.3g}{_unit(schema, schema.time)}" for step in (row.largest_deviation, row.median_step))
        text = f"irregular sampling: steps are up to {off} off their median {usual}"
        late = int(np.argmax(np.abs(np.diff(trial.times) - row.median_step))) + 1
        yield _in(trial, text, late, schema.time)
    rounding = float(np.spacing(np.abs(trial.times).max()))
    if row.median_step and rounding > 1e-4 * row.median_step:
        text = (
            f"times are rounded to {rounding:.2g}, {rounding / row.median_step:.2g} of a step, as they are so large: "
            "count them from the beginning of the trial"
        )
        yield _in(trial, text, 0, schema.time)
    for name, column in zip(schema.states, trial.states.T, strict=True):
        if count := row.missing[name]:
            text = f"{name} is missing in {count} of {row.samples} samples"
            yield _in(trial, text, int(np.isnan(column).argmax()), name)


def _values(trial: Trial, schema: Schema, stop: int) -> Iterator[Finding]:
    """Yield findings about the states of a trial; jumps are looked for in its first `stop` samples."""
    for name, column in zip(schema.states, trial.states.T, strict=True):
        measured = np.flatnonzero(~np.isnan(column))
        values = column[measured]
        if len(values) > 1 and np.all(values == values[0]):
            text = f"{name} is constant, {values[0]:g}{_unit(schema, name)} in every sample"
            yield _in(trial, text, int(measured[0]), name)
        measured = measured[measured < stop]
        times, values = trial.times[measured], values[: len(measured)]
        index = _jump(times, values)
        if index is not None:
            jump, (before, after) = values[index + 1] - values[index], measured[index : index + 2].tolist()
            text = f"{name} jumps by {jump:.3g}{_unit(schema, name)} from sample {before + 1} to sample {after + 1}"
            for k in (index + 1, index):
                without = _jump(np.delete(times, k), np.delete(values, k))
                if without is None or without > k:
                    at = f"{schema.time} = {times[k]:g}{_unit(schema, schema.time)}"
                    text += f": {values[k]:.6g}{_unit(schema, name)} at {at} may be a stray value"
                    after = int(measured[k])
                    break
            yield _in(trial, text, after, name)


def _jump(times: Floats, values: Floats) -> int | None:
    """Return the index of the sample before the first jump, or None.

    A jump is a second difference farther from the median of its neighbours than 10 robust standard deviations of all of
    them; where most are zero, than 10 of the smallest changes between samples.
    """
    if len(values) < _MIN_SAMPLES:
        return None
    slopes = np.diff(values) / np.diff(times) * np.median(np.diff(times))
    bends = np.diff(slopes)
    neighbours = sliding_window_view(np.pad(bends, 2, mode="reflect"), 5)
    distances = np.abs(bends - np.median(neighbours, axis=1))
    deviation = 1.4826 * np.median(np.abs(bends - np.median(bends)))
    rounding = 1e-12 * np.median(np.abs(values))
    if deviation <= rounding:
        changes = np.abs(slopes)[np.abs(slopes) > rounding]
        deviation = changes.min(initial=np.inf)
    wild = np.flatnonzero(distances > 10 * deviation)
    if not len(wild):
        return None
    before, after = np.abs(slopes[wild[0] : wild[0] + 2] - np.median(slopes))
    return int(wild[0] + (after >= before))


def exact_copies(trials: Iterable[Trial]) -> tuple[tuple[Trial, Trial], ...]:
    """Return each trial, of five samples or more, that equals one before it to the last bit, and that one."""
    by_digest = dict[tuple[object, ...], Trial]()
    pairs = list[tuple[Trial, Trial]]()
    for trial in (trial for trial in trials if len(trial) >= _MIN_SAMPLES):
        content = b"".join(values.tobytes() for values in (trial.times, trial.states, trial.inputs))
        before = by_digest.setdefault((trial.states.shape, hashlib.sha256(content).digest()), trial)
        if before is not trial:
            pairs.append((trial, before))
    return tuple(pairs)


def regular_length(times: Floats, tolerance: float | None) -> int:
    """Return the number of samples, from the first, that clipping at the last irregular frame keeps.

    With steps dt = diff(t), a frame i is irregular if abs(dt[i] - median(dt)) > tolerance, by default 7.5 % of the
    median: 5 ms for video at 15 frames a second.
    """
    irregular = np.flatnonzero(_irregular(times, tolerance))
    return int(irregular[-1]) + 1 if len(irregular) else len(times)


def _irregular(times: Floats, tolerance: float | None) -> Bools:
    if tolerance is not None and not tolerance > 0:
        raise CommonlawError("step-tolerance", tolerance=tolerance)
    steps = np.diff(times)
    median = np.median(steps) if len(steps) else 0.0
    return np.asarray(np.abs(steps - median) > (0.075 * median if tolerance is None else tolerance))
