"""The coefficients of a law as a file for other programs."""

import numpy as np
import pandas as pd

from commonlaw.law.law import Law
from commonlaw.law.tables import interval_frame, letter_interval_frame


def coefficients_csv(law: Law) -> str:
    """Return the coefficients of a law as CSV, see `coefficient_rows`; what is not known is empty."""
    return str(coefficient_rows(law).to_csv(index=False, lineterminator="\n"))


def coefficient_rows(law: Law) -> pd.DataFrame:
    """Return a row for each coefficient of a law, with its standard error, 95 % interval and unit.

    Columns are object, equation, term, value, standard error, low, high and unit, which is empty if it is not known.
    Intervals are averaged over what the law could be, see `Law.intervals`. A law that was given as equations has a row
    for each of their letters, and parameter in place of equation and term.
    """
    if law.provenance.equations:
        values, errors = law.letter_values()
        ends = (values * np.nan,) * 2 if law.covariance is None else law.letter_interval_ends()
        units = [unit or "" for unit in law.letter_units()] * len(law.objects)
        letters = letter_interval_frame(law.objects, law.letters, values, errors, *ends).assign(unit=units)
        letters.columns = ["value" if each == "coefficient" else each for each in letters.columns]
        return letters
    names, units_of_terms = (law.objects, law.left_hand_sides, law.terms.names), law.coefficient_units()
    unknown = np.full(law.coefficients.shape, np.nan)
    ends_of_terms = {"": (unknown, unknown) if law.covariance is None else law.interval_ends()}
    frame = interval_frame(*names, law.coefficients, law.standard_errors, ends_of_terms, None)
    frame.columns = ["value" if each == "coefficient" else each for each in frame.columns]
    frame["unit"] = [units_of_terms.get(each, "") for each in zip(frame["equation"], frame["term"], strict=True)]
    return frame
