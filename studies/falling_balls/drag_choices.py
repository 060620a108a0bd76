"""Part 8, first half: which drag the default method chooses for groups of balls, and what the evidence says."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from commonlaw.discovery import discover
from commonlaw.inference import fit_supports, prepare
from commonlaw.law import Law
from commonlaw.report import Section, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.landing import listed
from studies.falling_balls.settings import ALL_BALLS, BALL_GROUPS, DRAG_FORMS, EVIDENCE_WORDS, OFFERED


@dataclass(frozen=True, eq=False)
class Choice:
    """What the default method chooses for a group of balls.

    Parameters
    ----------
    law
        The law that it found.
    values
        Minus twice the log-evidence of each form of drag, but for a constant: each fitted with an error of its own.
    errors
        Of the law of each form, in each step, relative to the noise.
    noise
        Of the heights, by which these were found (m).
    """

    law: Law
    values: Mapping[str, float]
    errors: Mapping[str, float]
    noise: float

    @cached_property
    def form(self) -> str:
        """The form of drag that was chosen."""
        return form_of(self.law)

    @cached_property
    def against(self) -> dict[str, float]:
        """Twice the log Bayes factor of the best form against each, from the best, which has 0, to the worst."""
        least = min(self.values.values())
        return {form: self.values[form] - least for form in sorted(self.values, key=lambda each: self.values[each])}

    @cached_property
    def listed(self) -> dict[str, tuple[float, float]]:
        """What the law's own list says of each form in it: 2 log B, and the probability."""
        measures = {each.terms: each.measures for each in self.law.alternatives}
        factors = {terms: float(own["2 log B"] or 0.0) for terms, own in measures.items()}
        return {
            form: (factors[terms], float(measures[terms]["probability"] or 0.0))
            for form, terms in DRAG_FORMS.items()
            if terms in factors
        }

    @property
    def error(self) -> str:
        """The model error, in the words of the law's history."""
        return next(step.choice for step in self.law.history if step.stage == "model error")


def drag_choices(drops: Trials) -> tuple[Section, Mapping[str, Choice]]:
    """Return blocks and results for the part on the default method, and the choices by group of balls."""
    choices = {group: _choose(drops.select(object=balls)) for group, balls in BALL_GROUPS.items()}
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


def _choose(trials: Trials) -> Choice:
    law = discover(trials, order=2, library=OFFERED, progress=lambda _: None)
    unknown = np.full(law.coefficients.shape, np.nan)
    problem = prepare(trials, law.terms, law.order, unknown)
    found = {
        form: fit_supports(problem, np.isin(law.terms.names, terms)[np.newaxis]) for form, terms in DRAG_FORMS.items()
    }
    values = {form: each.value for form, each in found.items()}
    return Choice(law, values, {form: each.model_error for form, each in found.items()}, float(problem.noise[0]))


def agreed(choices: Mapping[str, Choice]) -> list[str]:
    """Return the groups in which the choice is the form of largest evidence."""
    return [group for group, choice in choices.items() if choice.form == next(iter(choice.against))]


def _choices_frame(choices: Mapping[str, Choice]) -> pd.DataFrame:
    rows = [
        {
            "balls": group,
            "chosen": choice.form,
            "largest evidence": next(iter(choice.against)),
            **{form.split()[0]: choice.against[form] for form in DRAG_FORMS},
            "noise (m)": choice.noise,
            "model error (noise)": choice.errors.get(choice.form),
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
            "its model error, in units of the noise": choice.errors[form],
            "2 log B at the model error of the chosen law": choice.listed.get(form, (None, None))[0],
            "probability then": choice.listed.get(form, (None, None))[1],
        }
        for group, choice in choices.items()
        for form in DRAG_FORMS
    ]
    return pd.DataFrame(rows)


def _results(choice: Choice) -> dict[str, Any]:
    laws = {}
    for form in DRAG_FORMS:
        at_chosen, probability = choice.listed.get(form, (None, None))
        laws[form] = {
            "two_log_bayes_factor": choice.against[form],
            "error": choice.errors[form],
            "two_log_bayes_factor_at_error_of_chosen": at_chosen,
            "probability": probability,
        }
    return {"chosen": choice.form, "noise": choice.noise, "error": choice.error, "laws": laws}


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
        f"and that of {_favoured(choices, 'quadratic')} for quadratic drag. Where choice and evidence disagree, the "
        "choice is the more cautious: it asks whether another term helps to forecast the later part of the drops from "
        "the earlier, and by more than a tenth. The evidence asks under which law the drops themselves are most "
        "probable, and takes the steps of the error for independent of each other, which those of a camera in "
        "somebody's hands are not."
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
    table = law.intervals()
    drag = table[table["term"] == "v"]
    pushed = drag[drag["low"] > 0]["object"].tolist()
    constant = table[table["term"] == "1"]["coefficient"]
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

The measured heights depart from each of these laws by more than their noise, as one may expect of a camera held by
hand, of wind, and of balls that spin. Each law is therefore given a model error, a random walk whose steps are a
multiple of the noise, and the multiple is found from the drops. In this case the default does not trust the
evidence. It forecasts the later part of each drop by laws that were fitted to the earlier, with such an error or with a
larger noise instead, and takes the fewest terms within a tenth of the least error of these forecasts. Here the evidence
stands beside the choice, and they need not agree.
"""
_CHOICES = (
    "What the default method chooses for each group of balls, and the law of largest evidence. The four columns after "
    "these are 2 log B, twice the log Bayes factor of the best of the four against each, each with a model error of "
    "its own: below 2 is hardly worth a mention, up to 6 is positive, up to 10 strong, above it very strong evidence "
    "for the best (Kass and Raftery 1995). Then the noise of the heights, and the model error of the chosen law in "
    "each step, in units of the noise."
)
_EVIDENCE = (
    "The same evidence, with the model error that suits each law. The last two columns are the list that the default "
    "method keeps with its law (`law.candidates()`), relative to the best in it: there all laws are compared with the "
    "model error of the chosen one, which hides part of what others gain if the chosen one needs a larger one. An "
    "empty cell is a law that differs from the chosen one by more than one term, and was not compared."
)
