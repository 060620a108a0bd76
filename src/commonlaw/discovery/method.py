"""What every method is: one way from trials to a law."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, TypeVar

from commonlaw.diagnostics import Diagnostic
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.errors import CommonlawError
from commonlaw.formulation import law_variables
from commonlaw.law import Law
from commonlaw.library import order_of_each
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.trials import Trials, TrialStream

T = TypeVar("T")


class AbstractMethod(ABC):
    """One way from trials to a law. Its fields are all that it heeds; what it does not take it refuses by name."""

    orders: ClassVar[tuple[int, ...]]
    """The orders of laws that it finds."""

    takes_mixed_orders: ClassVar[bool] = False
    """Whether it finds laws whose equations have different orders."""

    takes_streams: ClassVar[bool]
    """Whether it takes trials that come from a stream."""

    takes_noise_columns: ClassVar[bool] = False
    """Whether it heeds standard deviations of single measurements."""

    takes_derivatives: ClassVar[bool] = False
    """Whether it takes derivatives that are given."""

    takes_parameters: ClassVar[bool] = False
    """Whether it finds parameters inside terms."""

    @abstractmethod
    def find(self, trials: Trials | TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        """Return the law that these trials obey best.

        Parameters
        ----------
        trials
            What was measured.
        structure
            What is sought.
        progress
            Takes the text of each step.

        Raises
        ------
        CommonlawError
            If the order or a stream does not go with this method, or the trials cannot be used as they are; the
            message names the object and trial and says what to do.
        """


def refuse_what_does_not_fit(method: AbstractMethod, trials: Trials | TrialStream, structure: ModelStructure) -> None:
    """Refuse what a method does not take, before work starts, and name one that takes it."""
    name, order = type(method).__name__, structure.order
    if isinstance(order, tuple) and not method.takes_mixed_orders:
        raise CommonlawError("mixed-orders-unsupported", method=name)
    if not {*order_of_each(order, 1)} <= {*method.orders}:
        other = "DiscreteTimeRegression" if order == 0 else "DerivativeRegression"
        raise CommonlawError("order-of-method", order=order, method=name, alternative=other)
    if isinstance(trials, TrialStream) and not method.takes_streams:
        raise CommonlawError("stream-unsupported", method=name)
    if structure.derivatives is not None and not (method.takes_derivatives and order == 1):
        raise CommonlawError("derivatives-unsupported", method=name, order=order)
    inside = [each.text(law_variables(trials.schema, order)) for each in structure.parametric(trials.schema)]
    inside += ["ratios of sums"] if structure.ratios(trials.schema) else []
    others = [] if order == 0 else [Diagnostic("use-trajectory-likelihood")]
    if inside and not method.takes_parameters:
        remedy = "take a library without ratios" if inside[0] == "ratios of sums" else "give constants as numbers"
        raise CommonlawError("parametric-terms-unsupported", term=inside[0], method=name, remedies=[remedy, *others])
    columns = trials.schema.noise_columns
    if columns and not method.takes_noise_columns:
        others = [Diagnostic("read-without-deviations", {"states": [*trials.schema.measured]}), *others]
        raise CommonlawError("noise-columns-unsupported", columns=columns.values(), method=name, remedies=others)


def parsed(value: T | str | None, parse: Callable[[str], T]) -> T | None:
    """Return what a text stands for; anything else as it is."""
    return parse(value) if isinstance(value, str) else value
