"""commonlaw finds the law that repeated, noisy experiments on several objects have in common.

Each public name is loaded when it is first used, so that importing the package costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from commonlaw import datasets, plots, sphere_drag
    from commonlaw.differentiation import (
        CenteredDifference,
        FiniteDifference,
        ForwardDifference,
        MedianFilter,
        SavitzkyGolay,
        SmoothedDifference,
        SmoothingSpline,
        Spectral,
        TotalVariation,
        WienerFilter,
        noise_level,
    )
    from commonlaw.discovery import LawDiscovery, discover
    from commonlaw.errors import CommonlawError
    from commonlaw.forecast import Event, Forecast, Trajectory
    from commonlaw.formulation import LeastSquaresProblem, StrongForm, WeakForm
    from commonlaw.inference import refine
    from commonlaw.law import Law
    from commonlaw.library import (
        ConstantLibrary,
        ExpressionLibrary,
        FourierLibrary,
        PolynomialLibrary,
        RationalLibrary,
    )
    from commonlaw.outcomes import Outcome
    from commonlaw.solvers import (
        L1,
        L2,
        SR3,
        STLSQ,
        BackwardElimination,
        BestSubset,
        Constrained,
        Count,
        ForwardSelection,
        GroupSTLSQ,
        Lasso,
        Mean,
        Median,
        Quantile,
    )
    from commonlaw.trials import Schema, Trial, Trials, TrialStream

_ROOMS = {
    "commonlaw.differentiation": (
        "CenteredDifference",
        "FiniteDifference",
        "ForwardDifference",
        "MedianFilter",
        "SavitzkyGolay",
        "SmoothedDifference",
        "SmoothingSpline",
        "Spectral",
        "TotalVariation",
        "WienerFilter",
        "noise_level",
    ),
    "commonlaw.discovery": ("LawDiscovery", "discover"),
    "commonlaw.errors": ("CommonlawError",),
    "commonlaw.forecast": ("Event", "Forecast", "Trajectory"),
    "commonlaw.formulation": ("StrongForm", "LeastSquaresProblem", "WeakForm"),
    "commonlaw.inference": ("refine",),
    "commonlaw.law": ("Law",),
    "commonlaw.library": (
        "ConstantLibrary",
        "ExpressionLibrary",
        "FourierLibrary",
        "PolynomialLibrary",
        "RationalLibrary",
    ),
    "commonlaw.outcomes": ("Outcome",),
    "commonlaw.solvers": (
        "L1",
        "L2",
        "SR3",
        "STLSQ",
        "BackwardElimination",
        "BestSubset",
        "Constrained",
        "Count",
        "ForwardSelection",
        "GroupSTLSQ",
        "Lasso",
        "Mean",
        "Median",
        "Quantile",
    ),
    "commonlaw.trials": ("Schema", "Trial", "TrialStream", "Trials"),
}
_MODULES = ("datasets", "plots", "sphere_drag")
_HOME = {name: room for room, names in _ROOMS.items() for name in names}

__all__ = [
    "L1",
    "L2",
    "SR3",
    "STLSQ",
    "BackwardElimination",
    "BestSubset",
    "CenteredDifference",
    "CommonlawError",
    "ConstantLibrary",
    "Constrained",
    "Count",
    "Event",
    "ExpressionLibrary",
    "FiniteDifference",
    "Forecast",
    "ForwardDifference",
    "ForwardSelection",
    "FourierLibrary",
    "GroupSTLSQ",
    "Lasso",
    "Law",
    "LawDiscovery",
    "LeastSquaresProblem",
    "Mean",
    "Median",
    "MedianFilter",
    "Outcome",
    "PolynomialLibrary",
    "Quantile",
    "RationalLibrary",
    "SavitzkyGolay",
    "Schema",
    "SmoothedDifference",
    "SmoothingSpline",
    "Spectral",
    "StrongForm",
    "TotalVariation",
    "Trajectory",
    "Trial",
    "TrialStream",
    "Trials",
    "WeakForm",
    "WienerFilter",
    "datasets",
    "discover",
    "noise_level",
    "plots",
    "refine",
    "sphere_drag",
]


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return import_module(f"commonlaw.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'commonlaw' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
