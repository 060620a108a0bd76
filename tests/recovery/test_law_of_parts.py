"""Laws of the objects of many files: proposed by groups, judged by all, fitted file by file."""

from functools import partial

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.law import from_json, to_json
from commonlaw.law.parameters import standard_errors
from tests.refusals import refused
from tests.streams import ROLES, drops_with_masses, write_files

METHOD = cl.TrajectoryLikelihood()


@pytest.fixture(scope="module")
def whole():
    return drops_with_masses(6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, whole):
    return write_files(whole, tmp_path_factory.mktemp("runs"), 2)


@pytest.fixture(scope="module")
def stream(folder):
    return cl.TrialStream.from_parquet(folder, **ROLES, properties=["mass"])


@pytest.fixture(scope="module")
def law(stream):
    return cl.discover(stream, order=2, library="poly:2", method=METHOD)


def test_the_law_of_all_files_is_that_of_all_trials(law, whole):
    assert law.structure == ("x'' = a + b v",)
    assert law.objects == whole.objects
    together = cl.refine(law, whole, errors="white", partial_pooling=True)
    # Each file has a noise level of its own, so that weights differ a little
    for ours, theirs in (
        (law.uncertainty.pooled, together.uncertainty),
        (law.uncertainty, together.uncertainty.unpooled),
    ):
        errors, expected = (np.sqrt(np.diagonal(each.covariance, axis1=1, axis2=2)) for each in (ours, theirs))
        np.testing.assert_allclose(errors, expected, rtol=0.2)
    off = np.abs(law.uncertainty.pooled.coefficients - together.coefficients[:, law.support])
    assert (off < 0.3 * standard_errors(together)[:, law.support]).all()
    alone = together.uncertainty.unpooled.coefficients
    np.testing.assert_allclose(law.coefficients[:, law.support], alone, rtol=1e-4)
    assert law.uncertainty.noise == pytest.approx(together.uncertainty.noise, rel=0.05)
    said = {step.stage: step.choice for step in law.history}
    assert said["proposals"] == "1 law of 2 groups of at most 10 objects"
    visited = law.provenance.domain.visited["x"]
    assert visited == (min(each.states.min() for each in whole), max(each.states.max() for each in whole))


def test_what_decides_the_coefficients_is_found_by_the_properties_of_files(law):
    gravity, drag = law.explain().uncertainty.explanation.relations
    assert gravity.kind.value == "universal"
    assert (drag.properties, [float(exponent) for exponent in drag.exponents]) == (("mass",), [-1.0])
    assert drag.factors[0] == pytest.approx(-0.3, rel=0.05)


@pytest.mark.slow
def test_errors_by_the_bootstrap_are_those_of_all_trials_together(stream, whole):
    settings = {"covariance": "bootstrap", "noise": {"x": 0.01}, "errors": "white", "partial_pooling": False, "seed": 3}
    law = cl.discover(stream, order=2, library="poly:1", method=cl.TrajectoryLikelihood(**settings))
    together = cl.refine(law, whole, **settings)
    np.testing.assert_allclose(law.coefficients, together.coefficients, rtol=1e-8)
    np.testing.assert_allclose(law.uncertainty.covariance, together.uncertainty.covariance, rtol=1e-6)


def test_an_object_in_two_files_is_refused(tmp_path, whole):
    for trial in ("1", "2"):
        whole.select(object=["Ball 1", "Ball 2"], trial=trial).to_parquet(tmp_path / f"{trial}.parquet")
    with refused("object-in-two-files", object="Ball 1"):
        cl.discover(cl.TrialStream.from_parquet(tmp_path, **ROLES), order=2, library="poly:1", method=METHOD)


def test_an_object_in_two_files_is_refused_before_a_fit(tmp_path):
    resting = cl.Trials.from_arrays(np.arange(9.0), np.ones(9), names=["x"])
    for number in ("1", "2"):
        resting.to_parquet(tmp_path / f"{number}.parquet")
    stream = cl.TrialStream.from_parquet(tmp_path)
    for learn in (partial(cl.fit, "x' = -k x"), partial(cl.refine, cl.Law.from_text("x' = -0.5 x"))):
        with refused("object-in-two-files", object=resting.objects[0]):
            learn(stream)
    with refused("object-in-two-files", object=resting.objects[0]):
        cl.discover(stream, order=1, library="poly:1", method=METHOD)


def test_what_does_not_go_with_files_is_refused(stream, folder):
    for library in ("saturating", "ratio(poly:1, poly:1)"):
        with refused("stream-with-option", what="a term with nonlinear parameters"):
            cl.discover(stream, order=2, library=library, method=METHOD)
    with refused("stream-properties"):
        cl.TrialStream.from_parquet(folder, **ROLES, properties={"Ball 1": {"mass": 1.0}})


SETTINGS = {"noise": {"x": 0.01}, "errors": "white"}


