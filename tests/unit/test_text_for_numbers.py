"""Settings that are numbers refuse text in words."""

from dataclasses import fields

import pytest

import commonlaw as cl

METHODS = (cl.TrajectoryLikelihood, cl.DerivativeRegression, cl.WeakRegression, cl.DiscreteTimeRegression)
NUMBERS = [(method, each.name) for method in METHODS for each in fields(method) if type(each.default) in (int, float)]


@pytest.mark.parametrize(("method", "name"), NUMBERS, ids=[f"{method.__name__} {name}" for method, name in NUMBERS])
def test_text_is_no_number(method, name):
    with pytest.raises(cl.CommonlawError) as raised:
        method(**{name: "2"})
    assert "'2'" in str(raised.value)
    assert name in str(raised.value).replace(" ", "_") or raised.value.code == name.replace("_", "-")
