import re
from dataclasses import replace

import numpy as np
import pytest
import sympy
from sklearn import metrics

from commonlaw.diagnostics import Diagnostic
from commonlaw.differentiation import CenteredDifference, parse_differentiation
from commonlaw.integration import Event
from commonlaw.law import Law, PlausibleLaw, Provenance, Uncertainty, from_json, to_frame, to_json, to_sympy
from commonlaw.law.parameters import coefficient_units
from commonlaw.library import PolynomialLibrary, Variables, parse_library
from commonlaw.outcomes import Outcome, OutcomeKind
from commonlaw.trials import Schema, Trial, Trials
from tests.refusals import refused

HEIGHT = Schema(("x",), object="ball", trial="drop", units={"x": "m", "t": "s"})


@pytest.fixture
def drag():
    terms = PolynomialLibrary(2).bind(Variables(("x", "v")))
    coefficients = np.zeros((2, 1, len(terms)))
    coefficients[:, 0, terms.index("1")] = [-9.8, -9.34]
    coefficients[:, 0, terms.index("v")] = [-0.5, 0.0466]
    return Law(terms, HEIGHT, 2, ("heavy", "light"), coefficients, provenance=Provenance(CenteredDifference()))


@pytest.fixture
def predators():
    terms = PolynomialLibrary(2).bind(Variables(("x", "y")))
    coefficients = np.zeros((1, 2, len(terms)))
    coefficients[0, 0, [terms.index("x"), terms.index("x y")]] = [1.0, -0.5]
    coefficients[0, 1, [terms.index("y"), terms.index("x y")]] = [-2.0, 0.25]
    return Law(terms, Schema(("x", "y")), 1, ("island",), coefficients)


def test_equations_as_text(drag, predators):
    assert drag.equations("light") == ("x'' = -9.34 + 0.0466 v",)
    assert predators.equations() == ("x' = 1 x - 0.5 x y", "y' = -2 y + 0.25 x y")


def test_a_law_without_terms_says_zero(drag):
    empty = Law(drag.terms, HEIGHT, 2, ("heavy",), np.zeros((1, 1, len(drag.terms))))
    assert empty.equations() == ("x'' = 0",)
    assert to_frame(empty).shape == (1, 0)


def test_print_shows_the_shared_form_and_each_objects_coefficients(drag):
    assert str(drag) == (
        "x'' = a + b v\n\n       a [m/s²]  b [1/s]\nheavy      -9.8     -0.5\nlight     -9.34   0.0466\n\nwith v = x'"
    )


def test_the_short_form_names_the_objects_and_the_equations(drag, predators):
    assert repr(drag) == "<Law of heavy, light: x'' = a + b v>"
    assert repr(predators) == "<Law of island: x' = a x + b x y; y' = c y + d x y>"


def test_print_shows_each_object_when_they_share_no_form(drag):
    own = drag.coefficients.copy()
    own[1, 0, drag.terms.index("v")] = 0
    text = str(Law(drag.terms, HEIGHT, 2, drag.objects, own))
    assert "heavy:\n  x'' = -9.8 - 0.5 v\nlight:\n  x'' = -9.34\n" in text


def test_letters_for_coefficients_avoid_the_names_of_variables():
    terms = PolynomialLibrary(1).bind(Variables(("a", "c")))
    law = Law(terms, Schema(("a", "c")), 1, ("one", "two"), np.ones((2, 2, 3)))
    assert law.structure == ("a' = b + d a + f c", "c' = g + h a + i c")


def test_the_frame_has_a_row_for_each_object_and_a_column_for_each_term(drag, predators):
    frame = to_frame(drag)
    assert frame.loc["light"].to_dict() == {"1": -9.34, "v": 0.0466}
    columns = [tuple(each) for each in to_frame(predators).columns]
    assert columns == [("x'", "x"), ("x'", "x y"), ("y'", "y"), ("y'", "x y")]


def test_latex(drag, predators):
    assert drag.to_latex("heavy") == "\\begin{aligned}\n\\ddot{x} &= -9.8 - 0.5\\, v\n\\end{aligned}"
    assert "\\dot{y} &= -2\\, y + 0.25\\, x y" in predators.to_latex()


def test_sympy(predators):
    x, y = sympy.symbols("x y", real=True)
    forms = to_sympy(predators)
    assert [str(left) for left in forms] == ["x'", "y'"]
    assert sympy.simplify(list(forms.values())[1] - (-2.0 * y + 0.25 * x * y)) == 0


def test_units_of_coefficients(drag):
    assert coefficient_units(drag) == {("x''", "1"): "m/s²", ("x''", "v"): "1/s"}


def test_evaluation_agrees_with_the_equations(drag, predators):
    values = np.array([[30.0, -5.0, 0.1], [20.0, -15.0, 0.2]])
    np.testing.assert_allclose(drag.rhs("heavy", values)[:, 0], -9.8 - 0.5 * values[:, 1])
    x, y, t = 3.0, 2.0, 0.0
    np.testing.assert_allclose(predators.rhs("island", [[x, y, t]]), [[x - 0.5 * x * y, -2 * y + 0.25 * x * y]])


