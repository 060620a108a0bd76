"""Constants inside of terms that two laws have in common, by the same name."""

from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.library.parametric import free_name

if TYPE_CHECKING:
    from commonlaw.law.law import Law


def with_constants_of(other: "Law", law: "Law") -> "Law":
    """Return another law in which a constant has the name that it has in a law, where it is inside of the same terms.

    Others have names that the law has not: what has a name in both is the same in both.
    """
    same = defaultdict[frozenset[tuple[int, str]], list[str]](list)
    for name in law.terms.variables.constants:
        same[_places(law, name)].append(name)
    variables, names = other.terms.variables, list[str]()
    for each in variables.constants:
        known = same[_places(other, each)]
        taken = (*law.terms.variables.names, *variables.measured, *names)
        names.append(known.pop(0) if known else free_name(each, taken))
    return replace(other, terms=replace(other.terms, variables=replace(variables, constants=tuple(names))))


def _places(law: "Law", name: str) -> frozenset[tuple[int, str]]:
    """Return in which equations' terms a constant is, these with a sign in place of it and of others."""
    variables, column = law.terms.variables, law.terms.variables.index(name)
    signs = [*variables.measured, *("?" if each == name else "#" for each in variables.constants)]
    pairs = np.argwhere(law.support & law.terms.is_factor).tolist()
    return frozenset((j, law.terms.terms[k].text(signs)) for j, k in pairs if column in law.terms.terms[k].columns())
