"""The scheme of a law: the only place that asks for it."""

from collections.abc import Collection, Sequence

from commonlaw.forecast.collocation import Collocation
from commonlaw.forecast.scheme import AbstractScheme
from commonlaw.forecast.shooting import Shooting
from commonlaw.law import Law


def scheme_of(
    law: Law, properties: Sequence[str], input_interpolation: str | None = None, chosen: Collection[str] = ()
) -> AbstractScheme:
    """Return the scheme of a law for objects with these properties, in trials that choose the start of some states."""
    if law.scheme == "collocation":
        return Collocation(law)
    return Shooting.of(law, properties, input_interpolation, chosen)
