"""The discrepancy of a law with observation equations, by the likelihood of its solutions (single shooting)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.discrepancy.setting import AbstractSetting, Visited
from commonlaw.discrepancy.trajectories import (
    CONVERGED,
    MAX_ROUNDS,
    NOISE_MEASUREMENTS,
    FunctionFit,
    FunctionModel,
    SharedRows,
    posterior,
)
from commonlaw.errors import CommonlawError
from commonlaw.estimation.beginning import Beginning, begin
from commonlaw.estimation.fitting import Fitted, refit
from commonlaw.estimation.problem import Problem, TrialData
from commonlaw.estimation.search import Objective, minimum
from commonlaw.inference.fit.fit import NO_MODEL_ERROR
from commonlaw.law import Law, select_objects
from commonlaw.law.parameters import left_hand_sides
from commonlaw.law.restrictions import ALL, OBJECT, by_trial
from commonlaw.library import Variables, highest_columns
from commonlaw.library.notation import quoted
from commonlaw.trials import Trials
from commonlaw.trials.trial import property_names


@dataclass(frozen=True, eq=False)
class ObservedSetting(AbstractSetting):
    """A law with observation equations that was fitted to the trials again.

    Its unknowns are parameters and initial values of all objects, which may share some. The rows of the likelihood
    linearized about them are those of one object, and residuals those of the measured quantities in units of the noise
    of this fit. `points` are the variables of the model at all samples, shape (n, variables).
    """

    law: Law
    trials: Trials
    fitted: Fitted
    visited: Visited
    points: Floats

    @classmethod
    def of(
        cls, law: Law, trials: Trials, _: Sequence[str], noise: Mapping[str, float] | None, huber_threshold: float, /
    ) -> "ObservedSetting":
        """Return the setting, with states at the samples by the fit, and the numeric properties of objects."""
        fitted = refit(
            law, trials, noise=noise, errors="white", huber_threshold=huber_threshold, progress=lambda _: None
        )
        fitted = _with_outliers(fitted)
        problem, unknowns, law = fitted.begun.problem, fitted.optimum.unknowns, select_objects(law, trials.objects)
        names, owners = law.terms.variables.measured, [trials.properties.get(name, {}) for name in trials.objects]
        more = [
            name
            for name in property_names(trials.properties)
            if all(type(attributes.get(name)) is float for attributes in owners)
        ]
        parts, points = list[list[Floats]](), list[Floats]()
        for owner, attributes in zip(trials.objects, owners, strict=True):
            parts.append([])
            for data in (trial_data for trial_data in problem.trials if trial_data.trial.object == owner):
                times, parameters = data.times[data.rows], data.parameters(unknowns)
                states, inputs = problem.predicted(data, unknowns, False).states, data.inputs.at(times, parameters)
                points.append(problem.model.point(states, inputs, times, parameters))
                known = [np.full(len(times), attributes[name]) for name in more]
                parts[-1].append(np.column_stack([points[-1][:, : len(names)], *known]))
        return cls(law, trials, fitted, Visited.of((*names, *more), parts), np.concatenate(points))

    @property
    def variables(self) -> Variables:
        known = self.law.terms.variables
        more = [name for name in self.visited.names if name not in known.names]
        return replace(known, parameters=(*known.parameters, *more))

    @property
    def own(self) -> Bools:
        """Which coefficients are in equations with an unknown parameter, shape (equations, terms)."""
        unknown = [self.directions(j)[1].any() for j in range(len(self.law.schema.states))]
        return np.asarray(self.law.support & np.array(unknown)[:, np.newaxis])

    def directions(self, equation: int) -> tuple[tuple[str, ...], Floats]:
        begun, model, side = self.fitted.begun, self.fitted.begun.model, left_hand_sides(self.law)[equation]
        known = np.min(begun.unknowns.parameters, axis=0) < 0
        row = highest_columns(model.order, len(model.schema.states))[equation]
        slopes = model.rates.jacobian(self.points)[:, row, model.first_parameter :]
        names = [f"d({side})/d({name})" for name in model.parameters]
        return tuple(compress(names, ~known)), slopes[:, ~known]

    def rates(self, equation: int) -> Floats:
        model = self.fitted.begun.model
        row = highest_columns(model.order, len(model.schema.states))[equation]
        return np.asarray(model.rates.evaluate(self.points)[:, row])

    @property
    def _free(self) -> list[int]:
        """The unknowns of the law that are not at a bound, by index."""
        return np.flatnonzero(~self.fitted.optimum.at_bound).tolist()

    def _functions(self, model: FunctionModel) -> dict[str, str]:
        """Return the functions as they are written, by the names of their weights."""
        names = [quoted(name) for name in self.variables.names]
        functions = model.terms.terms[len(self.law.terms) :]
        return {f"weight {i}": function.text(names) for i, function in enumerate(functions, 1)}

    def _with_weights(self, model: FunctionModel) -> Problem:
        """Return the likelihood with weights of the functions as further unknowns, that all objects share."""
        problem, functions = self.fitted.begun.problem, self._functions(model)
        if not functions:
            return problem
        properties = [name for name in self.variables.names if name not in problem.model.variables.names]
        equation = int(np.flatnonzero(model.shared.any(axis=1))[0])
        wider = problem.model.with_terms(equation, functions, properties)
        properties = [name for name in wider.parameters if name in properties]
        indices, trials = np.arange(len(functions)) + problem.unknowns, list[TrialData]()
        for data in problem.trials:
            given = [self.trials.properties[data.trial.object][name] for name in properties]
            parameter = np.concatenate([data.parameter, np.full(len(given), -1), indices])
            values = np.concatenate([data.values, np.array(given, dtype=np.float64), np.zeros(len(functions))])
            trials.append(replace(data, parameter=parameter, values=values))
        return replace(problem, model=wider, trials=tuple(trials), unknowns=problem.unknowns + len(functions))

    def _about(self, model: FunctionModel, problem: Problem, unknowns: Floats) -> FunctionFit:
        """Return the posterior of the likelihood linearized about unknowns, those of the law and then the weights.

        Standardized residuals ``r + J (p - p0)`` are rows ``J p = J p0 - r``.
        """
        noise, count = self.fitted.optimum.noise, len(self._free)
        residuals, slopes = problem.residuals(unknowns, noise)
        if slopes is None or not np.isfinite(slopes).all():
            raise CommonlawError("discrepancy-fit-failed")
        order = [*self._free, *range(self.fitted.begun.problem.unknowns, problem.unknowns)]
        columns = slopes[:, order]
        target = columns @ unknowns[order] - residuals
        factor = np.asarray(np.linalg.qr(np.column_stack([columns, target]), mode="r"))
        rows = SharedRows.of([factor], count, max(len(residuals) - count, 1), 0.0)
        worth = np.inf if problem.errors or problem.known_noise.all() else NOISE_MEASUREMENTS * len(noise)
        estimate = posterior(rows, model.factors, model.size, worth)
        return FunctionFit(model, (), NO_MODEL_ERROR, rows, worth, estimate, 0.0, float(residuals @ residuals))

    def _mean(self, found: FunctionFit) -> Floats:
        """Return the unknowns at the mean of a posterior."""
        result = self.fitted.optimum.unknowns.copy()
        result[self._free] = found.posterior.coefficients[0]
        return np.append(result, found.posterior.weights)

    def annealed(self, model: FunctionModel) -> list[FunctionFit]:
        """Return the fit about solutions that have followed the posterior, in steps that do not fit worse."""
        problem, noise = self._with_weights(model), self.fitted.optimum.noise
        unknowns = self.fitted.optimum.unknowns
        point = np.append(unknowns, np.zeros(problem.unknowns - len(unknowns)))
        fitted = self._about(model, problem, point)
        for _ in range(MAX_ROUNDS):
            step, last = self._mean(fitted) - point, fitted
            for halvings in range(10):
                moved = point + step / 2**halvings
                residuals = problem.residuals(moved, noise, False)[0]
                # It may grow by a hundredth as the function is shrunk, but not be infinite
                if residuals @ residuals < 1.01 * fitted.deviance:
                    point, fitted = moved, self._about(model, problem, moved)
                    break
            if abs(fitted.value - last.value) < CONVERGED:
                break
        return [fitted]

    def value(self, alone: FunctionFit, model: FunctionModel) -> float:
        problem, unknowns = self._with_weights(model), self.fitted.optimum.unknowns
        return self._about(model, problem, np.append(unknowns, np.zeros(problem.unknowns - len(unknowns)))).value

    def given_deviance(self) -> float:
        begun, objective = self.fitted.begun, Objective(self.fitted.begun.problem, self.fitted.optimum.noise)
        shared, names = begun.restrictions.shared, begun.unknowns.names
        free = np.array([by_trial(shared.get(name, OBJECT), begun.trials.schema) for name in names], dtype=np.bool_)
        free[[k for indices in begun.unknowns.initial for k in indices if k >= 0]] = True
        return minimum(objective, begun.first, free, begun.bounds, tolerance=1e-8, steps=100)[1]

    def refitted(self, law: Law, found: FunctionFit) -> tuple[Law, Law]:
        begun, known, free, unknowns = self.fitted.begun, found.posterior, self._free, self._mean(found)
        factor = np.zeros((len(unknowns), len(known.weights)))
        factor[free], factor[begun.problem.unknowns :] = known.follow[0] @ known.shared_factor, known.shared_factor
        covariance = factor @ factor.T
        covariance[np.ix_(free, free)] += known.own_covariance[0]
        noise = self.fitted.optimum.noise * np.where(begun.problem.known_noise, 1.0, known.noise_factor)
        places = {label: i for i, label in enumerate([*begun.unknowns.labels, *self._functions(found.model)])}

        def law_of(begun: Beginning, at_bound: Bools) -> Law:
            order = [places[label] for label in begun.unknowns.labels]
            optimum = replace(
                self.fitted.optimum,
                unknowns=unknowns[order],
                noise=noise,
                log_likelihood=begun.problem.log_likelihood(unknowns[order], noise),
                covariance=covariance[np.ix_(order, order)],
                at_bound=at_bound,
            )
            return Fitted(begun, optimum, ()).law(())

        wide = law_of(self._written(found.model), np.zeros(len(unknowns), dtype=np.bool_))
        return law_of(begun, self.fitted.optimum.at_bound), wide

    def _written(self, model: FunctionModel) -> Beginning:
        """Return the fit of the equations with the functions, as it begins."""
        begun, functions = self.fitted.begun, self._functions(model)
        equation = int(np.flatnonzero(model.shared.any(axis=1))[0])
        restrictions = begun.restrictions
        return begin(
            replace(begun.model.text, functions={self.law.schema.states[equation]: functions}),
            begun.trials,
            dict.fromkeys(name for name in begun.model.variables.states if name not in begun.model.text.initial),
            begun.start,
            {**restrictions.shared, **dict.fromkeys(functions, ALL)},
            priors=restrictions.priors,
            log_states=begun.logarithmic,
            noise=restrictions.noise,
        )


def _with_outliers(fitted: Fitted) -> Fitted:
    """Return a fit by the Huber loss where outliers were rejected: what a law leaves out is no outlier."""
    begun, optimum = fitted.begun, fitted.optimum
    if not begun.problem.rejects:
        return fitted
    problem = replace(begun.problem, rejects=False)
    objective, free = Objective(problem, optimum.noise), ~optimum.at_bound
    unknowns, _ = minimum(objective, optimum.unknowns, free, begun.bounds, tolerance=1e-8, steps=40)
    return replace(fitted, begun=replace(begun, problem=problem), optimum=replace(optimum, unknowns=unknowns))
