"""Exponents of growth, and the law of the trials that grow."""

import pytest

import commonlaw as cl
from benchmarks import growth


@pytest.mark.parametrize("method", ["default", "regression"])
def test_methods_find_the_law_of_the_ring(method):
    law = cl.discover(growth.ring(4, 500), order=1, library="poly:1", method=growth.METHODS[method]())
    assert law.structure == ("x1' = a x2", "x2' = b x1 + c x2 + d x3", "x3' = f x4", "x4' = g x1 + h x3 + i x4")


def test_an_exponent_above_its_limit_ends_with_an_error(monkeypatch):
    costs = {"seconds": lambda size: size**1.5, "memory": lambda size: float(size)}
    monkeypatch.setattr(growth, "measured", lambda *run: growth.Cost(*(of(run[-1]) for of in costs.values())))
    with pytest.raises(SystemExit, match="default over samples"):
        growth.main(["--axis", "samples"])
    costs["seconds"] = lambda size: size**0.9
    growth.main(["--axis", "samples"])
