"""What every method is: one way from trials to a law."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, TypeVar

from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.errors import CommonlawError
from commonlaw.formulation import law_variables
from commonlaw.law import Law
from commonlaw.library import order_of_each
from commonlaw.progress import ProgressCallback
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

    takes_constants: ClassVar[bool] = False
    """Whether it finds constants inside of terms."""

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
        raise CommonlawError(
            f"equations of different orders do not go with {name}: use method=DerivativeRegression(), or give one order"
        )
    if not {*order_of_each(order, 1)} <= {*method.orders}:
        other = "DiscreteTimeRegression" if order == 0 else "DerivativeRegression"
        raise CommonlawError(f"order={order} does not go with {name}: use method={other}(), or another order")
    if isinstance(trials, TrialStream) and not method.takes_streams:
        raise CommonlawError(
            f"a stream does not go with {name}: use method=DerivativeRegression(), or read the trials into memory"
        )
    inside = [each.text(law_variables(trials.schema, order)) for each in structure.parametric(trials.schema)]
    inside += ["ratios of sums"] if structure.ratios(trials.schema) else []
    other = "" if order == 0 else ", or use method=TrajectoryLikelihood()"
    if inside and not method.takes_constants:
        remedy = "take a library without ratios" if inside[0] == "ratios of sums" else "give constants as numbers"
        raise CommonlawError(f"terms with constants inside, here {inside[0]}, do not go with {name}: {remedy}{other}")
    columns = trials.schema.noise_columns
    if columns and not method.takes_noise_columns:
        raise CommonlawError(
            f"standard deviations of measurements, here in {', '.join(columns.values())}, do not go with {name}: read "
            f"the table with noise_columns={{}}, states={[*trials.schema.measured]}{other}"
        )


def parsed(value: T | str | None, parse: Callable[[str], T]) -> T | None:
    """Return what a text stands for; anything else as it is."""
    return parse(value) if isinstance(value, str) else value
