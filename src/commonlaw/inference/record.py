"""What is said of a law: the choices on the way to it, and what else was to choose from."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference.accuracy import Rivals, probabilities
from commonlaw.inference.objects import Objects
from commonlaw.inference.search import Found
from commonlaw.law import Alternative, Law, Step
from commonlaw.outcomes import Outcome
from commonlaw.selection import MOST_TERMS
from commonlaw.trials import Schema, Trials

_LISTED = 12
"""Supports of each equation that are kept as alternatives, besides the chosen one."""


def alternatives(law: Law, others: Rivals) -> tuple[Alternative, ...]:
    """Return the supports that each equation was chosen from, the best first."""
    found = []
    for equation, listed in zip(law.left_hand_sides, others, strict=True):
        likely = probabilities(listed)
        chosen = next(i for i, (_, above) in enumerate(listed) if above == 0)
        for i in sorted({*range(min(_LISTED, len(listed))), chosen}):
            support, above = listed[i]
            names = tuple(law.terms.names[k] for k in np.flatnonzero(support))
            measures = {"evidence lost": float(above), "probability": float(likely[i])}
            found.append(Alternative(equation, names, measures, False, i == chosen))
    return tuple(found)


def _why(law: Law, listed: Sequence[tuple[Bools, float]]) -> str:
    """Return what speaks for the chosen support of an equation."""
    second = next((pair for pair in listed if pair[1] != 0), None)
    if second is None:
        return "no other support was compared"
    runner = ", ".join(law.terms.names[k] for k in np.flatnonzero(second[0])) or "no term"
    ratio = np.exp(min(abs(second[1]) / 2, 700))
    if second[1] < 0:
        return f"largest evidence once fitted; before that, {runner} is {ratio:.3g} times more probable"
    return f"largest evidence; the next, {runner}, is {ratio:.3g} times less probable"


def outcomes(trials: Trials, law: Law, objects: Objects, found: Found) -> tuple[Outcome, ...]:
    """Return what a user should know of a law that these trials gave."""
    progress = []
    if not found.obeyed:
        single = any(len(trials.of(name)) == 1 for name in trials.objects)
        weak = ", which says little of objects with a single trial" if single else ""
        progress.append(
            Outcome(
                "not obeyed",
                "",
                "the trials stray further from every law of the library than their noise explains; terms were chosen "
                f"by rates of stretches held out{weak}, and the law has an error of its own, in each step "
                f"{found.tolerance:g} times the noise",
                "offer terms for what is missing, give the noise if it is known to be larger, or take the law for a "
                "summary",
            )
        )
    progress += [
        Outcome("empty support", side, "no candidate term explains it better than noise", "offer other terms")
        for j, side in enumerate(law.left_hand_sides)
        if not any(each.coefficients[j].any() for each in found.estimates)
    ]
    most = objects.most_terms
    progress += [
        Outcome(
            "few samples",
            side,
            f"it has {most} terms, as many as the object with the fewest samples can tell apart",
            "measure more samples or trials, or offer fewer terms",
        )
        for side, support in zip(law.left_hand_sides, found.supports, strict=True)
        if support.sum() == most < min(MOST_TERMS, objects.allowed.sum(axis=1).max())
    ]
    return tuple(progress)


def history(
    trials: Trials, law: Law, objects: Objects, found: Found, others: Rivals, given: bool, resolved: bool
) -> tuple[Step, ...]:
    """Return every choice that was made, in order.

    Parameters
    ----------
    trials, law, objects, found, others
        What was measured, the law that is sought, and what was found.
    given
        Whether the noise was given.
    resolved
        Whether a finer mesh changes nothing.
    """
    mesh = "a finer mesh changes nothing" if resolved else "the finest there is"
    steps = [
        noise_step(trials.schema, objects, given),
        Step(
            "library",
            f"{len(law.terms)} terms" + (f" for each of {len(law.states)} equations" if len(law.states) > 1 else ""),
            ", ".join(law.terms.names[:10]) + (", ..." if len(law.terms) > 10 else ""),
        ),
        Step(
            "mesh",
            f"{objects.points} step{'s' if objects.points > 1 else ''} from sample to sample",
            mesh if found.obeyed else "a law with an error needs no finer one",
        ),
    ]
    for equation, listed in zip(law.left_hand_sides, others, strict=True):
        chosen = next(support for support, above in listed if above == 0)
        names = [law.terms.names[k] for k in np.flatnonzero(chosen)]
        reason = _why(law, listed) if found.obeyed else "the fewest within one standard error, on trials held out"
        steps.append(Step(f"terms of {equation}", ", ".join(names) or "none", reason))
    return (*steps, error_step(found), coefficients_step(trials, objects, found))


def noise_step(schema: Schema, objects: Objects, given: bool) -> Step:
    """Return what noise was taken."""
    levels = [
        f"{name}: {level:.3g} {schema.units.get(name, '')}".rstrip()
        for name, level in zip(schema.states, objects.noise, strict=True)
    ]
    return Step("noise", ", ".join(levels), "as given" if given else "from differences of neighbouring samples")


def error_step(found: Found) -> Step:
    """Return whether the law has an error of its own."""
    if found.obeyed:
        return Step("error of the law", "none", "the trajectories are solutions of the law, up to the noise")
    text = f"a random walk, in each step {found.tolerance:g} times the noise"
    return Step("error of the law", text, "the measurements stray further from the law than noise explains")


def coefficients_step(trials: Trials, objects: Objects, found: Found) -> Step:
    """Return how the coefficients were found, and what the trajectories leave."""
    misfit, count = sum(each.deviance for each in found.estimates), sum(objects.measured)
    return Step(
        "coefficients",
        f"maximum likelihood of {len(trials)} trajectories",
        f"misfit {misfit / count:.3f} for each of {count} measurements, where noise alone leaves about 1",
    )
