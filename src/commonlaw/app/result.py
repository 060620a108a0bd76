"""What the page is sent of a law: every candidate with its equations, coefficients, fit, forecasts and pictures.

So nothing is fitted or asked for when somebody moves along the candidates.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from threading import Lock
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
import pandas as pd

from commonlaw.app.question import MAX_DRAWN_TRIALS, message, text_in_page
from commonlaw.array_types import Bools, Floats, thinned
from commonlaw.discovery.textbook import has_textbook_laws
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.forecast import Forecast
from commonlaw.forecast.forecast import squared_errors
from commonlaw.inference import CandidateLaw, candidate_law, compare, iterate_candidates
from commonlaw.law import Law
from commonlaw.law.equilibria import has_phase_plane
from commonlaw.law.law import shares_terms
from commonlaw.law.parameters import left_hand_sides, named_parameters, rate_names, standard_errors, units_with_rates
from commonlaw.law.pooling import comparable_groups, contrasts
from commonlaw.law.printing import start_lines
from commonlaw.law.script import Source, given_initial_time, to_script
from commonlaw.law.tables import quantities_by_object, readable, with_interval, with_unit
from commonlaw.library import order_of_each
from commonlaw.report.markup import equation_parts, formula
from commonlaw.runtime.progress import Stage
from commonlaw.summary import Summary, parameters_caption, remarks, shown_equations
from commonlaw.text import counted
from commonlaw.trials import Trials
from commonlaw.verdict import Findings, find

if TYPE_CHECKING:
    from commonlaw.plots import Figure


@dataclass(frozen=True, eq=False)
class ShownLaw:
    """A candidate, and what the page is sent of it."""

    candidate: CandidateLaw
    shown: dict[str, Any]

    @property
    def law(self) -> Law:
        """Its law."""
        return self.candidate.law


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found: a law with what it is good for, and its candidates."""

    findings: Findings
    about: dict[str, Any]
    """What the page is sent beside the candidates."""
    candidates: tuple[ShownLaw, ...] = ()

    @property
    def law(self) -> Law:
        """The law."""
        return self.findings.law

    @property
    def shown(self) -> dict[str, Any]:
        """All that the page is sent."""
        return self.about | {"candidates": [candidate.shown for candidate in self.candidates]}

    def candidate(self, index: int) -> Law:
        """Return the law of a candidate.

        Raises `CommonlawError` if there is none.
        """
        if not 0 <= index < len(self.candidates):
            raise CommonlawError("candidate-index", index=index, candidates=len(self.candidates))
        return self.candidates[index].law

    def of_candidate(self, index: int) -> "Found":
        """Return this with a candidate in place of the law."""
        law = self.candidate(index)
        if law is self.law:
            return self
        return replace(self, findings=find(law, self.findings.trials, self.findings.training))

    def with_laws(self, laws: Iterable[ShownLaw]) -> "Found":
        """Return this with more candidates, after those that there are."""
        return replace(self, candidates=(*self.candidates, *laws))


def results(law: Law, trials: Trials, training: Trials, show: Callable[[str], None]) -> Iterator[Found]:
    """Yield a law with all that the page needs of it, again and again with one more candidate after it."""
    show(Stage("assessing forecasts", 0.0))
    findings = find(law, trials, training)
    law = findings.law
    schema = findings.trials.schema
    of_textbook = [str(summary.textbook)] if (summary := Summary(findings)).textbook else []
    about = {
        "verdict": [text_in_page(sentence) for sentence in (*findings.sentences, *of_textbook)],
        "objects": law.objects,
        "states": [{"name": name, "unit": schema.units.get(name, "")} for name in law.schema.states],
        "orders": order_of_each(law.order, len(law.schema.states)),
        "rates": [{"name": name, "unit": units_with_rates(law).get(name, "")} for name in rate_names(law)],
        "inputs": schema.inputs,
        "terms": law.terms.names,
        "known": _terms(law, (standard_errors(law) == 0).all(axis=0)),
        "others": shares_terms(law) and law.order != 0,
        "groups": {name: [_level(value) for value in values] for name, values in comparable_groups(law).items()},
        "follows": () if law.uncertainty.explanation is None else law.uncertainty.explanation.properties,
        "time": {"name": schema.time, "unit": schema.units.get(schema.time, "")},
        "views": [
            {
                "title": view.title,
                "fit": view.is_fit,
                "held_out": not view.is_fit and findings.is_held_out,
                "trials": [
                    {"object": trial.object, "name": trial.name} for trial in view.trials.trials[:MAX_DRAWN_TRIALS]
                ],
            }
            for view in findings.curves
        ],
        "failures": [text_in_page(failure) for failure in findings.failures],
        "outcomes": [text_in_page(str(diagnostic)) for diagnostic in law.diagnostics],
        "history": [[step.stage, step.choice, text_in_page(step.reason)] for step in law.history],
    }
    made = Found(findings, about)
    for candidate in iterate_candidates(law, findings.training, 12, show):
        made = made.with_laws([_shown(candidate, made)])
        yield made


