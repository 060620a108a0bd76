"""The compiled kernel computes what NumPy computes, and NumPy does where there is none."""

import os
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from commonlaw import kernel as kernels
from commonlaw.library import Term, Terms, Variables, parse_library
from commonlaw.library.grammar import FUNCTIONS
from commonlaw.likelihood import (
    Estimate,
    LatentProcesses,
    LinearizedObjects,
    NotPositiveError,
    ObservationModel,
    Prior,
    TrajectoryModel,
    compiled,
    fit,
    fitting,
    linearization,
    linearize,
    meshes,
)
from commonlaw.likelihood.collocation import jacobians
from commonlaw.likelihood.compiled import packed
from tests.refusals import refused
from tests.unit.trajectories import SUPPORT, of_prey, prey, trial

ROOT = Path(__file__).parents[2]

ERRORS = (1.0, 0.3, 0.03, 0.003)

FUNCTIONS_OF_TERMS = {
    **{name: f"{name}(x)" for name in FUNCTIONS},
    **{name: f"{name}(sin(x)/2)" for name in ("arcsin", "arccos", "arctanh")},
    "arccosh": "arccosh(1+x**2)",
    "arctan2": "arctan2(x, sin(y))",
    "power": "x**2.5",
    "negative power": "(1+x)**-3",
    "whole power": "exp((1+y)**4/9)",
    "zeroth power": "exp(x**0*y)",
    "quotient": "x/(2+y)",
    "nested": "exp(-(x-0.5)**2/0.3)+sqrt(1+y)*sin(2*x+t)",
    "constants": "exp((3-2)*x*2**0.5)",
}


INSIDE = "terms:y*sin(4*x+K),u,abs(x)**(2+p)"
CONSTANTS = ("K", "p", "q")


@pytest.fixture(scope="module")
def library():
    """The kernel; without it tests are skipped, or fail where CI is set."""
    found = kernels._loaded()
    if found is None:
        (pytest.fail if os.environ.get("CI") and os.name == "posix" else pytest.skip)(
            "the kernel was not built: run python hatch_build.py"
        )
    return found


def test_the_kernel_was_built_of_these_sources(library):
    folder, digest = Path(kernels.__file__).parent, runpy.run_path(str(ROOT / "hatch_build.py"))["digest"]
    assert library.commonlaw_sources().decode() == digest(sorted(folder.glob("*.[ch]"))), (
        "the sources changed: run python hatch_build.py"
    )


def model_of(
    order=1, text="poly:2", names=("x", "y"), inputs=("u",), between="linear", logarithmic=(), cut=4000, parameters=()
):
    """A model over irregular trials with inputs and gaps, and states and coefficients to begin with."""
    orders = order if isinstance(order, tuple) else ()
    generator = np.random.default_rng(len(text) + (sum(orders) or order))
    equations, trials = len(orders) or len(names) // order, []
    for n in (12, 9):
        times = np.cumsum(generator.uniform(0.05, 0.2, n))
        values = generator.uniform(0.5, 1.5, (n, equations))
        values[1:-1][generator.random(values[1:-1].shape) < 0.15] = np.nan
        trials.append(trial(times, values, generator.standard_normal((n, len(inputs))), str(n)))
    found = meshes(trials, most=cut, input_interpolation=between)
    scaled = [replace(each, scale=generator.uniform(0.5, 1.5, each.measured.shape)) for each in found]
    variables = Variables(tuple(names), tuple(inputs), logarithmic=logarithmic, parameters=parameters, orders=orders)
    own = (Term(parameter=variables.index(name)) for name in parameters)
    terms = Terms(variables, (*parse_library(text).bind(variables).terms, *own))
    noise, unit = np.full(equations, 0.1), np.linspace(0.1, 0.3, len(names))
    states = tuple(generator.uniform(0.5, 1.5, (len(each), len(names))) for each in scaled)
    coefficients = generator.uniform(-0.5, 0.5, (equations, len(terms)))
    coefficients[:, 1::3] = 0
    return TrajectoryModel(terms, scaled, ObservationModel(noise, 3.0), unit), Estimate(states, coefficients)


