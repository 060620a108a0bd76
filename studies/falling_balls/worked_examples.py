"""Part 11: examples without noise, on which the method works or is seen to lack a term."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.datasets import PRINTED_VISCOSITY
from commonlaw.datasets.sphere_drag import AIR_VISCOSITY
from commonlaw.plots import Figure
from commonlaw.report import Picture, Table, Text
from studies.falling_balls.errata import QUADRATIC
from studies.falling_balls.examples import Example, learned_fall, learned_oscillator
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.plots import plot_curves
from studies.falling_balls.printed import printed_table, prints_as
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import (
    CLOSE,
    EXAMPLE_BALL,
    EXAMPLE_SAMPLES,
    EXAMPLE_THRESHOLDS,
    OSCILLATOR_SAMPLES,
    PRINTED_DAMPING,
)

_OSCILLATOR = "nonlinear oscillator"
_HIGH, _LOW = "Reynolds-drag fall, threshold 0.1", "Reynolds-drag fall, threshold 0.004"
_CORRECTED = {(_LOW, "v", "v^2"): "0.017"}
"""What the errata have for a printed coefficient."""


@dataclass(frozen=True)
class Coefficient:
    """One coefficient as printed, empty text if it is not there, and as found."""

    example: str
    equation: str
    term: str
    printed: str
    found: float

    @property
    def agrees(self) -> bool:
        """Whether it was found to the printed digits."""
        return prints_as(self.found, self.printed)

    @property
    def corrected(self) -> bool:
        """Whether it was found to the digits that the errata have for it."""
        text = _CORRECTED.get((self.example, self.equation, self.term))
        return text is not None and prints_as(self.found, text)


def worked_examples(_: Inquiry) -> Section:
    """Return the part on examples without noise."""
    examples = {_OSCILLATOR: learned_oscillator(), **{name: learned_fall(name) for name in EXAMPLE_THRESHOLDS}}
    rows = _coefficients(examples)
    blocks = (
        Text(_asked()),
        _table(rows),
        Picture("nonlinear-oscillator", _OSCILLATOR_CAPTION, partial(_plot_oscillator, examples[_OSCILLATOR])),
        Picture("learned-falls", _FALLS_CAPTION, partial(_plot_falls, examples)),
        Text(_found(examples, rows)),
    )
    results: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    for row in rows:
        numbers = {"printed": float(row.printed or 0), "found": row.found}
        results.setdefault(row.example, {}).setdefault(row.equation, {})[row.term] = numbers
    verdicts = (_coefficient_verdict(rows), _trajectory_verdict(examples))
    return Section("worked-examples", "Worked examples", blocks, verdicts, {"worked_examples": results})


def _coefficients(examples: Mapping[str, Example]) -> list[Coefficient]:
    """Return every coefficient that was printed or found, in the order of print."""
    printed = {
        (name, equation, term): text.split()[0]
        for name, equation, term, text in printed_table("worked_examples").to_numpy()
    }
    rows = []
    for name, example in examples.items():
        terms, (coefficients,) = example.law.terms.names, example.law.coefficients
        for j, k in np.ndindex(coefficients.shape):
            index = (name, example.law.schema.states[j], terms[k])
            if coefficients[j, k] or index in printed:
                rows.append(Coefficient(*index, printed.get(index, ""), float(coefficients[j, k])))
    return rows


def _coefficient_verdict(rows: Sequence[Coefficient]) -> Verdict:
    agreeing = [row for row in rows if row.agrees]
    text = f"{len(agreeing)} of {len(rows)} coefficients come out to the printed digits"
    if len(agreeing) == len(rows):
        return Verdict("reproduced", f"{text}, with no term more or less.")
    others = [row for row in rows if not row.agrees]
    listed = "; ".join(
        f"{row.example}, {row.term}: {row.printed or 0} printed, {row.found:.4f} found" for row in others
    )
    if all(row.corrected for row in others):
        return Verdict("reproduced with correction", f"{text}. The errata have the others: {listed}.")
    return Verdict("differs", f"{text}; not {listed}.")


def _trajectory_verdict(examples: Mapping[str, Example]) -> Verdict:
    """Check that laws with all terms hold where nothing was learned, and that one without the drag does not."""
    errors = {name: float(example.errors.max()) for name, example in examples.items()}
    whole = [errors[name] for name in (_OSCILLATOR, *list(EXAMPLE_THRESHOLDS)[:2])]
    lacking = errors[_HIGH]
    example = examples[_OSCILLATOR]
    return Verdict(
        "reproduced" if max(whole) < CLOSE < lacking else "differs",
        f"The paper notes the close agreement of the learned oscillator with the true one up to "
        f"$t = {example.times[-1]:g}$: they part by at most {errors[_OSCILLATOR]:.2%} of its size, after learning up "
        f"to $t = {example.times[example.learned_from - 1]:g}$. The falls with all terms in the library agree within "
        f"{max(whole[1:]):.2%}. The fall whose drag was thresholded away is off by {lacking:.0%} of its largest speed.",
    )


def _table(rows: Sequence[Coefficient]) -> Table:
    frame = pd.DataFrame(
        {
            "example": [row.example for row in rows],
            "derivative of": [row.equation for row in rows],
            "term": [row.term for row in rows],
            "printed": [row.printed for row in rows],
            "found": [row.found for row in rows],
            "agrees": [row.agrees for row in rows],
        }
    )
    caption = (
        "Every coefficient of the examples: as the paper prints it, as found, and whether the two agree in the printed "
        "digits."
    )
    return Table("worked-example-coefficients", caption, frame)


def _plot_oscillator(example: Example) -> Figure:
    panels = {"path": ("x", "y"), "x over time": ("t", "x"), "y over time": ("t", "y")}
    return plot_curves(
        {title: example.curves(x, y) for title, (x, y) in panels.items()},
        {title: x for title, (x, _) in panels.items()},
        {title: y for title, (_, y) in panels.items()},
        share_x=False,
        share_y=False,
    )


def _plot_falls(examples: Mapping[str, Example]) -> Figure:
    return plot_curves(
        {name: examples[name].curves("t", "v") for name in EXAMPLE_THRESHOLDS}, "t (s)", "v (m/s)", columns=2
    )


_OSCILLATOR_CAPTION = (
    "The oscillator from (2, 0): the part of its trajectory that was learned from, the part that was not seen, and the "
    "simulation of the learned law from the same start (marks)."
)
_FALLS_CAPTION = (
    "Velocity of falling balls: the part that was learned from, what comes after it, and the simulation of the learned "
    "law from the same start (marks). Third panel: the threshold is too high for any drag. Fourth panel: the same ball "
    "with drag terms in the velocity and its square."
)


def _asked() -> str:
    ball = EXAMPLE_BALL
    learned, simulated = ((samples - 1) / 100 for samples in OSCILLATOR_SAMPLES)
    return f"""
