"""A law with all that a report says of it, the sections that say it, and reports of few objects or of many."""

import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from commonlaw import __version__
from commonlaw.errors import CommonlawError
from commonlaw.experiments import suggestions
from commonlaw.forecast import Forecast
from commonlaw.inference import CandidateLaw, candidate_laws
from commonlaw.inference.settings import STRONG
from commonlaw.law import Law, relations_frame, to_script
from commonlaw.law.alignment import TRIALS
from commonlaw.law.equilibria import depends_on, has_phase_plane
from commonlaw.law.parameters import named_parameters, state_rates, units_with_rates
from commonlaw.law.pooling import comparable_groups, contrasts
from commonlaw.law.provenance import Domain, levels_by_group, levels_in_words
from commonlaw.law.script import Source
from commonlaw.law.tables import (
    MEANINGS,
    coefficient_names,
    quantile_frame,
    spread_tables,
    with_unit,
)
from commonlaw.law.text import MANY
from commonlaw.likelihood import ERRORS
from commonlaw.plots import (
    ForecastPanels,
    IntervalPanels,
    ResidualPanels,
    plot_discrepancy,
    plot_errors,
    plot_forecast,
    plot_intervals,
    plot_phase_plane,
    plot_relations,
    plot_textbook,
)
from commonlaw.plots.forecast import relative_errors, representative
from commonlaw.plots.style import unit_text
from commonlaw.report import front
from commonlaw.report.document import (
    Block,
    Fold,
    Gallery,
    Picture,
    Report,
    Section,
    Table,
    Text,
    check_packages,
    to_page,
)
from commonlaw.report.front import FAILURES, ends, folded, listed, picture, said
from commonlaw.report.markup import code, literal
from commonlaw.report.page import Page
from commonlaw.runtime.arguments import check_type
from commonlaw.runtime.progress import on_terminal
from commonlaw.stream import ManyFindings, find_by_stream
from commonlaw.summary import Summary
from commonlaw.text import counted
from commonlaw.trials import Schema, Trials, TrialStream
from commonlaw.trials.roles import GUESSED
from commonlaw.trials.stream import in_memory_or_by_file
from commonlaw.verdict import Findings, find

if TYPE_CHECKING:
    from distributed import Client


def data_checks(case: Summary) -> Iterator[Block]:
    """Yield what the data checks found."""
    checked = case.findings.trials.check(order=0)  # What trials cannot tell is among the outcomes of the law
    notes = [note for note in dict.fromkeys(checked.notes) if not note.startswith(GUESSED)]
    remarks = [*checked.lines(), *notes, *map(str, case.law.diagnostics)]
    problems = listed([said(case, remark) for remark in remarks]) if remarks else " Data checks: no problem found."
    yield Text(f"{case.counts}.{problems}")
    frame = checked.to_frame().drop(columns="clipped")
    frame.columns = [_head(name, case.findings.trials.schema) for name in frame.columns]
    yield folded(Table("trials", "All trials.", frame), "All trials")


def _head(name: str, schema: Schema) -> str:
    """Return the head of a column of figures of trials, in the words of the table and with its unit."""
    state, _, kind = name.partition(" (")
    if name in ("duration", "median_step", "largest_deviation"):
        return with_unit(name.replace("_", " "), schema.units.get(schema.time))
    if kind in ("first)", "last)"):
        return with_unit(f"{kind[:-1]} {state}", schema.units.get(state))
    return {"object": schema.object, "trial": schema.trial}.get(name, name)


def choices(case: Summary) -> Iterator[Block]:
    """Yield every choice on the way."""
    rows = [(step.stage, step.choice, case.words(step.reason)) for step in case.law.history]
    frame = pd.DataFrame(rows, columns=["stage", "choice", "reason"])
    history = Table("history", "Choices in the search, with their reasons.", frame)
    yield history if rows else Text("No history is recorded.")


def methods(case: Summary) -> Iterator[Block]:
    """Yield how the law was estimated, with its formulas."""
    if case.law.order == 0:
        squares = r"$\min_c \sum_k (x_{k+1} - f(x_k; c))^2$"
        yield Text(f"Coefficients are least squares estimates from each sample to the next: {squares}.")
        return
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
    yield Text(text)


