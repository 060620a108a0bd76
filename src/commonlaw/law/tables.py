"""Tables of a law, and quantiles of the coefficients of very many objects."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import compress, starmap
from typing import Any

import numpy as np
import pandas as pd

from commonlaw.array_types import Floats
from commonlaw.law.law import Law, object_index, only_object, shares_terms
from commonlaw.law.parameters import (
    equation_label,
    left_hand_sides,
    named_parameters,
    tabulated_parameters,
)
from commonlaw.law.provenance import Alternative
from commonlaw.law.text import MANY, Written, one_sided_text, probability_text, rounded, with_error
from commonlaw.runtime.arguments import check_whole_number, checks_types
from commonlaw.text import counted

_WITH_ERRORS = ("coefficient", "estimate", "factor", "standard error", "low", "high", "95 %")
"""Columns, or how they begin, whose digits mean something as far as the column of standard errors says."""


LOG_SCORE = "log score difference"
"""How far forecasts of held-out data are less probable than those of the chosen law, in logarithms: 0 is best."""

_MEASURES = ("held-out error", "standard error", "BIC", "stability", "2 log B", "probability", LOG_SCORE)
"""What is shown of a candidate, as far as it is there."""

_COMPARING = ("2 log B", LOG_SCORE, "held-out error", "BIC", "AIC")
"""What candidates are compared by, the first that is there."""

MEANINGS = {
    "held-out error": "held-out error: mean squared error on held-out data",
    "BIC": "BIC: penalizes the misfit by the number of terms; lower is better",
    "stability": "stability: share of bootstrap resamples in which the least certain term is selected",
    "2 log B": "2 log B: evidence against a law relative to the best; above 10 is very strong (Kass and Raftery 1995)",
    LOG_SCORE: f"{LOG_SCORE}: how much less probable held-out data are by forecasts of a law, in logarithms; none if "
    "they diverge",
}
"""What is printed with a table with one of these measures."""


def readable(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose estimates have the decimal places of the standard error's second digit.

    An estimate without a standard error whose interval has one end is written as that limit. What has an error of zero,
    known or at a bound, was not estimated: it has neither error nor interval.
    """
    shown, errors = frame.copy(), frame.get("standard error")
    ends = [frame.get(f"95 % {end}", frame.get(end)) for end in ("low", "high")]
    for name in map(str, frame.columns):
        if "probability" in name:
            texts = [probability_text(probability) for probability in frame[name]]
        elif name == "2 log B":
            texts = [f"{number:.1f}" if number < 99.95 else f"{number:.0f}" for number in frame[name]]
        elif errors is not None and name.startswith(_WITH_ERRORS):
            is_value = name in ("coefficient", "estimate", "factor")
            pairs = zip(frame[name], errors, strict=True)
            texts = [rounded(value, error) if is_value or error != 0 else "" for value, error in pairs]
            if name == "estimate" and ends[0] is not None and ends[1] is not None:
                limits = [one_sided_text(*interval) for interval in zip(*ends, strict=True)]
                numbers = zip(texts, limits, errors.isna(), strict=True)
                texts = [limit if limit and alone else number for number, limit, alone in numbers]
        else:
            continue
        shown[name] = pd.Series(map(Written, texts), frame.index, dtype=object).where(frame[name].notna(), Written())
    return shown


def parameter_frame(law: Law, level: float = 0.95, averaged: bool = False) -> pd.DataFrame:
    """Return `Law.params` with intervals of a level, see `Law.conf_int`."""
    parameters, is_given = tabulated_parameters(law), bool(law.provenance.equations)
    low, high = parameters.intervals(level, averaged)
    rows, columns = np.nonzero(np.ones_like(low) if is_given else parameters.values)
    places = [parameters.definitions[i].parts[0] for i in columns]
    frame = pd.DataFrame(
        {
            "object": [law.objects[row] for row in rows],
            "equation": [equation_label(law, place.equation, place.term) for place in places],
            "term": [law.terms.names[place.term] for place in places],
            "parameter": [parameters.names[i] for i in columns],
            "estimate": parameters.values[rows, columns],
            "standard error": parameters.tabulated_errors[rows, columns],
            "low": low[rows, columns],
            "high": high[rows, columns],
            "unit": [parameters.units[i] or "" for i in columns],
        }
    )
    inclusion = law.uncertainty.inclusion_probabilities
    if inclusion is not None and not is_given:
        frame["inclusion probability"] = [inclusion[place.equation, place.term] for place in places]
    return frame


def covariance_frame(law: Law, name: str | None) -> pd.DataFrame:
    """Return the covariance of one object's parameters, see `Law.cov_params`."""
    law.uncertainty.known_covariance()
    parameters = named_parameters(law)
    names = pd.Index(parameters.names, name="parameter")
    matrix = parameters.covariance[object_index(law, only_object(law, name))]
    return pd.DataFrame(matrix, index=names, columns=names)


