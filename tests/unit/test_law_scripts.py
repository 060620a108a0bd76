"""A law as a program that finds it again."""

import numpy as np
import pytest

import commonlaw as cl


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), trials=1, noise=0.05)


def rerun(law, drops, folder):
    path = folder / "drops.csv"
    drops.to_csv(path)
    scope = {}
    exec(law.to_script(str(path)), scope)
    return scope["law"]


@pytest.mark.parametrize(
    "find",
    [
        lambda drops: cl.discover(drops, order=2, library="poly:1"),
        lambda drops: cl.discover(
            drops,
            order=2,
            library=cl.PolynomialLibrary(1),
            known={("x", "1"): -9.8},
            method=cl.DerivativeRegression(differentiation="savgol:25:3", solver=cl.STLSQ(0.05)),
        ),
        lambda drops: cl.fit("x'' = -9.8 - c v", drops, errors="white", noise={"x": 0.05}),
        lambda drops: cl.refine(cl.fit("x'' = -g - c v", drops), drops, huber_threshold=3.0),
        lambda drops: cl.fit("x'' = -g - c v", drops).explain([]),
    ],
)
def test_the_program_finds_the_law_again(find, drops, tmp_path, capsys):
    law = find(drops)
    again = rerun(law, drops, tmp_path)
    assert again.terms.names == law.terms.names
    np.testing.assert_array_equal(again.coefficients, law.coefficients)
    assert (again.explanation is None) == (law.explanation is None)
    assert str(law) in capsys.readouterr().out


def test_a_saved_law_keeps_its_program(drops):
    law = cl.fit("x'' = -g - c v", drops)
    assert cl.Law.from_json(law.to_json()).to_script() == law.to_script()


def test_a_law_of_unknown_making_is_fitted():
    law = cl.Law.from_text("T' = -k (T - 20)", {"k": 0.1})
    assert 'law = cl.fit("T\' = -k (T - 20)", trials)' in law.to_script()
