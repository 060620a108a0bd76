"""Part 8, first half: which drag the default method chooses for groups of balls, and what the evidence says."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from commonlaw.discovery import discover
from commonlaw.law import Law
from commonlaw.report import Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.landing import listed
from studies.falling_balls.report import Section
from studies.falling_balls.settings import ALL_BALLS, BALL_GROUPS, DRAG_FORMS, EVIDENCE_WORDS, OFFERED


@dataclass(frozen=True, eq=False)
class Choice:
    """What the default method chooses for a group of balls: the law, with the list of what it was chosen from."""

    law: Law

    @cached_property
    def form(self) -> str:
        """The form of drag that was chosen."""
        return form_of(self.law)

    @cached_property
    def listed(self) -> dict[str, Mapping[str, float | None]]:
        """What the law's list says of each form of drag, the largest evidence first."""
        measures = {alternative.terms: alternative.measures for alternative in self.law.provenance.alternatives}
        found = {form: measures[terms] for form, terms in DRAG_FORMS.items() if terms in measures}
        return dict(sorted(found.items(), key=lambda each: _number(each[1]["2 log B"])))

    @cached_property
    def against(self) -> dict[str, float]:
        """Twice the log Bayes factor of the best form against each, from the best, which has 0, to the worst."""
        values = {form: _number(measures["2 log B"]) for form, measures in self.listed.items()}
        least = min(values.values())
        return {form: value - least for form, value in values.items()}

    @property
    def noise(self) -> float:
        """Of the heights (m)."""
        return float("nan") if self.law.uncertainty.noise is None else float(self.law.uncertainty.noise[0])

    @property
    def errors(self) -> str:
        """What beside white noise explains the heights, in the words of the law's history."""
        steps = {step.stage: step.choice for step in self.law.provenance.history}
        memory = steps.get("errors with a memory")
        return steps["model error"] if memory is None else f"an error of the heights with a memory, {memory}"


def _number(measure: float | None) -> float:
    return float("nan") if measure is None else float(measure)


def drag_choices(drops: Trials) -> tuple[Section, Mapping[str, Choice]]:
    """Return blocks and results for the part on the default method, and the choices by group of balls."""
    choices = {group: Choice(_discovered(drops.select(object=balls))) for group, balls in BALL_GROUPS.items()}
    blocks = (
        Text(_ASKED),
        Table("default-choices", _CHOICES, _choices_frame(choices), 3),
        Text(_found(choices)),
        Table("default-evidence", _EVIDENCE, _evidence_frame(choices), 3),
        Text(_meant(choices[ALL_BALLS].law)),
    )
    results = {group: _results(choice) for group, choice in choices.items()}
    return Section("drag-choices", "Which drag", blocks, (), results), choices


def form_of(law: Law) -> str:
    """Return the name of a law's form of drag, or its terms if it has none of the names."""
    terms = tuple(law.terms.names[k] for k in np.flatnonzero(law.support[0]))
    return next((form for form, own in DRAG_FORMS.items() if own == terms), ", ".join(terms) or "no force")


def _discovered(trials: Trials) -> Law:
    return discover(trials, order=2, library=OFFERED, progress=lambda _: None)


def agreed(choices: Mapping[str, Choice]) -> list[str]:
    """Return the groups in which the choice is the form of largest evidence."""
    return [group for group, choice in choices.items() if choice.form == next(iter(choice.against))]


def _choices_frame(choices: Mapping[str, Choice]) -> pd.DataFrame:
    rows = [
        {
            "balls": group,
            "chosen": choice.form,
            "largest evidence": next(iter(choice.against)),
            **{form.split()[0]: choice.against.get(form) for form in DRAG_FORMS},
            "noise (m)": choice.noise,
            "what else": choice.errors,
        }
        for group, choice in choices.items()
    ]
    return pd.DataFrame(rows)


def _evidence_frame(choices: Mapping[str, Choice]) -> pd.DataFrame:
    rows = [
        {
            "balls": group,
            "law": form,
            "chosen": form == choice.form,
            "2 log B": choice.against[form],
            "probability": measures["probability"],
        }
        for group, choice in choices.items()
        for form, measures in choice.listed.items()
    ]
    return pd.DataFrame(rows)


