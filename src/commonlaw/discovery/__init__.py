"""From trials to a law: the estimator, and the function that most people call."""

from commonlaw.discovery.estimator import FORMULATIONS, LawDiscovery, discover

__all__ = ["FORMULATIONS", "LawDiscovery", "discover"]
