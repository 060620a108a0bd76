"""Part 2: the drag on a sphere, and where the balls move in it."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.array_types import Floats
from commonlaw.datasets import PRINTED_VISCOSITY
from commonlaw.datasets.sphere_drag import (
    AIR_VISCOSITY,
    MAX_REYNOLDS,
    drag_coefficient,
    in_valid_range,
    reynolds_number,
)
from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.plots import plot_drag_regimes
from studies.falling_balls.printed import printed_table, prints_as
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import PRINTED_COUNTS, PRINTED_SAMPLES
from studies.falling_balls.speeds import speeds

_NAME, _TITLE = "sphere-drag", "Drag on a sphere"
_RATIO = AIR_VISCOSITY / PRINTED_VISCOSITY
_TOLERANCE = 0.01e5
"""Of the printed Reynolds numbers, which have three digits."""

_CAPTION = (
    "Drag coefficient of a smooth sphere against the Reynolds number: solid where the correlation rests on "
    "experiments, dashed beyond. Shades are the regimes of the flow: attached, or separated and steady; separated and "
    "unsteady but laminar; with a chaotic wake; and, after the drag crisis, with a turbulent boundary layer."
)

Numbers = Mapping[str, Sequence[Floats]]
"""By ball the Reynolds numbers of each drop's samples."""

Largest = Mapping[str, Mapping[str, float]]
"""By ball the largest Reynolds number: printed, with the print's viscosity, and with that of the air."""


def drag_regimes(inquiry: Inquiry) -> Section:
    """Return the part on the drag of spheres: its regimes, and the balls' Reynolds numbers, printed and corrected."""
    question = Text(_question())
    drops = inquiry.drops
    if drops is None:
        left_out = Verdict("left out", "the Reynolds numbers of the balls need the measured drops")
        missing = Text(f"The measured drops are missing: {inquiry.missing}")
        return Section(
            _NAME, _TITLE, (question, Picture("drag-regimes", _CAPTION, plot_drag_regimes), missing), (left_out,)
        )
    as_printed, corrected = (_reynolds_numbers(drops, each) for each in (PRINTED_VISCOSITY, AIR_VISCOSITY))
    ranges = {name: (min(each[1] for each in drop), _largest(drop)) for name, drop in corrected.items()}
    printed = printed_table("ball_properties").set_index("object")["max_reynolds_as_printed"]
    largest = {
        name: {"printed": float(printed[name]), "as_printed": _largest(as_printed[name]), "corrected": ranges[name][1]}
        for name in drops.objects
    }
    counts = _count_table(as_printed, corrected)
    blocks = (
        question,
        Picture(
            "drag-regimes",
            f"{_CAPTION} Bars: Reynolds numbers of each ball in its two drops, from the second sample on, with the "
            "viscosity of the air.",
            partial(plot_drag_regimes, ranges),
        ),
        Table(
            "reynolds-numbers",
            "Largest Reynolds number of each ball: as printed; with the viscosity that was behind the print; with that "
            "of the air; and whether the correlation holds there for the latter.",
            _table(largest),
            digits=3,
        ),
        Table(
            "reynolds-counts",
            "Samples of an average drop by the order of magnitude of their Reynolds number.",
            counts,
            digits=3,
        ),
        Text(_found(largest, corrected)),
    )
    return Section(_NAME, _TITLE, blocks, (_verdict(largest), _count_verdict(counts)), {"reynolds": largest})


def _question() -> str:
    factor, power = f"{MAX_REYNOLDS:.0e}".split("e")
    return (
        "Air resists a falling ball with the force $F = \\frac{1}{2} \\rho v^2 A C_D$, with the density of the air "
        "$\\rho$, the speed $v$, the cross-section of the ball $A$, and a drag coefficient $C_D$ that depends on the "
        "Reynolds number $Re = v D / \\nu$ alone, where $D$ is the diameter of the ball and $\\nu$ the kinematic "
        "viscosity of the air. Where $C_D$ falls as $1/Re$, the force is proportional to the speed (linear drag); "
        "where $C_D$ is constant, to its square (quadratic drag). Which of the two do the balls meet?\n\n"
        "The curve is the correlation of Brown and Lawler (2003) for smooth spheres. It rests on experiments with $Re$ "
        f"below ${factor} \\times 10^{{{int(power)}}}$. Above, the drag crisis follows, in which the coefficient drops "
        "to a fraction, and which the correlation does not know. Rough balls meet the crisis earlier: that is what the "
        "dimples of a golf ball are for."
    )


def _reynolds_numbers(drops: Trials, viscosity: float) -> Numbers:
    return {
        name: [
            reynolds_number(speeds(trial), 2 * float(drops.properties[name]["radius"]), viscosity)
            for trial in drops.of_object(name)
        ]
        for name in drops.objects
    }


