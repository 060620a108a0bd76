"""Terms fitted to estimated derivatives."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from commonlaw.differentiation import AbstractDifferentiator, default_differentiation, parse_differentiation
from commonlaw.discovery.method import parsed
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.discovery.regression import AbstractRegression
from commonlaw.formulation import StrongForm
from commonlaw.library import Order, highest_order
from commonlaw.runtime.fit_options import documented, shown
from commonlaw.trials import Trials, TrialStream


@documented
@dataclass(frozen=True, kw_only=True)
class DerivativeRegression(AbstractRegression):
    """Derivatives are estimated from the samples, and terms fitted to them (Brunton, Proctor, Kutz 2016).

    With a group solver this is the method of de Silva, Higdon, Brunton and Kutz (2020). It takes streams.

    Parameters
    ----------
    {parameters}

    Raises
    ------
    CommonlawError
        If a text names nothing, or a value does not fit.

    Examples
    --------
    >>> from commonlaw import DerivativeRegression, datasets, discover
    >>> from commonlaw.law import average_law
    >>> drops = datasets.linear_drag(noise=0.0)
    >>> method = DerivativeRegression(differentiation="finite:6", solver="group-stlsq:1")
    >>> average_law(discover(drops, order=2, library="poly:1", method=method)).equations()
    ("x'' = -9.8 - 0.38 v",)
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_streams: ClassVar[bool] = True
    takes_mixed_orders: ClassVar[bool] = True

    differentiation: AbstractDifferentiator | str | None = field(
        default=None,
        metadata=shown(
            label="Differentiation",
            metavar="SPEC",
            text="How derivatives are estimated, or its text: savgol:WINDOW:POLYNOMIAL, centered, forward, "
            "finite:ACCURACY, spline, median:WINDOW, wiener:WINDOW, spectral, tv:STRENGTH, robust. By default finite:2 "
            "for order 1, savgol:35:3 for order 2, shorter where trials are short, and robust where neither suits.",
        ),
    )
    library_states: Literal["smoothed", "measured"] = field(
        default="smoothed",
        metadata=shown(
            label="Evaluated states",
            text="Whether terms are evaluated on the smoothed or on the measured states, see `StrongForm`.",
        ),
    )
    trim: int = field(
        default=0,
        metadata=shown(
            label="Trimmed rows",
            text="Number of rows left out at each end of a trial, where smoothing is least accurate.",
        ),
    )

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
