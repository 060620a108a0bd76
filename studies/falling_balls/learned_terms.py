"""Part 4: which terms each ball has by itself, and which the balls agree on."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from commonlaw.law import Law
from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.inquiry import Inquiry, left_out
from studies.falling_balls.method import coefficients_of, group_law, single_law
from studies.falling_balls.plots import plot_heat_maps
from studies.falling_balls.printed import printed_table
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import GROUP_THRESHOLD, SINGLE_THRESHOLD, WHIFFLE_BALLS

_NAME, _TITLE = "learned-terms", "Learned terms"
_DROPS = ("1", "2")

Laws = Mapping[str, Law]
"""By drop."""

Models = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Coefficients by drop, ball and term."""

Counts = Mapping[str, Mapping[str, int]]
"""By drop, and over "both", by what is counted."""


def learned_terms(inquiry: Inquiry) -> Section:
    """Return the part on the terms that are learned from each drop."""
    drops = inquiry.drops
    if drops is None:
        return left_out(_NAME, _TITLE, inquiry.missing)
    laws = _laws(drops)
    single, group = (_models(law) for law in laws.values())
    counts = {"single trial": _counts(single), "group": _counts(group)}
    panels = {f"{kind}, drop {drop}": law for kind, by_drop in laws.items() for drop, law in by_drop.items()}
    return Section(
        _NAME,
        _TITLE,
        (
            Text(_asked(drops)),
            Picture("learned-magnitudes", _HEAT_MAPS, partial(plot_heat_maps, panels, 2, row_titles=tuple(laws))),
            Table("learned-term-counts", _COUNTS, _count_table(counts)),
            Table("learned-models", _GROUP_MODELS, _group_table(laws["group"], group)),
            Table("single-trial-models", _SINGLE_MODELS, _single_trial_table(laws["single trial"], single)),
            Text(_found(drops, counts, laws["group"])),
        ),
        (
            _printed_models(group),
            _most_carry_height(counts["single trial"]),
            _all_carry_height(single, counts["single trial"]),
        ),
        {"group_models": group, "single_models": single, "single_model_counts": counts["single trial"]},
    )


def _laws(drops: Trials, **others: Any) -> dict[str, Laws]:
    """Return the laws of both drops by method."""
    parts = {drop: drops.select(trial=drop) for drop in _DROPS}
    return {
        "single trial": {drop: single_law(part, SINGLE_THRESHOLD, **others) for drop, part in parts.items()},
        "group": {drop: group_law(part, GROUP_THRESHOLD, **others) for drop, part in parts.items()},
    }


def _models(laws: Laws) -> Models:
    return {drop: {ball: coefficients_of(law, ball) for ball in law.objects} for drop, law in laws.items()}


def _has(model: Mapping[str, float], variable: str) -> bool:
    return any(variable in term for term in model)


def _counts(models: Models) -> dict[str, dict[str, int]]:
    """Count the models with a term of the height, with none of the speed, with a constant only, and all terms."""
    listed = {drop: list(by_ball.values()) for drop, by_ball in models.items()}
    listed["both"] = [model for drop in models for model in listed[drop]]
    return {
        drop: {
            "models": len(own),
            "terms": sum(map(len, own)),
            "with_height": sum(_has(model, "x") for model in own),
            "without_speed": sum(not _has(model, "v") for model in own),
            "constant_only": sum(list(model) == ["1"] for model in own),
        }
        for drop, own in listed.items()
    }


def _printed() -> dict[tuple[str, str], dict[str, str]]:
    """Return the printed coefficients by ball and drop, and by term."""
    table = printed_table("learned_models")
    names = table.columns[2:].tolist()
    return {(ball, drop): dict(zip(names, texts, strict=True)) for ball, drop, *texts in table.to_numpy().tolist()}


def _agreeing(found: Mapping[str, float], printed: Mapping[str, str]) -> int:
    """Count the coefficients that come out to the decimals printed."""
    return sum(f"{found.get(term, 0.0):.2f}" == text for term, text in printed.items())


def _group_table(laws: Laws, models: Models) -> pd.DataFrame:
    rows = [
        {
            "ball": ball,
            "drop": drop,
            "printed": f"x'' = {printed['1']} {printed['v'][0].replace('0', '+')} {printed['v'].lstrip('-')} v",
            "found": laws[drop].equations(ball)[0],
            "agrees": _agreeing(models[drop][ball], printed) == len(printed) == len(models[drop][ball]),
        }
        for (ball, drop), printed in _printed().items()
    ]
    return pd.DataFrame(rows)


def _single_trial_table(laws: Laws, models: Models) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "ball": ball,
            "drop": drop,
            "found": laws[drop].equations(ball)[0],
            "term of the height": _has(models[drop][ball], "x"),
            "term of the speed": _has(models[drop][ball], "v"),
        }
        for ball in models["1"]
        for drop in models
    )


def _count_table(counts: Mapping[str, Counts]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "method": kind,
            "drop": drop,
            "models": own["models"],
            "terms in all": own["terms"],
            "models with a term of the height": own["with_height"],
            "models without a term of the speed": own["without_speed"],
            "models with a constant only": own["constant_only"],
        }
        for kind, by_drop in counts.items()
        for drop, own in by_drop.items()
    )


