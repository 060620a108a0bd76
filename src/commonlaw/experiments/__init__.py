"""Which experiment next: what would distinguish plausible laws, and determine their coefficients."""

from commonlaw.experiments.design import design as design, suggestions as suggestions
from commonlaw.experiments.plan import Design as Design
