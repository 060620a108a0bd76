"""What a law says as tables, and how numbers of very many objects are spread."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.law.provenance import Alternative
from commonlaw.law.text import Written, probability_text, rounded
from commonlaw.text import counted

_MORE_TERMS = 2

_WITH_ERRORS = ("coefficient", "estimate", "factor", "standard error", "low", "high")
"""Columns, or how they begin, whose digits mean something as far as the column of standard errors says."""

MOST_DRAWS = 10_000_000
"""Draws of coefficients; more say nothing that these do not."""

LOG_SCORE = "log score difference"
"""How far forecasts of held-out data are less probable than those of the chosen law, in logarithms: 0 is best."""

_MEASURES = ("held-out error", "standard error", "BIC", "stability", "2 log B", "probability", LOG_SCORE)
"""What is shown of a candidate, as far as it is there."""

_COMPARING = ("2 log B", LOG_SCORE, "held-out error", "BIC", "AIC")
"""What candidates are compared by, the first that is there."""

MEANINGS = {
    "2 log B": "2 log B: evidence against a law relative to the best; above 10 is very strong (Kass and Raftery 1995)",
    LOG_SCORE: f"{LOG_SCORE}: how much less probable held-out data are by forecasts of a law, in logarithms; none if "
    "they diverge",
}
"""What stands beside a table with one of these measures."""


def readable(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table with the digits that mean something: numbers as far as their errors let them be.

    Coefficients, errors and ends of intervals have the decimal places of the standard error's second digit, and
    probabilities below 1e-9 are just that.
    """
    shown, errors = frame.copy(), frame.get("standard error")
    for name in map(str, frame.columns):
        if "probability" in name:
            texts = [probability_text(each) for each in frame[name]]
        elif errors is not None and name.startswith(_WITH_ERRORS):
            texts = [rounded(*pair) for pair in zip(frame[name], errors, strict=True)]
        else:
            continue
        shown[name] = pd.Series(map(Written, texts), frame.index, dtype=object).where(frame[name].notna(), Written())
    return shown


def interval_frame(law: Any, level: float = 0.95, averaged: bool = True) -> pd.DataFrame:
    """Return `Law.conf_int` by the names of columns that are kept stable where tables are saved.

    Without averages, where there is something to average over, the ends follow as "low given these terms" and "high
    given these terms".
    """
    found: pd.DataFrame = law.conf_int(level, averaged)
    by_name, ends = bool(law.provenance.equations), ["low", "high"]
    if averaged and law.uncertainty.other_laws and not by_name:
        alone = law.conf_int(level, averaged=False)
        after = [*found.columns].index("high") + 1
        for i, end in enumerate(ends):
            found.insert(after + i, f"{end} given these terms", alone[end])
    found["unit"] = found.pop("unit")
    found = found.drop(columns=["equation", "term"] if by_name else ["parameter"])
    saved = {"estimate": "coefficient", "inclusion probability": "term probability"}
    found.columns = pd.Index([saved.get(each, each) for each in found.columns])
    return found if found["unit"].any() else found.drop(columns="unit")


def coefficient_rows(law: Any) -> pd.DataFrame:
    """Return `Law.params` as a table for other programs; what is not known is empty.

    Columns are object, equation, term (or of a law of given equations parameter), value, standard error, low, high and
    unit.
    """
    names = ["parameter"] if law.provenance.equations else ["equation", "term"]
    found: pd.DataFrame = law.params[["object", *names, "estimate", "standard error", "low", "high", "unit"]]
    return found.set_axis(["object", *names, "value", "standard error", "low", "high", "unit"], axis=1)


