"""Laws whose coefficients, and their covariance, are known."""

import numpy as np

import commonlaw as cl
from commonlaw.experiments.experiment import Experiment
from commonlaw.experiments.predictive import Hypothesis
from commonlaw.likelihood import ErrorModel

NOISE = 0.1


def known(equation, values, covariance, noise=NOISE, objects=("ball",), errors=None, inputs=()):
    """Return a law with these values of its coefficients, for every object, and their covariance."""
    law = cl.Law.from_text(
        equation, {name: dict.fromkeys(objects, value) for name, value in values.items()}, inputs=inputs
    )
    own = np.tile(np.asarray(covariance, dtype=float), (len(objects), 1, 1))
    uncertainty = cl.law.Uncertainty(
        own, noise=np.full(len(law.schema.states), noise), error_model=errors or ErrorModel()
    )
    return cl.Law(law.terms, law.schema, law.order, law.objects, law.coefficients, uncertainty, law.provenance)


def falling(error=1.0):
    return known("x'' = -g", {"g": 9.8}, [[error**2]])


def said(law, settings):
    """Return what a law says of one experiment."""
    hypothesis = Hypothesis.of(law, law.objects)
    ((found,),) = hypothesis.predictions([Experiment.of(law, law.objects, settings, {})])
    return found
