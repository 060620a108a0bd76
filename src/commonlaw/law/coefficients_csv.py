"""The coefficients of a law as a file for other programs."""

from commonlaw.law.law import Law
from commonlaw.law.tables import interval_frame


def coefficients_csv(law: Law) -> str:
    """Return the coefficients of a law as CSV: a row for each, with its standard error, 95 % interval and unit.

    Columns are object, equation, term, value, standard error, low, high and unit; what is not known is empty.
    """
    names, units = (law.objects, law.left_hand_sides, law.terms.names), law.coefficient_units()
    frame = interval_frame(*names, law.coefficients, law.standard_errors, None, 0.95)
    frame.columns = ["value" if each == "coefficient" else each for each in frame.columns]
    frame["unit"] = [units.get(each, "") for each in zip(frame["equation"], frame["term"], strict=True)]
    return str(frame.to_csv(index=False, lineterminator="\n"))