def compared(one: Found, other: Found) -> dict[str, Any]:
    """Return what tells two laws apart: evidence where the same data and states give it, and errors of both.

    There is a problem in place of evidence that cannot be compared.
    """
    problem, evidence = "", list[float | None]([None, None])
    measured = [
        [(trial.object, trial.name, trial.states.tobytes()) for trial in result.findings.training]
        for result in (one, other)
    ]
    if measured[0] != measured[1]:
        problem = "The laws were fitted to other measurements: their evidence does not compare."
    else:
        try:
            frame = compare([one.law, other.law], one.findings.training).set_index("law")["2 log B"]
            evidence = [float(frame[f"law {i}"]) for i in (1, 2)]
        except CommonlawError as error:
            problem = message(error)
    return {
        "problem": problem,
        "laws": [_summary(result, value) for result, value in zip((one, other), evidence, strict=True)],
        "views": other.candidates[0].shown["views"] if other.candidates else [],
        "trials": other.about["views"],
    }


def _summary(found: Found, evidence: float | None) -> dict[str, Any]:
    findings, law = found.findings, found.law
    errors = {}
    for curves in findings.curves:
        held_out = ", held-out trials" * findings.is_held_out
        kind = "residuals of the fit" if curves.is_fit else f"errors of forecasts{held_out}"
        rms = squared_errors(curves).mean().pow(0.5)
        errors[kind] = {name: float(f"{value:.3g}") for name, value in rms.items() if np.isfinite(value)}
    return {
        "equations": list(law.structure) if shares_terms(law) else [],
        "parameters": len(named_parameters(law).names) if shares_terms(law) else None,
        "evidence": evidence,
        "errors": errors,
    }


class Groups(msgspec.Struct, forbid_unknown_fields=True):
    """A property whose values divide objects into groups, and the index of the value that others are compared with."""

    by: str
    reference: int = 0
    candidate: int = 0


def compared_groups(found: Found, asked: Groups) -> dict[str, Any]:
    """Return how parameters of objects differ between groups, as a table.

    Raises `CommonlawError` if the property does not divide the objects into groups, there is no such value, or standard
    errors are missing.
    """
    law = found.candidate(asked.candidate)
    values = comparable_groups(law).get(asked.by, [])
    check_choice("index of the reference", asked.reference, range(len(values)))
    rows = [
        [with_unit(name, unit), _level(value), str(with_interval(*numbers))]
        for name, value, _, *numbers, unit in contrasts(law, asked.by, values[asked.reference]).values.tolist()
    ]
    return {"head": ["parameter", asked.by, f"difference from {_level(values[asked.reference])}"], "rows": rows}


