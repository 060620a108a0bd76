"""Objects that do not follow the law of the others are named and left out; those that only show more of it are not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw.diagnostics import OutcomeKind
from commonlaw.discovery import estimator
from commonlaw.discovery.candidate_search import CandidateSearch
from commonlaw.discovery.method import ModelStructure
from commonlaw.discovery.strange_objects import with_objects_apart
from commonlaw.errors import CommonlawError
from commonlaw.inference.search.strange_objects import suspects
from commonlaw.runtime.time_limit import TimeLimit

TIMES = np.linspace(0, 5, 20)
RATES = (0.4, 0.5, 0.7, 0.9)


def cooling(last, noise=0.3):
    """Four cups that cool by x' = k (20 - x), and a fifth with another right-hand side."""
    generator, laws = np.random.default_rng(3), [lambda x, k=k: k * (20 - x) for k in RATES]
    curves = [
        solve_ivp(lambda _, x, law=law: law(x), (0, 5), [80.0], t_eval=TIMES, rtol=1e-8).y.T for law in (*laws, last)
    ]
    states = [curve + noise * generator.standard_normal(curve.shape) for curve in curves]
    return cl.Trials.from_arrays([TIMES] * 5, states, names=["x"], object=[f"cup {i}" for i in range(1, 6)])


def springs(largest, others=0.15, cubic=-0.5):
    """Six springs x'' = -k x - 0.2 v + c x^3, one of which swings further than the others."""
    generator, times, states = np.random.default_rng(1), np.linspace(0, 8, 60), []
    for i, k in enumerate(np.linspace(2, 4, 6)):
        start = [largest if i == 5 else others, 0.0]

        def rates(_, z, k=k):
            return [z[1], -k * z[0] - 0.2 * z[1] + cubic * z[0] ** 3]

        x = solve_ivp(rates, (0, 8), start, t_eval=times, rtol=1e-9, atol=1e-11).y[:1].T
        states.append(x + 0.01 * generator.standard_normal(x.shape))
    return cl.Trials.from_arrays([times] * 6, states, names=["x"], object=[f"s{i}" for i in range(6)])


@pytest.fixture(scope="module")
def strange():
    """Cups of which the fifth grows logistically in the opposite sense, and the law that is found."""
    trials = cooling(lambda x: 0.03 * (x - 10) * (x - 85))
    return trials, cl.discover(trials, order=1, library="poly:2")


def test_an_object_with_another_law_is_named_and_does_not_decide_that_of_the_others(strange):
    _, law = strange
    assert law.objects == tuple(f"cup {i}" for i in range(1, 5))
    assert law.structure == ("x' = a + b x",)
    assert law.coefficients[:, 0, 1] == pytest.approx(-np.array(RATES), rel=0.1)
    (outcome,) = [outcome for outcome in law.diagnostics if outcome.kind is OutcomeKind.OBJECTS_DIFFER]
    assert (outcome.code, outcome.where) == ("strange-object", "cup 5")
    assert [step.choice for step in law.history if step.stage == "strange objects"] == ["cup 5 left out"]
    assert {*law.params["object"]} == {*law.objects}


def test_the_others_have_the_law_that_they_have_alone(strange):
    trials, law = strange
    alone = cl.discover(trials.select(object=law.objects), order=1, library="poly:2")
    np.testing.assert_allclose(law.coefficients, alone.coefficients, rtol=1e-6)


def test_all_objects_are_kept_together_on_request(strange):
    trials, _ = strange
    method = cl.TrajectoryLikelihood(strange_objects="keep")
    law = cl.discover(trials, order=1, library="poly:2", method=method)
    assert law.objects == trials.objects
    assert law.structure == ("x' = a + b x + c x^2",)


def test_the_probability_is_that_of_two_laws_against_one():
    """By the scores of searches: of all cups, of four, and of the fifth with a law of its own and with that of four."""
    trials = cooling(lambda x: 0.015 * (400 - x * x), noise=0.8)
    search = CandidateSearch(trials, cl.TrajectoryLikelihood(), lambda _: None)

    def found(some, degree=2):
        structure = ModelStructure(1, cl.library.PolynomialLibrary(degree), possible=((1,),))
        return some.plain(structure, is_coarse=True)

    candidate = with_objects_apart(found(search), search, found, is_plain=True)
    assert candidate.apart is not None
    (stray,) = candidate.apart.objects
    own = search.of_objects(["cup 5"])
    searched = search, search.of_objects(trials.objects[:4]), own
    of_all, of_four, of_fifth = (some.resolved(found(some)).score for some in searched)
    shared = own.resolved(found(own, degree=1)).score
    prior = 2 * np.log(13)  # Of k strange objects of five B(1 + k, 14 - k): 1 / 14 for none, 1 / (13 14) for one
    against = of_four.total + of_fifth.total + prior + np.log(100) - of_all.total  # And a level of noise, log n
    assert candidate.apart.score - of_all == pytest.approx(against, abs=1e-6)
    follows = shared.total - shared.parts["structure"]
    shares = 1 / (1 + np.exp(against / 2)), 1 / (1 + np.exp((of_fifth.total - follows) / 2))
    assert stray.probability == pytest.approx(np.prod(shares), rel=1e-3)
    assert 0.5 < stray.probability < 0.99