def test_simulation_of_all_objects_agrees_with_the_exact_solution(drag):
    times = np.linspace(0, 3, 31)
    found = drag.simulate(times, [47.33, 0.0])
    assert list(found) == ["heavy", "light"]
    for name, (gravity, own) in zip(found, [(-9.8, -0.5), (-9.34, 0.0466)], strict=True):
        exact = 47.33 - gravity / own * times + gravity / own**2 * (np.exp(own * times) - 1)
        np.testing.assert_allclose(found[name].states[:, 0], exact, rtol=1e-7)


def test_simulation_from_each_objects_own_initial_state(drag):
    found = drag.simulate([0.0, 1.0], {"light": [10.0, 2.0]})
    assert list(found) == ["light"]
    assert found["light"].states[0].tolist() == [10.0, 2.0]
    with refused("initial-state-size", given=1, expected=2, names="x, v", where="heavy"):
        drag.simulate([0.0, 1.0], {"heavy": [10.0]})
    with refused("unknown-name", kind="object of this law", name="hevy"):
        drag.simulate([0.0, 1.0], {"hevy": [10.0, 0.0]})


@pytest.mark.parametrize("method", ["auto", "scipy"])
def test_simulation_finds_when_each_object_reaches_the_ground(drag, method):
    ground = Event("x", direction="falling", terminal=True)
    found = drag.simulate([0.0, 2.0, 4.0], [20.0, 0.0], method=method, events=[ground], dense=True, sensitivities=True)
    for name, each in found.items():
        gravity, own = drag.coefficients[drag.objects.index(name)][0, [drag.terms.index("1"), drag.terms.index("v")]]

        def height(t, gravity=gravity, own=own):
            return 20 - gravity / own * t + gravity / own**2 * (np.exp(own * t) - 1)

        assert height(each.ended) == pytest.approx(0, abs=1e-6)
        assert each.events[0].times.tolist() == [each.ended]
        np.testing.assert_allclose(each.at([1.0])[0, 0], height(1.0), rtol=1e-7)
        assert each.sensitivities.shape == (3, 2, 4)
        by_gravity = (np.exp(own * 2) - 1 - own * 2) / own**2
        assert each.outcome is None
        if each.ended > 2:
            assert each.sensitivities[1, 0, 0] == pytest.approx(by_gravity, rel=1e-6)


def test_a_law_with_inputs_is_driven_by_the_measured_inputs():
    terms = parse_library("terms:x,u").bind(Variables(("x",), ("u",)))
    law = Law(terms, Schema(("x",), ("u",)), 1, ("tank",), np.array([[[-1.0, 1.0]]]))
    times = np.linspace(0, 5, 501)
    exact = (np.sin(times) - np.cos(times) + 3 * np.exp(-times)) / 2
    trials = Trials((Trial("tank", "1", times, exact, np.sin(times)),), law.schema)
    np.testing.assert_allclose(law.predict(trials).trajectories[0].states[:, 0], exact, atol=2e-5)
    with refused("simulate-with-inputs"):
        law.simulate([0, 1], [1.0])


def _tank(inputs=("u",), between="linear"):
    terms = parse_library(f"terms:x,{','.join(inputs)}").bind(Variables(("x",), inputs))
    schema = Schema(("x",), inputs, input_between=between)
    return Law(terms, schema, 1, ("tank",), np.array([[[-1.0, *np.ones(len(inputs))]]]))


@pytest.mark.parametrize("method", ["scipy", "auto"])
def test_a_law_is_simulated_with_inputs_that_are_given(method):
    times = np.linspace(0, 5, 11)

    def end(law, inputs):
        return law.simulate(times, [1.0], inputs=inputs, method=method, tolerance=1e-9)["tank"].states[:, 0]

    exact = (np.sin(times) - np.cos(times) + 3 * np.exp(-times)) / 2
    for sine in (np.sin, {"u": np.sin}, lambda time: [np.sin(time)]):
        np.testing.assert_allclose(end(_tank(), sine), exact, atol=1e-7)
    # x' = -x + t, and x' = -x + 2 + (t > 1.3)
    np.testing.assert_allclose(end(_tank(), times), times - 1 + 2 * np.exp(-times), atol=1e-7)
    after = np.maximum(times - 1.3, 0)
    exact = 2 - np.exp(-times) + 1 - np.exp(-after)
    both = _tank(("u", "w"))
    np.testing.assert_allclose(end(both, {"w": 2.0, "u": lambda time: time > 1.3}), exact, atol=1e-7)
    held = _tank(between="held")
    levels = np.where(times < 2.5, 1.0, 0.0)
    np.testing.assert_allclose(end(held, levels), np.exp(-np.maximum(times - 2.5, 0)), atol=1e-7)


