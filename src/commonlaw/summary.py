"""What is said of a law and its assessment: lines and tables that the command line, reports and the app lay out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from commonlaw.array_types import Floats
from commonlaw.diagnostics import OutcomeKind
from commonlaw.discovery.textbook import TextbookLaw, nearest_textbook_law
from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast, fitted
from commonlaw.forecast.forecast import squared_errors
from commonlaw.inference import CandidateLaw
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.misfit import misfit_lines
from commonlaw.law.parameters import by_terms_of, named_parameters
from commonlaw.law.pooling import by_properties
from commonlaw.law.printing import equation_lines
from commonlaw.law.simplify import within_errors
from commonlaw.law.tables import coefficients_by_object, readable_candidates, with_unit
from commonlaw.runtime.forking import cached_property
from commonlaw.stream import ManyFindings
from commonlaw.text import counted, r_squared
from commonlaw.trials import Trials, TrialStream
from commonlaw.verdict import Findings


@dataclass(frozen=True, eq=False)
class Summary:
    """What is said of a law: its equations and parameters, how it fits and forecasts, and what it was chosen from.

    Of a law of a `stream`, `findings` are about a few of its objects, and `everything` has the forecasts of all. The
    `truth` is the law behind simulated trials, `rivals` are laws of other sizes, fitted to the same trials, and `words`
    turns messages into those of the caller.
    """

    findings: Findings
    everything: ManyFindings | None = None
    stream: TrialStream | None = None
    truth: Law | None = None
    rivals: tuple[CandidateLaw, ...] = ()
    words: Callable[[str], str] = str

    @property
    def law(self) -> Law:
        """The law."""
        return self.findings.law

    @property
    def counts(self) -> str:
        """How many trials, objects and samples there are, and how many of them were learned from."""
        if self.stream is not None:
            return f"{counted(len(self.stream.parts), 'file')} with {counted(len(self.law.objects), 'object')}"
        trials, training = self.findings.trials, self.findings.training

        def samples(trials: Trials) -> str:
            """Return their number, without rows of inputs alone and those that doses add."""
            return counted(sum(len(trial.measured()) for trial in trials), "sample")

        some = "" if training is trials else f"; training data: {counted(len(training), 'trial')}, {samples(training)}"
        return f"{counted(len(trials), 'trial')} of {counted(len(trials.objects), 'object')}, {samples(trials)}{some}"

    @property
    def parameters(self) -> pd.DataFrame:
        """The parameters, with true ones if these are known and the root mean square error of each object's curves."""
        law, truth = self.law, true_coefficients(self.law, self.truth)
        frame, true = parameter_table(law), None if truth is None else named_parameters(law).of(truth)
        if true is not None and law.schema.object in frame:
            frame[[f"true {name}" for name in named_parameters(law).names]] = true
        elif true is not None:
            frame["true"] = true.ravel()
        curves = self.findings.shown
        if curves is not None and law.schema.object in frame:
            what, units = "RMS residual" if curves.is_fit else "RMS forecast error", curves.trials.schema.units
            errors = squared_errors(curves).groupby(level=0).mean().pow(0.5)
            for state in errors:
                values = frame[law.schema.object].map(errors[state])
                frame[with_unit(f"{what} of {state}", units.get(str(state)))] = values
        return frame

    def score(self, curves: Forecast) -> str:
        """Return how well a law fits or forecasts the trials of the fit or the forecasts, in a line."""
        findings, number = self.findings, counted(len(curves.trials), "trial")
        learned = " of the training data" if self.law.provenance.is_learned else ""
        if curves.is_fit:
            what = f"Fit of {number}{learned}"
        elif findings.is_held_out and learned:
            what = f"Forecasts of {counted(len(curves.trials), 'held-out trial')}"
        else:
            what = f"Forecasts of {number}{learned}{', later samples included' * findings.has_later_samples}"
        misfit = self.law.uncertainty.misfit
        if learned and misfit is not None and misfit.outliers:
            what += f", {counted(misfit.outliers, 'outlier')} included"
        begin = curves.title.removeprefix("forecast").removeprefix("fit")
        numbers = [r_squared(score)] if np.isfinite(score := curves.score()) else []
        if curves.is_fit and not curves.outcomes:
            numbers.append(f"RMS residual {in_states(squared_errors(curves).mean().pow(0.5), curves)}")
        if curves.outcomes:
            numbers.append(f"{len(curves.outcomes)} diverge")
        return f"{what}{begin}: {', '.join(numbers) or 'not measured'}"

    @cached_property
    def textbook(self) -> TextbookLaw | None:
        """The law of textbooks nearest to a discovered law of trials in memory; None if there is none."""
        findings, law = self.findings, self.law
        if law.provenance.equations or not law.provenance.is_learned or self.stream or self.everything:
            return None
        if law.provenance.is_stopped:  # It may take longer than the law
            return None
        try:
            return nearest_textbook_law(law, findings.trials, findings.training, findings.verdict)
        except (CommonlawError, ArithmeticError, np.linalg.LinAlgError):
            return None

    @property
    def scores(self) -> tuple[str, ...]:
        """How well the law fits its training data and how well it forecasts, in lines."""
        if (every := self.everything) is None:
            return tuple(self.score(curves) for curves in self.findings.curves)
        known = not np.isnan(every.coverage)
        bands = f", {100 * every.coverage:.3g} % within the 95 % bands (about 95 % expected)" if known else ""
        diverged = f", {every.diverged} diverge" if every.diverged else ""
        few = counted(len(self.findings.trials.objects), "object")
        return (
            f"Forecasts of {every.forecast_of}: {r_squared(every.score)}{bands}{diverged}",
            f"All else is about {few} that represent all, evenly spaced by the rank of their forecast error",
        )

    @property
    def candidates(self) -> pd.DataFrame:
        """The candidates of each equation, with the measures that people compare; empty if there were none."""
        listed = self.law.provenance.alternatives
        return readable_candidates(listed) if listed else pd.DataFrame()

    @property
    def notes(self) -> tuple[str, ...]:
        """What else there is to know of the trials and of the law."""
        return tuple(self.words(str(note)) for note in (*self.findings.training.notes, *self.law.diagnostics))

    def of_law(self, law: Law) -> "Summary":
        """Return what is said of another law that was fitted to the same trials; it has no verdict."""
        if law is self.law:
            return self
        fit, forecast = (
            curves and self.curves_of(law, curves.trials, curves.is_fit, law.uncertainty.has_std)
            for curves in (self.findings.fit, self.findings.forecast)
        )
        return replace(self, findings=replace(self.findings, law=law, verdict=None, fit=fit, forecast=forecast))

    def curves_of(self, law: Law, trials: Trials, is_fit: bool, bands: bool = False) -> Forecast | None:
        """Return the fit of a law to trials, or forecasts as those of this law; None if there are none."""
        try:
            if is_fit:
                return fitted(law, trials, bands)
            return law.predict(trials, start=self.findings.start, return_std=bands)
        except (CommonlawError, ArithmeticError, np.linalg.LinAlgError):
            return None


