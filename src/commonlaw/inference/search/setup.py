"""The input of a fit: trials on the scale of the law with interpolated inputs, and the coefficients to estimate.

A search for a law begins with `transform_trials`; `refine`, `compare`, `adapt` and the discrepancy with a `FitSetup`.
States on a logarithmic scale need a law of first order, and noise that is not heteroscedastic.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.data.noise import known_noise
from commonlaw.inference.fit.problem import SearchProblem, prepare
from commonlaw.integration import BETWEEN, jumps
from commonlaw.law import Law, select_objects
from commonlaw.law.alignment import matched, matched_noise
from commonlaw.law.law import shares_terms
from commonlaw.law.parameters import standard_errors
from commonlaw.library import Terms, order_of_each
from commonlaw.likelihood import ERRORS, WHITE_NOISE, ByGroup, Heteroscedastic, Prior
from commonlaw.runtime.fit_options import CovarianceKind, ErrorKind, FitOptions, changed_settings
from commonlaw.trials import Schema, Trials
from commonlaw.trials.headers import find_name
from commonlaw.trials.recognition import is_held
from commonlaw.trials.transformations import with_logarithms, with_zeros_before_doses
from commonlaw.trials.trial import check_gaps


def transform_trials(trials: Trials, logarithmic: Sequence[str], input_interpolation: str) -> Trials:
    """Return trials with the logarithms of some states and an interpolation of the inputs.

    With ``"auto"`` the interpolation is that of `supported_interpolation`.
    """
    between = supported_interpolation(trials) if input_interpolation == "auto" else input_interpolation
    return with_interpolation(with_logarithms(trials, logarithmic), between)


def with_interpolation(trials: Trials, input_interpolation: str) -> Trials:
    """Return trials with an interpolation of the inputs."""
    return replace(trials, schema=replace(trials.schema, input_interpolation=input_interpolation))


def possible_interpolations(trials: Trials) -> tuple[str, ...]:
    """Return the interpolations that differ for the inputs of trials: ``"jumps"`` only where one jumps."""
    jump = not trials.schema.doses and any(jumps(trial.times, trial.inputs).any() for trial in trials)
    return tuple(between for between in BETWEEN if jump or between != "jumps")


def supported_interpolation(trials: Trials) -> str:
    """Return the interpolation that the inputs support: held, with jumps, linear, or cubic if all that vary are smooth.

    They are held if each that varies stays at levels, as samples of ramps lie between levels; doses have ramps. Others
    may jump. Otherwise the smaller leave-one-out error decides: each sample is predicted by Lagrange interpolation
    u_i ~ sum_j u_j prod_k (t_i - t_k)/(t_j - t_k) from its two or four neighbours. The likelihood of a fit does not
    decide it: a larger gain compensates for a flattened input.
    """
    varying = stay_at_levels(trials)
    if not trials.schema.doses and varying and all(varying.values()):
        return "held"
    if "jumps" in possible_interpolations(trials):
        return "jumps"
    squares, total = np.zeros((2, len(trials.schema.inputs))), np.zeros(len(trials.schema.inputs))
    for trial in trials:
        middle, total = np.arange(2, len(trial) - 2), total + np.sum(trial.inputs**2, axis=0)
        for i, steps in enumerate(((-1, 1), (-2, -1, 1, 2))):
            ahead = [trial.times[middle + step] - trial.times[middle] for step in steps]
            weights = [np.prod([b / (b - a) for b in ahead if b is not a], axis=0) for a in ahead]
            by_others = sum(w[:, np.newaxis] * trial.inputs[middle + k] for w, k in zip(weights, steps, strict=True))
            squares[i] += np.sum((trial.inputs[middle] - by_others) ** 2, axis=0)
    bent = squares[0] > np.finfo(float).eps * total
    return "cubic" if bent.any() and (squares[0] > settings.MIN_SMOOTHNESS * squares[1])[bent].all() else "linear"


def stay_at_levels(trials: Trials) -> dict[str, bool]:
    """Return for each input that varies, by name, whether it stays at levels in at least half of its trials."""
    columns = {name: [trial.inputs[:, j] for trial in trials] for j, name in enumerate(trials.schema.inputs)}
    varying = {name: [run for run in column if np.ptp(run)] for name, column in columns.items()}
    return {name: 2 * sum(map(is_held, runs)) >= len(runs) for name, runs in varying.items() if runs}


@dataclass(frozen=True, kw_only=True)
class RefitOptions:
    """The `FitOptions` of a law that is fitted again; by least squares, no measurement counts as an outlier."""

    log_states: Sequence[str] | None = None
    input_interpolation: str | None = None
    noise: Mapping[str, float] | None = None
    errors: ErrorKind | Literal["auto"] = "auto"
    huber_threshold: float = FitOptions.huber_threshold
    covariance: CovarianceKind = "likelihood"
    partial_pooling: bool = False
    seed: int = 0
    n_jobs: int = -1
    least_squares: bool = False

    @property
    def threshold(self) -> float:
        """The Huber threshold, infinite for least squares."""
        return np.inf if self.least_squares else self.huber_threshold

    @property
    def changed(self) -> dict[str, Any]:
        """Those that are not the default of `refine`."""
        return changed_settings(
            "refine", {name: value for name, value in vars(self).items() if name != "least_squares"}
        )


@dataclass(frozen=True, eq=False)
class FitSetup:
    """A law of given terms, and the trials of its objects that its coefficients are fitted to.

    Trials are in the units of the law, transformed by `transform_trials`. Known noise has shape (states,). The
    interpolation of inputs may be ``"auto"``, which begins with what these support. Priors of the coefficients of each
    object are None for flat; all are flat if empty.
    """

    law: Law
    trials: Trials
    noise: Floats | None
    huber_threshold: float
    input_interpolation: str
    priors: Sequence[Prior | None] = ()

    @classmethod
    def of(cls, law: Law, trials: Trials, options: RefitOptions) -> "FitSetup":
        """Return the setup for a law and trials, which may differ in units.

        The noise is given by state in the units of the trials. The interpolation of inputs and the states on a
        logarithmic scale are those of the law by default.

        Raises `CommonlawError` if the law is of discrete time, its objects do not share their terms, or law, trials and
        noise do not match.
        """
        log_states, input_interpolation = options.log_states, options.input_interpolation
        law = law if log_states is None else on_log_scale(law, log_states)
        levels = matched_noise(law, trials, options.noise)
        if not law.schema.doses:
            trials = trials.with_trials([trial.measured() for trial in trials])
        trials = with_zeros_before_doses(matched(law, trials))
        check_gaps(tuple(trials), trials.schema)
        between = law.schema.input_interpolation if input_interpolation is None else input_interpolation
        trials = transform_trials(trials, law.schema.logarithmic, between)
        if law.order == 0:
            raise CommonlawError("discrete-not-refined")
        law = select_objects(law, trials.objects)
        if not shares_terms(law):
            raise CommonlawError("refine-own-terms")
        law = replace(law, uncertainty=replace(law.uncertainty, huber_threshold=options.threshold))
        return cls(law, trials, known_noise(levels, trials), options.huber_threshold, between)

    def check_determined(self) -> None:
        """Raise `CommonlawError` for more coefficients and initial values than measurements, which do not fix them."""
        schema, coefficients = self.trials.schema, int(np.isnan(self.known).sum())
        orders = np.array(order_of_each(self.law.order, len(schema.states)))
        is_free = np.array([schema.initial_values.get(name) is None for name in schema.states])
        measured = [np.isfinite(trial.states) for trial in self.trials]
        initial = sum(int((orders * is_free)[values.any(axis=0)].sum()) for values in measured)
        if (count := sum(int(values.sum()) for values in measured)) < coefficients + initial:
            raise CommonlawError(
                "more-unknowns-than-measurements", coefficients=coefficients, initial=initial, measurements=count
            )

    @property
    def known(self) -> Floats:
        """Known coefficients, shape (objects, equations, terms), NaN where they are estimated."""
        result, law = np.where(self.law.support, np.nan, 0.0) + np.zeros_like(self.law.coefficients), self.law
        certain = standard_errors(law) == 0
        result[certain] = law.coefficients[certain]
        return result

    def problem(self) -> SearchProblem:
        """Return the measurements prepared for a fit of the terms of the law."""
        problem = prepare(
            self.trials,
            self.law.terms,
            self.known,
            noise=self.noise,
            huber_threshold=self.huber_threshold,
            guess=self.law.coefficients,
        )
        problem = replace(problem, residuals_estimate_noise=problem.is_determined(int(np.isnan(self.known).sum())))
        return problem.with_priors(self.priors) if self.priors else problem


def error_kinds(errors: ErrorKind | Literal["auto"], schema: Schema) -> tuple[ErrorKind, ...]:
    """Return the error models that are compared for trials of a schema.

    Raises `CommonlawError` if the noise of a logarithmic state is to be heteroscedastic, or if noise that columns have
    is to be that of each object or trial.
    """
    grouped = [kind for kind, model in ERRORS.items() if isinstance(model, ByGroup)]
    if errors in grouped and schema.noise_columns:
        raise CommonlawError("noise-by-group-given", errors=errors)
    grown = [kind for kind, model in ERRORS.items() if isinstance(model, Heteroscedastic)] if schema.logarithmic else []
    if errors in grown:
        raise CommonlawError("log-states-with-errors", states=schema.logarithmic)
    refused = [*grown, *(grouped if schema.noise_columns else [])]
    return tuple(kind for kind in (ERRORS if errors == "auto" else (errors,)) if kind not in refused)


def on_log_scale(law: Law, states: Sequence[str]) -> Law:
    """Return a law with these states, and no others, on a logarithmic scale.

    Its equations are the same. Solutions are computed for the logarithms of these states, so that forecasts and their
    bands stay positive, and measurement errors are relative. Estimates of the errors are dropped if the scale changes.

    Raises `CommonlawError` if the law is not of order 1, has no such state, or the state is latent.
    """
    names = tuple(dict.fromkeys(find_name(name, law.schema.states, "state") for name in states))
    if latent := [name for name in names if name in law.schema.initial_values]:
        raise CommonlawError("log-states-latent", state=latent[0])
    if names == law.schema.logarithmic:
        return law
    return replace(
        law,
        schema=replace(law.schema, logarithmic=names),
        terms=Terms(replace(law.terms.variables, logarithmic=names), law.terms.terms),
        uncertainty=replace(law.uncertainty, noise=None, error_model=WHITE_NOISE, other_laws=()),
    )