def sample_frame(law: Law, n: int, seed: int, averaged: bool) -> pd.DataFrame:
    """Return draws of the parameters, see `Law.sample`."""
    # More draws do not change statistics
    check_whole_number("n", n, 1, 10_000_000)
    parameters = named_parameters(law)
    values = parameters.draws(n, seed, averaged)
    index = pd.MultiIndex.from_product([range(n), law.objects], names=["draw", "object"])
    return pd.DataFrame(values.reshape(n * len(law.objects), -1), index=index, columns=list(parameters.names))


@checks_types
def to_frame(law: Law, errors: bool = False) -> pd.DataFrame:
    """Return the coefficients as a wide table: a row for each object, a column for each term.

    With several equations the columns have two levels, equation and term. Given equations have a column for each
    parameter. With `errors` each column is followed by its standard errors, ``"v ±"``.

    Raises `CommonlawError` if `errors` is set and standard errors are not known.

    Examples
    --------
    >>> import commonlaw as cl
    >>> print(cl.law.to_frame(cl.Law.from_text("T' = -k (T - 20)", {"k": {"cup": 0.1, "mug": 0.05}})))
              k
    object
    cup    0.10
    mug    0.05
    """
    if errors:
        law.uncertainty.known_covariance()
    parameters, lefts, is_given = tabulated_parameters(law), left_hand_sides(law), bool(law.provenance.equations)
    values, deviations = parameters.values, np.where(parameters.limited, np.nan, np.nan_to_num(parameters.errors))
    keys = [
        ("", definition.name) if is_given else (lefts[definition.equation], law.terms.names[definition.term])
        for definition in parameters.definitions
    ]
    if errors:
        keys = [key for equation, name in keys for key in ((equation, name), (equation, f"{name} ±"))]
        values = np.stack([values, deviations], axis=2).reshape(len(values), -1)
    columns: pd.Index[Any] = pd.MultiIndex.from_tuples(keys, names=["equation", "term"])
    if is_given or len(law.schema.states) == 1:
        kind = None if is_given else "term"
        columns = pd.Index([name for _, name in keys], dtype=object, name=kind)
    return pd.DataFrame(values, index=pd.Index(law.objects, name="object"), columns=columns)


def interval_frame(law: Law, level: float = 0.95) -> pd.DataFrame:
    """Return `Law.conf_int` with stable names of columns, followed by the intervals averaged over `Law.models`."""
    intervals = _without_limited_estimates(law.conf_int(level))
    by_name = bool(law.provenance.equations)
    if law.uncertainty.other_laws and not by_name:
        averaged, after = law.conf_int(level, averaged=True), [*intervals.columns].index("high") + 1
        for i, end in enumerate(("low", "high")):
            intervals.insert(after + i, f"{end} averaged over plausible laws", averaged[end])
    intervals["unit"] = intervals.pop("unit")
    intervals = intervals.drop(columns=["equation", "term"] if by_name else ["parameter"])
    saved = {"estimate": "coefficient", "inclusion probability": "term probability"}
    intervals.columns = pd.Index([saved.get(column, column) for column in intervals.columns])
    return intervals if intervals["unit"].any() else intervals.drop(columns="unit")


def _without_limited_estimates(intervals: pd.DataFrame) -> pd.DataFrame:
    """Return `Law.conf_int` without estimates of parameters that have only a limit."""
    is_limited = intervals["standard error"].isna() & (np.isinf(intervals["low"]) ^ np.isinf(intervals["high"]))
    return intervals.assign(estimate=intervals["estimate"].mask(is_limited))


def coefficient_rows(law: Law) -> pd.DataFrame:
    """Return `Law.params` as a table for other programs; what is not known is empty."""
    names = ["parameter"] if law.provenance.equations else ["equation", "term"]
    parameters = _without_limited_estimates(law.params)
    rows: pd.DataFrame = parameters[["object", *names, "estimate", "standard error", "low", "high", "unit"]]
    return rows.set_axis(["object", *names, "value", "standard error", "low", "high", "unit"], axis=1)


