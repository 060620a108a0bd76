import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.law import to_frame
from commonlaw.law.law import object_index
from tests.refusals import refused


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(noise=0.01, trials=3)


SETTINGS = {"order": 2, "library": "poly:2"}


def regression(**settings):
    return cl.DerivativeRegression(**{"differentiation": "savgol:25:3", "trim": 8} | settings)


def rows(law, trials, name):
    """Return heights with speeds, and accelerations, as a law of strong form has them of an object."""
    form = cl.formulation.StrongForm(law.provenance.differentiation, 2, trim=8)
    return (np.concatenate(parts) for parts in zip(*map(form.samples, trials.of_object(name)), strict=True))


def test_every_choice_can_be_an_object_or_its_text(drops):
    by_text = cl.discover(
        drops,
        order=2,
        library="poly:3",
        method=cl.DerivativeRegression(differentiation="savgol:35:3", solver="group-stlsq:1.5"),
    )
    by_object = cl.discover(
        drops,
        order=2,
        library=cl.library.PolynomialLibrary(3),
        method=cl.DerivativeRegression(
            differentiation=cl.differentiation.SmoothedDifference(
                cl.differentiation.SavitzkyGolay(35, 3), cl.differentiation.CenteredDifference()
            ),
            solver=cl.solvers.STLSQ(threshold=1.5),
        ),
    )
    np.testing.assert_array_equal(by_text.coefficients, by_object.coefficients)
    default = cl.discover(
        drops,
        order=2,
        library=cl.library.PolynomialLibrary(3),
        method=cl.DerivativeRegression(solver=cl.solvers.STLSQ(threshold=1.5)),
    )
    np.testing.assert_array_equal(by_text.coefficients, default.coefficients)


def test_coefficients_equal_plain_least_squares_on_all_rows_of_an_object(drops):
    law = cl.discover(drops, method=regression(solver="group-stlsq:1.5"), **SETTINGS)
    assert [name for name, used in zip(law.terms.names, law.support[0], strict=True) if used] == ["1", "v"]
    for name in drops.objects:
        values, targets = rows(law, drops, name)
        expected = np.linalg.lstsq(np.column_stack([np.ones(len(values)), values[:, 1]]), targets[:, 0], rcond=None)[0]
        np.testing.assert_allclose(law.coefficients[object_index(law, name)][0][law.support[0]], expected, rtol=1e-10)


def test_known_terms_are_moved_to_the_left_hand_side(drops):
    law = cl.discover(
        drops, method=regression(solver="stlsq:0.01"), known={"1": -9.8}, **SETTINGS | {"library": "terms:1,v"}
    )
    assert (to_frame(law)["1"] == -9.8).all()
    for name in drops.objects:
        values, targets = rows(law, drops, name)
        drag = values[:, 1] @ (targets[:, 0] + 9.8) / (values[:, 1] @ values[:, 1])
        assert to_frame(law).loc[name, "v"] == pytest.approx(drag, rel=1e-10)


def test_known_terms_may_differ_between_objects_and_equations(drops):
    own = dict(zip(drops.objects, [-0.1, -0.3, -0.3, -0.5, -0.7], strict=True))
    law = cl.discover(drops, method=regression(solver="group-stlsq:1"), known={("x", "v"): own}, **SETTINGS)
    assert to_frame(law)["v"].to_dict() == own
    assert to_frame(law)["1"].to_numpy() == pytest.approx(-9.8, abs=0.02)


def test_a_first_order_law_of_several_states():
    trials = cl.datasets.nonlinear_oscillator()
    law = cl.discover(
        trials,
        library="poly:3",
        method=cl.DerivativeRegression(differentiation="finite:6", solver="stlsq:0.05"),
        order=1,
    )
    assert law.equations(digits=3) == ("x' = -0.1 x^3 + 2 y^3", "y' = -2 x^3 - 0.1 y^3")
    held = cl.discover(
        trials,
        library="poly:3",
        method=cl.DerivativeRegression(differentiation="finite:6", solver="stlsq:0.05"),
        known={("x", "y^3"): 2.0},
        order=1,
    )
    assert held.equations(digits=3) == law.equations(digits=3)


