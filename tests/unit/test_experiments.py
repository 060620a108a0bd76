"""Experiments: settings, Gaussian densities, and designs held against simulation."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal, norm

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.experiments import suggestions
from commonlaw.experiments.design import usual
from commonlaw.experiments.experiment import Range
from commonlaw.experiments.gaussian import Draws, Evidence, Gaussian
from commonlaw.experiments.predictive import Hypothesis, refitted
from commonlaw.experiments.search import MAX_REPEATS, Search
from commonlaw.forecast.initial_state import model_error_std
from commonlaw.integration import Inputs
from commonlaw.law.population import with_objects_of
from commonlaw.law.uncertainty import PlausibleLaw
from commonlaw.library import Terms, Variables
from commonlaw.likelihood import ErrorModel
from tests.known_laws import NOISE, falling, known, said
from tests.refusals import refused

THROWN = {"x": 1, "v": 0, "duration": 1, "rate": 5}


def test_gravity_is_best_measured_at_ends_and_middle():
    """Height is a parabola of time, whose curvature is told best at both ends and in between, once to twice to once."""
    designs = {
        "closed form": (0.0, 0.999, 1.001, 2.0),
        "even": (0.0, 0.667, 1.333, 2.0),
        "ends": (0.0, 0.001, 1.999, 2.0),
        "start": (0.0, 0.5, 1.0, 2.0),
    }
    found = cl.design(falling(), {"x": 10, "v": 0, "times": list(designs.values())}, about="g")
    assert found.experiments[0].experiment.settings["times"] == designs["closed form"]
    # With weights 1/4, 1/2, 1/4 over 4 samples the variance of the curvature, -g/2, is that of x(0) - 2 x(1) + x(2)
    variance = 4 * (NOISE**2 * (1 + 4 / 2 + 1)) / 4
    assert found.experiments[0].std == pytest.approx((1 + 1 / variance) ** -0.5, rel=1e-3)


def test_what_is_said_of_measurements_agrees_with_forecasts():
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3), trials=1, noise=0.05)
    law = cl.fit("x'' = -g - c v", drops, partial_pooling=False)
    settings = {"x": 40.0, "v": -1.0, "duration": 2.0, "samples": 9.0, "object": "Ball 2"}
    found = said(law, settings)
    forecast = cl.forecast.forecast_from(law, "Ball 2", np.linspace(0, 2, 9), np.array([40.0, -1.0]))
    np.testing.assert_allclose(found.mean, forecast.trajectories[0].states[:, 0], rtol=1e-6)
    assert forecast.std is not None
    np.testing.assert_allclose(np.linalg.norm(found.by_unknowns, axis=1), forecast.std[0][:, 0], rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(found.noise, np.asarray(law.uncertainty.noise) ** 2 * np.ones(9))
    assert found.coloured is None


@pytest.mark.parametrize(
    "errors",
    [ErrorModel(walk=np.array([0.1, 0.2])), ErrorModel(force=np.array([0.5]), force_time=0.7)],
    ids=["walk", "force"],
)
def test_errors_of_the_law_add_up_as_in_forecasts(errors):
    law = known("x'' = -g - c v", {"g": 9.8, "c": 0.3}, np.zeros((2, 2)), errors=errors)
    times = np.linspace(0, 2, 61)
    found = said(law, {"x": 40.0, "v": 0.0, "times": tuple(times), "object": "ball"})
    trial = cl.Trial("ball", "1", times, np.full((61, 1), 1.0))
    states = law.simulate(times, [40.0, 0.0])["ball"].states
    wanted = model_error_std(law, trial, Inputs.of(times, np.empty((61, 0))), states)[:, 0]
    np.testing.assert_allclose(np.sqrt(np.diag(found.coloured))[10:], wanted[10:], rtol=0.05)


def test_a_law_has_no_bands_from_where_it_has_no_derivatives():
    law = known("x' = -a/x", {"a": 1.0}, [[0.0]], errors=ErrorModel(walk=np.array([0.1])))
    times, states = np.arange(4.0), np.array([[1.0], [0.25], [0.0], [0.25]])
    trial = cl.Trial("ball", "1", times, states)
    found = model_error_std(law, trial, Inputs.of(times, np.empty((4, 0))), states)[:, 0]
    assert np.isfinite(found[:2]).all()
    assert np.isinf(found[3])


def test_repeats_reach_what_they_promise():
    laws = [falling(1e-3), known("x'' = -g - c v", {"g": 9.8, "c": 0.1}, np.diag([1e-6, 0.0]))]
    vary = {"x": 10, "v": 0, "duration": 1, "rate": 10}
    found = cl.design(laws, vary)
    assert found.repeats is not None
    assert found.repeats > 1
    often = cl.design(laws, {**vary, "repeats": found.repeats})
    assert often.chance == pytest.approx(0.95, abs=0.02)
    assert cl.design(laws, {**vary, "repeats": found.repeats // 2}).chance < 0.95


@pytest.mark.slow
def test_laws_that_imitate_each_other_are_not_told_apart():
    laws = [known(text, {"a": 1.0}, [[1.0]], inputs=("u",)) for text in ("x' = a", "x' = a u")]
    vary = {"x": 0, "duration": 2, "rate": 10, "u": 1}
    found = cl.design(laws, vary)
    assert not found.tells_apart
    assert "No experiment in these ranges discriminates between these laws" in str(found)
    found = cl.design(laws, {**vary, "u.shape": ["constant", "ramp"]}, experiments=4)
    assert found.tells_apart
    assert found.experiments[0].experiment.settings["u.shape"] == "ramp"
    assert len(found.experiments) == 2  # Enough to decide


def test_the_chance_is_what_happens_far_from_lines():
    """Growth at a rate that is hardly known, or by a constant: against marginal likelihoods by quadrature."""
    random, times = np.random.default_rng(7), np.linspace(0, 2, 5)
    laws = [known("x' = a x", {"a": 0.5}, [[0.36]]), known("x' = a", {"a": 1.0}, [[1.0]])]
    found = cl.design(laws, {"x": 1, "times": [times]})
    unknowns = np.linspace(-5, 5, 201)[:, np.newaxis, np.newaxis]
    starts, weights = np.linspace(0.4, 1.6, 31)[:, np.newaxis], np.exp(-(unknowns[..., 0] ** 2) / 2)
    curves = [starts * np.exp((0.5 + 0.6 * unknowns) * times), starts + (1 + unknowns) * times]
    chances = []
    for unknown, i in zip(random.normal(size=400), np.arange(400) % 2, strict=True):
        clean = np.exp((0.5 + 0.6 * unknown) * times) if i == 0 else 1 + (1 + unknown) * times
        made = clean + NOISE * random.normal(size=5)
        densities = [
            np.sum(weights * np.exp(-np.sum((made - curve) ** 2, axis=2) / (2 * NOISE**2))) for curve in curves
        ]
        chances.append(max(densities) / sum(densities))
    assert found.chance == pytest.approx(np.mean(chances), abs=0.025)


def test_several_experiments_are_the_best_together():
    """Rates tell a cubic best at both ends and at 1/sqrt(5); one by one, the third would be in the middle."""
    law = known("x' = a + b u + c u^2 + d u^3", dict.fromkeys("abcd", 1.0), np.eye(4), inputs=("u",))
    levels = [-1, -0.75, -(5**-0.5), -0.25, 0, 0.25, 5**-0.5, 0.75, 1]
    found = cl.design(law, {"x": 0, "times": [0, 1], "u": levels}, experiments=4)
    chosen = np.array([experiment.experiment.settings["u"] for experiment in found.experiments])
    np.testing.assert_allclose(np.sort(chosen), [-1, -(5**-0.5), 5**-0.5, 1])
    columns = np.vander(chosen, 4) / (np.sqrt(2) * NOISE)
    assert found.experiments[-1].bits == pytest.approx(
        np.linalg.slogdet(np.eye(4) + columns.T @ columns)[1] / 2 / np.log(2)
    )


def test_prices_decide_and_the_budget_holds():
    law = known("x' = a", {"a": 1.0}, [[1.0]], objects=("one", "two"))
    vary = {"x": 0, "duration": 1, "rate": 10}
    found = cl.design(law, vary, cost={"trial": 1, "one": 5}, experiments=5, budget=3)
    assert [experiment.experiment.objects for experiment in found.experiments] == [("two",)] * 3
    assert found.cost == 3
    with refused("design-too-expensive", budget=0.5, cheapest=1.0):
        cl.design(law, vary, budget=0.5)
    with refused("design-trials-by-name"):
        cl.design(law, cl.datasets.linear_drag(trials=1))


def test_each_object_makes_a_trial():
    law = known("x' = a", {"a": 1.0}, [[1.0]], objects=("one", "two"))
    vary = {"x": 0, "duration": 1, "rate": 10}
    both = cl.design(law, {**vary, "object": "each"})
    alone = cl.design(law, {**vary, "object": "one"})
    assert both.experiments[0].experiment.objects == ("one", "two")
    assert both.cost == 2 * alone.cost
    assert both.experiments[0].bits == pytest.approx(2 * alone.experiments[0].bits)


def test_a_trial_ends_where_it_leaves_its_limits():
    found = cl.design(falling(), {"x": 20, "v": 0, "duration": 4, "rate": 20}, within={"x": "0..100"})
    ended = found.experiments[0].experiment.times[-1]
    assert found.to_frame().loc[0, "duration"] == ended
    assert ended == pytest.approx(np.sqrt(2 * 20 / 9.8), abs=0.1)


def test_a_forecast_is_asked_for():
    law = known("x'' = -g", {"g": 9.8}, [[0.01]])
    times = np.linspace(0, 1, 21)
    found = cl.design(law, {"x": 10, "v": 0, "times": [times]}, about="x at t=10 from 100, 0")
    assert found.aim.quantity is not None
    assert found.aim.quantity.values[0] == pytest.approx(100 - 9.8 * 50)
    assert found.aim.quantity.std(np.ones(1)) == pytest.approx(0.1 * 50)
    columns = np.column_stack([times**2 / 2, np.ones(21), times]) / NOISE
    information = 1 / np.linalg.inv(columns.T @ columns)[0, 0]
    assert found.experiments[0].std == pytest.approx(50 / np.sqrt(100 + information), rel=1e-5)


def test_new_objects_have_coefficients_by_their_properties():
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), noise=0.3, trials=1)
    masses = {name: {"mass": mass} for name, mass in zip(drops.objects, [0.3, 0.1, 0.06], strict=True)}
    laws = [cl.fit(text, drops).explain(masses) for text in ("x'' = -g - c v", "x'' = -g + b v^2")]
    vary = {"x": 40, "v": 0, "duration": 2, "samples": 5, "object.mass": 0.2}
    (found,) = cl.design(laws, vary).experiments
    assert "a new object with mass = 0.2" in found.text
    trial = cl.Trial("new", "1", [0.0], [[40.0]])
    wanted, _ = with_objects_of(laws[0], cl.Trials((trial,), drops.schema, {"new": {"mass": 0.2}}))
    states = wanted.simulate(np.linspace(0, 2, 5), [40.0, 0.0], sensitivities=True)["new"]
    np.testing.assert_allclose(found.forecasts.means[0, :, 0], states.states[:, 0], rtol=1e-4)
    slopes, covariance = states.sensitivities[:, 0, :-2], wanted.uncertainty.covariance[0]
    variances = np.einsum("ni,ij,nj->n", slopes, covariance, slopes) + laws[0].uncertainty.noise[0] ** 2
    np.testing.assert_allclose(found.forecasts.std[0, :, 0], np.sqrt(variances), rtol=1e-3)
    with refused("setting-not-a-property"):
        cl.design(laws[0], {**vary, "object.colour": "0..1"})


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ({"x": "5..60"}, Diagnostic("setting-missing", {"settings": "v=0..1, duration=1..5, rate=10..100"})),
        ({"x": "5..60", "w": 1}, Diagnostic("unknown-name", {"kind": "setting of an experiment", "name": "w"})),
        ({"x": "60..5"}, "setting-range"),
        ({"x": "high"}, Diagnostic("setting-syntax", {"name": "x", "value": "high"})),
        (
            {**THROWN, "duration": -1},
            Diagnostic("setting-too-small", {"name": "duration", "value": -1.0, "least": 0.0}),
        ),
        ({**THROWN, "object": "cube"}, Diagnostic("unknown-name", {"kind": "object of this law", "name": "cube"})),
        ({**THROWN, "object": "ball", "object.mass": 1}, "setting-object-twice"),
        ({**THROWN, "object.mass": 1}, Diagnostic("setting-without-properties", {"name": "object.mass"})),
        ({**THROWN, "x": []}, Diagnostic("setting-empty", {"name": "x"})),
        ({**THROWN, "x": np.inf}, Diagnostic("setting-not-finite", {"name": "x"})),
        ({**THROWN, "samples": 2e6}, Diagnostic("experiment-too-many-samples", {"count": 2e6})),
        ({"x": 1, "v": 0, "times": [[3, 1]]}, "experiment-times"),
    ],
)
def test_settings_that_cannot_be_are_refused(vary, message):
    with refused(message):
        cl.design(falling(), vary)


DRIVEN = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))


@pytest.mark.parametrize(
    ("laws", "about", "code"),
    [
        (cl.Law.from_text("x'' = -g", {"g": 9.8}), None, "uncertainty-unknown"),
        (replace(falling(), uncertainty=replace(falling().uncertainty, noise=None)), None, "noise-unknown"),
        (cl.Law.from_text("x[k+1] = a x", {"a": 0.9}), None, "discrete-between-samples"),
        (DRIVEN, "x at t=1 from 1", "design-forecast-with-inputs"),
        (known("x' = a x^2", {"a": 1.0}, [[1.0]]), "x at t=9 from 1", "design-forecast-diverges"),
        ([], None, "design-without-laws"),
    ],
)
def test_laws_whose_forecasts_have_no_errors_are_refused(laws, about, code):
    names = laws.terms.variables.names[:-1] if laws else ()
    with refused(code):
        cl.design(laws, {"duration": 1, "rate": 5, **dict.fromkeys(names, 1)}, about=about)


def test_a_coefficient_of_an_object_without_experiments_is_refused():
    law = known("x'' = -g", {"g": 9.8}, [[1.0]], objects=("ball", "cube"))
    with refused("unknown-name", name="cube"):
        cl.design(law, {**THROWN, "object": "ball"}, about="g of cube")


def test_a_design_shows_itself_in_a_notebook():
    shown = cl.design(falling(), THROWN)._repr_html_()
    assert "Next experiment" in shown
    assert "bits" in shown


def test_what_to_measure_next_is_suggested_within_what_was_visited():
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3), trials=1, noise=0.5)
    law = cl.fit("x'' = -g - c v", drops)
    found = suggestions(law, drops, most=2)
    assert [*found] == [
        "To know all coefficients better",
        "To know c of Ball 1 better, the coefficient that is known worst",
    ]
    low, high = law.provenance.domain.visited["x"]
    for made in found.values():
        assert len(made.experiments) == 2
        assert all(low <= experiment.experiment.start[0] <= high for experiment in made.experiments)
    assert suggestions(cl.Law.from_text("x'' = -g", {"g": dict.fromkeys(drops.objects, 9.8)}), drops) == {}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
def test_starts_by_default_do_not_cross_zero_from_measurements_of_one_sign(scheme, sign):
    times, begins = np.arange(8.0), (0.0, 3.0)
    values = [sign * np.maximum(0.0, begin + times - 1) for begin in begins]  # After a lag
    trials = cl.Trials.from_arrays([times] * 2, values, names=["c"])
    law = cl.fit("c' = q", trials, scheme=scheme, errors="white", n_jobs=1)
    starts = [states[0, 0] for states in law.predict(trials, start="all").solutions]
    assert min(sign * start for start in starts) < -0.1
    proposed = usual(law, trials)["c"]
    assert isinstance(proposed, Range)
    assert (proposed.low if sign > 0 else proposed.high) == 0


def test_suggestions_refit_rivals_to_few_measurements(monkeypatch):
    times = np.linspace(0, 2, 9)
    trials = cl.Trials.from_arrays(times, np.exp(0.5 * times), object="ball", names=["x"])
    law, rival = known("x' = a x", {"a": 0.5}, [[0.1]]), known("x' = a", {"a": 1.5}, [[0.1]])
    doubtful = replace(law, uncertainty=replace(law.uncertainty, other_laws=(PlausibleLaw(0.4, rival),)))
    refits, refit = [], Hypothesis.refitted

    def counted(self, *given):
        refits.append(len(given[2]))
        return refit(self, *given)

    monkeypatch.setattr(Hypothesis, "refitted", counted)
    aims = [design.aim for design in suggestions(doubtful, trials).values()]
    assert [aim.of_law for aim in aims] == [True, False]
    assert 0 < sum(refits) < 1000


@pytest.mark.parametrize("enough", [1, 2, 3, 63, 80, 99, 100, 101])
@pytest.mark.parametrize("off", [-2, 0, 1, 40])
def test_repeats_are_as_few_as_settle_the_law(enough, off):
    """Chances by linearization are those of more or fewer repeats."""
    simulated = []

    def chance(made, _):
        simulated.extend(times for candidate in made if (times := candidate.simulated_times))
        return float(made[0].times >= enough)

    def repeated(times):
        return Mock(times=times, simulated_times=times, linearized=Mock(times=times + off, simulated_times=None))

    search = Mock(chance=chance)
    assert Search.repeats(search, [Mock(repeated=repeated)]) == (enough if enough <= MAX_REPEATS else None)
    assert len(simulated) <= 4 or off or enough == 100


def test_a_fit_ends_whose_steps_lead_nowhere():
    """A law that diverges but near its start, and measurements far from what it can be."""
    tried = []

    def linearise(_, points):
        tried.extend(points)
        return [
            Gaussian(point[:1], np.eye(1), np.zeros((1, 0)), np.array([1e-6])) if abs(point[0]) < 1e-9 else None
            for point in points
        ]

    begin = np.zeros(1)
    (found,) = refitted(linearise(0, [begin]), [begin], [np.array([1e9])], linearise)
    assert found.mean == [0.0]
    assert len(tried) < 6


NOTHING = np.zeros((1, 0))


def point(mean, slopes, noise=1.0):
    """Return what a hypothesis says of one measurement without a start of its own."""
    return Gaussian(np.array([mean]), np.array([slopes], dtype=float), NOTHING, np.array([noise**2]))


def test_evidence_is_that_of_normal_densities():
    random = np.random.default_rng(0)
    parts = [
        Gaussian(random.normal(size=5), random.normal(size=(5, p)), np.zeros((5, 0)), random.uniform(1, 2, 5))
        for p in (2, 3)
    ]
    draws = Draws.of((2, 3), 5, 4, (1,), 0)
    found = Evidence.of(parts, draws)
    for i, (made, unknown) in enumerate(zip(parts, draws.unknowns, strict=True)):
        values = made.mean + unknown @ made.by_unknowns.T + draws.noise @ made.root.T
        for k, part in enumerate(parts):
            wanted = multivariate_normal(part.mean, np.diag(part.noise) + part.by_unknowns @ part.by_unknowns.T).logpdf(
                values
            )
            np.testing.assert_allclose(found.log_densities[i, :, k] - 2.5 * np.log(2 * np.pi), wanted, rtol=1e-10)


def test_a_free_start_is_the_limit_of_a_wide_prior():
    random = np.random.default_rng(2)
    times = np.linspace(0, 1, 8)
    starts = np.column_stack([np.ones(8), times])
    parts = [Gaussian(random.normal(size=8), random.normal(size=(8, 1)), starts, np.ones(8)) for _ in range(2)]
    draws = Draws.of((1, 1), 8, 5, (3,), 0)
    found = Evidence.of(parts, draws).log_densities
    wide = [
        Gaussian(part.mean, np.column_stack([part.by_unknowns, 1e4 * starts]), np.zeros((8, 0)), part.noise)
        for part in parts
    ]
    made = Draws(tuple(np.column_stack([unknown, np.zeros((5, 2))]) for unknown in draws.unknowns), draws.noise)
    limit = Evidence.of(wide, made).log_densities
    np.testing.assert_allclose(np.diff(found, axis=2), np.diff(limit, axis=2), atol=1e-5)


def test_chance_and_information_of_two_known_means():
    parts, prior, apart = [point(0.0, []), point(1.5, [])], np.array([0.5, 0.5]), 1.5
    found = Evidence.of(parts, Draws.of((0, 0), 1, 200_000, (0,), 0))
    assert found.chance(prior) == pytest.approx(norm.cdf(apart / 2), abs=2e-3)
    grid = np.linspace(-9, 11, 20001)
    one, two = norm.pdf(grid), norm.pdf(grid - apart)
    mixed = (one + two) / 2
    wanted = np.trapezoid(-mixed * np.log(mixed) + one * np.log(one) / 2 + two * np.log(two) / 2, grid)
    assert found.information_about_law(prior) == pytest.approx(wanted, abs=3e-3)


def test_repeats_count_as_independent_measurements():
    repeated = Gaussian(np.zeros(3), np.ones((3, 1)), np.zeros((3, 0)), np.ones(3), repeats=4)
    draws = Draws.of((1,), 3, 2, (0,), 0)
    (gain,) = Evidence.of([repeated], draws).gain()
    assert gain == pytest.approx(np.log(1 + 12) / 2)


def weight(points, shares, noise, truth, rival):
    """Return the weight of evidence for a truth against what imitates it by coefficients of columns, at its means."""
    found = []
    for x, share in zip(points, shares, strict=True):
        level = noise / np.sqrt(share)
        hypotheses = [point(truth(x), [], level), point(0.0, 1e3 * np.array(rival(x)), level)]
        found.append(Evidence.of(hypotheses, Draws((np.zeros((1, 0)), np.zeros((1, len(rival(x))))), np.zeros((1, 1)))))
    total = found[0]
    for each in found[1:]:
        total += each
    return float(total.log_densities[0, 0, 0] - total.log_densities[0, 0, 1])


def test_discrimination_agrees_with_the_published_t_optimal_design():
    """Atkinson and Fedorov (1975), Biometrika 62, example 1: 4.5 - 1.5 exp(x) - 2 exp(-x) against a parabola.

    Measured at -1, -0.669, 0.144 and 0.957 with weights 0.253, 0.428, 0.247 and 0.072.
    """
    support, shares = np.array([-1, -0.669, 0.144, 0.957]), np.array([0.253, 0.428, 0.247, 0.072])
    noise = 1e-5

    def value(at, weights):
        found = weight(at, weights, noise, lambda x: 4.5 - 1.5 * np.exp(x) - 2 * np.exp(-x), lambda x: [1, x, x**2])
        return 2 * noise**2 * found

    best = value(support, shares)
    assert best == pytest.approx(1.087e-3, rel=2e-3)
    # A measurement elsewhere brings nowhere more than those that are there (the equivalence theorem)
    points, small = np.linspace(-1, 1, 41), 1e-4
    more = [value(np.append(support, x), np.append((1 - small) * shares, small)) for x in points]
    assert max(more) < (1 + 1e-5) * best
    assert value(points, np.full(41, 1 / 41)) < 0.7 * best


def test_fits_to_lines_are_the_lines():
    """Where a law is linear, lines about other coefficients and another start say the same of all measurements."""
    random = np.random.default_rng(2)
    matrices = [(random.normal(size=6), random.normal(size=(6, 2)), random.normal(size=(6, 1))) for _ in range(2)]

    def linearise(k):
        mean, slopes, by_start = matrices[k]
        return lambda _, points: [
            Gaussian(mean + np.column_stack([slopes, by_start]) @ each, slopes, by_start, np.full(6, 0.04))
            for each in points
        ]

    draws = Draws.of((2, 2), 6, 5, (0,), 0)
    begin = np.zeros(3)
    lines = [linearise(k)(0, [begin])[0] for k in range(2)]
    made = [line.mean + unknown @ line.by_unknowns.T for line, unknown in zip(lines, draws.unknowns, strict=True)]
    measured = [row + 0.2 * noise for each in made for row, noise in zip(each, draws.noise, strict=True)]
    fits = [refitted([lines[k]] * 10, [begin] * 10, measured, linearise(k)) for k in range(2)]
    np.testing.assert_allclose(
        Evidence.about(np.array(measured), fits).log_densities, Evidence.of(lines, draws).log_densities, rtol=1e-8
    )


def test_coefficients_are_fitted_within_their_errors():
    """Of exp(u t) with u standard normal the fit is nearly that of nonlinear least squares; a line goes through it."""
    times, measured = np.linspace(0.1, 1, 8), np.exp(0.7 * np.linspace(0.1, 1, 8))

    def linearise(_, points):
        values = [np.exp(each[0] * times) for each in points]
        return [Gaussian(value, (times * value)[:, np.newaxis], np.zeros((8, 0)), np.full(8, 0.04)) for value in values]

    begin = np.zeros(1)
    (found,) = refitted(linearise(0, [begin]), [begin], [measured], linearise)

    def deviance(u):
        return np.sum((measured - np.exp(u * times)) ** 2) / 0.04 + u**2

    unknown = np.log(found.by_unknowns[0, 0] / times[0]) / times[0]
    assert deviance(unknown) < minimize_scalar(deviance).fun + 1 < deviance(0)
    np.testing.assert_allclose(found.mean, np.exp(unknown * times) * (1 - unknown * times))


@pytest.mark.parametrize("common", [None, np.full((3, 3), 0.5)], ids=["white", "common"])
def test_errors_are_turned_white(common):
    own = Gaussian(np.zeros(3), np.zeros((3, 0)), np.zeros((3, 0)), np.array([1.0, 4.0, 9.0]), common=common, repeats=4)
    turned = own.white(np.eye(3))
    covariance = np.diag([0.25, 1.0, 2.25]) + (0.0 if common is None else common)
    np.testing.assert_allclose(turned @ covariance @ turned.T, np.eye(3), atol=1e-12)


def test_errors_whose_numbers_are_too_far_apart_say_nothing():
    near, far = np.diag([1.0, 1.0]), np.array([[1e40, 1e40], [1e40, 1e40 * (1 + 1e-15)]])
    for coloured, is_finite in ((near, True), (-far, False), (np.diag([np.inf, np.inf]), False)):
        said = Gaussian(np.zeros(2), np.zeros((2, 0)), np.zeros((2, 0)), np.ones(2), coloured)
        assert said.is_finite == is_finite


def test_an_input_is_shaped_to_tell_its_coefficient():
    """x' = a u with a free start: the integral of the input has to change most, as a level that stays does."""
    law = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))
    vary = {"x": 0, "duration": 2, "samples": 9, "u": "0..2", "u.shape": ["constant", "step", "sine"], "u.period": 2}
    found = cl.design(law, vary).experiments[0]
    assert (found.experiment.settings["u"], found.experiment.settings["u.shape"]) == (2.0, "constant")
    columns = 2 * np.linspace(0, 2, 9)
    information = np.sum((columns - columns.mean()) ** 2) / NOISE**2
    assert found.bits == pytest.approx(np.log2(1 + information) / 2, rel=1e-3)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"u.shape": "1..5"}, Diagnostic("unknown-name", {"kind": "shape of an input", "name": "1..5"})),
        ({"object": "1..5"}, Diagnostic("unknown-name", {"name": "1..5"})),
    ],
)
def test_ranges_of_words_are_refused_by_name(setting, message):
    law = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))
    with refused(message):
        cl.design(law, {"x": 0, "duration": 2, "samples": 9, "u": 2, **setting})


