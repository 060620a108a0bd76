"""Laws in discrete time, fitted to the next samples."""

from dataclasses import dataclass
from typing import ClassVar

from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.discovery.regression import AbstractRegression
from commonlaw.formulation import DiscreteForm
from commonlaw.library import Order
from commonlaw.runtime.fit_options import documented
from commonlaw.trials import Trials, TrialStream


@documented
@dataclass(frozen=True, kw_only=True)
class DiscreteTimeRegression(AbstractRegression):
    """Terms at one sample are fitted to the states at the next: ``x[k+1] = f(x[k])``. It takes streams.

    Parameters
    ----------
    {parameters}

    Raises
    ------
    CommonlawError
        If a text names nothing, or a value does not fit.
    """

    orders: ClassVar[tuple[int, ...]] = (0,)
    takes_streams: ClassVar[bool] = True

    def formulation(self, trials: Trials | TrialStream, structure: ModelStructure) -> DiscreteForm:
        return DiscreteForm()

    def initial_rates(self, trials: Trials | TrialStream, order: Order) -> None:
        return None
