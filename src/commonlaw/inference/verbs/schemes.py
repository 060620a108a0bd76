"""The fit of a law by its scheme: the only place of the fitting verbs that asks for it."""

from commonlaw.inference.verbs.collocation import CollocationFit
from commonlaw.inference.verbs.scheme import AbstractFit
from commonlaw.inference.verbs.shooting import ShootingFit
from commonlaw.law import Law


def fit_of(law: Law) -> AbstractFit:
    """Return how a law is fitted."""
    return CollocationFit(law) if law.scheme == "collocation" else ShootingFit(law)
