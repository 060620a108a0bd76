"""What a law says as tables."""

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from commonlaw.errors import CommonlawError
from commonlaw.law.alternative import stretches
from commonlaw.law.uncertainty import covariance_of, normal_quantile

if TYPE_CHECKING:
    from commonlaw.law.law import Law


def coefficients(law: "Law", errors: bool) -> pd.DataFrame:
    """Return the coefficients, objects by terms, see `Law.to_frame`."""
    keys = [(law.left_hand_sides[j], law.terms.names[k]) for j, k in np.argwhere(law.support)]
    values = law.coefficients[:, law.support]
    if errors:
        covariance_of(law)
        keys = [key for equation, term in keys for key in ((equation, term), (equation, f"{term} ±"))]
        values = np.stack([values, law.standard_errors[:, law.support]], axis=2).reshape(len(values), -1)
    if len(law.states) == 1:
        columns = pd.Index([term for _, term in keys], dtype=object, name="term")
    else:
        columns = pd.MultiIndex.from_tuples(keys, names=["equation", "term"])
    return pd.DataFrame(values, index=pd.Index(law.objects, name="object"), columns=columns)


def intervals(law: "Law", level: float) -> pd.DataFrame:
    """Return a table of the coefficients with their standard errors and intervals, see `Law.intervals`."""
    covariance_of(law)
    width = normal_quantile(level)
    rows = []
    for i, j, k in np.argwhere(law.coefficients):
        value, error = float(law.coefficients[i, j, k]), float(law.standard_errors[i, j, k])
        rows.append(
            {
                "object": law.objects[i],
                "equation": law.left_hand_sides[j],
                "term": law.terms.names[k],
                "coefficient": value,
                "standard error": error,
                "low": value - width * error,
                "high": value + width * error,
                "term probability": None if law.inclusion is None else float(law.inclusion[j, k]),
            }
        )
    columns = ["object", "equation", "term", "coefficient", "standard error", "low", "high", "term probability"]
    return pd.DataFrame(rows, columns=columns if law.inclusion is not None else columns[:-1])


def candidates(law: "Law") -> pd.DataFrame:
    """Return the candidates that the law was chosen from, see `Law.candidates`."""
    rows = [
        {
            "equation": each.equation,
            "terms": ", ".join(each.terms),
            "size": len(each.terms),
            **each.measures,
            "proven": each.proven,
            "chosen": each.chosen,
        }
        for each in law.alternatives
    ]
    return pd.DataFrame(rows)


def path(law: "Law") -> pd.DataFrame:
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
        for equation in law.left_hand_sides
        for begin, end, each in stretches([each for each in law.alternatives if each.equation == equation])
    ]
    if not rows:
        raise CommonlawError(
            "this law was not chosen from the path of one solver; discover it with a solver that has no setting, "
            "such as GroupSTLSQ()"
        )
    return pd.DataFrame(rows)
