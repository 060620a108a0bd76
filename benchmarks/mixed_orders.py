"""Simulated systems whose states have different orders: machines, heat and what drives them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw.array_types import Floats

OBJECTS, TRIALS, SAMPLES = 3, 2, 100


@dataclass(frozen=True)
class MixedSystem:
    """Equations of states, of which some are of second order.

    Parameters
    ----------
    orders
        Of each state, by its name.
    library
        Candidate terms.
    rates
        The derivatives of all states and then of the rates of those of second order, from these, the coefficients of
        an object and the input.
    coefficients
        Typical ones; those of objects scatter by 15 %.
    starts
        Typical sizes of states and rates at first, which are normal.
    end
        Of each trial.
    driven
        Whether a sine is measured as the input u, which is the last argument of the rates.
    """

    orders: Mapping[str, int]
    library: str
    rates: Callable[[Floats, Floats, float], list[float]]
    coefficients: tuple[float, ...]
    starts: tuple[float, ...]
    end: float
    driven: bool = False

    def measured(self, level: float, seed: int) -> cl.Trials:
        """Return trials with noise relative to the spread of each state, drawn by the seed."""
        generator, noise = np.random.default_rng(0), np.random.default_rng(seed)
        times, states, inputs, owners = np.linspace(0, self.end, SAMPLES), list[Floats](), list[Floats](), []
        for i in range(OBJECTS):
            own = np.array(self.coefficients) * (1 + 0.15 * generator.standard_normal(len(self.coefficients)))
            for _ in range(TRIALS):
                phase, start = generator.uniform(0, 6), generator.standard_normal(len(self.starts)) * self.starts
                states.append(self._solved(times, own, phase, start))
                inputs.append(np.sin(times + phase)[:, np.newaxis])
                owners.append(f"object {i + 1}")
        scale = level * np.mean([state.std(axis=0) for state in states], axis=0)
        values = [state + scale * noise.standard_normal(state.shape) for state in states]
        names = [*self.orders, *(["u"] if self.driven else [])]
        return cl.Trials.from_arrays(
            [times] * len(values), values, object=owners, names=names, inputs=inputs if self.driven else None
        )

    def _solved(self, times: Floats, coefficients: Floats, phase: float, start: Floats) -> Floats:
        def rates(t: float, z: Floats) -> list[float]:
            return self.rates(z, coefficients, np.sin(t + phase))

        found = solve_ivp(rates, (0.0, self.end), start, t_eval=times, rtol=1e-9, atol=1e-11)
        return np.asarray(found.y[: len(self.orders)].T)


MIXED = {
    "motor with a pendulum": MixedSystem(
        {"theta": 2, "i": 1},
        "poly:1 + terms:sin(theta)",
        lambda z, c, u: [z[2], -c[3] * z[1] - c[4] * z[2] + u, -c[0] * np.sin(z[0]) - c[1] * z[2] + c[2] * z[1]],
        (4.0, 0.3, 1.5, 1.2, 0.4),
        (1.0, 0.5, 1.0),
        8.0,
        driven=True,
    ),
    "spring that heats and softens": MixedSystem(
        {"T": 1, "x": 2},
        "poly:2",
        lambda z, c, _: [c[0] * z[2] ** 2 - c[1] * z[0], z[2], -c[2] * z[1] + c[3] * z[0] * z[1] - c[4] * z[2]],
        (0.4, 0.5, 3.0, 0.8, 0.2),
        (0.5, 1.0, 1.0),
        6.0,
    ),
    "mass between two that relax": MixedSystem(
        {"x": 1, "y": 2, "z": 1},
        "poly:1",
        lambda z, c, _: [-c[0] * z[0] + c[1] * z[1], z[3], -c[2] * z[2] + z[1], -c[3] * z[1] + z[0] - c[4] * z[3]],
        (1.0, 0.5, 0.7, 2.0, 0.3),
        (1.0, 1.0, 1.0, 1.0),
        8.0,
    ),
    "levitated ball": MixedSystem(
        {"y": 2, "i": 1},
        "poly:2",
        lambda z, c, u: [z[2], -c[3] * z[1] + u, -c[0] * z[0] - c[1] * z[2] + c[2] * z[1] ** 2],
        (5.0, 0.4, 2.0, 0.9),
        (0.5, 1.0, 0.5),
        8.0,
        driven=True,
    ),
    "two pendulums on springs": MixedSystem(
        {"x": 2, "y": 2},
        "poly:1 + terms:sin(x),sin(y)",
        lambda z, c, _: [
            z[2],
            z[3],
            -c[0] * np.sin(z[0]) + c[1] * (z[1] - z[0]),
            -c[0] * np.sin(z[1]) + c[2] * (z[0] - z[1]),
        ],
        (3.0, 0.8, 1.2),
        (1.0, 1.0, 0.5, 0.5),
        8.0,
    ),
}