def with_latent(pair, **levels):
    model, estimate = pair
    equations = np.ones(model.equations)
    latent = LatentProcesses(**{k: v * equations if v < 1 else v for k, v in levels.items()})
    model, estimate = model.with_latent(latent, estimate)
    generator = np.random.default_rng(0)  # Errors and forces of zero would show no residual that leaves them out
    states = tuple(z + 0.1 * generator.standard_normal(z.shape) for z in estimate.states)
    return model, replace(estimate, states=states)


def rejecting(pair):
    model, estimate = pair
    return replace(model, observation=replace(model.observation, rejects=True)), estimate


CASES = {
    "first order": lambda: model_of(),
    "second order": lambda: model_of(2, "poly:2", ("x", "y", "v", "w")),
    "mixed orders": lambda: model_of((1, 2), "poly:2", ("x", "y", "v")),
    "mixed orders, memory and force": lambda: with_latent(
        model_of((2, 1), "terms:1,x,y,v,u", ("x", "y", "v")), correlated=0.1, memory=1.0, force=0.2, force_time=1.0
    ),
    "mixed orders, constants inside": lambda: model_of((2, 1, 2), INSIDE, tuple("xyzvw"), parameters=CONSTANTS),
    "one state": lambda: model_of(1, "poly:3", ("x",)),
    "many states": lambda: model_of(1, "poly:1", tuple("abcdefg")),
    "without inputs": lambda: model_of(inputs=()),
    "held inputs": lambda: model_of(between="held"),
    "cubic inputs": lambda: model_of(between="cubic"),
    "several meshes": lambda: model_of(2, "terms:1,x,v,u", ("x", "v"), cut=5),
    "functions": lambda: model_of(text="terms:sin(x),exp(-y)*x,abs(y)/(1+x**2),t*x"),
    "logarithms": lambda: model_of(text="terms:x,y,x*y,u", logarithmic=("x", "y")),
    "one logarithm": lambda: model_of(text="terms:x,y,x*y,u", logarithmic=("y",)),
    "logarithms, held inputs": lambda: model_of(text="terms:x,y,x*y,u", logarithmic=("x",), between="held"),
    "rejected outliers": lambda: rejecting(model_of()),
    "rejected outliers, memory": lambda: rejecting(with_latent(model_of(), correlated=0.1, memory=1.0)),
    "memory": lambda: with_latent(model_of(), correlated=0.1, memory=1.0),
    "sensor walk": lambda: with_latent(model_of(), correlated=0.1),
    "sensor walk, second order": lambda: with_latent(
        model_of(2, "terms:1,x,v,u", ("x", "v"), cut=5, between="held"), correlated=0.2
    ),
    "force": lambda: with_latent(model_of(2, "terms:1,x,v,u", ("x", "v")), force=0.2, force_time=1.0),
    "drift": lambda: with_latent(model_of(), offset=0.1, slope=0.2),
    "drift, second order": lambda: with_latent(
        model_of(2, "terms:1,x,v,u", ("x", "v"), cut=5, between="held"), offset=0.3, slope=0.1
    ),
    "drift, mixed orders": lambda: with_latent(
        model_of((1, 2), "poly:2", ("x", "y", "v")), offset=0.02, slope=0.5, trend=0.3
    ),
    "both": lambda: with_latent(model_of(), correlated=0.1, memory=1.0, force=0.2, force_time=1.0),
    "both, held inputs": lambda: with_latent(
        model_of(2, "terms:1,x,v", ("x", "v"), between="held"), correlated=0.1, memory=1.0, force=0.2, force_time=1.0
    ),
    "both, logarithms": lambda: with_latent(
        model_of(text="terms:x,y,u", logarithmic=("x",)), correlated=0.1, memory=1.0, force=0.2, force_time=1.0
    ),
    "constants inside": lambda: model_of(text=INSIDE, parameters=CONSTANTS),
    "constants inside, second order": lambda: model_of(2, INSIDE, ("x", "y"), parameters=CONSTANTS),
    "constants inside, force": lambda: with_latent(
        model_of(2, INSIDE, ("x", "y"), parameters=CONSTANTS, between="held"), force=0.2, force_time=1.0
    ),
    "constants inside, logarithms": lambda: model_of(text=INSIDE, logarithmic=("x",), parameters=CONSTANTS),
    "terms that are alike": lambda: model_of(text="terms:x,abs(x),y"),
}


