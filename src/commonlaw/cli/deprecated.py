"""Words of the last release, which commands take for one more: what they are now."""

from collections.abc import Iterator, Sequence

from commonlaw.cli.output import say

_OPTIONS = {
    "--plot": "--save",
    "--out": "--save",
    "--workers": "--set n_jobs=",
    "fit --start": "--initial-value",
    "fit --starts-at": "--initial-time",
    "predict --start": "--initial-samples",
    "design --against": "--rival",
    "show --object": "--select",
    "report --law": "",
}
"""Options that are called otherwise now, of one command or of all that have the new one."""

_SETTINGS = {
    name: name.removeprefix("--").replace("-", "_")
    for name in (
        "--positive", "--input-between", "--errors", "--huber-threshold", "--covariance", "--seed", "--unmeasured",
        "--solver", "--rule", "--scoring", "--differentiation", "--library-states", "--trim",
    )
} | {"--jobs": "n_jobs", "--resamples": "n_resamples", "--radius": "radii"}  # fmt: skip
"""Options that are settings now, by which name."""


def current(command: str, args: Sequence[str], options: Sequence[str]) -> list[str]:
    """Return the words that a command is given, with those of now for those of the last release, and say which.

    Parameters
    ----------
    command
        Its name.
    args
        As given.
    options
        Those that it has.
    """
    found, rest = list[str](), iter(args)
    for word in rest:
        if word == "--":
            return [*found, word, *rest]
        name, given, value = word.partition("=")
        new = _OPTIONS.get(f"{command} {name}", _OPTIONS.get(name, f"--set {_SETTINGS.get(name, '')}="))
        if name == "--dataset" and name not in options:
            value = value if given else next(rest, "")
            found.insert(0, f"dataset:{value}")
            _say(name, f"dataset:{value} in place of TABLE")
        elif name in ("--partial-pooling", "--no-partial-pooling") and "--set" in options:
            found += _set(name, f"partial_pooling={str(name == '--partial-pooling').lower()}")
        elif name in options or not name.startswith("--") or new == "--set =":
            found.append(word)
        elif new.startswith("--set ") and "--set" in options:
            found += _set(name, new.removeprefix("--set ") + (value if given else next(rest, "")))
        elif new in options or not new:
            found += ([new] if new else []) + ([value] if given else [])
            _say(name, new or "the law after TABLE")
        else:
            found.append(word)
    return found


def _set(name: str, setting: str) -> Iterator[str]:
    _say(name, f"--set {setting}")
    yield from ("--set", setting)


def _say(name: str, new: str) -> None:
    say(f"commonlaw: {name} is deprecated: write {new}", err=True)