def again(case: Summary, command: str, table: str | Source) -> Section:
    """Return the part that says how to make the law again."""
    text = f"Command:{code(command, 'sh')}" if command else ""
    if table:
        is_said = isinstance(table, Source) and not table.stream
        is_whole = case.findings.training is case.findings.trials or is_said
        some = "" if is_whole else ", which uses all trials of the table"
        text += f"In Python{some}:{code(to_script(case.law, table), 'python')}"
    versions = [f"Python {platform.python_version()}", f"commonlaw {__version__}"]
    for name in ("numpy", "scipy", "pandas", "matplotlib", "heyoka"):
        with suppress(PackageNotFoundError):
            versions.append(f"{name} {version(name)}")
    return Section("again", "Reproduction", (Text(f"{text}Made with {', '.join(versions)}."),))


def residuals(case: Summary) -> Iterator[Block]:
    """Yield residuals and the discrepancy."""
    yield from _patterns(case)
    yield from _discrepancy(case)
    yield from _errors(case)


def _patterns(case: Summary) -> Iterator[Block]:
    """Yield what measurements are off the law's trajectories, and which patterns that has."""
    try:
        tested = case.law.residuals(case.findings.trials)
    except FAILURES as error:
        yield Text(f"The residuals could not be tested: {said(case, error)}.")
        return
    meaning = "Residuals are measured minus fitted, in standard deviations of the noise. "
    meaning += "Orange: means of neighbouring residuals with 95 % intervals."
    if len(tested.significant) > 1:
        meaning += " Several patterns often have one cause: start with the smallest p-value."
    yield Text(meaning + listed([said(case, line) for line in str(tested).splitlines()]))
    # Small figures of residuals, those of the first state at once
    panels = ResidualPanels(tested)
    for j, state in enumerate(tested.trials.schema.states):
        pictures = [
            Picture(f"residuals-{j + 1}-{k + 1}", f"**Residuals of {literal(state)}.** {literal(caption)}", draw)
            for k, caption in enumerate(panels.captions(j))
            for draw in [partial(panels.draw, j, k)]
        ]
        gallery = Gallery(tuple(pictures))
        yield Fold(f"Residuals of {literal(state)}", (gallery,)) if j else gallery
    tests = tested.tests()
    if len(tests):
        yield Fold("Tests of the residuals", (Table("tests", "adjusted: p-values by false discovery rate.", tests),))


def _discrepancy(case: Summary) -> Iterator[Block]:
    if len(case.law.objects) > 100:
        yield Text("A discrepancy shared by all objects was not estimated: there are many objects.")
        return
    try:
        estimate = case.law.discrepancy(case.findings.training)
    except FAILURES as error:
        yield Text(f"A discrepancy shared by all objects could not be estimated: {said(case, error)}.")
        return
    of = literal(f"{estimate.basis.coordinate} in {estimate.equation}")
    strength = f"2 log B = {estimate.evidence:.1f}".replace("-", "−")
    if estimate.claimed:
        yield Text(f"Strong evidence for a discrepancy shared by all objects, a function of {of} ({strength}).")
    else:
        yield Text(
            f"No strong evidence for a discrepancy shared by all objects. The most probable is a function of {of} "
            f"({strength}; above {STRONG:.0f} is strong)."
        )
    picture = Picture("discrepancy", "Discrepancy with its 95 % band.", partial(plot_discrepancy, estimate))
    lines = Text(listed([said(case, line) for line in str(estimate).splitlines()]))
    yield Fold("Discrepancy", (picture, lines))


