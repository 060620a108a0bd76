"""What commands print and write of a fitted law, how it forecasts, and how it compares with others."""

import json
import re
import shlex
import sys
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.cli.options import AS_JSON, HISTORY, as_one, in_options, is_of_kind, saving
from commonlaw.cli.output import (
    Artifacts,
    parameter_columns,
    print_columns,
    print_frame,
    print_history,
    print_json,
    print_table,
    say,
)
from commonlaw.cli.source import Source, few_trials, stream_of
from commonlaw.errors import CommonlawError
from commonlaw.law import to_json
from commonlaw.law.alignment import measured_schema
from commonlaw.law.law import object_index, shares_terms
from commonlaw.law.models import model_named
from commonlaw.law.parameters import named_parameters
from commonlaw.law.pooling import by_properties
from commonlaw.law.simplify import within_errors
from commonlaw.law.text import MANY
from commonlaw.library.equation import split_equations
from commonlaw.runtime.fit_options import FitOptions, settings_of
from commonlaw.runtime.progress import ProgressCallback, part
from commonlaw.text import as_text, counted, in_line, r_squared
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.law import Law
    from commonlaw.law.script import Source as Program
    from commonlaw.plots import Figure
    from commonlaw.stream import ManyFindings
    from commonlaw.verdict import Findings


def compared(laws: "Mapping[str, Law]", training: "Trials", settings: Mapping[str, Any]) -> "pd.DataFrame":
    """Return the evidence of laws beside each other, under the settings that they were fitted with."""
    from commonlaw.inference import compare

    shared = settings.keys() & settings_of(FitOptions, "compare")
    return compare(laws, training, **{name: settings[name] for name in shared})


def print_compared(frame: "pd.DataFrame") -> None:
    """Print the evidence of laws beside each other, and what its numbers mean."""
    from commonlaw.law.tables import MEANINGS

    say("\nEvidence from the same measurements:\n")
    print_frame(frame, {"model error": "lack of fit"})
    say(f"\n{MEANINGS['2 log B']}.")
    say("Evidence penalizes additional coefficients. Probabilities assume that one of these laws is true.")


def over_table(source: Source, text: str) -> tuple[str, tuple[str, ...]]:
    """Return equations, or those of a named model over the columns of the table, and its inputs that are doses."""
    named = model_named(text)
    if named is None:
        return text, ()
    trials = source.load()
    textbook = named[0].over_columns(trials.schema, property_names(trials.properties), named[1])
    return textbook.equations, textbook.doses


