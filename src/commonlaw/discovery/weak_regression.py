"""Terms fitted in the weak form."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from commonlaw.differentiation import AbstractDifferentiator, parse_differentiation
from commonlaw.discovery.derivative_regression import suitable_differentiation
from commonlaw.discovery.method import parsed
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.discovery.regression import AbstractRegression
from commonlaw.formulation import WeakForm, reweight
from commonlaw.inference import known_noise
from commonlaw.library import Order, highest_order
from commonlaw.runtime.fit_options import documented, shown
from commonlaw.trials import Trials, TrialStream


@documented
@dataclass(frozen=True, kw_only=True)
class WeakRegression(AbstractRegression):
    """Terms are integrated against test functions, so that no derivative is estimated (Messenger and Bortz 2021).

    Rows are whitened by their covariance (Bortz, Messenger and Dukic 2023), see `WeakForm`.

    Parameters
    ----------
    {parameters}

    Raises
    ------
    CommonlawError
        If a text names nothing, or a value does not fit.
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_streams: ClassVar[bool] = False

    radii: tuple[float, ...] | None = field(
        default=None,
        metadata=shown(
            label="Radii [samples]",
            text="Radii of the test functions in samples; by default one for each trial, by its spectrum.",
        ),
    )
    noise: Mapping[str, float] | None = field(
        default=None,
        metadata=shown(
            label="Measurement noise",
            metavar="STATE=VALUE",
            text="Known standard deviation of each state's measurement noise; estimated for each trial by default.",
        ),
    )
    differentiation: AbstractDifferentiator | str | None = field(
        default=None,
        metadata=shown(
            label="Smoothing",
            metavar="SPEC",
            text="How states are smoothed before terms are evaluated on them, and where the rates of laws of second "
            "order come from, or its text, such as spline.",
        ),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "differentiation", parsed(self.differentiation, parse_differentiation))
        WeakForm(radii=self.radii)  # Refuses radii that do not fit

    def formulation(self, trials: Trials | TrialStream, structure: ModelStructure) -> WeakForm:
        assert isinstance(trials, Trials)
        levels = known_noise(self.noise, trials)
        noise = None if levels is None else tuple(levels.tolist())
        differentiation = parsed(self.differentiation, parse_differentiation)
        form = WeakForm(highest_order(structure.order), self.radii, noise, differentiation)
        return reweight(trials, structure.terms(trials.schema), form)[0]

    def initial_rates(self, trials: Trials | TrialStream, order: Order) -> AbstractDifferentiator:
        return parsed(self.differentiation, parse_differentiation) or suitable_differentiation(trials, order)