def test_states_on_a_logarithmic_scale_start_above_zero():
    random, times = np.random.default_rng(0), np.linspace(0, 5, 40)
    states = [5 * np.exp(-rate * times + 0.05 * random.normal(size=40)) for rate in (0.5, 0.8)]
    trials = cl.Trials.from_arrays([times, times], states, object=["a", "b"], names=["x"])
    law = cl.fit("x' = -k x", trials, log_states=["x"])
    with refused("setting-not-positive"):
        cl.design(law, {"x": "0..10", "duration": 5, "rate": 5})
    found = cl.design(law, {"x": "1..10", "duration": "1..8", "rate": 5}, about="coefficients")
    assert found.experiments[0].experiment.times[-1] == 8.0


@pytest.mark.parametrize("off", [0.0, 0.02, 10.0])
def test_starts_that_are_known_count_as_measured_beforehand(off):
    times = np.linspace(0, 2, 5)
    settings = {"x": 10, "v": 0, "times": [times]}
    found = cl.design(falling(), settings, about="g", start_std={"x": off, "v": off})
    columns = np.column_stack([-(times**2) / 2, np.ones(5), times]) / NOISE
    with np.errstate(divide="ignore"):
        prior = np.diag(1 / np.array([1.0, max(off, 1e-9), max(off, 1e-9)]) ** 2)
    expected = np.sqrt(np.linalg.inv(columns.T @ columns + prior)[0, 0])
    assert found.experiments[0].std == pytest.approx(expected, rel=1e-3)


