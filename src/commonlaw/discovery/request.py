"""What is asked of a fit of given equations, read once."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.estimation import beyond_collocation
from commonlaw.estimation.beginning import (
    FREE,
    InitialGiven,
    initial_time_of,
    refuse_zero_columns,
    written_starts,
    zero_columns,
)
from commonlaw.estimation.doses import usual_initial_time, with_doses_in_equations
from commonlaw.estimation.model import ModelText, read_model
from commonlaw.law.restrictions import ALL
from commonlaw.library.equation import split_equations
from commonlaw.library.functions import Function
from commonlaw.likelihood.levels import states_of_open_scale
from commonlaw.runtime.fit_options import changed_settings
from commonlaw.trials import Trials
from commonlaw.trials.equation_columns import as_named
from commonlaw.trials.transformations import amounts_at_samples, refuse_standing_time, with_doses
from commonlaw.trials.trial import property_names


@dataclass(frozen=True, eq=False)
class FitRequest:
    """Arguments of `commonlaw.fit`, with what follows from them.

    Parameters
    ----------
    equations, text
        As given, but for doses in them, and read as parts of a model.
    trials, dosed
        With columns as the equations name them; and with pulses in place of `doses`, which the table does not record.
    initial_values, initial_time, at
        As given, with the time that is usual for the table; and that time, None for the first sample of each trial.
    groups
        By parameter what has one value of it, see `Restrictions`.
    functions
        Of Python, that the equations call.
    settings
        Of `FitOptions`, by name.
    least_squares
        Whether no measurement counts as an outlier.
    undosed
        Objects that were left out, as they have no dose.
    calls
        What made the law, as Python.
    """

    equations: str | Sequence[str]
    text: ModelText
    trials: Trials
    dosed: Trials
    doses: tuple[str, ...]
    initial_values: Mapping[str, InitialGiven]
    initial_time: float | Literal["first"] | None
    at: float | None
    groups: Mapping[str, str]
    guesses: Mapping[str, float]
    priors: Mapping[str, tuple[float, float]]
    functions: tuple[Function, ...]
    scheme: Literal["auto", "collocation", "shooting"]
    settings: Mapping[str, Any]
    least_squares: bool
    undosed: tuple[str, ...]
    calls: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        equations: str | Sequence[str],
        trials: Trials,
        *,
        initial_values: Mapping[str, InitialGiven] | None,
        initial_time: float | Literal["first"] | None,
        doses: str | Sequence[str],
        shared: str | Sequence[str] | Mapping[str, str],
        guesses: Mapping[str, float] | None,
        observe: Mapping[str, str] | None,
        priors: Mapping[str, tuple[float, float]] | None,
        functions: tuple[Function, ...],
        scheme: Literal["auto", "collocation", "shooting"],
        settings: Mapping[str, Any],
    ) -> "FitRequest":
        """Return the request of arguments; refuse columns and starts that contradict the equations."""
        doses = (doses,) if isinstance(doses, str) else tuple(doses)
        shared = (shared,) if isinstance(shared, str) else shared
        refuse_standing_time(trials)
        owners = trials.objects
        equations, trials = with_doses_in_equations(equations, trials, doses)
        doses = () if trials.schema.doses else doses  # The table records them
        text, starts = ModelText.of(equations, observe), dict(initial_values or {})
        written = [equations] if isinstance(equations, str) else equations
        trials = as_named(trials, text.named, "; ".join([*written, *text.observed.values()]))
        if settings["input_interpolation"] is None:
            _refuse_interpolated_amounts(text, trials, doses)
        dosed = with_doses(trials, doses)
        if not functions:
            _refuse_zero_columns(text, dosed)
        initial_time = usual_initial_time(trials) if initial_time is None else initial_time
        at = initial_time_of(dosed, initial_time, written_starts(text, starts))
        _refuse_free_starts(dosed, [name for name, start in starts.items() if start in (None, FREE)])
        groups = shared if isinstance(shared, Mapping) else dict.fromkeys(shared, ALL)
        return cls(
            equations,
            text,
            trials,
            dosed,
            doses,
            starts,
            initial_time,
            at,
            groups,
            guesses or {},
            priors or {},
            functions,
            scheme,
            settings,
            settings["errors"] == "white",
            tuple(name for name in owners if name not in dosed.objects),
        )

    @property
    def changed(self) -> dict[str, Any]:
        """The settings that are not the default."""
        return changed_settings("fit", self.settings)

    @property
    def shared(self) -> tuple[str, ...]:
        """The parameters that all objects share."""
        return tuple(name for name, by in self.groups.items() if by == ALL)

    @property
    def said_time(self) -> float | Literal["first"] | None:
        """The time of initial values, as it is written."""
        return "first" if self.at is None and written_starts(self.text, self.initial_values) else self.at

    @property
    def beyond_collocation(self) -> list[str]:
        """What is to be fitted by shooting, in words."""
        reasons = beyond_collocation(
            self.text, self.dosed, self.initial_values, self.groups, self.priors, self.settings["noise"]
        )
        return reasons + ["doses"] * bool(self.trials.schema.doses)

    @property
    def open_scale(self) -> tuple[str, ...]:
        """Measured states whose scale is a choice, see `states_of_open_scale`."""
        is_first_order = all(equation.order == 1 for equation in split_equations(self.text.equations))
        given = {name: self.settings[name] for name in ("errors", "noise", "log_states")}
        return states_of_open_scale(self.dosed, **given, is_first_order=is_first_order)

    @property
    def why_shooting(self) -> str:
        """Why the request is fitted by shooting, with a comma between reasons; empty if collocation is tried first."""
        beyond = self.beyond_collocation
        if beyond and self.scheme == "collocation":
            raise CommonlawError("beyond-collocation", reasons=beyond)
        return "as given" if self.scheme == "shooting" else f"for {', '.join(beyond)}" if beyond else ""

    @property
    def why_collocation(self) -> str:
        """Why the request is fitted by collocation, where it is."""
        return "as given" if self.scheme == "collocation" else "the equations need nothing else"

    @property
    def refused_by_shooting(self) -> list[str]:
        """The arguments for which shooting does not fit what collocation cannot, settings apart."""
        return ["scheme"] * (self.scheme == "collocation") + [function.text for function in self.functions]


def _refuse_interpolated_amounts(model: ModelText, trials: Trials, doses: Sequence[str]) -> None:
    """Refuse equations with an input that is called an amount and holds single ones, unless these are doses."""
    for name in amounts_at_samples(trials):
        occurrence = re.compile(rf"(?<!\w)`?{re.escape(name)}`?(?!\w)")
        if name not in doses and any(occurrence.search(equation) for equation in model.equations):
            raise CommonlawError("doses-interpolated", name=name)


def _refuse_zero_columns(text: ModelText, trials: Trials) -> None:
    """Refuse parameters of columns of zeros; what else may be wrong with equations is refused where they are fitted."""
    if not (columns := zero_columns(trials)):
        return
    try:
        model = read_model(text, trials.schema, property_names(trials.properties))
    except CommonlawError:
        return
    refuse_zero_columns(model, trials, columns)


def _refuse_free_starts(trials: Trials, states: Sequence[str]) -> None:
    """Refuse free initial values of states that are zero before the first dose of a trial."""
    for trial in trials:
        measured = {
            name for name, value in zip(trials.schema.states, trial.states[0], strict=True) if np.isfinite(value)
        }
        if trial.begins_with_dose and (zero := [name for name in states if name not in measured]):
            raise CommonlawError(
                "free-start-with-dose", trial=trial.label, state=zero[0], start=f"{zero[0]}(0) = {zero[0]}0"
            )
