"""Part 5: simulated drops whose drag is linear in the velocity, and what noise does to the terms that are found."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.datasets import linear_drag
from commonlaw.discovery import DerivativeRegression, discover
from commonlaw.law import Law, average_law
from commonlaw.plots import Figure
from commonlaw.report import Picture, Text
from commonlaw.solvers import STLSQ
from commonlaw.trials import Trials
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.plots import Curve, plot_curves
from studies.falling_balls.quadratic_drag import quadratic_drag
from studies.falling_balls.recovery import Recovery, recovered
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import (
    AVERAGE_DIGITS,
    DIFFERENTIATION,
    GOOD_UP_TO,
    GROUP_THRESHOLD,
    LIBRARY,
    LINEAR_AVERAGES,
    NOISES,
    RECOVERY_NOISES,
    RECOVERY_SEEDS,
    RELIABLE,
    SEED,
    SIMULATED_SINGLE_THRESHOLD,
)
from studies.falling_balls.simulation import (
    agrees,
    averages_table,
    by_noise,
    heat_maps,
    learned,
    listed,
    mean_coefficients,
    on_grid,
    simulated,
)

_THRESHOLDS = {"single": SIMULATED_SINGLE_THRESHOLD, "group": GROUP_THRESHOLD}
_GROUP, _SINGLE, _EACH = "group, all balls", "single, all balls", "single, each ball"
Laws = Mapping[str, Mapping[float, Sequence[Law]]]
Recoveries = Mapping[str, Mapping[float, Recovery]]


def simulated_drops(inquiry: Inquiry) -> Section:
    """Learn laws of simulated drops with linear drag, once as the paper did and over many seeds."""
    clean = linear_drag(noise=0.0, trials=1)
    laws = learned(simulated(clean, NOISES, inquiry.seed), _THRESHOLDS)
    shown = {
        f"single, threshold {_THRESHOLDS['single']:g}": laws["single"],
        f"group, threshold {_THRESHOLDS['group']:g}": laws["group"],
    }
    averages = {
        noise: mean_coefficients(law)
        for noise, law in learned(simulated(clean, NOISES, SEED), _THRESHOLDS)["group"].items()
    }
    many = _many(clean, range(inquiry.seed, inquiry.seed + RECOVERY_SEEDS))
    recoveries = _recoveries(many)
    quadratic = quadratic_drag(inquiry)
    blocks = (
        Text(_asked()),
        Picture(
            "simulated-drops-heat-maps",
            f"Terms learned from simulated drops with linear drag (seed {inquiry.seed}): each cell is the magnitude of "
            "one term's coefficient (columns) for one ball (rows), at rising noise from left to right. The true terms "
            "are 1 and $v$.",
            partial(heat_maps, shown),
        ),
        averages_table(
            "simulated-drops-averages",
            "Coefficients of the group model, averaged over the five balls, for the noise of the authors' program "
            f"(seed {SEED}): what their program gave, and what came out here. The true averages are −9.8 and "
            f"{_number(average_law(linear_drag.truth()).coefficients[0, 0, 1])}.",
            averages,
            LINEAR_AVERAGES,
        ),
        Text(_over_seeds(recoveries, many)),
        Picture(
            "simulated-drops-recovery",
            f"In how many of {RECOVERY_SEEDS} simulated experiments exactly the true terms, 1 and $v$, are found, "
            "against the noise: by the group method, by the single-trial method for all five balls at once, and by the "
            "single-trial method for each ball. Bands are 95 % Wilson intervals.",
            partial(_draw_recoveries, recoveries),
        ),
        *quadratic.blocks,
    )
    results = {
        "linear_drag_averages": by_noise(averages),
        "recovery": {
            label: by_noise({noise: each.share for noise, each in row.items()}) for label, row in recoveries.items()
        },
        **quadratic.results,
    }
    verdicts = (_averages_verdict(averages), _recovery_verdict(averages, recoveries[_GROUP]), *quadratic.verdicts)
    return Section("simulated-drops", "Simulated drops with linear drag", blocks, verdicts, results)


def _many(clean: Trials, seeds: Sequence[int]) -> Laws:
    """Return the laws that each method finds at each noise, one for each seed."""
    grid = on_grid(DIFFERENTIATION, clean[0].times)
    learn = partial(discover, order=2, library=LIBRARY)
    single = DerivativeRegression(differentiation=grid, solver=STLSQ(_THRESHOLDS["single"], shared=False))
    solver = STLSQ(_THRESHOLDS["group"])
    group = DerivativeRegression(differentiation=grid, solver=solver, library_states="measured")
    laws: dict[str, dict[float, list[Law]]] = {method: {n: [] for n in RECOVERY_NOISES} for method in _THRESHOLDS}
    for seed in seeds:
        for noise, trials in simulated(clean, RECOVERY_NOISES, seed).items():
            laws["single"][noise].append(learn(trials, method=single))
            laws["group"][noise].append(learn(trials, method=group))
    return laws


def _recoveries(laws: Laws) -> Recoveries:
    """Return how often exactly the true terms were found at each noise."""
    truth = linear_drag.truth()
    right = {
        method: {noise: np.array([recovered(law, truth) for law in several]) for noise, several in row.items()}
        for method, row in laws.items()
    }
    return {
        _GROUP: {noise: _count(np.all(balls, axis=1)) for noise, balls in right["group"].items()},
        _SINGLE: {noise: _count(np.all(balls, axis=1)) for noise, balls in right["single"].items()},
        _EACH: {noise: _count(balls.ravel()) for noise, balls in right["single"].items()},
    }


def _count(right: Bools) -> Recovery:
    return Recovery(int(right.sum()), right.size)


def _draw_recoveries(recoveries: Recoveries) -> Figure:
    curves = []
    for label, row in recoveries.items():
        low, high = np.transpose([each.interval() for each in row.values()])
        curves.append(Curve(label, list(row), [each.share for each in row.values()], low, high, points=True))
    return plot_curves({"": curves}, "noise (m)", "share with the true terms", log_x=True, y_limits=(-0.03, 1.03))


def _asked() -> str:
    drags = listed([_number(row[0, 1]) for row in linear_drag.truth().coefficients])
    return (
        "Measured drops cannot tell whether a method finds the *right* law, for nobody knows that law exactly. "
        "Simulated drops can. Five balls fall from rest with $\\ddot x = -9.8 + D v$, where $D$ is "
        f"{drags} 1/s. Their heights are taken 15 times a second, 49 times, and noise of standard deviations from 0 "
        f"to {NOISES[-1]:g} m is added. Both methods then choose among the ten products of powers of $x$ and $v$ up to "
        "the third degree: the single-trial method for each ball by itself, the group method for all five at once. "
        "The right answer has two terms, 1 and $v$."
    )


def _over_seeds(recoveries: Recoveries, laws: Laws) -> str:
    at = recoveries[_GROUP][GOOD_UP_TO]
    low, high = at.interval()
    best = max(each.share for each in recoveries[_SINGLE].values())
    supports = [
        set(mean_coefficients(law)) for noise, row in laws["group"].items() if noise <= GOOD_UP_TO for law in row
    ]
    wrong = [terms for terms in supports if terms != {"1", "v"}]
    bare = sum(terms == {"1"} for terms in wrong)
    drags = -linear_drag.truth().coefficients[:, 0, 1].sum()
    return (
        f"One draw of noise may be lucky. Over {at.tried} draws the group method finds exactly 1 and $v$ in "
        f"{at.share:.0%} of them at a noise of {GOOD_UP_TO:g} m (95 % interval {low:.0%} to {high:.0%}). Up to that "
        f"noise, {bare} of its {len(wrong)} wrong laws have gravity alone: the sum of the balls' drag coefficients, "
        f"{drags:.2g} 1/s, is not far above the threshold, {GROUP_THRESHOLD:g}, and an estimate may fall below it. The "
        f"single-trial method is right for all five balls in at most {best:.0%} of the draws at any of these noises; "
        "the height $x$ often stands in for $v$, with which it goes along in a single drop."
    )


def _averages_verdict(averages: Mapping[float, Mapping[str, float]]) -> Verdict:
    if agrees(averages, LINEAR_AVERAGES):
        return Verdict(
            "reproduced",
            f"The group models of all {len(NOISES)} noise levels come out as in the authors' program, to all "
            f"{AVERAGE_DIGITS} decimals of the averages.",
        )
    return Verdict("differs", "The averages of the group models are not those of the authors' program; see the table.")


def _recovery_verdict(averages: Mapping[float, Mapping[str, float]], group: Mapping[float, Recovery]) -> Verdict:
    claim = 'The group method "identif[ies] the correct terms and their magnitudes for noise levels up to half a meter"'
    poor = {noise: each for noise, each in group.items() if noise <= GOOD_UP_TO and each.share < RELIABLE}
    shown = all(set(terms) == {"1", "v"} for noise, terms in averages.items() if noise <= GOOD_UP_TO)
    if shown and not poor:
        return Verdict("reproduced", f"{claim}: in at least {RELIABLE:.0%} of the seeds at each of these noises.")
    levels = listed([f"{each.share:.0%} at {noise:g} m" for noise, each in poor.items()])
    drawn = "so it does" if shown else "it does not do so"
    return Verdict(
        "differs",
        f"{claim}: {drawn} with the noise that the paper shows, but noise drawn with other seeds gives it less often. "
        f"Of {group[GOOD_UP_TO].tried} draws it finds exactly 1 and $v$ in {levels}.",
    )


def _number(value: float) -> str:
    return f"{value:.3g}".replace("-", "−")