def _printed_models(group: Models) -> Verdict:
    """Compare the group models with the printed ones."""
    printed = _printed()
    count = sum(map(len, printed.values()))
    agree = sum(_agreeing(group[drop][ball], texts) for (ball, drop), texts in printed.items())
    others = sorted({", ".join(model) for by_ball in group.values() for model in by_ball.values()} - {"1, v"})
    terms = (
        f"Some have the terms {'; '.join(others)}" if others else "All have a constant and the speed, and nothing else"
    )
    text = f"{agree} of the {count} coefficients of the {len(printed)} group models come out to the decimals printed."
    return Verdict("reproduced" if agree == count and not others else "differs", f"{text} {terms}.")


def _most_carry_height(counts: Counts) -> Verdict:
    """Compare the results' text: most models have a height term, two are constant."""
    both = counts["both"]
    holds = both["with_height"] > both["models"] / 2 and both["constant_only"] == 2
    text = (
        "The results say that most single-trial models have an extraneous height term, and that two have a constant "
        f"acceleration only: {_share(counts, 'with_height')} have a height term, {_share(counts, 'constant_only')} "
        "a constant only."
    )
    return Verdict("reproduced" if holds else "differs", text)


def _all_carry_height(single: Models, counts: Counts) -> Verdict:
    """Compare the conclusions: all models have a height term, and lighter balls further ones."""
    further = [
        f"{ball} (drop {drop})"
        for drop, by_ball in single.items()
        for ball, model in by_ball.items()
        if model.keys() - {"1", "x", "v"}
    ]
    text = (
        'The conclusions say "all models including a spurious height-dependent force and lower-density balls resulting '
        f'in additional spurious terms": {_share(counts, "with_height")} have a height term. Terms besides the '
        f"constant, $x$ and $v$ are in the models of {', '.join(further) or 'no ball'}."
    )
    return Verdict("reproduced" if counts["both"]["with_height"] == counts["both"]["models"] else "differs", text)


def _share(counts: Counts, what: str) -> str:
    """Return a count over both drops, and each drop's."""
    each = ", ".join(f"{counts[drop][what]} of {counts[drop]['models']} in drop {drop}" for drop in _DROPS)
    return f"{counts['both'][what]} of {counts['both']['models']} ({each})"


_COUNTS = (
    "How many terms the models of the ten balls have, and how many models have a term too many or too few: no force on "
    "a falling ball depends on its height, and the drag of the air grows with its speed."
)
_HEAT_MAPS = (
    "Magnitudes of the coefficients of the ten candidate terms, on one logarithmic scale; a light grey cell is a term "
    f"that is not in the ball's equation. Above, each ball by itself (threshold {SINGLE_THRESHOLD:g}); below, all "
    f"balls together (threshold {GROUP_THRESHOLD:g}). At the left, the first drop; at the right, the second."
)
_GROUP_MODELS = (
    "The twenty models of the group method as printed and as found. They agree if both coefficients are the same to "
    "the two decimals that were printed. Heights are in metres, times in seconds."
)
_SINGLE_MODELS = "The twenty models of the single-trial method, which the paper shows as colours only."


def _asked(drops: Trials) -> str:
    return f"""
Each of the two drops of {len(drops.objects)} balls is learned from by itself, in two ways. The *single-trial* method
takes each ball alone: it drops a term whose coefficient is below {SINGLE_THRESHOLD:g}, fits the rest again, and so on.
The *group* method adds up the magnitudes of a term's coefficients over all balls, and drops the term for all of them if
that sum is below {GROUP_THRESHOLD:g}. Which of the ten terms survive?

A choice of the authors' program has to be known to get their numbers: the single-trial method evaluates the candidate
terms on the smoothed heights, the group method on the heights as measured. The same is done here.
"""


def _found(drops: Trials, counts: Mapping[str, Counts], group: Laws) -> str:
    terms = {kind: by_drop["both"]["terms"] for kind, by_drop in counts.items()}
    drag = {(ball, drop): model.get("v", 0.0) for drop, own in _models(group).items() for ball, model in own.items()}
    whiffle = [abs(value) for (ball, _), value in drag.items() if ball in WHIFFLE_BALLS]
    other = [abs(value) for (ball, _), value in drag.items() if ball not in WHIFFLE_BALLS]
    wrong = [f"{ball} (drop {drop})" for (ball, drop), value in drag.items() if value > 0]
    smoothed = _laws(drops, library_states="smoothed")["group"]
    measured = _laws(drops, library_states="measured")["single trial"]
    same = all(np.allclose(smoothed[drop].coefficients, law.coefficients, 1e-10, 0) for drop, law in group.items())
    return f"""
The single-trial models have {terms["single trial"]} terms in all, the group models {terms["group"]}. In the group
models the whiffle balls, light and full of holes, have coefficients of $v$ from {min(whiffle):.2f} to
{max(whiffle):.2f} per second in size, all other balls up to {max(other):.2f}. The sign is wrong, a force that pushes a
falling ball on, for {", ".join(wrong)}: their drag is too small to be told from the errors of the measurement.

Smoothed instead of measured heights in the candidate terms make {"no" if same else "a"} difference to these group
models, of which {counts["group"]["both"]["with_height"]} have a term of the height. With measured heights,
{_counts(_models(measured))["both"]["with_height"]} single-trial models have such a term instead of
{counts["single trial"]["both"]["with_height"]}.
"""
