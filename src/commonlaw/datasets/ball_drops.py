"""Ten sports balls dropped from a bridge, filmed."""

import hashlib
import os
from pathlib import Path

import numpy as np

from commonlaw.datasets.dataset import DE_SILVA_2020, Dataset
from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import read_file
from commonlaw.runtime.shutdown import put_away_first
from commonlaw.trials import Schema, Trial, Trials

_SOURCE = "https://raw.githubusercontent.com/briandesilva/discovery-of-physics-from-data/b79c34317f049c9b47aaf2cc4c54c5ec7219f3d7/data/"
_HEIGHTS = "Ball_drops_data.xls"
_BALLS = "balls.txt"
_SHA256 = {
    _HEIGHTS: "942b2d68abfff3828ca323de491435d4ec27c3a22e62cee0cbdf52c2e8d1c0ed",
    _BALLS: "7cc282a6559ef636ce30cad53aae5bf825ce6200a94dd54f668af9797c584585",
}
_VARIABLE = "COMMONLAW_DATA"


_NAMES = {
    "Golf Ball": "golfball",
    "Baseball": "baseball",
    "Tennis Ball": "tennisball",
    "Volleyball": "volleyball",
    "Blue Basketball": "bluebasketball",
    "Green Basketball": "greenbasketball",
    "Whiffle Ball 1": "wiffleball1",
    "Whiffle Ball 2": "wiffleball2",
    "Yellow Whiffle Ball": "yellowWiffle",
    "Orange Whiffle Ball": "orangeWiffle",
}
"""Sheets of the workbook, in the order of the paper's tables, and what the list of balls calls them."""


def _load(folder: str | os.PathLike[str] | None = None, clip: bool = True) -> Trials:
    """Return the heights of ten balls dropped twice from the Alex Fraser Bridge, Vancouver, in June 2013.

    Heights ``x`` in m at about 15 frames a second, ``t`` in s. The bowling ball, whose first drop is corrupted, and the
    velocities in the file are left out, as in the paper.

    Properties are ``radius`` in m, ``mass`` in kg and ``density`` in kg/m^3, from the measured weights and
    circumferences. The volleyball was not measured: its radius is the authors' estimate, and it has no mass and
    density. The golf ball weighs 1.62 oz as measured (0.0459 kg); the paper's table has 1.6 oz (0.0454 kg) and the
    density that goes with it.

    Raises `CommonlawError` if a file cannot be had, or is not the published one.

    Parameters
    ----------
    folder
        Where ``Ball_drops_data.xls`` and ``balls.txt`` are. Default: the folder that the environment variable
        COMMONLAW_DATA names; without it both files are downloaded once, and kept in the user's cache.
    clip
        Whether drops end before their last irregular frame, see `Trials.clip_irregular`.
    """
    heights, balls = (_file(name, folder) for name in (_HEIGHTS, _BALLS))
    table = Trials.read(heights, trial="Drop #", time="Time", states="Height")
    drops = tuple(Trial(name, drop.name, drop.times, drop.states) for name in _NAMES for drop in table.of_object(name))
    units = {"x": "m", "t": "s", "radius": "m", "mass": "kg", "density": "kg/m^3"}
    rows = {name: values for name, *values in map(str.split, read_file(balls).decode().splitlines())}
    properties = {}
    for name, short in _NAMES.items():
        weight, circumference = rows[short]
        if weight == "??":
            # The authors' estimate from other volleyballs
            properties[name] = {"radius": 0.105}
            continue
        # From avoirdupois ounces
        radius, mass = float(circumference) / 100 / (2 * np.pi), float(weight) * 0.028349523125
        properties[name] = {"radius": radius, "mass": mass, "density": mass / (4 / 3 * np.pi * radius**3)}
    trials = Trials(drops, Schema(("x",), units=units), properties)
    return trials.clip_irregular() if clip else trials


def _file(name: str, folder: str | os.PathLike[str] | None) -> Path:
    """Return the path of a file that is the published one: in the folder, in the one of the environment, or fetched."""
    named = os.environ.get(_VARIABLE)
    if folder is None and not named:
        return _downloaded(name)
    path = Path(folder if folder is not None else named or "") / name
    try:
        content = read_file(path)
    except CommonlawError as error:
        whose = "the folder given" if folder is not None else f"the folder in {_VARIABLE}"
        raise CommonlawError("dataset-file", name=name, folder=whose, error=error, source=_SOURCE) from None
    checksum = hashlib.sha256(content).hexdigest()
    if checksum != _SHA256[name]:
        raise CommonlawError("dataset-checksum", path=path, found=checksum, sha256=_SHA256[name], source=_SOURCE)
    return path


def _downloaded(name: str) -> Path:
    """Return the path of a file in the user's cache, downloaded if it is not there yet."""
    import pooch
    from requests import exceptions

    cache, patient = pooch.os_cache("commonlaw"), pooch.HTTPDownloader(timeout=10.0)
    try:
        with put_away_first() as ending, ending.waiting():
            return Path(pooch.retrieve(_SOURCE + name, f"sha256:{_SHA256[name]}", name, cache, downloader=patient))
    except (OSError, ValueError) as error:  # no connection, no space, or another file than the published one
        is_away = isinstance(error, (exceptions.ConnectionError, exceptions.Timeout))
        is_away = is_away and not isinstance(error, exceptions.SSLError)  # Of these errors the text is long
        cause = f"no connection to {_SOURCE.split('/')[2]}" if is_away else str(error)
        raise CommonlawError(
            "dataset-download",
            source=_SOURCE,
            name=name,
            cache=str(cache),
            cause=cause,
            heights=_HEIGHTS,
            balls=_BALLS,
            variable=_VARIABLE,
        ) from None


ball_drops = Dataset(
    "ball-drops",
    "measured drops of ten sports balls from a bridge, two drops each",
    f"{DE_SILVA_2020}; data: https://github.com/briandesilva/discovery-of-physics-from-data (MIT licence)",
    _load,
    None,
)
