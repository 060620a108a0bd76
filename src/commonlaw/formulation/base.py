"""What every formulation is, and the variables of a law over trials of some schema."""

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, groupby

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation.least_squares_problem import BLOCK, LeastSquaresProblem, merge
from commonlaw.library import Order, Terms, Variables, with_rates
from commonlaw.trials import Schema, Trial


def law_variables(schema: Schema, order: Order) -> Variables:
    """Return the variables of a law: states, the rates of those of order 2, inputs, time.

    Rates have the names of their columns if they were measured, else ``v`` or ``v_x``, and ``x_rate`` where that is
    taken.
    """
    second = with_rates(order, len(schema.states))
    if not len(second):
        return Variables(schema.states, schema.inputs, schema.time, schema.logarithmic)
    taken, plain = {*schema.states, *schema.inputs, schema.time}, plain_rates(schema)
    rates = [f"{schema.states[j]}_rate" if plain[j] in taken else plain[j] for j in second]
    orders = order if isinstance(order, tuple) else ()
    return Variables((*schema.states, *rates), schema.inputs, schema.time, orders=orders)


def plain_rates(schema: Schema) -> tuple[str, ...]:
    """Return the names of the rates of states: of their columns if they were measured, or the usual ones."""
    usual = ["v"] if len(schema.states) == 1 else [f"v_{state}" for state in schema.states]
    return tuple(schema.rates.get(state, name) for state, name in zip(schema.states, usual, strict=True))


def check_order(order: int) -> None:
    """Refuse an order of an equation that is neither 1 nor 2."""
    if order not in (1, 2):
        raise CommonlawError("order-one-or-two", order=order)


Segment = tuple[int, Floats, Floats]
"""The first sample of a segment of a trial, and there the values of the variables and the targets, a row a sample."""


class AbstractFormulation(ABC):
    """From the samples of a trial to rows of terms and targets, and to the problems that these compress to."""

    @abstractmethod
    def rows(self, trial: Trial, terms: Terms) -> tuple[Floats, Floats]:
        """Return the library rows, shape (n, terms), and the target rows, shape (n, equations), of one trial.

        Raises `CommonlawError` if the trial is too short or a term is not finite on it.
        """

    @abstractmethod
    def problems(self, trial: Trial, terms: Terms, segments: int = 1) -> list[LeastSquaresProblem]:
        """Return the compressed rows of a trial in so many segments of equal length, in order of time."""

    def problem(self, trials: Sequence[Trial], terms: Terms) -> LeastSquaresProblem:
        """Return the rows of several trials, compressed together."""
        return merge(of_trial for trial in trials for of_trial in self.problems(trial, terms))


class AbstractSampledForm(AbstractFormulation):
    """A formulation whose rows are the terms at single samples; a trial that is too short for one is refused."""

    @abstractmethod
    def segments(self, trial: Trial, cuts: list[int]) -> Iterator[Segment]:
        """Yield the rows of a trial in segments of which none goes across a cut (a number of samples)."""

    @abstractmethod
    def span(self, trial: Trial) -> tuple[int, int]:
        """Return the first sample that makes a row, and the one behind the last."""

    def samples(self, trial: Trial) -> tuple[Floats, Floats]:
        """Return the variables' values, shape (n, variables), and the targets, shape (n, states)."""
        _, values, targets = zip(*self.segments(trial, []), strict=True)
        return _below(values), _below(targets)

    @property
    def takes_missing(self) -> bool:
        """Whether states may be missing (NaN) in a trial."""
        return False

    def rows(self, trial: Trial, terms: Terms) -> tuple[Floats, Floats]:
        self._check(trial, terms)
        values, targets = self.samples(trial)
        library = terms.evaluate(values)
        terms.check_finite(library, values, trial.label, self.span(trial)[0])
        return library, targets

    def problems(self, trial: Trial, terms: Terms, segments: int = 1) -> list[LeastSquaresProblem]:
        """Return the compressed rows as `AbstractFormulation` does, of which a few thousand are held at a time."""
        self._check(trial, terms)
        first, last = self.span(trial)
        cuts = [first + (last - first) * i // segments for i in range(1, segments)]
        width = len(terms) + trial.states.shape[1]
        by_cut = groupby(self.segments(trial, cuts), key=lambda segment: bisect_right(cuts, segment[0]))
        result = [LeastSquaresProblem.of_blocks(_blocks(parts, terms, width), len(terms), width) for _, parts in by_cut]
        if not all(np.isfinite(problem.factor).all() for problem in result):
            self.rows(trial, terms)  # Its message names the term and the sample
            raise CommonlawError("rate-not-finite", where=trial.label)
        return result

    def problem(self, trials: Sequence[Trial], terms: Terms) -> LeastSquaresProblem:
        """Return the rows of several trials, of which blocks are filled together, as `AbstractFormulation` does."""
        for trial in trials:
            self._check(trial, terms)
        width = len(terms) + trials[0].states.shape[1]
        segments = chain.from_iterable(self.segments(trial, []) for trial in trials)
        result = LeastSquaresProblem.of_blocks(_blocks(segments, terms, width), len(terms), width)
        if not np.isfinite(result.factor).all():
            return super().problem(trials, terms)  # Its message names the trial
        return result

    def _check(self, trial: Trial, terms: Terms) -> None:
        """Refuse a trial with missing states where all are needed."""
        if not (self.takes_missing or trial.complete):
            missing = np.argwhere(np.isnan(trial.states))
            sample, state = missing[0]
            raise CommonlawError(
                "state-missing",
                where=trial.label,
                state=terms.variables.states[state],
                sample=sample + 1,
                missing=len(missing),
            )


def _blocks(segments: Iterable[Segment], terms: Terms, width: int) -> Iterator[Floats]:
    """Yield rows ``[library | targets]`` in blocks that stay in cache; each is overwritten by the next."""
    block = np.empty((BLOCK, width), order="F")
    for values, targets in _together(segments):
        for i in range(0, len(values), BLOCK):
            some = values[i : i + BLOCK]
            rows = block[: len(some)]
            terms.evaluate(some, rows[:, : len(terms)])
            rows[:, len(terms) :] = targets[i : i + BLOCK]
            yield rows


def _together(segments: Iterable[Segment]) -> Iterator[tuple[Floats, Floats]]:
    """Yield values and targets of segments, those of several short ones together, as far as they fit into a block."""
    held, size = list[tuple[Floats, Floats]](), 0
    for _, values, targets in segments:
        if held and size + len(values) > BLOCK:
            yield _joined(held)
            held, size = [], 0
        held.append((values, targets))
        size += len(values)
    if held:
        yield _joined(held)


def _joined(held: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    if len(held) == 1:
        return held[0]
    values, targets = zip(*held, strict=True)
    return _below(values), _below(targets)


def _below(parts: Sequence[Floats]) -> Floats:
    """Return rows below each other, in Fortran order: long columns go several times faster than rows."""
    return np.concatenate([part.T for part in parts], axis=1).T
