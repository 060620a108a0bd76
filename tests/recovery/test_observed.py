"""Laws of states that are seen through observation equations."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.discovery.method import ModelStructure
from commonlaw.discovery.observed import _begun, _WeakSearch
from commonlaw.law.parameters import named_parameters
from commonlaw.library import PolynomialLibrary
from tests.refusals import refused
from tests.simulations import solved

SCALE, OFFSET = 1.7, 0.4
OBSERVE = {"y": "s (x + z) + b"}


def rates(_, state, k):
    x, z = state
    return k[0] * x - k[1] * x * z, k[2] * x * z - k[3] * z


def animals(x, z):
    """Return a number of all animals, predators z among them."""
    return SCALE * (x + z) + OFFSET


def measured(objects=2, samples=60, seed=3, observed=animals, eaten=None):
    """Return prey x and what else is seen, y, with the coefficients of each object; that of x z in z' may be given."""
    rng, times, states, truth = np.random.default_rng(seed), np.linspace(0, 12, samples), [], []
    for _ in range(objects):
        k = rng.uniform((0.7, 0.7, 0.5, 0.6), (1.3, 1.3, 1.0, 1.2))
        k[2] = k[2] if eaten is None else eaten
        truth.append(k)
        x, z = solved(rates, rng.uniform(0.5, 1.5, 2), times, k).T
        columns = (each + 0.01 * each.std() * rng.standard_normal(samples) for each in (x, observed(x, z)))
        states.append(np.column_stack([*columns]))
    names = [f"lake {number}" for number in range(objects)]
    return cl.Trials.from_arrays([times] * objects, states, object=names, names=["x", "y"]), np.array(truth)


@pytest.fixture(scope="module")
def lakes():
    return measured()


@pytest.mark.slow
def test_the_law_of_a_latent_state_is_found_with_the_parameters_of_what_was_measured(lakes):
    trials, truth = lakes
    law = cl.discover(trials, observe=OBSERVE, latent_states="z", cache=False)
    assert law.structure[:2] == ("x' = a x - c x z", "z' = -d z + f x z")
    named = named_parameters(law)
    expected = np.column_stack([truth[:, [0, 1, 3, 2]], np.tile([SCALE, OFFSET], (len(truth), 1))])
    places = [named.names.index(name) for name in ("a", "c", "d", "f", "s", "b")]
    z = (named.values[:, places] - expected) / named.errors[:, places]
    assert np.abs(z).max() < 4
    assert np.sqrt(np.mean(z**2)) < 1.7


def test_the_law_is_found_through_a_product():
    trials, _ = measured(1, seed=2, observed=lambda x, z: x * z + 0.5 * x)
    law = cl.discover(trials, observe={"y": "x z + b x"}, latent_states="z", cache=False)
    assert law.structure[:2] == ("x' = a x - c x z", "z' = -d z + f x z")
    named = named_parameters(law)
    place = named.names.index("b")
    assert named.values[0, place] == pytest.approx(0.5, abs=4 * named.errors[0, place])


def test_squares_with_all_terms_are_those_of_noise_for_any_parameters(lakes):
    trials, _ = lakes
    search = _WeakSearch(_begun(trials, OBSERVE, ("x", "z"), None), trials, ModelStructure(1, PolynomialLibrary(2)))
    assert search.whiten(np.array([SCALE, OFFSET]))
    whole = np.ones(search.width, dtype=bool)
    rows = sum(len(target) for _, target in search.white) - search.objects * search.width
    squares = [search.fitted(np.array(p), whole)[0] for p in ([SCALE, OFFSET], [1.1, 0.0], [2.5, 0.9])]
    np.testing.assert_allclose(squares, squares[0], rtol=1e-3)
    assert squares[0] / rows == pytest.approx(1, abs=4 * np.sqrt(2 / rows))


@pytest.mark.slow
def test_fixed_coefficients_stay_and_the_others_are_estimated():
    trials, truth = measured(eaten=0.75)
    known, library = {("z", "x*z"): 0.75}, "terms:x,z,x*z"
    law = cl.discover(trials, observe=OBSERVE, latent_states="z", known=known, library=library, cache=False)
    assert law.structure[:2] == ("x' = a x - c x z", "z' = -d z + 0.75 x z")
    named = named_parameters(law)
    expected = np.column_stack([truth[:, [0, 1, 3]], np.tile([SCALE, OFFSET], (len(truth), 1))])
    places = [named.names.index(name) for name in ("a", "c", "d", "s", "b")]
    assert np.abs((named.values[:, places] - expected) / named.errors[:, places]).max() < 4


@pytest.mark.slow
def test_a_law_with_fixed_coefficients_has_the_likelihood_of_a_fit_with_these():
    trials, _ = measured(4, eaten=0.75)
    law = cl.discover(trials, observe=OBSERVE, latent_states="z", known={("z", "x*z"): 0.75}, cache=False)
    fitted = cl.fit("x' = a x - c x z; z' = -d z + 0.75 x z", trials, observe=OBSERVE, shared=["s", "b"])
    assert law.provenance.log_likelihood == pytest.approx(fitted.provenance.log_likelihood, abs=1e-3)


@pytest.mark.slow
def test_known_physics_are_equations_or_a_law_of_the_states():
    trials, _ = measured(4, eaten=0.75)
    seen = cl.fit("x' = 0; z' = 0.75 x z; y = s (x + z)", trials.until(2))
    for known in ("x' = 0; z' = 0.75 x z", seen):
        law = cl.discover(trials, observe=OBSERVE, latent_states="z", known=known, library="poly:2", cache=False)
        assert law.structure[:2] == ("x' = a x - c x z", "z' = -d z + 0.75 x z")
    owners = dict(zip(trials.objects, (0.7, 0.8, 0.9, 1.0), strict=True))
    with refused("known-by-object-with-observation", objects=trials.objects):
        cl.discover(trials, observe=OBSERVE, latent_states="z", known={("z", "x*z"): owners}, cache=False)


def test_what_the_law_does_not_determine_is_named():
    trials, _ = measured(1)
    with refused("parameters-not-identified"):
        cl.discover(trials, observe={"y": "s z"}, latent_states="z", library="poly:1", cache=False)


def test_what_does_not_fit_is_refused(lakes):
    trials, _ = lakes
    with refused("observed-states", measured=("x", "y")):
        cl.discover(trials, observe=OBSERVE, cache=False)
    with refused("unknown-name"):
        cl.discover(trials, observe={"w": "s z"}, latent_states="z", cache=False)
    with refused("observed-order", order=2):
        cl.discover(trials, order=2, observe=OBSERVE, latent_states="z", cache=False)
    with refused("observation-not-invertible"):
        cl.discover(trials, observe={"y": "s sqrt(x) + b"}, latent_states="z", cache=False)
    short, _ = measured(samples=10)
    with refused("observed-trial-short", samples=10):
        cl.discover(short, observe=OBSERVE, latent_states="z", cache=False)


def test_the_command_takes_observations_and_latent_states(tmp_path, run, monkeypatch):
    asked = []

    def discover(trials, **settings):
        asked.append((trials.schema.states, settings["observe"], settings["latent_states"]))
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.discover", discover)
    measured()[0].to_csv(tmp_path / "lakes.csv")
    columns = ["--object", "object", "--trial", "trial", "--time", "t", "--state", "x", "--state", "y"]
    run("discover", "lakes.csv", *columns, "--observe", "y = s (x + z) + b", "--latent", "z")
    assert asked == [(("x", "y"), {"y": "s (x + z) + b"}, ("z",))]
