"""Coefficients over objects: how alike they are, what that says for a law, and what the objects learn from it."""

from commonlaw.hierarchy.random_effects import RandomEffects, Shrinkage, marginal_deviance, shrink

__all__ = ["RandomEffects", "Shrinkage", "marginal_deviance", "shrink"]
