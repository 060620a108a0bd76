"""Maximum likelihood of whole trajectories, with supports selected by their evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

from commonlaw.array_types import evenly_spaced
from commonlaw.discovery.candidate_search import CandidateSearch
from commonlaw.discovery.method import AbstractMethod, ModelStructure, check_supported, parsed
from commonlaw.discovery.pipeline import law_of_best_order
from commonlaw.errors import CommonlawError
from commonlaw.forecast.population import with_pooled_forecasts
from commonlaw.inference import refine
from commonlaw.inference.verbs.chunks import fitted_by_parts, typical
from commonlaw.inference.verbs.comparison import compare_by_parts, written_alike
from commonlaw.law import Law, Step
from commonlaw.library import order_of_each
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.runtime.fit_options import FitOptions, documented
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback, part, silent, unannounced
from commonlaw.solvers import parse_solver
from commonlaw.text import counted
from commonlaw.trials import Trials, TrialStream

_GROUPS, _OBJECTS = 4, 10
"""Groups of objects of a stream that propose laws, each from another part, and objects in each."""


@documented
@dataclass(frozen=True, kw_only=True)
class TrajectoryLikelihood(FitOptions, AbstractMethod):
    """Maximum likelihood of whole trajectories with free initial states; supports are compared by their evidence.

    The law has standard errors and intervals. See `commonlaw.inference`, and docs/method for all formulas.

    Raises `CommonlawError` if a text cannot be parsed, or a value is invalid.

    Parameters
    ----------
    {parameters}
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_mixed_orders: ClassVar[bool] = True
    takes_streams: ClassVar[bool] = True
    takes_noise_columns: ClassVar[bool] = True
    takes_parameters: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        solver = parsed(self.solver, parse_solver)
        if solver is not None and solver.hyperparameter is not None:
            raise CommonlawError("solver-with-value", solver=solver)
        object.__setattr__(self, "solver", solver)

    def find(self, trials: Trials | TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        if isinstance(trials, TrialStream):
            return self._of_parts(trials, structure, progress)
        orders = order_of_each(structure.order, len(trials.schema.states))
        return self.find_order(trials, structure, [(order,) for order in orders], progress)

    def find_order(
        self, trials: Trials, structure: ModelStructure, possible: Sequence[Sequence[int]], progress: ProgressCallback
    ) -> Law:
        """Return the law of largest evidence among those of several orders, see `law_of_best_order`."""
        check_supported(self, trials, structure)
        with threads(self.n_jobs):
            return law_of_best_order(CandidateSearch(trials, self, progress), structure, possible)

    def _of_parts(self, stream: TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        """Return the law of a stream: proposed by groups of objects, chosen by its evidence over all, fitted to each.

        Parts return only laws, evidences and coefficients; they are fitted under white noise by default.
        """
        check_supported(self, stream, structure)
        nonlinear = structure.parametric(stream.schema) or structure.ratios(stream.schema)
        if nonlinear or self.latent_states:
            what = "latent_states=1" if self.latent_states else "a term with nonlinear parameters"
            raise CommonlawError("stream-with-option", what=what)
        errors = "white" if self.errors == "auto" else self.errors
        weighing = {"noise": self.noise, "errors": errors, "huber_threshold": self.huber_threshold}
        alone = replace(self, errors=errors, covariance="likelihood", partial_pooling=False)
        parts = stream.parts or (stream,)
        some = [parts[i] for i in evenly_spaced(len(parts), _GROUPS)]
        laws = done_in_parts(
            partial(_proposed, alone, structure), some, "seeking laws of groups of objects", part(progress, 0.0, 0.2)
        )
        proposed = {"; ".join(law.structure): law for law in reversed(laws)}
        what = f"{counted(len(proposed), 'law')} of {counted(len(some), 'group')} of at most {_OBJECTS} objects"
        steps = [Step("proposals", what, "terms proposed by a search among few objects")]
        best = next(iter(proposed.values()))
        if len(proposed) > 1:
            frame = compare_by_parts(proposed, parts, weighing, part(progress, 0.2, 0.4))
            (first, second), evidence = frame["law"][:2], frame["2 log B"][1]
            reason = f"2 log B = {evidence:.4g} for it over {second}, summed over {counted(len(parts), 'part')}"
            best = proposed[first]
            steps.append(Step("support", first, reason))
        fit = partial(_fitted, best, {**weighing, "covariance": self.covariance, "seed": self.seed})
        law = fitted_by_parts([fit] * len(parts), parts, part(progress, 0.4, 1.0))
        provenance = replace(
            best.provenance, domain=law.provenance.domain, outcomes=(), alternatives=(), history=(*best.history, *steps)
        )
        law = replace(law, provenance=provenance)
        return with_pooled_forecasts(law, structure.shared_in(law), self.partial_pooling)


def _proposed(method: TrajectoryLikelihood, structure: ModelStructure, part: TrialStream) -> Law:
    """Return the law of the first objects of a part, whose library are its own terms."""
    trials = part.read()
    some = [trial for name in trials.objects[:_OBJECTS] for trial in trials.of_object(name)]
    with unannounced():
        law = method.find(trials.with_trials(some), structure, silent)
    return replace(written_alike(law, law.schema), provenance=law.provenance)


def _fitted(law: Law, settings: dict[str, Any], trials: Trials) -> Law:
    """Return a law fitted to the objects of a part, each starting from the average coefficients."""
    return refine(typical(law, trials.objects), trials, **settings, partial_pooling=False, progress=silent)
