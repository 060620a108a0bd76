"""Tables that are easily read wrongly: times that start again, indices, dates, a column for each object."""

import io
import random
from datetime import UTC, datetime, timedelta, timezone

import pandas as pd

from tests.hostile.case import Case

CHECK = ("data", "check", "t.csv", "--json")


def restarts(r: random.Random) -> Case:
    """Runs below each other whose times start again, with and without a column and an option that say so."""
    runs, samples = r.choice([1, 2, 3, 5]), r.choice([3, 4, 7, 20])
    shift = r.choice([0, 0.25, 1e-9, 0.5 * samples, -0.25, samples])
    times = [[round(run * shift + step, 9) for step in range(samples)] for run in range(runs)]
    rows = [(f"r{run}", time, round((run + 1) * time, 6)) for run, time_ in enumerate(times) for time in time_]
    named, said = r.random() < 0.4, r.choice([None, None, "trials"])
    if named and r.random() < 0.5:
        r.shuffle(rows)
        said = None
    elif r.random() < 0.2:
        rows.reverse()
        said = None
    lines = [",".join(map(str, row if named else row[1:])) for row in rows]
    head = "trial,t,x" if named else "t,x"
    option = ("--restarts", said) if said else ()
    # Without a column or an option, runs that go on in time are one trial
    goes_on = shift >= samples or runs == 1
    count = runs if named or (said and not goes_on) else 1
    truth = {"samples": len(rows), "trials": count, "states": ["x"]}
    if not (named or said or goes_on):
        truth["trials"] = 0  # Never interleaved
    return Case((*CHECK, *option), {"t.csv": "\n".join([head, *lines]).encode()}, truth=truth)


def indices(r: random.Random) -> Case:
    """Frames of pandas with every kind of index, as files that pandas writes."""
    rows = [(f"o{i}", j, float(k), 2.0 * k + i + j) for i in range(2) for j in range(2) for k in range(6)]
    frame = pd.DataFrame(rows, columns=["object", "trial", "t", "x"])
    frame = frame[[r.random() < 0.9 or k < 2 for k in range(len(frame))]]
    kind = r.choice(["as it is", "counted", "sorted", "named", "levels", "nameless levels", "text"])
    if kind == "counted":
        frame.index = pd.RangeIndex(5, 5 + len(frame))
    elif kind == "sorted":
        frame = frame.sort_values("x", kind="stable")
    elif kind == "named":
        frame = frame.set_index(r.choice(["object", "trial", "t"]))
    elif kind == "levels":
        frame = frame.set_index(r.sample(["object", "trial", "t"], r.choice([2, 3])))
    elif kind == "nameless levels":
        frame.index = pd.MultiIndex.from_arrays([range(len(frame)), range(1, len(frame) + 1)])
    elif kind == "text":
        frame.index = [f"row {i}" for i in range(len(frame))]
    truth = {"samples": len(frame), "trials": 4, "objects": ["o0", "o1"], "states": ["x"]}
    written = io.BytesIO()
    if r.random() < 0.6:
        frame.to_parquet(written)
    else:
        frame.to_csv(written)
    return Case(CHECK, {"t.csv": written.getvalue()}, truth=truth)


def dates(r: random.Random) -> Case:
    """Dates in one way of writing or in several, of which each says or does not say its offset."""
    whole, zone = r.random() < 0.5, timezone(timedelta(hours=r.choice([-5, 1, 2])))
    step = timedelta(days=r.choice([1, 7, 31])) if whole else timedelta(seconds=r.choice([60, 3600, 90_000]))
    first = datetime(2020, 3, r.choice([1, 27, 31]), tzinfo=zone)
    ways = ["%Y-%m-%d", "%Y%m%d"] if whole else ["%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S%z", "Z", "%d.%m.%Y %H:%M"]
    chosen = r.sample(ways, 1 if r.random() < 0.5 else 2)

    def written(stamp: datetime) -> str:
        way = r.choice(chosen)
        return stamp.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ") if way == "Z" else stamp.strftime(way)

    count = r.choice([3, 5, 20])
    rows = [f"{written(first + i * step)},{i * i}" for i in range(count)]
    duration = (count - 1) * step / timedelta(days=1 if whole else 0, seconds=0 if whole else 1)
    truth = {"samples": count, "trials": 1, "durations": [round(duration, 6)]}
    return Case(CHECK, {"t.csv": "\n".join(["t,x", *rows]).encode()}, truth=truth)


def wide(r: random.Random) -> Case:
    """Plates with a column for each well, conditions and gaps, read long, or not as one may expect."""
    count, samples = r.choice([2, 4, 12, 96]), r.choice([3, 8, 30])
    names = [f"{'ABCDEFGH'[i // 12]}{i % 12 + 1:{r.choice(['', '02'])}}" for i in range(count)]
    unit = r.choice(["", " [OD]"])
    cells = [[f"{0.1 * (1 + i) * (1 + 0.1 * row):.4g}" for i in range(count)] for row in range(samples)]
    gaps = {(r.randrange(samples), r.randrange(count)) for _ in range(r.choice([0, 0, 1, 2]))}
    for row, i in gaps:
        cells[row][i] = r.choice(["", "NA", ""])
    conditions = [["glucose", *(str(i % 3) for i in range(count))], ["strain", *(f"s{i % 2}" for i in range(count))]]
    lines = [["time [h]", *(f"{name}{unit}" for name in names)], *conditions[: r.choice([0, 0, 1, 2])]]
    lines += [[str(row), *cell] for row, cell in enumerate(cells)]
    separator = r.choice(",;\t")
    content = "\n".join(separator.join(line) for line in lines).encode()
    asked = r.random() < 0.7
    option = ("--wide", r.choice(["OD", "OD [OD]", "value"])) if asked else ()
    last = {i: max((row for row in range(samples) if (row, i) not in gaps), default=-1) for i in range(count)}
    # Rows after the last measured one are there to be forecast
    kept = sum(1 for row in range(samples) for i in range(count) if (row, i) not in gaps or row > last[i])
    truth: dict[str, object] = {"trials": count, "objects": sorted(names), "samples": kept}
    if not asked:
        truth = {"trials": count}  # Wells are never taken for states in silence
    return Case((*CHECK, *option), {"t.csv": content}, truth=truth)
