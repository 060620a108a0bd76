"""Saved laws of earlier versions of the schema, by the names of version 4."""

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


def as_now(document: dict[str, Any], version: int) -> dict[str, Any]:
    """Return a document of an earlier version, which need not be valid, by the names of version 4.

    Version 3 lacks what else a law could be, and the degrees of freedom of its noise.
    """
    found = _with_widening(_renamed(document) if version < 3 else {**document, "version": 4})
    others = found.get("other_laws")
    if isinstance(others, list):
        found |= {"other_laws": [_with_widening(each) if isinstance(each, dict) else each for each in others]}
    wider = found.get("with_discrepancy")
    return found | {"with_discrepancy": _with_widening({**wider, "version": 4})} if isinstance(wider, dict) else found


def _with_widening(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document whose factor of intervals, if its errors have one, is a widening that no horizon changes."""
    known = document.get("uncertainty")
    errors = known.get("error_model") if isinstance(known, dict) else None
    if not (isinstance(known, dict) and isinstance(errors, dict) and "widening" in errors):
        return document
    factor = errors["widening"]
    left = {"error_model": {name: each for name, each in errors.items() if name != "widening"} or None}
    wider = known.get("widening") or (None if factor == 1 else {"horizons": [0.0], "factors": [factor]})
    return document | {"uncertainty": known | left | {"widening": wider}}


def _renamed(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document of version 1 or 2."""
    moved = {*_UNCERTAINTY, *_PROVENANCE}
    provenance = {key: document[key] for key in _PROVENANCE if key in document}
    for key, rename in (("outcomes", _outcome), ("alternatives", _alternative)):
        if isinstance(provenance.get(key), list):
            provenance[key] = [rename(each) for each in provenance[key]]
    return {
        **{key: value for key, value in document.items() if key not in moved},
        "version": 4,
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
