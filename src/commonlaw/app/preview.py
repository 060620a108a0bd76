"""What a table holds, before a law is looked for, and what a law says of a start of one's own."""

from typing import Any

import msgspec
import numpy as np

from commonlaw.app.data_checks import cell_text, finding_kinds
from commonlaw.app.question import Columns, Table, shown_roles
from commonlaw.app.result import Found, numbers
from commonlaw.app.words import in_page, text_in_page
from commonlaw.errors import CommonlawError, unknown
from commonlaw.forecast import forecast_from
from commonlaw.forecast.population import with_objects_of
from commonlaw.law import Law
from commonlaw.trials import Trial, Trials
from commonlaw.trials.roles import GUESSED

_ROWS, _TRIALS, _SAMPLES, _POINTS = 8, 60, 400, 600
"""Rows that are shown, trials and samples of a trial that are drawn, and points of a curve."""

SAMPLES = {
    "linear-drag": {"noise": 0.05},
    "nonlinear-oscillator": {"noise": 0.01},
    "lotka-volterra": {"noise": 0.05},
    "lorenz": {"noise": 0.1},
}
"""Data sets that the page offers, and their options."""


class Sample(msgspec.Struct, forbid_unknown_fields=True):
    """A start of one's own, which a candidate of the law is to forecast."""

    candidate: int
    object: str
    start: tuple[float, ...]
    duration: float
    properties: dict[str, float] = {}
    """Of an object that was never measured; the object is then one of your own."""


def sample_table(name: str) -> Table:
    """Return a simulated data set as a table, as if its file had been sent."""
    from commonlaw.datasets import load

    if name not in SAMPLES:
        raise unknown("data set of the app", name, SAMPLES)
    trials = load(name, **SAMPLES[name])
    units = trials.schema.units
    frame = trials.to_frame()
    frame.columns = [f"{each} [{units[each]}]" if each in units else each for each in frame.columns]
    call = f"cl.datasets.load({name!r}, {', '.join(f'{each}={value!r}' for each, value in SAMPLES[name].items())})"
    return Table(f"{name}.csv", frame.to_csv(index=False).encode(), call)


def preview(table: Table, columns: Columns) -> dict[str, Any]:
    """Return the columns of a table, its first rows, its trials by these columns, and what data checks find.

    Where columns do not make trials, the reason stands in place of these, beside the roles that are clear.
    """
    held = table.cells()
    shown = [[cell_text(each) for each in column[:_ROWS]] for column in held.columns.values()]
    found: dict[str, Any] = {
        "name": table.name,
        "columns": list(held.columns),
        "rows": [list(row) for row in zip(*shown, strict=True)],
        "problem": "",
    }
    try:
        rows = columns.rows(held)
    except CommonlawError as error:
        return found | {"recognised": columns.recognised(held), "problem": error.sentence(in_page)}
    trials = Trials(*rows.data)
    check = trials.check()
    found |= {"recognised": shown_roles(rows.columns), "guessed": rows.columns.guessed and rows.columns.sentence}
    notes = [text_in_page(each) for each in check.notes if not each.startswith(GUESSED)]
    return found | _of_trials(trials) | {"checks": finding_kinds(check, held, rows.row_indices), "notes": notes}


def _of_trials(trials: Trials) -> dict[str, Any]:
    schema = trials.schema
    return {
        "roles": {
            "object": schema.object,
            "trial": schema.trial,
            "time": schema.time,
            "states": schema.states,
            "inputs": schema.inputs,
            "properties": sorted({name for own in trials.properties.values() for name in own}),
        },
        "objects": trials.objects,
        "labels": list(dict.fromkeys(each.name for each in trials)),
        "count": len(trials),
        "samples": sum(map(len, trials)),
        "units": dict(schema.units),
        "trials": [
            {
                "object": each.object,
                "name": each.name,
                "t": each.times[:: _every(len(each))].tolist(),
                "states": [numbers(column[:: _every(len(each))]) for column in each.states.T],
            }
            for each in trials.trials[:_TRIALS]
        ],
    }


def _every(samples: int) -> int:
    return -(-samples // _SAMPLES)


def _of_own_object(law: Law, asked: Sample) -> Law:
    """Return the law of an object that has these properties."""
    if law.uncertainty.explanation is None:
        raise CommonlawError("candidate-without-relations")
    trial = Trial(asked.object, "1", np.zeros(1), np.zeros((1, len(law.states))))
    trials = Trials((trial,), law.schema, {asked.object: dict(asked.properties)})
    return with_objects_of(law, trials)[0]


def simulated(found: Found, asked: Sample) -> dict[str, Any]:
    """Return the trajectory from a start, by a candidate of the law."""
    law = found.candidate(asked.candidate)
    if not (np.isfinite(asked.duration) and asked.duration > 0 and np.isfinite(asked.start).all()):
        raise CommonlawError("forecast-settings")
    if asked.properties:
        law = _of_own_object(law, asked)
    law.index(asked.object)
    times = np.linspace(0.0, asked.duration, _POINTS)
    forecast = forecast_from(law, asked.object, times, np.array(asked.start))
    (trajectory,) = forecast.trajectories
    ends = () if forecast.std is None else forecast.bands(measured=True)[0]
    columns = [trajectory.states[:, : len(law.states)], *ends]
    states = [
        dict(zip(("line", "low", "high"), (numbers(each[:, j]) for each in columns), strict=False))
        for j in range(len(law.states))
    ]
    return {"t": times.tolist(), "states": states, "outcome": str(trajectory.outcome or "")}
