"""Part 10: how the threshold decides which terms are in the law."""

from collections.abc import Mapping, Sequence

import pandas as pd

from commonlaw.law import average_law
from commonlaw.report import Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.errata import GROUP_TABLE
from studies.falling_balls.inquiry import Inquiry, left_out
from studies.falling_balls.method import METHODS, coefficients_of
from studies.falling_balls.printed import printed_table, prints_as
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import PATH_BALL, PATH_DROP
from studies.falling_balls.threshold_choices import METHOD_NAMES, chosen_law, threshold_choices

_NAME, _TITLE = "sparsity-path", "How the threshold decides"
_DIGITS = {"single": 6, "group": 3}
_ERRONEOUS = ("0.005", "v")
"""Threshold and term of the cell of the group table that the erratum is about."""

Printed = Mapping[str, Mapping[str, str]]
"""Printed coefficients by threshold and term."""

Found = Mapping[str, Mapping[str, float]]
"""Coefficients by threshold and term."""


def sparsity_path(inquiry: Inquiry) -> Section:
    """Return the part on the thresholds."""
    drops = inquiry.drops
    if drops is None:
        return left_out(_NAME, _TITLE, inquiry.missing)
    trials = {"single": drops.select(object=PATH_BALL, trial=PATH_DROP), "group": drops.select(trial=PATH_DROP)}
    printed = {kind: _printed(kind) for kind in trials}
    found = {kind: _coefficients(kind, trial, printed[kind]) for kind, trial in trials.items()}
    paths = {kind: chosen_law(kind, trial, "bic").provenance.path() for kind, trial in trials.items()}
    choices = threshold_choices(drops, paths)
    tables = [
        Table(f"thresholds-{kind}", _TABLES[kind], _side_by_side(printed[kind], found[kind]), _DIGITS[kind])
        for kind in trials
    ]
    intervals = Table("threshold-intervals", _INTERVALS, _intervals(printed, paths))
    return Section(
        _NAME,
        _TITLE,
        (Text(_ASKED), *tables, intervals, *choices.blocks),
        (
            _single_table(printed["single"], found["single"]),
            _group_table(printed["group"], found["group"]),
            *choices.verdicts,
        ),
        {**{f"threshold_path_{kind}": own for kind, own in found.items()}, **choices.results},
    )


def _printed(kind: str) -> dict[str, dict[str, str]]:
    table = printed_table(f"threshold_path_{kind}")
    terms = table.columns[1:].tolist()
    return {threshold: dict(zip(terms, texts, strict=True)) for threshold, *texts in table.to_numpy().tolist()}


def _coefficients(kind: str, trials: Trials, printed: Printed) -> Found:
    """Return the average coefficients at each printed threshold."""
    laws = {threshold: average_law(METHODS[kind](trials, float(threshold))) for threshold in printed}
    return {threshold: coefficients_of(law, "average") for threshold, law in laws.items()}


def _differing(printed: Printed, found: Found) -> list[tuple[str, str]]:
    """Return threshold and term of the cells that do not come out to the digits printed."""
    return [
        (threshold, term)
        for threshold, cells in printed.items()
        for term, text in cells.items()
        if not prints_as(found[threshold].get(term, 0.0), text)
    ]


def _side_by_side(printed: Printed, found: Found) -> pd.DataFrame:
    """Return two rows for each threshold: the coefficients as printed and as found."""
    there = {term for rows in (printed, found) for cells in rows.values() for term, value in cells.items() if value}
    terms = [term for term in next(iter(printed.values())) if term in there]
    rows: list[dict[str, object]] = []
    for threshold, cells in printed.items():
        rows.append({"threshold": threshold, "source": "printed", **{term: cells[term] or None for term in terms}})
        own = {term: found[threshold].get(term) for term in terms}
        rows.append({"threshold": threshold, "source": "found", **own})
    return pd.DataFrame(rows).astype(object).pipe(lambda frame: frame.where(frame.notna(), None))


def _intervals(printed: Mapping[str, Printed], paths: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the intervals of thresholds that give the same terms, and the printed thresholds in each."""
    return pd.DataFrame(
        {
            "method": METHOD_NAMES[kind],
            "from": row["from"],
            "to": row["to"],
            "terms": row["terms"] or "none",
            "number": row["size"],
            "printed": ", ".join(text for text in printed[kind] if row["from"] <= float(text) < row["to"]) or None,
        }
        for kind, path in paths.items()
        for row in path.to_dict("records")
    )


def _single_table(printed: Printed, found: Found) -> Verdict:
    differing = _differing(printed, found)
    text = f"Thresholds of the {PATH_BALL.lower()}: {_tally(printed, differing)}."
    return Verdict("differs" if differing else "reproduced", text)


def _group_table(printed: Printed, found: Found) -> Verdict:
    """Compare the group table, of which one cell is known to be wrong."""
    differing = _differing(printed, found)
    text = f"Thresholds of the group, averaged over the balls: {_tally(printed, differing)}."
    if not differing:
        return Verdict("reproduced", text)
    if differing != [_ERRONEOUS]:
        return Verdict("differs", text)
    threshold, term = _ERRONEOUS
    value = found[threshold].get(term, 0.0)
    corrected = prints_as(value, GROUP_TABLE.found.removesuffix(term).replace(" ", ""))
    text += f" There {GROUP_TABLE.printed} is printed, and the method gives {value:+.3f} {term}."
    return Verdict("reproduced with correction" if corrected else "differs", text)


def _tally(printed: Printed, differing: Sequence[tuple[str, str]]) -> str:
    """Say how many cells agree; an empty cell agrees if the term is absent."""
    cells = sum(map(len, printed.values()))
    where = ", ".join(f"{term} at threshold {threshold}" for threshold, term in differing)
    return f"{cells - len(differing)} of {cells} cells come out to the digits printed{where and f', but not {where}'}"


_TABLES = {
    "single": (
        f"{PATH_BALL}, drop {PATH_DROP}, single trial: coefficients of the terms at each threshold, as printed and as "
        "found. An empty cell is a term that is not in the equation; terms that are in none have no column."
    ),
    "group": (
        f"All balls, drop {PATH_DROP}, group: coefficients at each threshold, averaged over the ten balls, as printed "
        "(rounded or cut off to few digits) and as found. An empty cell is a term that is not in the equations."
    ),
}
_INTERVALS = (
    f"All thresholds for drop {PATH_DROP}: from where to where the method gives the same terms, and the thresholds of "
    "the printed tables in each interval."
)
_ASKED = f"""
One number decides how many terms a law has: the threshold. The paper chose it by hand, and shows in two tables what
other thresholds give, for the {PATH_BALL.lower()} by itself and for all balls together. Here are both tables again.

A path over all thresholds need not be sampled. Every decision of the method is a comparison of a number with the
threshold, so the equation stays the same until the threshold passes the smallest number that stayed. The next equation
begins there, exactly.
"""
