"""The function that a law lacks, with its errors."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.discrepancy.smooth_basis import SmoothBasis
from commonlaw.errors import CommonlawError
from commonlaw.inference.settings import STRONG
from commonlaw.law.quantiles import two_sided
from commonlaw.law.text import with_error
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.trials.trial import as_numbers

if TYPE_CHECKING:
    import pandas as pd


LawType = TypeVar("LawType")


class Description(NamedTuple):
    """Terms that fit as well as the smooth function, with standard errors, and 2 log B for them against it."""

    terms: tuple[str, ...]
    coefficients: tuple[float, ...]
    errors: tuple[float, ...]
    evidence: float


class Compared(NamedTuple):
    """A coordinate, the equation that a function of it stands in, and 2 log B for it relative to the law alone."""

    coordinate: str
    equation: str
    evidence: float


@dataclass(frozen=True, eq=False)
class Discrepancy(ShownInNotebooks, Generic[LawType]):
    """A smooth function in one equation of a law, shared by all objects; it prints as sentences.

    Called with values of the coordinate it gives the function there.

    Parameters
    ----------
    law
        With coefficients fitted together with the function; ``law.predict(trials, discrepancy=True)`` uses both.
    equation
        Left-hand side of the equation that the function is in.
    basis, weights, covariance
        Of the function: a `SmoothBasis`, weights of shape (functions,), their covariance.
    zero_at
        Where the function is held at zero, if anywhere.
    holds_nothing_of
        Terms of the law to which the function is orthogonal over the samples.
    visited
        The coordinate at all samples.
    evidence
        2 log B for the function relative to the law alone.
    shares
        Of the squared misfit: coefficients, the function, each trial's own departures, noise.
    descriptions, compared
        Terms that fit as well, and the coordinates that were compared, the largest evidence first.
    """

    law: LawType
    equation: str
    basis: SmoothBasis
    weights: Floats
    covariance: Floats
    zero_at: float | None
    holds_nothing_of: tuple[str, ...]
    visited: Floats
    evidence: float
    shares: Mapping[str, float]
    descriptions: tuple[Description, ...]
    compared: tuple[Compared, ...]

    @property
    def claimed(self) -> bool:
        """Whether there is a discrepancy, by strong evidence."""
        return self.evidence > STRONG

    def __call__(self, coordinate: ArrayLike) -> Floats:
        """Return the function at values of the coordinate, in their shape; a `CommonlawError` if one is not finite."""
        values = self._finite(coordinate)
        return np.asarray((self.basis.values(values.ravel()) @ self.weights).reshape(values.shape))

    def std(self, coordinate: ArrayLike) -> Floats:
        """Return the standard deviation of the function at values of the coordinate, in their shape."""
        values = self._finite(coordinate)
        functions = self.basis.values(values.ravel())
        variances = np.sum((functions @ self.covariance) * functions, axis=1)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)).reshape(values.shape))

    def _finite(self, coordinate: ArrayLike) -> Floats:
        values = as_numbers(coordinate)
        if not np.isfinite(values).all():
            wrong, basis = values[~np.isfinite(values)].flat[0], self.basis
            raise CommonlawError(
                "discrepancy-outside", coordinate=basis.coordinate, value=wrong, low=basis.low, high=basis.high
            )
        return values

    def to_frame(self, points: int = 41, level: float = 0.95) -> "pd.DataFrame":
        """Return a table over the visited range: coordinate, function, both ends of its band, share of the samples."""
        import pandas as pd

        edges = np.linspace(self.basis.low, self.basis.high, points + 1)
        middles = (edges[:-1] + edges[1:]) / 2
        counts, half = np.histogram(self.visited, edges)[0], two_sided(level) * self.std(middles)
        function = self(middles)
        columns = {
            self.basis.coordinate: middles,
            "discrepancy": function,
            "low": function - half,
            "high": function + half,
            "share of samples": counts / len(self.visited),
        }
        return pd.DataFrame(columns)

    def terms_frame(self) -> "pd.DataFrame":
        """Return a table of terms in place of the function, with 2 log B for each relative to the law alone."""
        import pandas as pd

        rows = []
        for description in self.descriptions:
            triples = zip(description.coefficients, description.errors, description.terms, strict=True)
            written = " + ".join(f"{with_error(value, error, bracket=True)} {term}" for value, error, term in triples)
            rows.append({"terms": written.replace("+ -", "- "), "2 log B": description.evidence + self.evidence})
        return pd.DataFrame(rows)

    def coordinates_frame(self) -> "pd.DataFrame":
        """Return a table of the coordinates that were compared, with 2 log B for each relative to the law alone."""
        import pandas as pd

        return pd.DataFrame(self.compared, columns=["coordinate", "equation", "2 log B"])

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found in words, what matters most first."""
        return tuple(self._sentences())

    def __repr__(self) -> str:
        return f"<Discrepancy of {self.equation}, a function of {self.basis.coordinate}: 2 log B = {self.evidence:.1f}>"

    def __str__(self) -> str:
        return "\n".join(self.sentences)

    def _sentences(self) -> Iterator[str]:
        named = f"f({self.basis.coordinate})"
        added = named if self.basis.times == "1" else f"{self.basis.times} {named}"
        how = "Discrepancy" if self.claimed else "No strong evidence for a discrepancy"
        yield f"{how}: {self.equation} = law + {added}, 2 log B = {self.evidence:.1f} relative to the law alone."
        yield f"2 log B: positive favours a discrepancy; above {STRONG:g} is strong (Kass and Raftery 1995)."
        low, high = self.basis.low, self.basis.high
        digits = 3 + max(0, int(np.log10(max(abs(low), abs(high)) / (high - low))))  # Those that tell the ends apart
        span = f"{self.basis.coordinate} from {low:.{digits}g} to {high:.{digits}g}"
        parts = ", ".join(f"{100 * share:z.0f} % {name}" for name, share in self.shares.items())
        yield f"Range of the data: {span}. Squared residuals of the law: {parts}."
        if self.zero_at is not None:
            yield f"f = 0 where {self.basis.coordinate} = {self.zero_at:g}."
        if self.holds_nothing_of:
            yield f"f is orthogonal to {', '.join(self.holds_nothing_of)} over the range of the data."
