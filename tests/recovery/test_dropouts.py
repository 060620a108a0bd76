"""Objects that were measured too few times for their coefficients, as those that dropped out of a study."""

import numpy as np

import commonlaw as cl


def test_what_two_samples_do_not_identify_has_no_small_error():
    generator, times = np.random.default_rng(0), [np.linspace(0, 9, 19)] * 4 + [np.array([0.0, 0.5])]
    states = [np.exp(-(0.3 + 0.05 * i) * t) + 0.01 * generator.standard_normal(len(t)) for i, t in enumerate(times)]
    trials = cl.Trials.from_arrays(times, states, object=list("abcde"), names=["x"])
    law = cl.fit("x' = a x + b x^2", trials)
    errors = law.params["standard error"].to_numpy().reshape(5, 2)
    assert (errors[4] > 1e3 * errors[:4].max()).all()
    rest = cl.fit("x' = a x + b x^2", trials.select(object=list("abcd")))
    np.testing.assert_allclose(law.coefficients[:4], rest.coefficients, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(errors[:4].ravel(), rest.params["standard error"], rtol=0.05)
    assert any(note.code == "not-pooled" for note in cl.law.pool_objects(law).diagnostics)
