"""Given equations that are fitted by collocation, each object by itself but for what all share; or in discrete time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any, cast

import numpy as np

from commonlaw.diagnostics import Outcome, OutcomeKind
from commonlaw.discovery.hints import outcomes_of_inputs, outcomes_of_units, with_change_by_errors
from commonlaw.discovery.known_physics import known_coefficients, unfitted
from commonlaw.discovery.measured_rates import without_measured_rates
from commonlaw.discovery.method import Known, ModelStructure
from commonlaw.discovery.regression import DiscreteTimeRegression, suitable_differentiation
from commonlaw.discovery.request import FitRequest
from commonlaw.discovery.shooting import by_shooting
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.estimation.beginning import FREE
from commonlaw.estimation.fitting import refused_settings
from commonlaw.estimation.profile import with_one_sided_limits
from commonlaw.inference.diagnose.scale_origin import with_origin_outcomes
from commonlaw.inference.propose.nonlinear_parameters import outcomes_of_parameters, with_initial_parameters
from commonlaw.inference.search.setup import RefitOptions
from commonlaw.inference.verbs.collocation import refined
from commonlaw.inference.verbs.parameter_bounds import is_near, is_within, refuse_outside
from commonlaw.law import Law, Provenance, Step
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import GivenEquations, read_equations
from commonlaw.law.provenance import Domain
from commonlaw.law.restrictions import Restrictions
from commonlaw.law.uncertainty import OneSidedLimit
from commonlaw.library import ExpressionLibrary
from commonlaw.library.bounds import Bound
from commonlaw.library.equation import Equation, split_equations
from commonlaw.runtime.fit_options import changed_settings
from commonlaw.runtime.progress import on_terminal
from commonlaw.solvers import STLSQ
from commonlaw.trials import Trials
from commonlaw.trials.transformations import (
    objects_at_rest,
    outcome_of_rest,
    outcome_of_undosed,
    with_doses,
    with_starts,
    without_objects,
)
from commonlaw.trials.trial import Start, property_names


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A request with trials whose states are those of the equations, and these read."""

    request: FitRequest
    trials: Trials
    given: GivenEquations
    settings: dict[str, Any]
    resting: tuple[str, ...]
    outcomes: tuple[Outcome, ...]
    history: tuple[Step, ...]

    @classmethod
    def of(cls, request: FitRequest) -> "_Prepared":
        equations = split_equations(request.equations)
        states = [equation.state for equation in equations]
        second = [equation.state for equation in equations if equation.order == 2]
        trials, rates = without_measured_rates(request.trials, second, states)
        starts = {name: None if start == FREE else start for name, start in request.initial_values.items()}
        resting = () if request.shared or starts else objects_at_rest(trials)
        trials = with_doses(without_objects(trials, resting), request.doses)
        _check_starts(request, trials, equations, starts)
        trials = with_starts(trials, cast(dict[str, Start], starts), request.at)
        properties, settings = property_names(trials.properties), dict(request.settings)
        given = read_equations(request.equations, trials.schema, properties=properties, functions=request.functions)
        if request.doses and settings["input_interpolation"] is None:
            settings["input_interpolation"] = "linear"
        text = "; ".join((*given.texts, *(bound.text for bound in given.bounds)))
        when = "the first sample of each trial" if request.at is None else f"t = {request.at:g}"
        names = {coefficient.name for coefficient in given.coefficients}
        history = (
            Step("equations", text, "as given"),
            Step("scheme", "collocation", request.why_collocation),
            *(
                Step("start", f"{name} = {start} at {when}", "as given, for a latent state")
                if start is not None
                else Step("start", name, "latent state; the initial value was estimated in each trial")
                for name, start in starts.items()
            ),
            *(Step("property", name, "given for each object, not estimated") for name in properties if name in names),
        )
        outcomes = (*rates, *outcome_of_undosed(request.undosed), *outcome_of_rest(resting))
        return cls(request, trials, given, settings, resting, outcomes, history)

    @property
    def has_starts(self) -> bool:
        """Whether there are latent states with initial values."""
        return bool(self.request.initial_values)


def by_collocation(request: FitRequest) -> Law:
    """Return the law of a request, by shooting where objects do not determine their parameters by themselves."""
    prepared = _Prepared.of(request)
    return _in_discrete_time(prepared) if prepared.given.order == 0 else _in_continuous_time(prepared)


