"""Terms with constants inside along curves, at many values of these."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.inference.fit.parameter_values import divisors, values_to_try
from commonlaw.library import Constant, ParametricTerm, Terms, Variables
from commonlaw.library.grammar import NUMPY, compiled

_HARDLY, _LEAST = 0.2, 1e-3
"""Shares of the size of a variable: how far below zero it may be by noise, and what is taken instead."""

_PROBES, _DIGITS = 7, 9
"""Points at which columns that are alike to so many digits are the same."""


@dataclass(frozen=True, eq=False)
class Banks:
    """Terms along curves at the values of their constants in a bank of each, one column for each.

    Parameters
    ----------
    others
        The terms.
    values
        Of the variables without constants, along the curves, shape (n, variables).
    constants
        The values in each bank, shape (values, constants).
    columns
        All terms at all values, one bank behind the other, shape (n, columns).
    repeated
        Which terms are along these curves what one before is that has no more constants, shape (terms,): s/(e + |s|)
        is s/(K + s) where s is positive.
    """

    others: tuple[ParametricTerm, ...]
    values: Floats
    constants: tuple[Floats, ...]
    columns: Floats
    repeated: Bools

    @classmethod
    def along(
        cls,
        variables: Variables,
        values: Floats,
        others: Sequence[ParametricTerm],
        sampled: Bools | slice = slice(None),
    ) -> "Banks":
        """Return terms along curves at values of their constants at which they are finite and no others' repeats.

        Periodic functions may be as fast as the points that were sampled resolve, by default all.
        """
        values, constants, columns = _above_zero(values), [], [np.empty((len(values), 0))]
        before, repeated = dict[bytes, int](), list[bool]()
        for each in others:
            bank = _bank(each, variables, values, sampled)
            own = along(each, values, bank)
            count, usable = len(each.constants), _usable(own)
            constants.append(bank[list(usable.values())])
            columns.append(own[:, list(usable.values())])
            repeated.append(bool(usable) and all(before.get(shown, count + 1) <= count for shown in usable))
            before |= {shown: min(count, before.get(shown, count)) for shown in usable}
        return cls(
            tuple(others), values, tuple(constants), np.concatenate(columns, axis=1), np.array(repeated, dtype=bool)
        )

    @cached_property
    def firsts(self) -> Indices:
        """The first column of each bank, and the number of columns."""
        return np.cumsum([0, *map(len, self.constants)])


def along(other: ParametricTerm, values: Floats, bank: Floats) -> Floats:
    """Return a term along curves at each of some values of its constants, shape (n, values)."""
    count = len(values)
    repeated = np.column_stack([np.tile(values, (len(bank), 1)), np.repeat(bank, count, axis=0)])
    return np.asarray(other.term.evaluate(repeated).reshape(len(bank), count).T)


def _bank(other: ParametricTerm, variables: Variables, values: Floats, sampled: Bools | slice) -> Floats:
    """Return values of the constants of a term that are tried, without a pole along the curves or between points."""
    first = len(variables.measured)
    columns = range(first, first + len(other.constants))
    terms = Terms(replace(variables, constants=other.constants), (other.term, *map(Constant, columns)))
    bank = values_to_try(terms, values[sampled], columns) if other.constants else np.empty((1, 0))
    every = [*values.T[:, :, np.newaxis], *bank.T[:, np.newaxis, :]]
    whole = np.ones(len(bank), dtype=bool)
    for code in divisors(terms, 0):
        with np.errstate(all="ignore"):
            whole &= np.ptp(np.sign(compiled(code)(every, NUMPY)) + np.zeros((len(values), len(bank))), axis=0) == 0
    return np.asarray(bank[whole])


def _usable(columns: Floats) -> dict[bytes, int]:
    """Return the indices of columns that are finite, not zero, and no multiple of one before, by values at points."""
    with np.errstate(all="ignore"):
        sizes = np.sqrt(np.mean(columns**2, axis=0))
    good = np.flatnonzero(np.isfinite(sizes) & (sizes > 0))
    probes = np.linspace(0, len(columns) - 1, _PROBES).round().astype(int)
    shown = columns[np.ix_(probes, good)] / sizes[good]
    largest = np.take_along_axis(shown, np.abs(shown).argmax(axis=0, keepdims=True), axis=0)
    shown = (shown * np.where(largest < 0, -1.0, 1.0)).round(_DIGITS) + 0.0  # Of zeros both signs are one
    found = dict[bytes, int]()
    for index, own in zip(good.tolist(), shown.T, strict=True):
        found.setdefault(own.tobytes(), index)
    return found


def _above_zero(values: Floats) -> Floats:
    """Return values of variables, of which those are kept above zero that are hardly below it: noise, most likely.

    So that roots and logarithms exist.
    """
    sizes = np.sqrt(np.mean(values**2, axis=0))
    hardly = values.min(axis=0) > -_HARDLY * sizes
    return np.where(hardly & (values < _LEAST * sizes), _LEAST * sizes, values)