@pytest.mark.parametrize("method", [None, cl.DerivativeRegression(), cl.WeakRegression()])
def test_states_whose_powers_vanish_are_refused_with_a_way_out(method):
    times = np.linspace(0, 4, 40)
    states = 1e-170 * np.exp(-times[:, np.newaxis])
    tiny = cl.Trials((cl.Trial("object", "1", times, states),), cl.Schema(("x",)))
    with refused("state-too-large", state="x"):
        cl.discover(tiny, library="poly:2", method=method, order=1)


def test_one_forecast_that_diverges_does_not_decide_a_comparison():
    times = np.linspace(0, 1, 30)
    trials = cl.Trials.from_arrays([times] * 9, [a / (1 - a * times) for a in np.linspace(0.1, 0.9, 9)])
    model = cl.LawDiscovery(library="poly:2", order=1)
    assert repr(model).startswith("LawDiscovery(order=1, library='poly:2', ")
    scores = []
    for text in ("x' = 1.13 x^2", "x' = 0.5"):
        model.law_ = cl.Law.from_text(text)
        scores.append(model.score(trials))
        assert model.score(trials, start=1) == scores[-1]
    assert cl.Law.from_text("x' = 1.13 x^2").predict(trials).score() == -np.inf
    assert scores[0] > 0.3 + scores[1]


def test_the_estimator_follows_scikit_learn(drops):
    from sklearn.base import clone

    model = cl.LawDiscovery(method=regression(solver=cl.solvers.STLSQ(1.5)), **SETTINGS)
    copy = clone(model)
    assert copy.get_params() == model.get_params()
    assert copy.set_params(method__trim=4) is copy
    assert copy.method.trim == 4
    assert model.method.trim == 8
    assert copy.set_params(method__solver="best-subset:2", method__solver__nodes=9).method.solver.nodes == 9
    copy.set_params(method=model.method)
    assert copy.fit(drops) is copy
    assert copy.score(drops) == copy.predict(drops).bounded_score() > 0.99
    with refused("unknown-name", kind="parameter", name="treshold"):
        copy.set_params(treshold=1)
    with refused("unknown-name", kind="parameter of method__solver", name="treshold"):
        copy.set_params(method__solver__treshold=1)
    with refused("no-parameter", name="method", value=None, path="trim"):
        cl.LawDiscovery(order=1, library="poly:3").set_params(method__trim=1)
    with refused("not-fitted"):
        model.predict(drops)


def test_the_threshold_is_chosen_by_held_out_trials(drops):
    from sklearn.model_selection import GridSearchCV, GroupKFold

    search = GridSearchCV(
        cl.LawDiscovery(method=regression(solver=cl.solvers.STLSQ()), **SETTINGS),
        {"method__solver__threshold": [20, 1.5, 1000]},
        cv=GroupKFold(3),
    )
    search.fit(drops, groups=[trial.name for trial in drops])
    assert search.best_params_ == {"method__solver__threshold": 1.5}
    assert search.best_estimator_.law_.objects == drops.objects


