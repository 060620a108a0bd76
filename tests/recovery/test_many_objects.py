"""The law of many objects with one short trial each."""

import numpy as np

import commonlaw as cl


def test_what_objects_have_in_common_is_found_among_many():
    # From rest at one height, v^2 and x are nearly functions of each other, and many laws fit nearly as well
    drag = -np.random.default_rng([1, 30]).uniform(0.1, 0.8, 30)
    drops = cl.datasets.linear_drag(drag=tuple(drag), trials=1, noise=0.2, seed=1)
    law = cl.discover(drops, order=2, library="poly:2")
    assert law.structure == ("x'' = a + b v",)
    errors = law.standard_errors[:, 0, law.terms.index("v")]
    misses = (law.coefficients[:, 0, law.terms.index("v")] - drag) / errors
    assert np.sqrt(np.mean(misses**2)) < 1.5