def load(
    source: Source,
    equations: Sequence[str],
    laws: "Iterable[Law]" = (),
    starts: Container[str] = (),
    groups: Iterable[str] = (),
) -> "Trials":
    """Return the trials, their columns in the roles that equations and other laws give them.

    What has an equation and a column was measured; states of observation equations, or with initial values, need none.
    Columns of `groups` are inputs.
    """
    from commonlaw.estimation.model import ModelText

    schemas = [*map(measured_schema, laws)]
    if not equations:
        return source.load(schemas[0])
    trials, text = source.load(), ModelText.of(equations[0])
    named = (*(equation.state for equation in split_equations(text.equations)), *text.observed)
    columns = (*trials.schema.states, *trials.schema.inputs)
    states = tuple(name for name in named if name in columns or (text.is_plain and name not in starts))
    if source.dataset or "states" in source.roles:
        return trials
    if trials.schema.wide and len(states) == 1:
        return source.reading(wide=source.roles.get("wide") or states[0]).load()
    taken = {*groups, *(name for schema in schemas for name in schema.inputs)}
    others = [name for name in (*trials.schema.states, *trials.schema.inputs) if name not in states]
    occurring = {name for name in others if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", ";".join(equations))}
    inputs = tuple(name for name in others if name in taken | occurring)
    if {*states} == {*trials.schema.states} and {*inputs} == {*trials.schema.inputs}:
        return trials
    try:
        return source.reading(states=states, inputs=source.roles.get("inputs", inputs)).load()
    except CommonlawError as error:
        name = error.parameters.get("name")
        if name not in states or error.parameters.get("kind") != "column":
            raise
        raise CommonlawError("column-of-latent-state", error=error, name=name) from None


_OPTIONS = (
    saving(
        law="the law",
        figure="a figure of the law and its fit, with the residuals",
        report="a page that says all about the law",
        table="a table of its coefficients",
        program="the law as a program or workbook",
    ),
    AS_JSON,
    HISTORY,
)


@dataclass(frozen=True)
class Outputs:
    """What is wanted of a law that was learned."""

    save: tuple[str, ...]
    history: bool
    as_json: bool

    @property
    def draws(self) -> bool:
        """Whether a figure is wanted."""
        return any(is_of_kind(file, "figure") for file in self.save)

    def give(self, learned: "FitResult", later: Artifacts) -> None:
        """Write the files and print the rest."""
        from commonlaw.law.tables import coefficient_rows

        table = partial(coefficient_rows, learned.law)
        report = partial(page, learned.findings, learned.program, lambda _: None, learned.everything)
        later.save(self.save, law=learned.law, figure=learned.figure, table=table, report=report)
        if self.as_json:
            print_json(learned.document())
        else:
            learned.show()
            if self.history:
                print_history(learned.law)
        later.end(learned.notes(), silent=self.as_json)


with_outputs = as_one("outputs", Outputs, _OPTIONS)
"""Adds the options that say what is wanted of a law to a command, which receives them as `outputs`."""


@dataclass(frozen=True)
class FitResult:
    """What was found out about a law, the true law if it is known, and laws compared, see `commonlaw.compare`.

    Of a law that was learned from a stream, the findings are about a few of its trials; what was held out of a stream
    is forecast as a whole.
    """

    findings: "Findings"
    truth: "Law | None"
    compared: "pd.DataFrame | None" = None
    stream: "TrialStream | None" = None
    everything: "ManyFindings | None" = None
    program: "Program | str" = ""
    """Where a program finds the trials."""

    @classmethod
    def check(
        cls,
        law: "Law",
        source: Source,
        trials: "Trials",
        training: "Trials",
        bands: bool,
        later: Artifacts,
        stream: "TrialStream | None" = None,
    ) -> "FitResult":
        """Return a law with its findings, forecasts with bands if wanted, and the true law of a data set."""
        from commonlaw.datasets import truth_of
        from commonlaw.verdict import Findings, find

        name = source.dataset
        truth = later.take("the true law was not found", lambda: truth_of(name) if name else None, None)
        unchecked = Findings(law, trials, training)
        findings = later.take("the law was not checked", lambda: find(law, trials, training, bands), unchecked)
        program = source.program(stream or trials) if source.path else ""
        return cls(findings, truth, stream=stream, program=program)

    @property
    def law(self) -> "Law":
        """The law."""
        return self.findings.law

    def figure(self, plots: Any) -> "Figure | None":
        """Return a figure of the law and its fit, or else its forecasts, if there are any."""
        shown = self.findings.shown
        return plots.plot_law(self.law, shown, truth=self.truth) if shown else None

    def show(self) -> None:
        """Print the law, how well it forecasts, and the most probable candidates."""
        from commonlaw.law.tables import MEANINGS, readable_candidates

        law, training = self.law, self.findings.training
        if self.stream is None:
            of = f"{counted(len(training), 'trial')} of", f", {counted(sum(map(len, training)), 'sample')}"
        else:
            of = f"{counted(len(self.stream.parts), 'file')} with", ""
        say(f"{of[0]} {counted(len(law.objects), 'object')}{of[1]}\n")
        parameters, observed = named_parameters(law), [] if law.observation is None else law.observation.lines
        if shares_terms(law) and law.uncertainty.explanation is None:
            say("\n".join((*map(in_line, (*law.structure, *observed)), "")))
            if len(law.objects) == 1 and parameters.names:
                say("\n".join((*map(in_line, law.equations()), "")))
            if (
                law.provenance.equations
                and 0 < len(law.objects) * len(parameters.names) <= MANY
                and law.uncertainty.covariance is not None
            ):
                columns = parameter_columns(law)
                if (true := self._true_values()) is not None:
                    columns["true"] = [*true.ravel().tolist()]
                print_table(list(columns), zip(*columns.values(), strict=True))
                if self.findings.shown is not None and len(law.objects) > 1:
                    say("")
                    print_columns(self._error_columns())
            else:
                self._show_coefficients()
            for line in [*within_errors(law), *by_properties(law)]:
                say(f"\n{in_line(line)}")
        else:
            say(str(law))
            if len(law.objects) > MANY:
                say("")
                self._show_coefficients()
        findings = self.findings
        if self.everything:
            say("\n".join(("", *self._scores())))
        if findings.verdict:
            say(f"\n{findings.verdict}")
        if not self.everything:
            say("\n".join(("", *self._scores())))
        if law.provenance.alternatives:
            say("\nCandidate laws (* chosen):\n")
            candidates = readable_candidates(law.provenance.alternatives)
            rank = candidates.groupby("equation").cumcount()
            few = candidates[(rank < 4) | (candidates[""] == "*")]
            print_frame(few)
            if len(few) < len(candidates):
                say(f"\n{len(candidates) - len(few)} more with less support: commonlaw show LAW.json --history")
            for meaning in (text for name, text in MEANINGS.items() if name in candidates):
                say(f"\n{meaning}.")
        if self.compared is not None:
            print_compared(self.compared)

    def _scores(self) -> Iterator[str]:
        findings = self.findings
        if every := self.everything:
            bands = (
                ""
                if np.isnan(every.coverage)
                else f"; 95 % bands hold {100 * every.coverage:.3g} % (about 95 % expected)"
            )
            yield f"Forecasts of {every.forecast_of}: {r_squared(every.score)}{bands}"
            yield f"Represented by {counted(len(findings.trials.objects), 'object')}:"
            return
        in_sample, forecast = list[str](), ""
        if findings.fit:
            in_sample.append(f"{r_squared(findings.fit.score())} in the fit")
        if findings.forecast:
            begin = findings.forecast.title.removeprefix("forecast ")
            later = ", later samples included" * findings.has_later_samples
            forecast = f"{r_squared(findings.forecast.score())} in forecasts {begin}{later}"
            in_sample += [] if findings.is_held_out else [forecast]
        if in_sample:
            yield f"Training data, {counted(len(findings.training), 'trial')}: {', '.join(in_sample)}"
        if findings.forecast and findings.is_held_out:
            yield f"Held-out data, {counted(len(findings.forecast.trials), 'trial')}: {forecast}"

    def document(self) -> dict[str, object]:
        """Return all results for ``--json``."""
        from commonlaw.law.tables import interval_frame

        law, findings = self.law, self.findings
        forecast, verdict = findings.forecast, findings.verdict
        return {
            "law": json.loads(to_json(law)),
            "equations": {name: list(law.equations(name)) for name in law.objects},
            "intervals": None if law.uncertainty.covariance is None else interval_frame(law).to_dict(orient="records"),
            "history": [asdict(step) for step in law.history],
            "truth": None if self.truth is None else json.loads(to_json(self.truth)),
            "fit": findings.fit
            and {"score": findings.fit.score(), "errors": findings.fit.errors().to_dict(orient="records")},
            "forecast": forecast
            and {
                "of": "held out" if findings.is_held_out else "training",
                "title": forecast.title,
                "score": forecast.score(),
                "errors": forecast.errors().to_dict(orient="records"),
            },
            "compared": None if self.compared is None else self.compared.to_dict(orient="records"),
            "verdict": verdict and asdict(verdict) | {"usable": verdict.usable, "sentences": verdict.sentences},
            "notes": list(findings.training.notes),
            "outcomes": [str(outcome) for outcome in (*law.diagnostics, *(forecast.outcomes if forecast else ()))],
        }

    def notes(self) -> list[object]:
        """Return what else there is to know."""
        findings = self.findings
        outcomes = findings.forecast.outcomes if findings.forecast else ()
        return [*findings.training.notes, *self.law.diagnostics, *findings.failures, *outcomes]

    def _show_coefficients(self) -> None:
        """Print the parameters of the law, of many objects how they are spread."""
        from commonlaw.law.parameters import named_parameters
        from commonlaw.law.tables import spread_tables, with_unit

        law, parameters = self.law, named_parameters(self.law)
        if len(law.objects) > MANY:
            if tables := spread_tables(law, 10):
                spread, farthest = tables
                print_frame(spread)
                how = "farthest from the medians, in standard deviations of a normal spread"
                say(f"\nThe 10 objects {how}:\n")
                print_table([*map(str, farthest)], farthest.itertuples(index=False, name=None))
        else:
            # With standard errors, true coefficients and RMS residuals where these are known
            columns, true = {law.schema.object: list[object](law.objects)}, self._true_values()
            deviations = np.nan_to_num(parameters.errors.T)
            estimates = zip(parameters.names, parameters.units, parameters.values.T, deviations, strict=True)
            for i, (name, unit, values, errors) in enumerate(estimates):
                pairs = zip(values.tolist(), errors.tolist(), strict=True)
                columns[with_unit(name, unit)] = [(value, error) if error else value for value, error in pairs]
                if true is not None:
                    columns[f"true {name}"] = true[:, i].tolist()
            print_columns(columns | self._error_columns())

    def _true_values(self) -> Floats | None:
        """Return the parameters of the true law, shape (objects, parameters), if it is known."""
        from commonlaw.law.parameters import by_terms_of, named_parameters

        if self.truth is None:
            return None
        rows = [object_index(self.truth, name) for name in self.law.objects]
        coefficients = by_terms_of(self.law, self.truth, self.truth.coefficients)[rows]
        return named_parameters(self.law).of(coefficients)

    def _error_columns(self) -> dict[str, list[object]]:
        """Return the RMS residuals of each object, or RMS errors of its forecasts where there is no fit."""
        from commonlaw.law.tables import with_unit

        law, curves = self.law, self.findings.shown
        columns = {law.schema.object: list[object](law.objects)}
        if curves is None:
            return columns
        errors_of = curves.errors().pivot_table(
            index=law.schema.object,
            columns="state",
            values="rms error",
            aggfunc=lambda errors: np.sqrt(np.mean(errors**2)),
        )
        schema = measured_schema(law)
        for state in schema.measured:
            what = "RMS residual" if curves.is_fit else "RMS forecast error"
            columns[with_unit(f"{what} of {state}", schema.units.get(state))] = (
                errors_of[state].reindex(law.objects).tolist()
            )
        return columns


def page(
    findings: "Findings", program: "Program | str", show: ProgressCallback, everything: "ManyFindings | None" = None
) -> bytes:
    """Return a page about a law, its findings, and how it is made again."""
    from commonlaw.report import law_report, to_page

    command = as_text(shlex.join(["commonlaw", *sys.argv[1:]]))
    made = law_report(findings, command, program, in_options, show, everything=everything)
    return to_page(made, lambda name: show(f"drawing {name}"))


def find_law(
    source: Source,
    outputs: Outputs,
    show: ProgressCallback,
    streams: bool,
    find: "Callable[[Any, ProgressCallback], Law]",
    explain: "Callable[[Law, ProgressCallback, Artifacts], Law]" = lambda law, *_: law,
) -> tuple[FitResult, Artifacts]:
    """Find a law in a table, or in files that are gone through one by one, and check it by forecasts.

    These are of all that is held out; of files without any of a few trials.
    """
    show("listing the files" if streams else "reading the table")
    trials: Any = stream_of(source) if streams else source.load()
    training, later = source.select(trials), Artifacts()
    law = find(training, part(show, 0.05, 0.9))
    later.save(outputs.save, law=law)
    law = explain(law, show, later)
    if not streams:
        show("checking the law by forecasts")
        return FitResult.check(law, source, trials, training, outputs.draws, later), later
    few = few_trials(training)
    if source.holds_out:
        from commonlaw.stream import find_by_stream
        from commonlaw.verdict import Findings

        find_all = partial(find_by_stream, law, source.held_out(trials), show, training)
        everything = later.take("the law was not checked", find_all, None)
        findings = Findings(law, few, few) if everything is None else replace(everything.few, law=everything.law)
        program = source.program(training)
        return FitResult(findings, None, stream=training, everything=everything, program=program), later
    show("checking the law by forecasts of a few trials")
    return FitResult.check(law, source, few, few, outputs.draws, later, trials), later