@pytest.fixture(params=CASES)
def case(request, monkeypatch, library):
    """A model, an estimate, and which coefficients are free."""
    assert library is not None
    monkeypatch.setenv(kernels.VARIABLE, "compiled")
    model, estimate = CASES[request.param]()
    free = np.ones(estimate.coefficients.shape, dtype=bool)
    free[:, -1] = False
    free[1:, list(model.terms.parameters)] = False  # One number stands for each
    return model, estimate, free


def disturbed(estimate, size):
    """Estimates whose states are rounded in several other ways, as how much that matters is luck."""
    for seed in range(3):
        generator = np.random.default_rng(seed)
        states = tuple(z * (1 + size * generator.standard_normal(z.shape)) for z in estimate.states)
        yield replace(estimate, states=states)


def agree(found, expected, again, message):
    """Two computations differ by 1e-8 at most, or by what another rounding in the second one makes of it."""
    found, expected = (np.asarray(each, dtype=float) for each in (found, expected))
    rounding = max(np.abs(each - expected).max(initial=0.0) for each in again)
    allowed = 1e-8 * np.abs(expected).max(initial=1e-300) + 100 * rounding
    np.testing.assert_array_less(np.abs(found - expected), allowed + np.zeros(found.shape) + 1e-300, message)


FITTED = (
    "both, held inputs", "mixed orders, constants inside", "cubic inputs", "several meshes", "logarithms, held inputs",
    pytest.param("second order", marks=pytest.mark.slow), pytest.param("both, logarithms", marks=pytest.mark.slow),
)  # fmt: skip


@pytest.mark.parametrize("case", FITTED, indirect=True)
def test_fits_are_those_of_numpy(case):
    model, start, free = case
    found, expected = fit(model, start, free, ERRORS), fitting.fit(model, start, free, ERRORS)
    again = [fitting.fit(model, each, free, ERRORS) for each in disturbed(start, 1e-13)]
    assert np.isfinite(expected.objective)
    for name in ("deviance", "objective", "coefficients"):
        agree(getattr(found, name), getattr(expected, name), [getattr(each, name) for each in again], name)
    for own, theirs, *others in zip(found.states, expected.states, *(each.states for each in again), strict=True):
        agree(own, theirs, others, "states")
    assert not np.allclose(found.coefficients[free], start.coefficients[free])
    np.testing.assert_array_equal(found.coefficients[~free], start.coefficients[~free])


@pytest.mark.parametrize("case", FITTED[::3], indirect=True)
def test_a_prior_of_coefficients_draws_fits_to_it_alike(case):
    model, start, free = case
    typical = np.where(free, 1.5 * start.coefficients, 7.0)
    prior = Prior(typical, np.full(typical.shape, 1e12))
    held = fit(replace(model, prior=prior), start, free, ERRORS)
    np.testing.assert_allclose(held.coefficients[free], typical[free], rtol=1e-3, atol=1e-6)
    np.testing.assert_array_equal(held.coefficients[~free], start.coefficients[~free])
    weak = replace(model, prior=Prior(typical, np.full(typical.shape, 3.0)))
    found, expected = fit(weak, start, free, ERRORS), fitting.fit(weak, start, free, ERRORS)
    again = [fitting.fit(weak, each, free, ERRORS) for each in disturbed(start, 1e-13)]
    for name in ("deviance", "objective", "coefficients"):
        agree(getattr(found, name), getattr(expected, name), [getattr(each, name) for each in again], name)


