"""A law with all that a report says of it, and the sections that say it."""

import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version

import numpy as np
import pandas as pd

from commonlaw import __version__
from commonlaw.discrepancy.function import STRONG
from commonlaw.errors import CommonlawError
from commonlaw.experiments import suggestions
from commonlaw.forecast import Forecast, fitted
from commonlaw.inference import CandidateLaw, candidate_laws, levels_in_words
from commonlaw.law import Law, relations_frame, to_script
from commonlaw.law.equilibria import depends_on, has_phase_plane
from commonlaw.law.parameters import named_parameters, state_rates, units_with_rates
from commonlaw.law.pooling import comparable_groups, contrasts
from commonlaw.law.provenance import Domain
from commonlaw.law.script import Source
from commonlaw.law.tables import (
    MEANINGS,
    coefficient_names,
    coefficients_by_object,
    quantities_by_object,
    readable_candidates,
    shown_quantities,
    with_unit,
)
from commonlaw.plots import (
    IntervalPanels,
    ResidualPanels,
    plot_discrepancy,
    plot_intervals,
    plot_phase_plane,
    plot_relations,
)
from commonlaw.plots.style import unit_text
from commonlaw.report.document import Block, Fold, Gallery, Picture, Section, Table, Text
from commonlaw.report.markup import code, literal
from commonlaw.text import counted
from commonlaw.trials import Schema, Trials
from commonlaw.trials.roles import GUESSED
from commonlaw.verdict import Findings


@dataclass(frozen=True, eq=False)
class LawCase:
    """Findings and rival laws, and what turns messages into the words of the caller."""

    findings: Findings
    words: Callable[[str], str]
    rivals: tuple[CandidateLaw, ...] = ()

    @property
    def law(self) -> Law:
        """The law."""
        return self.findings.law

    @property
    def trials(self) -> Trials:
        """All that was measured."""
        return self.findings.trials

    @property
    def forecast(self) -> Forecast | None:
        """Forecasts that check the law; None if there are none."""
        return self.findings.forecast

    @property
    def forecast_of(self) -> str:
        """What the forecasts are of, in words."""
        if not self.law.provenance.is_learned:
            return "compared with it"
        if self.findings.is_held_out:
            return "held out"
        return f"of the training data{', later samples included' if self.findings.has_later_samples else ''}"

    def said(self, text: object) -> str:
        """Return a message as Markdown that shows it as it stands, in the words of whoever asked."""
        return literal(self.words(str(text)))


def folded(table: Table, title: str) -> Block:
    """Return a table, behind a line that opens it if it is long."""
    return table if len(table.frame) <= 12 else Fold(f"{title} ({len(table.frame)} rows)", (table,))


def listed(lines: "list[str] | tuple[str, ...]") -> str:
    """Return a Markdown list."""
    return "\n\n" + "\n".join(f"- {line}" for line in lines) + "\n\n"


def data_checks(case: LawCase) -> Section:
    """Return the part on what the data checks found."""
    found = case.trials.check(order=0)  # What trials cannot tell is among the outcomes of the law
    notes = [note for note in dict.fromkeys(found.notes) if not note.startswith(GUESSED)]
    remarks = [*found.lines(), *notes, *map(str, case.law.diagnostics)]
    said = " Data checks: no problem found." if not remarks else listed([case.said(remark) for remark in remarks])
    trials = case.trials
    objects, samples = counted(len(trials.objects), "object"), sum(map(len, trials))
    counts = f"{counted(len(trials), 'trial')} of {objects}, {samples} samples."
    learned, some = sum(map(len, case.findings.training)), counted(len(case.findings.training), "trial")
    held_out = "" if case.findings.training is trials else f" Training data: {learned} samples of {some}."
    frame = found.to_frame().drop(columns="clipped")
    frame.columns = [_head(name, trials.schema) for name in frame.columns]
    table = Table("trials", "All trials.", frame)
    return Section("data-checks", "Data checks", (Text(f"{counts}{held_out}{said}"), folded(table, "All trials")))


