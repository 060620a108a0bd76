"""What a law says as tables."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.law.alternative import Alternative, path_segments
from commonlaw.law.uncertainty import normal_quantile


def coefficient_frame(
    objects: Sequence[str],
    equations: Sequence[str],
    terms: Sequence[str],
    support: Bools,
    coefficients: Floats,
    errors: Floats | None,
) -> pd.DataFrame:
    """Return the coefficients, objects by terms, see `Law.to_frame`.

    Parameters
    ----------
    objects, equations, terms
        Their names.
    support
        The coefficients to show, shape (equations, terms).
    coefficients, errors
        Shape (objects, equations, terms); None for no columns of errors.
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


def interval_frame(
    objects: Sequence[str],
    equations: Sequence[str],
    terms: Sequence[str],
    coefficients: Floats,
    errors: Floats,
    inclusion_probabilities: Floats | None,
    level: float,
) -> pd.DataFrame:
    """Return a table of the coefficients with their standard errors and intervals, see `Law.intervals`.

    Parameters
    ----------
    objects, equations, terms
        Their names.
    coefficients, errors
        Shape (objects, equations, terms).
    inclusion_probabilities
        Shape (equations, terms); None if they are not known.
    level
        The probability that a coefficient lies in its interval.

    Raises
    ------
    CommonlawError
        If the level is not between 0 and 1.
    """
    width = normal_quantile(level)
    rows = []
    for i, j, k in np.argwhere(coefficients):
        value, error = float(coefficients[i, j, k]), float(errors[i, j, k])
        row = {
            "object": objects[i],
            "equation": equations[j],
            "term": terms[k],
            "coefficient": value,
            "standard error": error,
            "low": value - width * error,
            "high": value + width * error,
        }
        if inclusion_probabilities is not None:
            row["term probability"] = float(inclusion_probabilities[j, k])
        rows.append(row)
    columns = ["object", "equation", "term", "coefficient", "standard error", "low", "high", "term probability"]
    return pd.DataFrame(rows, columns=columns if inclusion_probabilities is not None else columns[:-1])


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


def path_frame(equations: Sequence[str], alternatives: Sequence[Alternative]) -> pd.DataFrame:
    """Return the equations along the path of a solver, see `Law.path`.

    Raises
    ------
    CommonlawError
        If the alternatives are not from the path of one solver.
    """
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
        raise CommonlawError(
            "this law was not chosen from the path of one solver; discover it with a solver without a value, "
            "such as STLSQ()"
        )
    return pd.DataFrame(rows)
