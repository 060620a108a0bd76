"""The first page of a report, for readers of this page alone: the law, its fit, its numbers, and how good it is."""

import re
from collections.abc import Iterator
from functools import partial

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast
from commonlaw.forecast.forecast import squared_errors
from commonlaw.law.tables import quantities_by_object, shown_quantities
from commonlaw.plots import plot_forecast
from commonlaw.plots.forecast import omission, relative_errors, representative
from commonlaw.report.document import Block, Fold, Picture, Table, Text
from commonlaw.report.markup import law_markdown, literal
from commonlaw.summary import Summary, in_states, parameters_caption
from commonlaw.text import counted

FAILURES = (CommonlawError, ArithmeticError, np.linalg.LinAlgError)
"""Of what is computed of a law for a report, which says so then."""


def said(case: Summary, text: object) -> str:
    """Return a message as Markdown that shows it as it stands, in the words of whoever asked."""
    return literal(case.words(str(text)).replace("R^2", "R²"))


def folded(table: Table, title: str) -> Block:
    """Return a table, behind a line that opens it if it is long."""
    return table if len(table.frame) <= 12 else Fold(f"{title} ({len(table.frame)} rows)", (table,))


def listed(lines: "list[str] | tuple[str, ...]") -> str:
    """Return a Markdown list."""
    return "\n\n" + "\n".join(f"- {line}" for line in lines) + "\n\n"


def title(case: Summary) -> str:
    """Return what textbooks call the law, and what it is about."""
    law, textbook = case.law, case.textbook
    about, column = ", ".join(law.schema.states), law.schema.object
    if len(law.objects) > 1:
        is_noun = column.isalpha() and column.islower() and not column.endswith("s")
        about += f" of {counted(len(law.objects), column if is_noun else 'object')}"
    if textbook is None or not textbook.has_same_terms:
        return f"A law of {about}"
    return f"{re.sub(r' [(][^)]*[)]', '', textbook.title)}: {about}"


def summary(case: Summary, about: str) -> str:
    """Return what stands below the title, as Markdown: the law, how far it holds, how sure it is, what it leaves."""
    lines = [literal(about)] if about else []
    lines += [f"**{literal(case.findings.sentences[0])}**", law_markdown(case.law)]
    sentences = {
        "How sure": _how_sure(case),
        "What it leaves unexplained": _unexplained(case),
        "In short": _in_short(case),
    }
    return "\n\n".join([*lines, *(f"**{name}:** {text}" for name, text in sentences.items() if text)])


def _how_sure(case: Summary) -> str:
    """Return the probabilities of the law and the next one, and what the intervals mean."""
    law = case.law
    texts = ["The terms were given; no other law was compared."]
    if law.provenance.alternatives:
        best, *others = law.models
        probability = "above 0.999" if best.probability > 0.999 else f"of {best.probability:.3g}"
        texts = [f"Among the laws that were compared it has a probability {probability}."]
        if others:
            most = max(others, key=lambda model: model.probability)
            next_one = literal("; ".join(most.law.structure))
            texts.append(f"The next is {next_one}, with {most.probability:.2g}.")
    if law.uncertainty.covariance is not None and law.support.any():
        is_inexact = "" if case.findings.is_exact else ", but for the lack of fit"
        texts.append(f"A number such as 2.0 ± 0.1 is between 1.8 and 2.2 with a probability of 95 %{is_inexact}.")
    return " ".join(texts)


def _unexplained(case: Summary) -> str:
    """Return how large the residuals are, and whether they look like noise."""
    fit = case.findings.fit
    if fit is None or fit.outcomes:
        return ""
    sizes = literal(in_states(squared_errors(fit).mean().pow(0.5), fit))
    score = fit.score()
    text = f"{sizes}" + (f", {max(100 * (1 - score), 0.01):.2g} % of the variance" if np.isfinite(score) else "")
    try:
        tested = case.law.residuals(case.findings.trials)
    except FAILURES:
        return f"{text}."
    return f"{text}. {said(case, str(tested).splitlines()[0])}"


def _in_short(case: Summary) -> str:
    """Return what the equations are, for readers who do not know any."""
    law = case.law
    states, several = literal(" and ".join(law.schema.states)), len(law.schema.states) > 1
    what = "from one moment to the next" if law.order == 0 else "at every moment"
    shared = ""
    if len(law.objects) > 1:
        shared = f" All {len(law.objects)} objects follow the same equations, each with numbers of its own."
    change, present = ("change", "their present values") if several else ("changes", "its present value")
    return f"the equations say how {states} {change} {what}, given {present}.{shared}"


def blocks(case: Summary) -> Iterator[Block]:
    """Yield the picture of the fit, or of the forecasts where there is none, and the numbers."""
    for curves, kind in ((case.findings.fit, "fit"), (case.findings.forecast, "forecast")):
        if curves is not None:
            yield picture(curves, kind)
            break
    yield from values(case)
    if len(data := shown_quantities(case.law)):
        known = case.law.uncertainty.covariance is not None
        ends = ", with 95 % intervals; an infinite end says that there is none" if known else ""
        frame = quantities_by_object(case.law) if len(case.law.objects) > 1 else data
        yield folded(Table("quantities", f"Derived quantities{ends}.", frame, data=data), "Quantities")
    yield Text(listed([literal(sentence) for sentence in case.findings.sentences[1:]]))


def picture(curves: Forecast, kind: str) -> Picture:
    """Return the picture of a few objects that represent all."""
    shown, ranked = representative(curves), [str(name) for name in relative_errors(curves).index]
    omitted = f"{text}. " if (text := omission(curves, shown)) else ""
    what = "Points: measurements. Lines: " + (
        "the law. Below: measured minus fitted." if curves.is_fit else "forecasts."
    )
    return Picture(f"{kind}-objects", f"{what} {omitted}{ends(curves, ranked)}", partial(plot_forecast, curves))


def ends(curves: Forecast, names: "list[str] | tuple[str, ...]") -> str:
    """Return the errors of the first and the last of some objects."""
    what, rms = "residual" if curves.is_fit else "error", squared_errors(curves).groupby(level=0).mean().pow(0.5).T
    first_and_last = dict.fromkeys((names[0], names[-1]))
    texts = (f"**{literal(name)}** {literal(in_states(rms[name], curves))}" for name in first_and_last)
    return f"RMS {what}: {' to '.join(texts)}.".replace(r"\.", ".")


def values(case: Summary) -> tuple[Block, ...]:
    """Return the numbers that follow the formula of a law: its coefficients, by object, with intervals."""
    if not len(frame := case.parameters):
        return ()
    data = case.law.params.dropna(axis=1, how="all")
    table = Table("values", f"{parameters_caption(case.law)}.", frame, data=data)
    return (folded(table, "Coefficients by object"),)
