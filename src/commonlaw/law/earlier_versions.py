"""Saved laws of earlier versions of the schema, by the names of version 3."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from commonlaw.law.provenance import Alternative

_UNCERTAINTY = {
    "covariance": "covariance",
    "common": "shared_factor",
    "noise": "noise",
    "inclusion": "inclusion_probabilities",
}
_PROVENANCE = ("differentiation", "outcomes", "alternatives", "history")
_OUTCOME_KINDS = {"not obeyed": "model error"}
_ALTERNATIVE = {"settings": "hyperparameters"}
_BAYES_FACTOR = "2 log B"
_MEASURES = {"evidence lost": _BAYES_FACTOR}


def renamed(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document of version 1 or 2, which need not be valid, by the names of version 3."""
    moved = {*_UNCERTAINTY, *_PROVENANCE}
    provenance = {key: document[key] for key in _PROVENANCE if key in document}
    for key, rename in (("outcomes", _outcome), ("alternatives", _alternative)):
        if key in provenance:
            provenance[key] = _each(provenance[key], rename)
    return {
        **{key: value for key, value in document.items() if key not in moved},
        "version": 3,
        "uncertainty": {name: document[key] for key, name in _UNCERTAINTY.items() if key in document},
        "provenance": provenance,
    }


def compared_with_the_best(alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """Return alternatives whose Bayes factors are against the best of their equation, no more against the chosen."""
    known = [(each.equation, value) for each in alternatives if (value := each.measures.get(_BAYES_FACTOR)) is not None]
    least = {name: min(value for other, value in known if other == name) for name, _ in known}

    def compared(each: Alternative) -> Alternative:
        value = each.measures.get(_BAYES_FACTOR)
        if value is None:
            return each
        return replace(each, measures={**each.measures, _BAYES_FACTOR: value - least[each.equation]})

    return tuple(map(compared, alternatives))


def _outcome(outcome: dict[str, Any]) -> dict[str, Any]:
    kind = outcome.get("kind")
    return outcome | {"kind": _OUTCOME_KINDS.get(str(kind), kind)}


def _alternative(alternative: dict[str, Any]) -> dict[str, Any]:
    named = {_ALTERNATIVE.get(key, key): value for key, value in alternative.items()}
    if isinstance(named.get("measures"), dict):
        named["measures"] = {_MEASURES.get(key, key): value for key, value in named["measures"].items()}
    return named


def _each(values: Any, rename: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """Return a list with every entry renamed; what is no list of entries is left to the validation."""
    if not isinstance(values, list):
        return values
    return [rename(each) if isinstance(each, dict) else each for each in values]