def test_repeats_begin_anew_with_errors_of_their_starts():
    """Height in 1 s is known to the error of the start, and that is another one each time."""
    settings = {"x": 0, "v": 0, "times": [[0, 1]], "repeats": 4}
    found = cl.design(falling(), settings, about="g", start_std={"x": 0, "v": 0.5})
    variance = (0.5**2 + NOISE**2) / 4 * 2**2  # g = -2 x(1)
    assert found.experiments[0].std == pytest.approx((1 + 1 / variance) ** -0.5, rel=1e-3)


def test_starts_on_a_logarithmic_scale_are_off_by_shares():
    law = known("x' = a x", {"a": -0.3}, [[0.01]], noise=0.05)
    terms = Terms(Variables(("x",), (), "t", logarithmic=("x",)), law.terms.terms)
    law = replace(law, terms=terms, schema=replace(law.schema, logarithmic=("x",)))
    found = cl.design(law, {"x": 4, "times": [[0, 2]]}, about="a", start_std={"x": 0.2})
    columns = np.array([[0, 1], [2, 1]]) / 0.05  # log x = log x(0) + a t
    expected = np.linalg.inv(columns.T @ columns + np.diag([100, (4 / 0.2) ** 2]))[0, 0] ** 0.5
    assert found.experiments[0].std == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"start_std": {"x": "0.1"}}, "setting-negative"),
        ({"start_std": {"x": None}}, "setting-negative"),
        ({"cost": {"trial": "one"}}, "setting-negative"),
        ({"start_std": {"x": -1}}, Diagnostic("setting-negative", {"name": "the start of x is off by", "value": -1})),
        ({"start_std": {"y": 0}}, Diagnostic("unknown-name", {"name": "y"})),
        ({"experiments": 0}, "design-count"),
        ({"within": {"x": 3}}, Diagnostic("design-range", {"name": "x"})),
        ({"about": " "}, "design-without-target"),
        ({"about": "x at t=soon from 1, 2"}, "design-forecast-syntax"),
        ({"about": "x at t=1 from 1, 2, 3"}, Diagnostic("design-forecast-numbers", {"given": 3})),
    ],
)
def test_errors_of_starts_and_prices_that_cannot_be_are_refused(given, message):
    with refused(message):
        cl.design(falling(), THROWN, **given)