def _level(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def support_of(law: Law, terms: Sequence[Sequence[str]]) -> Bools:
    """Return which terms of its library a law has if each equation has those of these names."""
    if len(terms) != len(law.schema.states):
        raise CommonlawError("equation-count", equations=len(law.schema.states), given=len(terms))
    for name in chain.from_iterable(terms):
        check_choice("term", name, law.terms.names)
    return np.array([[name in term for name in law.terms.names] for term in terms])


def of_terms(found: Found, support: Bools, show: Callable[[str], None]) -> Iterator[ShownLaw]:
    """Yield the law of other terms with all that the page needs of it."""
    show(f"fitting {counted(int(support.sum()), 'term')}")
    candidate = candidate_law(found.law, found.findings.training, support)
    show("forecasting with it")
    made = _shown(candidate, found)
    yield replace(made, shown=made.shown | {"own": True})


def _shown(candidate: CandidateLaw, found: Found) -> ShownLaw:
    """Return a candidate with what the page shows of it."""
    law, of_found, views = candidate.law, Summary(found.findings), list[dict[str, Any]]()
    summary = of_found.of_law(law)
    for view in found.findings.curves:
        curves = summary.findings.fit if view.is_fit else summary.findings.forecast
        few = view.trials.with_trials(view.trials.trials[:MAX_DRAWN_TRIALS])
        whole = len(few) == len(view.trials)
        drawn = curves if whole else of_found.curves_of(law, few, view.is_fit, law.uncertainty.has_std)
        score = "" if curves is None else summary.score(curves)
        views.append({"score": score, "curves": [] if drawn is None else [*_curves(drawn)]})
    try:  # In parts, between which a line may break
        formulas = [[formula(part) for part in parts] for parts in equation_parts(law)]
    except CommonlawError:
        formulas = []
    shown = {
        "size": candidate.size,
        "chosen": candidate.chosen,
        "evidence": candidate.evidence,
        "text": shown_equations(law),
        "formula": formulas,
        "remarks": [*start_lines(law), *remarks(law, candidate.chosen)],
        "left": left_hand_sides(law),
        "equations": _editable(law),
        "figures": [
            {"name": name, "title": kind.title, "object": kind.of_object, "parameter": kind.of_parameter}
            for name, kind in _FIGURES.items()
            if kind.is_there(law, found.findings)
        ],
        "terms": _terms(law, law.support),
        "caption": parameters_caption(law),
        "table": _table(summary.parameters),
        "quantities": _table(quantities_by_object(law)),
        "views": views,
    }
    return ShownLaw(candidate, shown)


def _terms(law: Law, support: Bools) -> list[list[str]]:
    return [[name for name, there in zip(law.terms.names, row, strict=True) if there] for row in support]


def _table(frame: pd.DataFrame) -> dict[str, Any]:
    cells = readable(frame).to_numpy().tolist()
    rows = [[f"{cell:.4g}" * (cell == cell) if isinstance(cell, float) else str(cell) for cell in row] for row in cells]
    return {"head": list(frame), "rows": rows}


def _editable(law: Law) -> dict[str, Any] | None:
    """Return a law as the page's editor begins with it; None if its objects do not share equations that it can fit."""
    if not shares_terms(law) or law.order == 0:
        return None
    parameters = named_parameters(law)
    low, high = (parameters.values,) * 2 if law.uncertainty.covariance is None else parameters.intervals()
    observed = (f"{a} = {b}" for a, b in law.observation.written.items())
    schema = law.observation.measured
    return {
        "text": ";\n".join([*law.structure, *observed]),
        "values": {name: numbers(column) for name, column in zip(parameters.names, parameters.values.T, strict=True)},
        "errors": {
            name: float(np.nan_to_num(np.max(wide), posinf=0.0))
            for name, wide in zip(parameters.names, (high - low).T / 2, strict=True)
        },
        "starts": {
            name: "free" if start is None else str(start)
            for name, start in schema.initial_values.items()
            if not isinstance(start, Mapping)
        },
        "initial_time": given_initial_time(law),
        "doses": schema.doses,
    }


def _curves(forecast: Forecast) -> Iterator[dict[str, Any]]:
    """Yield for each trial times, and by state what was measured, forecast, and the ends of the band.

    A curve has 60 points or as many as samples, and about 400 at most.
    """
    smooth, states = forecast.smooth(60), len(forecast.trials.schema.states)
    bands = None if smooth.std is None else smooth.bands(measured=smooth.noise is not None)
    for i, (trial, trajectory) in enumerate(zip(smooth.trials, smooth.trajectories, strict=True)):
        every = thinned(len(trial.times), 460)
        columns = [trial.states, trajectory.states[:, :states], *((None, None) if bands is None else bands[i])]
        yield {
            "t": numbers(trial.times[every]),
            "states": [[None if part is None else numbers(part[every, j]) for part in columns] for j in range(states)],
        }


def numbers(values: Floats) -> list[float | None]:
    """Return numbers with five digits; what is not finite is None."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values.tolist()]


one_draws = Lock()
"""Matplotlib draws in one thread at a time."""


class _FigureKind(NamedTuple):
    """A kind of picture: title, what draws it of an object and a parameter, that as Python, and when it is there.

    What draws it takes the room of plots, which is imported for the first picture.
    """

    title: str
    draw: Callable[[Any, Found, str, str], "Figure"]
    written: str
    is_there: Callable[[Law, Findings], bool] = lambda *_: True
    of_object: bool = False
    of_parameter: bool = False


_FIGURES = {
    "law": _FigureKind(
        "Law with fit and coefficients",
        lambda plots, found, *_: plots.plot_law(found.law, curves(found, found.findings.shown)),
        "plot_law(law, trials)",
    ),
    "fit": _FigureKind(
        "Fitted curves and residuals",
        lambda plots, found, *_: plots.plot_forecast(curves(found, found.findings.fit)),
        "plot_forecast(law.predict(trials, start='all', return_std={bands}))",
    ),
    "forecast": _FigureKind(
        "Forecasts with bands",
        lambda plots, found, *_: plots.plot_forecast(curves(found, found.findings.forecast)),
        "plot_forecast(law.predict({measured}, start={start}, return_std={bands}))",
        lambda _, findings: findings.forecast is not None,
    ),
    "residuals": _FigureKind(
        "Residuals: patterns, autocorrelation, quantiles",
        lambda plots, found, *_: plots.plot_residuals(found.law.residuals(found.findings.training)),
        "plot_residuals(law.residuals(trials))",
        lambda law, _: law.order != 0,
    ),
    "textbook": _FigureKind(
        "What the nearest law of textbooks leaves",
        lambda plots, found, *_: plots.plot_textbook(
            found.law.textbook(found.findings.trials, found.findings.training)
        ),
        "plot_textbook(law.textbook(trials))",
        lambda law, _: not law.provenance.equations and has_textbook_laws(law),
    ),
    "coefficients": _FigureKind(
        "Coefficients by object",
        lambda plots, found, *_: plots.plot_coefficients(found.law, "support"),
        "plot_coefficients(law, 'support')",
        lambda law, _: shares_terms(law),
    ),
    "phase-plane": _FigureKind(
        "Phase plane with nullclines and fixed points",
        lambda plots, found, owner, _: plots.plot_phase_plane(found.law, found.findings.training, owner),
        "plot_phase_plane(law, trials, {object!r})",
        lambda law, _: has_phase_plane(law),
        of_object=True,
    ),
    "profile": _FigureKind(
        "Profile likelihood of a parameter",
        lambda plots, found, owner, name: plots.plot_profile(found.law, found.findings.training, name, owner),
        "plot_profile(law, trials, {parameter!r}, {object!r})",
        lambda law, _: shares_terms(law) and law.order != 0 and bool(named_parameters(law).names),
        of_object=True,
        of_parameter=True,
    ),
}


def figure_file(
    name: str, found: Found, source: Source, is_candidate: bool = False, owner: str = "", parameter: str = ""
) -> bytes:
    """Return a picture of a law, by its kind and ending; or the program that draws it, which loads a candidate.

    Raises `CommonlawError` if there is no such picture, or the law has it not.
    """
    kind, _, ending = name.partition(".")
    check_choice("figure", kind, _FIGURES)
    check_choice("ending of a figure", ending, ("svg", "png", "py"))
    if ending == "py":
        findings, lines = found.findings, to_script(found.law, source).splitlines()
        # Of another candidate there is no program that finds it: its law is loaded
        left_out = ("print(", "law = ") if is_candidate else ("print(",)
        lines = [line for line in lines if not line.startswith(left_out)]
        lines += ["law = cl.Law.load('law.json')"] * is_candidate
        measured = "measured" if findings.has_later_samples else "trials"
        if findings.is_held_out and source.training.endswith("[1]"):
            measured = source.training.removesuffix("[1]") + "[0]"
        bands = findings.fit is not None and findings.fit.std is not None
        named = {"object": owner, "parameter": parameter, "start": findings.start}
        call = _FIGURES[kind].written.format(bands=bands, measured=measured, **named)
        lines += [f"figure = cl.plots.{call}", f"cl.plots.save_figure(figure, '{kind}.svg')", ""]
        return "\n".join(lines).encode()
    with one_draws:
        from commonlaw import plots

        try:
            return plots.render(_FIGURES[kind].draw(plots, found, owner, parameter), f".{ending}")
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            raise CommonlawError("figure-failed", figure=kind, reason=error) from None


def curves(found: Found, wanted: Forecast | None) -> Forecast:
    """Return curves, which a law in discrete time, say, may not have."""
    if wanted is None:
        raise CommonlawError("curves-missing", reasons=found.findings.failures or ["a law in discrete time has none"])
    return wanted
