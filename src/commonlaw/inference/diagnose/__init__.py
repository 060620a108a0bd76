"""Diagnostics of data and fits: confounded variables, origins of scales, between-trial heterogeneity."""