def test_an_object_that_reveals_a_term_is_not_strange():
    law = cl.discover(springs(largest=2.0), order=2, library="poly:3")
    assert law.structure == ("x'' = a x + b v + c x^3",)
    assert len(law.objects) == 6
    assert law.provenance.domain.strange == ()


def test_the_same_object_is_strange_if_others_exclude_its_term():
    trials, linear = springs(largest=2.0), springs(largest=2.0, others=2.0, cubic=0.0)
    mixed = trials.with_trials([*linear.trials[:5], trials.trials[5]])
    law = cl.discover(mixed, order=2, library="poly:3")
    assert (law.structure, law.provenance.domain.strange) == (("x'' = a x + b v",), ("s5",))


def test_objects_that_are_alike_have_the_same_law_and_score_with_the_check_and_without():
    trials = cooling(lambda x: 0.8 * (20 - x))
    laws = [
        cl.discover(trials, order=1, library="poly:2", method=cl.TrajectoryLikelihood(strange_objects=how))
        for how in ("exclude", "keep")
    ]
    assert laws[0].structure == ("x' = a + b x",)
    assert laws[0].objects == trials.objects
    np.testing.assert_array_equal(laws[0].coefficients, laws[1].coefficients)
    assert laws[0].comparison.equals(laws[1].comparison)


def test_strange_objects_are_refused_by_name_and_left_out_of_whole_tables(strange, tmp_path):
    trials, law = strange
    law.save(tmp_path / "law.json")
    law = cl.Law.load(tmp_path / "law.json")
    assert law.provenance.domain.strange == ("cup 5",)
    with pytest.raises(CommonlawError) as refused:
        law.predict(trials.select(object="cup 5"))
    assert refused.value.code == "law-of-other-objects"
    assert "cup 5" in str(refused.value)
    forecast = law.predict(trials)
    assert forecast.trials.objects == law.objects
    assert any("cup 5" in note for note in forecast.trials.notes)
    verdict = law.assess(trials)
    assert verdict.usable
    assert any("cup 5" in line for line in verdict.not_assessable)
    again = cl.refine(law, trials)
    assert (again.objects, again.provenance.domain.strange) == (law.objects, ("cup 5",))


def test_laws_are_compared_by_the_objects_that_all_have(strange):
    trials, law = strange
    whole = cl.fit("x' = a + b x + c x^2", trials)
    four = trials.select(object=law.objects)
    frame, alone = cl.compare([law, whole], trials), cl.compare([law, cl.fit("x' = a + b x + c x^2", four)], four)
    assert frame["2 log B"].tolist() == pytest.approx(alone["2 log B"].tolist(), abs=1e-3)


def test_an_object_is_strange_to_a_law_of_richer_terms():
    """Plain terms imitate saturation and a square alike; the fifth object would add the square for all."""
    generator, times, states = np.random.default_rng(0), np.linspace(0, 5, 30), []
    rates = [lambda x, i=i: -(1 + 0.15 * i) * x / (0.6 + 0.1 * i + x) for i in range(4)]
    for rate in (*rates, lambda x: -0.25 * x**2):
        runs = [solve_ivp(lambda _, x, f=rate: f(x), (0, 5), [x], t_eval=times, rtol=1e-8).y.T for x in (4.0, 3.0)]
        states += [run + 0.03 * generator.standard_normal(run.shape) for run in runs]
    names = [f"enzyme {i}" for i in range(5) for _ in range(2)]
    trials = cl.Trials.from_arrays([times] * 10, states, names=["s"], object=names)
    law = cl.discover(trials, order=1, library="poly:2 + saturating")
    assert (law.structure, law.provenance.domain.strange) == (("s' = a s/(K + s)",), ("enzyme 4",))


