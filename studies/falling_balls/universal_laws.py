"""Part 12: is gravity universal, does drag follow size and mass, and what does one law of all balls leave?"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.datasets.sphere_drag import AIR_DENSITY, AIR_VISCOSITY, drag_coefficient
from commonlaw.discovery import fit
from commonlaw.discrepancy.function import Discrepancy
from commonlaw.hierarchy import Relation, RelationKind
from commonlaw.law import Law, select_objects
from commonlaw.law.printing import dependence
from commonlaw.plots import plot_relations
from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.inquiry import Inquiry, left_out
from studies.falling_balls.landing import listed
from studies.falling_balls.plots import Curve, plot_curves
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import HORIZON, RATE_SAMPLES, STANDARD_GRAVITY

_NAME, _TITLE = "universal-laws", "Universal laws and discrepancies"

_LAW, _PROPERTIES = "x'' = a + b v abs(v)", ("radius", "mass")
_REYNOLDS, _AREA = f"abs(v)*2*radius/{AIR_VISCOSITY!r}", "v*abs(v)*radius^2/mass"
_UNIT_DRAG = -AIR_DENSITY * np.pi / 2
"""What the discrepancy is for a drag coefficient of one."""

_POINTS = 25
_SURE = 0.95


@dataclass(frozen=True)
class Unseen:
    """Forecasts of a ball from the law of the others, and from the law that knows it, at the horizon.

    Parameters
    ----------
    kinds
        What decides the coefficients of the others.
    errors, own_errors
        Root mean square over both drops, m.
    band
        Half of the widest 95 % band of a measurement, m.
    held
        Share of the later measurements that lie in the bands.
    """

    kinds: str
    errors: float
    own_errors: float
    band: float
    held: float


def universal_laws(inquiry: Inquiry) -> Section:
    """Return the part on what all balls have in common, and what their law leaves unexplained."""
    if inquiry.drops is None:
        return left_out(_NAME, _TITLE, inquiry.missing)
    names = [name for name, attribute in inquiry.drops.properties.items() if {*_PROPERTIES} <= attribute.keys()]
    drops = inquiry.drops.select(object=names)
    law = fit(_LAW, drops, errors="gp-forcing", progress=lambda _: None)
    explained = law.explain(_PROPERTIES)
    found = law.discrepancy(drops, of=_REYNOLDS, times=_AREA, zero_at=None)
    curve, unseen = _curve(found), {name: _unseen(law, drops, name) for name in names}
    blocks = (
        Text(_ASKED.format(count=len(names))),
        Picture("universal-relations", _RELATIONS, partial(plot_relations, explained)),
        Text(_relations_text(explained)),
        Picture("reynolds-discrepancy", _CURVE, partial(plot_curves, {"": _curves(curve)}, *_AXES)),
        Text(_discrepancy_text(found, curve)),
        Table("unseen-balls", _UNSEEN, _frame(unseen), 3),
        Text(_unseen_text(unseen)),
    )
    gravity, drag = _relations(explained)
    results = {
        "universal_laws": {
            "gravity": _numbers(gravity),
            "drag": _numbers(drag),
            "discrepancy": {"evidence": found.evidence, "shares": dict(found.shares), "curve": curve.to_dict("list")},
            "unseen": {name: vars(each) for name, each in unseen.items()},
        }
    }
    return Section(_NAME, _TITLE, blocks, _verdicts(explained, found, unseen), results)


def _relations(law: Law) -> tuple[Relation, Relation]:
    """Return what decides gravity and drag."""
    assert law.uncertainty.explanation is not None
    gravity, drag = law.uncertainty.explanation.relations
    assert gravity is not None
    assert drag is not None
    return gravity, drag


def _numbers(relation: Relation) -> Mapping[str, object]:
    return {
        "kind": str(relation.kind),
        "follows": dependence(relation),
        "factor": relation.factors[0],
        "standard_error": relation.errors[0],
        "scatter": relation.scatter,
        "probability": round(relation.probability, 9),  # Further digits are those of rounding in linear algebra
    }


def _curve(found: Discrepancy[Law]) -> pd.DataFrame:
    """Return how the drag coefficient changes: in the drops, with its band, and by Brown and Lawler."""
    frame = found.to_frame(_POINTS)
    reynolds, shares = frame.iloc[:, 0].to_numpy(), frame["share of samples"]
    change, printed = frame["discrepancy"] / _UNIT_DRAG, drag_coefficient(reynolds)
    return pd.DataFrame(
        {
            "reynolds": reynolds,
            "change": change,
            "low": frame["high"] / _UNIT_DRAG,
            "high": frame["low"] / _UNIT_DRAG,
            "brown_lawler": printed - shares @ (printed - change),
            "samples": shares,
        }
    )


def _curves(curve: pd.DataFrame) -> list[Curve]:
    reynolds = curve["reynolds"]
    return [
        Curve("drops", reynolds, curve["change"], curve["low"], curve["high"]),
        Curve("Brown and Lawler", reynolds, curve["brown_lawler"], line="--"),
    ]


def _unseen(law: Law, drops: Trials, name: str) -> Unseen:
    """Return forecasts of one ball from its first second, by the others' law and by its own."""
    others = select_objects(law, [other for other in law.objects if other != name]).explain(_PROPERTIES)
    own, last = drops.select(object=name), HORIZON - 1
    found, known = (each.predict(own, start=RATE_SAMPLES, return_std=True) for each in (others, law))
    errors = [
        float(np.sqrt(np.mean([(path.states[last, 0] - trial.states[last, 0]) ** 2 for path, trial in pairs])))
        for pairs in (list(zip(each.trajectories, own, strict=True)) for each in (found, known))
    ]
    margins = [each[RATE_SAMPLES:, 0] for each in found.margins(measured=True)]
    off = [abs(p.states - t.states)[RATE_SAMPLES:, 0] for p, t in zip(found.trajectories, own, strict=True)]
    held = np.concatenate([a <= b for a, b in zip(off, margins, strict=True)]).mean()
    kinds = " and ".join(" of ".join(filter(None, (str(r.kind), dependence(r)))) for r in _relations(others))
    return Unseen(kinds, errors[0], errors[1], float(max(map(np.max, margins))), float(held))