def _check_starts(
    request: FitRequest, trials: Trials, equations: Sequence[Equation], starts: Mapping[str, object]
) -> None:
    """Refuse initial values of what is no latent state of first order, and states without a column or initial value."""
    states = [equation.state for equation in equations]
    for name in starts:
        check_choice("state of the equations", name, states)
        if name in trials.schema.inputs:
            raise CommonlawError("equation-of-input", name=name)
    columns = (*trials.schema.states, *trials.schema.inputs, *starts)
    if starts and (missing := [name for name in states if name not in columns]):
        raise CommonlawError("equation-without-column", name=missing[0])
    if latent := [equation.state for equation in equations if equation.state in starts and equation.order != 1]:
        raise CommonlawError("latent-of-second-order", state=latent[0])
    if request.initial_time is not None and not starts:
        raise CommonlawError("initial-time-without-values")
    if request.guesses and starts:
        raise CommonlawError("guess-with-latent-states")


def _in_discrete_time(prepared: _Prepared) -> Law:
    given, trials, request = prepared.given, prepared.trials, prepared.request
    if given.terms.parameters:
        variables = given.terms.variables
        raise CommonlawError(
            "discrete-with-parameters", names=", ".join(variables.parameters), variables=variables.measured
        )
    law = _next_samples(given, trials, {**prepared.settings, "shared": request.shared or None})
    # Of what a search says, only this concerns terms that were given
    ill_conditioned = (diagnostic for diagnostic in law.diagnostics if diagnostic.kind is OutcomeKind.ILL_CONDITIONED)
    provenance = Provenance(
        outcomes=(*with_origin_outcomes(ill_conditioned, law, trials), *outcome_of_rest(prepared.resting)),
        history=prepared.history,
        equations=given.texts,
        calls=request.calls,
        domain=Domain(at_rest=prepared.resting),
    )
    refuse_outside(law, given.bounds)
    return replace(law, provenance=provenance)


def _in_continuous_time(prepared: _Prepared) -> Law:
    request, trials, given, settings = prepared.request, prepared.trials, prepared.given, prepared.settings
    provenance = Provenance(
        suitable_differentiation(trials, given.order),
        prepared.outcomes,
        history=prepared.history,
        equations=given.texts,
        domain=Domain(at_rest=prepared.resting),
    )
    progress = settings.pop("progress") or on_terminal()
    settings["input_interpolation"] = settings["input_interpolation"] or "auto"
    options = RefitOptions(**settings, least_squares=request.least_squares)
    bounds = tuple(bound.text for bound in given.bounds)
    restrictions = Restrictions(dict(request.groups), bounds=bounds)
    start = unfitted(given, trials, provenance, restrictions)
    names = named_parameters(start).names
    _check_guesses(request.guesses, names, given.bounds)
    for name in request.shared:
        check_choice("coefficient", name, names)
    quotients = [entry.name for entry in named_parameters(start).definitions if len(entry.parts) > 1]
    if quotients := [name for name in request.shared if name in quotients]:
        if request.functions:
            raise CommonlawError("parameter-is-quotient", parameter=quotients[0])
        if request.scheme == "collocation":
            raise CommonlawError("beyond-collocation", reasons=[f"{quotients[0]}, a shared quotient"])
        return by_shooting(request, f"for {quotients[0]}, a shared quotient")
    try:
        begun = with_initial_parameters(start, trials, options, given.bounds, request.guesses, progress)
        law = refined(begun, trials, options, progress)
    except CommonlawError as error:
        return _together(request, names, error)
    refused = [*refused_settings(request.changed), *request.refused_by_shooting]
    if is_near(law, given.bounds) and not refused and not law.uncertainty.error_model.of_law:
        return by_shooting(_under_errors_of(law, request), "for a parameter next to its bound")
    if not is_within(law, given.bounds):
        if refused:
            refuse_outside(law, given.bounds, refused)
        try:
            return by_shooting(_under_errors_of(law, request), "for bounds of parameters")
        except CommonlawError as error:
            if error.code == "parameters-not-identified":  # At the bound, as of zero that is divided by
                refuse_outside(law, given.bounds)
            raise

    def under_white_noise() -> Law:
        return refined(begun, trials, replace(options, errors="white", least_squares=True), progress)

    law = with_change_by_errors(law, under_white_noise) if options.errors == "auto" else law
    law = law if request.functions else with_one_sided_limits(law, trials)
    # Latent states have a note of their own
    is_vague = not prepared.has_starts and _is_undetermined(law)
    if not request.refused_by_shooting and (
        is_vague or any(_is_misfit(law, limit) for limit in law.uncertainty.limits)
    ):
        # Other estimates, and their errors, are those given a value that has no meaning
        try:
            return by_shooting(_under_errors_of(law, request), "for a parameter that has no estimate, but a limit")
        except CommonlawError as error:
            if error.code == "parameters-not-identified" and not law.uncertainty.limits:
                raise
    outcomes = (*law.diagnostics, *outcomes_of_parameters(law), *outcomes_of_units(law, trials))
    outcomes += outcomes_of_inputs(law, trials)
    made = replace(law.provenance, calls=request.calls, outcomes=outcomes)
    return replace(law, provenance=made)


