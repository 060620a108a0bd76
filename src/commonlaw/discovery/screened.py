"""What is sought among the terms that a screening has kept of many."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.inference import Fit, missed_terms, promising_terms
from commonlaw.law import Step
from commonlaw.library import SelectedLibrary, Terms
from commonlaw.text import counted
from commonlaw.trials import Trials


@dataclass(frozen=True, eq=False)
class Screened:
    """What is sought among the terms that a screening has kept of many, shape (terms,); all if they are not many."""

    whole: ModelStructure
    terms: Terms
    kept: Bools

    @classmethod
    def of(cls, trials: Trials, structure: ModelStructure) -> "Screened":
        """Return what is sought in trials, of many terms those that explain most."""
        terms, schema = structure.terms(trials.schema), trials.schema
        known = structure.known_coefficients(schema, trials.objects)
        needed = (structure.universal_coefficients(schema) | ~np.isnan(known).any(axis=0)).any(axis=0)
        return cls(structure, terms, promising_terms(trials, terms, known, np.asarray(needed)))

    @cached_property
    def structure(self) -> ModelStructure:
        """The same question with the plain terms that were kept."""
        if self.kept.all() and not self.whole.library.parametric(self.terms.variables):
            return self.whole
        names = tuple(self.terms.names[i] for i in np.flatnonzero(self.kept))
        return replace(self.whole, library=SelectedLibrary(self.whole.library, names))

    @property
    def steps(self) -> tuple[Step, ...]:
        """What is said of it."""
        if self.kept.all():
            return ()
        why = "terms that explain most of the smoothed rates; none of the others improves the law"
        return (Step("screening", f"{int(self.kept.sum())} of {counted(len(self.terms), 'term')}", why),)

    def among(self, fit: Fit) -> "Screened":
        """Return the same with the terms among which a law was chosen."""
        return replace(self, kept=np.isin(self.terms.names, fit.problem.terms.names))

    def with_missed(self, fit: Fit) -> "Screened | None":
        """Return the same with terms that were left out and improve a law; None if there are none."""
        missed = missed_terms(fit, self.terms)
        return replace(self, kept=self.kept | missed) if missed.any() else None
