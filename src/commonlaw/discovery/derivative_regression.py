"""Terms fitted to estimated derivatives."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from commonlaw.differentiation import AbstractDifferentiator, default_differentiation, parse_differentiation
from commonlaw.discovery.method import parsed
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.discovery.regression import AbstractRegression
from commonlaw.formulation import StrongForm
from commonlaw.library import Order, highest_order
from commonlaw.trials import Trials, TrialStream


@dataclass(frozen=True, kw_only=True)
class DerivativeRegression(AbstractRegression):
    """Derivatives are estimated from the samples, and terms fitted to them (Brunton, Proctor, Kutz 2016).

    With a group solver this is the method of de Silva, Higdon, Brunton and Kutz (2020). It takes streams.

    Parameters
    ----------
    differentiation
        How derivatives are estimated, or its text such as ``"savgol:35:3"``. Default: `default_differentiation`.
    library_states
        Whether terms are evaluated on the ``"smoothed"`` or on the ``"measured"`` states, see `StrongForm`.
    trim
        Rows left out at each end of a trial, see `StrongForm`.
    solver, rule, scoring, n_resamples, n_jobs, seed
        How terms are chosen, see `AbstractRegression`.

    Raises
    ------
    CommonlawError
        If a text names nothing, or a value does not fit.

    Examples
    --------
    >>> from commonlaw import DerivativeRegression, datasets, discover
    >>> drops = datasets.linear_drag(noise=0.0)
    >>> method = DerivativeRegression(differentiation="finite:6", solver="group-stlsq:1")
    >>> discover(drops, order=2, library="poly:1", method=method).average().equations()
    ("x'' = -9.8 - 0.38 v",)
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_streams: ClassVar[bool] = True
    takes_mixed_orders: ClassVar[bool] = True

    differentiation: AbstractDifferentiator | str | None = None
    library_states: Literal["smoothed", "measured"] = "smoothed"
    trim: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "differentiation", parsed(self.differentiation, parse_differentiation))
        self._form(self.initial_rates(None, 1), 1)  # Refuses states and trims that do not fit

    def formulation(self, trials: Trials | TrialStream, structure: ModelStructure) -> StrongForm:
        return self._form(self.initial_rates(trials, structure.order), structure.order)

    def initial_rates(self, trials: Trials | TrialStream | None, order: Order) -> AbstractDifferentiator:
        return parsed(self.differentiation, parse_differentiation) or suitable_differentiation(trials, order)

    def _form(self, differentiation: AbstractDifferentiator, order: Order) -> StrongForm:
        return StrongForm(differentiation, order, self.library_states, self.trim)


def suitable_differentiation(trials: Trials | TrialStream | None, order: Order) -> AbstractDifferentiator:
    """Return how derivatives of these trials are estimated when nothing is named, by their lengths and gaps."""
    given = trials if isinstance(trials, Trials) else ()
    method = default_differentiation(highest_order(order), min(map(len, given), default=np.inf))
    suits = all(method.takes(each.times, each.states) for each in given)
    return method if suits else parse_differentiation("robust")