def comparison_frame(alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the candidates of each equation from the best to the worst, see `Law.comparison`."""
    found = []
    for equation in dict.fromkeys(each.equation for each in alternatives):
        own = [each for each in alternatives if each.equation == equation]
        names = [name for each in own for name in each.measures]
        measure = next((name for name in _COMPARING if name in names), names[0] if names else "")
        rows = candidate_frame(own).assign(measure=measure)
        scores = rows[measure].astype(float) if measure else pd.Series(np.nan, rows.index)
        rows["score"], rows["difference"] = scores, scores - scores.min()
        rows["weight"] = rows.get("probability", np.nan)
        rows = rows.sort_values(["score", "size"], kind="stable", ignore_index=True)
        rows.insert(1, "rank", range(len(rows)))
        found.append(rows)
    first, last = (
        ["equation", "rank", "terms", "size", "measure", "score", "difference", "weight"],
        ["proven", "chosen"],
    )
    if not found:
        return pd.DataFrame(columns=[*first, *last])
    table = pd.concat(found, ignore_index=True)
    others = [name for name in table if name not in (*first, *last, "probability", *table["measure"].unique())]
    return table[[*first, *others, *last]]


def candidate_frame(alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the candidates that a law was chosen from."""
    rows = [
        {
            "equation": each.equation,
            "terms": ", ".join(each.terms),
            "size": len(each.terms),
            **each.measures,
            "proven": each.proven,
            "chosen": each.chosen,
        }
        for each in alternatives
    ]
    return pd.DataFrame(rows)


def readable_candidates(alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the candidates up to a few terms more than were chosen, with the measures that people compare."""
    frame = candidate_frame(alternatives)
    chosen = frame[frame["chosen"]].groupby("equation")["size"].first()
    # What the chosen one alone has compares nothing
    others = frame if frame["chosen"].all() else frame[~frame["chosen"]]
    measures = [name for name in _MEASURES if name in frame and others[name].notna().any()]
    frame["terms"] = [" + ".join(each.terms) or "0" for each in alternatives]
    frame[""] = np.where(frame["chosen"], "*", "")
    few = frame["size"] <= frame["equation"].map(chosen) + _MORE_TERMS
    return frame.loc[few, ["", "equation", "terms", *measures]]


def path_frame(equations: Sequence[str], alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the equations along the path of a solver, see `Law.path`."""
    rows = [
        {
            "equation": equation,
            "from": begin,
            "to": end,
            "terms": ", ".join(each.terms),
            "size": len(each.terms),
            **each.measures,
            "chosen": each.chosen,
        }
        for equation in equations
        for begin, end, each in path_segments([each for each in alternatives if each.equation == equation])
    ]
    if not rows:
        raise CommonlawError("path-unknown")
    return pd.DataFrame(rows)


def path_segments(alternatives: Sequence[Alternative]) -> Iterator[tuple[float, float, Alternative]]:
    """Yield where each segment of a solver's path begins and ends (the last has no end), and its candidate."""
    begins = sorted((value, i) for i, each in enumerate(alternatives) for value in each.hyperparameters)
    turns = [pair for k, pair in enumerate(begins) if k == 0 or begins[k - 1][1] != pair[1]]
    ends = [*(begin for begin, _ in turns[1:]), math.inf]
    for (begin, i), end in zip(turns, ends, strict=False):
        yield begin, end, alternatives[i]


_DEPTHS = {"fourth": 4, "eighth": 8, "sixteenth": 16}
"""Letter values (Tukey 1977, "Exploratory data analysis", chapter 2) on each side of the median: one object in so many
is beyond them."""

_NORMAL = 1.349
"""Standard deviations between the fourths of a normal distribution."""


def letter_values(columns: Mapping[str, Floats], of: str) -> pd.DataFrame:
    """Return the letter values of columns of numbers, a row for each value and a column for each.

    >>> table = letter_values({"mass": np.arange(101.0)}, "object")
    >>> table.set_index("of 101 objects")["mass"].to_dict()["upper fourth"]
    75.0
    """
    values = np.stack([*columns.values()], axis=1)
    rows = [("median", 0.5)]
    for name, depth in _DEPTHS.items():
        rows += [(f"lower {name}", 1 / depth), (f"upper {name}", 1 - 1 / depth)]
    rows += [("least", 0.0), ("largest", 1.0)]
    found = np.quantile(values, [share for _, share in rows], axis=0, method="linear")
    names = pd.DataFrame({f"of {counted(len(values), of)}": [name for name, _ in rows]})
    return pd.concat([names, pd.DataFrame(found, columns=list(columns))], axis=1)


def strangest(values: Floats, heads: Sequence[str], count: int) -> tuple[list[int], list[str], list[float]]:
    """Return the objects farthest from the medians, the farthest first, in what they are, and by how much.

    Parameters
    ----------
    values
        Shape (objects, columns).
    heads
        Names of the columns.
    count
        Of objects.

    Returns
    -------
    indices, columns, distances
        Distances are in standard deviations of a normal distribution with the same fourths.
    """
    far, which = _distances(values)
    chosen = np.argsort(-far, kind="stable")[:count]
    return chosen.tolist(), [heads[i] for i in which[chosen].tolist()], far[chosen].tolist()


def _distances(values: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return how far each object is from the medians, and in which column farthest, both of shape (objects,)."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    scale = (high - low) / _NORMAL
    each = np.where(scale > 0, np.abs(values - middle) / np.where(scale > 0, scale, 1.0), 0.0)
    return each.max(axis=1), each.argmax(axis=1)
