"""Meshes and defects, beside known solutions and difference quotients."""

from dataclasses import replace

import numpy as np
import pytest

from commonlaw.integration import VectorField
from commonlaw.likelihood import Mesh, interpolate, meshes
from commonlaw.likelihood.collocation import defects, jacobians
from tests.unit.trajectories import DIFFICULT, difficult, terms_of, trial


def plain(times, inputs=None):
    """A mesh of one segment without measurements."""
    inputs = np.empty((len(times), 0)) if inputs is None else inputs
    return Mesh(times, np.full((len(times), 1), np.nan), inputs, np.ones(len(times) - 1, dtype=bool))


# Meshes


def test_long_trials_are_cut_into_even_stretches_and_no_sample_is_lost():
    generator = np.random.default_rng(0)
    lengths = [9001, 100, 3950, 20]
    trials = [trial(np.arange(n) / 7.0, generator.standard_normal((n, 2)), name=str(n)) for n in lengths]
    made = meshes(trials)
    assert [len(each) for each in made] == [3000, 3000, 3101, 3970]
    assert [np.flatnonzero(~each.contiguous).tolist() for each in made] == [[], [], [3000], [3949]]
    np.testing.assert_array_equal(
        np.concatenate([each.times for each in made]), np.concatenate([t.times for t in trials])
    )
    everything = np.concatenate([each.states for each in trials])
    np.testing.assert_array_equal(np.concatenate([each.measured for each in made]), everything)
    np.testing.assert_array_equal(np.concatenate(interpolate([each.states for each in trials])), everything)


def test_points_between_samples_lie_on_straight_lines_and_are_not_measured():
    times = [np.array([0.0, 1.0, 3.0]), np.array([5.0, 5.5])]
    trials = [trial(t, 10 * t[:, np.newaxis], inputs=t[:, np.newaxis] ** 2, name=str(i)) for i, t in enumerate(times)]
    (mesh,) = meshes(trials, points=4)
    expected = [0, 0.25, 0.5, 0.75, 1, 1.5, 2, 2.5, 3, 5, 5.125, 5.25, 5.375, 5.5]
    np.testing.assert_allclose(mesh.times, expected)
    samples = [0, 4, 8, 9, 13]
    np.testing.assert_array_equal(np.flatnonzero(mesh.observed), samples)
    np.testing.assert_allclose(mesh.measured[samples, 0], [0, 10, 30, 50, 55])
    np.testing.assert_allclose(mesh.inputs[:9, 0], np.interp(mesh.times[:9], times[0], times[0] ** 2))
    np.testing.assert_array_equal(np.flatnonzero(~mesh.contiguous), [8])
    assert mesh.steps[8] == 0
    assert mesh.walk[8, 0] == 1
    np.testing.assert_allclose(mesh.walk[[0, 4], 0], [1, 2] / np.median(mesh.steps[mesh.contiguous]) / 4)
    np.testing.assert_allclose(interpolate([each.states for each in trials], 4)[0][:, 0], 10 * mesh.times)


# Defects


@pytest.mark.parametrize(
    ("library", "coefficients", "solution", "inputs"),
    [
        ("terms:x,x^2", [1.0, -1.0], lambda t: [1 / (1 + np.exp(-t))], None),
        ("terms:x*cos(t)", [1.0], lambda t: [np.exp(np.sin(t))], None),
        ("terms:x*u", [0.5], lambda t: [np.exp(t**2 / 4)], lambda t: t),
        ("terms:cos(x)", [1.0], lambda t: [2 * np.arctan(np.tanh((t + 0.4) / 2))], None),
        (
            "terms:x,v",
            [-5.0, -2.0],
            lambda t: [np.exp(-t) * np.cos(2 * t), -np.exp(-t) * (np.cos(2 * t) + 2 * np.sin(2 * t))],
            None,
        ),
    ],
)
def test_defects_of_a_solution_are_32_times_smaller_at_half_the_step(library, coefficients, solution, inputs):
    order = len(solution(0.0))
    terms = terms_of(library, ("x", "v")[:order], () if inputs is None else ("u",))
    field = VectorField(terms, np.array([coefficients]), order)
    largest = []
    for n in (41, 81):
        times = np.linspace(0.1, 2.1, n)
        mesh = plain(times, None if inputs is None else inputs(times)[:, np.newaxis])
        largest.append(np.abs(defects(field, mesh, np.transpose(solution(times)))).max())
    assert largest[0] / largest[1] == pytest.approx(32, rel=0.05)
    assert largest[1] < 1e-6


def test_the_leading_error_of_a_step_is_as_documented():
    h = 0.01
    times = np.array([0, h])
    growing, driven = (VectorField(terms_of(each, ("x",)), np.ones((1, 1))) for each in ("terms:x", "terms:t^4"))
    growth = defects(growing, plain(times), np.exp(times)[:, np.newaxis])
    assert abs(growth[0, 0]) == pytest.approx(h**5 / 720, rel=0.02)
    growth = defects(driven, plain(times), times[:, np.newaxis] ** 5 / 5)
    assert abs(growth[0, 0]) == pytest.approx(h**5 * 24 / 2880, rel=0.02)


def test_nothing_links_two_stretches():
    field = VectorField(terms_of("poly:1", ("x",)), np.array([[0.3, -0.7]]), free=np.ones((1, 2), dtype=bool))
    mesh = meshes([trial(np.arange(5.0), np.ones((5, 1))), trial(np.arange(4.0), np.ones((4, 1)), name="2")])[0]
    states = np.random.default_rng(0).standard_normal((9, 1))
    found = jacobians(field, mesh, states)
    for each in (found.defects, found.start, found.end, found.coefficients):
        assert not each[4].any()
        assert each[[3, 5]].all()


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize(("order", "library", "names"), DIFFICULT)
def test_derivatives_of_defects_agree_with_difference_quotients(order, library, names, held):
    field, mesh, states = difficult(order, library, names)
    mesh = replace(mesh, held=held, middle=mesh.inputs[:-1] if held else None)
    linear = jacobians(field, mesh, states)
    np.testing.assert_allclose(linear.defects, defects(field, mesh, states), rtol=1e-13, atol=1e-14)

    def quotient(change):
        high, low = (defects(*change(step)) for step in (1e-6, -1e-6))
        return (high - low) / 2e-6

    def unit(like, *place):
        one = np.zeros(like.shape)
        one[place] = 1
        return one

    for i, j in np.ndindex(states.shape):
        at = unit(states, i, j)
        expected = quotient(lambda step, at=at: (field, mesh, states + step * at))
        found = np.zeros_like(expected)
        if i < len(mesh) - 1:
            found[i] += linear.start[i, :, j]
        if i > 0:
            found[i - 1] += linear.end[i - 1, :, j]
        np.testing.assert_allclose(found, expected, atol=2e-8)
    for p, place in enumerate(np.argwhere(field.free)):
        at = unit(field.coefficients, *place)
        expected = quotient(
            lambda step, at=at: (replace(field, coefficients=field.coefficients + step * at), mesh, states)
        )
        np.testing.assert_allclose(linear.coefficients[:, :, p], expected, atol=2e-8)


def test_a_law_without_terms_stands_still():
    field = VectorField(terms_of("poly:1", ("x",)), np.zeros((1, 2)))
    found = defects(field, plain(np.arange(4.0)), np.array([[1.0], [1.0], [3.0], [3.0]]))
    np.testing.assert_array_equal(found[:, 0], [0, 2, 0])
