"""The public names, each once; `__init__.py` loads them when they are first used."""

from . import (
    datasets as datasets,
    differentiation as differentiation,
    formulation as formulation,
    law as law,
    library as library,
    plots as plots,
    solvers as solvers,
)
from .diagnostics import Outcome as Outcome, OutcomeKind as OutcomeKind
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
from .experiments import design as design
from .forecast import Forecast as Forecast
from .inference import bounds as bounds, compare as compare, refine as refine
from .integration import Event as Event
from .law import Law as Law
from .law.models import NamedModel as NamedModel, named_models as named_models
from .runtime.fit_options import FitOptions as FitOptions
from .runtime.progress import LongWorkWarning as LongWorkWarning
from .stream import check_stream as check_stream, forecast_stream as forecast_stream
from .trials import Schema as Schema, Trial as Trial, Trials as Trials, TrialStream as TrialStream

__version__: str