def _errors(case: Summary) -> Iterator[Block]:
    """Yield the errors of measurement, and whether the law itself errs."""
    law, errors, schema = case.law, case.law.uncertainty.error_model, case.law.observation.measured
    noise = law.uncertainty.noise
    if noise is not None:
        unit = schema.units.get(schema.time)
        time = f"{errors.memory:.3g} {unit or f'units of {schema.time}'}"
        kinds = (
            ("noise", noise),
            (f"autocorrelated errors ({time})", errors.correlated),
            (f"random walk in one {unit or f'unit of {schema.time}'}", errors.sensor_walk),
            ("drift at first", errors.offset),
            (f"drift per {unit or f'unit of {schema.time}'}", errors.slope),
            (f"mean drift per {unit or f'unit of {schema.time}'}", errors.trend),
        )
        levels = [f"{kind} of {levels_in_words(std, schema)}" for kind, std in kinds if std is not None]
        levels += [f"noise of {grown}" for grown in errors.heteroscedastic_in_words(schema.states).values()]
        if errors.by_object:
            levels.append(f"{ERRORS[errors.grouping].label}: {levels_by_group(errors, noise, schema)}")
        yield Text(f"Measurement errors: {literal('; '.join(levels))}.")
    if errors.of_law:
        yield Text("Forecast bands contain the process noise.")


def coefficients(case: Summary) -> Iterator[Block]:
    """Yield coefficients, and what decides them."""
    law, known = case.law, case.law.uncertainty.covariance is not None
    if law.uncertainty.explanation is not None and len(law.objects) > 1:
        caption = (
            "Coefficients explained by properties: kind, properties, factor, and standard deviation between objects. "
            "The factor of an affine function is its constant; the formula at the top has all of them."
        )
        yield Table("relations", caption, relations_frame(law).dropna(axis=1, how="all"))
        caption = "Estimates by object against properties that explain them."
        yield Picture("relation-plots", caption, partial(plot_relations, law))
    if not law.support.any():
        yield Text("The law has no term: all rates are zero.")
        return
    text = "Their standard errors are unknown."
    if known and case.findings.is_exact:
        text = "95 % intervals contain the true coefficient with a probability of 95 %, if the law holds."
    elif known:
        text = "Because of lack of fit, these are best-fitting rather than true values; their 95 % intervals "
        text += "reflect sampling error only."
    yield Text(text)
    parameters = named_parameters(law)
    free = ((parameters.errors != 0) | parameters.limited).any(axis=0)
    free[[p for _, p in parameters.at_bounds]] = True
    if given := [
        name for (name, _), is_free in zip(coefficient_names(law), free, strict=True) if known and not is_free
    ]:
        yield Text(f"Fixed: {literal(', '.join(given))}.")
    intervals, panels = ", with 95 % intervals" if known else "", IntervalPanels(law)
    if len(law.objects) == 1 or len(panels.captions) <= 2:
        yield Picture("intervals", f"Coefficients by object{intervals}.", partial(plot_intervals, law))
    else:  # One each, as a phone is narrow
        pictures = [
            Picture(f"intervals-{i + 1}", f"Coefficients {literal(what)}{intervals}.", partial(panels.draw, i))
            for i, what in enumerate(panels.captions)
        ]
        yield Gallery(tuple(pictures))
    if case.findings.fit is not None and has_phase_plane(law) and not depends_on(law, *law.schema.inputs):
        caption = "Phase plane: flow, nullclines, where one state is constant, fixed points and fitted trajectories."
        yield Picture("phase-plane", caption, partial(plot_phase_plane, law, case.findings.fit))
    for i, (name, (reference, *_)) in enumerate(comparable_groups(law).items() if known else ()):
        title = f"Differences from {name} {reference}"
        try:
            frame = contrasts(law, name, reference)
        except CommonlawError as error:
            yield Text(f"{literal(title)}: {said(case, error)}.")
            continue
        if len(frame):
            frame = frame.drop(columns="reference").dropna(axis=1, how="all")
            frame.columns = [name if column == "value" else column for column in frame.columns]
            caption = f"{literal(title)}, with 95 % intervals of Student's t that contain the scatter between objects."
            yield folded(Table(f"contrasts-{i + 1}", caption, frame), title)


