"""Equations that a user writes: read as they are typed, and solved as sliders move."""

from dataclasses import replace
from functools import lru_cache
from time import monotonic
from typing import Any

import msgspec
import numpy as np

from commonlaw.app.question import MAX_DRAWN_TRIALS, Columns, Equations, Table, message
from commonlaw.array_types import Floats, Indices
from commonlaw.discovery.measured_rates import without_measured_rates
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.estimation import beyond_collocation
from commonlaw.estimation.beginning import Beginning, begin, initial_time_of, written_starts
from commonlaw.estimation.doses import usual_initial_time, with_doses_in_equations
from commonlaw.estimation.model import ModelText
from commonlaw.estimation.problem import Problem, TrialData
from commonlaw.law.models import named_models
from commonlaw.law.observation import written as written_of
from commonlaw.law.parse import latex_summands, read_equations
from commonlaw.law.text import aligned, latex_left_hand_sides, latex_observed
from commonlaw.library import with_rates
from commonlaw.library.bounds import parts_of as parts_of_text
from commonlaw.library.equation import split_equations
from commonlaw.library.grammar import FUNCTION_NAMES
from commonlaw.report.markup import formula, parts_of
from commonlaw.trials import Trials
from commonlaw.trials.equation_columns import as_named
from commonlaw.trials.transformations import with_doses
from commonlaw.trials.trial import property_names


class Asked(msgspec.Struct, forbid_unknown_fields=True):
    """Equations that are written for a table."""

    table: str
    columns: Columns
    equations: Equations
    moved: "Moved | None" = None


class Moved(msgspec.Struct, forbid_unknown_fields=True):
    """Curves that follow a slider: trials by index, the most urgent first, and free initial values of all trials."""

    trials: list[int]
    initial: list[list[float]]


def words(trials: Trials) -> list[str]:
    """Return what may stand in equations: states, rates, inputs, time, properties and functions."""
    schema = trials.schema
    measured = [*schema.states, *(f"{name}'" for name in schema.states), *schema.inputs]
    return [*measured, "t", *property_names(trials.properties), *(f"{f}(" for f in FUNCTION_NAMES)]


def named(trials: Trials) -> list[dict[str, Any]]:
    """Return the models of textbooks over the columns of a table, as far as it is clear which is which."""
    properties, result = property_names(trials.properties), list[dict[str, Any]]()
    for name, model in named_models.items():
        try:
            matched = model.over_columns(trials.schema, properties, {})
        except CommonlawError:
            continue
        if {*trials.schema.states} <= {*matched.states}:
            text = "\n".join(parts_of_text(matched.equations))
            result.append(
                {"name": name, "title": model.title, "field": model.field, "text": text, "doses": matched.doses}
            )
    return result


def solved(table: Table, columns: Columns, equations: Equations, moved: Moved | None = None) -> dict[str, Any]:
    """Return equations as they were read, their parameters with first values, and their curves.

    Where they cannot be read there is a problem instead. Where a slider moved there are only as many curves as can be
    computed at once, each with the index of its trial.
    """
    try:
        sought = Equations(
            equations.text, starts=equations.starts, initial_time=equations.initial_time, doses=equations.doses
        )
        begun, trials, formulas = _read(table, msgspec.json.encode((columns, sought)))
    except CommonlawError as error:
        return {"problem": message(error)}
    first = begun.first.copy()
    columns_of = {trial.object: parameter for trial, parameter in zip(trials, begun.unknowns.parameters, strict=True)}
    for at, owner in enumerate(trials.objects):
        for name, k in zip(begun.model.parameters, columns_of[owner], strict=True):
            given = equations.values.get(name, ())
            if k >= 0 and at < len(given):
                first[k] = given[at]
    if moved is not None:
        return {"problem": "", "curves": _followed(begun.problem, first, moved)}
    values = {
        name: [float(first[columns_of[owner][i]]) for owner in trials.objects]
        for i, name in enumerate(begun.model.parameters)
        if columns_of[trials.objects[0]][i] >= 0
    }
    return {
        "problem": "",
        "formula": formulas,
        "states": begun.model.observables,
        "values": values,
        "curves": [_curve(begun.problem, trial, first) for trial in begun.problem.trials[:MAX_DRAWN_TRIALS]],
    }


