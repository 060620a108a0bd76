"""Powers of variables that take few values are in no library beside the lower powers that they are sums of."""

import numpy as np
import pytest

from commonlaw.library import AutoLibrary, CappedLibrary, Variables, parse_library

VARIABLES = Variables(("x",), ("u",))


@pytest.mark.parametrize(
    ("library", "count", "names"),
    [
        ("poly:3", 2, ["1", "x", "u", "x^2", "x u", "x^3", "x^2 u"]),
        ("poly:3", 3, ["1", "x", "u", "x^2", "x u", "u^2", "x^3", "x^2 u", "x u^2"]),
        ("poly:2", 1, ["1", "x", "x^2"]),
        ("terms:x,u^2", 2, ["x", "u^2"]),
    ],
)
def test_powers_go_that_are_sums_of_lower_ones_in_the_library(library, count, names):
    terms = CappedLibrary(parse_library(library), (("u", count),)).bind(VARIABLES)
    assert list(terms.names) == names


def test_what_goes_is_what_measurements_cannot_tell():
    generator = np.random.default_rng(0)
    values = np.column_stack([generator.standard_normal(50), generator.choice([0.3, 2.0], 50), np.arange(50.0)])
    whole = parse_library("poly:3")
    capped = CappedLibrary(whole, (("u", 2),))
    columns, fewer = (each.bind(VARIABLES).evaluate(values) for each in (whole, capped))
    assert np.linalg.matrix_rank(columns) == np.linalg.matrix_rank(fewer) == fewer.shape[1] < columns.shape[1]


def test_what_is_offered_besides_stays():
    capped = CappedLibrary(AutoLibrary(), (("u", 2),))
    assert [each.count for each in capped.offers(VARIABLES)] == [each.count for each in AutoLibrary().offers(VARIABLES)]
    assert capped.higher is not None
    assert "u^4" not in capped.higher.bind(VARIABLES).names
    assert capped.higher.higher is None
    assert capped.seeks_latent_states
