"""What commands print and write of a fitted law, how it forecasts, and how it compares with others."""

import json
import re
import shlex
import sys
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from commonlaw.cli.options import AS_JSON, as_one, in_options, is_of_kind, saving
from commonlaw.cli.output import Artifacts, print_frame, print_json, print_law, say
from commonlaw.cli.source import Source, few_trials, layouts, print_layouts, stream_of
from commonlaw.errors import CommonlawError
from commonlaw.law import to_json
from commonlaw.law.models import model_named
from commonlaw.runtime.fit_options import FitOptions, settings_of
from commonlaw.runtime.progress import ProgressCallback, part
from commonlaw.text import as_text
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.equation_columns import as_named, is_letter
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.law import Law
    from commonlaw.law.script import Source as Program
    from commonlaw.plots import Figure
    from commonlaw.stream import ManyFindings
    from commonlaw.summary import Summary
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
    print_frame(frame)
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
    dosed: bool = False,
) -> "Trials":
    """Return the trials, their columns in the roles that equations and other laws give them.

    What has an equation and a column was measured; states of observation equations, or with initial values, need none,
    and none do where there are doses, before which they are zero. Columns of `groups` are inputs. A note names letters
    that are varying columns and might be parameters.
    """
    from commonlaw.estimation.model import ModelText

    schemas = [law.observation.measured for law in laws]
    if not equations:
        return source.load(schemas[0])
    trials, text = source.load(), ModelText.of(equations[0])
    named = text.named
    trials = as_named(trials, named, "; ".join(equations))
    columns = (*trials.schema.states, *trials.schema.inputs)
    may_be_latent = text.beyond_equations or dosed or trials.schema.administered
    states = tuple(name for name in named if name in columns or not (may_be_latent or name in starts))
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
    letters = [name for name in inputs if name in trials.schema.states and is_letter(name)]
    listed = f"inputs, as columns of the table: {', '.join(letters)}; rename a parameter that is meant"
    notes = [listed] if letters and "inputs" not in source.roles else []
    try:
        trials = source.reading(states=states, inputs=source.roles.get("inputs", inputs)).load()
        return trials.with_trials(trials.trials, *notes)
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
)


@dataclass(frozen=True)
class Outputs:
    """What is wanted of a law that was learned."""

    save: tuple[str, ...]
    as_json: bool

    @property
    def draws(self) -> bool:
        """Whether a figure is wanted."""
        return any(is_of_kind(file, "figure") for file in self.save)

    def give(self, learned: "FitResult", later: Artifacts) -> None:
        """Write the files and print the rest."""
        from commonlaw.law.tables import coefficient_rows

        summary, law = learned.summary, learned.summary.law
        table = partial(coefficient_rows, law)
        report = partial(page, summary.findings, learned.program, lambda _: None, summary.everything)
        later.save(self.save, law=law, figure=learned.figure, table=table, report=report)
        if self.as_json:
            print_json(learned.document())
        else:
            learned.show()
        later.end(learned.notes(), silent=self.as_json)


with_outputs = as_one("outputs", Outputs, _OPTIONS)
"""Adds the options that say what is wanted of a law to a command, which receives them as `outputs`."""


