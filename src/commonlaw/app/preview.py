"""What the page is sent of a table, of its data checks, of a forecast, and of experiments."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from commonlaw.app.equations import named, words
from commonlaw.app.question import Columns, Table, as_asked, edited, message, recognized, shown_roles, text_in_page
from commonlaw.app.result import Found, numbers
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.experiments import suggestions
from commonlaw.forecast import forecast_from
from commonlaw.law.law import object_index
from commonlaw.law.population import with_objects_of
from commonlaw.law.restrictions import ALL, TRIAL
from commonlaw.trials import Trial, Trials
from commonlaw.trials.check import Finding, Report
from commonlaw.trials.columns import Codes, Table as Cells
from commonlaw.trials.roles import GUESSED
from commonlaw.trials.tables import rows_of
from commonlaw.trials.trial import property_names

_Labels = tuple[str | None, str | None]
"""Of an object and its trial."""


def finding_kinds(check: Report, table: Cells, row_indices: Sequence[Codes]) -> list[dict[str, Any]]:
    """Return the findings in trials, whose samples are these rows of a table.

    For each kind there are its text, the number of cases, and the first of them with their rows.
    """
    labels = [(trial.object, trial.trial) for trial in check.trials]
    rows: dict[_Labels, Codes] = dict(zip(labels, row_indices, strict=True))
    return [
        {"text": text_in_page(text), "count": len(same), "cases": [_case(case, table, rows) for case in same[:12]]}
        for text, same in check.kinds().items()
    ]


def _case(found: Finding, table: Cells, rows: Mapping[_Labels, Codes]) -> dict[str, Any]:
    """Return a finding with rows of its trial, each the number that it has in the file and its cells.

    Which of the rows and columns is meant comes with it; neither if it is the trial as a whole.
    """
    indices = rows.get((found.object, found.trial))
    case: dict[str, Any] = {"text": text_in_page(found.text), "rows": [], "row": None, "column": None}
    if indices is None:
        return case
    sample, columns = found.sample or 0, table.columns.values()
    first = max(0, sample - 3)
    shown = indices[first : sample + 3 + 1].tolist()
    case["rows"] = [[table.number(row), *(cell_text(column[row]) for column in columns)] for row in shown]
    if found.sample is not None:
        case |= {"row": sample - first, "column": found.column}
    return case


def cell_text(cell: Any) -> str:
    """Return what is shown of a cell; nothing of an empty one."""
    if cell is None or cell != cell:
        return ""
    return str(cell).removesuffix(".0") if isinstance(cell, float) else str(cell)


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

    check_choice("data set of the app", name, SAMPLES)
    trials = load(name, **SAMPLES[name])
    units = trials.schema.units
    frame = trials.to_frame()
    frame.columns = [f"{column} [{units[column]}]" if column in units else column for column in frame.columns]
    call = f"cl.datasets.load({name!r}, {', '.join(f'{key}={value!r}' for key, value in SAMPLES[name].items())})"
    return Table(f"{name}.csv", frame.to_csv(index=False).encode(), call)


def preview(table: Table, columns: Columns) -> dict[str, Any]:
    """Return the columns of a table, its first rows, its trials by these columns, and what data checks find.

    Where columns do not make trials, the reason stands in place of these, beside the roles that are clear.
    """
    held = table.cells()
    shown = [[cell_text(cell) for cell in column[:8]] for column in held.columns.values()]
    answer: dict[str, Any] = {
        "name": table.name,
        "columns": list(held.columns),
        "rows": [list(row) for row in zip(*shown, strict=True)],
        "problem": "",
    }
    try:
        rows = rows_of(held, as_asked(columns))
    except CommonlawError as error:
        return answer | {"recognised": recognized(held, columns), "problem": message(error)}
    whole = Trials(*rows.data)
    check = whole.check()
    try:
        trials = edited(whole, columns)
    except CommonlawError as error:
        return answer | {"recognised": shown_roles(rows.columns), "problem": message(error)}
    answer |= {"recognised": shown_roles(rows.columns), "guessed": rows.columns.guessed and rows.columns.sentence}
    notes = [text_in_page(note) for note in check.notes if not note.startswith(GUESSED)]
    return (
        answer
        | _of_trials(trials)
        | {"all_objects": whole.objects, "checks": finding_kinds(check, held, rows.row_indices), "notes": notes}
    )


def _of_trials(trials: Trials) -> dict[str, Any]:
    schema = trials.schema
    return {
        "roles": {role: getattr(schema, role) for role in ("object", "trial", "time", "states", "inputs")}
        | {"properties": sorted(property_names(trials.properties))},
        "objects": trials.objects,
        "groups": _groups(trials),
        "labels": list(dict.fromkeys(trial.name for trial in trials)),
        "count": len(trials),
        "samples": sum(map(len, trials)),
        "units": dict(schema.units),
        "words": words(trials),
        "models": named(trials),
        "trials": [
            {
                "object": trial.object,
                "name": trial.name,
                "t": trial.times[::every].tolist(),
                "states": [numbers(column[::every]) for column in trial.states.T],
            }
            for trial in trials.trials[:60]
            for every in [-(-len(trial) // 400)]
        ],
    }


def _groups(trials: Trials) -> dict[str, str]:
    """Return what may have one value of a parameter where objects need not, in words."""
    inputs = trials.schema.inputs
    constant = [name for i, name in enumerate(inputs) if not any(np.ptp(trial.inputs[:, i]) for trial in trials)]
    groups = {TRIAL: "trial-specific"} if len(trials) > len(trials.objects) else {}
    if len(trials.objects) > 1:
        groups |= {ALL: "shared by all objects"}
        constant = [*property_names(trials.properties), *constant]
    return groups | {name: f"shared by {name}" for name in constant}


def simulated(found: Found, asked: Sample) -> dict[str, Any]:
    """Return the trajectory from a start, by a candidate of the law."""
    law = found.candidate(asked.candidate)
    if not (np.isfinite(asked.duration) and asked.duration > 0 and np.isfinite(asked.start).all()):
        raise CommonlawError("forecast-settings")
    if asked.properties:
        if law.uncertainty.explanation is None:
            raise CommonlawError("candidate-without-relations")
        trial = Trial(asked.object, "1", np.zeros(1), np.zeros((1, len(law.schema.states))))
        law = with_objects_of(law, Trials((trial,), law.schema, {asked.object: dict(asked.properties)}))[0]
    object_index(law, asked.object)
    times = np.linspace(0.0, asked.duration, 600)
    forecast = forecast_from(law, asked.object, times, np.array(asked.start))
    (trajectory,) = forecast.trajectories
    ends = () if forecast.std is None else forecast.bands(measured=True)[0]
    columns = [trajectory.states[:, : len(law.schema.states)], *ends]
    states = [
        dict(zip(("line", "low", "high"), (numbers(column[:, j]) for column in columns), strict=False))
        for j in range(len(law.schema.states))
    ]
    return {"t": times.tolist(), "states": states, "outcome": str(trajectory.outcome or "")}


class Budget(msgspec.Struct, forbid_unknown_fields=True):
    """How many trials may be made."""

    trials: int


def suggested(found: Found, asked: Budget) -> dict[str, Any]:
    """Return experiments for each purpose, with what they settle.

    Raises `CommonlawError` if the budget is none that the page offers, or nothing can be suggested.
    """
    if not 1 <= asked.trials <= 6:
        raise CommonlawError("design-budget", trials=asked.trials, limit=6)
    made = suggestions(found.law, found.findings.training, asked.trials)
    if not made:
        raise CommonlawError("design-needs-uncertain-law")
    return {
        "suggestions": [
            {
                "purpose": text_in_page(purpose),
                "experiments": [text_in_page(experiment.text) for experiment in design.experiments],
                "trials": design.cost,
                "settles": [text_in_page(sentence) for sentence in design.sentences],
            }
            for purpose, design in made.items()
        ]
    }