@pytest.mark.parametrize(
    ("one", "settings", "solver", "kind"),
    [
        (False, {}, "group-stlsq:1e6", "empty support"),
        (True, {}, "group-stlsq:0.05", "one object"),
        (False, {"library": "terms:v,v+1e-9*x"}, "group-stlsq:0", "ill-conditioned"),
    ],
)
def test_what_makes_a_regression_doubtful_is_a_diagnostic(drops, one, settings, solver, kind):
    law = cl.discover(drops[:1] if one else drops, method=regression(solver=solver), **SETTINGS | settings)
    assert kind in {diagnostic.kind for diagnostic in law.diagnostics}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"differentiation": "savgol:51:3"},
            Diagnostic("window-too-long", {"count": 49, "window": 51}, "Ball 1, trial 1"),
        ),
        ({"trim": 30}, Diagnostic("trim-too-long", {"samples": 49, "trim": 30}, "Ball 1, trial 1")),
        ({"trim": -1}, Diagnostic("trim-not-a-number", {"trim": -1})),
        ({"solver": "laso"}, Diagnostic("unknown-name", {"kind": "solver", "name": "laso"})),
        ({"differentiation": "savgoal"}, Diagnostic("unknown-name", {"kind": "differentiation", "name": "savgoal"})),
        ({"library_states": "raw"}, Diagnostic("library-states", {"library_states": "raw"})),
        ({"rule": "bci"}, Diagnostic("unknown-name", {"kind": "rule", "name": "bci"})),
        ({"scoring": "forecast"}, Diagnostic("unknown-name", {"kind": "scoring", "name": "forecast"})),
    ],
)
def test_settings_of_a_method_that_do_not_fit_are_refused_with_place_and_remedy(drops, settings, message):
    with refused(message):
        cl.discover(drops, method=regression(**settings), **SETTINGS)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"order": 3}, Diagnostic("order-not-offered", {"order": 3})),
        ({"order": "2"}, Diagnostic("order-not-offered", {"order": "2"})),
        ({"order": 2.0}, Diagnostic("argument-type", {"name": "order", "kind": "float"})),
        ({"order": [2]}, "order-not-offered"),
        ({"order": {"x": 2.0}}, Diagnostic("argument-type", {"name": "order of x", "kind": "float"})),
        (
            {"order": 0},
            Diagnostic(
                "order-of-method",
                {"order": 0, "method": "DerivativeRegression", "alternative": "DiscreteTimeRegression"},
            ),
        ),
        ({"library": "poly:2 + fuorier:1"}, Diagnostic("unknown-name", {"kind": "library", "name": "fuorier"})),
        ({"library": "terms:1,1/(t - t)"}, Diagnostic("term-not-finite", {}, "Ball 1, trial 1")),
        ({"known": {"w": 1.0}}, Diagnostic("unknown-name", {"kind": "term", "name": "w"})),
        ({"known": {("y", "1"): 1.0}}, Diagnostic("unknown-name", {"kind": "state", "name": "y"})),
        ({"known": {"1": {"Ball 1": 1.0}}}, Diagnostic("known-coefficient-missing", {"term": "1"})),
    ],
)
def test_structures_that_do_not_fit_are_refused_with_place_and_remedy(drops, settings, message):
    with refused(message):
        cl.discover(drops, method=regression(), **SETTINGS | settings)


@pytest.mark.parametrize("method", [cl.TrajectoryLikelihood(), cl.WeakRegression(), cl.DiscreteTimeRegression()])
def test_a_method_refuses_an_order_or_a_stream_that_it_does_not_take(drops, tmp_path, method):
    drops.to_parquet(tmp_path / "drops.parquet")
    stream, name = cl.TrialStream.from_parquet(tmp_path / "drops.parquet"), type(method).__name__
    order = 1 if 0 in method.orders else 0
    with refused("order-of-method", order=order, method=name):
        cl.discover(drops, order=order, method=method, library="poly:3")
    if isinstance(method, cl.WeakRegression):
        with refused("stream-unsupported", method=name):
            cl.discover(stream, order=2, method=method, library="poly:3")


def test_a_state_that_never_changes_is_refused():
    times = np.arange(50.0)
    rolling = cl.Trial("rock", "1", times, np.column_stack([times, np.full(50, 3.0)]))
    flying = cl.Trial("ball", "1", times, np.column_stack([times, times**2]))
    with refused("state-constant-of-object", state="y", name="rock"):
        cl.discover(
            cl.Trials((flying, rolling), cl.Schema(("x", "y"))),
            method=cl.DerivativeRegression(differentiation="finite"),
            order=1,
            library="poly:3",
        )


