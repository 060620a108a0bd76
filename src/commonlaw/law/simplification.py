"""A law in its simplest form, as it is shown: what was replaced, and whether the measurements bear it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from commonlaw.array_types import Floats
from commonlaw.law.text import coefficient_table, estimate_cells, with_error
from commonlaw.law.uncertainty import OneSidedLimit
from commonlaw.trials import Trials

if TYPE_CHECKING:
    from commonlaw.law.law import Law


class Replacement(NamedTuple):
    """Replacement of a number of a law, by its name in `Law.structure`.

    The estimate is its mean over objects, with its standard error; `off` are standard errors between both.
    """

    parameter: str
    estimate: float
    error: float
    form: str
    off: float

    def __str__(self) -> str:
        number = with_error(self.estimate, self.error)
        return f"{self.parameter} = {number} by {self.form}, {self.off:.1f} standard errors off"


@dataclass(frozen=True, eq=False)
class Simplification:
    """Simplest form of a law, from `Law.simplify`: equations, replacements and their chi-square test.

    Parameters
    ----------
    equations
        Shortest form of each equation, with parameters for the remaining numbers.
    replaced
        The replaced numbers.
    chi_square, degrees_of_freedom
        Of all replacements of all objects together: the squared distance of the estimates from the nearest that obey
        them, in units of their covariance.
    objects, parameters
        Of the law, and for the numbers that remain.
    values, errors
        Estimates of the parameters, given the replacements, and standard errors, shape (objects, parameters).
    limits
        Of parameters that have a limit on one side only; nothing replaces these.
    """

    equations: tuple[str, ...]
    replaced: tuple[Replacement, ...]
    chi_square: float
    degrees_of_freedom: int
    objects: tuple[str, ...]
    parameters: tuple[str, ...]
    values: Floats
    errors: Floats
    limits: tuple[OneSidedLimit, ...] = ()

    @property
    def p_value(self) -> float:
        """P-value of the chi-square test of all replacements."""
        return p_value(self.chi_square, self.degrees_of_freedom)

    def fit(self, trials: Trials, **settings: Any) -> "Law":
        """Return this form fitted to trials, see `commonlaw.fit`; refused if no parameter remains."""
        from commonlaw.discovery import fit

        return fit(self.equations, trials, **settings)

    def __str__(self) -> str:
        lines = [f"replaced: {replacement}" for replacement in self.replaced] or ["nothing could be replaced"]
        if self.replaced:
            freedom = f"{self.degrees_of_freedom} degree{'s' if self.degrees_of_freedom > 1 else ''} of freedom"
            lines += [f"together: chi-square {self.chi_square:.3g} with {freedom}, p = {self.p_value:.2g}"]
        cells, places = estimate_cells(self.values, self.errors), {name: i for i, name in enumerate(self.objects)}
        for limit in self.limits:
            if limit.parameter in self.parameters and places[limit.object] < len(cells):
                cells[places[limit.object]][self.parameters.index(limit.parameter)] = limit.text
        table = coefficient_table(self.objects, self.parameters, cells) if self.parameters else []
        return "\n".join([*self.equations, "", *lines, *([""] if table else []), *table])


def p_value(chi_square: float, degrees_of_freedom: int) -> float:
    """Return the probability of a chi-square at least so large."""
    from scipy.special import chdtrc

    return float(chdtrc(degrees_of_freedom, chi_square)) if degrees_of_freedom else 1.0
