"""Part 6: simulated drops whose drag depends on the Reynolds number, as that of real spheres does."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from commonlaw import datasets
from commonlaw.array_types import Bools
from commonlaw.datasets import PRINTED_VISCOSITY
from commonlaw.datasets.sphere_drag import AIR_VISCOSITY
from commonlaw.discovery import DerivativeRegression, discover
from commonlaw.law import Law
from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.errata import THRESHOLDS
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import (
    AVERAGE_DIGITS,
    EXTREME,
    FINDING,
    FINDING_DIFFERENTIATION,
    FINDING_LIBRARY,
    FINDING_NOISES,
    NOISES,
    PRINTED_THRESHOLDS,
    REYNOLDS_AVERAGES,
    RUN_THRESHOLDS,
    SEED,
    VARIANTS,
)
from studies.falling_balls.simulation import (
    agrees,
    averages_table,
    by_noise,
    captures,
    equation,
    heat_maps,
    learned,
    mean_coefficients,
    simulated,
)
from studies.falling_balls.tennis_ball import real_balls, tennis_ball_falls

Laws = Mapping[str, Mapping[float, Law]]


def reynolds_drag(inquiry: Inquiry) -> Section:
    """Learn laws of simulated drops with Reynolds-dependent drag, and of variants of that experiment."""
    clean = _drops()
    drops = simulated(clean, NOISES, inquiry.seed)
    run, printed = learned(drops, RUN_THRESHOLDS), learned(drops, PRINTED_THRESHOLDS)
    known = simulated(clean, NOISES, SEED)
    averages = _averages(learned(known, RUN_THRESHOLDS))
    in_air = _averages(learned(simulated(_drops(viscosity=AIR_VISCOSITY), NOISES, SEED), RUN_THRESHOLDS))
    kept = {noise: "x" in terms for noise, terms in _averages(learned(known, PRINTED_THRESHOLDS)).items()}
    variants = {name: learned(simulated(_drops(**options), NOISES, inquiry.seed), RUN_THRESHOLDS)
                for name, options in VARIANTS.items()}  # fmt: skip
    other = {name: _other_method(_drops(**options), inquiry.seed) for name, options in VARIANTS.items()}
    falls = tennis_ball_falls()
    blocks = (
        Text(_ASKED),
        *falls,
        Picture(
            "reynolds-drag-heat-maps",
            f"Terms learned from simulated drops with Reynolds-dependent drag (seed {inquiry.seed}) at the thresholds "
            "that the paper prints, and at those that its program ran with: magnitude of each term's coefficient "
            "(columns) for each ball (rows), at rising noise from left to right.",
            partial(heat_maps, {**_titled(printed, PRINTED_THRESHOLDS), **_titled(run, RUN_THRESHOLDS)}),
        ),
        averages_table(
            "reynolds-drag-averages",
            f"Coefficients of the group model (threshold {RUN_THRESHOLDS['group']:g}), averaged over the five balls, "
            f"for the noise of the authors' program (seed {SEED}): what their program gave, and what came out here.",
            averages,
            REYNOLDS_AVERAGES,
        ),
        Text(_viscosity(averages, in_air)),
        Table(
            "reynolds-drag-variants",
            "What the group method learns from other experiments, without noise and averaged over the balls; in how "
            f"many of {len(NOISES)} laws (one for each noise) $v^2$ is among its terms, and in how many equations of "
            "the single-trial method. *Captured* counts the equations of both methods that have $v^2$ with the right "
            f"sign, and beside it no terms but 1 and $v$. The last column is what the method of the part before learns "
            f"at a noise of {FINDING_NOISES[0]:g} m.",
            _variants_frame(variants, other),
            digits=3,
        ),
        Text(_elsewhere(other)),
    )
    results = {
        "reynolds_drag_averages": {
            "printed viscosity": by_noise(averages),
            "viscosity of air": by_noise(in_air),
            "x kept at the printed threshold": by_noise(kept),
        },
        "reynolds_drag_variants": {
            name: {"group": by_noise(_averages(laws)), "other method": mean_coefficients(other[name])}
            for name, laws in variants.items()
        },
    }
    verdicts = (_averages_verdict(averages, kept), _quadratic_verdict(variants))
    return Section("reynolds-drag", "Simulated drops with Reynolds-dependent drag", blocks, verdicts, results)


def _drops(**options: Any) -> Trials:
    """Return one drop of each ball without noise."""
    return datasets.reynolds_drag(**{"viscosity": PRINTED_VISCOSITY, **real_balls(), **options}, noise=0.0, trials=1)


def _averages(laws: Laws) -> dict[float, dict[str, float]]:
    return {noise: mean_coefficients(law) for noise, law in laws["group"].items()}


def _titled(laws: Laws, thresholds: Mapping[str, float]) -> dict[str, Mapping[float, Law]]:
    return {f"{method}, {thresholds[method]:g}": row for method, row in laws.items()}


def _other_method(clean: Trials, seed: int) -> Law:
    """Return what the method learns that finds a squared velocity where there is one."""
    (drops,) = simulated(clean, FINDING_NOISES[:1], seed).values()
    return discover(
        drops,
        order=2,
        library=FINDING_LIBRARY,
        method=DerivativeRegression(differentiation=FINDING_DIFFERENTIATION, **FINDING),
    )


def _variants_frame(variants: Mapping[str, Laws], other: Mapping[str, Law]) -> pd.DataFrame:
    rows = [
        {
            "experiment": name,
            "group, no noise": equation(laws["group"][NOISES[0]]),
            "group: laws with v²": sum(_squared(law).any() for law in laws["group"].values()),
            "single: equations with v²": int(sum(_squared(law).sum() for law in laws["single"].values())),
            "captured": int(sum(captures(law).sum() for row in laws.values() for law in row.values())),
            "other method": equation(other[name]),
        }
        for name, laws in variants.items()
    ]
    return pd.DataFrame(rows)


def _squared(law: Law) -> Bools:
    """Return which objects have v^2."""
    return np.asarray(law.coefficients[:, 0, law.terms.index("v^2")] != 0)


def _viscosity(averages: Mapping[float, Mapping[str, float]], in_air: Mapping[float, Mapping[str, float]]) -> str:
    pairs = [(averages[noise], in_air[noise]) for noise in NOISES]
    same = all(own.keys() == others.keys() for own, others in pairs)
    largest = max(abs(own[term] / others[term] - 1) for own, others in pairs for term in own if term in others)
    return (
        f"The program's air had a kinematic viscosity of {PRINTED_VISCOSITY * 1e5:.3f} × 10⁻⁵ m²/s; that of the "
        f"text has {AIR_VISCOSITY * 1e5:.3f} × 10⁻⁵ m²/s. With the latter the group method learns "
        f"{'the same terms at every' if same else 'other terms at some'} noise, and no average of a shared term "
        f"changes by more than {largest:.1%}: at these speeds the drag hardly depends on the viscosity."
    )


def _elsewhere(other: Mapping[str, Law]) -> str:
    names = [name for name, law in other.items() if "v^2" in mean_coefficients(law)]
    first = equation(other[next(iter(VARIANTS))])
    return (
        "That $v^2$ is not found is not the data's doing. The method of the part before, with its shorter window, "
        "terms of the velocity only and a criterion for the choice, has $v^2$ in "
        f"{len(names)} of these {len(other)} experiments. From the drops of the paper, with a noise of "
        f"{FINDING_NOISES[0]:g} m, it learns {first}."
    )


def _averages_verdict(averages: Mapping[float, Mapping[str, float]], kept: Mapping[float, bool]) -> Verdict:
    own, program = PRINTED_THRESHOLDS["group"], RUN_THRESHOLDS["group"]
    if not agrees(averages, REYNOLDS_AVERAGES, units=1.0):
        return Verdict("differs", "The averages of the group models are not those of the authors' program.")
    if not all(kept.values()):
        return Verdict("reproduced", "The averages of the group models come out as in the authors' program.")
    return Verdict(
        "reproduced with correction",
        f"The group models of all {len(NOISES)} noise levels come out as in the authors' program, their averages to "
        f"one unit of the {AVERAGE_DIGITS}th decimal. {THRESHOLDS.where}: it prints {THRESHOLDS.printed}. "
        f"With {own:g} the group method keeps $x$ at each of the {len(kept)} noise levels, against the text; with "
        f"{program:g} it does what the text says.",
    )


def _quadratic_verdict(variants: Mapping[str, Laws]) -> Verdict:
    laws = {name: [law for row in variant.values() for law in row.values()] for name, variant in variants.items()}
    caught = {name: int(sum(captures(law).sum() for law in each)) for name, each in laws.items()}
    usual = [law for name, each in laws.items() if name != EXTREME for law in each]
    having, equations = sum(int(_squared(law).sum()) for law in usual), sum(len(law.objects) for law in usual)
    found = sum(count for name, count in caught.items() if name != EXTREME)
    return Verdict(
        "differs" if found else "reproduced",
        '"Neither version of SINDy identifies a $v^2$ term", also with more samples and in denser fluids: of '
        f"{equations} equations, from {len(variants) - 1} experiments at {len(NOISES)} noise levels, {found} have "
        f"$v^2$ with the right sign and without terms that are not there; {having} have it at all. "
        f"({EXTREME.capitalize()}: {caught[EXTREME]} of {sum(len(law.objects) for law in laws[EXTREME])}.)",
    )


_ASKED = """
The drag of a real sphere is not linear in its velocity. It is $\\frac{1}{2} \\rho A C_D v^2$, with a drag coefficient
$C_D$ that falls with the Reynolds number at first and then is nearly constant, so that the drag goes over from linear
to quadratic. The paper simulated five balls, of the sizes and masses of five that were dropped, with such a drag (the
correlation of Brown and Lawler), and asked what the two methods make of it. No law in the library is exactly right
here; one with a term in $v^2$ is nearly so.
"""