def test_without_a_solver_the_law_is_chosen_and_the_candidates_are_shown(drops, tmp_path):
    law = cl.discover(
        drops, order=2, method=cl.DerivativeRegression(differentiation="savgol:25:3", trim=8), library="poly:3"
    )
    assert law.structure == ("x'' = a + b v",)
    assert "chosen" in {diagnostic.kind for diagnostic in law.diagnostics}
    candidates = law.comparison
    assert candidates["chosen"].sum() == 1
    assert candidates.loc[candidates["chosen"], ["terms", "size"]].to_numpy().tolist() == [["1, v", 2]]
    assert {"AIC", "AICc", "BIC", "EBIC", "standard error", "stability"} <= set(candidates.columns)
    assert {*candidates["measure"]} == {"held-out error"}
    law.save(tmp_path / "law.json")
    assert cl.Law.load(tmp_path / "law.json").provenance.alternatives == law.provenance.alternatives


@pytest.mark.parametrize(
    "rule", ["held-out", "bic", *(pytest.param(rule, marks=pytest.mark.slow) for rule in ("aic", "aicc", "ebic"))]
)
def test_a_solver_without_its_setting_offers_its_path_to_any_rule(rule):
    pairs = cl.datasets.lotka_volterra()
    law = cl.discover(
        pairs,
        library="poly:2",
        method=cl.DerivativeRegression(differentiation="finite:6", solver=cl.solvers.STLSQ(), rule=rule),
        order=1,
    )
    assert law.structure == ("x' = a x + b x y", "y' = c y + d x y")


def test_a_stream_is_chosen_from_like_trials(drops, tmp_path):
    drops.to_parquet(tmp_path / "drops.parquet")
    stream = cl.TrialStream.from_parquet(tmp_path / "drops.parquet")
    settings = {"order": 2, "method": regression()}
    np.testing.assert_array_equal(
        cl.discover(stream, **settings).coefficients, cl.discover(drops, **settings).coefficients
    )


def test_a_universal_term_has_one_coefficient_for_all_objects(drops):
    settings = {"order": 2, "shared": ["1"]}
    named = cl.discover(drops, library="poly:2", method=regression(solver="group-stlsq:1.5"), **settings)
    chosen = cl.discover(drops, method=regression(), **settings)
    for law in (named, chosen):
        assert law.structure == ("x'' = a + b v",)
        assert np.ptp(to_frame(law)["1"]) < 1e-12
        assert to_frame(law)["1"].iloc[0] == pytest.approx(-9.8, rel=0.01)
    own = cl.discover(drops, library="poly:2", method=regression(solver="group-stlsq:1.5"), **settings | {"shared": ()})
    assert np.ptp(to_frame(own)["1"]) > 1e-3


def test_universal_terms_of_several_equations_are_named_with_their_state():
    pairs = cl.datasets.lotka_volterra(decline=1.1, noise=0.0)
    method = cl.DerivativeRegression(differentiation="finite:6", solver="group-stlsq:0.2")
    settings = {"library": "poly:2", "method": method}
    law = cl.discover(pairs, shared=[("y", "y")], **settings)
    assert np.ptp(to_frame(law)["y'", "y"]) < 1e-12
    assert np.ptp(to_frame(law)["x'", "x"]) > 0.1
    with refused("known-term-ambiguous", key="y", state="x"):
        cl.discover(pairs, shared=["y"], **settings)


def test_candidates_can_be_judged_by_forecasts_of_held_out_trials():
    pairs = cl.datasets.lotka_volterra(
        growth=[1.0, 0.8], predation=0.1, decline=1.2, reproduction=0.06, noise=0.02, samples=100
    )
    method = cl.DerivativeRegression(
        differentiation="savgol:9:3", solver=cl.solvers.STLSQ(), n_resamples=0, scoring="forecasts"
    )
    law = cl.discover(pairs, library="poly:2", method=method, order=1)
    assert law.structure == ("x' = a x + b x y", "y' = c y + d x y")
    with refused("one-trial-to-forecast"):
        cl.discover(pairs.select(trial=1), library="poly:2", method=method, order=1)


def test_what_is_no_table_is_refused_with_the_way_to_trials():
    with refused("frame-unknown", type="str"):
        cl.discover("drops.csv", order=1, library="poly:3")
