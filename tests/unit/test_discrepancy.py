"""What a law leaves unexplained, as a function that objects share."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw import Law, Trials
from commonlaw.datasets.sphere_drag import drag_force, reynolds_number
from commonlaw.diagnostics import Diagnostic
from commonlaw.discrepancy.function import Discrepancy
from commonlaw.discrepancy.posterior import SharedRows, posterior
from commonlaw.discrepancy.smooth_basis import Samples, SmoothBasis, factors, meaning
from commonlaw.law import from_json, to_json
from commonlaw.law.parameters import standard_errors
from tests.refusals import refused

BASIS = SmoothBasis("v", "1", 0.0, 5.0)


@pytest.fixture(scope="module")
def drops() -> Trials:
    """Drops of one ball with linear drag."""
    return cl.datasets.linear_drag(noise=0.05, seed=1).select(object="Ball 2")


@pytest.fixture(scope="module")
def without_drag(drops: Trials) -> Discrepancy[Law]:
    """Return what a law without drag leaves."""
    return cl.fit("x'' = -g", drops).discrepancy(drops, of="v")


def test_the_drag_that_a_law_lacks_is_found_and_gravity_keeps_its_meaning(without_drag: Discrepancy[Law]) -> None:
    speeds = np.linspace(-18.0, -1.0, 8)
    assert without_drag.claimed
    assert np.all(abs(without_drag(speeds) - -0.3 * speeds) < 2.5 * without_drag.std(speeds))
    gravity, error = without_drag.law.coefficients[0, 0, 0], standard_errors(without_drag.law)[0, 0, 0]
    assert abs(gravity - -9.8) < 2 * error < 1.0
    assert (without_drag.zero_at, without_drag.holds_nothing_of) == (0.0, ())
    assert without_drag.shares["noise"] < 0.1 < without_drag.shares["shared discrepancy"]
    assert sum(without_drag.shares.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_values_that_are_not_finite_are_refused(without_drag: Discrepancy[Law], value: float) -> None:
    for function in (without_drag, without_drag.std):
        with refused("discrepancy-outside", coordinate=without_drag.basis.coordinate):
            function([1.0, value])


def test_a_line_describes_the_drag_that_a_law_lacks(without_drag: Discrepancy[Law]) -> None:
    described = {each.terms: each for each in without_drag.descriptions}
    line = described[("v",)]
    assert line.evidence > 0
    assert abs(line.coefficients[0] - -0.3) < 3 * line.errors[0]


def test_forecasts_with_the_discrepancy_are_better_and_less_sure_where_nothing_was_visited(
    drops: Trials, without_drag: Discrepancy[Law]
) -> None:
    law = from_json(to_json(without_drag.law))
    assert law.provenance.calls[1:] == ("law.discrepancy(trials, of='v').law",)
    with_it, alone = (
        law.predict(drops, start=15, discrepancy=how).errors()["rms error"].max() for how in (True, False)
    )
    assert with_it < 0.1 < alone
    assert without_drag.std(-40.0) > 5 * without_drag.std(-10.0)


def test_where_the_law_is_true_no_discrepancy_is_claimed(drops: Trials) -> None:
    found = cl.fit("x'' = -g - c v", drops).discrepancy(drops)
    assert not found.claimed
    assert {each.coordinate for each in found.compared} == {"x", "v", "t"}
    assert "No strong evidence for a discrepancy" in str(found)
    assert repr(found).startswith("<Discrepancy of x'', a function of ")


def test_a_function_of_properties_is_shared_by_objects_that_differ_in_them() -> None:
    drops = cl.datasets.reynolds_drag(trials=1).select(object=["Ball 1", "Ball 2", "Ball 5"])
    law = cl.fit("x'' = -9.8 + c v", drops)
    found = law.discrepancy(drops, of="abs(v)*2*radius/1.503e-5", times="v*abs(v)*radius^2/mass")
    own = dict(zip(found.law.objects, found.law.coefficients[:, 0, 1], strict=True))
    for name, values in drops.properties.items():
        speed = np.array([12.0, 18.0])
        radius, mass = float(values["radius"]), float(values["mass"])
        reynolds = reynolds_number(speed, 2 * radius)
        drag = own[name] * speed + found(reynolds) * speed**2 * radius**2 / mass
        assert -drag * mass == pytest.approx(drag_force(speed, 2 * radius), rel=0.05)
    forecast = found.law.predict(drops, start=10, discrepancy=True, return_std=True)
    assert forecast.score() > 0.9999
    alone = found.law.select(["Ball 5"]).predict(drops.select(object="Ball 5"), start=10, discrepancy=True)
    np.testing.assert_allclose(alone.trajectories[0].states, forecast.trajectories[-1].states, rtol=1e-6)


def test_evidence_and_posterior_are_those_of_the_dense_gaussian_model() -> None:
    rng = np.random.default_rng(0)
    design = rng.normal(size=(30, 3))
    target = design @ [1.0, -2.0, 0.5] + rng.normal(size=30)
    rows = SharedRows.of([np.asarray(np.linalg.qr(np.column_stack([design, target]), mode="r"))], 0, 30, 0.0)
    found = posterior(rows, [np.eye(3)], 2.0, np.inf)
    logs, means = [], []
    for amplitude in 2.0 * np.geomspace(1e-3, 10.0, 17):
        covariance = np.eye(30) + amplitude**2 * design @ design.T
        logs.append(-np.linalg.slogdet(covariance)[1] / 2 - target @ np.linalg.solve(covariance, target) / 2)
        means.append(amplitude**2 * design.T @ np.linalg.solve(covariance, target))
    weights = np.exp(np.array(logs) - max(logs))
    assert found.value == pytest.approx(-2 * (max(logs) + np.log(weights.mean())))
    assert found.weights == pytest.approx(weights / weights.sum() @ np.array(means))


def test_functions_are_zero_where_they_are_to_be_and_hold_nothing_of_other_terms() -> None:
    speeds = np.linspace(0.0, 5.0, 40)
    samples = [Samples(speeds, np.ones(40), np.column_stack([np.ones(40), speeds]))]
    kept = meaning(BASIS, samples, 0.0)
    assert (kept.zero_at, kept.held) == (0.0, (1,))
    factor = factors(BASIS, kept.constraints)[0]
    draws = factor @ np.random.default_rng(0).normal(size=(factor.shape[1], 5))
    functions = BASIS.values(speeds) @ draws
    assert abs(functions[0]).max() < 1e-6 * abs(functions).max()
    assert abs(speeds @ functions).max() < 1e-6 * abs(functions).max() * 40
    assert meaning(BASIS, samples, None).held == (0, 1)


def test_terms_that_no_function_of_the_coordinate_can_say_are_left_alone() -> None:
    speeds = np.linspace(0.0, 5.0, 40)
    samples = [Samples(speeds, np.ones(40), np.random.default_rng(0).normal(size=(40, 1)))]
    assert len(meaning(BASIS, samples, 0.0).constraints) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"of": "mass*v"}, Diagnostic("unknown-name", {"kind": "variable", "name": "mass"})),
        ({"of": "0*v"}, "several"),
        ({"of": "log(v)"}, "several"),
        ({"of": "v", "equation": "y"}, Diagnostic("unknown-name", {"kind": "equation", "name": "y"})),
        ({"of": "v", "times": "2*v"}, Diagnostic("term-with-factor", {"factor": "2"})),
    ],
)
def test_what_cannot_be_a_discrepancy_is_refused(
    drops: Trials, without_drag: Discrepancy[Law], options: dict[str, str], message: str
) -> None:
    with refused(message):
        without_drag.law.discrepancy(drops, **options)


def test_a_law_that_carries_no_discrepancy_or_was_changed_is_not_forecast_with_one(
    drops: Trials, without_drag: Discrepancy[Law]
) -> None:
    law = without_drag.law
    with refused("discrepancy-missing"):
        replace(law, provenance=replace(law.provenance, with_discrepancy=None)).predict(drops, discrepancy=True)
    with refused("discrepancy-outdated"):
        replace(law, coefficients=2 * law.coefficients).predict(drops, discrepancy=True)