def test_inputs_that_do_not_fit_are_refused():
    both = _tank(("u", "w"))
    with refused("simulate-with-inputs", names=["w"]):
        both.simulate([0, 1], [1.0], inputs={"u": np.sin})
    with refused("unknown-name"):
        both.simulate([0, 1], [1.0], inputs={"u": np.sin, "w": 1.0, "z": 0.0})
    with refused("input-shape", shape=(3,), samples=2):
        both.simulate([0, 1], [1.0], inputs={"u": [0.0, 1.0, 2.0], "w": 1.0})


def test_a_law_is_scored_as_by_scikit_learn(predators):
    times = np.linspace(0, 3, 31)
    (path,) = predators.simulate(times, [1.0, 2.0]).values()
    states = path.states + np.array([0.05, 0.02]) * np.random.default_rng(0).standard_normal((31, 2))
    states[0], states[7, 1] = path.states[0], np.nan
    trials = Trials((Trial("island", "1", times, states),), predators.schema)
    pairs = [(states[:, 0], path.states[:, 0]), (np.delete(states[:, 1], 7), np.delete(path.states[:, 1], 7))]
    for name, metric in {
        "r2": metrics.r2_score,
        "rmse": metrics.root_mean_squared_error,
        "mae": metrics.mean_absolute_error,
    }.items():
        expected = np.mean([metric(*pair) for pair in pairs])
        assert predators.score(trials, name) == pytest.approx(expected, rel=1e-6)
        assert predators.score(trials, metric) == pytest.approx(expected, rel=1e-6)
    with refused("unknown-name"):
        predators.score(trials, "r3")


@pytest.mark.parametrize("rule", ["savgol:35:3", "finite:4", None])
def test_a_saved_law_comes_back_whole(tmp_path, rule):
    law = Law(
        parse_library("poly:2 + terms:v*abs(v),sin(2*x)").bind(Variables(("x", "v"))),
        HEIGHT,
        2,
        ("heavy",),
        np.random.default_rng(0).standard_normal((1, 1, 8)),
        provenance=Provenance(
            differentiation=None if rule is None else parse_differentiation(rule),
            outcomes=(Outcome(OutcomeKind.ONE_OBJECT, "heavy", "only one", "add more"),),
        ),
    )
    law.save(tmp_path / "law.json")
    again = Law.load(tmp_path / "law.json")
    assert again.terms == law.terms
    assert (again.schema, again.order, again.objects) == (law.schema, law.order, law.objects)
    np.testing.assert_array_equal(again.coefficients, law.coefficients)
    assert again.provenance.differentiation == law.provenance.differentiation
    assert again.diagnostics == law.diagnostics


def test_a_law_of_another_version_or_damaged_is_refused_with_its_file(drag, tmp_path):
    path, text = tmp_path / "law.json", to_json(drag)
    for damage, message in (
        (text.replace('"version": 4', '"version": 9'), Diagnostic("law-version", {"version": 9, "supported": 4})),
        (text[:200], "not-a-law"),
        ("[1, 2]", "not-a-law"),
        (text.replace("-9.8", "null"), "not-a-law"),
        (text.replace('"x*v"', '"__import__"'), "unknown-name"),
        (
            re.sub(r'"heavy": \[\s*\[', '"heavy": [[1.5, ', text),
            Diagnostic("law-table-size", {"rows": 1, "columns": 6}),
        ),
    ):
        assert damage != text
        path.write_text(damage)
        with refused(message) as raised:
            Law.load(path)
        assert raised.value.diagnostic.where.endswith("law.json")
    with refused("file-missing", file="nowhere.json"):
        Law.load(tmp_path / "nowhere.json")


def test_trials_with_other_variables_are_refused(drag):
    trials = Trials((Trial("heavy", "1", [0, 1, 2], [1.0, 2.0, 3.0]),), Schema(("height",)))
    with refused("columns-differ", kind="states"):
        drag.predict(trials)


def test_coefficients_are_checked_and_cannot_be_changed(drag):
    with pytest.raises(ValueError, match="read-only"):
        drag.coefficients[0, 0, 0] = 1
    with refused("law-array-shape", axes="objects, equations, terms"):
        Law(drag.terms, HEIGHT, 2, ("one",), np.zeros((1, 2, 6)))


def test_laws_are_equal_by_what_they_are(drag, predators):
    same = from_json(to_json(drag))
    assert same == drag
    assert hash(same) == hash(drag)
    assert replace(drag, provenance=Provenance()) == drag
    assert drag not in (predators, drag.select(["heavy"]), replace(drag, coefficients=drag.coefficients * (1 + 1e-15)))
    averaged = replace(drag, uncertainty=Uncertainty(other_laws=(PlausibleLaw(0.1, drag),)))
    assert averaged == from_json(to_json(averaged)) != drag
