"""The named model nearest to a law: its evidence, its forecasts, and what it leaves unexplained."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, permutations, product
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.discovery.fitting import fit
from commonlaw.discovery.orders import attempt_each
from commonlaw.discrepancy.residual_tests import Residuals
from commonlaw.discrepancy.residuals import untested
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.convergence import converged
from commonlaw.inference.fit.final_score import score_of_fit
from commonlaw.inference.fit.fit import Fit, linearized_evidence
from commonlaw.inference.score.supports import SupportEvidence, shifted
from commonlaw.inference.search.error_models import with_error_models
from commonlaw.inference.search.law_search import fit_terms
from commonlaw.inference.search.setup import FitSetup, RefitOptions
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.law.law import shares_terms
from commonlaw.law.models import NamedModel, named_models
from commonlaw.law.parse import GivenEquations, read_equations
from commonlaw.law.text import left_hand_sides
from commonlaw.law.verdict import LawVerdict
from commonlaw.library import Term, Terms
from commonlaw.library.parametric import free_name
from commonlaw.likelihood import NotPositiveError
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.runtime.progress import silent, unannounced
from commonlaw.trials import Schema, Trials
from commonlaw.trials.headers import known_unit
from commonlaw.trials.trial import property_names
from commonlaw.trials.units import Conversion
from commonlaw.verdict import assess

AS_GOOD = 3.0
"""2 log B up to which a named model is as good as the law: positive evidence begins at 2, strong at 6 (Kass and Raftery
1995)."""

_MAX_FITTED = 4
"""So many named models are fitted, the nearest by the linearized likelihood."""

_THIRDS = ("at the start", "in the middle", "at the end")
"""The thirds of a trial."""


class Unexplained(NamedTuple):
    """What a law leaves of the measurements of a state, beyond their noise.

    Parameters
    ----------
    state, unit
        Whose measurements, and their unit, empty if unknown.
    size
        ``sqrt(mean r^2 - s^2)`` of residuals r, with the noise s by the chosen law, if the excess of n residuals is
        above two standard errors, ``2 sqrt(2/n) s^2``; ``sqrt(mean r_i r_(i+1))`` of residuals and the next, in which
        white noise has no part, if that is slow and larger; else zero.
    correlation
        Of residuals with those of the next samples, about zero.
    slow
        Whether this is above zero by more than two standard errors, ``1/sqrt(n)`` of n pairs.
    shares
        Of the sum behind the size in the first, second and last third of the trials; zero if nothing is left.
    """

    state: str
    unit: str
    size: float
    correlation: float
    slow: bool
    shares: tuple[float, float, float]

    def __str__(self) -> str:
        if not self.size:
            return f"nothing of {self.state} beyond the noise"
        most = int(np.argmax(self.shares))
        where = f", mostly {_THIRDS[most]}" if self.shares[most] > 0.5 else ""
        size = f"{self.size:.2g} {self.unit}".rstrip()
        return f"{size} of {self.state}{', slow' if self.slow else ''}{where}"


@dataclass(frozen=True, eq=False)
class TextbookLaw(ShownInNotebooks):
    """The named model nearest to a law; it prints as a sentence.

    Parameters
    ----------
    models
        The named models with these equations, over the columns of the trials.
    chosen
        The law that it is compared with.
    law
        The named model, fitted to the training data; the chosen law itself if this has its terms and signs.
    evidence
        2 log B of the chosen law against it, without the prior probabilities of terms, see `commonlaw.compare`;
        negative if the named model is more probable.
    verdicts
        The forecast assessments of it and of the chosen law.
    residuals
        Of its trajectories and of those of the chosen law, both over the noise by the latter.
    """

    models: tuple[NamedModel, ...]
    chosen: Law
    law: Law
    evidence: float
    verdicts: tuple[LawVerdict, LawVerdict]
    residuals: tuple[Residuals, Residuals]

    @property
    def title(self) -> str:
        """What textbooks call it."""
        return _title(self.models)

    @cached_property
    def unexplained(self) -> tuple[Unexplained, ...]:
        """What it leaves of each measured state."""
        schema = self.chosen.observation.measured
        return tuple(_unexplained(self.residuals[0], schema.states.index(name), schema) for name in schema.measured)

    @property
    def is_chosen(self) -> bool:
        """Whether the chosen law is this named model."""
        return self.law is self.chosen

    @property
    def as_good(self) -> bool:
        """Whether the data do not distinguish it from the chosen law: 2 log B of at most 3."""
        return self.evidence <= AS_GOOD

    @property
    def error_ratio(self) -> float:
        """Its forecast error over that of the chosen law; infinite if its forecasts diverge, NaN if unknown."""
        named, of_chosen = self.verdicts
        with np.errstate(all="ignore"):
            return float(np.divide(named.error, of_chosen.error))

    def as_dict(self) -> dict[str, object]:
        """Return its names, equations and numbers."""
        return {
            "models": [model.name for model in self.models],
            "equations": list(self.models[0].without_bounds),
            "is_chosen": self.is_chosen,
            "2 log B": self.evidence,
            "error_ratio": self.error_ratio,
            "unexplained": [of_state._asdict() for of_state in self.unexplained],
            "sentence": str(self),
        }

    def __str__(self) -> str:
        title, equations = self.title, "; ".join(self.models[0].without_bounds)
        if self.is_chosen:
            return f"This is a textbook law: {title}, {equations} ({self.models[0].source})."
        return f"Nearest textbook law: {title}, {equations}. {'; '.join(self._sentences())}."

    def _sentences(self) -> Iterator[str]:
        size = f"2 log B = {_rounded(abs(self.evidence))}"
        if abs(self.evidence) <= AS_GOOD:
            yield f"These data do not distinguish it from the chosen law ({size})"
        else:
            yield f"It is {'less' if self.evidence > 0 else 'more'} probable than the chosen law ({size})"
        ratio = self.error_ratio
        data = "training data" if self.verdicts[0].in_sample else self.verdicts[0].judged_on
        if np.isinf(ratio):
            yield f"its forecasts of {data} diverge"
        elif ratio > 1.1 or ratio < 1 / 1.1:
            yield f"its forecasts of {data} have {ratio:.2g} times the error"
        elif np.isfinite(ratio):
            yield f"its forecasts of {data} are as accurate"
        yield f"it leaves {' and '.join(map(str, self.unexplained))}"


def _unexplained(residuals: Residuals, j: int, schema: Schema) -> Unexplained:
    """Return what a law leaves of a state, given its residuals over the noise."""
    samples, pairs = list[Floats](), list[Floats]()
    for trial, fitted, standardized in zip(residuals.trials, residuals.fitted, residuals.standardized, strict=True):
        seen = np.isfinite(standardized[:, j])
        r, z = trial.states[seen, j] - fitted[seen, j], standardized[seen, j]
        third = np.minimum(3 * trial.elapsed[seen] / max(trial.elapsed[-1], np.finfo(float).tiny), 2).astype(int)
        samples.append(np.array([third, r**2, np.divide(r**2, z**2, out=np.zeros_like(r), where=z != 0)]))
        pairs.append(np.array([third[:-1], r[:-1] * r[1:]]))
    (third, squares, variances), (of_pair, products) = (np.concatenate(parts, axis=1) for parts in (samples, pairs))
    correlation = float(products.mean() / squares.mean()) if products.size and squares.any() else 0.0
    slow = bool(correlation > 2 / np.sqrt(max(products.size, 1)))
    excess = squares - variances
    is_excess = excess.mean() > 2 * np.sqrt(2 / squares.size) * variances.mean()
    # The larger of two estimates: what is slow is in both, unless the noise by the chosen law contains it
    is_slower = slow and not (is_excess and excess.mean() > products.mean())
    where, values = (of_pair, products) if is_slower else (third, excess)
    positive = np.maximum(np.bincount(where.astype(int), values, minlength=3), 0.0)
    is_left, shares = slow or is_excess, (0.0, 0.0, 0.0)
    if is_left:
        first, second, last = (positive / positive.sum()).tolist()
        shares = (first, second, last)
    size = float(np.sqrt(values.mean())) if is_left else 0.0
    unit = "" if schema.states[j] in schema.logarithmic else schema.units.get(schema.states[j], "")
    return Unexplained(schema.states[j], unit, size, correlation, slow, shares)


class _Nearest(NamedTuple):
    """Named models with the same terms, 2 log B of the law against them, and whether the law is this model."""

    models: Sequence[NamedModel]
    evidence: float
    is_law: bool = False


def nearest_textbook_law(
    law: Law, trials: Trials, learned: Trials | None = None, verdict: LawVerdict | None = None
) -> TextbookLaw:
    """Return the named model nearest to a law, see `Law.textbook`; `verdict` is that of the law, if it is known."""
    if not _is_comparable(law):
        raise CommonlawError("named-model-beyond")
    whole = matched(law, trials)
    training = whole if learned is None or learned is trials else matched(law, learned)
    with unannounced():
        nearest = _nearest(law, training)
        if nearest is None:
            raise CommonlawError("named-model-none", equations=left_hand_sides(law.schema.states, law.order))
        errors, verdict = law.uncertainty.error_model, verdict or assess(law, whole, training)
        named, of_named = law, verdict
        if not nearest.is_law:
            named = fit(
                nearest.models[0].without_bounds,
                training,
                errors=errors.kind,
                log_states=law.schema.logarithmic,
                input_interpolation=law.schema.input_interpolation,
                progress=silent,
            )
            of_named = assess(named, whole, training)
        under = replace(named, uncertainty=replace(named.uncertainty, error_model=errors))
        residuals = [untested(one, training, law.uncertainty.noise)[0] for one in (under, law)]
    return TextbookLaw(
        models=tuple(nearest.models),
        chosen=law,
        law=named,
        evidence=nearest.evidence,
        verdicts=(of_named, verdict),
        residuals=(residuals[0], residuals[1]),
    )


def outcomes_of_textbook(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return a note if a named model that the law is not is as good, see `TextbookLaw.as_good`."""
    if not _is_comparable(law) or _same(law, _candidates(law)):
        return ()
    try:
        with unannounced():
            nearest = _nearest(law, trials, AS_GOOD)
    except (CommonlawError, ArithmeticError, np.linalg.LinAlgError):  # Laws are reported without this note, too
        return ()
    if nearest is None or nearest.is_law:
        return ()
    title, equations = _title(nearest.models), nearest.models[0].without_bounds
    probable = "more probable" if nearest.evidence < -AS_GOOD else "about as probable"
    evidence = f"2 log B = {_rounded(abs(nearest.evidence))} {'against' if nearest.evidence > 0 else 'for'} it"
    return (note("textbook-law-as-good", title=title, equations=equations, probable=probable, evidence=evidence),)


