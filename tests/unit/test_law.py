"""Laws: their text, right-hand sides, trajectories and files, the ranges that they know, and their comparison."""

import json
import re
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
import sympy
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic, Outcome, OutcomeKind
from commonlaw.differentiation import CenteredDifference, parse_differentiation
from commonlaw.integration import Event, Inputs, VectorField
from commonlaw.law import (
    Law,
    PlausibleLaw,
    Provenance,
    Uncertainty,
    from_json,
    select_objects,
    to_frame,
    to_json,
    to_latex,
    to_sympy,
)
from commonlaw.law.parameters import coefficient_units, named_parameters
from commonlaw.law.provenance import Domain
from commonlaw.library import PolynomialLibrary, Variables, parse_library
from commonlaw.likelihood import ErrorModel
from commonlaw.trials import Schema, Trial, Trials
from commonlaw.verdict import find
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


def test_a_law_has_at_most_28_members_beside_its_fields():
    names = {field.name for field in fields(Law)}
    assert len([name for name in dir(Law) if not name.startswith("_") and name not in names]) <= 28


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


def test_names_for_coefficients_avoid_the_names_of_variables():
    terms = PolynomialLibrary(1).bind(Variables(("a", "c")))
    law = Law(terms, Schema(("a", "c")), 1, ("one", "two"), np.ones((2, 2, 3)))
    assert law.structure == ("a' = b + d a + f c", "c' = g + h a + i c")


def test_the_frame_has_a_row_for_each_object_and_a_column_for_each_term(drag, predators):
    frame = to_frame(drag)
    assert frame.loc["light"].to_dict() == {"1": -9.34, "v": 0.0466}
    columns = [tuple(column) for column in to_frame(predators).columns]
    assert columns == [("x'", "x"), ("x'", "x y"), ("y'", "y"), ("y'", "x y")]


def test_latex(drag, predators):
    assert to_latex(drag, "heavy") == "\\begin{aligned}\n\\ddot{x} &= -9.8 - 0.5\\, v\n\\end{aligned}"
    assert "\\dot{y} &= -2\\, y + 0.25\\, x y" in to_latex(predators)


def test_sympy(predators):
    x, y = sympy.symbols("x y", real=True)
    forms = to_sympy(predators)
    assert [str(form) for form in forms] == ["x'", "y'"]
    assert sympy.simplify(list(forms.values())[1] - (-2.0 * y + 0.25 * x * y)) == 0


def test_units_of_coefficients(drag):
    assert coefficient_units(drag) == {("x''", "1"): "m/s²", ("x''", "v"): "1/s"}


def test_evaluation_agrees_with_the_equations(drag, predators):
    values = np.array([[30.0, -5.0, 0.1], [20.0, -15.0, 0.2]])
    np.testing.assert_allclose(drag.rhs("heavy", values)[:, 0], -9.8 - 0.5 * values[:, 1])
    x, y, t = 3.0, 2.0, 0.0
    np.testing.assert_allclose(predators.rhs("island", [[x, y, t]]), [[x - 0.5 * x * y, -2 * y + 0.25 * x * y]])


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
    assert list(found) == ["heavy", "light"]
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


def _tank(inputs=("u",), between="linear"):
    terms = parse_library(f"terms:x,{','.join(inputs)}").bind(Variables(("x",), inputs))
    schema = Schema(("x",), inputs, input_interpolation=between)
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
    with refused("simulate-with-inputs"):
        both.simulate([0, 1], [1.0])
    with refused("simulate-with-inputs", names=["w"]):
        both.simulate([0, 1], [1.0], inputs={"u": np.sin})
    with refused("unknown-name"):
        both.simulate([0, 1], [1.0], inputs={"u": np.sin, "w": 1.0, "z": 0.0})
    with refused("input-shape", shape=(3,), samples=2):
        both.simulate([0, 1], [1.0], inputs={"u": [0.0, 1.0, 2.0], "w": 1.0})