def _head(name: str, schema: Schema) -> str:
    """Return the head of a column of figures of trials, in the words of the table and with its unit."""
    state, _, kind = name.partition(" (")
    if name in ("duration", "median_step", "largest_deviation"):
        return with_unit(name.replace("_", " "), schema.units.get(schema.time))
    if kind in ("first)", "last)"):
        return with_unit(f"{kind[:-1]} {state}", schema.units.get(state))
    return {"object": schema.object, "trial": schema.trial}.get(name, name)


def choices(case: LawCase) -> Section:
    """Return the part on every choice on the way."""
    rows = [
        {"stage": each.stage, "choice": each.choice, "reason": case.words(each.reason)} for each in case.law.history
    ]
    block: Block = Text("No history is recorded.")
    if rows:
        block = Table("history", "Choices in the search, with their reasons.", pd.DataFrame(rows))
    return Section("choices", "History", (block,))


def in_short(case: LawCase) -> str:
    """Return a paragraph for readers without statistics, as Markdown."""
    law, fit = case.law, case.findings.fit
    states, objects = literal(" and ".join(law.schema.states)), len(law.objects)
    what = "from one moment to the next" if law.order == 0 else "at every moment"
    shared = "" if objects == 1 else f" All {objects} objects follow the same equations, each with numbers of its own."
    text = f"In short: the equations say how {states} changes {what}, given its present value.{shared}"
    if fit is not None and np.isfinite(score := fit.score()) and score > 0:
        text += f" They reproduce {min(100 * score, 99.99):.4g} % of the variation in the measurements."
    if law.uncertainty.covariance is not None and law.support.any():
        text += " A number such as 2.0 ± 0.1 means that values from 1.8 to 2.2 agree with the data."
    return f"\n\n{text}\n\n"


def methods(case: LawCase) -> Section:
    """Return the part on how the law was estimated, with its formulas."""
    if case.law.order == 0:
        text = "Coefficients are least squares estimates from each sample to the next: "
        text += r"$\min_c \sum_k (x_{k+1} - f(x_k; c))^2$."
        return Section("methods", "Methods", (Text(text),))
    text = (
        r"Each trial is a solution of $\dot{x} = f(x, u, t; c)$, measured with noise: $y_i = x(t_i) + \varepsilon_i$, "
        r"$\varepsilon_i \sim N(0, \sigma^2)$. Coefficients $c$ and initial conditions $x_0$ maximize the likelihood, "
        r"$\log L = -\frac{1}{2} \sum_i ((y_i - x(t_i))/\sigma)^2 - n \log \sigma$; standard errors are those of its "
        r"curvature, $(-\partial^2 \log L / \partial c^2)^{-1}$."
    )
    if case.law.provenance.alternatives:
        text += (
            r" Terms are chosen by evidence, $2 \log B = 2 \log (p(y | M_1) / p(y | M_2))$; above 10 is very strong "
            "(Kass and Raftery 1995)."
        )
    return Section("methods", "Methods", (Text(text),))


def again(case: LawCase, command: str, table: str | Source) -> Section:
    """Return the part that says how to make the law again."""
    asked = f"Command:{code(command, 'sh')}" if command else ""
    text = asked
    if table:
        is_said = isinstance(table, Source) and not table.stream
        is_whole = case.findings.training is case.trials or is_said
        some = "" if is_whole else ", which uses all trials of the table"
        text += f"In Python{some}:{code(to_script(case.law, table), 'python')}"
    versions = [f"Python {platform.python_version()}", f"commonlaw {__version__}"]
    for name in ("numpy", "scipy", "pandas", "matplotlib", "heyoka"):
        with suppress(PackageNotFoundError):
            versions.append(f"{name} {version(name)}")
    made_with = ", ".join(versions)
    return Section("again", "Reproduction", (Text(f"{text}Made with {made_with}."),))


_FAILURES = (CommonlawError, ArithmeticError, np.linalg.LinAlgError)


def residuals(case: LawCase) -> Section:
    """Return the part on residuals and the discrepancy."""
    blocks = (*_patterns(case), *_discrepancy(case), *_errors(case))
    return Section("residuals", "Residuals and discrepancy", blocks)