@lru_cache(maxsize=8)
def _read(table: Table, asked: bytes) -> tuple[Beginning, Trials, list[list[str]]]:
    """Return how a fit begins of the columns and equations in JSON, the trials, and the equations as MathML."""
    columns, equations = msgspec.json.decode(asked, type=tuple[Columns, Equations])
    written, recorded = with_doses_in_equations(equations.text, table.trials(columns), equations.doses)
    trials = recorded if recorded.schema.doses else with_doses(recorded, equations.doses)
    model_text, given = ModelText.of(written), equations.initial
    trials = as_named(trials, model_text.named, written if isinstance(written, str) else "; ".join(written))
    split = split_equations(model_text.equations)
    second = [equation.state for equation in split if equation.order == 2]
    trials, _ = without_measured_rates(trials, second, [equation.state for equation in split])
    if not (recorded.schema.doses or beyond_collocation(model_text, trials, given, {}, None) or given):
        properties = property_names(trials.properties)
        read_equations("; ".join(model_text.equations), trials.schema, properties=properties)  # Says what `fit` refuses
    initial_time = usual_initial_time(recorded) if equations.initial_time is None else equations.initial_time
    at = initial_time_of(trials, initial_time, written_starts(model_text, given))
    begun = begin(model_text, trials, given, at)
    begun = replace(begun, problem=replace(begun.problem, tolerance=1e-5), first=_with_rates(begun))
    model = begun.model
    lefts = latex_left_hand_sides(model.schema.states, model.order)
    others = written_of(model.text.observed, model.text.initial, model.text.events)
    rows = latex_summands(model.text.equations, model.schema, model.variables, others)
    lefts = (*lefts, *latex_observed(others))
    try:
        formulas = [[formula(part) for part in parts] for parts in parts_of(aligned(zip(lefts, rows, strict=True)))]
    except CommonlawError:  # Some names cannot be drawn
        formulas = []
    return begun, trials, formulas


def _with_rates(begun: Beginning) -> Floats:
    """Return the first values, with initial rates by straight lines through the first samples."""
    model, first = begun.model, begun.first.copy()
    count = len(model.schema.states)
    second = with_rates(model.order, count).tolist()
    for data in begun.problem.trials:
        for i, j in enumerate(second):
            k, name = data.initial[count + i], model.schema.states[j]
            if k >= 0 and name in model.observables:
                column = data.trial.states[:, model.observables.index(name)]
                seen = np.flatnonzero(np.isfinite(column))[:5]
                if len(seen) > 1:
                    first[k] = np.polyfit(data.trial.times[seen], column[seen], 1)[0]
    return first


def _followed(problem: Problem, unknowns: Floats, moved: Moved) -> list[tuple[int, list[list[float]]]]:
    """Return solutions from given initial values: those that are computed in time, and at least one."""
    # Curves that follow a slider are sent after 0.02 s of computing; the others come with the next answer
    shown, until, result = problem.trials[:MAX_DRAWN_TRIALS], monotonic() + 0.02, list[tuple[int, list[list[float]]]]()
    for i in moved.trials:
        check_choice("index of a trial", i, range(min(len(shown), len(moved.initial))))
        data, _ = _drawn(shown[i])
        free = data.initial >= 0
        if sum(free) != len(moved.initial[i]):
            names = np.array(problem.model.variables.states)[free].tolist()
            raise CommonlawError("start-size", given=len(moved.initial[i]), expected=len(names), variables=names)
        unknowns[data.initial[free]] = moved.initial[i]
        with np.errstate(all="ignore"):
            values = problem.predicted(data, unknowns, slopes=False).values
        result.append((i, _natural(problem, values)))
        if monotonic() > until:
            break
    return result


def _drawn(data: TrialData, points: int = 60) -> tuple[TrialData, Indices]:
    """Return a trial with a row for each point of its curve, and which of them are its samples."""
    times = data.times
    if len(times) < points:
        times = np.union1d(times, np.linspace(times[0], times[-1], points))
    return replace(data, times=times, rows=np.arange(len(times))), np.searchsorted(times, data.trial.times)


def _natural(problem: Problem, values: Floats) -> list[list[float]]:
    """Return a column for each observable, from values of which some are logarithms."""
    with np.errstate(all="ignore"):
        columns: list[list[float]] = np.where(problem.logarithmic, np.exp(values), values).T.tolist()
    return columns


def _curve(problem: Problem, data: TrialData, unknowns: Floats) -> dict[str, Any]:
    """Return the solution for a trial, its free initial values by least squares."""
    data, rows = _drawn(data)
    free, measured = data.initial[data.initial >= 0], data.trial.states
    seen, scale = np.isfinite(measured), np.nanstd(measured, axis=0) + 1e-300
    best, unknowns, values = np.inf, unknowns.copy(), np.full((len(data.times), measured.shape[1]), np.nan)
    initial = unknowns[free]
    for step in range(3):  # Two Gauss-Newton steps
        with np.errstate(all="ignore"):
            predicted = problem.predicted(data, unknowns, step < 2 and len(free) > 0)
            residuals = ((predicted.values[rows] - measured) / scale)[seen]
            cost = float(residuals @ residuals)
        if step and not cost < best:
            break
        best, values, initial = cost, predicted.values, unknowns[free]
        if predicted.slopes is None or not np.isfinite(cost):
            break
        slopes = (predicted.slopes[rows][..., free] / scale[:, np.newaxis])[seen]
        unknowns[free] -= np.linalg.lstsq(slopes, residuals, rcond=None)[0]
    return {
        "object": data.trial.object,
        "name": data.trial.name,
        "t": data.times.tolist(),
        "states": _natural(problem, values),
        "initial": initial.tolist(),
    }
