"""The terms of a law whose equations have given sets of terms, with constants of their own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.propose.integral_ranking import Start, TermSet
from commonlaw.library import Constant, Terms, parse_term
from commonlaw.library.parametric import free_name


@dataclass(frozen=True, eq=False)
class TermsOfSets:
    """The terms of a law, and where those of each equation, and the constants of its others, are among them.

    Known coefficients have the shape (objects, equations, terms), NaN where they are to be found.
    """

    terms: Terms
    known: Floats
    places: tuple[tuple[int, ...], ...]
    constants: tuple[tuple[tuple[int, ...], ...], ...]

    def indices_of(self, equation: int, row: TermSet, k: int) -> list[int]:
        """Return the indices of a term of an equation, by its place in the equation's set, and of its constants."""
        inside = self.constants[equation][k - len(row.plain)] if k >= len(row.plain) else ()
        return [*(self.places[equation][place] for place in row.places_of(k)), *inside]

    def coefficients(self, starts: Sequence[Start]) -> Floats:
        """Return what a fit begins with, shape (objects, equations, terms), from the starts of each equation."""
        found = np.nan_to_num(self.known)
        for j, start in enumerate(starts):
            found[:, j, list(self.places[j])] = start.coefficients
            for indices, own in zip(self.constants[j], start.constants, strict=True):
                found[:, j, list(indices)] = own
        return found


def terms_of_sets(problem: SearchProblem, rows: Sequence[TermSet]) -> TermsOfSets:
    """Return the terms of a law whose equations have these."""
    whole = problem.models[0].terms
    variables, certain = whole.variables, np.nan_to_num(problem.known)
    plain = sorted({i for row in rows for i in row.plain} | {*np.flatnonzero(certain.any(axis=(0, 1))).tolist()})
    names, written = list[str](), list[list[tuple[list[str], list[str]]]]()
    for row in rows:
        written.append([])
        for other in row.others:
            new = list[str]()
            for each in other.constants:
                new.append(free_name(each, (*variables.measured, *names, *new)))
            names += new
            written[-1].append((other.expressions(variables, new), new))
    variables = replace(variables, constants=tuple(names))
    texts = list(
        dict.fromkeys(text for own in written for listed, _ in own for text in listed)
    )  # Equations share those without constants
    texts = [*(whole.terms[i].expression(whole.variables.names) for i in plain), *texts]
    constants = (Constant(variables.index(name)) for name in names)
    terms = Terms(variables, (*(parse_term(each, variables) for each in texts), *constants))
    known = np.zeros((*certain.shape[:2], len(terms)))
    known[:, :, : len(plain)] = certain[:, :, plain]
    places, inside = [], []
    for j, (row, own) in enumerate(zip(rows, written, strict=True)):
        places.append(
            (*(plain.index(i) for i in row.plain), *(texts.index(text) for listed, _ in own for text in listed))
        )
        inside.append(tuple(tuple(len(texts) + names.index(each) for each in new) for _, new in own))
        known[:, j, [*places[-1], *(i for each in inside[-1] for i in each)]] = np.nan
    return TermsOfSets(terms, known, tuple(places), tuple(inside))