def _largest(numbers: Sequence[Floats]) -> float:
    return max(float(number.max()) for number in numbers)


def _table(largest: Largest) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "ball": list(largest),
            "printed": [each["printed"] for each in largest.values()],
            f"with {PRINTED_VISCOSITY * 1e5:.3f} × 10⁻⁵ m²/s": [each["as_printed"] for each in largest.values()],
            f"with {AIR_VISCOSITY * 1e5:.3f} × 10⁻⁵ m²/s": [each["corrected"] for each in largest.values()],
            "correlation holds": [bool(in_valid_range(each["corrected"])) for each in largest.values()],
        }
    )


def _count_table(as_printed: Numbers, corrected: Numbers) -> pd.DataFrame:
    """Return how many samples of an average drop have Reynolds numbers of each order of magnitude."""
    lowest = min(PRINTED_COUNTS)
    limits = {f"below 10{_raised(lowest)}": (0.0, 10.0**lowest)}
    limits |= {f"10{_raised(power)}": (10.0**power, 10.0 ** (power + 1)) for power in PRINTED_COUNTS}
    limits |= {"all": (0.0, np.inf)}
    return pd.DataFrame(
        {
            "Reynolds number": list(limits),
            "printed": [None, *PRINTED_COUNTS.values(), PRINTED_SAMPLES],
            "with the print's viscosity": [_mean_count(as_printed, *limit) for limit in limits.values()],
            "with the viscosity of the air": [_mean_count(corrected, *limit) for limit in limits.values()],
        }
    )


def _mean_count(numbers: Numbers, low: float, high: float) -> float:
    drops = [drop for number in numbers.values() for drop in number]
    return float(np.mean([np.count_nonzero((drop >= low) & (drop < high)) for drop in drops]))


def _found(largest: Largest, corrected: Numbers) -> str:
    beyond = {key: sum(not in_valid_range(each[key]) for each in largest.values()) for key in ("printed", "corrected")}
    quadratic = (10.0 ** min(PRINTED_COUNTS), MAX_REYNOLDS)
    coefficients = drag_coefficient(np.geomspace(*quadratic, 100))
    share = _mean_count(corrected, *quadratic) / _mean_count(corrected, 0, np.inf)
    return (
        f"By the printed numbers {beyond['printed']} of {len(largest)} balls leave the range of the correlation; by "
        f"the right ones it is {beyond['corrected']}. The paper's conclusion {'stands' if share > 0.5 else 'falls'}: "
        f"{share:.0%} of all samples lie where the drag coefficient of a smooth sphere hardly changes, "
        f"{coefficients.min():.2f} to {coefficients.max():.2f}, so "
        "that the drag should be quadratic in the speed. Yet the method finds linear drag in them, as later parts show."
    )


def _verdict(largest: Largest) -> Verdict:
    agree = sum(abs(each["as_printed"] - each["printed"]) <= _TOLERANCE for each in largest.values())
    wrong = sum(abs(each["corrected"] - each["printed"]) > _TOLERANCE for each in largest.values())
    low, high = (pick(each["corrected"] for each in largest.values()) for pick in (min, max))
    text = (
        f"{agree} of {len(largest)} printed Reynolds numbers come out to {_TOLERANCE / 1e5:g} × 10⁵ with a kinematic "
        f"viscosity of {PRINTED_VISCOSITY * 1e5:.3f} × 10⁻⁵ m²/s. The air of the text has {AIR_VISCOSITY * 1e5:.3f} × "
        f"10⁻⁵ m²/s: the right numbers are {_RATIO:.2f} times smaller, {low / 1e5:.2f} × 10⁵ to {high / 1e5:.2f} × 10⁵."
    )
    if agree < len(largest):
        return Verdict("differs", text)
    return Verdict("reproduced with correction" if wrong else "reproduced", text)


def _count_verdict(counts: pd.DataFrame) -> Verdict:
    as_printed, corrected = (counts.iloc[1:-1, column].tolist() for column in (2, 3))
    same = all(prints_as(value, text) for value, text in zip(as_printed, PRINTED_COUNTS.values(), strict=True))
    moved = not all(prints_as(value, text) for value, text in zip(corrected, PRINTED_COUNTS.values(), strict=True))
    powers = [f"10{_raised(power)}" for power in PRINTED_COUNTS]
    text = (
        f"An average drop is printed to have about {', '.join(PRINTED_COUNTS.values())} samples with Reynolds numbers "
        f"of the order of {', '.join(powers)}; with the print's viscosity there are "
        f"{', '.join(f'{value:.1f}' for value in as_printed)}, with that of the air "
        f"{', '.join(f'{value:.1f}' for value in corrected)}."
    )
    if not same:
        return Verdict("differs", text)
    return Verdict("reproduced with correction" if moved else "reproduced", text)


def _raised(power: int) -> str:
    return str(power).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
