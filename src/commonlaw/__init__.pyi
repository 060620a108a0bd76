"""The public names, each once; `__init__.py` loads them when they are first used."""

from . import datasets as datasets, law as law, plots as plots
from .differentiation import (
    CenteredDifference as CenteredDifference,
    FiniteDifference as FiniteDifference,
    ForwardDifference as ForwardDifference,
    MedianFilter as MedianFilter,
    RobustSpline as RobustSpline,
    SavitzkyGolay as SavitzkyGolay,
    SmoothedDifference as SmoothedDifference,
    SmoothingSpline as SmoothingSpline,
    SpectralDerivative as SpectralDerivative,
    TotalVariationDerivative as TotalVariationDerivative,
    WienerFilter as WienerFilter,
    noise_level as noise_level,
)
from .discovery import (
    DerivativeRegression as DerivativeRegression,
    DiscreteTimeRegression as DiscreteTimeRegression,
    LawDiscovery as LawDiscovery,
    TrajectoryLikelihood as TrajectoryLikelihood,
    WeakRegression as WeakRegression,
    discover as discover,
    fit as fit,
)
from .errors import CommonlawError as CommonlawError
from .experiments import Design as Design, design as design
from .forecast import Forecast as Forecast
from .formulation import (
    DiscreteForm as DiscreteForm,
    LeastSquaresProblem as LeastSquaresProblem,
    StrongForm as StrongForm,
    WeakForm as WeakForm,
)
from .inference import (
    Bounds as Bounds,
    bounds as bounds,
    compare as compare,
    refine as refine,
)
from .integration import (
    Event as Event,
    Trajectory as Trajectory,
)
from .law import (
    Law as Law,
    PlausibleLaw as PlausibleLaw,
    Provenance as Provenance,
    Uncertainty as Uncertainty,
)
from .law.models import NamedModel as NamedModel, named_models as named_models
from .library import (
    AutoLibrary as AutoLibrary,
    ConstantLibrary as ConstantLibrary,
    ExpressionLibrary as ExpressionLibrary,
    FourierLibrary as FourierLibrary,
    ParametricLibrary as ParametricLibrary,
    PolynomialLibrary as PolynomialLibrary,
    RatioLibrary as RatioLibrary,
    RationalLibrary as RationalLibrary,
)
from .outcomes import (
    Outcome as Outcome,
    OutcomeKind as OutcomeKind,
)
from .runtime.fit_options import FitOptions as FitOptions
from .runtime.progress import LongWorkWarning as LongWorkWarning
from .solvers import (
    SR3 as SR3,
    STLSQ as STLSQ,
    BestSubset as BestSubset,
    ConstrainedSolver as ConstrainedSolver,
    Lasso as Lasso,
    StepwiseSelection as StepwiseSelection,
)
from .stream import (
    StreamResiduals as StreamResiduals,
    check_stream as check_stream,
    forecast_stream as forecast_stream,
)
from .trials import (
    Schema as Schema,
    Trial as Trial,
    Trials as Trials,
    TrialStream as TrialStream,
)

__version__: str