@pytest.fixture
def eliminated():
    """A law by which a dose leaves, and its true trials."""
    law = known("c' = -k c + dose", {"k": 0.5}, np.diag([0.01, 0]), inputs=("dose",))
    return replace(law, schema=replace(law.schema, doses=("dose",), input_interpolation="linear"))


def test_a_dose_that_leaves_is_best_measured_after_its_mean_stay(eliminated):
    """Box and Lucas 1959: of D exp(-k t) one sample tells k best at t = 1/k."""
    settings = {"c": 0, "dose": 3, "times": [[0, t] for t in (0.5, 1, 2, 3, 4)]}
    found = cl.design(eliminated, settings, about="k", start_std={"c": 0})
    assert found.experiments[0].experiment.settings["times"] == (0, 2)
    slope = 2 * 3 * np.exp(-0.5 * 2) / NOISE
    assert found.experiments[0].std == pytest.approx((100 + slope**2) ** -0.5, rel=1e-3)
    assert "dose of 3 after 0, 2 samples over 2" in found.experiments[0].text


def test_doses_are_given_when_and_as_often_as_is_set(eliminated):
    when = {"dose.at": 1.0, "dose.every": 2.0, "times": (0.0, 0.5, 2.0, 4.5)}
    found = said(eliminated, {"object": "ball", "c": 0.0, "dose": 3.0, **when})
    expected = [0, 0, 3 * np.exp(-0.5), 3 * np.exp(-0.5 * 3.5) + 3 * np.exp(-0.5 * 1.5)]
    np.testing.assert_allclose(found.mean, expected, atol=1e-3)


