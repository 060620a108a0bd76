"""Drops of balls with masses, in memory and in files."""

from pathlib import Path

import numpy as np

import commonlaw as cl

ROLES = {"object": "object", "trial": "trial", "time": "t", "states": ["x"]}


def drops_with_masses(count: int) -> cl.Trials:
    """Return drops of balls with a drag that goes with the inverse of the mass, and gravity, which all share."""
    masses = np.exp(np.random.default_rng(1).normal(0, 0.5, count))
    drops = cl.datasets.linear_drag(drag=tuple(-0.3 / masses), trials=2, noise=0.01)
    properties = {name: {"mass": float(mass)} for name, mass in zip(drops.objects, masses, strict=True)}
    return cl.Trials(drops.trials, drops.schema, properties)


def write_files(drops: cl.Trials, folder: Path, count: int) -> Path:
    """Write trials to so many files, each with objects of its own, and return the folder."""
    for i, names in enumerate(np.array_split(drops.objects, count)):
        drops.select(object=names.tolist()).to_parquet(folder / f"{i}.parquet")
    return folder
