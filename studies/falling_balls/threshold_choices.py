"""Part 10, continued: what would have chosen the threshold."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import pandas as pd

from commonlaw.law import Law
from commonlaw.plots import plot_path
from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.method import METHODS
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import CHOICES, GROUP_THRESHOLD, PATH_BALL, PATH_DROP, SINGLE_THRESHOLD

METHOD_NAMES = {"single": f"{PATH_BALL}, single trial", "group": "all balls, group"}
_THRESHOLDS = {"single": SINGLE_THRESHOLD, "group": GROUP_THRESHOLD}

Choices = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""What was chosen, by method and rule."""


def threshold_choices(drops: Trials, paths: Mapping[str, pd.DataFrame]) -> Section:
    """Return blocks, a verdict and results for the part on the thresholds.

    Parameters
    ----------
    drops
        The measured drops.
    paths
        The paths of the drop of the printed tables by method, as `Law.path` gives them.
    """
    trials = {"single": drops.select(object=PATH_BALL), "group": drops}
    laws = {kind: {rule: chosen_law(kind, trial, rule) for rule in CHOICES} for kind, trial in trials.items()}
    choices = {kind: {rule: _choice(law) for rule, law in by_rule.items()} for kind, by_rule in laws.items()}
    pictures = [
        Picture(
            f"threshold-path-{kind}",
            _PATHS[kind],
            partial(plot_path, laws[kind]["held-out"], marks={f"the paper's, {threshold:g}": threshold}),
        )
        for kind, threshold in _THRESHOLDS.items()
    ]
    return Section(
        "threshold-choices",
        "What would have chosen the threshold",
        (
            Text(_judged(drops)),
            *pictures,
            Table("rules-for-thresholds", _CHOICES, _choice_table(choices)),
            Text(_found(choices, paths)),
        ),
        (_cross_validation(choices),),
        {"choices": choices},
    )


def chosen_law(kind: str, trials: Trials, rule: str) -> Law:
    """Return the law that a rule chooses from all thresholds of a method."""
    return METHODS[kind](trials, None, rule=rule, n_resamples=0)


def _interval_at(path: pd.DataFrame, threshold: float) -> "pd.Series[Any]":
    """Return the row of a path that holds at a threshold."""
    return path[(path["from"] <= threshold) & (threshold < path["to"])].iloc[0]


def _choice(law: Law) -> dict[str, Any]:
    """Return what a law was chosen for, and the intervals of thresholds that give it."""
    path = law.provenance.path()
    rows = path[path["chosen"]]
    return {
        "terms": rows["terms"].iloc[0].split(", "),
        "size": int(rows["size"].iloc[0]),
        "thresholds": rows[["from", "to"]].to_numpy().tolist(),
        "held_out_error": float(rows["held-out error"].iloc[0]),
        "standard_error": float(rows["standard error"].iloc[0]),
    }


def _includes(choice: Mapping[str, Any], threshold: float) -> bool:
    return any(low <= threshold < high for low, high in choice["thresholds"])


def _choice_table(choices: Choices) -> pd.DataFrame:
    rows = []
    for kind, by_rule in choices.items():
        for rule, choice in by_rule.items():
            rows.append(
                {
                    "method": METHOD_NAMES[kind],
                    "rule": CHOICES[rule],
                    "terms": ", ".join(choice["terms"]),
                    "number": choice["size"],
                    "held-out error": choice["held_out_error"],
                    "standard error": choice["standard_error"],
                    "thresholds": "; ".join(f"{low:.3g} to {high:.3g}" for low, high in choice["thresholds"]),
                    "the paper's among them": _includes(choice, _THRESHOLDS[kind]),
                }
            )
    return pd.DataFrame(rows)


def _cross_validation(choices: Choices) -> Verdict:
    """Compare the advice that held-out data choose an appropriate threshold with what they choose."""
    group, single = (choices[kind]["held-out"] for kind in ("group", "single"))
    holds = _includes(group, GROUP_THRESHOLD)
    text = (
        "The appendix advises to choose the threshold by cross-validation. Held-out drops choose the terms "
        f"{_listed(group)} for the group, {'the same' if holds else 'not the same'} as the paper's threshold "
        f"{GROUP_THRESHOLD:g}. For the {PATH_BALL.lower()} by itself they choose {_listed(single)}"
    )
    spurious = ", with the height among them: only the balls together are rid of it."
    needs_group = "x" in single["terms"] and "x" not in group["terms"]
    return Verdict("reproduced" if holds else "differs", text + (spurious if needs_group else "."))


def _listed(choice: Mapping[str, Any]) -> str:
    return ", ".join(f"${term}$" for term in choice["terms"])


_PATHS = {
    "single": (
        f"{PATH_BALL} by itself, both drops: number of terms and error on the held-out drop at every threshold. The "
        "error is the mean squared error of the acceleration, relative to its mean square. Shaded: the thresholds "
        "whose equation has the least error. Dashed: the threshold in the paper."
    ),
    "group": (
        "All balls, both drops, group method: number of terms and error on the held-out drops at every threshold. The "
        "error is the mean over balls of the mean squared error of the acceleration, relative to its mean square. "
        "Shaded: the thresholds whose equation has the least error. Dashed: the threshold in the paper."
    ),
}
_CHOICES = (
    "What rules would have chosen from all thresholds, learning from both drops. The held-out error is relative to the "
    "mean square of the acceleration: 0.01 is an error of a tenth of it."
)


def _judged(drops: Trials) -> str:
    return f"""
Which threshold is right? The paper advises cross-validation, and does not do it. Here both drops of a ball are learned
from, {len(drops)} drops of {len(drops.objects)} balls in all. Each equation on the path is judged by cross-validation
over the drops: its coefficients are fitted to one drop of each ball and tested on the accelerations of the other drop,
and the other way round. Only the list of terms comes from both drops. As these paths learn from two drops, they turn at
other thresholds than the tables, which learn from one.
"""


def _found(choices: Choices, paths: Mapping[str, pd.DataFrame]) -> str:
    group, single = choices["group"], choices["single"]
    above = {kind: value / _interval_at(paths[kind], value)["from"] for kind, value in _THRESHOLDS.items()}
    low, high = group["held-out"]["thresholds"][0]
    return f"""
For the group the held-out drop chooses {_listed(group["held-out"])}, at every threshold from
{low:.2g} to {high:.2g}. Criteria judge by the data that were fitted: the AIC chooses {_listed(group["aic"])}, the BIC
{_listed(group["bic"])}. The {PATH_BALL.lower()} by itself gets {_listed(single["held-out"])} by the least error, and
{_listed(single["one-standard-error"])} if an equation of fewer terms is preferred wherever its error is within one
standard error.

The paper says that its thresholds are slightly larger than those at which the number of terms jumps. On drop
{PATH_DROP}, the group's {GROUP_THRESHOLD:g} is {above["group"]:.2g} times the threshold below which a further term
enters; for the {PATH_BALL.lower()} by itself, {SINGLE_THRESHOLD:g} is {above["single"]:.2g} times that.
"""
