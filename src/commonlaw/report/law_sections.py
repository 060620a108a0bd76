"""The parts of a law's report that say what it says and how well it holds."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.experiments import suggestions
from commonlaw.forecast import fitted
from commonlaw.inference import CandidateLaw, candidate_laws
from commonlaw.law import Law
from commonlaw.law.domain import Domain
from commonlaw.law.tables import MEANINGS, readable_candidates
from commonlaw.plots import IntervalPanels, plot_intervals, plot_relations
from commonlaw.plots.style import unit_text
from commonlaw.report.document import Block, Gallery, Picture, Section, Table, Text
from commonlaw.report.formulas import coefficient_names
from commonlaw.report.law_case import LawCase, folded, listed
from commonlaw.report.markup import literal
from commonlaw.wording import counted

_TOGETHER = 2
"""Coefficients of several objects in one figure."""

_MEASURES = {
    "held-out error": "Held-out error is the mean squared error on data that they were not fitted to.",
    "BIC": "BIC weighs the fit against the number of terms; lower is better.",
    "stability": "Stability is how often the least certain term is chosen again when trials are drawn anew.",
    **{name: f"{text}." for name, text in MEANINGS.items()},
}
"""What measures of candidates mean."""

_REFITTED = 100
"""Objects up to which candidates are fitted again, as it takes long."""


def coefficients(case: LawCase) -> Section:
    """Return the part on coefficients, and on what decides them."""
    law, blocks = case.law, list[Block]()
    if law.explanation is not None and len(law.objects) > 1:
        blocks += _relations(law)
    if law.support.any():
        known = law.covariance is not None
        what = "Coefficients by object, with the ends of their 95 % intervals." if known else "Coefficients by object."
        blocks.append(Text(_interval(case) if known else "How accurate they are is not known."))
        pairs = zip(coefficient_names(law), law.letter_values()[1].T, strict=True)
        given = [name for (name, _), errors in pairs if known and not errors.any()]
        if given:
            blocks.append(Text(f"Known, and not fitted: {literal(', '.join(given))}."))
        blocks.append(_intervals(law, what))
    else:
        blocks.append(Text("The law has no coefficient: it says that nothing changes."))
    return Section("coefficients", "Coefficients", tuple(blocks))


def values(law: Law) -> tuple[Block, ...]:
    """Return the numbers that stand beside the formula of a law: its coefficients, by object, with intervals."""
    if not law.letters:
        return ()
    ends = "" if law.covariance is None else ", with the ends of their 95 % intervals"
    return (folded(Table("values", f"Coefficients{ends}.", _by_object(law)), "Coefficients by object"),)


def _intervals(law: Law, caption: str) -> Block:
    """Return a figure of all coefficients; of many coefficients of several objects one each, as a phone is narrow."""
    panels = IntervalPanels(law)
    if len(law.objects) == 1 or len(panels.captions) <= _TOGETHER:
        return Picture("intervals", caption, partial(plot_intervals, law))
    intervals = "" if law.covariance is None else ", with 95 % intervals"
    pictures = [
        Picture(f"intervals-{i + 1}", f"Coefficients {literal(what)}{intervals}.", partial(panels.draw, i))
        for i, what in enumerate(panels.captions)
    ]
    return Gallery(tuple(pictures))


def _interval(case: LawCase) -> str:
    others = len(case.law.other_laws)
    averaged = f" They are averaged over the law and {counted(others, 'law')} that it could also be." if others else ""
    if case.findings.is_exact:
        holds = "" if others else ", if the law holds"
        return f"Each 95 % interval holds the true coefficient with a probability of 95 %{holds}.{averaged}"
    return (
        "As the law is not exact, these are not true values, but those that describe the measurements best; their 95 % "
        f"intervals say how well the measurements tell them.{averaged}"
    )


def _relations(law: Law) -> list[Block]:
    caption = (
        "What decides each coefficient: its kind, the properties that it follows, and how far objects stray. Factors "
        "of affine functions are their constants; the formula at the top has all of them."
    )
    relations = law.relations().dropna(axis=1, how="all")
    return [
        Table("relations", caption, relations),
        Picture(
            "relation-plots", "Each object's own estimates against what decides them.", partial(plot_relations, law)
        ),
    ]


def _by_object(law: Law) -> pd.DataFrame:
    """Return a row for each object with its coefficients and intervals; for terms of their own, for each of these."""
    if not law.shared or len(law.objects) == 1:
        return law.to_frame().reset_index() if law.covariance is None else law.intervals()
    columns: dict[str, Sequence[object]] = {law.schema.object: law.objects}
    values, _ = law.letter_values()
    low, high = law.letter_interval_ends()
    for (name, unit), own, *ends in zip(coefficient_names(law), values.T, low.T, high.T, strict=True):
        head = f"{name} ({unit})" if unit else name
        columns[head] = own.tolist()
        if np.isfinite(ends).all() and np.ptp(ends, axis=0).any():
            columns |= {f"{name} from": ends[0].tolist(), f"{name} to": ends[1].tolist()}
    return pd.DataFrame(columns)


def candidates(case: LawCase) -> Section:
    """Return the part on what else the law could be."""
    law, blocks = case.law, list[Block]()
    if not law.alternatives:
        text = "The terms were given, and nothing else was compared."
        return Section("candidates", "What else it could be", (Text(text),))
    if case.rivals or len(law.objects) <= _REFITTED:
        blocks += _refitted(case, case.rivals or candidate_laws(law, case.findings.training, most=6))
    table = Table("compared", _what_compared(case), readable_candidates(law.alternatives))
    return Section("candidates", "What else it could be", (*blocks, folded(table, "Candidates")))


def _what_compared(case: LawCase) -> str:
    """Return what the measures of candidates mean."""
    listed = case.law.alternatives
    caption = "Candidates of each equation, and what speaks for them; * marks those of the law."
    there = {name for each in listed for name in each.measures}
    caption += "".join(f" {said}" for name, said in _MEASURES.items() if name in there)
    return caption


def _refitted(case: LawCase, found: Sequence[CandidateLaw]) -> Iterator[Block]:
    """Yield how laws of other sizes fit the same trials, and how they forecast held-out ones."""
    if len(found) < 2 or case.findings.shown is None:
        return
    held_out, score = case.findings.is_held_out, "R² of forecasts" if case.findings.is_held_out else "R² of the fit"
    rows = [
        {
            "": "*" * each.chosen,
            "terms": each.size,
            "law": "; ".join(each.law.structure()),
            "2 log B": each.evidence,
            score: (value := _score(case, each.law)),
            "1 − R²": 1 - value,
        }
        for each in found
    ]
    caption = "Laws from few terms to many, fitted to the same trials; * marks the law."
    if held_out:
        caption += " Forecasts are those of held-out trials."
    else:
        caption += " R² favours many terms: it speaks for no law by itself."
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
    title, found = "What to measure next", suggestions(case.law, case.findings.training)
    if not found:
        text = "Nothing is suggested: that takes a law of continuous time that knows how accurate its coefficients are."
        return Section("experiments", title, (Text(text),))
    intro = (
        "One more trial like those that were made, from anywhere among the states that they visited: the one that is "
        "expected to tell most, by all that the law could be, with its errors."
    )
    lines = []
    for each in found:
        (planned,) = each.design.experiments
        said = " ".join(map(literal, each.design.sentences))
        lines.append(f"**{literal(each.purpose)}**: {literal(planned.text)}. {said}")
    return Section("experiments", title, (Text(intro + listed(lines)),))


def ranges(case: LawCase) -> Section:
    """Return the part on where the law may be used: what was visited when it was learned."""
    law, trials = case.law, case.findings.training
    schema, length = trials.schema, [float(np.ptp(trial.times)) for trial in trials]
    visited = law.provenance.domain.visited or Domain.of(trials, law.state_rates).visited
    columns = {**visited, "length of a trial": (min(length), max(length))}
    units, time = {name: schema.units.get(name, "") for name in columns}, schema.units.get(schema.time, "")
    for name, rate in law.state_rates:
        units[rate] = f"{units[name]}/{time}" if units[name] and time else ""
    units["length of a trial"] = time
    rows = [
        {"": name, "from": low, "to": high, "unit": unit_text(units[name]) or None}
        for name, (low, high) in columns.items()
    ]
    learned = "The law was learned from the ranges below, and says nothing certain outside of them. "
    given = "The law was given, and compared with trials in the ranges below. "
    text = (learned if law.provenance.is_learned else given) + " ".join(
        literal(each) for each in case.findings.sentences[:1]
    )
    if law.provenance.is_learned and law.explanation is None and len(law.objects) > 1:
        text += " Of objects that were not measured it knows the mean coefficients only."
    frame = pd.DataFrame(rows).dropna(axis=1, how="all")
    return Section("ranges", "Where it may be used", (Text(text), Table("visited", "What was visited.", frame)))