def _frame(unseen: Mapping[str, Unseen]) -> pd.DataFrame:
    rows = [
        {
            "ball": name,
            "gravity and drag of the others": each.kinds,
            "error by the others (m)": each.errors,
            "error by its own law (m)": each.own_errors,
            "half of the widest band (m)": each.band,
            "held by bands": each.held,
        }
        for name, each in unseen.items()
    ]
    return pd.DataFrame(rows)


def _relations_text(law: Law) -> str:
    gravity, drag = _relations(law)
    off = abs(gravity.factors[0] + STANDARD_GRAVITY) / gravity.errors[0]
    sure = "is" if gravity.probability >= _SURE else "is rather"
    return (
        f"Gravity {sure} {gravity.kind} (probability {gravity.probability:.2f}): {_value(gravity)} m/s². That is "
        f"{off:.1f} standard errors from −{STANDARD_GRAVITY}. What is wrong by as much for every ball is not the "
        "balls': the scale of heights in the film would do that, or the moment of release; these data do not say. "
        f"Drag {_decided(drag)} (probability {drag.probability:.2f}); with one coefficient for all spheres it would "
        "follow radius²/mass."
    )


def _decided(relation: Relation) -> str:
    if dependence(relation):
        return f"follows {dependence(relation)}"
    return "is each ball's own" if relation.kind is RelationKind.OWN else f"is {relation.kind}"


