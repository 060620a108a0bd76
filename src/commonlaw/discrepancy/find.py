"""Estimate the discrepancy of a law, a function that its objects share: candidates, fit, shares of the residuals."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.discrepancy.function import Compared, Description, Discrepancy
from commonlaw.discrepancy.observed import ObservedSetting
from commonlaw.discrepancy.setting import AbstractSetting, Visited
from commonlaw.discrepancy.smooth_basis import SmoothBasis
from commonlaw.discrepancy.trajectories import FunctionFit, FunctionModel, annealed, best, converged, fit_about
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.inference.fit.covariance import errors_of
from commonlaw.inference.fit.fit import NO_MODEL_ERROR
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.search.setup import FitSetup, RefitOptions
from commonlaw.inference.settings import FINAL_MODEL_ERRORS, MAX_MESH_POINTS, MODEL_ERRORS
from commonlaw.inference.verbs.comparison import with_inputs_of
from commonlaw.law import Law, Provenance, Step, Uncertainty, select_objects
from commonlaw.law.alignment import TRIALS
from commonlaw.law.observation import Scheme
from commonlaw.law.parameters import left_hand_sides
from commonlaw.law.script import call
from commonlaw.library import Terms, Variables, highest_columns, parse_terms
from commonlaw.library.grammar import columns_in, read, with_names, write
from commonlaw.library.notation import quoted
from commonlaw.likelihood import HUBER_THRESHOLD, NotPositiveError, fit
from commonlaw.runtime.arguments import check_type
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.transformations import with_property_inputs
from commonlaw.trials.trial import property_names


@dataclass(frozen=True, eq=False)
class Setting(AbstractSetting):
    """A law of states that were measured, whose terms are over all that functions may take."""

    law: Law
    problem: SearchProblem
    visited: Visited

    @classmethod
    def of(
        cls,
        law: Law,
        trials: Trials,
        texts: Sequence[str],
        noise: Mapping[str, float] | None,
        huber_threshold: float,
        /,
    ) -> "Setting":
        """Return the setting for functions of some texts, with the properties in these as constant inputs.

        Raises `CommonlawError` if a text cannot be read, or names neither a variable nor a property.
        """
        properties = property_names(trials.properties)
        if inside := [name for name in law.terms.variables.parameters if name not in properties]:
            raise CommonlawError("discrepancy-with-parameters", parameters=", ".join(inside))
        options = RefitOptions(noise=noise, huber_threshold=huber_threshold)
        setup = _with_properties_as_inputs(FitSetup.of(law, trials, options))
        law, trials = setup.law, setup.trials
        known = law.terms.variables.names
        names = [*known, *(name for name in property_names(trials.properties) if name not in known)]
        used = {names[i] for text in texts for i in columns_in(write(read(text, names)))}
        taken = [name for name in names[len(known) :] if name in used]
        trials = with_property_inputs(trials, taken)
        law = with_inputs_of(law, replace(law.schema, inputs=(*law.schema.inputs, *taken)))
        problem, variables = replace(setup, law=law, trials=trials).problem(), law.terms.variables
        smoothed = [
            [
                variables.natural(np.column_stack([states, trial.inputs, trial.times]))
                for trial, states in zip(problem.trials.of_object(name), curves, strict=True)
            ]
            for name, curves in zip(problem.trials.objects, problem.smoothed, strict=True)
        ]
        return cls(law, problem, Visited.of(variables.names, smoothed))

    @property
    def variables(self) -> Variables:
        return self.law.terms.variables

    @property
    def own(self) -> Bools:
        return np.asarray(self.law.support & self.problem.allowed)

    def directions(self, equation: int) -> tuple[tuple[str, ...], Floats]:
        """Return the values of the terms of an equation."""
        kept = self.own[equation]
        names = tuple(self.law.terms.names[k] for k in np.flatnonzero(kept))
        return names, self.law.terms.evaluate(self.visited.values)[:, kept]

    def rates(self, equation: int) -> Floats:
        """Return differences of the smoothed measurements."""
        column = highest_columns(self.law.order, len(self.law.schema.states))[equation]
        parts = np.split(self.visited.values[:, [column, -1]], self.visited.begins[1:])
        return np.concatenate([np.gradient(part[:, 0], part[:, 1]) for part in parts])

    def annealed(self, model: FunctionModel) -> list[FunctionFit]:
        return annealed(self.problem, model)

    def converged(self, fitted: FunctionFit) -> FunctionFit:
        return converged(self.problem, fitted)

    def value(self, alone: FunctionFit, model: FunctionModel) -> float:
        """Return the smaller value of the model error of the law alone and of none."""
        more = ((0, 0), (0, model.own.shape[1] - self.own.shape[1]))
        estimates = tuple(replace(start, coefficients=np.pad(start.coefficients, more)) for start in alone.estimates)
        result = [np.inf]
        for model_error in {alone.model_error, NO_MODEL_ERROR}:
            with suppress(NotPositiveError):
                result.append(fit_about(self.problem, model, estimates, model_error).value)
        return min(result)

    def resolving(self, basis: SmoothBasis) -> "Setting":
        problem, step = self.problem, np.quantile(self.visited.steps(self.visited.evaluate(basis.coordinate)), 0.95)
        while problem.points < MAX_MESH_POINTS[1] and step > basis.width * problem.points / 2:
            problem = problem.finer()
        return replace(self, problem=problem)

    def given_deviance(self) -> float:
        none, errors = np.zeros_like(self.own), (*MODEL_ERRORS, *FINAL_MODEL_ERRORS)
        parts = zip(self.problem.models, self.problem.starts, self.law.coefficients, strict=True)
        return sum(fit(model, replace(start, coefficients=c), none, errors).deviance for model, start, c in parts)

    def refitted(self, law: Law, found: FunctionFit) -> tuple[Law, Law]:
        narrow, whole = select_objects(law, self.problem.trials.objects), _whole(law, self, found)
        in_law = np.zeros((len(law.schema.states), len(found.model.terms)), dtype=np.bool_)
        in_law[:, : len(self.law.terms)] = self.law.support
        is_factor = narrow.support & narrow.terms.is_factor
        coefficients = narrow.coefficients.copy()
        coefficients[:, is_factor] = whole.coefficients[:, in_law]
        uncertainty = replace(
            whole.uncertainty.restrict(in_law[whole.support]).with_known(is_factor[narrow.support]),
            inclusion_probabilities=narrow.uncertainty.inclusion_probabilities,
        )
        return replace(narrow, coefficients=coefficients, uncertainty=uncertainty), whole


def _with_properties_as_inputs(setup: FitSetup) -> FitSetup:
    """Return a setup in which properties inside terms, with the numbers that the law has for them, are inputs."""
    law, trials, before = setup.law, setup.trials, setup.law.terms.variables
    if not before.parameters:
        return setup
    numbers = law.coefficients[:, :, list(law.terms.parameters)].sum(axis=1)  # Each stands in one equation
    properties = {
        owner: {**trials.properties.get(owner, {}), **dict(zip(before.parameters, row.tolist(), strict=True))}
        for owner, row in zip(law.objects, numbers, strict=True)
    }
    trials = with_property_inputs(replace(trials, properties=properties), before.parameters)
    inputs, kept = trials.schema.inputs, law.terms.is_factor
    texts = [term.expression(before.names) for term in law.terms.take(np.flatnonzero(kept).tolist()).terms]
    uncertainty = law.uncertainty.restrict(np.broadcast_to(kept, law.support.shape)[law.support])
    law = replace(
        law,
        terms=parse_terms(texts, replace(before, inputs=inputs, parameters=())),
        schema=replace(law.schema, inputs=inputs),
        coefficients=law.coefficients[:, :, kept],
        uncertainty=replace(uncertainty, inclusion_probabilities=None, other_laws=()),
        provenance=Provenance(),
    )
    return replace(setup, law=law, trials=trials)


def candidates(
    setting: AbstractSetting,
    coordinates: Sequence[str],
    times: str,
    equations: Sequence[int],
    zero_at: float | str | None,
) -> list[tuple[float, SmoothBasis, int]]:
    """Return functions of coordinates in equations after the value of each about the law alone, that of best first."""
    pairs, reasons = [], []
    for coordinate in coordinates:
        try:
            values = setting.visited.evaluate(coordinate)
            low, high = float(values.min()), float(values.max())
            if not high - low > 1e-9 * max(abs(low), abs(high)):
                raise CommonlawError("coordinate-constant", coordinate=coordinate, value=low)
            basis = SmoothBasis(coordinate, times, low, high)
        except CommonlawError as error:
            reasons.append(error)
            continue
        pairs += [(basis, equation) for equation in equations]
    if not pairs:
        raise CommonlawError("several", messages=reasons)
    if len(pairs) == 1:
        return [(0.0, *pairs[0])]
    alone = best(setting.annealed(setting.alone))
    valued = [(setting.value(alone, setting.with_function(*pair, zero_at)), *pair) for pair in pairs]
    return sorted(valued, key=lambda pair: pair[0])


_FUNCTIONS: tuple[tuple[str, Callable[[Floats], Floats]], ...] = (
    ("1", np.ones_like),
    ("{0}", lambda u: u),
    ("{0}^2", np.square),
    ("{0}^3", lambda u: u**3),
    ("abs({0})", np.abs),
    ("{0} abs({0})", lambda u: u * np.abs(u)),
    ("sqrt(abs({0}))", lambda u: np.sqrt(np.abs(u))),
)


def descriptions(fitted: FunctionFit, basis: SmoothBasis, visited: Floats) -> tuple[Description, ...]:
    """Return simple functions of the visited coordinate, shape (n,), and pairs of these, the largest evidence first."""
    values, rows = basis.values(visited), fitted.rows
    names, columns = list[str](), list[Floats]()
    for name, function in _FUNCTIONS:
        weights = np.linalg.lstsq(values, function(visited), rcond=1e-10)[0]
        column = rows.shared @ weights
        size = np.sqrt(column @ column + sum(np.sum((block.across @ weights) ** 2) for block in rows.objects))
        rests = [column, *(column - earlier * (earlier @ column) / (earlier @ earlier) for earlier in columns)]
        # Less than a thousandth is said by the law's own terms, or by a simpler function
        if min(np.linalg.norm(rest) for rest in rests) > 1e-3 * size:
            names.append(name)
            columns.append(column)
    of = basis.coordinate if basis.coordinate.isidentifier() else f"({basis.coordinate})"
    front = "" if basis.times == "1" else f"{basis.times} "
    result = list[Description]()
    for group in [*((i,) for i in range(len(names))), *combinations(range(len(names)), 2)]:
        design = np.array([columns[i] for i in group]).T
        coefficients, _, _, _ = np.linalg.lstsq(design, rows.target, rcond=None)
        squares = np.array(rows.rest + np.sum((rows.target - design @ coefficients) ** 2))
        value = float(rows.deviance(squares, fitted.noise_measurements)) + len(group) * np.log(rows.numbers)
        variance = float(rows.variance(squares, fitted.noise_measurements))
        errors = np.sqrt(variance) * np.linalg.norm(np.linalg.pinv(design), axis=1)
        texts = tuple((front + names[i].format(of)).removesuffix(" 1") for i in group)
        evidence = fitted.posterior.value - value
        result.append(Description(texts, tuple(coefficients.tolist()), tuple(errors.tolist()), evidence))
    return tuple(sorted(result, key=lambda description: -description.evidence)[:5])


def shares(
    given_deviance: float, alone: Sequence[FunctionFit], shared: Sequence[FunctionFit], chosen: FunctionFit
) -> Mapping[str, float]:
    """Return what each step removes of the law's sum of squares in units of the noise, as shares of it.

    The steps: the coefficients as given; the best ones; the function; a model error, if one was chosen. What is left is
    noise.
    """
    steps = [given_deviance, _without_error(alone), _without_error(shared), chosen.deviance]
    falling = np.minimum.accumulate(steps)
    parts = dict(zip(("coefficients", "shared discrepancy", "trial"), -np.diff(falling), strict=True))
    return {name: float(share / falling[0]) for name, share in (parts | {"noise": falling[-1]}).items()}


def _without_error(found: Sequence[FunctionFit]) -> float:
    return min(fitted.deviance for fitted in found if fitted is found[-1] or not fitted.has_model_error)


_SETTINGS: Mapping[Scheme, type[AbstractSetting]] = {"collocation": Setting, "shooting": ObservedSetting}


def discrepancy(
    law: Law,
    trials: Trials,
    of: str | None = None,
    *,
    times: str = "1",
    equation: str | None = None,
    zero_at: float | str | None = "auto",
    noise: Mapping[str, float] | None = None,
    huber_threshold: float = HUBER_THRESHOLD,
) -> Discrepancy[Law]:
    """Return the smooth function of a coordinate that all objects share in addition to a law, see `Law.discrepancy`."""
    check_type("trials", trials, (Trials, TrialStream), TRIALS)
    called = call(discrepancy, locals(), "law.discrepancy", "trials") + ".law"
    known = {name: {**law.properties.get(name, {}), **trials.properties.get(name, {})} for name in trials.objects}
    trials, texts = replace(trials, properties=known), [times, *([of] if of else [])]
    setting = _SETTINGS[law.scheme].of(law, trials, texts, noise, huber_threshold)
    names, sides = setting.visited.names, left_hand_sides(law)
    coordinates = [of] if of else [quoted(name) for name in law.terms.variables.measured]
    # As terms are written, so that they can stand in one
    written = [with_names(write(read(text, names)), [*map(quoted, names)]) for text in (times, *coordinates)]
    if equation is not None:
        check_choice("equation", equation, law.schema.states)
    able = np.flatnonzero(setting.own.any(axis=1)).tolist() or list(range(len(law.schema.states)))
    places = able if equation is None else [law.schema.states.index(equation)]
    listed = candidates(setting, written[1:], written[0], places, zero_at)
    least, basis, place = listed[0]
    setting = setting.resolving(basis)
    model = setting.with_function(basis, place, zero_at)
    alone, shared = (setting.annealed(function_model) for function_model in (setting.alone, model))
    law_alone, fitted = (setting.converged(best(fits)) for fits in (alone, shared))
    # What the choice among several costs: all of them are as probable beforehand
    evidence = law_alone.value - fitted.value - 2 * float(np.log(len(listed)))
    visited = setting.visited.evaluate(basis.coordinate)
    step = Step(
        "discrepancy",
        f"a function of {basis.coordinate} in {sides[place]}",
        f"coefficients estimated jointly with it; noise scaled by {fitted.posterior.noise_factor:.3g}",
    )
    narrow, wide = setting.refitted(law, fitted)
    history, calls = (*law.history, step), (*law.provenance.calls, called)
    provenance = replace(law.provenance, history=history, calls=calls, with_discrepancy=wide)
    return Discrepancy(
        law=replace(narrow, provenance=provenance),
        equation=sides[place],
        basis=basis,
        weights=fitted.posterior.weights,
        covariance=fitted.posterior.covariance,
        zero_at=model.zero_at,
        holds_nothing_of=model.held,
        visited=visited,
        evidence=evidence,
        shares=shares(setting.given_deviance(), alone, shared, fitted),
        descriptions=descriptions(fitted, basis, visited),
        compared=tuple(Compared(tried.coordinate, sides[j], evidence + least - value) for value, tried, j in listed),
    )


def _whole(law: Law, setting: Setting, found: FunctionFit) -> Law:
    """Return a law with the functions as further terms."""
    problem, model, posterior = setting.problem, found.model, found.posterior
    objects, terms = problem.trials.objects, Terms(setting.law.terms.variables, model.terms.terms)
    coefficients = np.array([estimate.coefficients for estimate in found.estimates])
    coefficients[:, model.own], coefficients[:, model.shared] = posterior.coefficients, posterior.weights
    support = np.any(coefficients != 0, axis=0)
    order = np.concatenate([np.flatnonzero(model.own), np.flatnonzero(model.shared)])
    factor = posterior.shared_factor
    shared = np.zeros((len(objects), support.size, factor.shape[1]))
    shared[:, order] = np.concatenate([posterior.follow @ factor, np.tile(factor, (len(objects), 1, 1))], axis=1)
    covariance = shared @ shared.transpose(0, 2, 1)
    columns = np.flatnonzero(model.own)
    covariance[:, columns[:, np.newaxis], columns] += posterior.own_covariance
    kept = support.ravel()
    uncertainty = Uncertainty(
        covariance=covariance[:, kept][:, :, kept],
        shared_factor=shared[:, kept],
        noise=posterior.noise_factor * problem.noise,
        error_model=errors_of(problem, posterior.noise_factor * found.model_error if found.has_model_error else 0.0),
        huber_threshold=problem.huber_threshold,
    )
    schema, provenance = setting.law.schema, Provenance(law.provenance.differentiation, domain=law.provenance.domain)
    return Law(terms, schema, law.order, objects, coefficients, uncertainty, provenance, setting.law.properties)