def _results(choice: Choice) -> dict[str, Any]:
    laws = {
        form: {"two_log_bayes_factor": choice.against[form], "probability": measures["probability"]}
        for form, measures in choice.listed.items()
    }
    return {"chosen": choice.form, "noise": choice.noise, "errors": choice.errors, "laws": laws}


def _found(choices: Mapping[str, Choice]) -> str:
    same = agreed(choices)
    lines = []
    for group, choice in choices.items():
        best, second = list(choice.against)[:2]
        if group in same:
            verdict = f"the evidence agrees, and {second} loses {_words(choice.against[second])}"
        elif choice.form in choice.against:
            verdict = f"the evidence is for {best}, and the choice loses {_words(choice.against[choice.form])}"
        else:
            verdict = f"the evidence among the four laws is for {best}"
        lines.append(f"- {group}: the choice is {choice.form}; {verdict}.")
    return (
        f"Choice and evidence name the same law for {len(same)} of {len(choices)} groups ({listed(same)}):\n\n"
        + "\n".join(lines)
        + f"\n\nIf there is one kind of drag only, the evidence of {_favoured(choices, 'linear')} is for linear drag, "
        f"and that of {_favoured(choices, 'quadratic')} for quadratic drag."
    )


def _words(value: float) -> str:
    words = next(words for bound, words in EVIDENCE_WORDS.items() if value < bound)
    return f"{value:.1f} ({words})"


def _favoured(choices: Mapping[str, Choice], drag: str) -> str:
    """Return the groups whose evidence is for this one of the two drags, each with the loss of the other."""
    other = {"linear": "quadratic", "quadratic": "linear"}[drag]
    gains = {
        group: choice.against[f"{other} drag"] - choice.against[f"{drag} drag"] for group, choice in choices.items()
    }
    return listed([f"the {group} (by {gain:.1f})" for group, gain in gains.items() if gain > 0])


def _meant(law: Law) -> str:
    table = law.conf_int()
    drag = table[table["term"] == "v"]
    pushed = drag[drag["low"] > 0]["object"].tolist()
    constant = table[table["term"] == "1"]["estimate"]
    if drag.empty:
        return "The law of all ten balls has no linear drag."
    return (
        "A form that is probable is not therefore the drag of the air. In the law of all ten balls the constants run "
        f"from {constant.min():.2f} to {constant.max():.2f} m/s², and the 95 % interval of the drag lies on the wrong "
        f"side of zero, so that the air would push, for {len(pushed)} of them ({listed(pushed)})."
    ).replace("-", "−")


_ASKED = f"""
This part goes beyond the paper. Its method needs a threshold and a smoothing window, and somebody who knows which. The
default of this library is given neither: `discover(trials, order=2, library="{OFFERED}")`. It fits whole trajectories
to the heights as they were measured, and estimates the noise of the heights from neighbouring samples. It may choose
between constant acceleration ($1$), linear drag ($1, v$), quadratic drag ($1, v^2$) and both ($1, v, v^2$).

As all balls of a group share the terms, the choice may depend on who is in it. There are six groups, each with both
drops: all ten balls; the four whiffle balls, whose openings add drag; the six balls that are closed; and of these three
pairs: the basketballs, which are nearly the same; the golf ball and the baseball, which are the densest; and the tennis
ball and the volleyball, which remain.

The measured heights depart from each of these laws by more than white noise explains, as one may expect of a camera
held by hand, of wind, and of balls that spin. The default therefore also tries noise that grows with the height, errors
of the heights that have a memory, a random walk and a smooth force beside the law, each with levels of its own, and
takes the law and the errors of largest evidence.
"""
_CHOICES = (
    "What the default method chooses for each group of balls, and the law of largest evidence. The four columns after "
    "these are 2 log B, twice the log Bayes factor of the best of the four against each, with the errors of the chosen "
    "law: below 2 is hardly worth a mention, up to 6 is positive, up to 10 strong, above it very strong evidence "
    "for the best (Kass and Raftery 1995). Then the noise of the heights, and what explains the rest: the standard "
    "deviation of a force is in m/s², that of an error of the heights in m."
)
_EVIDENCE = (
    "The list that the default method keeps with its law (`law.comparison`), under the errors of the chosen law."
)
