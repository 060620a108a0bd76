"""What drives a law of second order, and nobody measured: functions of time whose constants are found.

They are the solutions of the equations that such a drive would have as a state, and so need none.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference.fit.state import fit_neighbours, is_settled
from commonlaw.inference.search.law_search import LawSearch
from commonlaw.law import Step
from commonlaw.library import ParametricTerm, Terms, TiedTerms, Variables, parse_term
from commonlaw.library.parametric import parametric_term, terms_of_family
from commonlaw.outcomes import Outcome

UNMEASURED_STATE = "unmeasured state"
"""Of the history of a law: what was chosen of a state that nobody measured."""


def drives(variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
    """Return what a law of second order may be driven by that nobody measured: functions of time.

    They are the solutions of u' = -r u and of u'' = -w^2 u.
    """
    t = variables.time
    return (parametric_term(f"exp(-r*{t})", variables), *terms_of_family("periodic", variables, (t,)))


def with_drive_said(found: LawSearch, offered: Sequence[ParametricTerm | TiedTerms]) -> LawSearch:
    """Return a law of second order, without terms that it is better without, and with a word on what drives it.

    Parameters
    ----------
    found
        The law of largest evidence among those with drives, and without.
    offered
        Those drives, see `drives`.
    """
    found = _without_needless_terms(found)
    terms = found.template.terms
    chosen = found.state.supports.any(axis=0) & terms.is_factor
    named = [terms.names[k] for k in np.flatnonzero(chosen) if _is_one_of(terms, int(k), offered)]
    without = min((each.state.score for each in found.rivals if each.solver is not None), default=None)
    more = np.inf if without is None else without - found.state.score
    why = f"latent forcing; without it -2 log evidence is {more:.3g} more"
    step = Step(UNMEASURED_STATE, ", ".join(named) or "none", why)
    if not named:
        step = Step(UNMEASURED_STATE, "none", "no drive that nobody measured has a larger evidence")
    return with_provenance(found, (step,), ())


def _is_one_of(terms: Terms, index: int, offered: Sequence[ParametricTerm | TiedTerms]) -> bool:
    """Return whether a term with constants is one of those that were offered, whatever its constants are called."""
    first = len(terms.variables.measured)
    columns = sorted(column for column in terms.terms[index].columns() if column >= first)
    names = [terms.variables.names[column] for column in columns]
    written = terms.terms[index].expression(terms.variables.names)
    return any(
        len(names) == len(each.constants)
        and parse_term(each.expression(terms.variables, names), terms.variables) == parse_term(written, terms.variables)
        for several in offered
        for each in several.parts
    )


def _without_needless_terms(found: LawSearch) -> LawSearch:
    """Return a law with constants inside of terms without plain terms that its evidence is larger without."""
    problem, terms = found.problem, found.template.terms
    plain = terms.is_factor & ~np.array(terms.have_constants, dtype=bool)
    while found.solver is None:
        state, fewer = found.state, list[Bools]()
        for j, k in np.argwhere(state.supports & plain).tolist():
            fewer.append(state.supports.copy())
            fewer[-1][j, k] = False
        listed = [each for each in fit_neighbours(problem, state, fewer) if is_settled(problem, each)]
        best = min(listed, key=lambda each: each.score, default=state)
        if not best.score < state.score:
            break
        found = replace(found, state=best, found=(best,))
    return found


def with_provenance(found: LawSearch, history: tuple[Step, ...], outcomes: tuple[Outcome, ...]) -> LawSearch:
    """Return a search with what is to be said of its law."""
    made = replace(found.template.provenance, history=history, outcomes=outcomes)
    return replace(found, template=replace(found.template, provenance=made))
