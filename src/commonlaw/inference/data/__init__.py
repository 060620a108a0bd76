"""Preprocessing of trials: noise estimates, smoothing, subsampling."""