def test_a_law_is_scored_as_by_scikit_learn(predators):
    from sklearn import metrics

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
    terms = parse_library("poly:2 + terms:v*abs(v),sin(2*x)").bind(Variables(("x", "v")))
    outcomes = (Outcome(OutcomeKind.ONE_OBJECT, "heavy", "only one", "add more"),)
    provenance = Provenance(None if rule is None else parse_differentiation(rule), outcomes)
    coefficients = np.random.default_rng(0).standard_normal((1, 1, 8))
    law = Law(terms, HEIGHT, 2, ("heavy",), coefficients, provenance=provenance)
    law.save(tmp_path / "law.json")
    again = Law.load(tmp_path / "law.json")
    assert again == law
    assert again.provenance == provenance


def test_a_law_of_another_version_or_damaged_is_refused_with_its_file(drag, tmp_path):
    path, text = tmp_path / "law.json", to_json(drag)
    for damage, message in (
        (text.replace('"version": 8', '"version": 9'), Diagnostic("law-version", {"version": 9, "supported": 8})),
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


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"other_laws": [{"support": [[9]]}]}, "law-average-terms"),
        (
            {"other_laws": [{"support": [[0]], "coefficients": {"heavy": [0], "light": [0]}}]},
            "law-average-coefficients",
        ),
        ({"with_discrepancy": {"with_discrepancy": {}}}, "law-nested-discrepancy"),
    ],
)
def test_laws_in_a_law_that_do_not_fit_are_refused(drag, change, code):
    whole = json.loads(to_json(replace(drag, uncertainty=Uncertainty(other_laws=(PlausibleLaw(0.3, drag),)))))
    known = {**whole, "other_laws": []}
    if "other_laws" in change:
        change = {"other_laws": [whole["other_laws"][0] | change["other_laws"][0]]}
    else:
        change = {"with_discrepancy": {**known, "with_discrepancy": known}}
    with refused(code):
        from_json(json.dumps(whole | change))


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"order": (1, 1)}, "order-of-states"),
        ({"properties": {"cube": {"mass": 1.0}}}, "properties-of-others"),
        ({"uncertainty": Uncertainty(error_model=ErrorModel(memory=-1.0))}, "law-error-not-positive"),
    ],
)
def test_parts_that_do_not_make_a_law_are_refused(drag, change, code):
    assert drag != "a law"
    with refused(code):
        replace(drag, **change)


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
    assert drag not in (
        predators,
        select_objects(drag, ["heavy"]),
        replace(drag, coefficients=drag.coefficients * (1 + 1e-15)),
    )
    averaged = replace(drag, uncertainty=Uncertainty(other_laws=(PlausibleLaw(0.1, drag),)))
    assert averaged == from_json(to_json(averaged)) != drag


RATES = {2: ("v_x", "v_y"), (1, 2): ("v_y",)}
"""The rates by order of the law."""

ORDERS = [0, 1, *RATES]


def field(order):
    terms = PolynomialLibrary(2).bind(Variables(("x", "y", *RATES.get(order, ())), ("u",), "t"))
    coefficients = np.random.default_rng(0).standard_normal((2, len(terms)))
    coefficients[:, 3] = 0
    return VectorField(terms, coefficients, order, Inputs.of(np.array([0.4]), np.sin([[0.4]])))


def points(order):
    return np.random.default_rng(2).uniform(-1, 1, (7, 4 + len(RATES.get(order, ()))))


@pytest.mark.parametrize("order", ORDERS)
def test_derivatives_are_sums_of_terms_behind_the_rates(order):
    found, values = field(order), points(order)
    highest = found.terms.evaluate(values) @ found.coefficients.T
    expected = {
        2: np.hstack([values[:, 2:4], highest]),
        (1, 2): np.column_stack([highest[:, 0], values[:, 2], highest[:, 1]]),
    }.get(order, highest)
    np.testing.assert_allclose(found.derivatives(values), expected, atol=1e-14)
    np.testing.assert_allclose(found.linearize(values).derivatives, expected, atol=1e-14)


@pytest.mark.parametrize("order", ORDERS)
def test_one_point_is_a_row_with_the_inputs_at_its_time(order):
    found, z = field(order), np.array([0.3, -0.7, 0.2, 0.5])[: 2 + len(RATES.get(order, ()))]
    values = np.concatenate([z, [np.sin(0.4), 0.4]])[np.newaxis]
    np.testing.assert_array_equal(found.point(0.4, z), values)
    np.testing.assert_array_equal(found(0.4, z), found.derivatives(values)[0])
    np.testing.assert_allclose(found.jacobian(0.4, z), found.linearize(values).by_states[0], atol=1e-14)


