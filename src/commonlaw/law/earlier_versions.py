"""Saved laws of earlier versions of the schema, by the names of version 3."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from commonlaw.law.provenance import Alternative

_BAYES_FACTOR = "2 log B"
_UNCERTAINTY = {
    "covariance": "covariance",
    "common": "shared_factor",
    "noise": "noise",
    "inclusion": "inclusion_probabilities",
}
_PROVENANCE = ("differentiation", "outcomes", "alternatives", "history")
_ALTERNATIVES = {"settings": "hyperparameters", "evidence lost": _BAYES_FACTOR}


def renamed(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document of version 1 or 2, which need not be valid, by the names of version 3."""
    moved = {*_UNCERTAINTY, *_PROVENANCE}
    provenance = {key: document[key] for key in _PROVENANCE if key in document}
    for key, rename in (("outcomes", _outcome), ("alternatives", _alternative)):
        if isinstance(provenance.get(key), list):
            provenance[key] = [rename(each) for each in provenance[key]]
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


def _outcome(outcome: Any) -> Any:
    known = isinstance(outcome, dict) and outcome.get("kind") == "not obeyed"
    return outcome | {"kind": "model error"} if known else outcome


def _alternative(value: Any) -> Any:
    """Return an alternative, or the measures in it, by the present names."""
    if not isinstance(value, dict):
        return value
    return {_ALTERNATIVES.get(key, key): _alternative(each) for key, each in value.items()}