How well does the method do where nothing is in its way? There is no noise in these examples, and all but the last two
have laws that are sums of candidate terms.

- *A nonlinear oscillator*, $\\dot x = -0.1 x^3 + 2 y^3$ and $\\dot y = -2 x^3 - 0.1 y^3$, is measured a hundred times
  in each unit of time up to $t = {learned:g}$. The candidates are all products of $x$ and $y$ up to the fifth degree.
  Then the learned law is simulated up to $t = {simulated:g}$.
- *Falling balls*: {EXAMPLE_SAMPLES[0]} heights, 15 a second, from rest. Centred differences make velocities of them,
  and $\\dot v$ is learned from the candidates $1$, $v$ and $v^2$: without drag, with the linear drag $-0.5 v$, and with
  the drag of a smooth sphere, which depends on the Reynolds number and is no sum of these. That last ball is learned
  with a high and with a low threshold.

The paper does not say which ball the last one is. Its numbers come out with a diameter of {2 * ball["radius"]:g} m and
a mass of {ball["mass"]:g} kg, as of a tennis ball, and with the kinematic viscosity behind its other simulations,
$\\nu = {1e6 * PRINTED_VISCOSITY:.2f} \\times 10^{{-6}}$ m²/s (see the errata; the air of the text has
${1e6 * AIR_VISCOSITY:.2f} \\times 10^{{-6}}$ m²/s).
"""


def _found(examples: Mapping[str, Example], rows: Sequence[Coefficient]) -> str:
    damping = [row.found for row in rows if row.example == _OSCILLATOR and row.term == f"{row.equation}^3"]
    short = [value for value in damping if not prints_as(value, PRINTED_DAMPING)]
    high, low = examples[_HIGH], examples[_LOW]
    (square,) = (row.found for row in rows if row.example == _LOW and row.term == "v^2")
    in_air = learned_fall(_HIGH, AIR_VISCOSITY).law.coefficients[0, 0, 0]
    seen = high.errors[: high.learned_from].max()
    digits = f"the last digit does not agree for {len(short)} of them" if short else "both print so"
    upward = "that pushes a falling ball up, as drag does" if square > 0 else "here it is negative"
    return f"""
In its text the paper gives {_minus(PRINTED_DAMPING)} for the damping of both $x$ and $y$. Found are
{" and ".join(_minus(f"{value:.4f}") for value in damping)}: {digits}.

If a term is missing, the others bend to make up for it. With the high threshold the last ball has no drag, and its
constant is {_minus(f"{high.law.coefficients[0, 0, 0]:.3f}")} m/s² instead of −9.8 m/s², an average over the drop. Even
where it was learned its velocity is off by up to {seen:.0%} of the largest, and after that it goes on without end.
(With the viscosity of the text's air it is {_minus(f"{in_air:.3f}")} m/s².)

With the low threshold the paper prints {QUADRATIC.printed} where {QUADRATIC.found} is found. It calls the positive sign
of this term nonphysical; but {upward}, and this law is within {low.errors.max():.2%} of the true velocity, also where
it did not learn. It would be wrong for a ball that rises.
"""


def _minus(number: str) -> str:
    return number.replace("-", "−")
