"""What drives a law of second order, and nobody measured: functions of time whose constants are found.

They are the solutions of the equations that such a drive would have as a state, and so need none.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Step
from commonlaw.library import ParametricTerm, Terms, TiedTerms, Variables, parse_term
from commonlaw.library.parametric import parametric_term, terms_of_family

UNMEASURED_STATE = "unmeasured state"
"""Of the history of a law: what was chosen of a state that nobody measured."""


def drives(variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
    """Return what a law of second order may be driven by that nobody measured: functions of time.

    They are the solutions of u' = -r u and of u'' = -w^2 u.
    """
    t = variables.time
    return (parametric_term(f"exp(-r*{t})", variables), *terms_of_family("periodic", variables, (t,)))


def with_drive_said(pool: Pool, offered: Sequence[ParametricTerm | TiedTerms]) -> Pool:
    """Return laws of second order, the best without terms that it is better without, and with a word on what drives it.

    Parameters
    ----------
    pool
        The law of largest evidence among those with drives, and without.
    offered
        Those drives, see `drives`.
    """
    fit = _without_needless_terms(pool.best)
    terms = fit.problem.terms
    chosen = fit.supports.any(axis=0) & terms.is_factor
    named = [terms.names[k] for k in np.flatnonzero(chosen) if _is_one_of(terms, int(k), offered)]
    without = min((each.score for each in pool.rivals if each.problem.solver is not None), default=None)
    more = np.inf if without is None else without - fit.score
    why = f"latent forcing; without it -2 log evidence is {more:.3g} more"
    step = Step(UNMEASURED_STATE, ", ".join(named) or "none", why)
    if not named:
        step = Step(UNMEASURED_STATE, "none", "no drive that nobody measured has a larger evidence")
    return pool.with_best(replace(fit, steps=(step,)))


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


def _without_needless_terms(fit: Fit) -> Fit:
    """Return a law with constants inside of terms without plain terms that its evidence is larger without."""
    terms = fit.problem.terms
    plain = terms.is_factor & ~np.array(terms.have_constants, dtype=bool)
    while fit.problem.solver is None:
        fewer = list[Bools]()
        for j, k in np.argwhere(fit.supports & plain).tolist():
            fewer.append(fit.supports.copy())
            fewer[-1][j, k] = False
        refitted = (fit.refitted(each) for each in fewer)
        converged = [each for each in refitted if each.is_usable and each.has_converged]
        best = min(converged, key=lambda each: each.score, default=fit)
        if not best.score < fit.score:
            break
        fit = best
    return fit
