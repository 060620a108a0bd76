"""From trials to a law: the methods, the estimator, and the function that most people call."""

from commonlaw.discovery.estimator import LawDiscovery, default_method, discover
from commonlaw.discovery.fitting import fit
from commonlaw.discovery.method import AbstractMethod, ModelStructure
from commonlaw.discovery.regression import DerivativeRegression, DiscreteTimeRegression, WeakRegression
from commonlaw.discovery.trajectory_likelihood import TrajectoryLikelihood

__all__ = [
    "AbstractMethod",
    "DerivativeRegression",
    "DiscreteTimeRegression",
    "LawDiscovery",
    "ModelStructure",
    "TrajectoryLikelihood",
    "WeakRegression",
    "default_method",
    "discover",
    "fit",
]
