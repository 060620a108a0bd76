"""The layouts of cells, the first of which that fits decides."""

from collections.abc import Callable, Sequence

from commonlaw.trials.columns import Table
from commonlaw.trials.layouts.blocks import blocks
from commonlaw.trials.layouts.grid import Grid
from commonlaw.trials.layouts.plates import plates

OF_CELLS: Sequence[Callable[[Grid], Table | None]] = (plates, blocks)


def table_in_cells(grid: Grid) -> Table | None:
    """Return the table in rows that have one of these layouts, None if they are a plain table."""
    return next((table for layout in OF_CELLS if (table := layout(grid)) is not None), None)
