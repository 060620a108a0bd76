"""What one object's trials do not tell of parameters inside of terms is taken from objects that are alike."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law.parameters import named_parameters
from tests.simulations import solved

SWITCH = "p' = b - d p + a p^2/(K^2 + p^2)"
PARAMETERS = ("b", "d", "a", "K")
OWN = {
    "A": (0.10, 0.60, 1.2, 0.65),
    "B": (0.14, 0.65, 1.3, 0.70),
    "C": (0.12, 0.55, 1.0, 0.60),
    "D": (0.08, 0.50, 1.3, 0.55),
    "E": (0.10, 0.50, 1.2, 0.60),
}
STARTS = dict.fromkeys("ABCD", (0.05, 1.5)) | {"E": (1.9, 3.0)}  # Where E has been its switch is on


@pytest.fixture(scope="module")
def switches():
    def rate(_, p, b, d, a, half):
        return b - d * p + a * p**2 / (half**2 + p**2)

    times, generator, made = np.linspace(0, 12, 40), np.random.default_rng(3), []
    for name, numbers in OWN.items():
        for k, start in enumerate(STARTS[name]):
            exact = solved(rate, [start], times, *numbers)
            made.append(cl.Trial(name, str(k), times, exact + 0.005 * generator.standard_normal(exact.shape)))
    return cl.Trials(tuple(made), cl.Schema(("p",)))


def test_an_object_that_does_not_tell_a_constant_leaves_others_as_they_are_and_takes_it_from_them(switches):
    law, alone = (cl.fit(SWITCH, switches, partial_pooling=pooling, errors="white") for pooling in (True, False))
    parameters = named_parameters(law)
    values = parameters.values[:, [parameters.names.index(name) for name in PARAMETERS]]
    truth = np.array(list(OWN.values()))
    parameters = named_parameters(alone)  # In the order of its own names
    errors = parameters.errors[:, [parameters.names.index(name) for name in PARAMETERS]]
    values[:, 3] = np.abs(values[:, 3])
    assert (np.abs(values - truth)[:4] < 4 * errors[:4]).all()
    assert values[4, 3] == pytest.approx(0.6, abs=0.2)
    again = cl.refine(law, switches, partial_pooling=True, errors="white")
    np.testing.assert_allclose(again.coefficients, law.coefficients, rtol=0.1)
    (outcome,) = (diagnostic for diagnostic in alone.diagnostics if diagnostic.kind == "not identifiable")
    assert outcome.where == "E"