def test_a_dose_after_the_last_sample_is_none(eliminated):
    found = cl.design(eliminated, {"c": 0, "dose": 3, "dose.at": 5, "duration": 5, "rate": 2})
    assert "no dose" in found.experiments[0].text
    assert found.experiments[0].bits == pytest.approx(0)


def test_settings_and_doses_are_those_of_trials_by_default():
    times = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0])
    random = np.random.default_rng(0)
    states, doses, since = [], [], times - 1
    for amount in (2.0, 4.0):
        doses.append(np.where(times == 1, amount, 0.0)[:, np.newaxis])
        clean = np.where(since > 0, amount * np.exp(-0.5 * since), 0.0)
        states.append((clean + 0.02 * random.normal(size=6))[:, np.newaxis])
    trials = cl.Trials.from_arrays([times] * 2, states, inputs=doses, names=["c", "dose"])
    law = cl.fit("c' = -k c + dose", trials, doses="dose")
    (found,) = cl.design(law, {}, trials=trials).experiments
    settings = found.experiment.settings
    assert np.min(states) <= found.experiment.start[0] <= np.max(states)
    assert 2 <= settings["dose"] <= 4
    assert settings["dose.at"] == 1
    assert (settings["duration"], settings["samples"]) == (8, 6)


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ({"dose.shape": "ramp"}, Diagnostic("unknown-name", {"name": "dose.shape"})),
        ({"dose.every": 0}, Diagnostic("setting-too-small", {"name": "dose.every", "value": 0.0, "least": 0.0})),
        ({"dose.every": 1e-9}, Diagnostic("experiment-too-many-doses", {"count": 5000000000.0, "name": "dose"})),
        ({"dose.at": -1}, Diagnostic("setting-negative", {"name": "dose.at is", "value": -1.0})),
    ],
)
def test_doses_have_no_shape_and_take_time(eliminated, vary, message):
    with refused(message):
        cl.design(eliminated, {"c": 0, "dose": 3, "duration": 5, "rate": 2, **vary})