@pytest.mark.parametrize("most", [0, 20_000], ids=["by LAPACK", "in one call"])
def test_linearizations_are_those_of_numpy(case, monkeypatch, most):
    monkeypatch.setattr(compiled, "_MAX_ROW_NUMBERS", most)
    model, estimate, free = case
    for columns in (None, free, np.zeros_like(free)):
        found = linearize(model, estimate, 0.1, columns)
        expected = linearization.linearize(model, estimate, 0.1, columns)
        again = [linearization.linearize(model, each, 0.1, columns) for each in disturbed(estimate, 1e-13)]
        logs, factors = [
            [getattr(each, name) for each in (found, expected, *again)] for name in ("log_determinant", "problem")
        ]
        agree(logs[0], logs[1], logs[2:], "log-determinant")
        products = [factor.factor.T @ factor.factor for factor in factors]
        agree(products[0], products[1], products[2:], "information")


LEVELS = {
    "white": {},
    "memory": {"correlated": np.array([0.1, 0.2]), "memory": 0.7},
    "sensor walk": {"correlated": np.array([0.1, 0.2])},
    "force": {"force": np.array([0.3, 0.1]), "force_time": 1.5},
}


@pytest.mark.parametrize("kernel", ["compiled", "numpy"])
@pytest.mark.parametrize("levels", LEVELS.values(), ids=LEVELS)
def test_objects_at_other_levels_of_errors_are_linearized_as_one_by_one(library, monkeypatch, levels, kernel):
    assert library is not None
    monkeypatch.setenv(kernels.VARIABLE, kernel)
    begun = LatentProcesses(**{name: 1.5 * value for name, value in levels.items()})
    model, estimate = model_of()
    other = replace(estimate, coefficients=estimate.coefficients + 0.1)
    pairs = [model.with_latent(begun, own) for own in (estimate, other)]
    models, estimates = zip(*pairs, strict=True)
    columns = np.ones(estimate.coefficients.shape, dtype=bool)
    columns[0, 1] = False
    (mesh,), latent = model.meshes, LatentProcesses(**levels)
    scales = np.random.default_rng(0).uniform(0.5, 2.0, (2, *mesh.measured.shape))
    std = np.concatenate(scales) * model.observation.noise
    found, log_determinant = LinearizedObjects(models, estimates, columns).linearize(std, latent, 0.1)
    alone = [
        linearize(replace(each, meshes=[mesh.with_scale(scale)], latent=latent), own, 0.1, columns)
        for each, own, scale in zip(models, estimates, scales, strict=True)
    ]
    for factor, expected in zip(found, alone, strict=True):
        theirs = expected.problem.factor
        np.testing.assert_allclose(
            factor.T @ factor, theirs.T @ theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max() ** 2
        )
    np.testing.assert_allclose(log_determinant, sum(each.log_determinant for each in alone), rtol=1e-11)


def test_defects_and_their_derivatives_are_those_of_numpy(case, library):
    model, estimate, free = case
    for index, (mesh, states, latent) in enumerate(model.parts(estimate)):
        found = compiled.jacobians(library, model, packed(model), index, estimate, free)
        expected = jacobians(model.field(estimate.coefficients, free), mesh, states, latent)
        for name in ("defects", "start", "end", "coefficients"):
            own, theirs = getattr(found, name)[mesh.contiguous], getattr(expected, name)[mesh.contiguous]
            np.testing.assert_allclose(own, theirs, rtol=1e-11, atol=1e-12, err_msg=name)