def candidates(case: Summary) -> Iterator[Block]:
    """Yield the candidate laws."""
    law, frame = case.law, case.candidates
    if not len(frame):
        yield Text("The terms were given; no other law was compared.")
        return
    if case.rivals or len(law.objects) <= 100:  # Of more, fits take long
        yield from _refitted(case, case.rivals or candidate_laws(law, case.findings.training, most=6))
    meanings = (f" {literal(meaning)}." for name, meaning in MEANINGS.items() if name in frame)
    yield from _textbook(case)
    caption = f"Candidates of each equation (* chosen).{''.join(meanings)}"
    yield folded(Table("compared", caption, frame), "Candidates")


def _textbook(case: Summary) -> Iterator[Block]:
    """Yield the nearest law of textbooks, and what it leaves."""
    if (textbook := case.textbook) is None:
        return
    yield Text(f"{literal(str(textbook))}")
    if not textbook.is_chosen:
        caption = "Residuals of the chosen law and of the nearest law of textbooks, measured minus fitted."
        yield Picture("textbook", caption, partial(plot_textbook, textbook))


def _refitted(case: Summary, found: Sequence[CandidateLaw]) -> Iterator[Block]:
    """Yield how laws of other sizes fit the same trials, and how they forecast held-out ones."""
    findings, held_out = case.findings, case.findings.is_held_out
    curves = findings.forecast if held_out else findings.shown
    if len(found) < 2 or curves is None:
        return
    again = [case.curves_of(candidate.law, curves.trials, curves.is_fit) for candidate in found]
    score = f"1 − R² of {'forecasts' if held_out else 'the fit'}"
    rows = [
        {
            "": "*" * candidate.chosen,
            "terms": candidate.size,
            "law": "; ".join(candidate.law.structure),
            "2 log B": candidate.evidence,
            score: None if of_candidate is None else 1 - of_candidate.score(),
        }
        for candidate, of_candidate in zip(found, again, strict=True)
    ]
    caption = "Laws with few to many terms, fitted to the same trials (* chosen)."
    if held_out:
        caption += " Forecasts of held-out trials."
    else:
        caption += " On training data R² favours many terms."
    yield Table("sizes", caption, pd.DataFrame(rows).dropna(axis=1, how="all"))


def experiments(case: Summary) -> Iterator[Block]:
    """Yield what to measure next."""
    designs = suggestions(case.law, case.findings.training)
    if not designs:
        if case.law.uncertainty.has_std and case.law.order != 0 and case.law.support.any():
            yield Text("No suggestion: all experiments in the range of the data diverge by one of the plausible laws.")
            return
        needs = "a law in continuous time of measured states, with a covariance matrix"
        yield Text(f"No suggestion: experimental design needs {needs}.")
        return
    intro = (
        "The most informative further trial, with initial conditions in the range of the data, and duration and "
        "sampling as before."
    )
    lines = []
    for purpose, design in designs.items():
        (planned,) = design.experiments
        sentences = " ".join(map(literal, design.sentences))
        lines.append(f"**{literal(purpose)}**: {literal(planned.text)}. {sentences}")
    yield Text(intro + listed(lines))


def ranges(case: Summary) -> Iterator[Block]:
    """Yield where the law may be used: what was visited when it was learned."""
    law, trials = case.law, case.findings.training
    schema, length = trials.schema, [float(np.ptp(trial.times)) for trial in trials]
    visited = law.provenance.domain.visited or Domain.of(trials, state_rates(law)).visited
    columns = {**visited, "trial duration": (min(length), max(length))}
    units = units_with_rates(law) | {"trial duration": schema.units.get(schema.time, "")}
    printed = {name: unit_text(units.get(name, "")) or None for name in columns}
    rows = [{"": name, "from": low, "to": high, "unit": printed[name]} for name, (low, high) in columns.items()]
    learned = "The law was fitted in the ranges below and extrapolates outside them. "
    given = "The law was given and compared with trials in the ranges below. "
    text = (learned if law.provenance.is_learned else given) + " ".join(map(literal, case.findings.sentences[:1]))
    if law.provenance.is_learned and law.uncertainty.explanation is None and len(law.objects) > 1:
        text += " Other objects are forecast with the mean coefficients."
    yield Text(text)
    yield Table("visited", "Range of the data.", pd.DataFrame(rows).dropna(axis=1, how="all"))


