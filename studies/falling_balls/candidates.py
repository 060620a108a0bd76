"""Part 3: the candidate terms of which laws are made."""

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.array_types import Floats
from commonlaw.formulation import law_variables
from commonlaw.library import Terms, Variables, parse_library, term_unit
from commonlaw.plots import plot_library
from commonlaw.report import Picture, Table, Text
from commonlaw.trials.headers import parse_unit
from studies.falling_balls.inquiry import Inquiry, left_out
from studies.falling_balls.printed import printed_table
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import LIBRARY, LIBRARY_BALL, LIBRARY_DROP
from studies.falling_balls.speeds import FORM

_TITLE = "Candidate terms"
_UNITS: Mapping[str, str] = {"x": "m", "v": "m/s"}
_ACCELERATION = "m/s^2"


def candidates(inquiry: Inquiry) -> Section:
    """Return the part on the library: its terms along one drop, and how hard they are to tell apart."""
    if inquiry.drops is None:
        return left_out("library", _TITLE, inquiry.missing)
    drops = inquiry.drops
    (trial,) = drops.select(object=LIBRARY_BALL, trial=LIBRARY_DROP)
    terms = parse_library(LIBRARY).bind(law_variables(drops.schema, FORM.order))
    rows, _ = FORM.rows(trial, terms)
    rates = FORM.rates(trial)
    off = _deviation(terms, rows, rates.states[:, 0], rates.derivatives[0][:, 0])
    condition = float(np.linalg.cond(rows / np.linalg.norm(rows, axis=0)))
    table = _table(terms, rows)
    blocks = (
        Text(
            "Which terms might be in the law? The method is given a library of candidates: all products of the height "
            f"$x$ and the speed $v$ up to the third degree, {len(terms)} in all. A law is a sum of some of them, each "
            "times a coefficient, $\\ddot x = c_1 + c_2 x + c_3 v + \\dots$; so every coefficient times its term is an "
            "acceleration, and times the mass of the ball a force. The method is not told that gravity depends on "
            "neither $x$ nor $v$, or that drag depends on $v$ alone: it is to find out."
        ),
        Picture(
            "library-terms",
            f"The candidate terms along drop {LIBRARY_DROP} of the {LIBRARY_BALL}: what a law may add up to the "
            "measured acceleration. $x$ is the smoothed height, $v$ its derivative.",
            partial(plot_library, trial, FORM, terms, drops.schema.units),
        ),
        Table(
            "candidate-terms",
            f"The candidate terms along drop {LIBRARY_DROP} of the {LIBRARY_BALL}: their range and unit, the unit of "
            "their coefficient, the other term that runs most like them, by the correlation of the two, and how much "
            "of a term the best sum of all other terms leaves over, by the root of the sum of squares.",
            table,
            digits=4,
        ),
        Text(_found(table, condition)),
    )
    results = {"terms": list(terms.names), "condition_number": condition}
    return Section("library", _TITLE, blocks, (_verdict(terms, off),), {"library": results})


def _deviation(terms: Terms, rows: Floats, x: Floats, v: Floats) -> float:
    """Return the largest relative difference of the terms' values from plain products of the height and the speed."""
    products = {
        "1": np.ones_like(x),
        "x": x,
        "v": v,
        "x^2": x * x,
        "x v": x * v,
        "v^2": v * v,
        "x^3": x * x * x,
        "x^2 v": x * x * v,
        "x v^2": x * v * v,
        "v^3": v * v * v,
    }
    if products.keys() != set(terms.names):
        return np.inf
    expected = np.column_stack([products[name] for name in terms.names])
    return float(np.max(np.abs(rows - expected).max(axis=0) / np.abs(expected).max(axis=0)))


def _table(terms: Terms, rows: Floats) -> pd.DataFrame:
    correlations = np.full((len(terms), len(terms)), np.nan)
    varies = np.ptp(rows, axis=0) > 0
    correlations[np.ix_(varies, varies)] = np.corrcoef(rows[:, varies], rowvar=False)
    np.fill_diagonal(correlations, np.nan)
    found = []
    for i, name in enumerate(terms.names):
        unit = term_unit(terms.terms[i], Variables(terms.variables.states), _UNITS)
        nearest = int(np.argmax(np.nan_to_num(np.abs(correlations[i])))) if varies[i] else None
        found.append(
            {
                "term": name,
                "smallest": float(rows[:, i].min()),
                "largest": float(rows[:, i].max()),
                "unit": "" if unit is None else f"{unit:~P}",
                "unit of coefficient": "" if unit is None else f"{parse_unit(_ACCELERATION) / unit:~P}",
                "most alike": "" if nearest is None else terms.names[nearest],
                "correlation": None if nearest is None else float(correlations[i, nearest]),
                "left over by the others": _left_over(rows, i),
            }
        )
    return pd.DataFrame(found)


def _left_over(rows: Floats, column: int) -> float:
    """Return the part of a column that no sum of the other columns gives, by norms."""
    scaled = rows / np.linalg.norm(rows, axis=0)
    others = np.delete(scaled, column, axis=1)
    fitted = others @ np.linalg.lstsq(others, scaled[:, column], rcond=None)[0]
    return float(np.linalg.norm(scaled[:, column] - fitted))


def _found(table: pd.DataFrame, condition: float) -> str:
    most = table["left over by the others"].max()
    factor, power = f"{condition:.1e}".split("e")
    return (
        "Along a single fall these terms are hard to tell apart. Height and speed both run smoothly from start to end, "
        f"so every term is nearly a sum of the others, which leave over {most:.2%} of it at most. The condition number "
        f"of the library, its columns scaled to length one, is ${factor} \\times 10^{{{int(power)}}}$: an error in the "
        "acceleration may come back in the coefficients magnified by as much. That is why the results depend so much "
        "on noise, and on how few terms are asked for."
    )


def _verdict(terms: Terms, off: float) -> Verdict:
    printed = set(printed_table("threshold_path_single").columns) - {"threshold"}
    same = set(terms.names) == printed
    holds = same and off < 1e-12
    return Verdict(
        "reproduced" if holds else "differs",
        f"The library has {len(terms)} terms, {'the' if same else 'not the'} {len(printed)} of the paper; their values "
        f"along the drop {'are' if off < 1e-12 else 'are not'} the plain products of $x$ and $v$. The paper prints no "
        "numbers here.",
    )