def test_errors_of_a_coarse_mesh_are_no_reason():
    """Exact solutions of a Brusselator, of which some change several times faster than others."""
    trials, times = [], np.linspace(0, 20, 150)
    for b in (1.8, 2.2, 2.6, 3.0, 3.6):

        def rates(_, z, b=b):
            return [1 - (b + 1) * z[0] + z[0] ** 2 * z[1], b * z[0] - z[0] ** 2 * z[1]]

        states = solve_ivp(rates, (0, 20), [1.2, 2.0], t_eval=times, rtol=1e-10, atol=1e-12).y.T
        trials.append(states)
    data = cl.Trials.from_arrays([times] * 5, trials, names=["x", "y"], object=[f"o{i}" for i in range(5)])
    search = CandidateSearch(data, cl.TrajectoryLikelihood(), lambda _: None)
    structure = ModelStructure(1, cl.library.PolynomialLibrary(3), possible=((1,),))

    def found(some):
        return some.plain(structure, is_coarse=False)

    candidate = found(search)
    assert suspects(candidate.pool, excluded=0)
    assert with_objects_apart(candidate, search, found, is_plain=True).apart is None


def test_an_object_in_other_units_is_named_with_the_factor():
    random, times, tables = np.random.default_rng(11), np.linspace(0, 6, 30), list[np.ndarray]()
    for rate in (0.3, 0.5, 0.8, 0.6):
        tables.append(20 + 60 * np.exp(-rate * times) + 0.5 * random.standard_normal(30))
    tables[3] *= 1000
    law = cl.discover(cl.Trials.from_arrays([times] * 4, tables, object=list("abcd"), names=["x"]), order=1)
    assert law.structure == ("x' = a + b x",)
    assert law.objects == ("a", "b", "c")
    (stray,) = (outcome for outcome in law.diagnostics if outcome.where == "d")
    assert stray.code == "strange-object-units"
    assert "1000 times" in str(stray)


def test_pendulums_of_which_one_is_in_degrees_have_the_sine_of_the_others():
    """By cubic terms all have one law, as these take any unit."""
    random, times, tables = np.random.default_rng(3), np.linspace(0, 6, 100), list[np.ndarray]()
    for squared, start in ((19.6, 1.9), (14.7, 1.2), (12.0, 2.2), (9.8, 1.0), (8.6, 2.0)):

        def rates(_, z, squared=squared):
            return [z[1], -squared * np.sin(z[0]) - 0.15 * z[1]]

        x = solve_ivp(rates, (0, 6), [start, 0.0], t_eval=times, rtol=1e-9).y[:1].T
        tables.append(x + 0.01 * random.standard_normal(x.shape))
    tables[2] = np.degrees(tables[2])
    law = cl.discover(cl.Trials.from_arrays([times] * 5, tables, object=list("abcde"), names=["angle"]))
    assert law.structure == ("angle'' = a v + b sin(angle)",)
    assert law.provenance.domain.strange == ("c",)
    assert "strange-object-units" in [outcome.code for outcome in law.diagnostics]


def test_noise_that_grows_with_the_value_is_no_sign_of_other_units():
    random, times, tables = np.random.default_rng(0), np.arange(0, 20, 0.5), list[np.ndarray]()
    for rate, most in ((0.4, 100), (0.5, 120), (0.6, 90), (0.7, 110), (0.5, 1000)):
        exact = most / (1 + (1 / random.uniform(0.03, 0.15) - 1) * np.exp(-rate * times))
        tables.append(exact * (1 + 0.05 * random.standard_normal(40)))
    law = cl.discover(cl.Trials.from_arrays([times] * 5, tables, object=list("abcde"), names=["N"]), order=1)
    assert (law.structure, law.objects) == (("N' = a N + b N^2",), tuple("abcde"))


def test_noise_that_outliers_alone_scatter_is_one_noise():
    random, times, tables = np.random.default_rng([0, 77]), np.linspace(0, 6, 40), list[np.ndarray]()
    for rate in (0.3, 0.5, 0.8):
        errors = 0.5 * random.standard_normal(40)
        errors[random.random(40) < 0.1] += random.choice([-10.0, 10.0])
        tables.append(20 + 60 * np.exp(-rate * times) + errors)
    law = cl.discover(cl.Trials.from_arrays([times] * 3, tables, object=list("abc"), names=["x"]), order=1)
    assert law.structure == ("x' = a + b x",)
    assert not law.uncertainty.error_model
    assert "outliers" in [step.stage for step in law.history]


def test_under_a_limit_that_is_over_when_objects_are_left_out_the_law_is_that_of_the_others(strange, monkeypatch):
    trials, law = strange
    seconds, without = [0.0], CandidateSearch.without_strange_of

    def late(search, candidate):
        seconds[0] = 40.0
        return without(search, candidate)

    monkeypatch.setattr(estimator, "limit_of", lambda *_: TimeLimit(60, clock=lambda: seconds[0]))
    monkeypatch.setattr(CandidateSearch, "without_strange_of", late)
    limited = cl.discover(trials, order=1, library="poly:2", cache=False)
    assert limited.provenance.is_stopped
    assert limited.objects == law.objects == trials.objects[:-1]
    assert limited.provenance.domain.strange == (trials.objects[-1],)
    np.testing.assert_allclose(limited.coefficients, law.coefficients, rtol=0.05)
