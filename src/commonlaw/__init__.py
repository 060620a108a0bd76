"""commonlaw finds the law that repeated, noisy experiments on several objects have in common.

Each public name is loaded when it is first used, so that importing the package costs next to nothing; `__init__.pyi`
lists them.
"""

import warnings
from pkgutil import resolve_name

import lazy_loader

__version__ = "0.2.0"

_loaded, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_MOVED = {
    "differentiation": "CenteredDifference FiniteDifference ForwardDifference MedianFilter RobustSpline SavitzkyGolay "
    "SmoothedDifference SmoothingSpline SpectralDerivative TotalVariationDerivative WienerFilter noise_level",
    "experiments": "Design",
    "formulation": "DiscreteForm LeastSquaresProblem StrongForm WeakForm",
    "inference": "Bounds",
    "integration": "Trajectory",
    "law": "PlausibleLaw Provenance Uncertainty",
    "library": "AutoLibrary ConstantLibrary ExpressionLibrary FourierLibrary ParametricLibrary PolynomialLibrary "
    "RatioLibrary RationalLibrary",
    "solvers": "BestSubset ConstrainedSolver Lasso SR3 STLSQ StepwiseSelection",
    "stream": "StreamResiduals",
}
RENAMED = {name: f"{module}.{name}" for module, names in _MOVED.items() for name in names.split()}
"""Public names of the last release, and where they are now."""
RENAMED |= {"FamilyLibrary": "library.ParametricLibrary"}


def __getattr__(name: str) -> object:
    if name not in RENAMED:
        return _loaded(name)
    warnings.warn(f"cl.{name} is deprecated; use cl.{RENAMED[name]}", DeprecationWarning, stacklevel=2)
    return resolve_name(f"{__name__}.{RENAMED[name]}")