def _patterns(case: LawCase) -> Iterator[Block]:
    """Yield what measurements are off the law's trajectories, and which patterns that has."""
    try:
        found = case.law.residuals(case.trials)
    except _FAILURES as error:
        yield Text(f"The residuals could not be tested: {case.said(error)}.")
        return
    meaning = "Residuals are measured minus fitted, in standard deviations of the noise. "
    meaning += "Orange: means of neighbouring residuals with 95 % intervals."
    if len(found.significant) > 1:
        meaning += " Several patterns often have one cause: start with the smallest p-value."
    yield Text(meaning + listed([case.said(line) for line in str(found).splitlines()]))
    # Small figures of residuals, those of the first state at once
    panels = ResidualPanels(found)
    for j, state in enumerate(found.trials.schema.states):
        pictures = [
            Picture(f"residuals-{j + 1}-{k + 1}", f"**Residuals of {literal(state)}.** {literal(caption)}", draw)
            for k, caption in enumerate(panels.captions(j))
            for draw in [partial(panels.draw, j, k)]
        ]
        gallery = Gallery(tuple(pictures))
        yield Fold(f"Residuals of {literal(state)}", (gallery,)) if j else gallery
    tests = found.tests()
    if len(tests):
        yield Fold("Tests of the residuals", (Table("tests", "adjusted: p-values by false discovery rate.", tests),))


def _discrepancy(case: LawCase) -> Iterator[Block]:
    """Yield the discrepancy, a function that objects share."""
    if len(case.law.objects) > 100:
        yield Text("A discrepancy shared by all objects was not estimated: there are many objects.")
        return
    try:
        found = case.law.discrepancy(case.findings.training)
    except _FAILURES as error:
        yield Text(f"A discrepancy shared by all objects could not be estimated: {case.said(error)}.")
        return
    of = literal(f"{found.basis.coordinate} in {found.equation}")
    strength = f"2 log B = {found.evidence:.1f}".replace("-", "−")
    if found.claimed:
        yield Text(f"Strong evidence for a discrepancy shared by all objects, a function of {of} ({strength}).")
    else:
        yield Text(
            f"No strong evidence for a discrepancy shared by all objects. The most probable is a function of {of} "
            f"({strength}; above {STRONG:.0f} is strong)."
        )
    picture = Picture("discrepancy", "Discrepancy with its 95 % band.", partial(plot_discrepancy, found))
    lines = Text(listed([case.said(line) for line in str(found).splitlines()]))
    yield Fold("Discrepancy", (picture, lines))


def _errors(case: LawCase) -> Iterator[Block]:
    """Yield the errors of measurement, and whether the law itself errs."""
    law, errors, schema = case.law, case.law.uncertainty.error_model, case.law.schema
    if law.uncertainty.noise is not None:
        time = f"{errors.memory:.3g} {schema.units.get(schema.time, f'units of {schema.time}')}"
        kinds = (("noise", law.uncertainty.noise), (f"autocorrelated errors ({time})", errors.correlated))
        levels = [f"{kind} of {levels_in_words(own, schema)}" for kind, own in kinds if own is not None]
        levels += [f"noise of {grown}" for grown in errors.heteroscedastic_in_words(schema.states).values()]
        yield Text(f"Measurement errors: {literal('; '.join(levels))}.")
    if errors.of_law:
        yield Text("Lack of fit: the law includes process noise, which the forecast bands contain.")


_MEASURES = {
    "held-out error": "Held-out error is the mean squared error on held-out data.",
    "BIC": "BIC penalizes the misfit by the number of terms; lower is better.",
    "stability": "Stability is the share of bootstrap resamples in which the least certain term is selected.",
    **{name: f"{text}." for name, text in MEANINGS.items()},
}
"""What measures of candidates mean."""


