"""Laws that are fitted by shooting: parameters and initial values of solutions, within bounds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from commonlaw.errors import CommonlawError
from commonlaw.estimation.fitting import OF_FIT, checked_errors, refit, updated
from commonlaw.inference.result.history import without_outcomes_of_fit
from commonlaw.inference.search.error_models import outcomes_of_departures, under_likeliest_errors
from commonlaw.inference.search.setup import RefitOptions
from commonlaw.inference.verbs.scheme import AbstractFit
from commonlaw.law import Law
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.trials import Trials, TrialStream


@dataclass(frozen=True, eq=False)
class ShootingFit(AbstractFit):
    """A law with observation equations, initial values, or what else collocation does not fit."""

    takes_rows_of_inputs = True
    law: Law

    @property
    def has_joint_objects(self) -> bool:
        return True

    def refitted(
        self,
        trials: Trials,
        options: RefitOptions,
        progress: ProgressCallback,
        equations: Sequence[str] | None = None,
    ) -> Law:
        if options.input_interpolation == "auto":
            raise CommonlawError("not-with-observation", settings=["input_interpolation='auto'"])
        errors = checked_errors(options.changed)
        fitted = refit(
            self.law,
            trials,
            equations=equations,
            log_states=options.log_states,
            input_interpolation=options.input_interpolation,
            noise=options.noise,
            errors=errors or "white",
            huber_threshold=options.threshold,
            seed=options.seed,
            progress=progress,
        )
        fitted = fitted if errors else under_likeliest_errors(fitted)
        law, before = fitted.law(()), self.law.provenance
        kept = (outcome for outcome in without_outcomes_of_fit(before.outcomes) if outcome.code not in OF_FIT)
        provenance = replace(
            law.provenance,
            differentiation=before.differentiation,
            outcomes=(
                *kept,
                *law.provenance.outcomes,
                *outcomes_of_departures(fitted, tried_errors=errors is None),
            ),
            history=(*before.history, *fitted.steps),
            domain=law.provenance.domain.with_left_out(before.domain),
        )
        return replace(law, provenance=provenance)

    def by_file(self, stream: TrialStream, options: RefitOptions, progress: ProgressCallback) -> Law:
        raise CommonlawError("not-refined-file-by-file", what="observation equations")

    def updated(self, trials: Trials) -> Law:
        return updated(self.law, trials)
