"""Data sets by name: measured drops of balls, and simulated systems whose law is known."""

from collections.abc import Mapping
from functools import partial, update_wrapper
from inspect import signature
from typing import TYPE_CHECKING, Any

from commonlaw.datasets import sphere_drag
from commonlaw.datasets.ball_drops import ball_drops
from commonlaw.datasets.dataset import Dataset
from commonlaw.datasets.simulated import (
    PRINTED_VISCOSITY,
    linear_drag,
    lorenz,
    lotka_volterra,
    nonlinear_oscillator,
    reynolds_drag,
)
from commonlaw.errors import check_choice
from commonlaw.runtime.arguments import parse_spec
from commonlaw.trials import Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

__all__ = [
    "DATASETS",
    "PRINTED_VISCOSITY",
    "Dataset",
    "ball_drops",
    "linear_drag",
    "load",
    "lorenz",
    "lotka_volterra",
    "nonlinear_oscillator",
    "reynolds_drag",
    "sphere_drag",
    "truth_of",
]

DATASETS: Mapping[str, Dataset[...]] = {
    dataset.name: dataset
    for dataset in (ball_drops, linear_drag, reynolds_drag, nonlinear_oscillator, lotka_volterra, lorenz)
}


def load(name: str, **options: Any) -> Trials:
    """Return the trials of the data set of that name.

    Raises `CommonlawError` if there is no such data set, or it has no such option.

    Parameters
    ----------
    name
        One of `DATASETS`.
    **options
        Options of the data set.

    Examples
    --------
    >>> load("linear-drag", noise=0.1, seed=1)
    <Trials: 10 trials of 5 objects, 490 samples of x>
    """
    check_choice("data set", name, DATASETS)
    dataset = DATASETS[name]
    known = signature(dataset.load).parameters
    for option in options:
        check_choice(f"option of the data set {name!r}", option, known)
    return dataset(**options)


def truth_of(text: str) -> "Law | None":
    """Return the law behind the data set that a text names with its options; None where it is not known.

    Raises `CommonlawError` if there is no such data set, or the options do not fit.

    Examples
    --------
    >>> truth_of("linear-drag:drag=-0.5:noise=0.1").equations()
    ("x'' = -9.8 - 0.5 v",)
    """
    # Messages show the options as those of the data set
    makers = {name: update_wrapper(partial(_known_truth, dataset), dataset.load) for name, dataset in DATASETS.items()}
    return parse_spec("data set", text, makers)


def _known_truth(dataset: Dataset[...], *args: Any, **options: Any) -> "Law | None":
    return dataset.truth(*args, **options) if dataset.law else None
