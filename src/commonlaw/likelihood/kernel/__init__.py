"""The compiled kernel: whole fits and linearisations of one object, in one call each.

It does what `commonlaw.likelihood.fitting` and `commonlaw.likelihood.linearization` do, to rounding, for laws whose
terms are programs (`commonlaw.library.program`). Built by ``hatch_build.py`` where there is a C compiler.
"""