def has_textbook_laws(law: Law) -> bool:
    """Return whether there are named models that a law can be compared with."""
    return _is_comparable(law) and bool(_candidates(law))


def _is_comparable(law: Law) -> bool:
    is_plain = law.scheme == "collocation" and not law.schema.initial_values and law.uncertainty.explanation is None
    return is_plain and law.order in (1, 2) and shares_terms(law)


def _rounded(evidence: float) -> str:
    """Return 2 log B with two digits, or as a whole number.

    >>> _rounded(1.234), _rounded(123.4)
    ('1.2', '123')
    """
    return f"{evidence:.2g}" if abs(evidence) < 100 else f"{evidence:.0f}"


def _title(models: Sequence[NamedModel]) -> str:
    return " or ".join(dict.fromkeys(model.title for model in models))


_Places = frozenset[tuple[int, Term]]
"""The terms of each equation of a law, with the index of the equation."""


class _Candidate(NamedTuple):
    """A named model over the columns of trials, its equations, and whether the columns have the names of its variables.

    Names such as T or theta say what a column is; x, y and z do not.
    """

    model: NamedModel
    given: GivenEquations
    has_names: bool

    @property
    def places(self) -> _Places:
        """The terms of its equations."""
        chosen = np.argwhere(np.isnan(self.given.known)).tolist()
        return frozenset((j, self.given.terms.terms[k]) for j, k in chosen)

    def has_signs(self, coefficients: Floats, terms: Terms) -> bool:
        """Return whether parameters are within their bounds, given coefficients, (objects, equations, terms).

        The mean over objects decides: noise may turn the sign of an object.
        """
        mean = coefficients[:, :, [terms.terms.index(term) for term in self.given.terms.terms]].mean(axis=0)
        values = {coefficient.name: coefficient.of(mean) for coefficient in self.given.coefficients}
        return all(bound.holds(values[bound.name]) for bound in self.given.bounds)


