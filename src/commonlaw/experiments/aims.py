"""What one wants to know of a law, and its value after an experiment."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.experiments.experiment import Experiment
from commonlaw.experiments.gaussian import Evidence
from commonlaw.experiments.predictive import Hypothesis
from commonlaw.forecast.scheme import PlannedTrial
from commonlaw.law.law import object_index
from commonlaw.law.parameters import followed_coefficients, named_parameters

_FORECAST = re.compile(
    r"(?P<state>\S+) at (?:\S+ *= *)?(?P<time>\S+) from (?P<start>.+?)(?: of (?P<object>.+))?", re.DOTALL
)
_COEFFICIENT = re.compile(r"(?P<name>.+?)(?: of (?P<object>.+))?", re.DOTALL)


@dataclass(frozen=True, eq=False)
class Quantity:
    """A function of coefficients under K hypotheses: values, shape (K,), and derivatives by unknowns, (p,)."""

    name: str
    values: Floats
    slopes: tuple[Floats, ...]

    def std(self, prior: Floats) -> float:
        """Return how far off it may be now, as a standard deviation over all hypotheses."""
        variances = np.array([slope @ slope for slope in self.slopes])
        return float(np.sqrt(prior @ (variances + (self.values - prior @ self.values) ** 2)))

    def expected_std(self, prior: Floats, evidence: Evidence) -> float:
        """Return how far off it may be after measurements, on average over what these may be."""
        parts = zip(self.values, self.slopes, evidence.estimates, strict=True)
        means = np.stack([value + estimates @ slopes for value, slopes, estimates in parts], axis=2)
        known = zip(self.slopes, evidence.covariances, strict=True)
        within = np.stack([np.einsum("p,...pq,q->...", s, covariance, s) for s, covariance in known], axis=-1)
        weights = evidence.probabilities(prior)
        middle = np.sum(weights * means, axis=2, keepdims=True)
        variances = np.sum(weights * (within + (means - middle) ** 2), axis=2)
        return float(np.sqrt(prior @ variances.mean(axis=1)))


def quantity(text: str, hypotheses: Sequence[Hypothesis]) -> Quantity:
    """Return the quantity that a text names.

    ``"x at t=10 from 100"`` is a forecast of a state, or of a measured quantity of a law with observation equations,
    from values of all states (and rates), with commas between them; rates that are left out are zero. ``"c"`` is a
    coefficient by its name in the law, or by its term. Of one object with `` of Ball 3`` behind it, else the mean over
    all objects. Raises `CommonlawError` if a name or number cannot be read.
    """
    forecast, coefficient = (form.fullmatch(text.strip()) for form in (_FORECAST, _COEFFICIENT))
    match = forecast or coefficient
    if match is None:
        raise CommonlawError("design-without-target")
    chosen, first = match["object"], hypotheses[0]
    if chosen is not None and chosen not in first.objects:
        raise unknown("object of this law", chosen, first.objects)
    names = first.objects if chosen is None else (chosen,)
    if forecast is None:
        return _of_hypotheses(text, (_coefficient(match["name"], first, model, names) for model in hypotheses))
    return _of_hypotheses(text, (_forecast(match, model, names) for model in hypotheses))


def coefficients(hypotheses: Sequence[Hypothesis]) -> list[Quantity]:
    """Return the coefficients of the first law, each of every object."""
    first = hypotheses[0]
    parameters, objects = [definition.name for definition in named_parameters(first.law).definitions], first.objects
    return [
        _of_hypotheses(
            f"{parameter} of {name}" if len(objects) > 1 else parameter,
            (_coefficient(parameter, first, hypothesis, (name,)) for hypothesis in hypotheses),
        )
        for parameter in parameters
        for name in objects
    ]


def _of_hypotheses(text: str, made: Iterable[tuple[float, Floats]]) -> Quantity:
    values, slopes = zip(*made, strict=True)
    return Quantity(text, np.array(values), slopes)


def _coefficient(name: str, first: Hypothesis, each: Hypothesis, names: Sequence[str]) -> tuple[float, Floats]:
    """Return the mean of a coefficient of the first law over objects as another law has it, and its derivatives."""
    law, terms = first.law, each.law.terms.names
    parameters = named_parameters(law)
    named = {definition.name: definition for definition in parameters.definitions}
    named = {law.terms.names[definition.term]: definition for definition in parameters.definitions} | named
    check_choice("coefficient of this law", name, named)
    columns = {term: k for k, term in enumerate(terms)}
    parts = [part._replace(term=columns.get(law.terms.names[part.term], -1)) for part in named[name].parts]
    if not all(part.term >= 0 and each.law.support[part.equation, part.term] for part in parts):
        return 0.0, np.zeros(each.unknowns)
    coefficient = named[name]._replace(parts=tuple(parts))
    values = each.law.coefficients[[object_index(each.law, owner) for owner in names]]
    slopes, places = np.zeros((len(names), each.roots.shape[1])), np.argwhere(each.law.support).tolist()
    for part, gradient in zip(parts, coefficient.gradient(values).T, strict=True):
        slopes[:, places.index([part.equation, part.term])] = gradient
    return float(coefficient.of(values).mean()), _by_unknowns(slopes, each, names)


def _forecast(parts: re.Match[str], each: Hypothesis, names: Sequence[str]) -> tuple[float, Floats]:
    law, states = each.law, each.law.terms.variables.states
    scheme = each.scheme(frozenset(states))
    check_choice("state" if scheme.shown == states else "measured quantity", parts["state"], scheme.shown)
    if law.observation.measured.inputs:
        raise CommonlawError("design-forecast-with-inputs")
    try:
        time, start = float(parts["time"]), [float(number) for number in parts["start"].split(",")]
    except ValueError as error:
        raise CommonlawError("design-forecast-syntax", error=error) from None
    if not (time > 0 and len(law.schema.states) <= len(start) <= len(states)):
        raise CommonlawError(
            "design-forecast-numbers",
            time=time,
            given=len(start),
            least=len(law.schema.states),
            most=len(states),
            states=states,
        )
    initial = np.pad(np.array(start), (0, len(states) - len(start)))
    column, times, count = scheme.shown.index(parts["state"]), np.array([0.0, time]), int(law.support.sum())
    settings = {**dict(zip(states, initial.tolist(), strict=True)), "times": (0.0, time)}
    made = Experiment.of(law, tuple(names), settings, {})
    beginning, _ = scheme.beginning(made.start, made.start_std)
    planned = [
        PlannedTrial(
            name, times, followed_coefficients(law, name), beginning, law.properties.get(name, {}), made.inputs
        )
        for name in names
    ]
    followed = scheme.followed(planned, slopes=True)
    values = np.array([curve.values[-1, column] for curve in followed if curve.values is not None])
    slopes = np.array([curve.slopes[-1, column, :count] for curve in followed if curve.slopes is not None])
    if not (len(values) == len(names) and np.isfinite(values).all()):
        raise CommonlawError("design-forecast-diverges", structure=law.structure, time_name=law.schema.time, time=time)
    if parts["state"] in law.observation.measured.logarithmic:
        values = np.exp(values)
        slopes = slopes * values[:, np.newaxis]
    return float(values.mean()), _by_unknowns(slopes, each, names)


def _by_unknowns(slopes: Floats, each: Hypothesis, names: Sequence[str]) -> Floats:
    """Return the derivatives of a mean over objects from those by their parameters, shape (unknowns,)."""
    roots = each.roots[[each.objects.index(name) for name in names]]
    return np.asarray(np.einsum("op,opu->u", slopes, roots) / len(names))


LAW, COEFFICIENTS = "law", "coefficients"


@dataclass(frozen=True, eq=False)
class Aim:
    """What is to be learned, among hypotheses with these probabilities, shape (K,).

    Without a quantity: which hypothesis is right, or all coefficients together (D-optimality).
    """

    prior: Floats
    of_law: bool
    quantity: Quantity | None = None

    @classmethod
    def of(cls, text: str | None, prior: Floats, hypotheses: Sequence[Hypothesis]) -> "Aim":
        """Return the aim that a text names; by default the law, if it is in doubt."""
        if text in (None, LAW, COEFFICIENTS):
            return cls(prior, len(prior) > 1 and text != COEFFICIENTS)
        return cls(prior, False, quantity(str(text), hypotheses))

    def bits(self, evidence: Evidence) -> float:
        """Return how much is learned of it, in bits."""
        if self.quantity is not None:
            now, then = self.quantity.std(self.prior), self.quantity.expected_std(self.prior, evidence)
            return float(np.log2(now / then)) if then > 0 else 0.0
        if self.of_law:
            return float(evidence.information_about_law(self.prior) / np.log(2))
        return float(self.prior @ evidence.gain().mean(axis=(0, 2)) / np.log(2))