def coefficients(case: LawCase) -> Section:
    """Return the part on coefficients, and on what decides them."""
    law, blocks = case.law, list[Block]()
    if law.uncertainty.explanation is not None and len(law.objects) > 1:
        caption = (
            "Coefficients explained by properties: kind, properties, factor, and standard deviation between objects. "
            "The factor of an affine function is its constant; the formula at the top has all of them."
        )
        blocks.append(Table("relations", caption, relations_frame(law).dropna(axis=1, how="all")))
        caption = "Estimates by object against properties that explain them."
        blocks.append(Picture("relation-plots", caption, partial(plot_relations, law)))
    if law.support.any():
        known = law.uncertainty.covariance is not None
        what = "Coefficients by object with 95 % intervals." if known else "Coefficients by object."
        others = len(law.uncertainty.other_laws)
        text = "Their standard errors are unknown."
        if known and case.findings.is_exact:
            holds = "" if others else ", if the law holds"
            text = f"95 % intervals contain the true coefficient with a probability of 95 %{holds}."
        elif known:
            text = "Because of lack of fit, these are best-fitting rather than true values; their 95 % intervals "
            text += "reflect sampling error only."
        if known and others:
            text += f" They are averaged over the law and {counted(others, 'other plausible law')}."
        blocks.append(Text(text))
        pairs = zip(coefficient_names(law), named_parameters(law).errors.T, strict=True)
        given = [name for (name, _), errors in pairs if known and not errors.any()]
        if given:
            blocks.append(Text(f"Fixed: {literal(', '.join(given))}."))
        blocks.append(_intervals(law, what))
        if len(data := shown_quantities(law)):
            ends = ", with 95 % intervals; an infinite end says that there is none" if known else ""
            caption = f"Quantities that follow from the coefficients{ends}."
            frame = quantities_by_object(law) if len(law.objects) > 1 else data
            blocks.append(folded(Table("quantities", caption, frame, data=data), "Quantities"))
        if case.findings.fit is not None and has_phase_plane(law) and not depends_on(law, *law.schema.inputs):
            caption = (
                "Phase plane: flow, nullclines, where one state is constant, fixed points and fitted trajectories."
            )
            blocks.append(Picture("phase-plane", caption, partial(plot_phase_plane, law, case.findings.fit)))
        blocks += _contrasts(case) if known else ()
    else:
        blocks.append(Text("The law has no term: all rates are zero."))
    return Section("coefficients", "Coefficients", tuple(blocks))


def values(law: Law) -> tuple[Block, ...]:
    """Return the numbers that follow the formula of a law: its coefficients, by object, with intervals."""
    if not named_parameters(law).names:
        return ()
    known = law.uncertainty.covariance is not None
    caption = "Coefficients ± standard errors, with 95 % intervals." if known else "Coefficients."
    frame, data = coefficients_by_object(law), law.params.dropna(axis=1, how="all")
    # Of one object without trials of their own a row for each coefficient
    table = Table("values", caption, frame if len(frame) > 1 else data, data=data)
    return (folded(table, "Coefficients by object"),)


def _intervals(law: Law, caption: str) -> Block:
    """Return a figure of all coefficients; of many coefficients of several objects one each, as a phone is narrow."""
    panels = IntervalPanels(law)
    if len(law.objects) == 1 or len(panels.captions) <= 2:
        return Picture("intervals", caption, partial(plot_intervals, law))
    intervals = "" if law.uncertainty.covariance is None else ", with 95 % intervals"
    pictures = [
        Picture(f"intervals-{i + 1}", f"Coefficients {literal(what)}{intervals}.", partial(panels.draw, i))
        for i, what in enumerate(panels.captions)
    ]
    return Gallery(tuple(pictures))


def _contrasts(case: LawCase) -> Iterator[Block]:
    """Yield how parameters differ between groups of objects, for each property that makes some."""
    for i, (name, (reference, *_)) in enumerate(comparable_groups(case.law).items()):
        title = f"Differences from {name} {reference}"
        try:
            frame = contrasts(case.law, name, reference)
        except CommonlawError as error:
            yield Text(f"{literal(title)}: {case.said(error)}.")
            continue
        if len(frame):
            frame = frame.drop(columns="reference").dropna(axis=1, how="all")
            frame.columns = [name if column == "value" else column for column in frame.columns]
            caption = f"{literal(title)}, with 95 % intervals of Student's t that contain the scatter between objects."
            yield folded(Table(f"contrasts-{i + 1}", caption, frame), title)