def _of_signs(alike: Sequence[_Candidate], coefficients: Floats, terms: Terms) -> list[_Candidate]:
    """Return those of some named models whose signs coefficients have, each once, that of the names of columns first.

    If one has these names, it alone says what the columns are.
    """
    known = {candidate.model.name: candidate for candidate in alike if candidate.has_signs(coefficients, terms)}
    return [candidate for candidate in known.values() if candidate.has_names] or [*known.values()]


def _candidates(law: Law) -> dict[_Places, list[_Candidate]]:
    """Return the named models with the states, the order and inputs of a law, by their terms.

    They are linear in free coefficients.
    """
    schema, result = law.schema, dict[_Places, list[_Candidate]]()
    inputs = [name for name in schema.inputs if name not in schema.doses]
    taken = (*law.terms.variables.names, *property_names(law.properties))
    for model in named_models.values():
        is_of_order = (law.order == 2) == ("''" in model.equations)
        if not (is_of_order and len(model.states) == len(schema.states) and _is_linear(model.name)):
            continue
        free = {name: free_name(name, taken) for name in model.parameters}
        free = {name: new for name, new in free.items() if new != name}
        for columns in product(permutations(schema.states), permutations(inputs, len(model.inputs))):
            names = dict(zip((*model.states, *model.inputs), chain(*columns), strict=True))
            over = model.over(names | free)
            candidate = _Candidate(over, read_equations(over.equations, schema), _are_names(names))
            result.setdefault(candidate.places, []).append(candidate)
    return result


