"""The scale on which states of many decades are fitted: their own, or that of their logarithms.

Fits resolve a state to `MIN_NOISE` of its standard deviation, so that smaller values count for nothing. On a
logarithmic scale all count, as their errors are in proportion to the state. Both are compared by the likelihood of the
measurements y about trajectories h of standard deviation s over whole trials, in which outliers are as likely as a
measurement at the Huber threshold,

    -2 log L = sum of min(|h - y| / s, threshold)^2 + 2 log s,

where s is the error of the logarithm times ``exp(h)`` if h is that of a logarithm. First measurements of trials, to
which free initial values fit on any scale, do not count.
"""

from collections.abc import Callable

import numpy as np

from commonlaw.diagnostics import marked, note
from commonlaw.discrepancy.residuals import untested
from commonlaw.errors import CommonlawError
from commonlaw.inference.verbs.refinement import noted
from commonlaw.law import Law
from commonlaw.law.parameters import named_parameters
from commonlaw.law.text import with_error
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.likelihood.levels import over_decades
from commonlaw.likelihood.observation_model import VERY_STRONG
from commonlaw.trials import Trials


def likelier_scale(
    on_log_scale: Callable[[], Law], on_own_scale: Callable[[], Law], reference: Callable[[Law], Law], trials: Trials
) -> Law:
    """Return the law on a logarithmic scale if the evidence for it is very strong, else that on its own; with a note.

    The former is compared with a reference for it, the law of the same equations on its own scale. Where one of both
    cannot be fitted it is the other one.

    Raises `CommonlawError` if neither can be fitted.
    """
    try:
        law = on_log_scale()
    except CommonlawError:
        return noted(on_own_scale(), (note("small-values-without-weight", states=[*over_decades(trials)]),))
    states = law.observation.measured.logarithmic
    try:
        linear = reference(law)
        gain = _deviance(linear, trials) - _deviance(law, trials)
    except CommonlawError as error:
        return noted(law, (note("log-scale-without-comparison", states=states, error=error.sentence(marked)),))
    if not gain > VERY_STRONG:
        return on_own_scale()
    changed = largest_change(law, linear, "on a linear scale")
    return noted(law, (note("log-scale-chosen", states=states, gain=gain, changed=changed),))


def largest_change(law: Law, reference: Law, how: str) -> str:
    """Return the parameter that differs most from that of a reference, in standard errors, with both values."""
    here, there = named_parameters(law), named_parameters(reference)
    with np.errstate(divide="ignore", invalid="ignore"):
        changes = np.nan_to_num(abs(there.values - here.values) / here.errors)
    i, j = np.unravel_index(np.argmax(changes), here.values.shape)
    of = f" of {law.objects[i]}" if len(law.objects) > 1 else ""
    values = with_error(here.values[i, j], here.errors[i, j])
    others = with_error(there.values[i, j], float(np.nan_to_num(there.errors[i, j])))
    return f"{here.names[j]}{of} is {values}, and {others} {how}"


def _deviance(law: Law, trials: Trials) -> float:
    """Return minus twice the log-likelihood of measurements about the trajectories of a law, without constants."""
    noise, errors = law.uncertainty.noise, law.uncertainty.error_model
    assert noise is not None
    residuals, _ = untested(law, trials, noise)
    schema, total = residuals.trials.schema, 0.0
    is_logarithmic = np.isin(schema.states, schema.logarithmic)
    for trial, fitted, z in zip(residuals.trials, residuals.fitted, residuals.standardized, strict=True):
        seen = np.isfinite(trial.states)
        seen[np.argmax(seen, axis=0), range(seen.shape[1])] = False
        curve = np.where(np.isfinite(z), fitted[:, : seen.shape[1]], trial.states)
        white = trial.std(errors.noise_of_trial(trial, noise))
        std = errors.measurement_std(curve, white, trial.elapsed)
        logs = 2 * np.log(std) + 2 * np.where(is_logarithmic, curve, 0.0)
        sizes = np.fmin(np.abs(z), HUBER_THRESHOLD)
        total += float(np.sum((sizes**2 + logs)[seen]))
    return total