def candidates(case: LawCase) -> Section:
    """Return the part on candidate laws."""
    law, blocks, listed = case.law, list[Block](), case.law.provenance.alternatives
    if not listed:
        text = "The terms were given; no other law was compared."
        return Section("candidates", "Candidate laws", (Text(text),))
    if case.rivals or len(law.objects) <= 100:  # Of more, fits take long
        blocks += _refitted(case, case.rivals or candidate_laws(law, case.findings.training, most=6))
    caption = "Candidates of each equation (* chosen)."
    there = {name for each in listed for name in each.measures}
    caption += "".join(f" {said}" for name, said in _MEASURES.items() if name in there)
    table = Table("compared", caption, readable_candidates(listed))
    return Section("candidates", "Candidate laws", (*blocks, folded(table, "Candidates")))


def _refitted(case: LawCase, found: Sequence[CandidateLaw]) -> Iterator[Block]:
    """Yield how laws of other sizes fit the same trials, and how they forecast held-out ones."""
    if len(found) < 2 or case.findings.shown is None:
        return
    held_out = case.findings.is_held_out
    score = f"1 − R² of {'forecasts' if held_out else 'the fit'}"
    rows = [
        {
            "": "*" * each.chosen,
            "terms": each.size,
            "law": "; ".join(each.law.structure),
            "2 log B": each.evidence,
            score: 1 - _score(case, each.law),
        }
        for each in found
    ]
    caption = "Laws with few to many terms, fitted to the same trials (* chosen)."
    if held_out:
        caption += " Forecasts of held-out trials."
    else:
        caption += " On training data R² favours many terms."
    yield Table("sizes", caption, pd.DataFrame(rows).dropna(axis=1, how="all"))


def _score(case: LawCase, law: Law) -> float:
    """Return R^2 of what is held out, or else of the fit; NaN where there is none."""
    found = case.findings
    try:
        if found.fit is not None and not found.is_held_out:
            return fitted(law, found.training).score()
        return law.predict(found.forecast.trials, start=found.start).score() if found.forecast else float("nan")
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return float("nan")


def experiments(case: LawCase) -> Section:
    """Return the part on what to measure next."""
    title, found = "Next experiment", suggestions(case.law, case.findings.training)
    if not found:
        needs = "a law in continuous time of measured states, with a covariance matrix"
        text = f"No suggestion: experimental design needs {needs}."
        return Section("experiments", title, (Text(text),))
    intro = (
        "The most informative further trial, with initial conditions in the range of the data, and duration and "
        "sampling as before."
    )
    lines = []
    for purpose, design in found.items():
        (planned,) = design.experiments
        said = " ".join(map(literal, design.sentences))
        lines.append(f"**{literal(purpose)}**: {literal(planned.text)}. {said}")
    return Section("experiments", title, (Text(intro + listed(lines)),))


def ranges(case: LawCase) -> Section:
    """Return the part on where the law may be used: what was visited when it was learned."""
    law, trials = case.law, case.findings.training
    schema, length = trials.schema, [float(np.ptp(trial.times)) for trial in trials]
    visited = law.provenance.domain.visited or Domain.of(trials, state_rates(law)).visited
    columns = {**visited, "trial duration": (min(length), max(length))}
    units = units_with_rates(law) | {"trial duration": schema.units.get(schema.time, "")}
    rows = [
        {"": name, "from": low, "to": high, "unit": unit_text(units.get(name, "")) or None}
        for name, (low, high) in columns.items()
    ]
    learned = "The law was fitted in the ranges below and extrapolates outside them. "
    given = "The law was given and compared with trials in the ranges below. "
    text = (learned if law.provenance.is_learned else given) + " ".join(
        literal(sentence) for sentence in case.findings.sentences[:1]
    )
    if law.provenance.is_learned and law.uncertainty.explanation is None and len(law.objects) > 1:
        text += " Other objects are forecast with the mean coefficients."
    frame = pd.DataFrame(rows).dropna(axis=1, how="all")
    return Section("ranges", "Range of validity", (Text(text), Table("visited", "Range of the data.", frame)))
