"""Which experiment next: what would tell plausible laws apart, and their coefficients, before it is measured."""

from commonlaw.experiments.design import design as design
from commonlaw.experiments.plan import Design as Design
from commonlaw.experiments.suggestions import Suggestion as Suggestion, suggestions as suggestions