def fit(case: Summary) -> Iterator[Block]:
    """Yield trials as measured, with solutions of the law through them."""
    if (fit := case.findings.fit) is None:
        has_only = "a law in discrete time has forecasts only, see below"
        yield Text(f"No fitted curves: {has_only if case.law.order == 0 else 'see the forecasts below'}.")
        return
    yield Text(
        f"{said(case, case.score(fit))}. Initial conditions are estimated from all samples. R² is 1 for a perfect fit "
        f"and 0 for the mean of each trial.{_legend(fit)}"
    )
    yield from curve_blocks(fit, "fit")


def forecasts(case: Summary) -> Iterator[Block]:
    """Yield trials as measured, with forecasts from their first samples."""
    if (forecast := case.findings.forecast) is None:
        yield Text(listed([said(case, failure) for failure in case.findings.failures]))
        return
    yield Text(f"{said(case, case.score(forecast))}.{_legend(forecast)}")
    if case.findings.fit is not None:  # Else on the first page
        yield picture(forecast, "forecast")
    yield from curve_blocks(forecast, "forecast")


def _legend(forecast: Forecast) -> str:
    bands = " Bands: 95 % of the measurements expected." if forecast.std is not None else ""
    several = len(forecast.trials) > len(forecast.trials.objects)
    return f"{bands}{' Colours: trials of an object.' if several else ''}"


def curve_blocks(forecast: Forecast, kind: str) -> Iterator[Block]:
    """Yield figures of the other objects, tables of errors, and a figure of all; `kind` begins their names."""
    what, word = ("residual", "Residuals of the fit") if forecast.is_fit else ("error", "Errors of the forecasts")
    ranked, shown = [str(name) for name in relative_errors(forecast).index], representative(forecast)
    if others := [name for name in ranked if name not in shown]:
        # Of very many objects few lines of each
        few = len(others) <= MANY
        draw, size = (partial(plot_forecast, forecast), len(shown)) if few else (ForecastPanels(forecast).overview, 36)
        parts = [others[i : i + size] for i in range(0, len(others), size)]
        pictures = tuple(
            Picture(f"{kind}-{i + 1}", ends(forecast, part), partial(draw, part)) for i, part in enumerate(parts)
        )
        yield Fold(f"The other {counted(len(others), 'object')}", pictures if few else (Gallery(pictures),))
    yield Table(f"{kind}-by-state", f"{word} by state.", _by_state(forecast, what).dropna(axis=1, how="all"), 3)
    errors, units = forecast.errors(), forecast.trials.schema.units
    errors = errors if forecast.outcomes else errors.drop(columns="diverged after")
    errors = errors.assign(state=[with_unit(state, units.get(state)) for state in errors["state"]])
    named = {"rms error": f"RMS {what}", "largest error": f"largest {what}", "last error": f"last {what}"}
    errors.columns = [named.get(name, name) for name in map(str, errors)]
    yield folded(Table(f"{kind}-errors", f"{word} by trial.", errors, 3), f"{word} by trial")
    yield Fold(f"{word} of all trials", (Picture(f"{kind}-all", f"{word}.", partial(plot_errors, forecast)),))


def _by_state(forecast: Forecast, what: str) -> pd.DataFrame:
    frame, rows, schema = forecast.to_frame(), list[dict[str, object]](), forecast.trials.schema
    for state in schema.states:
        errors = frame[f"{state} error"].astype(float) * (-1.0 if forecast.is_fit else 1.0)
        seen = errors[np.isfinite(errors)]
        mean, rms = float(seen.mean()), float(np.sqrt((seen**2).mean()))
        row: dict[str, object] = {"state": state, "unit": schema.units.get(state), "measurements": len(seen)}
        row |= {f"mean {what}": 0.0 if abs(mean) <= 1e-3 * rms else mean, f"RMS {what}": rms}
        if f"{state} measured low" in frame and len(seen):
            inside = frame[state].between(frame[f"{state} measured low"], frame[f"{state} measured high"])
            row["within 95 % band"] = f"{100 * inside[seen.index].mean():.0f} %"
        rows.append(row)
    return pd.DataFrame(rows)


