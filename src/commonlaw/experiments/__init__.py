"""Which experiment next: what would tell plausible laws apart, and their coefficients, before it is measured."""

from commonlaw.experiments.design import Suggestion as Suggestion, design as design, suggestions as suggestions
from commonlaw.experiments.plan import Design as Design