@pytest.fixture(scope="module")
def drops():
    """Drops of two balls with masses."""
    drops = cl.datasets.linear_drag(noise=0.05, drag=(-0.3, -0.5), trials=1)
    return Trials(drops.trials, drops.schema, {"Ball 1": {"mass": 1.0}, "Ball 2": {"mass": 2.0}})


@pytest.fixture(scope="module")
def law(drops):
    """The law of these drops."""
    return cl.fit("x'' = -g - c v", drops)


def test_a_law_knows_the_ranges_of_what_it_was_learned_from_and_keeps_them(law, drops):
    again = from_json(to_json(law))
    table = again.provenance.domain.to_frame(again.schema.units).set_index("variable")
    heights = np.concatenate([drop.states for drop in drops])
    assert table.loc["x", ["low", "high"]].tolist() == [heights.min(), heights.max()]
    assert table.loc["v", "low"] == pytest.approx(-19.7, abs=1.0)
    assert table.loc["mass"].tolist() == [1.0, 2.0, ""]
    assert table.loc["x", "unit"] == "m"


def test_forecasts_that_leave_what_was_visited_say_so(law, drops):
    assert law.predict(drops).trials.notes == drops.notes
    beyond = law.predict(drops, times=[10.0]).trials.notes[-1]
    assert "forecasts extrapolate beyond the training data" in beyond
    assert "x reaches -" in beyond
    assert "in Ball 1, trial 1 and 1 more (training range " in beyond
    heavier = Trials(drops.trials, drops.schema, {"Ball 1": {"mass": 9.0}})
    assert "mass reaches 9 in Ball 1, trial 1 (training range 1 to 2)" in law.predict(heavier).trials.notes[-1]


def test_forecasts_beyond_the_horizon_say_so(law, drops):
    found = find(law, drops, drops.until(2.0))
    judged, verdict = found.law, found.verdict
    assert verdict is not None
    assert judged.provenance.domain.horizon == verdict.horizon
    notes = judged.predict(drops, times=[8.0]).trials.notes
    assert f"forecasts go 4.8 s ahead; reliable forecast horizon: {verdict.horizon:.3g} s" in notes
    assert "ahead" not in str(judged.predict(drops, times=[4.0]).trials.notes)


def test_rates_and_states_on_a_logarithmic_scale_are_told_as_measured():
    times = np.linspace(0.0, 2.0, 30)
    trials = Trials.from_arrays(times, 3 * np.exp(-times) * np.exp(0.01 * np.sin(50 * times)), names=["x"])
    law = cl.fit("x' = -k x", trials, log_states=["x"])
    heights = trials[0].states
    assert law.provenance.domain.to_frame(law.schema.units).iloc[0, 1:3].tolist() == pytest.approx(
        [heights.min(), heights.max()]
    )


def test_rates_of_long_trials_are_told_by_segments_of_them():
    times = 0.02 * np.arange(20_000)
    states = np.sin(times) + 1e-3 * np.random.default_rng(0).standard_normal(20_000)
    visited = Domain.of(Trials.from_arrays(times, states), [("x", "v")]).visited
    assert visited["x"] == (states.min(), states.max())
    assert visited["v"] == pytest.approx((-1.0, 1.0), abs=0.02)


@pytest.fixture(scope="module")
def decays():
    """Three objects that decay exponentially, in white noise."""
    times, noise = np.linspace(0.0, 4.0, 40), np.random.default_rng(2)
    states = [5 * np.exp(-rate * times) + noise.normal(0, 0.05, 40) for rate in (0.5, 0.7, 1.0)]
    return cl.Trials.from_arrays([times] * 3, states, object=["a", "b", "c"])


@pytest.fixture(scope="module")
def fits(decays):
    """Return the fits of texts, each made once."""
    made = cache(lambda text: cl.fit(text, decays))
    return lambda *texts: {text: made(text) for text in texts}


def test_evidence_is_for_the_law_that_made_the_measurements(decays, fits):
    found = cl.compare(fits("x' = -k x^2", "x' = -k x", "x' = a - k x"), decays)
    assert found["law"].tolist() == ["x' = -k x", "x' = a - k x", "x' = -k x^2"]
    assert found["coefficients"].tolist() == [1, 2, 1]
    assert found["2 log B"].iloc[2] > 50
    assert found["probability"].sum() == pytest.approx(1)