_PARTS: Mapping[str, Callable[[Summary], Iterator[Block]]] = {
    "Fit": fit,
    "Coefficients": coefficients,
    "Forecasts from the first samples": forecasts,
    "Candidate laws": candidates,
    "Residuals and discrepancy": residuals,
    "Range of validity": ranges,
    "Next experiment": experiments,
    "Data checks": data_checks,
    "History": choices,
    "Methods": methods,
}
"""The sections of a report by their titles; the names of the functions are those of their anchors."""


def law_page(
    law: Law, trials: Trials | TrialStream, learned: Trials | TrialStream | None = None, client: "Client | None" = None
) -> Page:
    """Return the report of a law as a page, see `Law.report`."""
    check_packages()
    check_type("trials", trials, (Trials, TrialStream), TRIALS)

    def in_memory(trials: Trials) -> Report:
        if isinstance(learned, TrialStream):
            raise CommonlawError("learned-not-in-memory")
        return law_report(find(law, trials, learned))

    def by_file(stream: TrialStream) -> Report:
        if isinstance(learned, Trials):
            raise CommonlawError("learned-not-a-stream")
        findings = find_by_stream(law, stream, on_terminal(), learned)
        return law_report(findings.few, table=Source("runs/*.parquet", stream=True), everything=findings)

    return Page(to_page(in_memory_or_by_file(trials, client, in_memory, by_file)).decode())


def law_report(
    findings: Findings,
    command: str = "",
    table: str | Source = "trials.csv",
    words: Callable[[str], str] = str,
    progress: Callable[[str], None] = lambda _: None,
    rivals: Sequence[CandidateLaw] = (),
    everything: ManyFindings | None = None,
    title: str = "",
    about: str = "",
) -> Report:
    """Return the report of a law.

    Parameters
    ----------
    findings
        The law and its assessment.
    command, table
        The command of the report and the file of the trials, as shown; empty if there is none.
    words
        Turns messages of the library into the words of the caller.
    progress
        Takes the text of each step.
    rivals
        Candidates that were fitted before, the law among them; default: fitted for the report.
    everything
        Results of all objects of a stream, if the findings are about a few of them.
    title, about
        The title, by default what textbooks call the law, or "A law of" the states; and a line below it, such as file,
        date and checksum.
    """
    check_packages()
    case = Summary(findings, everything, rivals=tuple(rivals), words=words)
    sections = list[Section]()
    for heading, part in (_PARTS if everything is None else {"All objects": all_objects, **_PARTS}).items():
        progress(heading.lower())
        sections.append(Section(part.__name__.replace("_", "-"), heading, tuple(part(case))))
    sections.append(again(case, command, table))
    return Report(title or front.title(case), front.summary(case, about), tuple(sections), tuple(front.blocks(case)))


def all_objects(case: Summary) -> Iterator[Block]:
    """Yield what holds of all objects of a stream."""
    assert case.everything is not None
    law = case.everything.law
    yield Text(f"{'. '.join(said(case, score) for score in case.scores)}.")
    relative = case.everything.relative.replace(np.inf, np.nan).dropna()
    if len(relative) > MANY:
        caption = "Errors of the forecasts of objects, in units of the spread of the states: quantiles."
        yield Table("errors-of-all", caption, quantile_frame({"rms error": relative.to_numpy()}, "object"))
    worst = case.everything.relative.iloc[::-1][:10]
    frame = pd.DataFrame({case.everything.errors.columns[0]: worst.index.astype(str), "rms error": worst.to_numpy()})
    caption = f"The {counted(len(worst), 'object')} with the worst forecasts, in the same units."
    yield Table("worst", caption, frame)
    if len(law.objects) <= MANY or not law.support.any():
        return
    if tables := spread_tables(law, 10, universal=False):  # What is universal is said above
        spread, farthest = tables
        yield Table("spread", "Coefficients of all objects: quantiles (letter values, Tukey 1977).", spread)
        caption = "The objects farthest from the medians, in standard deviations of a normal spread."
        yield Table("outlying", caption, farthest)
    yield Picture("coefficients-of-all", "Coefficients of all objects in order.", partial(plot_intervals, law))
