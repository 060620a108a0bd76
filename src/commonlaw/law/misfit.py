"""What there is beyond a law and white noise, in a line for each kind of errors and for outliers."""

from collections.abc import Iterator

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.law.law import Law
from commonlaw.likelihood import ERRORS, ByGroup, Heteroscedastic
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.text import counted


def misfit_lines(law: Law) -> list[str]:
    """Return a line for each kind of errors besides white noise, and one for outliers: kind, size, and a remedy.

    Sizes are in units of the states, and as a share of their standard deviation within trials. They are those of
    `AbstractErrors.size`, and of process noise the deviation of the paths from solutions of the law, see `Misfit`.

    >>> from commonlaw import Law
    >>> misfit_lines(Law.from_text("x' = -x"))
    []
    """
    errors, misfit, lines = law.uncertainty.error_model, law.uncertainty.misfit, list[str]()
    schema = law.observation.measured
    unit_of_time = schema.units.get(schema.time, f"units of {schema.time}")
    for kind in errors.kinds:
        amounts = [*_amounts(law, kind)]
        if not amounts and isinstance(ERRORS[kind], ByGroup):  # Of one object
            continue
        text = ERRORS[kind].description.format(
            amount=" and ".join(amounts) or "an unknown amount",
            time=f"{_rounded(errors.correlation_time)} {unit_of_time}",
        )
        remedy = ERRORS[kind].distinguished_by
        lines.append(f"{text}; {remedy}" if remedy else text)
    if misfit is not None and misfit.outliers:
        how = "have no weight" if ERRORS[errors.kind].is_independent else "count linearly instead of squared"
        is_one = misfit.outliers == 1
        number = f"{misfit.outliers} of {counted(misfit.measurements, 'measurement')}"
        how = how.replace("have", "has").replace("count", "counts") if is_one else how
        lines.append(f"{number} {'is an outlier' if is_one else 'are outliers'}, which {how}")
    return [f"beyond the law: {line}" for line in lines]


def misfit_size(law: Law, kind: ErrorKind) -> Floats | None:
    """Return the standard deviation of errors of a kind of each measured quantity, shape (m,), see `misfit_lines`.

    None for kinds that have no one size, of process noise also where the law was not fitted to trials.
    """
    errors, misfit = law.uncertainty.error_model, law.uncertainty.misfit
    size = ERRORS[kind].size(errors, np.nan if misfit is None else misfit.duration)
    if size is None and misfit is not None and ERRORS[kind].group == "law":
        return misfit.deviation
    return size


def _amounts(law: Law, kind: ErrorKind) -> Iterator[str]:
    """Yield how large errors of a kind are, of each measured quantity that has any."""
    errors, misfit, schema = law.uncertainty.error_model, law.uncertainty.misfit, law.observation.measured
    model, noise, known = ERRORS[kind], law.uncertainty.noise, {*law.objects}
    if isinstance(model, Heteroscedastic):
        yield errors.heteroscedastic_in_words(schema.states)[kind]
        return
    if isinstance(model, ByGroup):
        groups = errors.by_trial or {owner: factors for owner, factors in errors.by_object.items() if owner in known}
        for j, name in enumerate(schema.states):
            levels = {group: float(factors[j]) for group, factors in groups.items()}
            if noise is not None and len({*levels.values()}) > 1:
                ends = (min(levels, key=lambda group: levels[group]), max(levels, key=lambda group: levels[group]))
                of = (f"{_size(law, j, levels[group] * noise[j])} ({group})" for group in ends)
                yield f"from {' to '.join(of)} in {name}"
        return
    if (size := misfit_size(law, kind)) is None:
        return
    for j, name in enumerate(schema.states):
        if np.isfinite(size[j]) and name not in schema.initial_values:
            share = size[j] / misfit.signal[j] if misfit is not None and misfit.signal[j] > 0 else np.nan
            of_signal = f"{_rounded(100 * share)} % of" if share < 1 else f"{_rounded(share)} times"
            yield f"{_size(law, j, size[j])} in {name}{f' ({of_signal} the signal)' if np.isfinite(share) else ''}"


def _size(law: Law, j: int, size: float) -> str:
    """Return the size of an error of a measured quantity with its unit."""
    schema = law.observation.measured
    if schema.states[j] in schema.logarithmic:
        return f"{_rounded(100 * size)} %"
    return f"{_rounded(size)} {schema.units.get(schema.states[j], '')}".rstrip()


def _rounded(value: float) -> str:
    """Return a number to two digits.

    >>> _rounded(0.02613), _rounded(123.4)
    ('0.026', '120')
    """
    return f"{float(f'{value:.2g}'):g}"
