"""Whatever a simple law is like, everything that shows or writes it works: without error and without a warning."""

import random

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import Law, to_latex
from commonlaw.plots import plot_coefficients, plot_intervals

FACTORS = ("", "2 ", "-2 ", "0 ", "0.0 ", "1e-12 ", "1e90 ", "3e5 ", "1e-300 ", "k ", "-k ", "k*", "+", "-")
FORMS = (
    "{}", "{}**0", "{}^1", "{}**2", "{}^-1", "1/{}", "sin({})", "exp(-{})", "exp({})", "abs({})", "sqrt({})", "log({})",
    "1", "{}/(1+{})", "{}^0.5", "tanh({})", "{}^9", "sign({})", "{}*{}",
)  # fmt: skip
LAWS = (
    "x'' = +x", "x ' = 2 + -2 x", "x' = x**0", "x' = 0 x", "x' = 1", "x' = k x", "x'' = -1e90 x'",
    "x' = " + " + ".join(f"exp({i} x)" for i in range(1, 21)), "x' = 1e90 x^9 - 1e-140", "x[k+1] = -x",
    "x' = 1/x - x^-1.5", "x' = +y; y' = -0.0 - +x", "x' = y/(1e-300 + x); y' = 2 x^0 - y",
)  # fmt: skip


def drawn(seed):
    """Return the text of a random law: with blanks, signs, powers of zero, constants alone, large and small numbers."""
    r = random.Random(seed)
    states, mark = ["x", "y", "z"][: r.choice([1, 1, 2, 3])], r.choice(["'", "''", "[k+1]"])
    names = [*states, "t", "1", *(f"{state}'" for state in states if mark == "''")]
    equations = []
    for state in states:
        right = r.choice(["", "+", "-", " - "])
        for i in range(r.randint(1, 3)):
            form, name = r.choice(FORMS), r.choice(names)
            right += r.choice([" + ", " - ", "+", "-", " +"]) * bool(i) + r.choice(FACTORS) + form.format(name, name)
        equations.append(f"{state}{r.choice(['', ' '])}{mark}{r.choice(['', ' '])}={r.choice(['', ' '])}{right}")
    return "; ".join(equations)


def law_of(text):
    """Return the law of a text; None if the same term stands twice in it."""
    try:
        return Law.from_text(text, {"k": 0.5} if "k " in text.replace("[k+1]", "") or "k*" in text else {})
    except cl.CommonlawError as error:
        if error.code != "term-twice":
            raise
        return None


def show(law, folder):
    """Show and write a law in every way; what a format cannot hold is refused."""
    assert repr(law)
    assert str(law)
    assert to_latex(law)
    assert str(law.params) + str(law.quantities) + str(law.summary()) + str(law.equations())
    assert "<math" in law._repr_html_() or "<pre" in law._repr_html_()
    assert plot_intervals(law)
    assert plot_coefficients(law)
    law.save(folder / "law.json")
    assert Law.load(folder / "law.json") == law
    for ending in ("c", "py", "m", "mo", "xml", "xlsx"):
        try:
            law.save(folder / f"law.{ending}")
        except cl.CommonlawError as error:
            if error.code != "export-unsupported":
                raise


@pytest.mark.parametrize("text", [LAWS[0], *(pytest.param(text, marks=pytest.mark.slow) for text in LAWS[1:])])
def test_a_simple_law_is_shown_and_written(tmp_path, text):
    show(law_of(text), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_a_random_law_is_shown_and_written(tmp_path, seed):
    law = law_of(drawn(seed))
    if law is not None:
        show(law, tmp_path)


@pytest.mark.parametrize("text", LAWS[6:])
def test_a_simple_law_is_printed_and_its_equilibria_are_found(text):
    law = law_of(text)
    assert str(law)
    assert str(law.quantities)


@pytest.mark.parametrize("objects", [1, 60])
@pytest.mark.parametrize("text", LAWS[1:4])
def test_a_law_without_parameters_has_a_figure(text, objects):
    law = law_of(text)
    names = tuple(f"object {i}" for i in range(objects))
    many = Law(law.terms, law.schema, 1, names, np.tile(law.coefficients, (objects, 1, 1)), provenance=law.provenance)
    assert plot_intervals(many)


@pytest.mark.slow
@pytest.mark.parametrize("text", ["x' = x**0", "x' = -1e90 exp(x)", "x'' = +x"])
def test_a_simple_law_has_a_page(tmp_path, text):
    times = np.linspace(0, 2, 25)
    trials = cl.Trials.from_arrays(times, 1.5 + 0.5 * np.sin(3 * times), names=["x"])
    law_of(text).report(trials).save(tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size > 1000


def test_an_infinite_estimate_is_replaced_by_nothing():
    times = np.linspace(0, 5, 40)
    decay = np.exp(-times / 2.0) + 1e-3 * np.sin(40 * times)
    trials = cl.Trials.from_arrays([times, times], [decay, decay], names=["x"], object=["a", "b"])
    law = cl.fit("x' = -x/V", trials)
    coefficients = law.coefficients[:1] * np.array([1.0, -1.0]).reshape(2, 1, 1)  # Zero on average, V is infinite
    infinite = Law(law.terms, law.schema, 1, law.objects, coefficients, law.uncertainty, law.provenance, law.properties)
    assert infinite.simplify().replaced == ()