def shown_equations(law: Law) -> list[str]:
    """Return the equations that all objects share, of one object also with numbers; else those of each object."""
    numbers = equation_lines(law)
    has_numbers = len(law.objects) == 1 and law.uncertainty.explanation is None and bool(named_parameters(law).names)
    return [*law.structure, *numbers] if has_numbers else numbers


def remarks(law: Law, has_properties: bool = True) -> list[str]:
    """Return lines below the equations: those that fit as well, and what there is beyond the law.

    Equations that fit as well have fewer parameters, or those that follow from properties of the objects, if wanted.
    """
    return [*within_errors(law), *(by_properties(law) if has_properties else ()), *misfit_lines(law)]


def parameters_caption(law: Law) -> str:
    """Return what the table of parameters shows."""
    if law.uncertainty.covariance is None:
        return "Coefficients"
    is_assumed = any(diagnostic.kind is OutcomeKind.NOISE for diagnostic in law.diagnostics)
    return f"Coefficients ± standard errors, with 95 % intervals{', of an assumed noise' * is_assumed}"


def parameter_table(law: Law) -> pd.DataFrame:
    """Return a row for each object, see `coefficients_by_object`; of one object a row for each parameter.

    It is empty where objects have terms of their own, or there is no parameter.
    """
    frame = coefficients_by_object(law)
    if len(frame) != 1:  # Of one object with trials of their own, too
        return frame
    dropped = ["object", "equation", "term", *([] if law.params["unit"].any() else ["unit"])]
    rows: pd.DataFrame = law.params.drop(columns=dropped).dropna(axis=1, how="all")
    return rows.set_axis([f"95 % {name}" if name in ("low", "high") else name for name in rows], axis=1)


def true_coefficients(law: Law, truth: Law | None) -> Floats | None:
    """Return true coefficients of a law's objects, shape (objects, equations, terms); None if they are not known.

    Those of an object that the true law does not have are zero.
    """
    if truth is None:
        return None
    known, none = by_terms_of(law, truth, truth.coefficients), np.zeros(law.support.shape)
    return np.array([known[object_index(truth, name)] if name in truth.objects else none for name in law.objects])


def in_states(errors: "pd.Series[float]", curves: Forecast) -> str:
    """Return errors by state, in the states' units, in words."""
    if np.isinf(errors).any():
        return "diverges"
    units, several = curves.trials.schema.units, len(errors) > 1
    known: Sequence[tuple[str, float]] = [(str(state), value) for state, value in errors.items() if np.isfinite(value)]
    texts = [f"{value:.3g} {units.get(state, '')}".rstrip() + f" ({state})" * several for state, value in known]
    return " and ".join(texts) or "not measured"