def _discrepancy_text(found: Discrepancy[Law], curve: pd.DataFrame) -> str:
    inside = (curve["low"] <= curve["brown_lawler"]) & (curve["brown_lawler"] <= curve["high"])
    share = float(curve["samples"][inside].sum())
    parts = listed([f"{100 * value:.0f} % {name}" for name, value in found.shares.items()])
    fallen = curve["change"].iloc[0] - curve["change"].iloc[-1]
    direction = "falls" if fallen > 0 else "rises"
    outweighs = "outweighs" if found.shares["trial"] > found.shares["shared discrepancy"] else "is less than"
    return (
        "Beside a constant drag coefficient of each ball, one that changes with the Reynolds number has 2 log B = "
        f"{found.evidence:.1f}. It {direction} by {abs(fallen):.2f} over the visited range; the curve of Brown and "
        f"Lawler lies in its band for {share:.0%} of the samples. But of the squared misfit of the law with quadratic "
        f"drag there are {parts}: what each drop does by itself {outweighs} what all have in common. Low Reynolds "
        "numbers are those of balls just released, when the film is least exact, and the highest are those of the "
        "basketballs alone: what looks like drag may be the film, or the balls, and the drops leave that open."
    )


def _unseen_text(unseen: Mapping[str, Unseen]) -> str:
    others, own = (
        float(np.median([getattr(each, name) for each in unseen.values()])) for name in ("errors", "own_errors")
    )
    held = float(np.mean([each.held for each in unseen.values()]))
    return (
        f"Forecast from its first second by the law of the other balls, a ball is off by {others:.1f} m at sample "
        f"{HORIZON} (median), and by {own:.1f} m by the law that has seen it. The bands hold {held:.0%} of the later "
        f"measurements: they are up to {max(each.band for each in unseen.values()):.0f} m wide to each side, and say "
        "little."
    )


def _verdicts(law: Law, found: Discrepancy[Law], unseen: Mapping[str, Unseen]) -> tuple[Verdict, ...]:
    gravity, drag = _relations(law)
    enough = "enough" if dependence(drag) else "not enough"
    common = (
        f"Gravity is {gravity.kind} by the evidence (probability {gravity.probability:.2f}), at {_value(gravity)} "
        f"m/s²; drag {_decided(drag)} ({drag.probability:.2f}). Radius and mass are {enough} to say how much."
    )
    claim, share = "claimed" if found.claimed else "not claimed", found.shares["trial"]
    left = (
        f"A drag coefficient that changes with the Reynolds number is {claim} (2 log B = {found.evidence:.1f}, "
        f"beside a random walk of each drop); {share:.0%} of the misfit is each drop's own. Unseen balls are forecast "
        f"to {float(np.median([each.errors for each in unseen.values()])):.1f} m by the others."
    )
    return Verdict("beyond the paper", common), Verdict("beyond the paper", left)


def _value(relation: Relation) -> str:
    return f"{relation.factors[0]:.2f} ± {relation.errors[0]:.2f}".replace("-", "−")


_ASKED = """
The question of the paper's title, asked once more: what is universal in these drops, what do the balls' properties
decide, and what does the law leave? The law offered to the {count} balls whose mass is known is gravity and a drag
with a constant coefficient, $\\ddot x = a + b\\,v|v|$. Each coefficient is universal, a power law of radius and mass,
or each ball's own, by evidence. What the law leaves is sought as a change of the drag coefficient with the Reynolds
number, the same for all balls, in the likelihood of the drops; it is orthogonal to a constant coefficient. Then each
ball is forecast by what the others have in common.
"""
_RELATIONS = (
    "Both coefficients of every ball, its own estimates with 95 % intervals, against what decides them. Black: what "
    "the evidence takes."
)
_AXES = ("Reynolds number", "change of the drag coefficient")
_CURVE = (
    "Change of the drag coefficient with the Reynolds number, as all balls share it, with its 95 % band, beside that "
    "of Brown and Lawler for smooth spheres, shifted to the same mean over the samples."
)
_UNSEEN = (
    f"Forecasts of both drops of a ball, started by their first {RATE_SAMPLES} samples, with the coefficients that "
    f"follow from the other balls by radius and mass, or are typical of them: error at sample {HORIZON}, beside that "
    "by the law that was learned from these drops too."
)