@dataclass(frozen=True)
class FitResult:
    """What was found out about a law, and where a program finds the trials."""

    summary: "Summary"
    program: "Program | str" = ""

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
        from commonlaw.summary import Summary
        from commonlaw.verdict import Findings, find

        name = source.dataset
        truth = later.take("the true law was not found", lambda: truth_of(name) if name else None, None)
        unchecked = Findings(law, trials, training)
        findings = later.take("the law was not checked", lambda: find(law, trials, training, bands), unchecked)
        program = source.streamed_program() if stream else source.program(trials) if source.path else ""
        return cls(Summary(findings, stream=stream, truth=truth), program)

    def figure(self, plots: Any) -> "Figure":
        """Return a figure of the law and its fit, or else its forecasts; raise `CommonlawError` if there are none."""
        findings = self.summary.findings
        if findings.shown is None:
            raise CommonlawError("curves-missing", reasons=findings.failures or ["the law was not checked"])
        figure: Figure = plots.plot_law(findings.law, findings.shown, truth=self.summary.truth)
        return figure

    def show(self) -> None:
        """Print the law, how well it forecasts, and the most probable candidates."""
        from commonlaw.law.tables import MEANINGS

        summary = self.summary
        print_layouts(summary.findings.training)
        say(f"{summary.counts}\n")
        print_law(summary.law, summary.parameters)
        say("\n".join(("", *summary.scores)))
        if summary.findings.verdict:
            say(f"\n{summary.findings.verdict}")
        if summary.textbook is not None:
            say(f"\n{summary.textbook}")
        if len(candidates := summary.candidates):
            say("\nCandidate laws (* chosen):\n")
            few = candidates[(candidates.groupby("equation").cumcount() < 4) | (candidates[""] == "*")]
            print_frame(few)
            if len(few) < len(candidates):
                say(f"\n{len(candidates) - len(few)} more with less support: commonlaw show LAW.json --history")
            for meaning in (text for name, text in MEANINGS.items() if name in candidates):
                say(f"\n{meaning}.")

    def document(self) -> dict[str, object]:
        """Return all results for ``--json``."""
        from commonlaw.law.misfit import misfit_lines
        from commonlaw.law.tables import interval_frame

        summary, findings = self.summary, self.summary.findings
        law, truth, forecast, verdict = findings.law, summary.truth, findings.forecast, findings.verdict
        return {
            "law": json.loads(to_json(law)),
            "equations": {name: list(law.equations(name)) for name in law.objects},
            "intervals": None if law.uncertainty.covariance is None else interval_frame(law).to_dict(orient="records"),
            "misfit": misfit_lines(law),
            "history": [asdict(step) for step in law.history],
            "truth": None if truth is None else json.loads(to_json(truth)),
            "fit": findings.fit
            and {"score": findings.fit.score(), "errors": findings.fit.errors().to_dict(orient="records")},
            "forecast": forecast
            and {
                "of": "held out" if findings.is_held_out else "training",
                "title": forecast.title,
                "score": forecast.score(),
                "errors": forecast.errors().to_dict(orient="records"),
            },
            "textbook": summary.textbook and summary.textbook.as_dict(),
            "verdict": verdict and asdict(verdict) | {"usable": verdict.usable, "sentences": verdict.sentences},
            "notes": list(findings.training.notes),
            "outcomes": [str(outcome) for outcome in (*law.diagnostics, *(forecast.outcomes if forecast else ()))],
        }

    def notes(self) -> list[object]:
        """Return what else there is to know."""
        findings = self.summary.findings
        outcomes = findings.forecast.outcomes if findings.forecast else ()
        notes = [note for note in self.summary.notes if note not in layouts(findings.training)]
        return [*notes, *findings.failures, *outcomes]


def command_line() -> str:
    """Return this command as words of a shell, which a shell takes as they were given."""
    return as_text(shlex.join(["commonlaw", *sys.argv[1:]]))


def page(
    findings: "Findings", program: "Program | str", show: ProgressCallback, everything: "ManyFindings | None" = None
) -> bytes:
    """Return a page about a law, its findings, and how it is made again."""
    from commonlaw.report import law_report, to_page

    made = law_report(findings, command_line(), program, in_options, show, everything=everything)
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
        from commonlaw.summary import Summary
        from commonlaw.verdict import Findings

        find_all = partial(find_by_stream, law, source.held_out(trials), show, training)
        everything = later.take("the law was not checked", find_all, None)
        findings = Findings(law, few, few) if everything is None else replace(everything.few, law=everything.law)
        return FitResult(Summary(findings, everything, training), source.streamed_program()), later
    show("checking the law by forecasts of a few trials")
    return FitResult.check(law, source, few, few, outputs.draws, later, trials), later