def test_a_coefficient_that_is_known_costs_nothing(decays):
    one = decays.select(object="a")
    laws = {name: cl.fit(text, one) for name, text in (("known", "x' = -0.5 x"), ("free", "x' = -k x"))}
    found = cl.compare(laws, one, noise={"x": 0.05}).set_index("law")
    assert found.loc["known", "coefficients"] == 0
    # One free number costs log 40 and the bit of its factor, and gains a chi-squared of one degree of freedom
    assert 0 < found.loc["free", "2 log B"] < np.log(40) + 2 * np.log(2)


def test_laws_of_different_measurements_are_refused(decays, fits):
    pair = cl.Law.from_text("x' = y; y' = -k x", {"k": 1.0})
    with refused("laws-of-other-states"):
        cl.compare([*fits("x' = -k x").values(), pair], decays)


def test_laws_of_different_orders_are_compared(decays, fits):
    found = cl.compare(fits("x' = -k x", "x'' = -k v", "x'' = -k x"), decays).set_index("law")["2 log B"]
    assert list(found.index) == ["x' = -k x", "x'' = -k v", "x'' = -k x"]
    assert 6 < found["x'' = -k v"] < found["x'' = -k x"]  # Of second order, rates at starts are found besides


def test_laws_without_coefficients_are_compared(decays, fits):
    laws = fits("x' = 0", "x' = -0.7 x", "x' = -k x")
    found = cl.compare(laws, decays)
    assert found["law"].tolist() == [*laws][::-1]
    assert laws["x' = 0"].uncertainty.noise[0] > 0
    assert found["coefficients"].tolist() == [1, 0, 0]
    assert str(laws["x' = 0"]).splitlines()[0] == "x' = 0"
    assert from_json(to_json(laws["x' = 0"])).structure == ("x' = 0",)
    assert np.array_equal(cl.Law.from_text("x' = 0").simulate([0.0, 1.0], [2.0])["object"].states[:, 0], [2.0, 2.0])


def test_the_residuals_of_all_objects_tell_the_noise_of_few_samples_each():
    times, generator = np.array([0.0, 1.0, 2.0, 4.0, 7.0, 10.0]), np.random.default_rng(5)
    states = [a / (1 + 0.5 * a * times) + 0.03 * generator.standard_normal(6) for a in np.linspace(1.5, 4, 8)]
    vials = cl.Trials.from_arrays([times] * 8, states, object=list("abcdefgh"))
    laws = {"first": cl.fit("x' = -k x", vials), "second": cl.fit("x' = -k x^2", vials)}
    table = cl.compare(laws, vials).set_index("law")["2 log B"]

    def left(curve):
        """The sum of squares that a curve of two parameters leaves of all vials, by least squares."""
        fits = (least_squares(lambda p, state=state: curve(*p) - state, [state[0], 0.3]) for state in states)
        return 2 * sum(fit.cost for fit in fits)

    ratio = left(lambda a, k: a * np.exp(-k * times)) / left(lambda a, k: a / (1 + a * k * times))
    # With the noise integrated out, of 48 measurements and 16 parameters
    assert (48 - 16) * np.log(ratio) < table["first"] < 48 * np.log(ratio)
    assert table["second"] == 0


def test_the_equations_of_a_law_are_read_once():
    law = cl.Law.from_text("s' = -V s/(K + s)", {"V": 1.0, "K": 2.0})
    assert named_parameters(law).products is named_parameters(law).products


def test_a_law_with_other_equations_has_their_parameters():
    law = Law.from_text("x'' = -g - c v", {"g": 9.81, "c": 0.2})
    renamed = replace(law, provenance=replace(law.provenance, equations=("x'' = -a - b v",)))
    assert named_parameters(renamed).names == ("a", "b")
    assert named_parameters(replace(law, coefficients=2 * law.coefficients)).names == ("g", "c")
    assert named_parameters(replace(law, provenance=Provenance())).names == ("a", "b")
    wider = parse_library("terms:1,v,v^2").bind(law.terms.variables)
    with refused("law-terms-and-equations"):
        replace(law, terms=wider, coefficients=np.ones((1, 1, 3)), uncertainty=Uncertainty())
