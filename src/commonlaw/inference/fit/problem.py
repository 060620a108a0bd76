"""What the search for a law starts from: each object's trials, their noise, and smooth curves through them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.formulation import refuse_constant_states
from commonlaw.inference import settings
from commonlaw.inference.data.noise import by_columns, estimated_noise, has_replicates, noise_floor, within_trial_std
from commonlaw.inference.data.smoothing import filled_curves, gradient_matching, smooth_curves, typical_states
from commonlaw.inference.data.subsampling import subsample
from commonlaw.inference.fit.latent_initialization import (
    begun,
    initial_latent_estimates,
    with_initial_condition_noise,
    with_latent_noise,
)
from commonlaw.inference.score.evidence import NoiseScale
from commonlaw.inference.score.priors import Measurements, StructurePrior, complexity_penalties, shifted
from commonlaw.law import Law, Provenance
from commonlaw.library import Order, Terms, with_rates
from commonlaw.likelihood import (
    HUBER_THRESHOLD,
    NO_ERRORS,
    ErrorModel,
    Estimate,
    Mesh,
    ObservationModel,
    Prior,
    TrajectoryModel,
    interpolate,
    meshes,
)
from commonlaw.solvers import AbstractSolver
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import with_typical


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """What was measured on each object, ready to be searched for a law.

    The starts are smoothed states, and coefficients of all allowed terms by least squares on smoothed rates; `smoothed`
    are those states (and rates) of each object's trials, each of shape (n, D). `measured` counts the numbers that were
    measured on each object. The noise of each state has shape (d,); it and other errors are those of all objects; the
    `noise_estimate` is that before any law, which stays if it was given.
    Coefficients that are known have shape (objects,
    equations, terms), NaN where they are to be found; `points` are those of the meshes for each sampling step. The
    `samples` say which of all are fitted, nothing if all are. Of latent states, coefficients that would
    fit the first object about as well as its first guess are `equivalent_optima`, each of shape (equations, terms).
    So many terms were to choose from `excluded_terms`, which the price of supports counts. Where terms are given, their
    residuals may tell the noise that differences of few samples do not. The path of the solver lists the candidates
    of each equation; it is None where the terms are given. Forecasts of laws estimate rates by the differentiation.
    """

    trials: Trials
    models: tuple[TrajectoryModel, ...]
    starts: tuple[Estimate, ...]
    smoothed: tuple[tuple[Floats, ...], ...]
    measured: tuple[int, ...]
    noise: Floats
    noise_reason: str
    known: Floats
    noise_estimate: Floats
    noise_given: bool
    points: int = 1
    errors: ErrorModel = NO_ERRORS
    samples: str = ""
    equivalent_optima: tuple[Floats, ...] = ()
    excluded_terms: int = 0
    residuals_estimate_noise: bool = False
    solver: AbstractSolver | None = None
    differentiation: AbstractDifferentiator | None = None

    @property
    def terms(self) -> Terms:
        """The candidate terms."""
        return self.models[0].terms

    @property
    def order(self) -> Order:
        """Of laws, or of each equation."""
        return self.models[0].order

    @property
    def law(self) -> Law:
        """The law of these trials that has the coefficients that are known alone."""
        return Law(
            self.terms,
            self.trials.schema,
            self.order,
            self.trials.objects,
            np.nan_to_num(self.known),
            provenance=Provenance(self.differentiation),
        )

    @property
    def allowed(self) -> Bools:
        """Which terms may enter which equation, shape (equations, terms)."""
        return np.asarray(np.isnan(self.known[0]))

    @cached_property
    def measured_states(self) -> tuple[Bools, ...]:
        """Which states of each object were measured in one of its trials, each of shape (states,)."""
        groups = (self.trials.of_object(name) for name in self.trials.objects)
        return tuple(
            np.asarray(np.isfinite(np.concatenate([trial.states for trial in group])).any(axis=0)) for group in groups
        )

    @property
    def most_terms(self) -> int:
        """How many terms an equation may have.

        Objects share the support, so that all of them together pay for its terms. What an object has of its own, the
        initial states of its trials and its coefficients, takes as many measured numbers.
        """
        pairs = zip(self.models, self.trials.objects, strict=True)
        starts = [model.width * len(self.trials.of_object(name)) for model, name in pairs]
        spare = min(n - initial for n, initial in zip(self.measured, starts, strict=True))
        shared = sum(self.measured) // settings.MIN_SAMPLES_PER_TERM
        return int(np.clip(min(spare, shared) // len(self.noise), 1, settings.MAX_TERMS))

    @property
    def noise_is_fixed(self) -> bool:
        """Whether what a law leaves does not change the noise.

        It was given, trials are too short to tell it, or more samples tell it than those that are fitted.
        """
        return (
            self.noise_given or bool(self.samples) or not (self.noise_is_identifiable or self.residuals_estimate_noise)
        )

    @property
    def noise_is_identifiable(self) -> bool:
        """Whether differences of the samples of some trial tell the noise of a state, or repeated measurements do."""
        return bool(has_replicates(self.trials).any()) or any(
            np.isfinite(trial.states).sum(axis=0).max() >= settings.MIN_SAMPLES for trial in self.trials
        )

    def is_determined(self, coefficients: int) -> bool:
        """Return whether the residuals of all objects, with so many coefficients, have enough degrees of freedom."""
        starts = sum(model.width * len(model.meshes) for model in self.models)
        return sum(self.measured) - starts - coefficients >= settings.MIN_FREEDOM

    def starts_with(self, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
        """Return where fits start, with the coefficients of estimates, which may be on another mesh."""
        pairs = zip(self.starts, estimates, strict=True)
        return tuple(replace(start, coefficients=estimate.coefficients) for start, estimate in pairs)

    def with_priors(self, priors: Sequence[Prior | None]) -> "SearchProblem":
        """Return the problem with what the coefficients of each object are beforehand, if anything is known."""
        pairs = zip(self.models, priors, strict=True)
        return replace(self, models=tuple(replace(model, prior=prior) for model, prior in pairs))

    def of_objects(self, indices: Sequence[int]) -> "SearchProblem":
        """Return the problem of some of the objects alone, with the same errors."""
        names = [self.trials.objects[i] for i in indices]
        trials = self.trials.with_trials([trial for trial in self.trials if trial.object in names])
        return replace(
            self,
            trials=trials,
            models=tuple(self.models[i] for i in indices),
            starts=tuple(self.starts[i] for i in indices),
            smoothed=tuple(self.smoothed[i] for i in indices),
            measured=tuple(self.measured[i] for i in indices),
            known=self.known[indices],
        )

    def of_trials(self, trials: Sequence[Trial], known: Floats, guess: Floats) -> "SearchProblem":
        """Return the problem of other trials of the same schema, with the same errors, and on as fine a mesh.

        Coefficients that are known, and those that fits may begin with, both of shape (objects, equations, terms), are
        those of the objects of these trials.
        """
        model, some = self.models[0], self.trials.with_trials(trials)
        threshold = model.observation.huber_threshold
        problem = prepare(some, model.terms, known, noise=self.noise_estimate, huber_threshold=threshold, guess=guess)
        while problem.points < self.points:
            problem = problem.finer()
        models = tuple(replace(each, unit=model.unit) for each in problem.models)
        return replace(problem, models=models).with_errors(self.noise, self.errors, self.noise_reason)

    def with_scaled_noise(self, factor: Floats | float, reason: str) -> "SearchProblem":
        """Return the same problem with the noise times a factor, of each state or of all, and the reason for it."""
        factors = np.broadcast_to(factor, self.noise.shape)
        units = np.concatenate([factors, factors[with_rates(self.models[0].order, len(factors))]])
        models = tuple(replace(model, unit=units * model.unit) for model in self.models)
        return replace(self, models=models).with_errors(factor * self.noise, self.errors, reason)

    def with_huber_threshold(self, threshold: float) -> "SearchProblem":
        """Return the same problem with other standard deviations beyond which a measurement counts as an outlier."""
        models = (
            replace(model, observation=replace(model.observation, huber_threshold=threshold)) for model in self.models
        )
        return replace(self, models=tuple(models))

    def with_errors(self, noise: Floats, errors: ErrorModel, reason: str) -> "SearchProblem":
        """Return the same problem with other noise, shape (d,), and other errors, and the reason for them."""
        stds, models, starts = iter(self._by_mesh(self.measurements.white_std(noise, errors) / noise)), [], []
        for model, start in zip(self.models, self.starts, strict=True):
            states = tuple(state[:, : model.width] for state in start.states)
            meshes = [mesh.with_scale(next(stds)) for mesh in model.meshes]
            observation = replace(model.observation, noise=noise)
            changed = replace(model, meshes=meshes, observation=observation)
            changed, start = changed.with_latent(errors.latent, replace(start, states=states))
            models.append(changed)
            starts.append(start)
        return replace(
            self, models=tuple(models), starts=tuple(starts), noise=noise, errors=errors, noise_reason=reason
        )

    @property
    def under_white_noise(self) -> "SearchProblem":
        """The same problem without other errors than white noise, of the level that was estimated first."""
        return self.with_errors(self.noise_estimate, NO_ERRORS, "of the first estimate") if self.errors else self

    def about(self, estimates: Sequence[Estimate]) -> "SearchProblem":
        """Return the same problem that starts from the states of estimates, at which noise in proportion is taken."""
        starts = tuple(
            replace(start, states=estimate.states) for start, estimate in zip(self.starts, estimates, strict=True)
        )
        return replace(self, starts=starts).with_errors(self.noise, self.errors, self.noise_reason)

    @cached_property
    def measurements(self) -> Measurements:
        """What says how probable levels of errors are, whatever the law."""
        meshes = tuple(mesh for model in self.models for mesh in model.meshes)
        states = tuple(state for start in self.starts for state in start.states)
        return Measurements(
            self.trials,
            meshes,
            states,
            self.noise_estimate,
            self.models[0].order,
            sum(self.measured),
            self.noise_is_fixed,
            settings.PRIOR_OBSERVATIONS if self.noise_is_identifiable else 0.0,
        )

    @cached_property
    def noise_scale(self) -> NoiseScale:
        """How many numbers were measured, and how surely they tell the scale of the noise."""
        return self.measurements.noise_scale(self.noise, self.errors, self.white_std)

    @property
    def least_variance(self) -> float:
        """What the variance of the noise that laws are fitted under is at least, in units of what it is."""
        return self.measurements.least_variance(self.noise)

    @cached_property
    def structure_prior(self) -> StructurePrior:
        """What supports cost.

        The origin of a state of second order is arbitrary, unless trials pass through its zero.
        """
        terms, states = self.models[0].terms, len(self.noise)
        given = ~self.allowed.any(axis=0) & np.any(np.nan_to_num(self.known) != 0, axis=(0, 1))
        origins = []
        for j in with_rates(self.models[0].order, states):
            seen = np.concatenate([trial.states[:, j] for trial in self.trials])
            if not np.nanmin(seen) <= 0 <= np.nanmax(seen):
                origins.append(shifted(terms, j) & ~given)
        return StructurePrior(
            complexity_penalties(terms), tuple(origins), float(np.log(sum(self.measured))), self.excluded_terms
        )

    @cached_property
    def error_level_penalty(self) -> float:
        """What the levels of errors cost, see `Measurements.level_penalty`."""
        return self.measurements.level_penalty(self.noise, self.errors, self.white_std)

    def std_of(self, mesh: Mesh) -> Floats:
        """Return the white noise of each measurement at the state where it is, shape (n, d)."""
        return mesh.scale * self.noise

    @cached_property
    def white_std(self) -> Floats:
        """The same of all meshes, one behind the other, shape (points, d)."""
        return np.concatenate([self.std_of(mesh) for model in self.models for mesh in model.meshes])

    def _by_mesh(self, values: Floats) -> list[Floats]:
        """Return values at the points of all meshes, one behind the other, mesh by mesh."""
        lengths = [len(mesh) for model in self.models for mesh in model.meshes]
        return np.split(values, np.cumsum(lengths)[:-1])

    def padded(self, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
        """Return estimates with as many latent processes as the problem has, which begin at zero if they are new."""
        pairs = zip(self.models, estimates, strict=True)
        return tuple(
            estimate
            if all(states.shape[1] == model.width + model.latent.width for states in estimate.states)
            else model.with_latent(model.latent, estimate)[1]
            for model, estimate in pairs
        )

    def finer(self) -> "SearchProblem":
        """Return the same problem with twice as many points for each sampling step."""
        points = 2 * self.points
        groups = [self.trials.of_object(name) for name in self.trials.objects]
        pairs = zip(self.models, groups, strict=True)
        between = self.trials.schema.input_between
        models = tuple(replace(model, meshes=meshes(group, points, input_between=between)) for model, group in pairs)
        starts = tuple(
            replace(start, states=tuple(map(Mesh.halfway, model.meshes, start.states)))
            for model, start in zip(self.models, self.starts, strict=True)
        )
        return replace(self, models=models, starts=starts, points=points).with_errors(
            self.noise, self.errors, self.noise_reason
        )


def prepare(
    trials: Trials,
    terms: Terms,
    known: Floats,
    *,
    noise: Floats | None = None,
    huber_threshold: float = HUBER_THRESHOLD,
    most_samples: int = settings.MAX_SAMPLES,
    guess: Floats | None = None,
) -> SearchProblem:
    """Return the problem of finding a law of these trials.

    Coefficients that are known have the shape (objects, equations, terms), NaN where they are to be found. A guess of
    that shape says what parameters inside terms begin with, and likely signs in equations of unmeasured states. The
    noise of each state, shape (d,), see `known_noise`, is estimated by default, from all samples, of which
    `most_samples` are fitted, see `subsample`; for the Huber threshold see `ObservationModel`.

    Raises `CommonlawError` if a trial is too short, or a term is not finite on it; the message names the trial.
    """
    trials = with_initial_condition_noise(trials, terms, known[0])
    scale, order = within_trial_std(trials), terms.variables.order_of(len(trials.schema.states))
    trials = trials.with_trials(
        [replace(trial, noise=np.maximum(trial.noise, settings.MIN_NOISE * scale)) for trial in trials]
    )
    samples = {name: np.concatenate([trial.states for trial in trials.of_object(name)]) for name in trials.objects}
    extremes = {name: np.array([np.fmin.reduce(states), np.fmax.reduce(states)]) for name, states in samples.items()}
    started = trials.schema.unmeasured
    refuse_constant_states(
        {name: np.where(started, np.nan, bounds) for name, bounds in extremes.items()}, trials.schema
    )
    given = noise is not None
    noise, reason = estimated_noise(trials) if noise is None else (noise, "as given")
    levels = np.fmax(noise, settings.MIN_NOISE * scale if given else noise_floor(trials))
    if started.any():
        levels = with_latent_noise(levels, trials)
    carried = subsample(trials, levels, most_samples)
    trials = carried.trials
    groups = [trials.of_object(name) for name in trials.objects]
    curves = [[smooth_curves(trial, order, started) for trial in group] for group in groups]
    unit, second = levels, with_rates(order, len(scale))
    if len(second):
        rates = np.concatenate([states[:, len(scale) :] for group in curves for states, _ in group])
        unit = np.concatenate([levels, levels[second] * np.nanstd(rates, axis=0) / scale[second]])
    between, observation = trials.schema.input_between, ObservationModel(levels, huber_threshold)
    models = [
        TrajectoryModel(
            terms,
            [_with_starts(mesh, levels, started) for mesh in meshes(group, input_between=between)],
            observation,
            unit,
        )
        for group in groups
    ]
    if started.any():
        starts, curves, equivalent_optima = initial_latent_estimates(
            models, trials, curves, known, np.zeros_like(known) if guess is None else guess
        )
    else:
        begins = known if guess is None else np.where(np.isnan(known) & ~terms.is_factor, guess, known)
        starts, equivalent_optima = _smoothed_estimates(models, groups, curves, begins), []
    typical = typical_states(curves)
    measured = tuple(int(sum(trial.counts[:, ~trial.absent].sum() for trial in group)) for group in groups)
    smooth = tuple(tuple(filled_curves(curve, typical)) for curve in curves)
    problem = SearchProblem(
        trials,
        tuple(models),
        tuple(starts),
        smooth,
        measured,
        levels,
        reason,
        known,
        levels,
        given,
        samples=carried.words,
        equivalent_optima=tuple(equivalent_optima),
    )
    return problem.with_errors(levels, NO_ERRORS, reason + by_columns(trials.schema))


def _with_starts(mesh: Mesh, levels: Floats, started: Bools) -> Mesh:
    """Return a mesh on which starts of latent states are as exact as they are."""
    if not started.any():
        return mesh
    return mesh.with_scale(
        np.where(started & mesh.observed, with_typical(mesh.noise, levels) * mesh.averaging / levels, 1.0)
    )


def _smoothed_estimates(
    models: Sequence[TrajectoryModel],
    groups: Sequence[Sequence[Trial]],
    curves: Sequence[Sequence[tuple[Floats, Floats]]],
    known: Floats,
) -> list[Estimate]:
    """Return the smoothed states and rates of each object, and coefficients of all allowed terms by least squares."""
    starts, own_laws, typical = [], [], typical_states(curves)
    for model, group, smoothed, fixed in zip(models, groups, curves, known, strict=True):
        usable = [pair for pair in zip(group, smoothed, strict=True) if np.isfinite(pair[1][0]).all()]
        coefficients = gradient_matching(model.terms, usable, fixed) if usable else np.nan_to_num(fixed)
        starts.append(Estimate(tuple(interpolate(filled_curves(smoothed, typical))), coefficients))
        own_laws.append([coefficients] if usable else [])
    others = [coefficients_ for own_law in own_laws for coefficients_ in own_law]
    for o, smoothed in enumerate(curves):
        if any(np.isnan(states).any() for states, _ in smoothed):
            starts[o] = begun(models[o], starts[o], own_laws[o] or others)
    return starts