def test_sensitivities_of_states_are_those_of_numpy(case, library):
    model, estimate, free = case
    for index, mesh in enumerate(model.meshes):
        if (steps := model.latent_steps[index]) is not None and steps.force is not None:
            continue  # Solutions without the force are computed with NumPy
        wanted = mesh.observed.any(axis=1)
        own = compiled.sensitivities(library, model, packed(model), index, estimate, free, wanted)
        states = estimate.states[index]
        theirs = linearization.sensitivities(model, mesh, states, estimate.coefficients, free, wanted)
        np.testing.assert_allclose(own, theirs, rtol=1e-9, atol=1e-10 * np.abs(theirs).max())


@pytest.mark.parametrize("text", FUNCTIONS_OF_TERMS.values(), ids=FUNCTIONS_OF_TERMS)
def test_every_function_of_terms_is_in_programs(library, text):
    model, estimate = model_of(text=f"terms:{text},y", inputs=())
    estimate = replace(estimate, coefficients=np.array([[0.7, 0.1], [-0.4, 0.3]]))
    free = np.ones((2, 2), dtype=bool)
    (mesh,), (states,) = model.meshes, estimate.states
    found = compiled.jacobians(library, model, packed(model), 0, estimate, free)
    expected = jacobians(model.field(estimate.coefficients, free), mesh, states)
    for name in ("defects", "start", "end"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-11, atol=1e-12, err_msg=name)
    on = mesh.contiguous
    np.testing.assert_allclose(found.coefficients[on], expected.coefficients[on], rtol=1e-11, atol=1e-12)


@pytest.mark.usefixtures("library")
def test_the_environment_chooses_who_computes(monkeypatch):
    model, start = of_prey(prey()[1])
    monkeypatch.setenv(kernels.VARIABLE, "numpy")
    np.testing.assert_array_equal(
        fit(model, start, SUPPORT, ERRORS).coefficients, fitting.fit(model, start, SUPPORT, ERRORS).coefficients
    )
    monkeypatch.setenv(kernels.VARIABLE, "fortran")
    with refused("kernel-unknown"):
        fit(model, start, SUPPORT, ERRORS)


def test_without_a_kernel_numpy_computes_unless_it_is_demanded(monkeypatch):
    model, start = of_prey(prey()[1])
    monkeypatch.setattr(kernels, "_loaded", lambda: None)
    monkeypatch.delenv(kernels.VARIABLE, raising=False)
    assert fit(model, start, SUPPORT, ERRORS).objective == fitting.fit(model, start, SUPPORT, ERRORS).objective
    monkeypatch.setenv(kernels.VARIABLE, "compiled")
    with refused("kernel-missing"):
        fit(model, start, SUPPORT, ERRORS)


def test_a_library_of_other_structures_is_not_used(monkeypatch):
    monkeypatch.setattr(kernels, "_STRUCTURES", kernels._STRUCTURES[::-1])
    assert kernels._loaded.__wrapped__() is None


@pytest.mark.usefixtures("library")
def test_the_same_fit_gives_the_same_bits():
    model, start = of_prey(prey()[1])
    one, other = (fit(model, start, SUPPORT, ERRORS) for _ in range(2))
    assert one.coefficients.tobytes() == other.coefficients.tobytes()
    assert one.states[0].tobytes() == other.states[0].tobytes()


@pytest.mark.usefixtures("library")
def test_numbers_beyond_all_bounds_end_as_with_numpy(monkeypatch):
    monkeypatch.setenv(kernels.VARIABLE, "compiled")
    model, start = model_of(text="terms:exp(x),y")
    far = replace(start, states=tuple(np.full_like(state, 800.0) for state in start.states))
    free = np.ones(start.coefficients.shape, dtype=bool)
    assert fit(model, far, free, ERRORS).objective == fitting.fit(model, far, free, ERRORS).objective == np.inf
    with pytest.raises(NotPositiveError):
        linearize(model, far, 0.1)


def test_polynomials_share_what_they_have_in_common():
    program = parse_library("poly:3").bind(Variables(("x", "y"))).program
    assert len(program.code) == 7  # Ten terms but for 1, x and y
