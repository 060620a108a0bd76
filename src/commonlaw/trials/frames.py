"""Tables in frames of pandas, polars and pyarrow."""

from typing import TYPE_CHECKING, Any

from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Column, Table, column_of, filled_table

if TYPE_CHECKING:
    import narwhals as nw


def frame_table(frame: Any, source: str = "the frame") -> Table:
    """Return the table in a pandas, polars or pyarrow frame, or in any other that narwhals reads.

    Raises
    ------
    CommonlawError
        If it is not a frame, or a header is there twice.
    """
    import narwhals as nw

    try:
        data = nw.from_native(frame)
        eager = data.collect() if isinstance(data, nw.LazyFrame) else data
        headers = [str(name) for name in eager.columns]
    except nw.exceptions.DuplicateError as error:
        text = " ".join(str(error).split())
        raise CommonlawError(f"{source}: {text}; give each column a name of its own") from None
    except TypeError:
        raise CommonlawError(
            f"cannot read a table from {type(frame).__name__}: give a pandas, polars or pyarrow frame"
        ) from None
    columns = [_column(each) for each in eager.iter_columns()]
    loose = [i for i, (_, is_mixed) in enumerate(columns) if is_mixed]
    return filled_table(source, headers, [column for column, _ in columns], loose=loose)


def _column(series: "nw.Series[Any]") -> tuple[Column, bool]:
    """Return a column of a frame, and whether it was of several kinds and became text."""
    if series.dtype.is_integer() or series.dtype.is_float():
        values = series.to_numpy()
        if values.dtype.kind in "iuf":
            return values, False
    return column_of(series.to_list())
