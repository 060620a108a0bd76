"""The inference problem: trials on meshes, candidate terms, noise, error model and initial estimates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.differentiation.noise import within_trial_std
from commonlaw.formulation import refuse_constant_states
from commonlaw.inference import settings
from commonlaw.inference.data.noise import (
    by_columns,
    estimated_noise,
    has_replicates,
    initial_value_scales,
    noise_floor,
)
from commonlaw.inference.data.segments import between_jumps
from commonlaw.inference.data.smoothing import filled_curves, gradient_matching, smooth_curves, typical_states
from commonlaw.inference.data.subsampling import subsample
from commonlaw.inference.fit.latent_initialization import (
    initial_latent_estimates,
    pooled_start,
    with_initial_condition_noise,
)
from commonlaw.inference.score.evidence import NoisePrior, NoiseScale
from commonlaw.inference.score.supports import BITS, StructurePrior, shifted
from commonlaw.law import Law, Provenance
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library import Order, Terms, with_rates
from commonlaw.likelihood import (
    HUBER_THRESHOLD,
    WHITE_NOISE,
    ErrorModel,
    Estimate,
    Mesh,
    NoiseByGroup,
    ObservationModel,
    Prior,
    Scales,
    TrajectoryModel,
    by_group,
    interpolate,
    meshes,
)
from commonlaw.likelihood.levels import scales_of
from commonlaw.runtime.fit_options import ErrorKind, FitOptions
from commonlaw.runtime.forking import cached_property
from commonlaw.solvers import AbstractSolver
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import Replication, replication, with_typical


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """The data and settings of inference: trials of all objects, candidate terms, noise, and initial estimates.

    For each object there are a model (terms, meshes with measurements), an initial estimate (`starts`), smoothed states
    (and rates) of its trials, each of shape (n, D), and the number of measurements. Standard deviations of the `noise`
    have shape (d,); `noise_estimate` is that before any law, which is kept if it is given. Fixed coefficients, `known`,
    have shape (objects, equations, terms), NaN for free ones. `points` are points of a sampling step; `jumps` say
    which inputs jump between segments, see `between_jumps`, and `samples` describe the subsample, empty for none. With
    latent states, `equivalent_optima` fit the first object about as well as its initial estimate, each of shape
    (equations, terms). `excluded_terms` candidates were screened out before. With `residuals_estimate_noise`, residuals
    estimate the noise of trials that are too short for differences. The solver lists candidate supports, None for given
    terms; the differentiation is that of forecasts.
    The Huber threshold is that of laws, also where a fit is by least squares for want of outliers.
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
    errors: ErrorModel = WHITE_NOISE
    jumps: str = ""
    samples: str = ""
    equivalent_optima: tuple[Floats, ...] = ()
    excluded_terms: int = 0
    residuals_estimate_noise: bool = False
    solver: AbstractSolver | None = None
    differentiation: AbstractDifferentiator | None = None
    huber_threshold: float = HUBER_THRESHOLD

    @property
    def terms(self) -> Terms:
        return self.models[0].terms

    @property
    def order(self) -> Order:
        """The order of the laws, or of each equation."""
        return self.models[0].order

    @property
    def law(self) -> Law:
        """The law of these trials with the fixed coefficients alone."""
        return Law(
            self.terms,
            self.trials.schema,
            self.order,
            self.trials.objects,
            np.nan_to_num(self.known),
            Uncertainty(huber_threshold=self.huber_threshold),
            Provenance(self.differentiation),
        )

    @property
    def allowed(self) -> Bools:
        """Candidate terms of each equation, shape (equations, terms)."""
        return np.asarray(np.isnan(self.known[0]))

    @cached_property
    def measured_states(self) -> tuple[Bools, ...]:
        """Which states of each object were measured in one of its trials, each of shape (states,)."""
        groups = [self.trials.of_object(name) for name in self.trials.objects]
        states = (np.concatenate([trial.states for trial in group]) for group in groups)
        return tuple(np.asarray(np.isfinite(measured).any(axis=0)) for measured in states)

    def fixed_at_pooled(self, index: int) -> Bools:
        """Return the coefficients of an object that are fixed at pooled values, shape (equations, terms)."""
        measured = self.measured_states[index]
        unmeasured = np.flatnonzero(~measured)
        of_unmeasured = np.array([any(c in term.columns() for c in unmeasured) for term in self.terms.terms])
        is_known = any(states.all() for states in self.measured_states)
        return np.asarray(measured[:, np.newaxis] & of_unmeasured & is_known)

    @cached_property
    def most_terms(self) -> int:
        """The largest number of terms of an equation.

        All objects have at least `MIN_SAMPLES_PER_TERM` measurements for each term of the shared support, and each one
        as many as it has initial states and coefficients.
        """
        pairs = zip(self.models, self.trials.objects, strict=True)
        starts = [model.width * len(self.trials.of_object(name)) for model, name in pairs]
        spare = min(n - initial for n, initial in zip(self.measured, starts, strict=True))
        shared = sum(self.measured) // settings.MIN_SAMPLES_PER_TERM
        return int(np.clip(min(spare, shared) // len(self.noise), 1, settings.MAX_TERMS))

    @property
    def noise_is_fixed(self) -> bool:
        """Whether the noise is kept: given, estimated from more samples than are fitted, or not identifiable."""
        is_estimated = self.noise_is_identifiable or self.residuals_estimate_noise
        return self.noise_given or bool(self.samples) or not is_estimated

    @cached_property
    def noise_is_identifiable(self) -> bool:
        """Whether replicates, or differences of the samples of some trial, estimate the noise of a state."""
        return bool(has_replicates(self.trials).any()) or any(
            np.isfinite(trial.states).sum(axis=0).max() >= settings.MIN_SAMPLES for trial in self.trials
        )

    def is_determined(self, coefficients: int) -> bool:
        """Return whether residuals have enough degrees of freedom with so many coefficients of all objects."""
        starts = sum(model.width * len(model.meshes) for model in self.models)
        return sum(self.measured) - starts - coefficients >= settings.MIN_FREEDOM

    def starts_with(self, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
        """Return the initial states with the coefficients of estimates, which may be on another mesh."""
        pairs = zip(self.starts, estimates, strict=True)
        return tuple(replace(start, coefficients=estimate.coefficients) for start, estimate in pairs)

    def with_priors(self, priors: Sequence[Prior | None]) -> "SearchProblem":
        """Return the problem with priors of the coefficients of each object."""
        pairs = zip(self.models, priors, strict=True)
        return replace(self, models=tuple(replace(model, prior=prior) for model, prior in pairs))

    def of_objects(self, indices: Sequence[int]) -> "SearchProblem":
        """Return the problem of some of the objects with the same error model."""
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
        """Return the problem of other trials of the same schema, with the same error model and mesh level.

        Fixed and initial coefficients of their objects have shape (objects, equations, terms).
        """
        model, some = self.models[0], self.trials.with_trials(trials)
        threshold = model.observation.huber_threshold
        problem = prepare(some, model.terms, known, noise=self.noise_estimate, huber_threshold=threshold, guess=guess)
        problem = problem.with_points(self.points)
        models = tuple(replace(fine, unit=self.unit) for fine in problem.models)
        return replace(problem, models=models).with_errors(self.noise, self.errors, self.noise_reason)

    def with_scaled_noise(self, factor: Floats | float, reason: str) -> "SearchProblem":
        """Return the problem with the noise times a factor, of each state or of all, and its description."""
        factors = np.broadcast_to(factor, self.noise.shape)
        units = np.concatenate([factors, factors[with_rates(self.models[0].order, len(factors))]])
        models = tuple(replace(model, unit=units * model.unit) for model in self.models)
        return replace(self, models=models).with_errors(factor * self.noise, self.errors, reason)

    def with_huber_threshold(self, threshold: float, *, rejects: bool = False) -> "SearchProblem":
        """Return the problem with another Huber threshold, which may reject outliers, see `ObservationModel`."""
        observation = replace(self.models[0].observation, huber_threshold=threshold, rejects=rejects)
        return replace(self, models=tuple(replace(model, observation=observation) for model in self.models))

    def with_errors(self, noise: Floats, errors: ErrorModel, reason: str) -> "SearchProblem":
        """Return the problem with other noise, shape (d,), other errors, and their description."""
        lengths = [len(mesh) for model in self.models for mesh in model.meshes]
        scales = iter(np.split(self.white_std_at(noise, errors) / noise, np.cumsum(lengths)[:-1]))
        models, starts, units = [], [], zip(self._units(errors), self._units(self.errors), strict=True)
        for model, start, (unit, before) in zip(self.models, self.starts, units, strict=True):
            states = tuple(state[:, : model.width] for state in start.states)
            meshes = [mesh.with_scale(next(scales)) for mesh in model.meshes]
            observation = replace(model.observation, noise=noise)
            changed = replace(model, meshes=meshes, observation=observation, unit=model.unit * (unit / before))
            changed, start = changed.with_latent(errors.latent, replace(start, states=states))
            models.append(changed)
            starts.append(start)
        problem = replace(self, models=tuple(models), starts=tuple(starts))
        return replace(problem, noise=noise, errors=errors, noise_reason=reason)

    def errors_to_fit(self, model_error: float) -> tuple[float, ...]:
        """Return the sequence of model errors of a fit; zero is approached by continuation.

        In a search, measurements without noise come from a solver, whose errors in a step are those of its tolerance:
        of solutions alone, these errors would be explained by terms.
        """
        if model_error:
            return (model_error,)
        if not (least := settings.SOLVER_ERROR * self._exact_share):
            return settings.FINAL_MODEL_ERRORS
        return (*(error for error in (settings.MODEL_ERRORS[-2], *settings.FINAL_MODEL_ERRORS) if error > least), least)

    @cached_property
    def _exact_share(self) -> float:
        """The smallest noise of a state, relative to that of now, if a search has no more; zero if there is more."""
        if self.solver is None or self.noise_given:
            return 0.0
        measured, least = ~self.trials.schema.is_latent, settings.MIN_NOISE * within_trial_std(self.trials)
        is_exact = (self.noise_estimate <= 1.001 * least)[measured].all()
        return float(np.max((least / self.noise)[measured])) if is_exact else 0.0

    @property
    def under_white_noise(self) -> "SearchProblem":
        """The problem with white noise alone, of its first estimate, which is the unit of model errors again."""
        if not self.errors:
            return self
        white = self.with_errors(self.noise, WHITE_NOISE, self.noise_reason)
        of_unit = replace(white, noise=self.unit[: len(self.noise)])
        return of_unit.with_scaled_noise(self.noise_estimate / of_unit.noise, "of the first estimate")

    @property
    def scatters(self) -> Bools:
        """Of which states the noise differs between objects, or trials, shape (d,)."""
        ones = np.ones(len(self.noise))
        return np.asarray(np.any([self.errors.noise_of_trial(trial, ones) != 1 for trial in self.trials], axis=0))

    def with_noise_by_group(
        self, kind: ErrorKind, residuals: NoiseByGroup, scatters: Bools, reason: str
    ) -> "SearchProblem":
        """Return the problem with the noise of each group by residuals, of states that scatter, shape (d,)."""
        noise, factors = residuals.levels(scatters)
        is_estimated = residuals.freedom.sum(axis=0) >= 1
        floor = np.where(scatters, 0.0, noise_floor(self.trials))
        noise = np.where(is_estimated, np.maximum(noise, floor), self.noise)
        groups, in_order = by_group(kind), self.in_order
        errors = groups.of_factors(in_order, factors) if scatters.any() else WHITE_NOISE
        return self.with_errors(noise, errors, reason)

    @property
    def unit(self) -> Floats:
        """The unit of the model errors of all objects, shape (D,); of each one it is in proportion to its noise."""
        return self.models[0].unit / self._units(self.errors)[0]

    def _units(self, errors: ErrorModel) -> list[Floats]:
        """Return the unit of model errors of each object relative to that of all, shape (D,)."""
        second, ones = with_rates(self.order, len(self.noise)), np.ones(len(self.noise))
        factors = [errors.noise_of(name, ones) for name in self.trials.objects]
        return [np.append(factor, factor[second]) for factor in factors]

    def about(self, estimates: Sequence[Estimate]) -> "SearchProblem":
        """Return the problem with the states of estimates, at which heteroscedastic noise is evaluated."""
        pairs = zip(self.starts, estimates, strict=True)
        starts = tuple(replace(start, states=estimate.states) for start, estimate in pairs)
        return replace(self, starts=starts).with_errors(self.noise, self.errors, self.noise_reason)

    def white_std_at(self, noise: Floats, errors: ErrorModel) -> Floats:
        """Return the white-noise standard deviation of each measurement, shape (points, d), given that of states, (d,).

        Constant states keep their prior noise; that of absent ones (exactly zero) is negligible. Heteroscedastic noise
        is evaluated at the initial estimates.
        """
        states = np.concatenate([state for start in self.starts for state in start.states])[:, : len(noise)]
        levels = np.array([errors.noise_of_trial(trial, noise) for trial in self.in_order])
        std = errors.white_std(states, with_typical(self._given, levels[np.concatenate(self.trial_of_points)]))
        still = np.where(self._absent, settings.MIN_NOISE * self.noise_estimate, self.noise_estimate)
        return np.where(self._still, with_typical(self._given, still), std) * self._averaging

    @cached_property
    def noise_prior(self) -> NoisePrior:
        """The prior of levels of errors; the variance is at least that of the least noise."""
        return NoisePrior(
            sum(self.measured),
            float(sum(mesh.degrees_of_freedom(self.order) for mesh in self._meshes)),
            ~self.trials.schema.is_latent,
            None if self.noise_is_fixed else self.noise_estimate,
            settings.PRIOR_OBSERVATIONS if self.noise_is_identifiable else 0.0,
            self.replication,
            noise_floor(self.trials),
            self.scales,
        )

    @cached_property
    def scales(self) -> Scales:
        """The scales of levels of errors."""
        trials, d, in_order = self.trials, len(self.noise), self.in_order
        curves = [curve[:, -d:] for group in self.smoothed for curve in group]
        rates = [np.gradient(column, trial.times, axis=0) for column, trial in zip(curves, in_order, strict=True)]
        std = np.where(trials.schema.is_latent, noise_floor(trials), within_trial_std(trials))
        size = np.sqrt(np.mean(np.concatenate(rates) ** 2, axis=0))
        return replace(scales_of(std, in_order), rates=size, least_walk=self.errors_to_fit(0.0)[0])

    def relative_noise_at(self, noise: Floats, std: Floats) -> Floats:
        """Return the mean squares of white noise at the measurements in units of that of a state of zero, (d,)."""
        relative = np.where(self._absent, 1.0, std / (with_typical(self._given, noise) * self._averaging))
        seen = np.isfinite(self.measurements)
        return np.asarray(np.sum(np.where(seen, relative, 0.0) ** 2, axis=0) / np.maximum(seen.sum(axis=0), 1))

    @cached_property
    def noise_scale(self) -> NoiseScale:
        return self.noise_prior.posterior(self.noise, self.errors, self.relative_noise_at(self.noise, self.white_std))

    @property
    def level_penalty(self) -> float:
        """Minus twice the log prior of the noise and of levels of errors."""
        prior, relative = self.noise_prior, self.relative_noise_at(self.noise, self.white_std)
        return prior.penalty(self.noise, self.errors, relative) + prior.of_levels(self.errors)

    @property
    def least_variance(self) -> float:
        """The lower bound of the noise variance that laws are fitted under, in units of its present value."""
        return float(np.max(noise_floor(self.trials) / self.noise) ** 2)

    @property
    def _meshes(self) -> list[Mesh]:
        return [mesh for model in self.models for mesh in model.meshes]

    @cached_property
    def measurements(self) -> Floats:
        """Measured states at all points, shape (points, d), NaN where missing."""
        return np.concatenate([mesh.measured for mesh in self._meshes])

    @cached_property
    def pure_error(self) -> tuple[Floats, Floats]:
        """The pure-error sum of squares of replicates of each state, and its degrees of freedom, each of shape (d,).

        Squares are those at the noise of all objects, see `ErrorModel.noise_of_trial`.
        """
        squares, freedom = np.zeros((2, len(self.noise)))
        for trial, of_trial in self.replication:
            squares += of_trial.squares / self.errors.noise_of_trial(trial, np.ones(len(self.noise))) ** 2
            freedom += of_trial.freedom
        return squares, freedom

    @cached_property
    def replication(self) -> list[tuple[Trial, Replication]]:
        """Trials in the order of objects, with numbers of measurements and the pure error of replicates."""
        return replication(self.in_order)

    @cached_property
    def in_order(self) -> list[Trial]:
        """The trials in the order of objects."""
        return [trial for name in self.trials.objects for trial in self.trials.of_object(name)]

    @cached_property
    def trial_of_points(self) -> list[Indices]:
        """The trial at each point of the meshes of each object, by its place among those in order, shape (points,)."""
        result, before = list[Indices](), 0
        for name in self.trials.objects:
            group = self.trials.of_object(name)
            places = [np.full((len(trial), 1), i, dtype=np.float64) for i, trial in enumerate(group, start=before)]
            points = np.concatenate(interpolate(places, self.points))[:, 0]
            result.append(np.rint(points).astype(np.int64))
            before += len(group)
        return result

    @cached_property
    def _given(self) -> Floats:
        return np.concatenate([np.broadcast_to(mesh.noise, mesh.measured.shape) for mesh in self._meshes])

    @cached_property
    def _averaging(self) -> Floats:
        return np.concatenate([np.broadcast_to(mesh.averaging, mesh.measured.shape) for mesh in self._meshes])

    @cached_property
    def _still(self) -> Bools:
        return np.concatenate([mesh.still for mesh in self._meshes])

    @cached_property
    def _absent(self) -> Bools:
        return np.concatenate([mesh.absent for mesh in self._meshes])

    @cached_property
    def structure_prior(self) -> StructurePrior:
        """The prior of supports; the origin of a state of second order is arbitrary unless trials pass through zero."""
        terms, states = self.models[0].terms, len(self.noise)
        given = ~self.allowed.any(axis=0) & np.any(np.nan_to_num(self.known) != 0, axis=(0, 1))
        origins = []
        for j in with_rates(self.models[0].order, states):
            seen = np.concatenate([trial.states[:, j] for trial in self.trials])
            if not np.nanmin(seen) <= 0 <= np.nanmax(seen):
                origins.append(shifted(terms, j) & ~given)
        bits, penalty = 2 * np.log(2) * BITS * terms.complexities, float(np.log(sum(self.measured)))
        return StructurePrior(bits, tuple(origins), penalty, self.excluded_terms)

    def std_of(self, mesh: Mesh) -> Floats:
        """Return the white-noise standard deviation of each measurement on a mesh, shape (n, d)."""
        return mesh.scale * self.noise

    @cached_property
    def white_std(self) -> Floats:
        """The same of all meshes in turn, shape (points, d)."""
        return np.concatenate([self.std_of(mesh) for mesh in self._meshes])

    def padded(self, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
        """Return estimates with the latent processes of the problem, zero if they are new."""
        pairs = zip(self.models, estimates, strict=True)
        return tuple(
            estimate
            if all(states.shape[1] == model.width + model.latent.width for states in estimate.states)
            else model.with_latent(model.latent, estimate)[1]
            for model, estimate in pairs
        )

    def finer(self) -> "SearchProblem":
        """Return the problem with twice as many points for each sampling step."""
        starts = self.on_half_steps(self.starts)
        return replace(self, starts=starts, points=2 * self.points).with_meshes_of(self.trials)

    def with_points(self, points: int) -> "SearchProblem":
        """Return the problem with at least so many points for each sampling step."""
        problem = self
        while problem.points < points:
            problem = problem.finer()
        return problem

    def on_half_steps(self, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
        """Return estimates with states interpolated linearly to the mesh of half steps."""
        return tuple(
            replace(estimate, states=tuple(map(Mesh.halfway, model.meshes, estimate.states)))
            for model, estimate in zip(self.models, estimates, strict=True)
        )

    def interpolated(self, trials: Trials) -> "SearchProblem":
        """Return the problem of the whole trials under another interpolation of inputs, which may be in segments."""
        if between_jumps(trials)[1] == self.jumps:
            return self.with_meshes_of(replace(self.trials, schema=trials.schema))
        guess = np.array([start.coefficients for start in self.starts])
        problem = replace(self, trials=trials).of_trials(trials.trials, self.known, guess)
        return replace(
            problem,
            noise_given=self.noise_given,
            samples=self.samples,
            excluded_terms=self.excluded_terms,
            residuals_estimate_noise=self.residuals_estimate_noise,
            solver=self.solver,
            differentiation=self.differentiation,
            huber_threshold=self.huber_threshold,
        )

    def with_meshes_of(self, trials: Trials) -> "SearchProblem":
        """Return the problem with new meshes of the same trials, or of these with another interpolation of inputs."""
        between, groups = trials.schema.input_interpolation, [trials.of_object(name) for name in trials.objects]
        models = tuple(
            replace(model, meshes=meshes(group, self.points, input_interpolation=between))
            for model, group in zip(self.models, groups, strict=True)
        )
        changed = replace(self, trials=trials, models=models)
        return changed.with_errors(self.noise, self.errors, self.noise_reason)


def prepare(
    trials: Trials,
    terms: Terms,
    known: Floats,
    *,
    noise: Floats | None = None,
    huber_threshold: float = HUBER_THRESHOLD,
    most_samples: int = FitOptions.max_samples,
    guess: Floats | None = None,
) -> SearchProblem:
    """Return the inference problem of these trials and candidate terms.

    Fixed coefficients have shape (objects, equations, terms), NaN for free ones. A guess of this shape has initial
    nonlinear parameters, and signs of coefficients in equations of latent states. The noise of each state, shape (d,),
    see `known_noise`, is by default estimated from all samples, of which `most_samples` are fitted (see `subsample`);
    for the Huber threshold see `ObservationModel`.

    Raises `CommonlawError` if a trial is too short, or a term is not finite on it; the message names the trial.
    """
    trials = with_initial_condition_noise(trials, terms, known[0])
    scale, order = within_trial_std(trials), terms.variables.order_of(len(trials.schema.states))
    trials = trials.with_trials(
        [replace(trial, noise=np.maximum(trial.noise, settings.MIN_NOISE * scale)) for trial in trials]
    )
    samples = {name: np.concatenate([trial.states for trial in trials.of_object(name)]) for name in trials.objects}
    extremes = {name: np.array([np.fmin.reduce(states), np.fmax.reduce(states)]) for name, states in samples.items()}
    started = trials.schema.is_latent
    extremes = {name: np.where(started, np.nan, bounds) for name, bounds in extremes.items()}
    refuse_constant_states(extremes, trials.schema)
    given = noise is not None
    noise, reason = estimated_noise(trials) if noise is None else (noise, "as given")
    levels = np.fmax(noise, settings.MIN_NOISE * scale if given else noise_floor(trials))
    if started.any():  # With the median noise-to-signal ratio, as the unit of model errors
        deviations = np.nanstd(np.concatenate([trial.states for trial in trials])[:, ~started], axis=0)
        share = np.median(levels[~started] / deviations)
        levels = np.where(started, share * initial_value_scales(trials), levels)
    trials, jumps = between_jumps(trials)
    trials, subsampled = subsample(trials, levels, most_samples)
    groups = [trials.of_object(name) for name in trials.objects]
    curves = [[smooth_curves(trial, order, started) for trial in group] for group in groups]
    unit, second = levels, with_rates(order, len(scale))
    if len(second):
        rates = np.concatenate([states[:, len(scale) :] for group in curves for states, _ in group])
        unit = np.concatenate([levels, levels[second] * np.nanstd(rates, axis=0) / scale[second]])
    between, observation = trials.schema.input_interpolation, ObservationModel(levels, huber_threshold)
    models = list[TrajectoryModel]()
    for group in groups:
        on_meshes = meshes(group, input_interpolation=between)
        if started.any():  # With the standard deviations of the initial values of latent states
            stds = [with_typical(mesh.noise, levels) * mesh.averaging / levels for mesh in on_meshes]
            pairs = zip(on_meshes, stds, strict=True)
            on_meshes = [mesh.with_scale(np.where(started & mesh.observed, std, 1.0)) for mesh, std in pairs]
        models.append(TrajectoryModel(terms, on_meshes, observation, unit))
    if started.any():
        starts, curves, equivalent_optima = initial_latent_estimates(
            models, trials, curves, known, np.zeros_like(known) if guess is None else guess
        )
    else:
        initial = known if guess is None else np.where(np.isnan(known) & ~terms.is_factor, guess, known)
        starts, equivalent_optima, matched, typical = list[Estimate](), [], list[list[Floats]](), typical_states(curves)
        for group, smoothed, fixed in zip(groups, curves, initial, strict=True):
            usable = [pair for pair in zip(group, smoothed, strict=True) if np.isfinite(pair[1][0]).all()]
            coefficients = gradient_matching(terms, usable, fixed) if usable else np.nan_to_num(fixed)
            states = filled_curves(smoothed, typical)
            starts.append(Estimate(tuple(interpolate(states)), coefficients))
            matched.append([coefficients] if usable else [])
        for o, smoothed in enumerate(curves):
            if any(np.isnan(states).any() for states, _ in smoothed):
                starts[o] = pooled_start(models[o], starts[o], matched[o] or [*chain.from_iterable(matched)])
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
        jumps=jumps,
        samples=subsampled,
        equivalent_optima=tuple(equivalent_optima),
        huber_threshold=huber_threshold,
    )
    return problem.with_errors(levels, WHITE_NOISE, reason + by_columns(trials.schema))
