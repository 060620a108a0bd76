"""What every data set is."""

from collections.abc import Callable
from dataclasses import dataclass, field
from inspect import signature
from typing import TYPE_CHECKING, Any, Generic, ParamSpec

from commonlaw.errors import CommonlawError
from commonlaw.trials import Trials

if TYPE_CHECKING:
    from commonlaw.law import Law


P = ParamSpec("P")

DE_SILVA_2020 = (
    "B. M. de Silva, D. M. Higdon, S. L. Brunton and J. N. Kutz, Discovery of Physics from Data: Universal Laws and "
    "Discrepancies, Frontiers in Artificial Intelligence 3:25 (2020), doi:10.3389/frai.2020.00025"
)


@dataclass(frozen=True)
class Dataset(Generic[P]):
    """Named data set; calling it loads or simulates its trials.

    Parameters
    ----------
    name
        Name on the command line: ``"linear-drag"``.
    summary
        Description in one line.
    citation
        Source.
    load
        Function that returns the trials; its parameters are the options of the data set.
    law
        Function that returns the true law for these options; None if it is not known.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drag = cl.datasets.DATASETS["linear-drag"]
    >>> drag(noise=0.05), drag.truth(noise=0.05).structure
    (<Trials: 10 trials of 5 objects, 490 samples of x>, ("x'' = a + b v",))
    """

    name: str
    summary: str
    citation: str = field(repr=False)
    load: Callable[P, Trials] = field(repr=False)
    law: "Callable[..., Law] | None" = field(repr=False)

    def __post_init__(self) -> None:
        # So that help, completion and messages about options show those of `load`
        object.__setattr__(self, "__signature__", signature(self.load))
        object.__setattr__(self, "__doc__", self.load.__doc__)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> Trials:
        """Return the trials, see `load`."""
        return self.load(*args, **kwargs)

    def truth(self, *args: Any, **kwargs: Any) -> "Law":
        """Return the law behind the trials that the same options load.

        Raises `CommonlawError` if it is not known, or an option cannot be.
        """
        if self.law is None:
            raise CommonlawError("dataset-without-law", name=self.name)
        options = signature(self.load).bind(*args, **kwargs)
        options.apply_defaults()
        return self.law(**{name: options.arguments[name] for name in signature(self.law).parameters})