def _under_errors_of(law: Law, request: FitRequest) -> FitRequest:
    """Return a request for the errors of measurements that were chosen for a law by default."""
    errors = law.uncertainty.error_model
    if request.settings["errors"] != "auto" or not errors or errors.of_law:
        return request
    return replace(request, settings={**request.settings, "errors": errors.kind})


def _check_guesses(guesses: Mapping[str, float], names: Sequence[str], bounds: Sequence[Bound]) -> None:
    for name, value in guesses.items():
        check_choice("coefficient", name, names)
        within = [bound for bound in bounds if bound.name == name]
        if not np.isfinite(value) or value == 0 or not all(bound.holds(np.array(value)) for bound in within):
            raise CommonlawError("guess-out-of-bounds", name=name, value=value)


def _together(request: FitRequest, names: Sequence[str], error: CommonlawError) -> Law:
    """Return a fit by shooting, which may give limits, or share parameters, where one of objects apart failed."""
    if request.refused_by_shooting:
        raise error
    reason = "objects determine it together"
    if error.code == "state-constant-of-object" and request.shared:
        resting = () if {*names} <= {*request.shared} else objects_at_rest(request.dosed)
        if resting or {*names} <= {*request.shared}:
            return by_shooting(request, reason, resting)
    codes = ("more-unknowns-than-measurements", "no-degrees-of-freedom")
    if error.code in ("likelihood-not-computable", "no-law-near-measurements"):
        reason = "by collocation it has no maximum"
    elif error.code != "parameters-not-identified" and not (request.shared and error.code in codes):
        raise error
    try:
        return by_shooting(request, reason)
    except CommonlawError as of_model:
        raise (of_model if request.shared else error) from None


def _is_misfit(law: Law, limit: OneSidedLimit) -> bool:
    """Whether an estimate that has only a limit is beyond it, or less than its standard error."""
    parameters = named_parameters(law)
    place = law.objects.index(limit.object), parameters.names.index(limit.parameter)
    value, error = float(parameters.values[place]), float(parameters.errors[place])
    return (value < limit.value) == limit.is_lower or error > abs(value)


def _is_undetermined(law: Law) -> bool:
    """Whether two parameters or more have no limit and standard errors above their estimates in all objects.

    One of them is inside of a term.
    """
    parameters = named_parameters(law)
    vague = np.all(parameters.errors > np.abs(parameters.values), axis=0).tolist()
    names = {*compress(parameters.names, vague)}
    return len(names) > 1 and not names.isdisjoint(law.terms.variables.parameters)


def _next_samples(given: GivenEquations, trials: Trials, settings: dict[str, Any]) -> Law:
    """Return the law in discrete time whose coefficients are those of least squares."""
    taken = ("n_jobs", "progress")
    if refused := ", ".join(name for name in changed_settings("fit", settings) if name not in taken):
        raise CommonlawError("discrete-without-option", refused=refused)
    names, terms, values = given.terms.variables.names, given.terms.terms, known_coefficients(given, trials)
    functions = given.terms.variables.functions
    library = ExpressionLibrary(*(term.expression(names) for term in terms), functions=functions)
    known: Known = {
        (trials.schema.states[j], given.terms.names[k]): dict(
            zip(trials.objects, values[:, j, k].tolist(), strict=True)
        )
        for j, k in np.argwhere(~np.isnan(values).any(axis=0)).tolist()
    }
    progress = settings.get("progress") or on_terminal()
    return DiscreteTimeRegression(solver=STLSQ(0.0)).find(trials, ModelStructure(0, library, known), progress)
