"""Which of many columns of labels is the finest, in time that grows with their number."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.trials.columns import Table
from commonlaw.trials.recognition import _determines, _finest


def finest_by_pairs(codes):
    """Return the columns that no other determines, but for an equal one after them."""
    names = list(codes)
    return [
        name
        for i, name in enumerate(names)
        if not any(
            _determines(codes[other], codes[name]) and (j < i or not _determines(codes[name], codes[other]))
            for j, other in enumerate(names)
            if j != i
        )
    ]


@pytest.mark.parametrize("seed", range(20))
def test_the_finest_columns_are_those_that_no_other_determines(seed):
    generator = np.random.default_rng(seed)
    codes = {str(i): generator.integers(0, 4, 8) for i in range(4)}
    for i in range(6):
        source = codes[str(generator.integers(0, len(codes)))]
        codes[str(len(codes))] = generator.integers(0, 3 + i, 4)[np.minimum(source, 3)]
    assert _finest(codes) == finest_by_pairs(codes)


def test_properties_of_one_label_are_compared_with_it_alone(monkeypatch):
    calls = []

    def counted(codes, others):
        calls.append(1)
        return _determines(codes, others)

    monkeypatch.setattr("commonlaw.trials.recognition._determines", counted)
    label = np.repeat(np.arange(8), 3)
    properties = {str(bits): bits >> label & 1 for bits in range(1, 128)}
    assert _finest({"name": label, **properties}) == ["name"]
    assert len(calls) <= len(properties)


def test_columns_are_asked_once_whether_they_are_numeric(monkeypatch):
    calls = []
    asked = Table.is_numeric

    def counted(table, name):
        calls.append(name)
        return asked(table, name)

    monkeypatch.setattr(Table, "is_numeric", counted)
    words = {f"w{i}": np.random.default_rng(i).choice(["a", "b", "c"], 20) for i in range(60)}
    cl.Trials.from_frame({"t": np.arange(20.0), "x": np.arange(20.0) ** 2, **words})
    assert len(calls) < 30 * len(words)
