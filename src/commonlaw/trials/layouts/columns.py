"""The layouts of columns, the first of which that fits decides."""

from collections.abc import Callable, Sequence

from commonlaw.trials.columns import Table
from commonlaw.trials.layouts.pairs_across import pairs_across
from commonlaw.trials.layouts.points_across import points_across
from commonlaw.trials.layouts.quantities_below import quantities_below
from commonlaw.trials.layouts.runs_across import runs_across
from commonlaw.trials.layouts.times_across import times_across
from commonlaw.trials.reading import Reading

OF_COLUMNS: Sequence[Callable[[Table, Reading], Table | None]] = (
    times_across,
    runs_across,
    points_across,
    pairs_across,
    quantities_below,
)


def table_in_columns(table: Table, reading: Reading) -> Table | None:
    """Return a table of one of these layouts with a row for each sample, None if it is a plain table."""
    return next((long for layout in OF_COLUMNS if (long := layout(table, reading)) is not None), None)
