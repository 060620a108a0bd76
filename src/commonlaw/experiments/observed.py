"""Measurements of a trial by a law with observation equations, ``y = h(x(t; p, x0); p)``, and their derivatives."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.estimation.model import Model, ModelText, read_model
from commonlaw.estimation.problem import Predicted, Problem, TrialData
from commonlaw.experiments.experiment import Experiment
from commonlaw.integration.shooting import NO_INPUTS, DelayedInputs
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.observation import OBJECT, Observation, Restrictions, by_trial
from commonlaw.law.parameters import Parameters, named_parameters, state_rates
from commonlaw.trials import Trial
from commonlaw.trials.trial import property_names


@dataclass(frozen=True, eq=False)
class ObservedLaw:
    """A law with observation equations in experiments that set the initial values of some states.

    Unknowns of the problem are the P parameters of the model and then the D initial values. `of_trial` has the q
    parameters that differ between trials, by index; like initial values, every trial determines them anew.
    """

    observation: Observation
    model: Model
    problem: Problem
    named: Parameters
    of_trial: tuple[int, ...]

    @classmethod
    def of(cls, law: Law, chosen: Collection[str]) -> "ObservedLaw | None":
        """Return the law where the initial values of chosen states (and rates) are set; None without observations."""
        observation, rates = law.observation, {f"{state}'": rate for state, rate in state_rates(law)}
        if observation is None:
            return None
        initial = {name: start for name, start in observation.initial.items() if rates.get(name, name) not in chosen}
        measured, restrictions = observation.measured, observation.restrictions or Restrictions()
        text = ModelText(law.provenance.equations, observation.equations, initial, events=observation.events)
        model = read_model(text, measured, property_names(law.properties))
        sizes = np.array([observation.sizes[name] for name in model.variables.states])
        logarithmic = np.array([name in measured.logarithmic for name in model.observables])
        problem = Problem(model, (), len(model.parameters) + model.width, logarithmic, sizes, ())
        shared = [restrictions.shared.get(name, OBJECT) for name in model.parameters]
        of_trial = tuple(i for i, by in enumerate(shared) if by_trial(by, measured))
        return cls(observation, model, problem, named_parameters(law), of_trial)

    @cached_property
    def _priors(self) -> dict[str, tuple[float, float]]:
        return dict(self.observation.restrictions.priors) if self.observation.restrictions else {}

    def beginning(self, experiment: Experiment) -> tuple[Floats, Floats]:
        """Return initial values, and zeros for the parameters of a trial, with standard deviations, shape (D + q,).

        Those of initial values that follow from the parameters of the law are zero.
        """
        start, std = experiment.start.copy(), experiment.start_std.copy()
        for j in np.flatnonzero(np.isnan(start)).tolist():
            start[j], std[j] = self.model.expected.get(j, (np.nan, 0.0))
        own = [self._priors.get(self.model.parameters[i], (0.0, np.inf))[1] for i in self.of_trial]
        return np.append(start, np.zeros(len(own))), np.append(std, own)

    def predicted(
        self,
        law: Law,
        experiment: Experiment,
        name: str,
        times: Floats,
        coefficients: Floats | None = None,
        own: Floats | None = None,
        slopes: bool = True,
    ) -> Predicted:
        """Return the trial of an object at times, with slopes by coefficients in the support, then by its `beginning`.

        Coefficients of the object, shape (equations, terms), are those of the law by default. With the parameters p(c),
        ``dy/dc = dy/dp dp/dc``.
        """
        model, observation, names = self.model, self.observation, self.named.names
        coefficients = law.coefficients[object_index(law, name)] if coefficients is None else coefficients
        own = self.beginning(experiment)[0] if own is None else own
        count, properties = len(model.parameters), experiment.properties or law.properties.get(name, {})
        by_name = dict(zip(names, (float(each.of(coefficients)) for each in self.named.definitions), strict=True))
        values = np.array([by_name[each] if each in by_name else properties[each] for each in model.parameters])
        for shift, i in zip(own[model.width :], self.of_trial, strict=True):
            values[i] = self._priors.get(model.parameters[i], (values[i], 0.0))[0] + shift
        free = np.isin(np.arange(model.width), model.free_of(name))
        grid = np.union1d(times[:1] if observation.initial_time is None else [observation.initial_time], times)
        data = TrialData(
            Trial(name, "1", times, np.zeros((len(times), len(model.observables)))),
            grid,
            np.searchsorted(grid, times),
            DelayedInputs(experiment.inputs, model.column, model.delay) if experiment.inputs else NO_INPUTS,
            np.arange(count),
            values,
            np.where(free, count + np.arange(model.width), -1),
            model.initial_of(name),
        )
        found = self.problem.predicted(data, np.append(values, own[: model.width]), slopes)
        if found.slopes is None:
            return found
        inner = [i for i, each in enumerate(model.parameters) if each in by_name and i not in self.of_trial]
        by_coefficients = np.nan_to_num(self.named.slopes(coefficients[np.newaxis])[0])
        by_coefficients = by_coefficients[[names.index(model.parameters[i]) for i in inner]]
        rows = found.slopes[:, :, inner] @ by_coefficients
        parts = [rows, found.slopes[:, :, count:], found.slopes[:, :, list(self.of_trial)]]
        return found._replace(slopes=np.concatenate(parts, axis=2))

    def noise(self, name: str) -> Floats:
        """Return the standard deviations of the measurements of an object, relative where log-scaled, shape (m,)."""
        known = self.observation
        return np.array([known.noise_of.get(each, {}).get(name, known.noise[each]) for each in self.model.observables])
