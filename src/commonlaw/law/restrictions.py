"""What restricts the parameters of a law: sharing, priors, bounds and known noise."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from commonlaw.trials import Schema

ALL, OBJECT, TRIAL = "all", "object", "trial"
"""What has one value of a parameter: all trials, those of an object, or each one."""


@dataclass(frozen=True)
class Restrictions:
    """What restricted the parameters when a law was fitted.

    Parameters
    ----------
    shared
        By parameter what has one value of it: "all" trials, those of an "object" (as where it is not here), each
        "trial", or trials with the same value of a property or an input, by its name.
    priors
        Means and standard deviations by parameter.
    bounds
        As they are written, ``K > 0``.
    noise
        By measured quantity the standard deviation that was given, or the property whose values have noise of their
        own.
    """

    shared: Mapping[str, str] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    bounds: tuple[str, ...] = ()
    noise: Mapping[str, float | str] = field(default_factory=dict)

    def prior_std(self, measured: Schema) -> dict[str, float]:
        """Return standard deviations of normal priors of parameters that do not differ between trials of an object."""
        return {
            name: std for name, (_, std) in self.priors.items() if not by_trial(self.shared.get(name, OBJECT), measured)
        }


def by_trial(by: str, schema: Schema) -> bool:
    """Return whether what has one value of a parameter differs between trials of an object."""
    return by == TRIAL or by in schema.inputs
