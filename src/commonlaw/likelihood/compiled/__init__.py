"""Whole fits and linearisations of one object by the compiled kernel, in one call each.

They do what `commonlaw.likelihood.fitting` and `commonlaw.likelihood.linearization` do, to rounding, for laws whose
terms are programs (`commonlaw.library.program`).
"""
