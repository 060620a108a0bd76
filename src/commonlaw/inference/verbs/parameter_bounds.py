"""Bounds of the parameters of a law that is fitted by collocation, which does not keep to them."""

from collections.abc import Iterator, Sequence

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.law.parameters import named_parameters
from commonlaw.law.text import with_error
from commonlaw.library.bounds import NEAR_BOUND, Bound


def is_within(law: Law, bounds: Sequence[Bound]) -> bool:
    return next(_outside(law, bounds), None) is None


def is_near(law: Law, bounds: Sequence[Bound]) -> bool:
    """Return whether a parameter inside a term is within a few standard errors of a bound.

    There the likelihood is no parabola, and a mesh may not resolve the solution, as of x/(K + x) with a small K.
    """
    parameters, near = named_parameters(law), False
    for bound in (bound for bound in bounds if bound.name in law.terms.variables.parameters):
        index = parameters.names.index(bound.name)
        values, errors = parameters.values[:, index], np.nan_to_num(parameters.errors[:, index])
        near |= bool(np.any(np.minimum(values - bound.low, bound.high - values) < NEAR_BOUND * errors))
    return near


def refuse_outside(law: Law, bounds: Sequence[Bound], without: Sequence[str] = ()) -> None:
    """Refuse a law with parameters outside of their bounds, where shooting would hold them `without` these settings."""
    instead = f"; without {', '.join(without)} it is held there, by shooting" if without else ""
    for where, bound, value in _outside(law, bounds):
        raise CommonlawError(
            "estimate-out-of-bounds", name=where, parameter=bound.name, value=value, bound=bound.text, instead=instead
        )


def _outside(law: Law, bounds: Sequence[Bound]) -> Iterator[tuple[str, Bound, str]]:
    """Yield the objects whose parameters are outside of their bounds, with the bound and the estimate."""
    parameters = named_parameters(law)
    for bound in bounds:
        index = parameters.names.index(bound.name)
        for owner, value, error in zip(
            law.objects, parameters.values[:, index], parameters.errors[:, index], strict=True
        ):
            if not bound.holds(value):
                yield owner, bound, with_error(value, float(np.nan_to_num(error)))
