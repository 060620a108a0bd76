"""What a law says as tables, and how numbers of very many objects are spread."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.law.provenance import Alternative
from commonlaw.law.text import Written, probability_text, rounded
from commonlaw.text import counted

_MORE_TERMS = 2

_WITH_ERRORS = ("coefficient", "factor", "standard error", "low", "high")
"""Columns, or how they begin, whose digits mean something as far as the column of standard errors says."""

MOST_DRAWS = 10_000_000
"""Draws of coefficients; more say nothing that these do not."""

LOG_SCORE = "log score difference"
"""How far forecasts of held-out data are less probable than those of the chosen law, in logarithms: 0 is best."""

_MEASURES = ("held-out error", "standard error", "BIC", "stability", "2 log B", "probability", LOG_SCORE)
"""What is shown of a candidate, as far as it is there."""

MEANINGS = {
    "2 log B": "2 log B: evidence against a law relative to the best; above 10 is very strong (Kass and Raftery 1995)",
    LOG_SCORE: f"{LOG_SCORE}: how much less probable held-out data are by forecasts of a law, in logarithms; none if "
    "they diverge",
}
"""What stands beside a table with one of these measures."""


def coefficient_frame(
    objects: Sequence[str],
    equations: Sequence[str],
    terms: Sequence[str],
    support: Bools,
    coefficients: Floats,
    errors: Floats | None,
) -> pd.DataFrame:
    """Return the coefficients, objects by terms, see `Law.to_frame`; without errors there are no columns of them.

    The support has the shape (equations, terms), coefficients and errors (objects, equations, terms).
    """
    keys = [(equations[j], terms[k]) for j, k in np.argwhere(support)]
    values = coefficients[:, support]
    if errors is not None:
        keys = [key for equation, term in keys for key in ((equation, term), (equation, f"{term} ±"))]
        values = np.stack([values, errors[:, support]], axis=2).reshape(len(values), -1)
    if len(equations) == 1:
        columns = pd.Index([term for _, term in keys], dtype=object, name="term")
    else:
        columns = pd.MultiIndex.from_tuples(keys, names=["equation", "term"])
    return pd.DataFrame(values, index=pd.Index(objects, name="object"), columns=columns)


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


def letter_frame(
    objects: Sequence[str], letters: Sequence[str], values: Floats, errors: Floats, with_errors: bool
) -> pd.DataFrame:
    """Return what letters stand for, and if wanted their standard errors, objects by letters, see `Law.to_frame`.

    Both arrays have the shape (objects, letters).
    """
    columns = {letter: values[:, i] for i, letter in enumerate(letters)}
    if with_errors:
        columns = {
            f"{letter}{mark}": own[:, i]
            for i, letter in enumerate(letters)
            for mark, own in (("", values), (" ±", errors))
        }
    return pd.DataFrame(columns, index=pd.Index(objects, name="object"))


def letter_interval_frame(
    objects: Sequence[str], letters: Sequence[str], values: Floats, errors: Floats, low: Floats, high: Floats
) -> pd.DataFrame:
    """Return what letters stand for with standard errors and intervals, arrays of shape (objects, letters)."""
    names = np.array([(name, letter) for name in objects for letter in letters], dtype=object).reshape(-1, 2)
    columns = {"object": names[:, 0], "parameter": names[:, 1], "coefficient": values.ravel()}
    return pd.DataFrame({**columns, "standard error": errors.ravel(), "low": low.ravel(), "high": high.ravel()})


def interval_frame(
    objects: Sequence[str],
    equations: Sequence[str],
    terms: Sequence[str],
    coefficients: Floats,
    errors: Floats,
    ends: Mapping[str, tuple[Floats, Floats]],
    inclusion_probabilities: Floats | None,
) -> pd.DataFrame:
    """Return the coefficients with their standard errors and intervals, see `Law.intervals`.

    Coefficients, errors and the ends of intervals, by what is said of these, have the shape (objects, equations,
    terms), probabilities (equations, terms).
    """
    i, j, k = np.nonzero(coefficients)
    values, own_errors = coefficients[i, j, k], errors[i, j, k]
    columns: dict[str, Sequence[object] | Floats] = {
        "object": [objects[each] for each in i.tolist()],
        "equation": [equations[each] for each in j.tolist()],
        "term": [terms[each] for each in k.tolist()],
        "coefficient": values,
        "standard error": own_errors,
    }
    for said, (low, high) in ends.items():
        columns |= {f"low{said}": low[i, j, k], f"high{said}": high[i, j, k]}
    if inclusion_probabilities is not None:
        columns["term probability"] = inclusion_probabilities[j, k]
    return pd.DataFrame(columns)


def draws_frame(objects: Sequence[str], letters: Sequence[str], values: Floats) -> pd.DataFrame:
    """Return draws of coefficients, shape (draws, objects, letters), see `Law.draws`."""
    rows = pd.MultiIndex.from_product([range(len(values)), objects], names=["draw", "object"])
    return pd.DataFrame(values.reshape(-1, len(letters)), index=rows, columns=list(letters))


def plausible_frame(laws: Iterable[tuple[float, Sequence[str]]]) -> pd.DataFrame:
    """Return a row for each law, given how probable it is and its equations."""
    return pd.DataFrame([{"probability": share, "law": "; ".join(equations)} for share, equations in laws])


def candidate_frame(alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the candidates that a law was chosen from, see `Law.candidates`."""
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