def _same(law: Law, candidates: Mapping[_Places, Sequence[_Candidate]]) -> list[_Candidate]:
    """Return the named models that a law is: those of its terms and signs."""
    terms = law.terms
    places = frozenset((j, terms.terms[k]) for j, k in np.argwhere(law.support & terms.is_factor).tolist())
    return _of_signs(candidates.get(places, []), law.coefficients, terms)


@cache
def _is_linear(name: str) -> bool:
    """Return whether a named model is linear in free coefficients, and all of its states have columns."""
    model = named_models[name]
    if model.properties or model.latent or model.doses or re.search(r"\(t - ", model.equations):
        return False
    given = read_equations(model.equations, Schema(model.states, model.inputs))
    return not given.terms.parameters and not np.nan_to_num(given.known).any()


def _are_names(names: Mapping[str, str]) -> bool:
    return all(name == column for name, column in names.items()) and not {*names} <= {"x", "y", "z"}


def _has_units(candidate: _Candidate, schema: Schema) -> bool:
    """Return whether the units of columns have the dimensions of a named model, where both are known.

    Degrees Celsius have an arbitrary origin, which the terms must not fix.
    """
    model, terms, supports = candidate.model, candidate.given.terms, np.isnan(candidate.given.known)
    for name in (*model.states, *model.inputs):
        unit, of_model = (known_unit(units.get(name, "")) for units in (schema.units, model.units))
        if unit is None:
            continue
        if of_model is not None and of_model.dimensionality != unit.dimensionality:
            return False
        if unit.is_compatible_with("K") and Conversion.between(name, schema.units[name], "K").offset:
            # A term whose derivative is not in the span of those of its equation needs all of them
            column, indices = terms.variables.index(name), [np.flatnonzero(support).tolist() for support in supports]
            if any(shifted(terms.take(some), column).all(axis=1).any() for some in indices):
                return False
    return True


class _Ranked(NamedTuple):
    """Named models of the same terms, with coefficients, and 2 log B against them, by the linearized likelihood."""

    above: float
    alike: Sequence[_Candidate]
    law: Law


