"""The likelihood of trajectories against dense algebra, difference quotients, shooting and variational equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.stats import multivariate_normal

from benchmarks.variational import cramer_rao, solve
from commonlaw.library import Variables, parse_library
from commonlaw.likelihood import (
    Dynamics,
    Estimate,
    Mesh,
    NotPositiveError,
    ObservationModel,
    TrajectoryModel,
    fit,
    interpolate,
    linearize,
    meshes,
)
from commonlaw.likelihood.normal_equations import eliminate_states
from commonlaw.trials import Trial

DOWN = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0003)
"""Model errors, further down than need be, so that what is left of them does not blur comparisons."""


def dynamics(library, states, order=1, inputs=()):
    return Dynamics(parse_library(library).bind(Variables(tuple(states), tuple(inputs))), len(states) // order, order)


def trial(times, states, inputs=None, name="1"):
    return Trial("object", name, times, states, np.empty((len(times), 0)) if inputs is None else inputs)


def plain(times, inputs=None):
    """A mesh of one segment without measurements."""
    inputs = np.empty((len(times), 0)) if inputs is None else inputs
    return Mesh(times, np.full((len(times), 1), np.nan), inputs, np.ones(len(times) - 1, dtype=bool))


def information(model, estimate, support, model_error):
    """What the measurements hold on the coefficients of the support."""
    columns = linearize(model, estimate, model_error).problem.factor[:, :-1][:, support.ravel()]
    return columns.T @ columns


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
    assert mesh.relative_steps[8] == 1
    np.testing.assert_allclose(mesh.relative_steps[[0, 4]], [1, 2] / np.median(mesh.steps[mesh.contiguous]) / 4)
    np.testing.assert_allclose(interpolate([each.states for each in trials], 4)[0][:, 0], 10 * mesh.times)


# Defects


@pytest.mark.parametrize(
    ("library", "coefficients", "solution", "inputs"),
    [
        ("terms:x,x^2", [1.0, -1.0], lambda t: 1 / (1 + np.exp(-t)), None),
        ("terms:x*cos(t)", [1.0], lambda t: np.exp(np.sin(t)), None),
        ("terms:x*u", [0.5], lambda t: np.exp(t**2 / 4), lambda t: t),
        ("terms:cos(x)", [1.0], lambda t: 2 * np.arctan(np.tanh((t + 0.4) / 2)), None),
    ],
)
def test_defects_of_a_solution_are_32_times_smaller_at_half_the_step(library, coefficients, solution, inputs):
    law = dynamics(library, ("x",), inputs=() if inputs is None else ("u",))
    largest = []
    for n in (41, 81):
        times = np.linspace(0.1, 2.1, n)
        mesh = plain(times, None if inputs is None else inputs(times)[:, np.newaxis])
        largest.append(np.abs(law.defects(mesh, solution(times)[:, np.newaxis], np.array([coefficients]))).max())
    assert largest[0] / largest[1] == pytest.approx(32, rel=0.05)


def test_defects_of_a_law_of_second_order_vanish_on_its_solution():
    law = dynamics("terms:x,v", ("x", "v"), order=2)
    largest = []
    for n in (21, 41):
        t = np.linspace(0, 2, n)
        states = np.column_stack([np.exp(-t) * np.cos(2 * t), -np.exp(-t) * (np.cos(2 * t) + 2 * np.sin(2 * t))])
        largest.append(np.abs(law.defects(plain(t), states, np.array([[-5.0, -2.0]]))).max())
    assert largest[0] / largest[1] == pytest.approx(32, rel=0.1)
    assert largest[1] < 1e-6


def test_the_leading_error_of_a_step_is_as_documented():
    h = 0.01
    times = np.array([0, h])
    growth = dynamics("terms:x", ("x",)).defects(plain(times), np.exp(times)[:, np.newaxis], np.ones((1, 1)))
    assert abs(growth[0, 0]) == pytest.approx(h**5 / 720, rel=0.02)
    driven = dynamics("terms:t^4", ("x",)).defects(plain(times), times[:, np.newaxis] ** 5 / 5, np.ones((1, 1)))
    assert abs(driven[0, 0]) == pytest.approx(h**5 * 24 / 2880, rel=0.02)


def test_nothing_links_two_stretches():
    law = dynamics("poly:1", ("x",))
    mesh = meshes([trial(np.arange(5.0), np.ones((5, 1))), trial(np.arange(4.0), np.ones((4, 1)), name="2")])[0]
    states = np.random.default_rng(0).standard_normal((9, 1))
    jacobians = law.jacobians(mesh, states, np.array([[0.3, -0.7]]), np.ones((1, 2), dtype=bool))
    for each in (jacobians.defects, jacobians.start, jacobians.end, jacobians.coefficients):
        assert not each[4].any()
        assert each[[3, 5]].all()


DIFFICULT = [
    (1, "poly:2 + fourier:1 + terms:x*t,sin(2*t)", ("x", "y")),
    (2, "poly:2 + fourier:1 + terms:x*t,v*u^2", ("x", "v")),
    (2, "poly:2 + terms:sin(v*t)", ("x", "y", "v", "w")),
]


def difficult(order, library, names):
    """Dynamics, an irregular mesh of two segments, states, coefficients and which of them are free."""
    generator = np.random.default_rng(order)
    law = dynamics(library, names, order, inputs=("u",))
    trials = []
    for n in (4, 3):
        times = np.cumsum(generator.uniform(0.1, 0.4, n))
        trials.append(
            trial(times, generator.standard_normal((n, law.equations)), generator.standard_normal((n, 1)), str(n))
        )
    (mesh,) = meshes(trials, points=2)
    coefficients = generator.standard_normal((law.equations, len(law.terms)))
    coefficients[generator.random(coefficients.shape) < 0.3] = 0
    free = generator.random(coefficients.shape) < 0.4
    return law, mesh, generator.standard_normal((len(mesh), law.width)), coefficients, free


@pytest.mark.parametrize(("order", "library", "names"), DIFFICULT)
def test_derivatives_of_defects_agree_with_difference_quotients(order, library, names):
    law, mesh, states, coefficients, free = difficult(order, library, names)
    jacobians = law.jacobians(mesh, states, coefficients, free)
    np.testing.assert_allclose(jacobians.defects, law.defects(mesh, states, coefficients), rtol=1e-13, atol=1e-14)

    def quotient(change):
        high, low = (law.defects(mesh, *change(step)) for step in (1e-6, -1e-6))
        return (high - low) / 2e-6

    for i in range(len(mesh)):
        for j in range(law.width):

            def moved(step, i=i, j=j):
                z = states.copy()
                z[i, j] += step
                return z, coefficients

            expected = quotient(moved)
            found = np.zeros_like(expected)
            if i < len(mesh) - 1:
                found[i] += jacobians.start[i, :, j]
            if i > 0:
                found[i - 1] += jacobians.end[i - 1, :, j]
            np.testing.assert_allclose(found, expected, atol=2e-8)
    for p, (equation, term) in enumerate(np.argwhere(free)):

        def changed(step, equation=equation, term=term):
            c = coefficients.copy()
            c[equation, term] += step
            return states, c

        np.testing.assert_allclose(jacobians.coefficients[:, :, p], quotient(changed), atol=2e-8)


def test_a_law_without_terms_stands_still():
    law = dynamics("poly:1", ("x",))
    defects = law.defects(plain(np.arange(4.0)), np.array([[1.0], [1.0], [3.0], [3.0]]), np.zeros((1, 2)))
    np.testing.assert_array_equal(defects[:, 0], [0, 2, 0])


# Measurements


def test_the_deviance_is_the_sum_of_squares_and_beyond_the_threshold_that_of_huber():
    residuals, noise = np.array([[0.1, np.nan], [-0.2, 1.0], [3.0, -8.0]]), np.array([0.1, 2.0])
    sizes = np.array([1.0, 2.0, 30.0, 0.5, 4.0])
    assert ObservationModel(noise).deviance(residuals) == pytest.approx(np.sum(sizes**2))
    expected = sum(s**2 if s <= 3 else 2 * 3 * s - 3**2 for s in sizes)
    assert ObservationModel(noise, 3.0).deviance(residuals) == pytest.approx(expected)
    np.testing.assert_allclose(
        ObservationModel(noise, 3.0).weights(residuals), np.array([[1, 0], [1, 1], [0.1, 0.75]]) / noise**2
    )


# Normal equations


def dense(law, mesh, states, coefficients, free, precision, weights, residuals):
    """The Jacobian and the residuals of the whole least-squares problem; states first, then coefficients."""
    jacobians = law.jacobians(mesh, states, coefficients, free)
    n, width, measured = len(mesh), law.width, law.equations
    rows = (n - 1) * width
    of_measurements = np.zeros((n, measured, n, width))
    for i in range(n):
        of_measurements[i, range(measured), i, range(measured)] = -np.sqrt(weights[i])
    of_defects = np.zeros((n - 1, width, n, width))
    for i in range(n - 1):
        of_defects[i, :, i], of_defects[i, :, i + 1] = jacobians.start[i], jacobians.end[i]
    root = np.sqrt(precision).ravel()[:, np.newaxis]
    jacobian = np.block(
        [
            [of_measurements.reshape(n * measured, -1), np.zeros((n * measured, int(free.sum())))],
            [
                root * of_defects.reshape(rows, -1),
                root * jacobians.coefficients.reshape(rows, -1),
            ],
        ]
    )
    of_samples = np.nan_to_num(residuals) * np.sqrt(weights)
    both = np.concatenate([of_samples.ravel(), root[:, 0] * jacobians.defects.ravel()])
    return jacobians, jacobian, both


@pytest.mark.parametrize(("order", "library", "names"), DIFFICULT)
def test_the_states_are_eliminated_as_in_dense_algebra(order, library, names):
    law, mesh, states, coefficients, free = difficult(order, library, names)
    generator = np.random.default_rng(9)
    residuals = mesh.measured - states[:, : law.equations]
    residuals[2, 0] = np.nan
    weights = np.where(np.isnan(residuals), 0.0, generator.uniform(0.5, 2, residuals.shape))
    precision = generator.uniform(1, 5, (len(mesh) - 1, law.width)) * mesh.contiguous[:, np.newaxis]
    jacobians, jacobian, both = dense(law, mesh, states, coefficients, free, precision, weights, residuals)
    reduced = eliminate_states(jacobians, precision, weights, residuals)
    size = states.size
    matrix, right = jacobian.T @ jacobian, jacobian.T @ both
    follow = -np.linalg.solve(matrix[:size, :size], matrix[:size, size:])
    schur = matrix[size:, size:] + matrix[size:, :size] @ follow
    scale = np.abs(schur).max()
    np.testing.assert_allclose(reduced.information, schur, atol=1e-9 * scale)
    np.testing.assert_allclose(reduced.state_sensitivity.reshape(size, -1), follow, atol=1e-7 * np.abs(follow).max())
    gradient = right[size:] + follow.T @ right[:size]
    np.testing.assert_allclose(reduced.gradient, gradient, atol=1e-9 * np.abs(gradient).max())
    step = np.linalg.lstsq(matrix, -right, rcond=None)[0]
    # Whatever step the coefficients take, the states follow to where their gradient vanishes
    moved = (reduced.state_step + reduced.state_sensitivity @ step[size:]).ravel()
    np.testing.assert_allclose(moved, step[:size], atol=1e-6 * np.abs(step).max())


def test_numbers_that_are_not_finite_are_refused():
    law, mesh, states, coefficients, free = difficult(*DIFFICULT[0])
    states[1, 0] = np.inf
    model = TrajectoryModel(law, (mesh,), ObservationModel(np.ones(2)), np.ones(2))
    estimate = Estimate((states,), coefficients)
    with pytest.raises(NotPositiveError), np.errstate(all="ignore"):
        linearize(model, estimate, 0.1)
    assert fit(model, estimate, free, (0.1,)).objective == np.inf


# Fits


def shot(field, times, measured, noise, sizes, start):
    """Coefficients of least squares over initial states and coefficients: single shooting, one start for each trial."""
    count = sum(sizes)

    def residuals(p):
        found = []
        for i, (t, y) in enumerate(zip(times, measured, strict=True)):
            begin = p[count * i : count * (i + 1)]
            span = (t[0], t[-1])
            path = solve_ivp(
                lambda _, z: field(z, p[count * len(times) :]), span, begin, "DOP853", t, rtol=1e-11, atol=1e-11
            ).y.T
            residuals = (path[:, : y.shape[1]] - y) / noise
            found.append(residuals[np.isfinite(residuals)])
        return np.concatenate(found)

    best = least_squares(residuals, start, xtol=1e-13, ftol=1e-13, gtol=1e-13, x_scale=np.maximum(np.abs(start), 0.1))
    return best.x[count * len(times) :], 2 * best.cost


VARIABLES, PREY = ("x", "y"), (("x", "x y"), ("y", "x y"))
TRUE = np.array([1.0, -0.9, -1.2, 0.6])
SUPPORT = np.array([[True, False, True], [False, True, True]])
TIMES = np.linspace(0, 8, 60)
NOISE = np.array([0.05, 0.04])


def prey(seed=1, starts=((1.2, 0.9), (0.8, 1.5))):
    """Two noisy trials of prey and predators."""
    generator = np.random.default_rng(seed)
    runs = [solve(VARIABLES, PREY, TRUE, np.array(start), TIMES) for start in starts]
    return runs, [run.states + NOISE * generator.standard_normal(run.states.shape) for run in runs]


def of_prey(measured, times=TIMES, huber_threshold=np.inf, points=1):
    """The model of prey and predators, and where to begin."""
    law = dynamics("terms:x,y,x*y", VARIABLES)
    filled = [
        np.column_stack([np.interp(times, times[np.isfinite(c)], c[np.isfinite(c)]) for c in each.T])
        for each in measured
    ]
    (mesh,) = meshes([trial(times, each, name=str(i)) for i, each in enumerate(filled)], points)
    mesh.measured[np.isfinite(mesh.measured[:, 0])] = np.concatenate(measured)
    model = TrajectoryModel(law, (mesh,), ObservationModel(NOISE, huber_threshold), NOISE)
    return model, Estimate(tuple(interpolate(filled, points)), np.where(SUPPORT, [[1.1, 0, -0.8], [0, -1, 0.5]], 0.0))


@pytest.fixture(scope="module")
def shot_prey():
    runs, measured = prey()
    start = np.concatenate([*(run.states[0] for run in runs), TRUE])
    found, cost = shot(
        lambda z, c: [c[0] * z[0] + c[1] * z[0] * z[1], c[2] * z[1] + c[3] * z[0] * z[1]],
        [TIMES] * 2, measured, NOISE, (1, 1), start,
    )  # fmt: skip
    return measured, found, cost


@pytest.mark.parametrize("points", [1, 2])
def test_prey_and_predators_fit_as_by_shooting(shot_prey, points):
    measured, expected, cost = shot_prey
    model, start = of_prey(measured, points=points)
    found = fit(model, start, SUPPORT, DOWN)
    bounds = cramer_rao(prey()[0], NOISE)
    np.testing.assert_allclose((found.coefficients[SUPPORT] - expected) / bounds, 0, atol=1e-3)
    assert found.deviance == pytest.approx(cost, abs=3e-3)
    assert found.objective == pytest.approx(found.deviance, abs=1e-2)


def test_heights_of_falling_balls_fit_as_by_shooting():
    times, noise = np.linspace(0, 3.2, 49), np.array([0.05])
    generator = np.random.default_rng(2)
    runs = [solve(("x", "v"), (("1", "v"),), np.array([-9.8, -0.4]), np.array(z), times) for z in ((47, 0), (46, 0.4))]
    measured = [run.states[:, :1] + noise * generator.standard_normal((49, 1)) for run in runs]
    start = np.concatenate([*(run.states[0] for run in runs), [-9.8, -0.4]])
    expected, cost = shot(lambda z, c: [z[1], c[0] + c[1] * z[1]], [times] * 2, measured, noise, (1, 1), start)
    model = TrajectoryModel(
        dynamics("terms:1,x,v", ("x", "v"), 2),
        meshes([trial(times, each, name=str(i)) for i, each in enumerate(measured)]),
        ObservationModel(noise),
        np.array([0.05, 0.1]),
    )
    begin = Estimate((np.concatenate([run.states for run in runs]) + 0.1,), np.array([[-8.0, 0.0, -0.2]]))
    free = np.array([[True, False, True]])
    found = fit(model, begin, free, DOWN)
    np.testing.assert_allclose((found.coefficients[free] - expected) / cramer_rao(runs, noise), 0, atol=1e-3)
    assert found.coefficients[0, 1] == 0
    assert found.deviance == pytest.approx(cost, abs=1e-3)


def test_coefficients_that_are_not_free_stay():
    model, start = of_prey(prey()[1])
    held = start.coefficients.copy()
    held[0, 0] = 0.9
    free = SUPPORT.copy()
    free[0, 0] = False
    found = fit(model, Estimate(start.states, held), free, DOWN[:4])
    assert found.coefficients[0, 0] == 0.9
    assert found.deviance > fit(model, start, SUPPORT, DOWN[:4]).deviance + 10


@pytest.mark.parametrize(
    ("variables", "equations", "coefficients", "library", "start", "times", "noise"),
    [
        (
            ("x", "y", "z"),
            (("x", "y"), ("x", "y", "x z"), ("z", "x y")),
            [-10, 10, 28, -1, -1, -8 / 3, 1],
            "poly:2",
            [-8, 8, 27],
            np.linspace(0, 2, 401),
            [0.1, 0.2, 0.3],
        ),
        (("x", "v"), (("x", "v", "x^2 v"),), [-1.0, 1.2, -1.1], "poly:3", [1, 0], np.linspace(0, 9, 181), [0.05]),
        (
            ("x", "y", "v", "w"),
            (("x", "v"), ("y", "x y", "w")),
            [-1, -0.1, -2, 0.3, -0.2],
            "poly:2",
            [1, 0.5, 0, 0.3],
            np.linspace(0, 6, 121),
            [0.05, 0.02],
        ),
    ],
)
def test_the_information_is_that_of_fisher(variables, equations, coefficients, library, start, times, noise):
    order = len(variables) // len(equations)
    run = solve(variables, equations, np.array(coefficients, float), np.array(start, float), times)
    law = dynamics(library, variables, order)
    values = np.zeros((len(equations), len(law.terms)))
    pairs = [(j, law.terms.index(term)) for j, equation in enumerate(equations) for term in equation]
    values[tuple(np.transpose(pairs))] = coefficients
    unit = np.tile(np.array(noise), order)
    model = TrajectoryModel(
        law, meshes([trial(times, run.states[:, : len(noise)])]), ObservationModel(np.array(noise)), unit
    )
    found = information(model, Estimate((run.states,), values), values != 0, 1e-4)
    listed = [tuple(pair) for pair in np.argwhere(values)]
    errors = np.sqrt(np.diag(np.linalg.inv(found)))[[listed.index(pair) for pair in pairs]]
    np.testing.assert_allclose(errors, cramer_rao([run], np.array(noise)), rtol=2e-3)


def test_samples_that_miss_at_the_end_change_nothing():
    measured = prey()[1][:1]
    short, begin = of_prey([measured[0][:50]], TIMES[:50])
    missing = measured[0].copy()
    missing[50:] = np.nan
    longer, start = of_prey([missing])
    one, other = fit(short, begin, SUPPORT, DOWN[:6], 30), fit(longer, start, SUPPORT, DOWN[:6], 30)
    errors = np.sqrt(np.diag(np.linalg.inv(information(short, one, SUPPORT, 0.003))))
    np.testing.assert_allclose((one.coefficients - other.coefficients)[SUPPORT] / errors, 0, atol=1e-3)
    found = np.sqrt(np.diag(np.linalg.inv(information(longer, other, SUPPORT, 0.003))))
    np.testing.assert_allclose(found, errors, rtol=1e-4)


def test_missing_values_and_a_gap_cost_information_only(shot_prey):
    full, *_ = shot_prey
    missing = [each.copy() for each in full]
    missing[0][20:30] = np.nan
    missing[1][np.random.default_rng(3).random((60, 2)) < 0.2] = np.nan
    runs = prey()[0]
    start = np.concatenate([*(run.states[0] for run in runs), TRUE])
    expected, cost = shot(
        lambda z, c: [c[0] * z[0] + c[1] * z[0] * z[1], c[2] * z[1] + c[3] * z[0] * z[1]],
        [TIMES] * 2, missing, NOISE, (1, 1), start,
    )  # fmt: skip
    model, begin = of_prey(missing)
    found = fit(model, begin, SUPPORT, DOWN)
    lost = information(model, found, SUPPORT, DOWN[-1])
    whole, first = of_prey(full)
    kept = information(whole, fit(whole, first, SUPPORT, DOWN), SUPPORT, DOWN[-1])
    errors = np.sqrt(np.diag(np.linalg.inv(lost)))
    np.testing.assert_allclose((found.coefficients[SUPPORT] - expected) / errors, 0, atol=2e-3)
    assert found.deviance == pytest.approx(cost, abs=2e-3)
    assert np.all(errors > np.sqrt(np.diag(np.linalg.inv(kept))))


def test_an_outlier_pulls_no_harder_than_the_huber_threshold(shot_prey):
    measured, *_ = shot_prey
    spoilt = [each.copy() for each in measured]
    spoilt[0][33, 0] += 50 * NOISE[0]
    fits = {}
    for huber_threshold in (np.inf, 4.0):
        clean, begin = of_prey(measured, huber_threshold=huber_threshold)
        dirty, start = of_prey(spoilt, huber_threshold=huber_threshold)
        reference = fit(clean, begin, SUPPORT, DOWN[:6])
        errors = np.sqrt(np.diag(np.linalg.inv(information(clean, reference, SUPPORT, DOWN[5]))))
        moved = fit(dirty, start, SUPPORT, DOWN[:6], 30).coefficients - reference.coefficients
        fits[huber_threshold] = np.abs(moved[SUPPORT] / errors).max()
    assert fits[4.0] < 1 < fits[np.inf]


# Linearization


@pytest.mark.parametrize(("order", "library", "names"), DIFFICULT)
def test_squared_residuals_and_the_log_determinant_are_the_density_of_the_linearised_model(order, library, names):
    law, mesh, states, coefficients, _ = difficult(order, library, names)
    mesh.measured[2, 0] = np.nan
    noise = np.linspace(0.5, 0.8, law.equations)
    unit = np.concatenate([noise, 0.9 * noise])[: law.width]
    huber_threshold, model_error, step = 2.0, 0.7, np.median(mesh.steps[mesh.contiguous])
    model = TrajectoryModel(law, (mesh,), ObservationModel(noise, huber_threshold), unit)
    linearization = linearize(model, Estimate((states,), coefficients), model_error)

    # What was measured says where states are; what was not is somewhere within a hundred times the noise
    residuals = mesh.measured - states[:, : law.equations]
    scaled = np.abs(residuals) / noise
    deviations = np.zeros_like(states)
    variances = np.tile(np.tile((100 * noise) ** 2, order), (len(mesh), 1))
    variances[:, law.equations :] *= (0.03 / step) ** 2
    seen = np.isfinite(residuals)
    deviations[:, : law.equations][seen] = residuals[seen]
    variances[:, : law.equations][seen] = (np.maximum(scaled / huber_threshold, 1) * noise**2)[seen]
    free = np.ones_like(coefficients, dtype=bool)
    jacobians = law.jacobians(mesh, states, coefficients, free)
    linked = np.flatnonzero(mesh.contiguous)
    matrix = np.zeros((len(linked), law.width, len(mesh), law.width))
    for row, i in enumerate(linked):
        matrix[row, :, i], matrix[row, :, i + 1] = jacobians.start[i], jacobians.end[i]
    matrix = matrix.reshape(len(linked) * law.width, -1)
    allowed = np.repeat((mesh.steps[linked] / step)[:, np.newaxis], law.width, 1) * (model_error * unit) ** 2
    covariance = matrix @ np.diag(variances.ravel()) @ matrix.T + np.diag(allowed.ravel())
    turned = sum(np.log(abs(np.linalg.det(jacobians.end[i]))) for i in linked)
    for seed in range(3):
        change = np.random.default_rng(seed).standard_normal(coefficients.shape)
        mean = (
            jacobians.defects[linked].ravel()
            + matrix @ deviations.ravel()
            + jacobians.coefficients[linked].reshape(len(covariance), -1) @ change.ravel()
        )
        density = multivariate_normal(mean, covariance).logpdf(np.zeros(len(mean)))
        # The density of defects becomes that of the states at the ends of their steps
        expected = -2 * (density + turned) - len(mean) * np.log(2 * np.pi)
        found = (
            linearization.problem.residual((coefficients + change).reshape(1, -1))[0] + linearization.log_determinant
        )
        assert found == pytest.approx(expected, rel=1e-8)


def test_the_linearization_about_the_best_fit_has_its_minimum_and_curvature_there():
    measured = prey()[1]
    model, start = of_prey(measured)
    found = fit(model, start, SUPPORT, (0.1,), 60)
    rows = linearize(model, found, 0.1).problem
    held = 0.0
    for mesh, states in zip(model.meshes, found.states, strict=True):
        jacobians, residuals = (
            model.dynamics.jacobians(mesh, states, found.coefficients, SUPPORT),
            model.residuals(mesh, states),
        )
        weights = model.observation.weights(residuals)
        held = held + eliminate_states(jacobians, model.precision(mesh, 0.1), weights, residuals).information
    errors = np.sqrt(np.diag(np.linalg.inv(held)))
    again = rows.least_squares(SUPPORT.ravel(), 0).reshape(SUPPORT.shape)
    np.testing.assert_allclose((again - found.coefficients)[SUPPORT] / errors, 0, atol=0.05)
    np.testing.assert_allclose(information(model, found, SUPPORT, 0.1), held, rtol=1e-6)
