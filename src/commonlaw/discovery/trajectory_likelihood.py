"""States and coefficients fitted together to what was measured, terms chosen by their evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from commonlaw.diagnostics import Diagnostic
from commonlaw.discovery.candidate_search import CandidateSearch
from commonlaw.discovery.fit_options import FitOptions
from commonlaw.discovery.method import AbstractMethod, refuse_what_does_not_fit
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.discovery.pipeline import law_of_best_order
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.library import order_of_each
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.stream.proposals import Fitting, law_of_parts
from commonlaw.trials import Trials, TrialStream


@dataclass(frozen=True, kw_only=True)
class TrajectoryLikelihood(FitOptions, AbstractMethod):
    """Maximum likelihood of whole trajectories with free initial states; supports are compared by their evidence.

    The law knows how accurate it is. See `commonlaw.inference`, and docs/method for every formula.

    Parameters
    ----------
    positive
        States that are above zero and modelled on a logarithmic scale, in laws of first order: errors of their
        measurement are shares of the state, and so is their noise; forecasts and their bands stay above zero. The law
        itself is in the units of the states.
    input_between
        The interpolation of inputs between samples: ``"held"``, ``"linear"`` or ``"cubic"``, see `Law.predict`.
        ``"auto"``: straight lines, unless the evidence of the law for another is strong.
    noise
        Standard deviation of each state's measurement noise by name. Default: it is estimated, but for states whose
        measurements have standard deviations of their own (``noise_columns`` of the trials).
    errors
        The errors beside white noise that are estimated with the law. ``"auto"``: the kind that the measurements ask
        for, if white noise does not explain them. ``"white"``: none; ``"proportional"``: noise that grows with the
        states; ``"correlated"``: errors of the measurements that have a memory; ``"walk"``, ``"force"``: a law that
        errs, by a random walk or by a smooth force.
    huber_threshold
        Standard deviations of noise beyond which a measurement counts as an outlier; infinite for none.
    covariance
        How the coefficients' covariance is found. ``"likelihood"``: from the curvature of the likelihood.
        ``"bootstrap"``: from the scatter of coefficients when blocks of the trials are drawn anew, for noise that is
        neither normal nor alike everywhere.
    partial_pooling
        Whether forecasts draw coefficients to their mean over objects as far as these are alike, see
        `Law.pool`. The law itself has those of each object's own trials.
    solver
        Whose path lists the candidates of each equation, or its text such as ``"best-subset"``; it has no value of its
        hyperparameter, as the evidence chooses. Default: best subset selection.
    max_samples
        Of more samples so many are fitted, and the law says so: thinned as far as these still tell noise from motion,
        and if that is not enough, in segments spread over the trials of each object. All of them tell the noise.
    unmeasured
        1 to ask, too, for a state that nobody measured: a depot or a drive that decays, a pool that is used up, one
        that keeps what it gets, a compartment; in laws with an equation of second order a drive. The law without it is
        one of the hypotheses. What it is counted in is said by the history of the law.
    seed
        Of the bootstrap.
    n_jobs
        Threads that share the objects and the searches; the law is the same for any number. Default: one for each core,
        or as many as the environment variable ``OMP_NUM_THREADS`` says.

    Raises
    ------
    CommonlawError
        If a text names nothing, or a value does not fit.
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_mixed_orders: ClassVar[bool] = True
    takes_streams: ClassVar[bool] = True
    takes_noise_columns: ClassVar[bool] = True
    takes_constants: ClassVar[bool] = True

    def find(self, trials: Trials | TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        if isinstance(trials, TrialStream):
            return self._of_parts(trials, structure, progress)
        orders = order_of_each(structure.order, len(trials.schema.states))
        return self.find_order(trials, structure, [(each,) for each in orders], progress)

    def find_order(
        self,
        trials: Trials,
        structure: ModelStructure,
        possible: Sequence[Sequence[int]],
        progress: ProgressCallback,
    ) -> Law:
        """Return the law of largest evidence among those of several orders, see `law_of_best_order`."""
        refuse_what_does_not_fit(self, trials, structure)
        with threads(self.n_jobs):
            return law_of_best_order(CandidateSearch(trials, self, progress), structure, possible)

    def _of_parts(self, trials: TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        """Return the law of objects that are fitted part by part, under white noise if nothing else is named."""
        refuse_what_does_not_fit(self, trials, structure)
        inside = structure.parametric(trials.schema) or structure.ratios(trials.schema)
        if inside or self.unmeasured:
            what = "unmeasured=1" if self.unmeasured else "a term with constants inside"
            raise CommonlawError("stream-with-option", what=what)
        errors = "white" if self.errors == "auto" else self.errors
        return law_of_parts(
            trials,
            partial(_found_in, replace(self, errors=errors, covariance="likelihood", partial_pooling=False), structure),
            Fitting(
                noise=self.noise,
                errors=errors,
                huber_threshold=self.huber_threshold,
                covariance=self.covariance,
                seed=self.seed,
            ),
            structure.universal_in,
            self.partial_pooling,
            progress,
        )


def with_unmeasured(method: AbstractMethod, count: int) -> AbstractMethod:
    """Return the method that asks, too, for so many states that nobody measured."""
    if not count:
        return method
    if not isinstance(method, TrajectoryLikelihood):
        name = type(method).__name__
        remedy = Diagnostic("leave-out" if 0 in method.orders else "use-trajectory-likelihood")
        raise CommonlawError("latent-states-unsupported", count=count, method=name, remedy=remedy)
    return replace(method, unmeasured=count)


def _found_in(method: TrajectoryLikelihood, structure: ModelStructure, trials: Trials) -> Law:
    return method.find(trials, structure, lambda _: None)