def _nearest(law: Law, trials: Trials, most: float = np.inf) -> _Nearest | None:
    """Return the nearest named model; None if there is none, or 2 log B against it is above `most`.

    One whose variables have the names of the columns comes before others. All have the error model of the law. With a
    finite `most`, models are not fitted if by the linearized likelihood n residuals have e times the variance of those
    of the law, ``2 log B = n``.
    """
    candidates = {
        places: known
        for places, alike in _candidates(law).items()
        if (known := [candidate for candidate in alike if _has_units(candidate, law.schema)])
    }
    if same := _same(law, candidates):
        return _Nearest([candidate.model for candidate in same], 0.0, is_law=True)
    if not candidates:
        return None
    kind = law.uncertainty.error_model.kind
    chosen = _fitted(law, trials, kind)
    ranked = sorted(_linearized(chosen, law.schema, candidates.values()), key=lambda named: named.above)
    ranked = [named for named in ranked if any(known.has_names for known in named.alike)] or ranked
    measured = sum(chosen.problem.measured) if np.isfinite(most) else np.inf
    near = [named for named in ranked[:_MAX_FITTED] if named.above < measured]
    fits, _ = attempt_each(lambda named: (_fitted(named.law, trials, kind), named.alike), near)
    # Converged fits differ from these by less than strong evidence as a rule
    least = min((_score(fitted) for fitted, _ in fits), default=0.0)
    close = [pair for pair in fits if _score(pair[0]) < min(least, _score(chosen) + most) + settings.STRONG]
    best, of_law = list[_Nearest](), score_of_fit(converged(chosen)[0]) if close else None
    for fitted, alike in close:
        done = converged(fitted)[0]
        coefficients = np.array([estimate.coefficients for estimate in done.estimates])
        if of_law is not None and (models := _of_signs(alike, coefficients, done.problem.terms)):
            best.append(_Nearest([candidate.model for candidate in models], score_of_fit(done) - of_law))
    nearest = min(best, key=lambda nearest: nearest.evidence, default=None)
    return nearest if nearest is not None and nearest.evidence <= most else None


def _fitted(law: Law, trials: Trials, kind: ErrorKind) -> Fit:
    """Return the fit of a law under an error model."""
    fitted = fit_terms(FitSetup.of(law, trials, RefitOptions()))
    return (fitted if kind == "white" else with_error_models(fitted, None, (kind,), silent)).best


def _score(fitted: Fit) -> float:
    """Return the score of a fit without the prior of its terms."""
    return fitted.score.total - fitted.score.parts.get("structure", 0.0)


def _linearized(fitted: Fit, schema: Schema, candidates: Iterable[Sequence[_Candidate]]) -> Iterator[_Ranked]:
    """Yield named models of the right signs, ranked by the likelihood linearized about a fitted law.

    The prior probabilities of terms are left out. Models whose terms are not finite there are, too.
    """
    problem, before = fitted.problem, fitted.problem.terms
    inner = len(before) - len(before.parameters)
    for alike in candidates:
        named = alike[0].given.terms.terms
        more = [term for term in named if term not in before.terms]
        terms = Terms(before.variables, (*before.terms[:inner], *more, *before.terms[inner:]))
        columns = [terms.terms.index(term) for term in named]

        def wider(values: Floats, new: float, count: int = len(more)) -> Floats:
            return np.insert(values, [inner] * count, new, axis=-1)

        models = tuple(replace(model, terms=terms) for model in problem.models)
        estimates = [replace(estimate, coefficients=wider(estimate.coefficients, 0.0)) for estimate in fitted.estimates]
        wide = replace(problem, models=models, known=np.full_like(wider(problem.known, 0.0), np.nan))
        supports = np.zeros(wide.allowed.shape, dtype=bool)
        supports[:, columns] = np.isnan(alike[0].given.known)
        try:
            evidence = linearized_evidence(wide, estimates, fitted.fitted_model_error)
            chosen = wider(fitted.supports.astype(np.float64), 0.0) > 0
            above = _without_prior(evidence, supports) - _without_prior(evidence, chosen)
            coefficients = evidence.coefficients(supports)
        except (NotPositiveError, np.linalg.LinAlgError):
            continue
        if known := _of_signs(alike, coefficients, terms):
            terms = Terms(replace(before.variables, parameters=()), named)
            objects = problem.trials.objects
            yield _Ranked(above, known, Law(terms, schema, problem.order, objects, coefficients[:, :, columns]))


def _without_prior(evidence: SupportEvidence, supports: Bools) -> float:
    return evidence.value(supports) - sum(map(evidence.structure_prior.of, supports))