@pytest.mark.parametrize("pooling", [True, False])
def test_a_law_in_mind_is_fitted_file_by_file_as_in_memory(stream, whole, pooling):
    law = cl.fit("x'' = -g - c v", stream, **SETTINGS, partial_pooling=pooling)
    together = cl.fit("x'' = -g - c v", whole, **SETTINGS, partial_pooling=pooling)
    assert law.objects == whole.objects
    assert law.properties == together.properties
    np.testing.assert_allclose(law.coefficients, together.coefficients, rtol=1e-7)
    np.testing.assert_allclose(standard_errors(law), standard_errors(together), rtol=1e-5)
    assert law.provenance.calls == together.provenance.calls
    assert law.explain().uncertainty.explanation.relations[1].factors[0] == pytest.approx(-0.3, rel=0.05)
    assert from_json(to_json(law)).structure == together.structure


def test_properties_of_objects_stand_in_equations_of_a_stream(stream, whole):
    np.testing.assert_allclose(
        *(cl.fit("x'' = -9.8 - mass v", each, **SETTINGS).coefficients for each in (stream, whole))
    )


def test_a_law_of_few_objects_is_refined_for_all_of_a_stream(stream, whole):
    few = cl.fit("x'' = -9.8 - c v", whole.select(object=["Ball 1", "Ball 2"]))
    law = cl.refine(few, stream, **SETTINGS)
    together = cl.fit("x'' = -9.8 - c v", whole, **SETTINGS)
    np.testing.assert_allclose(law.coefficients, together.coefficients, rtol=1e-7)
    again = cl.refine(law, stream, **SETTINGS)
    np.testing.assert_allclose(again.coefficients, cl.refine(together, whole, **SETTINGS).coefficients, rtol=1e-7)
    assert "each object was fitted to its trials, file by file" in [each.reason for each in law.history]


def test_what_is_not_fitted_file_by_file_is_refused(stream, whole):
    falling = cl.fit("x'' = -g", whole, **SETTINGS)
    for use, said in [
        (
            lambda: cl.fit("x'' = -k abs(v)^p sign(v)", stream),
            Diagnostic("not-file-by-file", {"what": "nonlinear parameters are"}),
        ),
        (lambda: cl.fit("x[k+1] = a x", stream), Diagnostic("not-file-by-file", {"what": "a discrete-time law is"})),
        (lambda: cl.fit("x' = -k x + d; d' = -a d", stream, initial_values={"d": 1.0}), "not-for-streams"),
        (lambda: cl.fit("x'' = -g", whole, client=object()), "cluster-client-without-files"),
        (lambda: cl.refine(falling, whole, client=object()), "cluster-client-without-files"),
        (
            lambda: cl.refine(falling, stream, covariance="x"),
            Diagnostic("unknown-name", {"kind": "covariance"}),
        ),
    ]:
        with refused(said):
            use()


@pytest.mark.slow
def test_evidences_of_files_add_up_to_nearly_those_of_all_trials(stream, whole):
    laws = {text: cl.fit(text, whole, **SETTINGS) for text in ("x'' = a + b v", "x'' = a + b v^2", "x'' = a")}
    found, together = (cl.compare(laws, each, **SETTINGS) for each in (stream, whole))
    assert found["law"].tolist() == together["law"].tolist()
    assert found["coefficients"].tolist() == together["coefficients"].tolist()
    # What objects have in common beforehand is found in each file by itself
    np.testing.assert_allclose(found["2 log B"], together["2 log B"], rtol=3e-3)
    assert found["probability"].sum() == pytest.approx(1.0)


def test_outliers_in_files_count_linearly_by_default(tmp_path):
    random, times, trials = np.random.default_rng(3), np.linspace(0.0, 4.0, 25), list[np.ndarray]()
    for rate in (0.5, 0.9):
        x = 4 * np.exp(-rate * times) + 0.05 * random.standard_normal(25)
        x[8] += 2.0
        trials.append(x)
    names, parts = ["a", "b"], list[cl.Trials]()
    for name, x in zip(names, trials, strict=True):
        parts.append(cl.Trials.from_arrays([times], [x], names=["x"], object=name))
        parts[-1].to_parquet(tmp_path / f"{name}.parquet")
    stream, table = cl.TrialStream.from_parquet(tmp_path), parts[0].with_trials([*parts[0], *parts[1]])
    alone = cl.fit("x' = -k x", table)
    laws = [cl.fit("x' = -k x", stream), cl.refine(alone, stream)]
    laws.append(cl.discover(stream, order=1, library="terms:x", method=cl.TrajectoryLikelihood(n_jobs=1)))
    for law in laws:
        assert law.uncertainty.huber_threshold == 4.0
        np.testing.assert_allclose(law.coefficients, alone.coefficients, rtol=2e-3)
    squares = cl.fit("x' = -k x", stream, errors="white")
    assert squares.uncertainty.huber_threshold == np.inf
    assert np.all(abs(squares.coefficients / alone.coefficients - 1) > 0.01)
    rivals = {text: cl.fit(text, table) for text in ("x' = -k x", "x' = -k x + b")}
    apart = sum(cl.compare(rivals, part, n_jobs=1)["2 log B"][1] for part in parts)
    assert cl.compare(rivals, stream)["2 log B"][1] == pytest.approx(apart, abs=0.01)