def comparison_frame(alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the candidates of each equation from the best to the worst, see `Law.comparison`."""
    tables = []
    for equation in dict.fromkeys(alternative.equation for alternative in alternatives):
        candidates = [alternative for alternative in alternatives if alternative.equation == equation]
        names = [name for candidate in candidates for name in candidate.measures]
        measure = next((name for name in _COMPARING if name in names), names[0] if names else "")
        rows = candidate_frame(candidates).assign(measure=measure)
        scores = rows[measure].astype(float) if measure else pd.Series(np.nan, rows.index)
        rows["score"], rows["difference"] = scores, scores - scores.min()
        rows["weight"] = rows.get("probability", np.nan)
        rows = rows.sort_values(["score", "size"], kind="stable", ignore_index=True)
        rows.insert(1, "rank", range(len(rows)))
        tables.append(rows)
    first, last = (
        ["equation", "rank", "terms", "size", "measure", "score", "difference", "weight"],
        ["proven", "chosen"],
    )
    if not tables:
        return pd.DataFrame(columns=[*first, *last])
    table = pd.concat(tables, ignore_index=True)
    others = [name for name in table if name not in (*first, *last, "probability", *table["measure"].unique())]
    return table[[*first, *others, *last]]


def candidate_frame(alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the candidates that a law was chosen from."""
    rows = [
        {
            "equation": alternative.equation,
            "terms": ", ".join(alternative.terms),
            "size": len(alternative.terms),
            **alternative.measures,
            "proven": alternative.proven,
            "chosen": alternative.chosen,
        }
        for alternative in alternatives
    ]
    return pd.DataFrame(rows)


def readable_candidates(alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the candidates up to a few terms more than were chosen, with the measures that people compare."""
    frame = candidate_frame(alternatives)
    chosen = frame[frame["chosen"]].groupby("equation")["size"].first()
    # What the chosen one alone has compares nothing
    others = frame if frame["chosen"].all() else frame[~frame["chosen"]]
    measures = [name for name in _MEASURES if name in frame and others[name].notna().any()]
    frame["terms"] = [" + ".join(alternative.terms) or "0" for alternative in alternatives]
    frame[""] = np.where(frame["chosen"], "*", "")
    few = frame["size"] <= frame["equation"].map(chosen) + 2
    return frame.loc[few, ["", "equation", "terms", *measures]]


def summary(law: Law) -> str:
    """Return the law as it prints, with its tables, see `Law.summary`."""
    tables = [readable(law.params).dropna(axis=1, how="all")]
    if law.trial_estimates:
        tables.append(readable(law.trial_estimates.to_frame()))
    if len(quantities := shown_quantities(law)):
        tables.append(readable(quantities))
    if law.provenance.alternatives:
        tables.append(readable_candidates(law.provenance.alternatives))
    return "\n\n".join([str(law), *(table.to_string(index=False, na_rep="") for table in tables)])


def coefficient_names(law: Law) -> Iterator[tuple[str, str | None]]:
    """Yield the name of each coefficient with its unit; where relations have names of their own, its term."""
    parameters = named_parameters(law)
    names = parameters.names
    lefts = left_hand_sides(law)
    if law.uncertainty.explanation is not None and not law.provenance.equations:
        terms = [
            (lefts[definition.equation], law.terms.names[definition.term]) for definition in parameters.definitions
        ]
        names = tuple(
            f"{term} in {left_side}" if len(law.schema.states) > 1 else f"of {term}" for left_side, term in terms
        )
    return zip(names, parameters.units, strict=True)


def coefficients_by_object(law: Law) -> pd.DataFrame:
    """Return a row for each object: ``0.447 ± 0.005``, and on a line below the ends of a 95 % interval.

    Below an object stand its trials, with what differs between them. The table is empty where objects have terms of
    their own. A property that names the objects has no column of its own.
    """
    parameters = named_parameters(law)
    if not shares_terms(law) or not parameters.names:
        return pd.DataFrame()
    known = law.uncertainty.covariance is not None
    low, high = parameters.intervals() if known else (parameters.values, parameters.values)
    by_trial = dict[str, dict[str, dict[str, Written]]]()
    for estimate in law.trial_estimates:
        by_trial.setdefault(estimate.object, {}).setdefault(estimate.trial, {})[estimate.name] = Written(
            with_error(estimate.value, estimate.error)
        )
    rows = list[list[str]]()
    errors = np.where(parameters.limited, np.nan, np.nan_to_num(parameters.errors))
    for name, *estimates in zip(law.objects, parameters.values, errors, low, high, strict=True):
        rows.append([name, *(with_interval(*numbers) for numbers in zip(*estimates, strict=True))])
        for trial, cells in by_trial.get(name, {}).items():
            if not cells.keys().isdisjoint(parameters.names):
                label = f"{name}, {law.schema.trial} {trial}"
                rows.append([label, *(cells.get(parameter, Written()) for parameter in parameters.names)])
    heads = [law.schema.object, *starmap(with_unit, coefficient_names(law))]
    frame = pd.DataFrame(rows, columns=heads, dtype=object)
    return frame.loc[:, [True, *(name != law.schema.object for name in parameters.names)]]


def quantities_by_object(law: Law) -> pd.DataFrame:
    """Return what is quoted of a law of a known form, as `coefficients_by_object`; empty if there is nothing."""
    shown = shown_quantities(law)
    columns: dict[str, dict[str, Written]] = {}
    repeated = set[str]()  # Of several equations of one form
    if len(shown):
        repeated = {*shown["symbol"][shown.duplicated(["object", "quantity", "symbol"], keep=False)]}
    for row in shown.fillna({"unit": ""} if "unit" in shown else {}).to_dict("records"):
        part = f"{row['form']}: " if row["symbol"] in repeated else ""
        title = with_unit(f"{part}{row['quantity']} {row['symbol']}".rstrip(), row.get("unit"))
        cell = with_interval(
            row["estimate"], row.get("standard error", 0.0), *(row[end] for end in ("low", "high") if end in row)
        )
        columns.setdefault(title, {})[row["object"]] = cell
    rows = [[name, *(cells.get(name, Written()) for cells in columns.values())] for name in law.objects if columns]
    return pd.DataFrame(rows, columns=[law.schema.object, *columns], dtype=object)


def with_interval(value: float, error: float, *ends: float) -> Written:
    """Return a value with its standard error, and on a line below the ends of its interval; or its only limit."""
    if np.isnan(error) and len(ends) == 2 and (limit := one_sided_text(*ends)):
        return Written(limit)
    error = float(np.nan_to_num(error))
    interval = f"\n{' to '.join(rounded(end, error) for end in ends)}" if error > 0 else ""
    return Written(with_error(value, error) + interval)


def with_unit(name: str, unit: str | None) -> str:
    """Return the head of a column of numbers."""
    return f"{name} ({unit})" if unit else name


def shown_quantities(law: Law) -> pd.DataFrame:
    """Return `Law.quantities` without empty columns, and without rows where there are very many objects."""
    if len(law.objects) > MANY:
        return pd.DataFrame()
    frame = law.quantities()
    known = [name for name in frame if name == "symbol" or not (frame[name].isna() | (frame[name] == "")).all()]
    return frame[known] if len(frame) else frame


_DEPTHS = {"fourth": 4, "eighth": 8, "sixteenth": 16}
"""Letter values (Tukey 1977, "Exploratory data analysis", chapter 2) on each side of the median: one object in so many
is beyond them."""


def quantile_frame(columns: Mapping[str, Floats], of: str) -> pd.DataFrame:
    """Return the letter values (quantiles) of columns of numbers, a row for each and a column for each.

    >>> table = quantile_frame({"mass": np.arange(101.0)}, "object")
    >>> table.set_index("of 101 objects")["mass"].to_dict()["upper fourth"]
    75.0
    """
    values = np.stack([*columns.values()], axis=1)
    rows = [("median", 0.5)]
    for name, depth in _DEPTHS.items():
        rows += [(f"lower {name}", 1 / depth), (f"upper {name}", 1 - 1 / depth)]
    rows += [("least", 0.0), ("largest", 1.0)]
    result = np.quantile(values, [share for _, share in rows], axis=0, method="linear")
    names = pd.DataFrame({f"of {counted(len(values), of)}": [name for name, _ in rows]})
    return pd.concat([names, pd.DataFrame(result, columns=list(columns))], axis=1)


def spread_tables(law: Law, count: int, universal: bool = True) -> tuple[pd.DataFrame, pd.DataFrame] | None:
    """Return quantiles of the parameters, and so many objects farthest from the medians, with their parameters.

    Distances are in standard deviations of a normal distribution with the same fourths. `universal` parameters, equal
    for all objects, may be left out; None if no parameter is left.
    """
    parameters, heads = named_parameters(law), [*starmap(with_unit, coefficient_names(law))]
    values = parameters.values
    kept = np.array([name != law.schema.object for name in parameters.names])
    if not universal:
        kept &= ~np.isclose(values, values[0], rtol=1e-9).all(axis=0)
    if not kept.any():
        return None
    heads, values = [*compress(heads, kept)], values[:, kept]
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    # Standard deviations between the fourths of a normal distribution
    scale = (high - low) / 1.349
    distances = np.where(scale > 0, np.abs(values - middle) / np.where(scale > 0, scale, 1.0), 0.0)
    chosen = np.argsort(-distances.max(axis=1), kind="stable")[:count]
    rows = [
        [
            law.objects[i],
            *map(Written, compress(parameters.texts(i), kept)),
            heads[int(distances[i].argmax())],
            float(distances[i].max()),
        ]
        for i in chosen.tolist()
    ]
    farthest = pd.DataFrame(rows, columns=[law.schema.object, *heads, "farthest in", "by"])
    return quantile_frame(dict(zip(heads, values.T, strict=True)), "object"), farthest
