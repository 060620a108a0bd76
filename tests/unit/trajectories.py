"""Models of trajectories that several tests look at."""

import numpy as np

from benchmarks.variational import solve
from commonlaw.integration import VectorField
from commonlaw.library import Variables, parse_library
from commonlaw.likelihood import Estimate, ObservationModel, TrajectoryModel, interpolate, linearize, meshes
from commonlaw.trials import Trial


def terms_of(library, states, inputs=(), order=1):
    orders = order if isinstance(order, tuple) else ()
    return parse_library(library).bind(Variables(tuple(states), tuple(inputs), orders=orders))


def trial(times, states, inputs=None, name="1"):
    return Trial("object", name, times, states, np.empty((len(times), 0)) if inputs is None else inputs)


DIFFICULT = [
    (1, "poly:2 + fourier:1 + terms:x*t,sin(2*t)", ("x", "y")),
    (2, "poly:2 + fourier:1 + terms:x*t,v*u^2", ("x", "v")),
    (2, "poly:2 + terms:sin(v*t)", ("x", "y", "v", "w")),
    ((1, 2, 2), "poly:2 + terms:sin(v*t)", ("x", "y", "z", "v", "w")),
]


def difficult(order, library, names):
    """A vector field, some of whose coefficients are free, an irregular mesh of two segments, and states."""
    generator = np.random.default_rng(order)
    terms = terms_of(library, names, ("u",), order)
    equations = len(order) if isinstance(order, tuple) else len(names) // order
    trials = []
    for n in (4, 3):
        times = np.cumsum(generator.uniform(0.1, 0.4, n))
        trials.append(
            trial(times, generator.standard_normal((n, equations)), generator.standard_normal((n, 1)), str(n))
        )
    (mesh,) = meshes(trials, points=2)
    coefficients = generator.standard_normal((equations, len(terms)))
    coefficients[generator.random(coefficients.shape) < 0.3] = 0
    free = generator.random(coefficients.shape) < 0.4
    states = generator.standard_normal((len(mesh), len(names)))
    return VectorField(terms, coefficients, order, free=free), mesh, states


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
    filled = [
        np.column_stack([np.interp(times, times[np.isfinite(c)], c[np.isfinite(c)]) for c in each.T])
        for each in measured
    ]
    (mesh,) = meshes([trial(times, each, name=str(i)) for i, each in enumerate(filled)], points)
    mesh.measured[np.isfinite(mesh.measured[:, 0])] = np.concatenate(measured)
    model = TrajectoryModel(
        terms_of("terms:x,y,x*y", VARIABLES), (mesh,), ObservationModel(NOISE, huber_threshold), NOISE
    )
    return model, Estimate(tuple(interpolate(filled, points)), np.where(SUPPORT, [[1.1, 0, -0.8], [0, -1, 0.5]], 0.0))


def information(model, estimate, support, model_error):
    """What the measurements hold on the coefficients of the support."""
    columns = linearize(model, estimate, model_error).problem.factor[:, :-1][:, support.ravel()]
    return columns.T @ columns
